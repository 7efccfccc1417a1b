"""The model of a step on many ranks: counts are exact, times are what a hand computes from its parts."""

import re
from dataclasses import replace

import pytest
import scaling_model as model
import scaling_page
from launch import ROOT
from scaling_fit import link_of
from scaling_model import Block, Constants, LawCost, Link, Machine, Split

from pmpm.parallel.slabs import Slabs

PLANE = 13, 14  # rows, nodes of a row
LAW = LawCost(particle=1e-6, regroup=4e-6, held=100, moved=300)
CONSTANTS = Constants({"W1": LAW}, step=0.0, every=40.0, copy=1e9, local=Link(1e-6, 1e9), file_bytes=100.0, source="")
MACHINE = Machine("two cores a node", units=2, memory=1e12, links=1, link=Link(1e-5, 1e8), sources=())
SLABS_OF_10 = Slabs(30, False, 2, 2, (0, 10, 20, 30))


def seconds(block, split, machine=MACHINE, constants=CONSTANTS, **choices):
    return model.step_seconds(block, split, machine, LAW, constants, **choices)


# ---- counts ----------------------------------------------------------------------------------------------------------------


def test_quadratic_splines_send_4_planes_up_and_10_down():
    """docs/architecture.md, The same bits."""
    assert model.planes_of_cut((2, 2)) == (4, 10)


def test_every_rank_sends_a_message_to_each_neighbour():
    assert list(model.halo_messages(SLABS_OF_10)) == [1, 2, 1]


def test_on_a_periodic_axis_the_ends_are_neighbours():
    assert list(model.halo_messages(replace(SLABS_OF_10, periodic=True))) == [2, 2, 2]


def test_ranks_without_layers_send_nothing():
    assert list(model.halo_messages(Slabs(10, False, 2, 2, (0, 5, 10, 10)))) == [1, 1, 0]


@pytest.mark.parametrize(("blends", "f_bar", "exchanges"), [(False, False, 1), (True, False, 2), (True, True, 3)])
def test_flip_and_f_bar_exchange_once_more_each(blends, f_bar, exchanges):
    count = model.halo_exchanges(blends, f_bar)
    assert list(model.halo_messages(SLABS_OF_10, count)) == [exchanges, 2 * exchanges, exchanges]


@pytest.mark.parametrize("real_bytes", [4, 8])
def test_full_rows_travel_by_four_nodes_of_four_reals_with_their_spans_before_them(real_bytes):
    """A plane of 13 rows of 16 nodes; 8 bytes per plane and 12 per row, 656 and 1640 of them, fill whole lines of 64."""
    nodes = 13 * 16 * 4 * real_bytes
    up, down = 704 + 4 * nodes, 1664 + 10 * nodes
    assert list(model.halo_bytes(SLABS_OF_10, PLANE, real_bytes)) == [up, up + down, down]


def test_bytes_do_not_depend_on_the_width_of_slabs():
    wide = Slabs(300, False, 2, 2, (0, 100, 200, 300))
    assert list(model.halo_bytes(wide, PLANE, 4)) == list(model.halo_bytes(SLABS_OF_10, PLANE, 4))


@pytest.mark.parametrize("ranks", [2, 3])
def test_the_model_sends_what_slabs_send(ranks):
    """A layer's particles reach two nodes beyond their cell on either side."""
    edges = tuple(10 * rank for rank in range(ranks + 1))
    counted = model.halo_bytes(Slabs(10 * ranks, False, 2, 2, edges), (6 + 4, 7 + 4), 4)
    assert model.surface(Block((10 * ranks, 6, 7)), Split((ranks, 1, 1))).sent == counted.max()


# ---- times -----------------------------------------------------------------------------------------------------------------


def test_one_rank_computes_and_regroups_and_nothing_else():
    found = seconds(Block((10, 10, 10)), Split((1, 1, 1)))
    assert {name: value for name, value in found.items() if value} == pytest.approx(
        {"compute": 8000 * 1e-6, "regroup": 8000 * 4e-6 / 40.0}
    )


def test_the_time_of_two_slabs_is_the_sum_of_its_parts():
    """8000 particles each; 14 x 14 nodes in a plane; the upper rank sends ten planes and receives four."""
    found = seconds(Block((20, 10, 10)), Split((2, 1, 1)))
    up, down = (head + planes * 14 * 16 * 16 for head, planes in ((704, 4), (1792, 10)))
    regroup = 8000 * 4e-6 + 1 * (3e-6 + 4.0 * 2 / 1e9) + 0.5 * 100 * 8 * 100 / 1e9
    expected = {
        "compute": 8000 * 1e-6,
        "ghost nodes": 4 * 14 * 14 * model.NODE_COST * 1e-6,
        "packing": 2 * (up + down) / 1e9,
        "messages": 1e-6 + down / 1e9,
        "regroup": regroup / 40.0,
        "fixed": 0.0,
        "reductions": 0.0,
    }
    assert found == pytest.approx(expected, rel=1e-12)


