"""What is kept of a run to compare it with other levels: a few fields averaged over the cells of the coarsest level.

Particles differ between levels, so averages are compared, at common times. Times between two steps are interpolated linearly
between them: of the second order in the step, as the scheme is at best.

displacement  of the particles that started in a cell of the coarsest grid, averaged over their reference volumes: of a body and
              a cell the same material at all levels, but for a part of a particle at surfaces that cut through cells
mass          on the nodes of the coarsest grid, by quadratic splines: where the material is, whichever it is
extent        quantiles of mass along each axis, where the material begins and ends
center        of mass
kinetic       energy
"""

import math

import numpy as np

from pmpm.physics.bspline import weights_quadratic
from pmpm.scene.seeding import places_of

TIMES = 10  # after the start at which levels are compared
BINS = 64  # per cell, of the histograms that quantiles of mass come from
QUANTILES = (0.005, 0.995)
EARLY = 1.5  # steps before a common time from which on a state may be the last one before it
QUANTITIES = ("displacement", "mass", "extent", "center", "kinetic")


class Sampler:
    """Observer, called after every step and at the start, that keeps what is compared. Collective."""

    def __init__(self, simulation, coarse):
        """`coarse`: the scene of level 0."""
        self.coarse, self.dim = coarse, coarse.dim
        self.periodic = np.array([axis in coarse.domain.periodic for axis in "xyz"[: self.dim]])
        self.finer = simulation.scene.cells[0] // coarse.cells[0]
        self.times = np.linspace(0.0, simulation.scene.time.end, TIMES + 1)
        found = simulation.comm.gather(np.unique(self.blocks(simulation.scene, self.rows(simulation)["id"])[0]))
        self.keys = np.unique(np.concatenate(found))
        self.kept, self.before = [], None

    def __call__(self, simulation):
        time, due = simulation.time, len(self.kept)
        if due > TIMES or time + EARLY * simulation.dt < self.times[due]:
            return
        now = (time, self.sample(simulation))
        while len(self.kept) <= TIMES and self.times[len(self.kept)] <= time:
            self.kept.append(self.between(self.before, now, self.times[len(self.kept)]))
        self.before = now

    def result(self):
        """{name: array} of all times; what does not change with time comes once."""
        fields = {name: np.stack([sample[name] for sample in self.kept]) for name in self.kept[0]}
        return fields | {"keys": self.keys, "volume": fields["volume"][0], "times": self.times[: len(self.kept)]}

    def between(self, before, after, time):
        """A sample at a time between two (time, sample)."""
        if before is None or before[0] >= after[0]:
            return after[1]
        part = (time - before[0]) / (after[0] - before[0])
        found = {name: (1.0 - part) * before[1][name] + part * after[1][name] for name in after[1]}
        moved = self.nearest(after[1]["displacement"] - before[1]["displacement"])
        return found | {"displacement": before[1]["displacement"] + part * moved}

    def rows(self, simulation):
        """This rank's particles: id, x, velocity (n, dim), mass and volume0, in double precision."""
        names = ("id", "x", "velocity", "mass", "volume0")
        rows = simulation.fields(names)
        return {name: rows[name] if name == "id" else rows[name].astype(np.float64) for name in names}

    def blocks(self, scene, ids):
        """(keys (n,) int64 of body and coarse cell in which particles started, X (n, dim) m)."""
        body, cell, place = places_of(scene, ids)
        keys = np.ravel_multi_index(tuple((cell // self.finer).T), self.coarse.cells)
        return body * math.prod(self.coarse.cells) + keys, (cell + place) * scene.domain.cell_size

    def sample(self, simulation):
        rows, add = self.rows(simulation), simulation.comm.sum
        keys, X = self.blocks(simulation.scene, rows["id"])
        block = np.searchsorted(self.keys, keys)
        volume = add(np.bincount(block, rows["volume0"], len(self.keys)))
        moved = self.nearest(rows["x"] - X)
        if self.periodic.any():  # a block may lie on both sides of the farthest image
            around = self.around(block, rows["volume0"], moved, add)
            moved = around[block] + self.nearest(moved - around[block])
        sums = add(self.per_block(block, rows["volume0"][:, None] * moved))
        total = add(np.append(rows["mass"] @ rows["x"], rows["mass"].sum()))
        energy = 0.5 * rows["mass"] @ (rows["velocity"] * rows["velocity"]).sum(axis=1)
        return {
            "volume": volume,
            "displacement": sums / volume[:, None],
            "mass": add(self.nodal_mass(rows)),
            "extent": self.extent(rows, add),
            "center": np.where(self.periodic, 0.0, total[:-1] / total[-1]),
            "kinetic": add(np.array([energy])),
        }

    def per_block(self, block, values):
        """(blocks, k) sums of this rank's (n, k) values."""
        return np.stack([np.bincount(block, column, len(self.keys)) for column in values.T], axis=-1)

    def nearest(self, difference):
        """Differences of positions (n, dim) to the nearest image."""
        size = np.array(self.coarse.domain.size)
        return difference - np.where(self.periodic, size * np.rint(difference / size), 0.0)

    def around(self, block, volume, moved, add):
        """(blocks, dim) displacements near those of all particles of a block, by the mean of angles on periodic axes."""
        size = np.array(self.coarse.domain.size)
        angle = 2.0 * np.pi * moved / size
        cosine, sine = (add(self.per_block(block, volume[:, None] * f(angle))) for f in (np.cos, np.sin))
        return np.where(self.periodic, np.arctan2(sine, cosine) * size / (2.0 * np.pi), 0.0)

    def nodal_mass(self, rows):
        """Mass on the nodes of the coarsest grid, flat; one node more beyond each end of axes that do not repeat."""
        cells = np.array(self.coarse.cells)
        g = rows["x"] / self.coarse.domain.cell_size
        node = np.rint(g)
        weights = weights_quadratic(g - node)
        shape = np.where(self.periodic, cells, cells + 3)
        found = np.zeros(math.prod(shape))
        for steps in np.ndindex(*(3,) * self.dim):
            place = node.astype(np.int64) + np.array(steps) - 1
            place = np.where(self.periodic, place % cells, np.clip(place + 1, 0, cells + 2))
            weight = math.prod(weights[step][:, axis] for axis, step in enumerate(steps))
            found += np.bincount(np.ravel_multi_index(tuple(place.T), shape), rows["mass"] * weight, len(found))
        return found

    def extent(self, rows, add):
        """(dim, quantiles) m where so much of the mass has been met along an axis; 0 along one that repeats."""
        found = np.zeros((self.dim, len(QUANTILES)))
        for axis in np.flatnonzero(~self.periodic):
            width = self.coarse.domain.cell_size / BINS
            bins = self.coarse.cells[axis] * BINS
            place = np.clip((rows["x"][:, axis] / width).astype(np.int64), 0, bins - 1)
            share = np.concatenate([[0.0], np.cumsum(add(np.bincount(place, rows["mass"], bins)))])
            found[axis] = np.interp(QUANTILES, share / share[-1], width * np.arange(bins + 1))
        return found


def differences(coarse, fine, periodic_size):
    """{quantity: (times,) relative difference} between the results of two samplers; `periodic_size` (dim,) m, 0 of other axes.

    Root mean square displacements relative to the largest of the finer run, the share of the mass that lies elsewhere, extent
    and center relative to the widest extent at the start, kinetic energy relative to the largest.
    """
    _, a, b = np.intersect1d(coarse["keys"], fine["keys"], return_indices=True)
    weight = fine["volume"][b] / fine["volume"][b].sum()
    apart = coarse["displacement"][:, a] - fine["displacement"][:, b]
    length = np.where(periodic_size > 0.0, periodic_size, 1.0)
    apart -= np.where(periodic_size > 0.0, length * np.rint(apart / length), 0.0)
    moved = np.sqrt(((fine["displacement"][:, b] ** 2).sum(axis=2) @ weight).max())
    width = np.ptp(fine["extent"][0], axis=1).max()
    return {
        "displacement": relative(np.sqrt((apart**2).sum(axis=2) @ weight), moved),
        "mass": 0.5 * np.abs(coarse["mass"] - fine["mass"]).sum(axis=1) / fine["mass"][0].sum(),
        "extent": relative(np.abs(coarse["extent"] - fine["extent"]).max(axis=(1, 2)), width),
        "center": relative(np.sqrt(((coarse["center"] - fine["center"]) ** 2).sum(axis=1)), width),
        "kinetic": relative(np.abs(coarse["kinetic"] - fine["kinetic"])[:, 0], fine["kinetic"].max()),
    }


def relative(values, scale):
    """Values over a scale that may be zero: nothing over nothing is no difference."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(values == 0.0, 0.0, values / scale)
