"""MLS-MPM in Warp on one CPU thread, for cases with an exact solution: one launch per phase, `wp.atomic_add` on the grid."""

from collections import namedtuple

import numpy as np
import warp as wp
from peers.problem import Waves

wp.config.quiet = True
VERSION = wp.config.version
Types = namedtuple("Types", "real vector matrix")


def types_of(precision, dim):
    real = {"float32": wp.float32, "float64": wp.float64}[precision]
    return Types(real, wp.types.vector(length=dim, dtype=real), wp.types.matrix(shape=(dim, dim), dtype=real))


def waves(problem, types):
    """Acceleration that makes the waves a solution for a neo-Hookean solid."""
    real, vector, _ = types
    force, dim = problem.force, problem.dim
    A, k, w, Ak = (real(value) for value in (force.A, force.k, force.w, force.A * force.k))
    mu, lam, one = real(problem.mu), real(problem.lam), real(1.0)
    square, w2 = real(force.k**2 / problem.density), real(force.w**2)
    phases = vector(*force.phases)

    @wp.func
    def body_force(X: vector, t: real):
        u = vector()
        F = vector()
        J = one
        for d in range(dim):
            swing = wp.sin(w * t + phases[d])
            u[d] = A * wp.sin(k * X[d]) * swing
            F[d] = one + Ak * wp.cos(k * X[d]) * swing
            J = J * F[d]
        pressure = lam * (wp.log(J) - one)
        b = vector()
        for d in range(dim):
            b[d] = u[d] * (square * (mu + (mu - pressure) / (F[d] * F[d])) - w2)
        return b

    return body_force


def vortex(problem, types):
    real, vector, _ = types
    force = problem.force
    A, w, stiffness = real(force.A), real(force.w), real(problem.mu / problem.density)
    centre, one, three, sixteen, fortyeight, sixtyfour = vector(*force.centre), *map(real, (1, 3, 16, 48, 64))

    @wp.func
    def body_force(X: vector, t: real):
        place = X - centre
        R = wp.length(place)
        d = R - one
        swing = A * wp.sin(w * t)
        rest = sixteen * d * d - one
        h = rest * rest
        slope = sixtyfour * d * rest * swing
        bend = sixtyfour * (fortyeight * d * d - one) * swing
        turned = A * w * wp.cos(w * t) * h
        radial = stiffness * R * slope * slope - R * turned * turned
        along = -R * w * w * swing * h - stiffness * (three * slope + R * bend)
        c = wp.cos(swing * h)
        s = wp.sin(swing * h)
        ox = (c * place[0] - s * place[1]) / R
        oy = (s * place[0] + c * place[1]) / R
        return vector(radial * ox - along * oy, radial * oy + along * ox)

    return body_force


