"""Fill the bodies of a scene with particles: each rank only the layers it owns, the same particles for any rank count."""

from dataclasses import dataclass

import numpy as np

from pmpm.scene.colliders import cut_out

PLACES = 1 << 17  # that are tried at a time


@dataclass
class Seeds:
    """Particles of one body on one rank: node (n, dim) home nodes, offset (n, dim) from them in cells, id (n,)."""

    node: np.ndarray
    offset: np.ndarray
    id: np.ndarray

    def take(self, index):
        return Seeds(self.node[index], self.offset[index], self.id[index])


@dataclass(frozen=True)
class Surroundings:
    """Boxes of cells around all bodies, (bodies, dim) their first cells and last ones + 1, and the first id of each body."""

    first: np.ndarray
    last: np.ndarray
    first_id: np.ndarray


def lattice(particles_per_cell, dim):
    """(particles_per_cell, dim) places within a cell, in cells; None if the number is no perfect square or cube."""
    per_axis = round(particles_per_cell ** (1 / dim))
    if per_axis**dim != particles_per_cell:
        return None
    places = (np.arange(per_axis) + 0.5) / per_axis
    return np.stack(np.meshgrid(*[places] * dim, indexing="ij"), -1).reshape(-1, dim)


def lattice_range(corners, spacing, shift):
    """(n, dim) int64 numbers of the places (number + 1/2) spacing + shift between two corners (dim,) m, and a few more."""
    low, high = corners
    first = np.floor((low - shift) / spacing).astype(np.int64) - 1
    last = np.ceil((high - shift) / spacing).astype(np.int64) + 1
    ranges = [np.arange(a, b) for a, b in zip(first, last, strict=True)]
    return np.stack(np.meshgrid(*ranges, indexing="ij"), -1).reshape(-1, len(first))


def jittered(cells, particles_per_cell, body):
    """(cells, particles_per_cell, dim) random places within each cell, from a generator keyed on body and cell alone.

    cells: (n, dim) integers. One random number per place: the splitmix64 finaliser of a counter (Steele et al. 2014).
    """
    key = np.full(len(cells), body + 1, np.uint64)
    with np.errstate(over="ignore"):
        for axis in range(cells.shape[1]):
            key = scrambled(key * np.uint64(0x9E3779B97F4A7C15) + cells[:, axis].astype(np.uint64))
        counter = np.arange(particles_per_cell * cells.shape[1], dtype=np.uint64)
        bits = scrambled(key[:, None] + counter * np.uint64(0x9E3779B97F4A7C15))
    return ((bits >> np.uint64(11)) * 2.0**-53).reshape(len(cells), particles_per_cell, cells.shape[1])


def scrambled(z):
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


def id_offsets(scene):
    """First id of each body: ids number all places a body could fill in the domain, so that they may have gaps."""
    cells = int(np.prod([np.int64(n) for n in scene.cells]))
    return np.concatenate([[0], np.cumsum([cells * body.particles_per_cell for body in scene.bodies])]).astype(np.int64)


def seed(scene, geometry, number, groups, around):
    """Yield the Seeds of body `number` in one group of layers after another: `groups`, (first, last + 1) layers of each, the
    next one beginning where the last one ends. Where bodies overlap the later one wins. `around`: as for `seed_planes`."""
    first_layer, last_layer, slab = groups[0][0], groups[-1][1], geometry.axes[0]
    planes = seed_planes(scene, geometry, number, first_layer, last_layer, around)
    end = last_layer, joined([], geometry.dim)
    plane, seeds = next(planes, end)
    waiting: list[Seeds] = []
    for _, last in groups:
        while plane < last:  # a plane gives its own layer and the next
            waiting.append(seeds)
            plane, seeds = next(planes, end)
        found = joined(waiting, geometry.dim)
        here = found.node[:, slab] < last
        waiting = [found.take(~here)]
        yield found.take(here)


def add_counts(counts, layer):
    """Add how often each layer occurs, without a look at all the others: there may be millions."""
    if len(layer):
        first = layer.min()
        found = np.bincount(layer - first)
        counts[first : first + len(found)] += found


