"""A user's view of the particles: arrays in metres and SI units, read as copies, written back by assigning."""

import math

import numpy as np

from pmpm import readout


class Particles:
    """This rank's particles as arrays: reading gives a copy, assigning writes back. Rows may change order at any step."""

    def __init__(self, simulation):
        object.__setattr__(self, "simulation", simulation)

    def __getattr__(self, name):
        simulation = self.simulation
        if name == "volume":
            return self.volume0 * self.J
        if name not in simulation_fields(simulation):
            raise AttributeError(f"particles have no {name!r}; known: {', '.join(simulation_fields(simulation))}")
        values = simulation.fields([name])[name]
        if name in ("F", "C"):
            return values.reshape(-1, simulation.dim, simulation.dim)
        return values

    def __setattr__(self, name, values):
        """Write (n, ...) values back. Collective: every rank assigns rows of its own; `x` regroups all particles."""
        simulation = self.simulation
        if not writable(simulation, name):
            raise AttributeError(f"particles.{name} cannot be assigned")
        values, rows = np.asarray(values), simulation.rows()
        values = values.reshape(rows, values.size // rows if rows else math.prod(values.shape[1:]))
        if name == "x":
            self.check_inside(values)
        in_order = np.empty_like(values)
        in_order[readout.order(simulation)] = values
        first, moved = 0, []
        for population, layout in zip(simulation.populations, simulation.layouts, strict=True):
            rows = in_order[first : first + len(population)]
            first += len(population)
            if name == "x":
                moved.append(self.moved_to(population, rows))
            elif layout.where(name) is not None:
                population.set_rows(layout.where(name), rows)
        simulation.changed_by_hand(moved if name == "x" else None)

    def moved_to(self, population, x):
        """A population as a Cloud at positions x (n, dim) in m."""
        return population.at(*nodes_and_places(self.simulation, x))

    def check_inside(self, x):
        """Raise ValueError, on all ranks, if any rank's positions (n, dim) in m are not numbers or further beyond a wall than a
        run lets them come: half a cell, nothing at a free one."""
        comm, geometry, limits = self.simulation.comm, self.simulation.geometry, self.simulation.limits
        inside, place = np.isfinite(x), 64.0 * x / geometry.cell_size
        for axis in range(geometry.dim):
            if not geometry.periodic[axis]:
                inside[:, axis] &= (place[:, axis] >= limits[axis, 0]) & (place[:, axis] <= limits[axis, 1])
        outside = int(comm.sum(np.array([np.count_nonzero(~inside.all(axis=1))]))[0])
        if outside:
            raise ValueError(f"particles.x: {outside} of the new positions are not inside the domain")


def nodes_and_places(simulation, x):
    """(home node (n, dim) int32, place from there (n, dim)) of particles at x (n, dim) m."""
    geometry = simulation.geometry
    cells = x / geometry.cell_size
    node = np.floor(cells + geometry.stencil.round)
    # What stands on a wall, or has passed it a little, belongs to the last node inside.
    for axis in range(geometry.dim):
        if not geometry.periodic[axis]:
            node[:, axis] = np.clip(node[:, axis], 0, geometry.homes(axis) - 1)
    place = simulation.needs.places.from_cells(cells - node)
    for axis in range(geometry.dim):
        if geometry.periodic[axis]:
            node[:, axis] %= geometry.cells[axis]
    return node.astype(np.int32), place


def writable(simulation, name):
    """Whether a derived quantity is a stored state variable of some law here."""
    return any(layout.where(name) is not None for layout in simulation.layouts)


def simulation_fields(simulation):
    """Names that `particles` answers to."""
    stored = [f.name for layout in simulation.layouts for f in layout.fields]
    return list(dict.fromkeys([*stored, "J", "mass", "volume0", "material", "id", "density", "stress"]))
