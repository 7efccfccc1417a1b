"""MLS-MPM in Warp, on the CPU (one thread) or a graphics card: one launch per phase, `wp.atomic_add` on the grid."""

import argparse
import time

import contest
import numpy as np
import warp as wp
from workloads import BULK_MODULUS, DENSITY, GRAVITY, LAM, MU, SLOPE, STEP, Workload, start

WALL = 3  # nodes at each side of the domain that let nothing out


def stress_function(name):
    """Kirchhoff stress of a particle after its state (F, or `volume`: J of water, v_c of sand) has followed the flow."""

    @wp.func
    def jelly(p: int, C: wp.mat33, F: wp.array(dtype=wp.mat33), volume: wp.array(dtype=float)):
        one = wp.identity(n=3, dtype=float)
        F_new = (one + STEP * C) * F[p]
        F[p] = F_new
        return MU * (F_new * wp.transpose(F_new)) + (LAM * wp.log(wp.determinant(F_new)) - MU) * one

    @wp.func
    def sand(p: int, C: wp.mat33, F: wp.array(dtype=wp.mat33), volume: wp.array(dtype=float)):
        U = wp.mat33()
        V = wp.mat33()
        s = wp.vec3()
        wp.svd3((wp.identity(n=3, dtype=float) + STEP * C) * F[p], U, s, V)
        e = wp.vec3(
            wp.log(wp.max(wp.abs(s[0]), 0.05)), wp.log(wp.max(wp.abs(s[1]), 0.05)), wp.log(wp.max(wp.abs(s[2]), 0.05))
        )
        third = (e[0] + e[1] + e[2]) / 3.0
        deviator = e - wp.vec3(third, third, third)
        trace = 3.0 * third + volume[p]
        volume[p] = wp.max(trace, 0.0)
        closed = wp.min(trace, 0.0)
        shrink = wp.min(1.0, -SLOPE * closed / (wp.length(deviator) + 1.0e-20))
        mean = closed / 3.0
        e = shrink * deviator + wp.vec3(mean, mean, mean)
        F[p] = U * wp.diag(wp.vec3(wp.exp(e[0]), wp.exp(e[1]), wp.exp(e[2]))) * wp.transpose(V)
        pressure = LAM * closed
        return U * wp.diag(2.0 * MU * e + wp.vec3(pressure, pressure, pressure)) * wp.transpose(U)

    @wp.func
    def water(p: int, C: wp.mat33, F: wp.array(dtype=wp.mat33), volume: wp.array(dtype=float)):
        J = volume[p] * (1.0 + STEP * wp.trace(C))
        volume[p] = J
        return wp.min(BULK_MODULUS * (J - 1.0), 0.0) * wp.identity(n=3, dtype=float)

    return {"W1": jelly, "W2": sand, "W3": water}[name]


