"""Fill the bodies of a scene with particles: each rank only the layers it owns, the same particles for any rank count."""

from dataclasses import dataclass

import numpy as np


@dataclass
class Seeds:
    """Particles of one body on one rank: node (n, dim) home nodes, offset (n, dim) from them in cells, id (n,)."""

    node: np.ndarray
    offset: np.ndarray
    id: np.ndarray

    def take(self, index):
        return Seeds(self.node[index], self.offset[index], self.id[index])


def lattice(particles_per_cell, dim):
    """(particles_per_cell, dim) places within a cell, in cells; None if the number is no perfect square or cube."""
    per_axis = round(particles_per_cell ** (1 / dim))
    if per_axis**dim != particles_per_cell:
        return None
    places = (np.arange(per_axis) + 0.5) / per_axis
    return np.stack(np.meshgrid(*[places] * dim, indexing="ij"), -1).reshape(-1, dim)


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


def seed(scene, geometry, first_layer, last_layer):
    """Seeds of each body in layers first_layer .. last_layer - 1. Where bodies overlap the later one wins."""
    return [
        joined(list(seed_planes(scene, geometry, number, first_layer, last_layer)), geometry.dim)
        for number in range(len(scene.bodies))
    ]


def count_per_layer(scene, geometry, first_layer, last_layer):
    """(bodies, layers of the domain) how many particles will be seeded in each of these layers; zero elsewhere."""
    counts = np.zeros((len(scene.bodies), geometry.layers), np.int64)
    for number in range(len(scene.bodies)):
        for seeds in seed_planes(scene, geometry, number, first_layer, last_layer):
            counts[number] += np.bincount(seeds.node[:, geometry.axes[0]], minlength=geometry.layers)
    return counts


def seed_planes(scene, geometry, number, first_layer, last_layer):
    """Seeds of body `number` in these layers, one plane of cells after another."""
    slab, body = geometry.axes[0], scene.bodies[number]
    first_id = id_offsets(scene)[number]
    low, high = body.shape.bounds()
    first_cell = np.clip(np.floor(np.asarray(low) / geometry.cell_size).astype(np.int64) - 1, 0, None)
    last_cell = np.minimum(np.ceil(np.asarray(high) / geometry.cell_size).astype(np.int64) + 1, geometry.cells)
    cross = [np.arange(first_cell[a], last_cell[a]) for a in range(geometry.dim)]
    # Layers centred on nodes hold halves of two cells, layer 0 of a periodic axis also one of the last cell.
    wrapped = geometry.cells[slab] - 1 if geometry.periodic[slab] and first_layer == 0 else None
    for plane in range(first_cell[slab], last_cell[slab]):
        if first_layer - 1 <= plane <= last_layer or plane == wrapped:
            cross[slab] = np.array([plane])
            cells = np.stack(np.meshgrid(*cross, indexing="ij"), -1).reshape(-1, geometry.dim)
            yield seed_cells(scene, geometry, number, cells, first_id, first_layer, last_layer)


def seed_cells(scene, geometry, number, cells, first_id, first_layer, last_layer):
    """Seeds of body `number` in these cells, as far as they lie in the layers."""
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
    for later in scene.bodies[number + 1 :]:
        inside &= ~later.shape.contains(x)
    here = here[inside]
    return Seeds(node[here].astype(np.int32), offset[here], ids[here])


def joined(parts, dim):
    if not parts:
        return Seeds(np.zeros((0, dim), np.int32), np.zeros((0, dim)), np.zeros(0, np.int64))
    return Seeds(*(np.concatenate([getattr(part, name) for part in parts]) for name in ("node", "offset", "id")))
