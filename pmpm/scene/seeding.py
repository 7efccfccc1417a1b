"""Fill the bodies of a scene with particles: each rank only the layers it owns, the same particles for any rank count."""

import math
from dataclasses import dataclass
from functools import cache, partial
from itertools import product

import numpy as np

from pmpm.scene.colliders import cut_out
from pmpm.scene.shapes import leaves_of
from pmpm.state.fields import SHARE_STEPS

PLACES = 1 << 17  # that are tried at a time
SEEDINGS = ("lattice", "jittered", "poisson_disk", "quadrature")
TRIED = 64  # places of a particle's part of a cell, of which is asked how many lie in the body
TILE_PLACES, CANDIDATES = 1024, 32  # of the pattern that poisson_disk repeats


@dataclass
class Seeds:
    """Particles of one body on one rank: node (n, dim) home nodes, offset (n, dim) from them in cells, id (n,), and share (n,)
    of a whole particle's volume, None where all are whole."""

    node: np.ndarray
    offset: np.ndarray
    id: np.ndarray
    share: np.ndarray | None = None

    def take(self, index):
        share = None if self.share is None else self.share[index]
        return Seeds(self.node[index], self.offset[index], self.id[index], share)

    @property
    def whole(self):
        """How many whole particles these are: exact in any order up to 2^53 steps of shares."""
        return float(len(self.id)) if self.share is None else float(self.share.sum())


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


def fits_lattice(particles_per_cell, dim):
    """Whether a lattice has so many places in a cell."""
    return lattice(particles_per_cell, dim) is not None


def gives_shares(body):
    """Whether particles of a body carry a part of a whole particle's volume each."""
    return body.seeding == "quadrature" or (body.shape.type == "particles" and file_shares(body.shape) is not None)


def file_shares(shape):
    """(n,) of the particles of a file, in whole SHARE_STEPS; None where all have the same volume."""
    given = shape.volume if shape.volume is not None else shape.field("share")
    if given is None or np.ptp(given) == 0.0:
        return None
    steps = np.rint(given.reshape(-1) * (SHARE_STEPS / (1.0 if shape.volume is None else given.max())))
    return np.maximum(steps, 1.0) / SHARE_STEPS


def whole_volume(scene, body):
    """Volume in m3 (2-D: m2) of a particle of a body whose share is 1."""
    if body.shape.type == "particles" and body.shape.volume is not None:
        return float(body.shape.volume.max())
    return scene.domain.cell_size**scene.dim / body.particles_per_cell


def place_counts(scene):
    """[of each body the number of places that particles could have]: ids number them."""
    cells = math.prod(scene.cells)
    return [len(b.shape.x) if b.shape.type == "particles" else cells * b.particles_per_cell for b in scene.bodies]


@cache
def spread_tile(particles_per_cell, dim):
    """(cells, ..., cells, particles_per_cell, dim) places in the cells of a tile that repeats, no two close to each other, as
    many in each cell: of CANDIDATES random ones in the cell each time the one farthest from all before (Mitchell 1991)."""
    side = max(1, int((TILE_PLACES / particles_per_cell) ** (1.0 / dim)))
    cells = np.stack(np.meshgrid(*[np.arange(side)] * dim, indexing="ij"), -1).reshape(-1, dim)
    found = np.zeros((len(cells) * particles_per_cell, dim))
    owner, which = np.zeros((2, len(found)), np.int64)
    count = 0
    for k in range(particles_per_cell):
        for cell in np.argsort(scrambled(np.arange(len(cells), dtype=np.uint64) + np.uint64(977 * (k + 1)))):
            tried = cells[cell] + jittered(cells[cell : cell + 1], CANDIDATES, k + 1)[0]
            far = np.abs(tried[:, None, :] - found[:count])
            far = np.minimum(far, side - far)
            nearest = (far * far).sum(axis=2).min(axis=1, initial=np.inf)
            found[count], owner[count], which[count] = tried[np.argmax(nearest)], cell, k
            count += 1
    tile = np.zeros((len(cells), particles_per_cell, dim))
    tile[owner, which] = found - cells[owner]
    return tile.reshape(*[side] * dim, particles_per_cell, dim)


