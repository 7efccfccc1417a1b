"""The halo sum: on every rank, for all cuts, each node holds the sum over layers in their order, bit for bit."""

import functools
import itertools
import tracemalloc

import node_kernels
import numpy as np
import pytest
from mpi4py import MPI
from node_kernels import kernels

from pmpm.kernels.needs import STENCILS
from pmpm.parallel.comm import World
from pmpm.parallel.halo import Halo
from pmpm.parallel.parts import parts_of
from pmpm.parallel.slabs import Slabs
from pmpm.state.grid import Geometry, Patch

pytestmark = pytest.mark.mpi(min_size=2)

COMM = World(MPI.COMM_WORLD)
QUADRATIC = STENCILS["quadratic"]
WINDOW, LOW, HIGH = QUADRATIC.window, QUADRATIC.reach_low, QUADRATIC.reach_high
CELLS, ALONG = 17, 45
GRIDS = {  # cells and array axes of the slab axis x, y, z
    "x in 2-D": ((CELLS, ALONG), (0, -1, 1)),
    "y in 2-D": ((ALONG, CELLS), (1, -1, 0)),
    "z in 3-D": ((4, ALONG, CELLS), (2, 0, 1)),
}


def geometry(grid, periodic):
    cells, axes = GRIDS[grid]
    return Geometry(cells, tuple(periodic and axis == axes[0] for axis in range(len(cells))), 0.1, axes, QUADRATIC)


def edges_of_all_cuts(layers, ranks):
    """Every way to cut the layers for 1 .. ranks ranks; those left over idle."""
    for active in range(1, ranks + 1):
        for inner in itertools.combinations(range(1, layers), active - 1):
            edges = (0, *inner, *[layers] * (ranks + 1 - active))
            if min(np.diff(edges[: active + 1])) >= WINDOW:
                yield edges


