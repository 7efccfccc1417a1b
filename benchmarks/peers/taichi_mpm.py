"""MLS-MPM in Taichi, on the CPU or a graphics card, as its mpm3d example writes it: a field per quantity, atomic sums."""

import argparse
import time

import contest
import taichi as ti
from workloads import BULK_MODULUS, DENSITY, GRAVITY, LAM, MU, SLOPE, STEP, Workload, start

WALL = 3  # nodes at each side of the domain that let nothing out


def kernels(workload, fields):
    """The four phases of a step. `fields`: x, v, C, F, volume (J of water, v_c of sand), then the nodes' momentum and mass."""
    x, v, C, F, volume, momentum, mass = fields
    name, nodes = workload.name, workload.cells
    dx, inv_dx = workload.cell_size, float(workload.cells)
    particle_volume, particle_mass = workload.volume, workload.volume * DENSITY

    @ti.func
    def stress(p):
        """Kirchhoff stress of particle p after its state has followed the flow."""
        tau = ti.Matrix.zero(ti.f32, 3, 3)
        if ti.static(name == "W3"):
            volume[p] *= 1 + STEP * C[p].trace()
            tau = ti.Matrix.identity(ti.f32, 3) * ti.min(BULK_MODULUS * (volume[p] - 1), 0.0)
        else:
            F_new = (ti.Matrix.identity(ti.f32, 3) + STEP * C[p]) @ F[p]
            if ti.static(name == "W1"):
                J = F_new.determinant()
                tau = MU * (F_new @ F_new.transpose()) + ti.Matrix.identity(ti.f32, 3) * (LAM * ti.log(J) - MU)
                F[p] = F_new
            else:
                U, sigma, V = ti.svd(F_new)
                e = ti.Vector([ti.log(ti.max(ti.abs(sigma[d, d]), 0.05)) for d in ti.static(range(3))])
                deviator = e - e.sum() / 3
                trace = e.sum() + volume[p]
                volume[p] = ti.max(trace, 0.0)
                closed = ti.min(trace, 0.0)
                shrink = ti.min(1.0, -SLOPE * closed / (deviator.norm() + 1e-20))
                e = shrink * deviator + closed / 3
                along = 2 * MU * e + LAM * closed
                stretch = ti.Matrix.zero(ti.f32, 3, 3)
                principal = ti.Matrix.zero(ti.f32, 3, 3)
                for d in ti.static(range(3)):
                    stretch[d, d] = ti.exp(e[d])
                    principal[d, d] = along[d]
                F[p] = U @ stretch @ V.transpose()
                tau = U @ principal @ U.transpose()
        return tau

    @ti.kernel
    def clear():
        for node in ti.grouped(mass):
            momentum[node] = ti.zero(momentum[node])
            mass[node] = 0

    @ti.kernel
    def p2g():
        for p in x:
            base = (x[p] * inv_dx - 0.5).cast(int)
            fx = x[p] * inv_dx - base.cast(float)
            w = [0.5 * (1.5 - fx) ** 2, 0.75 - (fx - 1) ** 2, 0.5 * (fx - 0.5) ** 2]
            affine = (-STEP * particle_volume * 4 * inv_dx * inv_dx) * stress(p) + particle_mass * C[p]
            for i, j, k in ti.static(ti.ndrange(3, 3, 3)):
                offset = ti.Vector([i, j, k])
                distance = (offset.cast(float) - fx) * dx
                weight = w[i][0] * w[j][1] * w[k][2]
                momentum[base + offset] += weight * (particle_mass * v[p] + affine @ distance)
                mass[base + offset] += weight * particle_mass

    @ti.kernel
    def update_nodes():
        for i, j, k in mass:
            if mass[i, j, k] > 0:
                u = momentum[i, j, k] / mass[i, j, k]
                u[1] += STEP * GRAVITY
                if i < WALL and u[0] < 0:
                    u[0] = 0
                if i > nodes - WALL and u[0] > 0:
                    u[0] = 0
                if j < WALL and u[1] < 0:
                    u[1] = 0
                if j > nodes - WALL and u[1] > 0:
                    u[1] = 0
                if k < WALL and u[2] < 0:
                    u[2] = 0
                if k > nodes - WALL and u[2] > 0:
                    u[2] = 0
                momentum[i, j, k] = u

    @ti.kernel
    def g2p():
        for p in x:
            base = (x[p] * inv_dx - 0.5).cast(int)
            fx = x[p] * inv_dx - base.cast(float)
            w = [0.5 * (1.5 - fx) ** 2, 0.75 - (fx - 1) ** 2, 0.5 * (fx - 0.5) ** 2]
            new_v = ti.Vector.zero(ti.f32, 3)
            new_C = ti.Matrix.zero(ti.f32, 3, 3)
            for i, j, k in ti.static(ti.ndrange(3, 3, 3)):
                offset = ti.Vector([i, j, k])
                distance = offset.cast(float) - fx
                u = momentum[base + offset]
                weight = w[i][0] * w[j][1] * w[k][2]
                new_v += weight * u
                new_C += 4 * inv_dx * weight * u.outer_product(distance)
            v[p] = new_v
            C[p] = new_C
            x[p] += STEP * new_v

    return {"clear": clear, "p2g": p2g, "nodes": update_nodes, "g2p": g2p}


class TaichiMpm:
    def __init__(self, workload, threads, device):
        ti.init(arch=ti.cuda if device == "cuda" else ti.cpu, cpu_max_num_threads=threads, log_level=ti.ERROR)
        self.workload, self.particles, nodes = workload, workload.particles, (workload.cells,) * 3
        self.x, self.v = (ti.Vector.field(3, ti.f32, shape=self.particles) for _ in range(2))
        self.C, self.F = (ti.Matrix.field(3, 3, ti.f32, shape=self.particles) for _ in range(2))
        self.volume = ti.field(ti.f32, shape=self.particles)
        grid = ti.Vector.field(3, ti.f32, shape=nodes), ti.field(ti.f32, shape=nodes)
        self.kernels = kernels(workload, (self.x, self.v, self.C, self.F, self.volume, *grid))
        self.seconds = dict.fromkeys(self.kernels, 0.0)
        self.start(fast=False)
        self.step()

    def facts(self):
        return {"version": ".".join(map(str, ti.__version__))}

    def start(self, fast):
        first = start(self.workload, fast)
        self.x.from_numpy(first.x)
        self.v.from_numpy(first.v)
        self.C.fill(0.0)
        self.F.from_numpy(first.F.astype("float32"))
        self.volume.from_numpy(first.v_c.astype("float32") + (1.0 if self.workload.name == "W3" else 0.0))

    def step(self):
        for name, kernel in self.kernels.items():
            began = time.perf_counter()
            kernel()
            ti.sync()
            self.seconds[name] += time.perf_counter() - began

    def phases(self):
        return self.seconds

    def sorts(self):
        return 0

    def positions(self):
        return self.x.to_numpy()


def main():
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("name", help="W1, W2 or W3")
    options.add_argument("cells", type=int)
    options.add_argument("--cores", type=int, nargs="+", default=[0], help="as many threads as cores")
    options.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    given = options.parse_args()
    workload = Workload(given.name, given.cells)
    contest.serve(lambda: TaichiMpm(workload, len(given.cores), given.device), given.cores)


if __name__ == "__main__":
    main()