def places_in_cells(body, number, cells):
    """(n, particles_per_cell, dim) places, in cells, of whole particles of body `number` in each of the cells (n, dim)."""
    count, dim = body.particles_per_cell, cells.shape[1]
    if body.seeding == "jittered":
        return jittered(cells, count, number)
    if body.seeding == "poisson_disk":
        tile = spread_tile(count, dim)
        return tile[tuple((cells % len(tile)).T)]
    regular = lattice(count, dim)
    return np.broadcast_to(regular, (len(cells), *regular.shape))


def spread_places(count, dim):
    """(count, dim) places spread evenly over the unit square or cube, always the same: multiples of powers of the root of
    x^(dim + 1) = x + 1 (M. Roberts 2018, a generalisation of the golden ratio)."""
    root = 1.32471795724474602596 if dim == 2 else 1.22074408460575947536
    return np.modf(np.arange(1, count + 1)[:, None] * root ** -np.arange(1.0, dim + 1.0))[0]


def cut_places(bodies, hole, cells, per_axis, cell_size, number):
    """((n, count, dim) places in cells, (n, count) shares of whole particles) of body `number` in cells (n, dim): each is cut
    into per_axis^dim parts, each a particle. A part of which all corners and the middle lie inside, and to which no surface
    of a mesh comes near, is whole; of others TRIED places are asked: how many lie inside is the share, and the middle of those
    the place. `bodies`: this one, and then those that take away from it.

    What a particle is depends on its cell and the body alone. The places are those of a sequence that fills the part evenly,
    shifted by random numbers of the part, so that of a flat face not all parts are wrong by the same.
    """
    dim, inside = cells.shape[1], partial(lies_in, bodies, hole)
    corners = np.stack(np.meshgrid(*[np.arange(per_axis + 1) / per_axis] * dim, indexing="ij"), -1)
    middles = lattice(per_axis**dim, dim)
    probes = np.concatenate([corners.reshape(-1, dim), middles])
    held = asked(inside, (cells[:, None, :] + probes) * cell_size)
    at_corners = held[:, : -len(middles)].reshape(len(cells), *corners.shape[:-1])
    ends = [
        at_corners[(slice(None), *(slice(end, per_axis + end) for end in corner))]
        for corner in product((0, 1), repeat=dim)
    ]
    known = [held[:, -len(middles) :], *(end.reshape(len(cells), -1) for end in ends)]
    whole, some = np.all(known, axis=0), np.any(known, axis=0)
    places = np.broadcast_to(middles, (len(cells), *middles.shape)).copy()
    share = whole.astype(float)
    cut = some & ~whole
    for _, shape in (leaf for body in bodies for leaf in leaves_of(body.shape)):
        if hasattr(shape, "near"):
            reach = 0.5 * np.sqrt(dim) * cell_size / per_axis
            cut |= asked(partial(shape.near, reach=reach), (cells[:, None, :] + middles) * cell_size)
    cell, part = np.nonzero(cut)
    within, shift = spread_places(TRIED, dim), jittered(cells, len(middles), number)
    step = max(1, PLACES // TRIED)
    for first in range(0, len(cell), step):
        c, p = cell[first : first + step], part[first : first + step]
        tried = middles[p][:, None, :] + (np.modf(within + shift[c, p][:, None, :])[0] - 0.5) / per_axis
        found = asked(inside, (cells[c][:, None, :] + tried) * cell_size)
        count = found.sum(axis=1)
        share[c, p] = count / TRIED
        mean = (tried * found[:, :, None]).sum(axis=1) / np.maximum(count, 1)[:, None]
        places[c, p] = np.where(((count > 0) & (count < TRIED))[:, None], mean, middles[p])
    return places, share


def asked(inside, x):
    """What `inside` says of places (n, k, dim): bool (n, k)."""
    return inside(x.reshape(-1, x.shape[-1])).reshape(x.shape[:-1])


def scrambled(z):
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


def id_offsets(scene):
    """First id of each body: ids number all places a body could fill in the domain, so that they may have gaps."""
    return np.concatenate([[0], np.cumsum(place_counts(scene))]).astype(np.int64)


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
    if body.shape.type == "particles":
        yield from seed_file(geometry, body.shape, around.first_id[number], first_layer, last_layer)
        return
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


def seed_file(geometry, shape, first_id, first_layer, last_layer):
    """Yield (layer, Seeds) of particles out of a file in these layers, one layer after another."""
    cells, share = shape.x / geometry.cell_size, file_shares(shape)
    home = np.floor(cells + geometry.stencil.round)
    for axis in range(geometry.dim):
        if not geometry.periodic[axis]:  # what stands on a wall belongs to the last node inside
            home[:, axis] = np.clip(home[:, axis], 0, geometry.homes(axis) - 1)
    offset, node = cells - home, home.astype(np.int32)
    for axis in range(geometry.dim):
        if geometry.periodic[axis]:
            node[:, axis] %= geometry.cells[axis]
    layer = node[:, geometry.axes[0]]
    here = np.flatnonzero((layer >= first_layer) & (layer < last_layer))
    here = here[np.argsort(layer[here], kind="stable")]
    for one in np.split(here, np.flatnonzero(np.diff(layer[here])) + 1):
        if len(one):
            shares = None if share is None else share[one]
            yield int(layer[one[0]]), Seeds(node[one], offset[one], first_id + one, shares)


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
    bodies = [body, *later_bodies]
    share = None
    if body.seeding == "quadrature":
        per_axis = round(count ** (1 / geometry.dim))
        places, share = cut_places(bodies, hole_of(scene), cells, per_axis, geometry.cell_size, number)
    else:
        places = places_in_cells(body, number, cells)
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
    if share is None:
        x = (cells[:, None, :] + places).reshape(-1, geometry.dim)[here] * geometry.cell_size
        here = here[lies_in(bodies, hole_of(scene), x)]
        return Seeds(node[here].astype(np.int32), offset[here], ids[here])
    here = here[share.reshape(-1)[here] > 0.0]
    return Seeds(node[here].astype(np.int32), offset[here], ids[here], share.reshape(-1)[here])


def hole_of(scene):
    """What says which places x (n, dim) in m colliders cut out of bodies; None where there are none."""
    return partial(cut_out, scene.colliders, scene.domain.periods) if scene.colliders else None


def lies_in(bodies, hole, x):
    """(n,) whether places x (n, dim) in m lie in the first body and in none of the others, nor in the hole (see `hole_of`)."""
    found = bodies[0].shape.contains(x)
    for later in bodies[1:]:
        found &= ~later.shape.contains(x)
    if hole is not None:
        found &= ~hole(x)
    return found


def places_of(scene, ids):
    """(body (n,), cell (n, dim) int64, place in the cell (n, dim)) from which particles came, as their ids tell."""
    offsets = id_offsets(scene)
    body = np.searchsorted(offsets, ids, side="right") - 1
    counts = np.array([b.particles_per_cell for b in scene.bodies], np.int64)[body]
    from_file = np.array([b.shape.type == "particles" for b in scene.bodies])[body]
    cell_number, which = np.divmod(np.where(from_file, 0, ids - offsets[body]), counts)
    cell = np.stack(np.unravel_index(cell_number, scene.cells), axis=-1).astype(np.int64)
    place = np.zeros((len(ids), scene.dim))
    for number in np.unique(body):
        rows = np.flatnonzero(body == number)
        own = scene.bodies[number]
        if own.shape.type == "particles":
            x = own.shape.x[ids[rows] - offsets[number]] / scene.domain.cell_size
            cell[rows] = np.clip(np.floor(x), 0, np.array(scene.cells) - 1)
            place[rows] = x - cell[rows]
            continue
        if own.seeding == "quadrature":
            bodies = [own, *meeting_later_bodies(scene, number, surroundings(scene))]
            per_axis = round(own.particles_per_cell ** (1 / scene.dim))
            cut, back = np.unique(cell[rows], axis=0, return_inverse=True)
            places, _ = cut_places(bodies, hole_of(scene), cut, per_axis, scene.domain.cell_size, number)
            place[rows] = places[back.reshape(-1), which[rows]]
        else:
            place[rows] = places_in_cells(own, number, cell[rows])[np.arange(len(rows)), which[rows]]
    return body, cell, place


def joined(parts, dim):
    if not parts:
        return Seeds(np.zeros((0, dim), np.int32), np.zeros((0, dim)), np.zeros(0, np.int64))
    node, offset, id = (np.concatenate([getattr(part, name) for part in parts]) for name in ("node", "offset", "id"))
    if all(part.share is None for part in parts):
        return Seeds(node, offset, id)
    shares = [np.ones(len(part.id)) if part.share is None else part.share for part in parts]
    return Seeds(node, offset, id, np.concatenate(shares))
