"""Who may send particles to whom at a regroup, when nobody has moved farther than to the next layer."""

import numpy as np
import pytest

from pmpm.parallel.balance import FEW, edges_between, sums_below
from pmpm.parallel.regroup import partners

LAYERS = 40


def random_edges(random, ranks):
    active = int(random.integers(1, ranks + 1))
    inner = np.sort(random.choice(np.arange(1, LAYERS // 5), active - 1, replace=False)) * 5
    return (0, *(int(edge) for edge in inner), *[LAYERS] * (ranks + 1 - active))


def reached(before, after, rank, periodic):
    """Ranks to whose layers one step leads from a layer of this rank."""
    layers = range(before[rank], before[rank + 1])
    near = [layer + step for layer in layers for step in (-1, 0, 1)]
    near = [layer % LAYERS for layer in near] if periodic else [layer for layer in near if 0 <= layer < LAYERS]
    owner = {int(np.searchsorted(after[1:], layer, side="right")) for layer in near}
    return sorted(owner - {rank})


@pytest.mark.parametrize("periodic", [False, True])
@pytest.mark.parametrize("seed", range(20))
def test_partners_are_the_ranks_a_step_away(seed, periodic):
    random = np.random.default_rng(seed)
    before, after = random_edges(random, 6), random_edges(random, 6)
    for rank in range(6):
        to, _ = partners(before, after, rank, periodic)
        assert to == reached(before, after, rank, periodic)


@pytest.mark.parametrize("periodic", [False, True])
@pytest.mark.parametrize("seed", range(20))
def test_a_rank_listens_to_those_who_may_send_to_it(seed, periodic):
    random = np.random.default_rng(seed)
    before, after = random_edges(random, 6), random_edges(random, 6)
    found = [partners(before, after, rank, periodic) for rank in range(6)]
    assert all((other in found[rank][0]) == (rank in found[other][1]) for rank in range(6) for other in range(6))


@pytest.mark.parametrize("seed", range(20))
def test_on_the_way_to_far_cuts_few_particles_arrive_at_a_time(seed):
    """A sixteenth of what a rank has in the end or had before, and two layers, for cuts lie between layers; 3e10 particles."""
    random = np.random.default_rng(seed)
    counts = random.integers(0, 3 * 10**9, LAYERS)
    before, after = random_edges(random, 4), random_edges(random, 4)
    ways = [before, *edges_between(counts, before, after)]
    below = sums_below(counts)
    most = np.maximum(np.diff(below[list(before)]), np.diff(below[list(after)])) / 16 + 2 * counts.max()
    assert ways[-1] == after
    for now, then in zip(ways[:-1], ways[1:], strict=True):
        first, last = np.maximum(now[:-1], then[:-1]), np.minimum(now[1:], then[1:])
        stay = below[np.maximum(last, first)] - below[first]
        assert (np.diff(below[list(then)]) - stay <= most).all()


def test_few_particles_go_all_at_once():
    assert edges_between(np.full(LAYERS, FEW // LAYERS), (0, 5, LAYERS), (0, 35, LAYERS)) == [(0, 35, LAYERS)]


def test_cuts_that_stay_need_one_way():
    assert edges_between(np.full(LAYERS, 10**9), (0, 5, LAYERS), (0, 5, LAYERS)) == [(0, 5, LAYERS)]