def kernels(problem, types):
    """(p2g, update_nodes, g2p). In 2-D the grid's last axis has one node."""
    real, vector, matrix = types
    body_force = (waves if isinstance(problem.force, Waves) else vortex)(problem, types)
    dim, dt, dx, inv_dx = problem.dim, real(problem.step), real(problem.cell_size), real(1.0 / problem.cell_size)
    mu, lam = real(problem.mu), real(problem.lam)
    particle_mass = real(problem.volume * problem.density)
    impulse = real(-problem.step * problem.volume * 4.0 / problem.cell_size**2)
    zero, half, three_quarters, one, three_halves = (real(value) for value in (0.0, 0.5, 0.75, 1.0, 1.5))
    four_inv_dx, periodic, last = real(4.0 / problem.cell_size), problem.periodic, 3 if dim == 3 else 1
    nx, ny, nz = (*problem.nodes, 1)[:3]
    table = wp.types.matrix(shape=(3, dim), dtype=real)
    corner = wp.types.vector(length=3, dtype=wp.int32)
    grid_vector, grid_scalar = wp.array3d(dtype=vector), wp.array3d(dtype=real)

    @wp.func
    def weights(f: vector):
        w = table()
        for d in range(dim):
            a = three_halves - f[d]
            b = f[d] - one
            c = f[d] - half
            w[0, d] = half * a * a
            w[1, d] = three_quarters - b * b
            w[2, d] = half * c * c
        return w

    @wp.func
    def corner_of(place: vector):
        found = corner()
        for d in range(dim):
            found[d] = int(wp.floor(place[d] - half))
        return found

    @wp.func
    def fraction(place: vector, base: corner):
        f = vector()
        for d in range(dim):
            f[d] = place[d] - real(base[d])
        return f

    @wp.func
    def wrapped(i: int, count: int):
        if i < 0:
            i += count
        if i >= count:
            i -= count
        return i

    @wp.func
    def node_at(base: corner, a: int, b: int, c: int):
        node = corner(base[0] + a, base[1] + b, base[2] + c)
        if wp.static(periodic):
            node = corner(wrapped(node[0], nx), wrapped(node[1], ny), wrapped(node[2], nz))
        return node

    @wp.func
    def offset_2(a: int, b: int, c: int):
        return vector(real(a), real(b))

    @wp.func
    def offset_3(a: int, b: int, c: int):
        return vector(real(a), real(b), real(c))

    @wp.func
    def weight_2(w: table, a: int, b: int, c: int):
        return w[a, 0] * w[b, 1]

    @wp.func
    def weight_3(w: table, a: int, b: int, c: int):
        return w[a, 0] * w[b, 1] * w[c, 2]

    offset, weight_of = (offset_2, weight_2) if dim == 2 else (offset_3, weight_3)

    @wp.kernel(enable_backward=False)
    def p2g(
        x: wp.array(dtype=vector),
        v: wp.array(dtype=vector),
        C: wp.array(dtype=matrix),
        F: wp.array(dtype=matrix),
        X: wp.array(dtype=vector),
        t: real,
        momentum: grid_vector,
        mass: grid_scalar,
    ):
        p = wp.tid()
        unit = wp.identity(n=dim, dtype=real)
        F_new = (unit + dt * C[p]) * F[p]
        F[p] = F_new
        stress = mu * (F_new * wp.transpose(F_new)) + (lam * wp.log(wp.determinant(F_new)) - mu) * unit
        affine = impulse * stress + particle_mass * C[p]
        push = particle_mass * (v[p] + dt * body_force(X[p], t))
        place = x[p] * inv_dx
        base = corner_of(place)
        f = fraction(place, base)
        w = weights(f)
        for a in range(3):
            for b in range(3):
                for c in range(wp.static(last)):
                    weight = weight_of(w, a, b, c)
                    node = node_at(base, a, b, c)
                    share = weight * (push + affine * ((offset(a, b, c) - f) * dx))
                    wp.atomic_add(momentum, node[0], node[1], node[2], share)
                    wp.atomic_add(mass, node[0], node[1], node[2], weight * particle_mass)

    @wp.kernel(enable_backward=False)
    def update_nodes(momentum: grid_vector, mass: grid_scalar):
        i, j, k = wp.tid()
        if mass[i, j, k] > zero:
            momentum[i, j, k] = momentum[i, j, k] / mass[i, j, k]

    @wp.kernel(enable_backward=False)
    def g2p(
        x: wp.array(dtype=vector),
        v: wp.array(dtype=vector),
        C: wp.array(dtype=matrix),
        momentum: grid_vector,
    ):
        p = wp.tid()
        place = x[p] * inv_dx
        base = corner_of(place)
        f = fraction(place, base)
        w = weights(f)
        new_v = vector()
        new_C = matrix()
        for a in range(3):
            for b in range(3):
                for c in range(wp.static(last)):
                    node = node_at(base, a, b, c)
                    u = weight_of(w, a, b, c) * momentum[node[0], node[1], node[2]]
                    new_v += u
                    new_C += wp.outer(u, offset(a, b, c) - f)
        v[p] = new_v
        C[p] = new_C * four_inv_dx
        moved = x[p] + dt * new_v
        if wp.static(periodic):
            for d in range(dim):
                moved[d] = moved[d] - wp.floor(moved[d])
        x[p] = moved

    return p2g, update_nodes, g2p


class WarpExact:
    """A problem in Warp; `precision` float32 or float64."""

    def __init__(self, problem, precision):
        wp.init()
        self.problem, self.precision, self.types = problem, precision, types_of(precision, problem.dim)
        self.nodes = (*problem.nodes, 1)[:3]
        self.momentum = wp.zeros(self.nodes, dtype=self.types.vector, device="cpu")
        self.mass = wp.zeros(self.nodes, dtype=self.types.real, device="cpu")
        self.p2g, self.update_nodes, self.g2p = kernels(problem, self.types)
        self.start()
        self.run(1)
        self.start()

    def array(self, values, dtype):
        return wp.array(values.astype(self.precision), dtype=dtype, device="cpu")

    def start(self):
        self.steps, problem = 0, self.problem
        self.x, self.v, self.X = (self.array(a, self.types.vector) for a in (problem.x, problem.v, problem.X))
        self.F, self.C = (self.array(a, self.types.matrix) for a in (problem.F, np.zeros_like(problem.F)))

    def run(self, steps):
        grid, count = [self.momentum, self.mass], len(self.problem.X)
        for _ in range(steps):
            t = self.types.real(self.steps * self.problem.step)
            self.momentum.zero_()
            self.mass.zero_()
            wp.launch(self.p2g, count, [self.x, self.v, self.C, self.F, self.X, t, *grid], device="cpu")
            wp.launch(self.update_nodes, self.nodes, grid, device="cpu")
            wp.launch(self.g2p, count, [self.x, self.v, self.C, self.momentum], device="cpu")
            self.steps += 1

    def positions(self):
        return self.x.numpy()