def test_the_largest_slab_counts_where_layers_do_not_divide_evenly():
    assert seconds(Block((16, 10, 10)), Split((3, 1, 1)))["compute"] == pytest.approx(6 * 800 * 1e-6)


def test_slabs_thinner_than_a_stencil_are_refused():
    with pytest.raises(ValueError, match="at least 5 cells"):
        seconds(Block((14, 10, 10)), Split((3, 1, 1)))


def test_threads_share_work_but_not_messages():
    block = Block((80, 10, 10))
    one, two = (seconds(block, Split((4, 1, 1), threads), replace(MACHINE, units=1)) for threads in (1, 2))
    assert two["compute"] == pytest.approx(one["compute"] / 2)
    assert two["messages"] == one["messages"]


def test_messages_are_hidden_behind_half_of_the_interior():
    """A slab of 20 layers in the middle has 12 that no neighbour touches."""
    block, split = Block((60, 10, 10)), Split((3, 1, 1))
    shown, hidden = (seconds(block, split, overlap=share)["messages"] for share in (0.0, 1.0))
    assert hidden == pytest.approx(max(0.0, shown - 12 / 20 * 16000 * 1e-6 / 2.0))
    assert hidden < shown


def test_a_full_node_is_as_fast_as_its_memory():
    """300 bytes per particle-step from 1e9 bytes/s that four cores share."""
    narrow = replace(MACHINE, units=4, memory=1e9)
    assert model.unit_seconds(LAW, narrow, busy=4) == pytest.approx(1.2e-6)
    assert model.unit_seconds(LAW, narrow, busy=1) == LAW.particle


def test_reductions_count_only_beyond_the_two_steps_they_may_take():
    """1024 ranks: 10 levels there and back at 1 ms each, once a step and once in eight for the count of disorder."""
    slow = replace(MACHINE, units=1, link=Link(1e-3, 1e12))
    block = Block((5 * 1024, 5, 5))
    found = seconds(block, Split((1024, 1, 1)), slow)
    rest = sum(found.values()) - found["reductions"]
    assert found["reductions"] == pytest.approx(20e-3 * 9 / 8 - 2 * rest, rel=1e-6)
    assert seconds(block, Split((1024, 1, 1)), MACHINE)["reductions"] == 0.0


def test_a_run_without_cuts_is_fully_efficient():
    assert model.efficiency(Block((10, 10, 10)), Split((1, 1, 1)), MACHINE, LAW, CONSTANTS) == pytest.approx(1.0)


@pytest.mark.parametrize(("size", "ranks"), [(1e6, 10), (1e8, 46), (1e9, 100)])
def test_a_cube_feeds_a_fifth_of_its_layers(size, ranks):
    """(N / 8)^(1/3) / 5."""
    assert model.most_slabs(scaling_page.block_of(size)) == ranks


@pytest.mark.parametrize(("axes", "parts"), [(2, (8, 8, 1)), (3, (4, 4, 4))])
def test_bricks_with_the_smallest_surface_are_the_most_even(axes, parts):
    assert model.best_bricks(Block((100, 100, 100)), 64, 1, axes).parts == parts


def test_there_are_no_bricks_thinner_than_a_stencil():
    assert model.best_bricks(Block((10, 10, 10)), 16, 1) is None


# ---- constants and the page ------------------------------------------------------------------------------------------------


def test_latency_is_of_the_smallest_message_and_bandwidth_of_the_largest():
    link = link_of([[8, 2e-6], [1024, 3e-6], [1_000_008, 2e-6 + 1e-3]])
    assert (link.latency, link.bandwidth) == pytest.approx((2e-6, 1e9))


def test_constants_are_kept_as_they_were_measured(tmp_path):
    model.write_constants(CONSTANTS, tmp_path / "constants.json")
    assert model.read_constants(tmp_path / "constants.json") == CONSTANTS


def test_the_page_says_what_the_constants_say():
    page = ROOT / "docs" / "scaling.md"
    made, kept = scaling_page.text(model.read_constants()), page.read_text(encoding="utf-8")
    of_the_day = re.compile(r"^.*; commit .*$", re.MULTILINE)
    assert of_the_day.sub("", kept) == of_the_day.sub("", made)