@functools.cache
def quads_of_layers(layers, shape):
    """(layers, rows, quads) bool: the quads that each layer gives anything to, with holes; one gives nothing."""
    random = np.random.default_rng(5)
    held = random.random((layers, shape[0], -(-shape[1] // 4))) < 0.6
    held[:, 0, 3:6] = False
    held[3] = False
    return held


def contributions(layers, shape, real):
    """(layers, window, rows, 4 quads, 4) what each layer adds to its planes; the sum depends on its order almost anywhere."""
    random = np.random.default_rng(11)
    held = quads_of_layers(layers, shape)
    size = (layers, WINDOW, *held.shape[1:], 16)
    values = random.standard_normal(size) * 10.0 ** random.integers(-6, 6, (layers, WINDOW, 1, 1, 1))
    values *= held[:, None, :, :, None]
    return values.reshape(layers, WINDOW, held.shape[1], -1, 4).astype(real)


def lay_out(patch, shape):
    """Let a patch take the nodes of `quads_of_layers`, as if particles had marked them."""
    held = quads_of_layers(patch.geometry.layers, shape)[patch.first_layer : patch.first_layer + patch.layers]
    bits = np.packbits(held, axis=2, bitorder="little")

    def mark(marks):
        marks.view(np.uint8)[:, :, : bits.shape[2]] |= bits

    node_kernels.lay_out(patch, mark)


def fold(given, first, last, patch):
    """Add layers first .. last - 1, in the patch's counting."""
    middle, node, _ = patch.corner
    windows = patch.windows[0]
    for layer in range(first, last):
        of_layer = given[patch.first_layer + layer]
        windows[0] = of_layer[:, middle : middle + windows.shape[2], node : node + windows.shape[3]]
        kernels(patch.real).fold_layer(
            windows,
            0,
            layer,
            patch.placed,
            patch.placed_start,
            patch.corner,
            patch.slots,
            patch.nodes[0],
            patch.unsummed[0],
        )


def ordered_sum(given, periodic):
    """{plane: sum over layers in their order}; on a periodic axis planes one period apart are the same."""
    planes = {}
    for layer, window in enumerate(given):
        for k, plane in enumerate(range(layer - LOW, layer + HIGH + 1)):
            name = plane % len(given) if periodic else plane
            planes[name] = planes.get(name, 0) + window[k]
    return planes


class Summed:
    """The patch of this rank, whose layers are summed part by part, those inside backwards, and its halo."""

    def __init__(self, given, grid, edges, threads):
        real = given.dtype.type
        slabs = Slabs(grid.layers, grid.periodic[grid.axes[0]], LOW, HIGH, edges)
        first, last = slabs.owned(COMM.rank)
        self.given, self.patch = given, Patch(grid, first, last, 1, real)
        self.halo = Halo(COMM, slabs, self.patch, kernels(real))
        works = np.ones(last - first, np.int64)
        self.parts = parts_of(works, WINDOW, self.halo.low_shared, self.halo.high_shared, threads)
        self.apart = self.patch.keep_apart([pair for pair in self.parts.apart if pair not in self.patch.apart])
        lay_out(self.patch, grid.plane_shape)
        self.halo.lay_out()

    def step(self):
        patch = self.patch
        patch.nodes[:] = 0.0
        for part in self.parts.edges:
            fold(self.given, *part, patch)
        self.halo.pack()
        self.halo.start()
        for part in reversed(self.parts.inner):
            fold(self.given, *part, patch)
        patch.add_apart(kernels(patch.real), self.apart)
        self.halo.wait()
        self.halo.finish()
        return patch


def differing_planes(patch, expected, layers, periodic):
    """Planes on which a node that there is holds anything but the sum."""
    plane, middle, node = patch.nodes_of(slice(None))
    found = []
    for number in range(patch.planes):
        name = (number + patch.first_plane) % layers if periodic else number + patch.first_plane
        here = plane == number
        if patch.nodes[0][here].tobytes() != expected[name][middle[here], node[here]].tobytes():
            found.append(name)
    return found


def missing_nodes(patch, shape):
    """How many of the quads that this rank's layers give to are not there."""
    held = quads_of_layers(patch.geometry.layers, shape)[patch.first_layer : patch.first_layer + patch.layers]
    layer, middle, quad = np.nonzero(held)
    return sum(int((patch.find(layer + k, middle, 4 * quad) < 0).sum()) for k in range(WINDOW))


@pytest.mark.parametrize("real", [np.float32, np.float64])
@pytest.mark.parametrize("periodic", [False, True], ids=["walls", "periodic"])
@pytest.mark.parametrize("grid", GRIDS)
def test_every_node_of_every_rank_holds_the_ordered_sum_for_all_cuts_and_threads(grid, periodic, real):
    grid = geometry(grid, periodic)
    given = contributions(grid.layers, grid.plane_shape, real)
    expected = ordered_sum(given, periodic)
    wrong = {}
    for edges, threads in itertools.product(edges_of_all_cuts(grid.layers, COMM.size), (1, 3)):
        patch = Summed(given, grid, edges, threads).step()
        wrong[edges, threads] = differing_planes(patch, expected, grid.layers, periodic)
        assert missing_nodes(patch, grid.plane_shape) == 0
    assert all(not found for rank in COMM.gather(wrong) for found in rank.values()), wrong


def test_all_cuts_are_as_many_as_there_should_be():
    assert len(list(edges_of_all_cuts(CELLS, 3))) == 1 + (CELLS - 2 * WINDOW + 1) + 6


def test_the_contributions_tell_orders_apart():
    given = contributions(CELLS, (1, 9), np.float64)
    backwards = ordered_sum(given[::-1, ::-1], False)
    forwards = ordered_sum(given, False)
    assert any(forwards[plane].tobytes() != backwards[CELLS - 1 - plane].tobytes() for plane in range(CELLS))


@pytest.mark.parametrize("periodic", [False, True], ids=["walls", "periodic"])
def test_a_second_step_begins_from_nothing(periodic):
    grid = geometry("x in 2-D", periodic)
    given = contributions(grid.layers, grid.plane_shape, np.float64)
    edges = max(edges_of_all_cuts(grid.layers, COMM.size), key=lambda edges: len(set(edges)))
    summed = Summed(given, grid, edges, 1)
    found = [summed.step().nodes.tobytes() for _ in range(2)]
    assert COMM.gather(found[0]) == COMM.gather(found[1])


def test_an_exchange_allocates_nothing():
    """After the first ones: what the interpreter makes and drops within 20 of them is less than any plane."""
    grid = geometry("z in 3-D", True)
    given = contributions(grid.layers, grid.plane_shape, np.float64)
    edges = max(edges_of_all_cuts(grid.layers, COMM.size), key=lambda edges: len(set(edges)))
    summed = Summed(given, grid, edges, 1)
    for _ in range(3):
        summed.step()
    plane = 8 * 16 * int(np.diff(summed.patch.plane_start).max())
    tracemalloc.start()
    try:
        held, _ = tracemalloc.get_traced_memory()
        for _ in range(20):
            summed.halo.pack()
            summed.halo.start()
            summed.halo.wait()
            summed.halo.finish()
        now, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert plane > 10_000
    assert most - held < 0.3 * plane
    assert now - held < 1000
