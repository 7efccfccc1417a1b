"""Fields on the nodes of the background grid at the time of a snapshot: what contours, cuts and stream lines are made of.

A node holds the mean over the particles around it, by their mass and the spline of the scene. Sums go through the particles
in the one global order; a rank goes on with the sums of the rank before it: the same bits on any number of ranks.

      left rank: layers .. c-2 c-1 | c c+1 c+2 .. right rank
      told by the left one   c-RL .......... c-1+RH           (planes with what its layers add: its last ones alone do)
"""

from dataclasses import dataclass
from itertools import product

import numpy as np

from pmpm import readout
from pmpm.output.layout import three_columns
from pmpm.scene.needs import FACES, NOT_HELD
from pmpm.state.fields import OUTPUT_VECTORS
from pmpm.state.particles import layer_groups

MASS, DENSITY = "mass", "density"  # of the node, not means over particles
EVERYBODYS = ("velocity", "speed", "J")  # fields that no particle lacks
CHUNK = 1 << 12  # particles whose weights are there at a time


@dataclass(frozen=True)
class Column:
    """Where the sums of a field are: `first` .. `last` - 1 of w m q, and `weight`, of w m of the particles that have it."""

    name: str
    first: int
    last: int
    weight: int


def of_nodes(simulation, names):
    """{name: (planes, ...) this rank's rows} of the named fields on all nodes of the domain, in the precision of the scene.

    Rows are planes across the last axis, in 3-D (z, y, x), in 2-D (y, x), rank after rank; vectors have three components. On a
    periodic axis a node stands there once. Means are nan where there is no particle that has the field. Collective.
    """
    columns = columns_of(simulation, [name for name in names if name not in (MASS, DENSITY)])
    sums = total(simulation, columns)
    return {name: in_file_order(simulation, field(simulation, sums, columns, name)) for name in names}


def columns_of(simulation, names):
    """A Column of each field, behind the first one, of the mass of nodes."""
    found, first = [], 1
    for name, rows in readout.fields_of(simulation, simulation.no_derived(np.float64), names).items():
        last = first + int(np.prod(rows.shape[1:], dtype=np.int64))
        found.append(Column(name, first, last, 0 if name in EVERYBODYS else last))
        first = last + (name not in EVERYBODYS)
    return found


def field(simulation, sums, columns, name):
    """(planes, ..., components) of one field out of the sums of planes."""
    if name == MASS:
        return sums[0].astype(simulation.real)
    if name == DENSITY:
        return (sums[0] / node_volumes(simulation, len(sums[0]))).astype(simulation.real)
    column = next(column for column in columns if column.name == name)
    values = np.moveaxis(sums[column.first : column.last], 0, -1)
    weight = sums[column.weight][..., None]
    with np.errstate(all="ignore"):
        means = np.where(weight > 0.0, values / weight, np.nan).astype(simulation.real)
    if name in OUTPUT_VECTORS:
        return three_columns(means.reshape(-1, simulation.dim)).reshape(*means.shape[:-1], 3)
    return means[..., 0] if means.shape[-1] == 1 else means


# ---- the grid ----


def behind(simulation):
    """The axes other than the slab axis, the last one first: with it they are the axes of the sums."""
    slab = simulation.geometry.axes[0]
    return [axis for axis in reversed(range(simulation.dim)) if axis != slab]


def has_mirror(simulation, axis):
    """Whether there is a wall that holds material at either end of an axis."""
    domain = simulation.scene.domain
    return [
        not simulation.geometry.periodic[axis] and domain.wall(f"{'xyz'[axis]}_{face}").type not in NOT_HELD
        for face in FACES
    ]


def node_volumes(simulation, planes):
    """(planes, ...) m3 of this rank's nodes, in 2-D per metre of thickness: at walls only what lies within the domain."""
    geometry, slab = simulation.geometry, simulation.geometry.axes[0]
    found = np.array(geometry.cell_size**geometry.dim)
    for axis in (slab, *behind(simulation)):
        sides = np.ones(simulation.scene.domain.nodes[axis])
        low, high = has_mirror(simulation, axis)
        sides[0], sides[-1] = (0.5 if low else sides[0]), (0.5 if high else sides[-1])
        found = found[..., None] * (sides[owned(simulation)[0] :][:planes] if axis == slab else sides)
    return found