def kernels(workload):
    """(p2g, update_nodes, g2p)."""
    stress = stress_function(workload.name)
    nodes, dx, inv_dx = workload.cells, workload.cell_size, float(workload.cells)
    particle_mass = workload.volume * DENSITY
    impulse = -STEP * workload.volume * 4.0 * inv_dx * inv_dx
    gravity = STEP * GRAVITY

    @wp.func
    def weights(f: wp.vec3):
        a = wp.vec3(1.5, 1.5, 1.5) - f
        b = f - wp.vec3(1.0, 1.0, 1.0)
        c = f - wp.vec3(0.5, 0.5, 0.5)
        middle = wp.vec3(0.75, 0.75, 0.75) - wp.cw_mul(b, b)
        return wp.matrix_from_rows(0.5 * wp.cw_mul(a, a), middle, 0.5 * wp.cw_mul(c, c))

    @wp.kernel(enable_backward=False)
    def p2g(
        x: wp.array(dtype=wp.vec3),
        v: wp.array(dtype=wp.vec3),
        C: wp.array(dtype=wp.mat33),
        F: wp.array(dtype=wp.mat33),
        volume: wp.array(dtype=float),
        momentum: wp.array3d(dtype=wp.vec3),
        mass: wp.array3d(dtype=float),
    ):
        p = wp.tid()
        affine = impulse * stress(p, C[p], F, volume) + particle_mass * C[p]
        X = x[p] * inv_dx
        i = int(X[0] - 0.5)
        j = int(X[1] - 0.5)
        k = int(X[2] - 0.5)
        f = X - wp.vec3(float(i), float(j), float(k))
        w = weights(f)
        for a in range(3):
            for b in range(3):
                for c in range(3):
                    distance = (wp.vec3(float(a), float(b), float(c)) - f) * dx
                    weight = w[a, 0] * w[b, 1] * w[c, 2]
                    wp.atomic_add(momentum, i + a, j + b, k + c, weight * (particle_mass * v[p] + affine * distance))
                    wp.atomic_add(mass, i + a, j + b, k + c, weight * particle_mass)

    @wp.kernel(enable_backward=False)
    def update_nodes(momentum: wp.array3d(dtype=wp.vec3), mass: wp.array3d(dtype=float)):
        i, j, k = wp.tid()
        if mass[i, j, k] > 0.0:
            u = momentum[i, j, k] / mass[i, j, k] + wp.vec3(0.0, gravity, 0.0)
            a = u[0]
            b = u[1]
            c = u[2]
            if (i < WALL and a < 0.0) or (i > nodes - WALL and a > 0.0):
                a = 0.0
            if (j < WALL and b < 0.0) or (j > nodes - WALL and b > 0.0):
                b = 0.0
            if (k < WALL and c < 0.0) or (k > nodes - WALL and c > 0.0):
                c = 0.0
            momentum[i, j, k] = wp.vec3(a, b, c)

    @wp.kernel(enable_backward=False)
    def g2p(
        x: wp.array(dtype=wp.vec3),
        v: wp.array(dtype=wp.vec3),
        C: wp.array(dtype=wp.mat33),
        momentum: wp.array3d(dtype=wp.vec3),
    ):
        p = wp.tid()
        X = x[p] * inv_dx
        i = int(X[0] - 0.5)
        j = int(X[1] - 0.5)
        k = int(X[2] - 0.5)
        f = X - wp.vec3(float(i), float(j), float(k))
        w = weights(f)
        new_v = wp.vec3(0.0, 0.0, 0.0)
        new_C = wp.mat33(0.0)
        for a in range(3):
            for b in range(3):
                for c in range(3):
                    distance = wp.vec3(float(a), float(b), float(c)) - f
                    u = w[a, 0] * w[b, 1] * w[c, 2] * momentum[i + a, j + b, k + c]
                    new_v += u
                    new_C += wp.outer(u, distance)
        v[p] = new_v
        C[p] = new_C * (4.0 * inv_dx)
        x[p] = x[p] + STEP * new_v

    return p2g, update_nodes, g2p


class WarpMpm:
    def __init__(self, workload, device):
        wp.config.quiet = True
        wp.init()
        self.device = device
        self.workload, self.particles, self.nodes = workload, workload.particles, (workload.cells,) * 3
        self.momentum = wp.zeros(self.nodes, dtype=wp.vec3, device=self.device)
        self.mass = wp.zeros(self.nodes, dtype=float, device=self.device)
        self.p2g, self.update_nodes, self.g2p = kernels(workload)
        self.seconds = dict.fromkeys(("clear", "p2g", "nodes", "g2p"), 0.0)
        self.start(fast=False)
        self.step()

    def facts(self):
        return {"version": wp.config.version}

    def start(self, fast):
        first = start(self.workload, fast)
        volume = first.v_c + (1.0 if self.workload.name == "W3" else 0.0)
        self.x = wp.array(first.x, dtype=wp.vec3, device=self.device)
        self.v = wp.array(first.v, dtype=wp.vec3, device=self.device)
        self.C = wp.zeros(self.particles, dtype=wp.mat33, device=self.device)
        self.F = wp.array(first.F.astype(np.float32), dtype=wp.mat33, device=self.device)
        self.volume = wp.array(volume.astype(np.float32), dtype=float, device=self.device)

    def step(self):
        clock = [time.perf_counter()]
        self.momentum.zero_()
        self.mass.zero_()
        clock.append(self.now())
        grid = [self.momentum, self.mass]
        wp.launch(self.p2g, self.particles, [self.x, self.v, self.C, self.F, self.volume, *grid], device=self.device)
        clock.append(self.now())
        wp.launch(self.update_nodes, self.nodes, grid, device=self.device)
        clock.append(self.now())
        wp.launch(self.g2p, self.particles, [self.x, self.v, self.C, self.momentum], device=self.device)
        clock.append(self.now())
        for name, taken in zip(self.seconds, np.diff(clock), strict=True):
            self.seconds[name] += float(taken)

    def now(self):
        """The time when all that has been launched is done."""
        wp.synchronize()
        return time.perf_counter()

    def phases(self):
        return self.seconds

    def sorts(self):
        return 0

    def positions(self):
        return self.x.numpy()


def main():
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("name", help="W1, W2 or W3")
    options.add_argument("cells", type=int)
    options.add_argument("--cores", type=int, nargs=1, default=[0])
    options.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    given = options.parse_args()
    contest.serve(lambda: WarpMpm(Workload(given.name, given.cells), given.device), given.cores)


if __name__ == "__main__":
    main()
