"""pmpm as a contestant: whole steps through `pmpm.Simulation.step()`, on one rank or under mpiexec on as many as cores."""

import argparse
import time
from math import log

import contest
import numpy as np
from workloads import (
    BULK_MODULUS,
    DENSITY,
    FRICTION_ANGLE,
    GRAVITY,
    LAM,
    MU,
    POISSON_RATIO,
    STEP,
    YOUNGS_MODULUS,
    Workload,
    start,
)

import pmpm
from pmpm.kernels import loops, targets
from pmpm.physics import tensors3 as la

ELASTIC = {"density": DENSITY, "youngs_modulus": YOUNGS_MODULUS, "poisson_ratio": POISSON_RATIO}
MATERIALS = {
    "W1": {"model": "neo_hookean", **ELASTIC},
    "W2": {"model": "drucker_prager", **ELASTIC, "friction_angle": FRICTION_ANGLE},
    "W3": {"model": "fluid", "density": DENSITY, "bulk_modulus": BULK_MODULUS, "gamma": 1.0},
}


def scene(workload, precision, shape_function, own_law):
    """The block on a lattice; `PmpmSteps.start` moves its particles to the places of the workload."""
    material = MATERIALS[workload.name]
    if own_law:
        material = {"model": neo_hookean_of_my_own, "density": DENSITY, "mu": MU, "lam": LAM}
    dim, cell = workload.dim, workload.cell_size
    low, high = [workload.first_cell] * dim, [workload.first_cell + cells for cells in workload.block_shape]
    box = {"type": "box", "min": [cell * c for c in low], "max": [cell * c for c in high]}
    return pmpm.Scene(
        title=f"{workload.name}: a block of {workload.particles} particles",
        domain={
            "size": [cells * cell for cells in workload.domain_shape],
            "cell_size": cell,
            "gravity": [0.0, GRAVITY, 0.0][:dim],
        },
        method={"precision": precision, "transfer": "mls", "shape_function": shape_function},
        time={"end": 1.0, "step": STEP},
        materials={"block": material},
        bodies=[{"material": "block", "shape": box, "particles_per_cell": workload.particles_per_cell}],
    )


def neo_hookean_of_my_own(F, mu, lam):
    """The law of W1 as a user would write it."""
    return la.scale_plus_diagonal(mu, la.left_cauchy_green(F), lam * log(la.det(F)) - mu)


def bytes_held(simulation):
    """Of all particle arrays: lanes that fill up blocks and tables of segments too."""
    return sum(population.nbytes for population in simulation.populations)


def bytes_of_ids(simulation):
    """The one array that kernels never touch."""
    return sum(population.id.nbytes for population in simulation.populations)


def seconds_of_ordered_sum(simulation, times=7):
    """What it takes to add each layer's planes to the nodes: P2G could add to them at once if the order did not matter."""
    fold = targets.scalar(simulation.real).compile(loops.fold_layer)
    patch = simulation.patch
    simulation.lay_out()
    found = []
    for _ in range(times):
        began = time.perf_counter()
        for layer in range(patch.layers):
            fold(
                patch.windows[0], 0, layer, patch.placed, patch.placed_start, patch.corner, patch.slots, patch.nodes[0],
                patch.unsummed[0],
            )  # fmt: skip
        found.append(time.perf_counter() - began)
    return min(found)


class PmpmSteps:
    def __init__(self, workload, precision, shape_function, own_law, shuffled, comm, threads=1, device="cpu"):
        self.workload, self.comm = workload, comm
        self.device = device
        of_workload = scene(workload, precision, shape_function, own_law)
        self.simulation = pmpm.Simulation(of_workload, comm, threads=threads, backend=device)
        ids = self.simulation.particles.id
        self.ids = np.sort(ids if comm is None else np.concatenate(comm.allgather(ids)))
        self.particles = len(self.ids)
        assert self.particles == workload.particles
        # Row of the workload that each id, in order, stands for.
        self.row = np.arange(self.particles)
        if shuffled:
            self.row = np.random.default_rng(1).permutation(self.particles)
        self.simulation.step()

    def facts(self):
        held, own = bytes_held(self.simulation), self.simulation.rows()
        touched = held - bytes_of_ids(self.simulation)
        ordered_sum = seconds_of_ordered_sum(self.simulation) if self.comm is None and self.device == "cpu" else None
        return {
            "version": pmpm.__version__,
            "held": held / own,
            "touched": touched / own,
            "ordered sum": ordered_sum and 1e9 * ordered_sum / own,
        }

    def rows(self):
        """Row of the workload of each particle of this rank."""
        return self.row[np.searchsorted(self.ids, self.simulation.particles.id)]

    def start(self, fast):
        first, dim = start(self.workload, fast), self.workload.dim
        particles = self.simulation.particles
        particles.x = first.x[self.rows()]
        rows = self.rows()  # assigning x has sorted the particles
        particles.v = first.v[rows]
        particles.C = np.zeros((len(rows), dim, dim))
        if self.workload.name == "W1":
            particles.F = first.F[rows]
        elif self.workload.name == "W2":
            particles.hencky_strain = first.strain[rows][:, *np.triu_indices(dim)]
            particles.v_c = first.v_c[rows]
        else:
            particles.J = np.ones(len(rows))

    def step(self):
        self.simulation.step()

    def phases(self):
        return self.simulation.timers.seconds

    def sorts(self):
        return self.simulation.regroups

    def positions(self):
        own = self.rows(), self.simulation.particles.x
        pieces = [own] if self.comm is None else self.comm.gather(own)
        if pieces is None:
            return None
        x = np.empty((self.particles, self.workload.dim))
        for rows, values in pieces:
            x[rows] = values
        return x


def main():
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("name", help="W1, W2 or W3")
    options.add_argument("cells", type=int)
    options.add_argument("--dim", type=int, default=3)
    options.add_argument("--length", type=int, default=1, help="blocks one after the other")
    options.add_argument("--precision", default="float32")
    options.add_argument("--shape-function", default="quadratic")
    options.add_argument("--own-law", action="store_true", help="W1 with a law given as a Python function")
    options.add_argument("--shuffled", action="store_true", help="particles in random order at the start")
    options.add_argument("--cores", type=int, nargs="+", default=[0], help="one for each rank or thread")
    options.add_argument("--threads", type=int, default=1, help="of one rank that has all the cores")
    options.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    given = options.parse_args()
    comm, cores = None, given.cores
    if len(cores) > given.threads:
        from mpi4py import MPI

        comm = MPI.COMM_WORLD
        cores = [cores[comm.rank]]
    workload = Workload(given.name, given.cells, given.dim, given.length)
    chosen = given.precision, given.shape_function, given.own_law, given.shuffled
    contest.serve(lambda: PmpmSteps(workload, *chosen, comm, given.threads, given.device), cores, comm)


if __name__ == "__main__":
    main()