def numbered(simulation, axis, nodes):
    """Numbers of nodes along an axis: those beyond a wall as their images within, those that repeat as the first; -1 for what
    is beyond an open or free end."""
    cells = simulation.geometry.cells[axis]
    if simulation.geometry.periodic[axis]:
        return nodes % cells
    low, high = has_mirror(simulation, axis)
    nodes = np.where(nodes < 0, -nodes if low else -1, nodes)
    nodes = np.where(nodes > cells, 2 * cells - nodes if high else -1, nodes)
    return np.where((nodes >= 0) & (nodes <= cells), nodes, -1)


def owned(simulation):
    """(first, last + 1) of the planes whose sums this rank has in the end: those that its layers are the last to reach."""
    stencil, slabs, rank = simulation.needs.stencil, simulation.slabs, simulation.comm.rank
    first, last = slabs.owned(rank)
    planes = simulation.scene.domain.nodes[simulation.geometry.axes[0]]
    if rank >= slabs.active:
        return planes, planes
    begin = first - stencil.reach_low if rank > 0 else 0
    return begin, last - stencil.reach_low if rank < slabs.active - 1 else planes


# ---- sums ----


def total(simulation, columns):
    """(columns, planes, ...) float64 sums over all particles, on the planes that this rank has. Collective."""
    stencil, slabs, comm = simulation.needs.stencil, simulation.slabs, simulation.comm
    first, last = slabs.owned(comm.rank)
    shared = stencil.reach_low + stencil.reach_high
    sums = Sums(simulation, columns, first, last)
    sends, receives = [], []
    if 0 <= comm.rank < slabs.active - 1:  # at once: nobody waits for all of another's sums
        tail = Sums(simulation, columns, last - shared, last)
        tail.add(last - shared, last)
        sends.append((comm.rank + 1, 0, np.ascontiguousarray(tail.planes[:, -shared:])))
    if 0 < comm.rank < slabs.active:
        head = np.empty((len(sums.planes), shared, *sums.planes.shape[2:]))
        receives.append((comm.rank - 1, 0, head))
    comm.deliver(*map(as_bytes, (sends, receives)))
    for _, _, told in receives:
        sums.planes[:, :shared] = told
    sums.add(first, last)
    if slabs.periodic:
        join_ends(simulation, sums.planes)
    begin, end = owned(simulation)
    low = first - stencil.reach_low
    return sums.planes[:, max(begin - low, 0) : max(end - low, 0)]


def join_ends(simulation, planes):
    """Add what lies beyond either end of a periodic slab axis at the other end. Collective."""
    stencil, slabs, comm = simulation.needs.stencil, simulation.slabs, simulation.comm
    below, above = stencil.reach_low, stencil.reach_high
    first, last = comm.rank == 0, comm.rank == slabs.active - 1
    sends, receives = [], []
    if first:
        sends.append((slabs.active - 1, 1, np.ascontiguousarray(planes[:, :below])))
        receives.append((slabs.active - 1, 2, np.empty((len(planes), above, *planes.shape[2:]))))
    if last:
        sends.append((0, 2, np.ascontiguousarray(planes[:, -above:])))
        receives.append((0, 1, np.empty((len(planes), below, *planes.shape[2:]))))
    comm.deliver(*map(as_bytes, (sends, receives)))
    for _, tag, told in receives:
        if tag == 2:
            planes[:, below : below + above] += told
        else:
            planes[:, -above - below : -above] += told


def as_bytes(messages):
    return [(peer, tag, array.reshape(-1).view(np.uint8)) for peer, tag, array in messages]


