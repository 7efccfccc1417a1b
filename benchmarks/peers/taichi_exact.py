"""MLS-MPM in Taichi on one thread of the CPU, for cases with an exact solution: one kernel per step, as its mpm88 example."""

import taichi as ti
from peers.problem import Waves

VERSION = ".".join(map(str, ti.__version__))


def waves(problem):
    """Acceleration that makes the waves a solution for a neo-Hookean solid."""
    force, dim = problem.force, problem.dim
    A, k, w, mu, lam = force.A, force.k, force.w, problem.mu, problem.lam
    square = k * k / problem.density
    phases = ti.Vector(force.phases)

    @ti.func
    def body_force(X, t):
        swing = ti.sin(w * t + phases)
        u = A * ti.sin(k * X) * swing
        F = 1 + A * k * ti.cos(k * X) * swing
        J = F[0]
        for d in ti.static(range(1, dim)):
            J *= F[d]
        return u * (square * (mu + (mu - lam * (ti.log(J) - 1)) / (F * F)) - w * w)

    return body_force


def vortex(problem):
    force, stiffness = problem.force, problem.mu / problem.density
    A, w, centre = force.A, force.w, ti.Vector(force.centre)

    @ti.func
    def body_force(X, t):
        place = X - centre
        R = place.norm()
        d = R - 1
        swing = A * ti.sin(w * t)
        h = (16 * d * d - 1) ** 2
        slope = 64 * d * (16 * d * d - 1) * swing
        bend = 64 * (48 * d * d - 1) * swing
        turned = A * w * ti.cos(w * t) * h
        radial = -R * turned * turned + stiffness * R * slope * slope
        along = -R * w * w * swing * h - stiffness * (3 * slope + R * bend)
        c, s = ti.cos(swing * h), ti.sin(swing * h)
        outward = ti.Vector([c * place[0] - s * place[1], s * place[0] + c * place[1]]) / R
        return radial * outward + along * ti.Vector([-outward[1], outward[0]])

    return body_force


def substep_kernel(problem, real, fields):
    """One whole step. `fields`: x, v, C, F, X of particles, then momentum and mass of nodes."""
    x, v, C, F, X, momentum, mass = fields
    dim, dt, dx, inv_dx = problem.dim, problem.step, problem.cell_size, 1.0 / problem.cell_size
    mu, lam = problem.mu, problem.lam
    particle_volume, particle_mass = problem.volume, problem.volume * problem.density
    periodic, nodes = problem.periodic, problem.nodes
    body_force = (waves if isinstance(problem.force, Waves) else vortex)(problem)

    @ti.func
    def node_at(place):
        if ti.static(periodic):
            for d in ti.static(range(dim)):
                place[d] = (place[d] + nodes[d]) % nodes[d]
        return place

    @ti.kernel
    def substep(t: real):
        for node in ti.grouped(mass):
            momentum[node] = ti.zero(momentum[node])
            mass[node] = 0
        for p in x:
            base = ti.floor(x[p] * inv_dx - 0.5).cast(int)
            fx = x[p] * inv_dx - base.cast(real)
            w = [0.5 * (1.5 - fx) ** 2, 0.75 - (fx - 1) ** 2, 0.5 * (fx - 0.5) ** 2]
            F[p] = (ti.Matrix.identity(real, dim) + dt * C[p]) @ F[p]
            pressure = lam * ti.log(F[p].determinant()) - mu
            stress = mu * (F[p] @ F[p].transpose()) + ti.Matrix.identity(real, dim) * pressure
            affine = (-dt * particle_volume * 4 * inv_dx * inv_dx) * stress + particle_mass * C[p]
            push = particle_mass * (v[p] + dt * body_force(X[p], t))
            for offset in ti.static(ti.grouped(ti.ndrange(*((3,) * dim)))):
                distance = (offset.cast(real) - fx) * dx
                weight = ti.cast(1.0, real)
                for d in ti.static(range(dim)):
                    weight *= w[offset[d]][d]
                node = node_at(base + offset)
                momentum[node] += weight * (push + affine @ distance)
                mass[node] += weight * particle_mass
        for node in ti.grouped(mass):
            if mass[node] > 0:
                momentum[node] /= mass[node]
        for p in x:
            base = ti.floor(x[p] * inv_dx - 0.5).cast(int)
            fx = x[p] * inv_dx - base.cast(real)
            w = [0.5 * (1.5 - fx) ** 2, 0.75 - (fx - 1) ** 2, 0.5 * (fx - 0.5) ** 2]
            new_v = ti.Vector.zero(real, dim)
            new_C = ti.Matrix.zero(real, dim, dim)
            for offset in ti.static(ti.grouped(ti.ndrange(*((3,) * dim)))):
                weight = ti.cast(1.0, real)
                for d in ti.static(range(dim)):
                    weight *= w[offset[d]][d]
                u = momentum[node_at(base + offset)]
                new_v += weight * u
                new_C += 4 * inv_dx * weight * u.outer_product(offset.cast(real) - fx)
            v[p] = new_v
            C[p] = new_C
            x[p] += dt * new_v
            if ti.static(periodic):
                x[p] -= ti.floor(x[p])

    return substep


class TaichiExact:
    """A problem in Taichi; `precision` float32 or float64."""

    def __init__(self, problem, precision):
        real = {"float32": ti.f32, "float64": ti.f64}[precision]
        ti.init(arch=ti.cpu, cpu_max_num_threads=1, default_fp=real, log_level=ti.ERROR)
        self.problem, self.precision, count, dim = problem, precision, len(problem.X), problem.dim
        self.x, self.v, self.X = (ti.Vector.field(dim, real, shape=count) for _ in range(3))
        self.C, self.F = (ti.Matrix.field(dim, dim, real, shape=count) for _ in range(2))
        grid = ti.Vector.field(dim, real, shape=problem.nodes), ti.field(real, shape=problem.nodes)
        self.substep = substep_kernel(problem, real, (self.x, self.v, self.C, self.F, self.X, *grid))
        self.start()
        self.run(1)
        self.start()

    def start(self):
        self.steps = 0
        self.C.fill(0.0)
        for name in ("x", "v", "F", "X"):
            getattr(self, name).from_numpy(getattr(self.problem, name).astype(self.precision))

    def run(self, steps):
        for _ in range(steps):
            self.substep(self.steps * self.problem.step)
            self.steps += 1
        ti.sync()

    def positions(self):
        return self.x.to_numpy()
