"""Maps over the plane across gravity, kept while a run goes on: largest depth and speed in each column of cells, deposit.

They are looked at whenever some particle may have moved by a cell, so that what passes a column is seen in it, and, being
largest values and sums of whole numbers, are the same bits on any number of ranks and over restarts.
"""

import math

import numpy as np

from pmpm.output.checkpoints import CheckpointFile
from pmpm.output.files import on_every_rank, on_rank_zero, unfinished_name
from pmpm.sampling import UNIT, filled
from pmpm.scene.watched import upright

TRAVEL = 1.0  # cells, at most, that a particle moves between two looks
GROUP = "restart/maps"  # in a checkpoint


class Maps:
    """Observer of each step that keeps the maps of a simulation.

    most (columns,) int64: the largest depth so far in UNITs of a cell; fastest (columns,) float64 m/s, of this rank's particles
    only; travel: how far particles had moved at the last look, in cells, see timestep.StepControl. `held`: a checkpoint that
    was written with maps, see `datasets`.
    """

    def __init__(self, simulation, wanted, held=None):
        geometry = simulation.geometry
        self.wanted = wanted
        self.up = upright(simulation.scene.domain.gravity)
        self.plan = [axis for axis in range(geometry.dim) if axis != self.up]
        self.shape = tuple(geometry.cells[axis] for axis in self.plan)
        columns = math.prod(self.shape)
        self.most, self.fastest = np.zeros(columns, np.int64), np.zeros(columns)
        self.travel = -math.inf
        if held is not None and held.names(GROUP):
            self.most = held.rows(f"{GROUP}/most", 0, columns, (), np.int64)
            self.fastest = held.rows(f"{GROUP}/fastest", 0, columns, (), np.float64)
            self.travel = float(held.rows(f"{GROUP}/travel", 0, 1, (), np.float64)[0])

    def __call__(self, simulation):
        """Look at the columns if it is time to. Collective."""
        if simulation.control.travel - self.travel >= TRAVEL:
            depth, speed = self.look(simulation, "max_depth" in self.wanted, "max_speed" in self.wanted)
            np.maximum(self.most, depth, out=self.most)
            np.maximum(self.fastest, speed, out=self.fastest)
            self.travel = simulation.control.travel

    def look(self, simulation, at_depth, at_speed):
        """(depth in UNITs, of all ranks; speed in m/s, of this rank) of each column now; zero for what is not looked at."""
        depth, speed = np.zeros_like(self.most), np.zeros_like(self.fastest)
        for group in simulation.derived_groups(np.float64) if at_depth or at_speed else ():
            for derived in group:
                node, part = derived.population.cells(simulation.geometry.axes)
                if at_depth:
                    volume = UNIT * filled(derived) / simulation.geometry.cell_size**simulation.dim
                    for column, weight in self.shares(simulation, node, part):
                        share = np.rint(volume * weight)
                        depth += np.bincount(column, weights=share, minlength=len(depth)).astype(np.int64)
                if at_speed:
                    column = self.number([self.cell(simulation, axis, node[:, axis]) for axis in self.plan])
                    np.fmax.at(speed, column, derived.speed())
        return (simulation.comm.sum(depth) if at_depth else depth), speed

    def shares(self, simulation, node, part):
        """Yield (columns, weights) of the particles: each is as wide as a cell, and shared by the columns that it overlaps."""
        sides = []
        for axis in self.plan:
            over = part[:, axis] >= 0.5
            low = node[:, axis] - 1 + over
            weight = part[:, axis] + 0.5 - over
            ends = ((low, 1.0 - weight), (low + 1, weight))
            sides.append([(self.cell(simulation, axis, cell), share) for cell, share in ends])
        if len(sides) == 1:
            yield from sides[0]
            return
        for first, one in sides[0]:
            for second, other in sides[1]:
                yield self.number([first, second]), one * other

    def cell(self, simulation, axis, cell):
        """Cells within the domain: beyond a wall the last one, beyond the end of a periodic axis the first."""
        cells = simulation.geometry.cells[axis]
        return cell % cells if simulation.geometry.periodic[axis] else np.clip(cell, 0, cells - 1)

    def number(self, cells):
        return cells[0] if len(cells) == 1 else cells[0] * self.shape[1] + cells[1]

    def datasets(self, simulation):
        """What it takes to go on, as datasets of a checkpoint: all of it from rank 0. Collective."""
        fastest = simulation.comm.max(self.fastest)
        kept = {"most": self.most, "fastest": fastest, "travel": np.array([self.travel])}
        return {f"{GROUP}/{name}": v.copy() if simulation.comm.rank == 0 else v[:0] for name, v in kept.items()}

    def arrays(self, simulation):
        """{name: array} of the maps, the state of now among them, and where their columns are. Collective."""
        deposit, speed = self.look(simulation, {"max_depth", "deposit"} & set(self.wanted), "max_speed" in self.wanted)
        cell_size = simulation.geometry.cell_size
        found = {
            "max_depth": np.maximum(self.most, deposit) / UNIT * cell_size,
            "max_speed": simulation.comm.max(np.maximum(self.fastest, speed)),
            "deposit": deposit / UNIT * cell_size,
        }
        told = {"".join("xyz"[axis]): (np.arange(count) + 0.5) * cell_size
                for axis, count in zip(self.plan, self.shape, strict=True)}  # fmt: skip
        told |= {name: found[name].reshape(self.shape) for name in self.wanted}
        return told | {"time": np.float64(simulation.time), "step": np.int64(simulation.step_count)}


def continued(simulation, wanted, path):
    """The Maps of a simulation that goes on from the checkpoint at `path`, or begins (None). OutputError for a damaged one."""
    return (
        Maps(simulation, wanted)
        if path is None
        else on_every_rank(simulation.comm, lambda: from_file(simulation, wanted, CheckpointFile(path)))
    )


def from_file(simulation, wanted, file):
    try:
        return Maps(simulation, wanted, file)
    finally:
        file.close()


def write(path, comm, arrays):
    """Write maps as a .npz file, whole or not at all. Collective; OutputError on all ranks."""

    def put():
        with open(unfinished_name(path), "wb") as file:
            np.savez(file, **arrays)
        unfinished_name(path).replace(path)

    on_rank_zero(comm, put)