class Sums:
    """Sums over particles of some layers of this rank, on all planes that these reach: `planes` (columns, planes, ...)."""

    def __init__(self, simulation, columns, first, last):
        self.simulation, self.columns = simulation, columns
        stencil, counts = simulation.needs.stencil, simulation.scene.domain.nodes
        self.low = first - stencil.reach_low
        shape = last - first + stencil.reach_low + stencil.reach_high, *(counts[axis] for axis in behind(simulation))
        self.size = int(np.prod(shape))
        # One more number behind the nodes, for what weighs nothing or lies beyond an open end.
        self.flat = np.zeros((max([1, *(max(c.last, c.weight + 1) for c in columns)]), self.size + 1))
        self.planes = self.flat[:, : self.size].reshape(-1, *shape)

    def add(self, first, last):
        """Add the particles of layers first .. last - 1, one after another in the one global order."""
        if first >= last:
            return
        simulation = self.simulation
        populations = [population.part(first, last) for population in simulation.populations]
        for layers in layer_groups(sum(population.layer_counts for population in populations), first):
            derived = [
                simulation.derived_of(law, np.float64, population.part(*layers))
                for law, population in enumerate(populations)
            ]
            self.add_group(derived)

    def add_group(self, derived):
        simulation = self.simulation
        order = readout.order_of([of_law.population for of_law in derived])
        cells = [of_law.population.cells(simulation.geometry.axes) for of_law in derived]
        node, part = (np.concatenate(arrays)[order] for arrays in zip(*cells, strict=True))
        mass = np.concatenate([of_law.mass() for of_law in derived])[order]
        values = readout.fields_of(simulation, derived, [column.name for column in self.columns])
        for begin in range(0, len(mass), CHUNK):
            rows = slice(begin, begin + CHUNK)
            self.add_particles(node[rows], part[rows], mass[rows], {name: v[rows] for name, v in values.items()})

    def add_particles(self, node, part, mass, values):
        index, weights = self.weights(node, part)
        weights *= mass[:, None]
        index = np.where(weights > 0.0, index, self.size).ravel()
        self.put(0, index, weights)
        for column in self.columns:
            value = values[column.name].reshape(len(mass), -1).astype(np.float64)
            lacking = np.isnan(value).all(axis=1)
            value[lacking] = 0.0
            for number in range(column.first, column.last):
                self.put(number, index, weights * value[:, number - column.first, None])
            if column.weight:
                self.put(column.weight, index, weights * ~lacking[:, None])

    def put(self, number, index, values):
        np.add.at(self.flat[number], index, values.ravel())

    def weights(self, node, part):
        """(index (n, nodes), weights (n, nodes)) of what particles reach, by the node below (n, dim) and the part of a cell."""
        geometry, axes = self.simulation.geometry, [self.simulation.geometry.axes[0], *behind(self.simulation)]
        stencil, counts = geometry.stencil, self.simulation.scene.domain.nodes
        along = []
        for axis in axes:
            centre = node[:, axis] + (part[:, axis] >= 1.0 - stencil.round)
            weights = stencil.weights(part[:, axis] - (centre - node[:, axis]))
            numbers = [self.number(axis, centre - stencil.low + k) for k in range(stencil.nodes)]
            along.append(list(zip(numbers, weights, strict=True)))
        index, found = [], []
        for corner in product(*along):
            place, weight = corner[0]
            beyond = place < 0
            for (number, factor), axis in zip(corner[1:], axes[1:], strict=True):
                place, weight, beyond = place * counts[axis] + number, weight * factor, beyond | (number < 0)
            index.append(np.where(beyond, self.size, place))
            found.append(weight)
        return np.stack(index, axis=1), np.stack(found, axis=1)

    def number(self, axis, nodes):
        """Numbers of nodes along an axis of `planes`, -1 for what is beyond an open end."""
        geometry = self.simulation.geometry
        if axis != geometry.axes[0]:
            return numbered(self.simulation, axis, nodes)
        if not geometry.periodic[axis]:
            nodes = numbered(self.simulation, axis, nodes)
            return np.where(nodes >= 0, nodes - self.low, -1)
        return nodes - self.low


# ---- the order of files ----


def in_file_order(simulation, rows):
    """This rank's planes across the last axis out of the ranks' planes across the slab axis. Collective."""
    comm, dim, slab = simulation.comm, simulation.dim, simulation.geometry.axes[0]
    if slab == dim - 1:
        return np.ascontiguousarray(rows)
    place = dim - 1 - slab  # of the slab axis in files
    mine = np.moveaxis(rows, 0, place)
    if comm.size == 1:
        return np.ascontiguousarray(mine)
    counts, planes = comm.gather(len(rows)), len(mine)
    edges = [planes * rank // comm.size for rank in range(comm.size + 1)]
    own = edges[comm.rank], edges[comm.rank + 1]
    sends = [
        (rank, 3, np.ascontiguousarray(mine[edges[rank] : edges[rank + 1]]))
        for rank in range(comm.size)
        if len(rows) and edges[rank] < edges[rank + 1]
    ]
    pieces = []
    for count in counts:
        shape = [own[1] - own[0], *mine.shape[1:]]
        shape[place] = count
        pieces.append(np.empty(shape, rows.dtype))
    receives = [(rank, 3, piece) for rank, piece in enumerate(pieces) if piece.size]
    comm.deliver(as_bytes(sends), as_bytes(receives))
    return np.concatenate(pieces, axis=place)
