"""Which nodes a patch has: those that material reaches and few others, in domains however large; and who sums them."""

import node_kernels
import numpy as np
import pytest
import scaling_model

import pmpm
from pmpm.kernels.needs import STENCILS
from pmpm.parallel.halo import Halo
from pmpm.parallel.parts import parts_of, pieces
from pmpm.parallel.slabs import Slabs
from pmpm.state.grid import Geometry, Patch

CELL = 0.05
WATER = {"water": {"model": "fluid", "density": 1000.0, "sound_speed": 10.0}}


def flying(size, lows, velocity, dim=3, **method):
    """A box of water of 4 cells at each corner of `lows`, in cells, in a domain of `size` cells."""
    bodies = [
        {
            "material": "water",
            "velocity": velocity,
            "shape": {"type": "box", "min": [CELL * c for c in low], "max": [CELL * (c + 4) for c in low]},
        }
        for low in lows
    ]
    return pmpm.Simulation(
        pmpm.Scene(
            domain={"size": [CELL * c for c in size], "cell_size": CELL, "gravity": [0.0] * dim},
            method=method,
            time={"end": 1.0},
            materials=WATER,
            bodies=bodies,
        )
    )


def test_no_mass_is_lost_by_particles_that_fly_as_fast_as_they_may():
    """A fifth of a cell in each step, 8.5 cells along y and z in all: nodes are laid out anew for every half, and particles,
    which stay in their layers, hardly ever sorted."""
    simulation = flying((40, 40, 40), [(3, 4, 5)], [0.0, 9.0, 9.0])
    total, laid_out, lay_out = simulation.measure()["mass"], [], simulation.lay_out

    def counted():
        laid_out.append(simulation.step_count)
        lay_out()

    simulation.lay_out = counted
    for _ in range(60):
        simulation.step()
        assert simulation.patch.nodes[0, :, 3].sum() == pytest.approx(total, rel=1e-12)
    assert 14 <= len(laid_out) <= 18
    assert simulation.regroups <= 2


def test_what_particles_travel_is_never_taken_for_less_than_it_is():
    """Places are rounded to the nearest unit: a particle whose steps are 100.55 units long moves 101 in each."""
    unit = 2.0**-24
    simulation = flying(
        (12, 12), [(4, 4)], [0.0, -100.55 * unit * CELL / 2.0**-10], 2, precision="float32", transfer="pic"
    )
    simulation.control.fixed_step = 2.0**-10
    before = simulation.populations[0].places[:, 1].astype(int)
    for _ in range(500):
        simulation.step()
    moved = np.abs(simulation.populations[0].places[:, 1] - before).max()
    assert simulation.regroups == 0
    assert moved == 500 * 101
    assert moved * unit <= simulation.patch.travelled <= 1.02 * moved * unit


def nodes_of(simulation):
    simulation.step()
    return simulation.patch.quads


def test_a_block_has_as_many_nodes_in_a_large_domain_as_in_a_tight_one():
    """Both lie at the same place among quads, and far enough from walls, which would ask for nodes of their own."""
    tight, large = (nodes_of(flying((cells,) * 3, [(low,) * 3], [0.0] * 3)) for cells, low in ((16, 6), (90, 42)))
    assert tight == large


def test_the_gap_between_two_blocks_in_the_same_rows_has_no_nodes():
    one, two = (nodes_of(flying((90, 12, 90), lows, [0.0] * 3)) for lows in ([(4, 4, 4)], [(4, 4, 4), (4, 4, 72)]))
    assert two == 2 * one


def test_windows_are_as_large_as_the_material():
    simulation = flying((90,) * 3, [(40,) * 3], [0.0] * 3)
    simulation.step()
    _, _, _, middles, row, _ = simulation.patch.windows.shape
    assert middles <= 12
    assert row <= 16


# ---- parts of layers -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("threads", [1, 2, 5])
@pytest.mark.parametrize(("low", "high"), [(False, False), (True, False), (False, True), (True, True)])
@pytest.mark.parametrize("layers", [0, 1, 5, 8, 9, 23])
def test_every_layer_is_in_one_part(layers, low, high, threads):
    parts = parts_of(np.arange(layers), 5, low, high, threads)
    ranges = sorted([*parts.edges, *parts.inner])
    assert [layer for first, last in ranges for layer in range(first, last)] == list(range(layers))
    assert len(parts.inner) <= threads


def test_layers_beside_cuts_are_summed_first():
    parts = parts_of(np.ones(20, np.int64), 5, True, True, 2)
    assert parts.edges == ((0, 4), (16, 20))
    assert parts.inner == ((4, 10), (10, 16))
    # Planes that layers before 10, or before 16, reach as well: four of the first layer, three of the next, ...
    assert [layer for layer, _ in parts.apart] == [n for begin in (10, 16) for n in [begin] * 4 + [begin + 1] * 3
                                                   + [begin + 2] * 2 + [begin + 3]]  # fmt: skip


def test_planes_near_the_ends_stay_with_one_thread():
    assert pieces(0, 23, 3, 5) == [(0, 7), (7, 15), (15, 23)]
    assert pieces(0, 9, 3, 5) == [(0, 9)]
    assert pieces(3, 3, 3, 5) == [(3, 3)]


# ---- bytes of the halo ---------------------------------------------------------------------------------------------------


class Told:
    """One rank of several, which only tells what it would send."""

    def __init__(self, rank, size):
        self.rank, self.size = rank, size

    def exchange(self, sends, receives):
        return sends


@pytest.mark.parametrize("periodic", [False, True])
@pytest.mark.parametrize("ranks", [1, 2, 3, 7, 64])
@pytest.mark.parametrize("real", [np.float32, np.float64])
def test_bytes_and_messages_of_a_step_are_those_of_the_formula(ranks, periodic, real):
    """Planes that are full: 4 summed ones one way, 10 unsummed ones the other, with the table of their rows."""
    stencil, axes = STENCILS["quadratic"], (2, 0, 1)
    geometry = Geometry((6, 30, 5 * ranks + 3), (False, False, periodic), CELL, axes, stencil)
    edges = tuple(np.linspace(0, geometry.layers, ranks + 1).astype(int))
    slabs = Slabs(geometry.layers, periodic, stencil.reach_low, stencil.reach_high, edges)
    full = (geometry.extent(0), geometry.extent(1))

    def mark(marks):
        marks[:, :, 0] = (1 << -(-full[1] // 4)) - 1

    sent = []
    for rank in range(ranks):
        first, last = slabs.owned(rank)
        patch = Patch(geometry, first, last, 1, real)
        halo = Halo(Told(rank, ranks), slabs, patch, node_kernels.kernels(real))
        node_kernels.lay_out(patch, mark)
        halo.lay_out()
        sent.append(halo.each_time)
    messages, nbytes = np.transpose(sent)
    assert list(messages) == list(scaling_model.halo_messages(slabs))
    assert list(nbytes) == list(scaling_model.halo_bytes(slabs, full, np.dtype(real).itemsize))
