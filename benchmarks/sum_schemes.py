"""How many sums in a card's memory three ways of doing P2G take, worked out from where the particles lie.

plain          each particle adds to its nodes
warp           the particles of a warp with the same stencil are summed first, by warp operations; one of them adds
tiles          a block of threads sums in shared memory; what its nodes have got is added once (kernels/cuda_loops.py)

gpu.py has the first and the last counted by the simulator as well.
"""

import numpy as np

from pmpm.kernels import build_cuda
from pmpm.kernels.loops import PADDING
from pmpm.state.particles import LANES

WARP = 32
SCHEMES = "plain", "warp", "tiles"


def stencils(simulation, law):
    """(threads, 3) plane, middle and row node where the stencil of each lane's particle begins, and which lanes hold one."""
    population, geometry = simulation.populations[law], simulation.geometry
    node, part = population.cells(geometry.axes)
    home = node + np.floor(part + geometry.stencil.round).astype(np.int64)
    columns = [home[:, axis] if axis >= 0 else np.zeros(len(home), np.int64) for axis in geometry.axes]
    held = population.lanes.reshape(-1)
    first = np.zeros((len(held), 3), np.int64)
    first[held] = np.stack(columns, axis=1) + PADDING
    return first, held


def sums(simulation):
    """{scheme: sums per particle} for all laws, and the share of blocks of threads that find no room in shared memory."""
    real, nodes, dim = np.dtype(simulation.real), simulation.geometry.stencil.nodes, simulation.dim
    room = build_cuda.TILE_BYTES // real.itemsize
    found, particles, blocks, without_room = dict.fromkeys(SCHEMES, 0), 0, 0, 0
    reach = np.array([nodes, nodes if dim == 3 else 1, nodes])
    of_particle, numbers = int(reach.prod()) * (dim + 1), dim + 1
    steps = np.stack(np.meshgrid(*map(np.arange, reach), indexing="ij"), axis=-1).reshape(-1, 3)
    for law in range(len(simulation.populations)):
        first, held = stencils(simulation, law)
        particles += int(held.sum())
        found["plain"] += of_particle * int(held.sum())
        for begin in range(0, len(held), WARP):
            here = first[begin : begin + WARP][held[begin : begin + WARP]]
            found["warp"] += of_particle * len(np.unique(here, axis=0))
        for begin in range(0, len(held), build_cuda.THREADS):
            here = first[begin : begin + build_cuda.THREADS][held[begin : begin + build_cuda.THREADS]]
            size = int((here.max(axis=0) - here.min(axis=0) + reach).prod())
            blocks += 1
            if 4 * size <= room:
                met = np.unique((here[:, None] + steps).reshape(-1, 3), axis=0)
                found["tiles"] += numbers * len(met)
            else:
                without_room += 1
                found["tiles"] += of_particle * len(here)
    assert LANES * 2 == WARP
    return {scheme: count / particles for scheme, count in found.items()}, without_room / blocks
