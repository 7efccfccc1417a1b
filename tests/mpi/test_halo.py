"""The halo sum: on every rank, for all cuts, each node holds the sum over layers in their order, bit for bit."""

import functools
import itertools
from types import SimpleNamespace

import numpy as np
import pytest
from mpi4py import MPI

from pmpm.kernels import loops, targets
from pmpm.kernels.loops import EMPTY_BOX
from pmpm.kernels.needs import STENCILS
from pmpm.parallel.comm import World
from pmpm.parallel.halo import Halo
from pmpm.parallel.slabs import Slabs
from pmpm.state.grid import Geometry, Patch

pytestmark = pytest.mark.mpi(min_size=2)

COMM = World(MPI.COMM_WORLD)
QUADRATIC = STENCILS["quadratic"]
WINDOW, LOW, HIGH = QUADRATIC.window, QUADRATIC.reach_low, QUADRATIC.reach_high
CELLS, ROW_PADDING = 17, 4
GRIDS = {  # cells and array axes of the slab axis x, y, z
    "x in 2-D": ((CELLS, 3), (0, -1, 1)),
    "y in 2-D": ((3, CELLS), (1, -1, 0)),
    "z in 3-D": ((2, 1, CELLS), (2, 0, 1)),
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


def boxes_of_layers(layers, shape):
    """(layers, 4) where along middle and row each layer gives anything; one gives nothing."""
    random = np.random.default_rng(5)
    low = random.integers(0, 2, (layers, 2)) * (np.array(shape) > 1)
    row = shape[1] - ROW_PADDING  # the rest lets rows of four nodes reach over their end
    boxes = np.stack([low[:, 0], np.full(layers, shape[0]), low[:, 1], row - low[:, 1]], axis=1)
    boxes[3] = EMPTY_BOX
    return boxes


def contributions(layers, shape, real):
    """(layers, window, *shape, 4) what each layer adds to its planes; the sum depends on its order in almost any place."""
    random = np.random.default_rng(11)
    values = random.standard_normal((layers, WINDOW, *shape, 4)) * 10.0 ** random.integers(
        -6, 6, (layers, WINDOW, 1, 1, 1)
    )
    for window, (j0, j1, k0, k1) in zip(values, boxes_of_layers(layers, shape), strict=True):
        outside = np.ones(shape, bool)
        outside[j0:j1, k0:k1] = False
        window[:, outside] = 0.0
    return values.astype(real)


@functools.cache
def kernels(real):
    """The loops over planes of a scene, and `fold` of some layers."""
    target = targets.scalar(real)
    entries = {name: target.entry(getattr(loops, name)) for name in ("clear", "pack", "take_planes", "add_planes")}
    return SimpleNamespace(**entries, fold_layer=target.compile(loops.fold_layer))


def fold(given, first, last, halo, patch):
    boxes = boxes_of_layers(len(given), patch.nodes.shape[1:3])
    for layer in range(first, last):
        halo.kernels.fold_layer(
            given[layer].copy(), boxes[layer], halo.targets[layer - first], patch.nodes, patch.boxes, halo.unsummed,
            halo.slot_boxes,
        )  # fmt: skip


def ordered_sum(given, periodic):
    """{plane: sum over layers in their order}; on a periodic axis planes one period apart are the same."""
    planes = {}
    for layer, window in enumerate(given):
        for k, plane in enumerate(range(layer - LOW, layer + HIGH + 1)):
            name = plane % len(given) if periodic else plane
            planes[name] = planes.get(name, 0) + window[k]
    return planes


def halo_sum(given, grid, edges):
    """The patch of this rank after the halo."""
    slabs = Slabs(grid.layers, grid.periodic[grid.axes[0]], LOW, HIGH, edges)
    first, last = slabs.owned(COMM.rank)
    patch = Patch(grid, first, last, 1, given.dtype.type)
    halo = Halo(COMM, slabs, patch, kernels(given.dtype.type))
    fold(given, first, last, halo, patch)
    halo.finish(halo.start())
    return patch


def differing_planes(patch, expected, layers, periodic):
    planes = range(patch.first_plane, patch.first_plane + patch.planes)
    names = [plane % layers if periodic else plane for plane in planes]
    return [name for name, own in zip(names, patch.nodes, strict=True) if own.tobytes() != expected[name].tobytes()]


@pytest.mark.parametrize("real", [np.float32, np.float64])
@pytest.mark.parametrize("periodic", [False, True], ids=["walls", "periodic"])
@pytest.mark.parametrize("grid", GRIDS)
def test_every_plane_of_every_rank_holds_the_ordered_sum_for_all_cuts(grid, periodic, real):
    grid = geometry(grid, periodic)
    given = contributions(grid.layers, grid.plane_shape, real)
    expected = ordered_sum(given, periodic)
    wrong = {}
    for edges in edges_of_all_cuts(grid.layers, COMM.size):
        wrong[edges] = differing_planes(halo_sum(given, grid, edges), expected, grid.layers, periodic)
    assert all(not found for rank in COMM.gather(wrong) for found in rank.values()), wrong


def test_all_cuts_are_as_many_as_there_should_be():
    assert len(list(edges_of_all_cuts(CELLS, 3))) == 1 + (CELLS - 2 * WINDOW + 1) + 6


def test_the_contributions_tell_orders_apart():
    given = contributions(CELLS, (1, 3), np.float64)
    backwards = ordered_sum(given[::-1, ::-1], False)
    forwards = ordered_sum(given, False)
    assert any(forwards[plane].tobytes() != backwards[CELLS - 1 - plane].tobytes() for plane in range(CELLS))


@pytest.mark.parametrize("periodic", [False, True], ids=["walls", "periodic"])
def test_a_second_step_begins_from_nothing(periodic):
    grid = geometry("x in 2-D", periodic)
    given = contributions(grid.layers, grid.plane_shape, np.float64)
    edges = max(edges_of_all_cuts(grid.layers, COMM.size), key=lambda edges: len(set(edges)))
    slabs = Slabs(grid.layers, periodic, LOW, HIGH, edges)
    first, last = slabs.owned(COMM.rank)
    patch = Patch(grid, first, last, 1, np.float64)
    halo = Halo(COMM, slabs, patch, kernels(np.float64))
    found = []
    for _ in range(2):
        halo.kernels.clear(patch.nodes, patch.boxes)
        fold(given, first, last, halo, patch)
        halo.finish(halo.start())
        found.append(patch.nodes.tobytes())
    assert COMM.gather(found[0]) == COMM.gather(found[1])