def seed_planes(scene, geometry, number, first_layer, last_layer, around):
    """Yield (plane, Seeds) of body `number` in these layers: one plane of cells after another, in pieces that fit into a core's
    cache. A plane gives particles to its own layer and the next; of a periodic axis, what the last plane gives to layer 0
    comes with plane 0.

    `around`: the Surroundings of all bodies.
    """
    slab, body = geometry.axes[0], scene.bodies[number]
    first_id, later = around.first_id[number], meeting_later_bodies(scene, number, around)
    first_cell, last_cell = around.first[number], around.last[number]
    widths = np.maximum(last_cell - first_cell, 0)
    widths[slab] = 1
    in_plane, piece = int(np.prod(widths)), max(1, PLACES // body.particles_per_cell)
    # Layers centred on nodes hold halves of two cells, layer 0 of a periodic axis also one of the last cell.
    planes = range(max(first_cell[slab], first_layer - 1), min(last_cell[slab], last_layer + 1))
    end = geometry.cells[slab] - 1
    holds_seam = geometry.periodic[slab] and first_layer == 0 < last_layer
    wraps = holds_seam and end > 0 and first_cell[slab] <= end < last_cell[slab]
    found = [(plane, plane, first_layer, last_layer) for plane in planes if plane <= 0]
    found += [(0, end, 0, 1)] if wraps else []
    found += [
        (plane, plane, max(first_layer, 1) if wraps and plane == end else first_layer, last_layer)
        for plane in planes
        if plane > 0
    ]
    for told, plane, lowest, highest in found:
        corner = np.where(np.arange(geometry.dim) == slab, plane, first_cell)
        for first in range(0, in_plane, piece):
            within = np.unravel_index(np.arange(first, min(first + piece, in_plane)), widths)
            cells = corner + np.stack(within, -1)
            yield told, seed_cells(scene, geometry, number, cells, first_id, lowest, highest, later)


def surrounding_cells(scene, body):
    """((dim,) first cell, (dim,) last cell + 1) of the box of cells around a body, one cell wider for round-off."""
    with np.errstate(over="ignore"):
        low, high = (np.asarray(corner) / scene.domain.cell_size for corner in body.shape.bounds())
    cells = np.array(scene.cells)
    # Cut before the numbers become integers, for they may be as large as they like.
    first = np.clip(np.floor(low) - 1.0, 0.0, cells).astype(np.int64)
    return first, np.clip(np.ceil(high) + 1.0, 0.0, cells).astype(np.int64)


def surroundings(scene):
    """The Surroundings of all bodies: found once, for there may be thousands of them."""
    found = np.array([surrounding_cells(scene, body) for body in scene.bodies], np.int64).reshape(-1, 2, scene.dim)
    return Surroundings(found[:, 0], found[:, 1], id_offsets(scene))


def meeting_later_bodies(scene, number, around):
    """The bodies after body `number` whose surroundings meet its own: where they lie it has no particles."""
    later = slice(number + 1, None)
    meet = ((around.first[number] < around.last[later]) & (around.first[later] < around.last[number])).all(axis=1)
    return [scene.bodies[number + 1 + place] for place in np.flatnonzero(meet)]


def seed_cells(scene, geometry, number, cells, first_id, first_layer, last_layer, later_bodies):
    """Seeds of body `number` in these cells, as far as they lie in the layers and in none of the later bodies."""
    body, count = scene.bodies[number], scene.bodies[number].particles_per_cell
    places = lattice(count, geometry.dim)
    places = jittered(cells, count, number) if places is None else np.broadcast_to(places, (len(cells), *places.shape))
    cell_number = np.ravel_multi_index(tuple(cells.T), geometry.cells).astype(np.int64)
    ids = (first_id + cell_number[:, None] * count + np.arange(count)).reshape(-1)
    step = np.floor(places + geometry.stencil.round)
    node = (cells[:, None, :] + step.astype(np.int64)).reshape(-1, geometry.dim)
    offset = (places - step).reshape(-1, geometry.dim)
    for axis in range(geometry.dim):
        if geometry.periodic[axis]:
            node[:, axis] %= geometry.cells[axis]
    layer = node[:, geometry.axes[0]]
    here = np.flatnonzero((layer >= first_layer) & (layer < last_layer))
    x = ((cells[:, None, :] + places).reshape(-1, geometry.dim)[here]) * geometry.cell_size
    inside = body.shape.contains(x)
    for later in later_bodies:
        inside &= ~later.shape.contains(x)
    if scene.colliders:
        inside &= ~cut_out(scene.colliders, x)
    here = here[inside]
    return Seeds(node[here].astype(np.int32), offset[here], ids[here])


def places_of(scene, ids):
    """(body (n,), cell (n, dim) int64, place in the cell (n, dim)) from which particles came, as their ids tell."""
    offsets = id_offsets(scene)
    body = np.searchsorted(offsets, ids, side="right") - 1
    counts = np.array([b.particles_per_cell for b in scene.bodies], np.int64)[body]
    cell_number, which = np.divmod(ids - offsets[body], counts)
    cell = np.stack(np.unravel_index(cell_number, scene.cells), axis=-1).astype(np.int64)
    place = np.zeros((len(ids), scene.dim))
    for number in np.unique(body):
        rows, count = np.flatnonzero(body == number), scene.bodies[number].particles_per_cell
        regular = lattice(count, scene.dim)
        if regular is None:
            place[rows] = jittered(cell[rows], count, number)[np.arange(len(rows)), which[rows]]
        else:
            place[rows] = regular[which[rows]]
    return body, cell, place


def joined(parts, dim):
    if not parts:
        return Seeds(np.zeros((0, dim), np.int32), np.zeros((0, dim)), np.zeros(0, np.int64))
    return Seeds(*(np.concatenate([getattr(part, name) for part in parts]) for name in ("node", "offset", "id")))
