"""Cuts follow counted work: the best edges against all there are, and when new ones are worth it."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pmpm.parallel.balance import MOVE_WORK, Balance, best_edges, imbalance, least_possible, moved, slab_works, smallest
from pmpm.parallel.slabs import Slabs, room
from pmpm.state.particles import Cloud

WORK = st.lists(st.one_of(st.just(0), st.integers(0, 3), st.integers(0, 10**12)), min_size=1, max_size=13)


def all_edges(layers, ranks, window):
    """Every way to cut so many layers for at most so many ranks."""
    for slabs in range(1, min(ranks, room(layers, window)) + 1):
        for inner in itertools.combinations(range(1, layers), slabs - 1):
            edges = (0, *inner, layers)
            if slabs == 1 or min(np.diff(edges)) >= window:
                yield edges


@given(WORK, st.integers(1, 5), st.integers(1, 5))
@settings(max_examples=300, deadline=None)
def test_no_cuts_give_the_busiest_rank_less_by_more_than_a_thousandth(work, ranks, window):
    work = np.array(work)
    edges = best_edges(work, ranks, window)
    assert len(edges) == ranks + 1
    if len(work) >= window:
        Slabs(len(work), False, window // 2, window - 1 - window // 2, edges)  # ValueError for edges that are no slabs
    best = min(slab_works(work, found).max() for found in all_edges(len(work), ranks, window))
    assert best <= slab_works(work, edges).max() <= best + best // 1000
    assert least_possible(work, ranks, window) <= best


@pytest.mark.parametrize("least", [0, 1, 7, 999, 123_456, 10**15])
@pytest.mark.parametrize("below", [0.0, 0.3, 0.999, 1.0])
def test_the_smallest_bound_that_fits_is_found_to_a_thousandth(least, below):
    found = smallest(int(below * least), lambda bound: bound >= least)
    assert least <= found <= least + least // 1000


def test_fewer_ranks_are_taken_where_more_would_make_the_busiest_busier():
    # Three slabs of five layers are 0 .. 5 .. 10 .. 15 alone: the middle one would hold all there is to do.
    work = np.array([0] * 5 + [1] * 5 + [0] * 5)
    edges = best_edges(work, 3, 5)
    assert edges[2:] == (15, 15)
    assert sorted(slab_works(work, edges)) == [0, 2, 3]


@pytest.mark.parametrize(("steps", "moves"), [(10, False), (1000, True)])
def test_cuts_move_when_they_have_cost_more_than_the_moving_costs(steps, moves):
    work = np.full(100, 10_000)
    edges = (0, 40, 100)  # ten layers too many, each of a hundred particles
    balance = Balance((100,), 5)
    assert (balance.look(work, edges, steps) == (0, 50, 100)) == moves
    assert balance.before == pytest.approx(1.2)
    assert (balance.best, balance.changes) == (1.0, int(moves))
    assert balance.after == (1.0 if moves else balance.before)
    assert (100_000 * steps > MOVE_WORK * moved(work, edges, (0, 50, 100))) == moves


def test_what_old_cuts_cost_adds_up_until_they_move():
    work, edges = np.full(100, 10_000), (0, 40, 100)
    balance = Balance((100,), 5)
    # 1000 particles move at 1000 each; 100 000 are lost in a step, so that the eleventh is too many.
    assert [balance.look(work, edges, 1) is not None for _ in range(22)] == ([False] * 10 + [True]) * 2


def test_cuts_stay_where_the_balance_is_not_wanted_or_cannot_be_better():
    work = np.array([1] * 20 + [1000] + [1] * 20)
    best = best_edges(work, 4, 5)
    balance = Balance((100,), 5)
    assert balance.look(work, best, 10**9) is None
    assert balance.best == balance.before == pytest.approx(imbalance(slab_works(work, best)))
    assert Balance((100,), 5, wanted=False).look(work, (0, 5, 10, 15, 41), 10**9) is None


def test_what_moves_is_counted_for_the_rank_that_sends_most():
    work = np.full(10, 700)
    assert moved(work, (0, 5, 10), (0, 5, 10)) == 0
    assert moved(work, (0, 5, 10), (0, 8, 10)) == 3 * 7
    assert moved(work, (0, 2, 4, 10), (0, 4, 8, 10)) == 4 * 7


@pytest.mark.parametrize(("size", "dim", "real"), [(9, 2, np.float64), (23, 3, np.float32)])
def test_bytes_of_a_particle_that_moves_are_those_it_takes_in_a_message(size, dim, real):
    few = Cloud(np.zeros((5, size), real), np.zeros((5, dim), np.int32), np.zeros(5, np.int32), np.zeros(5, np.int64))
    assert sum(part.nbytes for part in few.parts) == 5 * Cloud.row_bytes(size, dim, real)
