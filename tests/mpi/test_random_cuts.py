"""Cuts drawn at random, at random steps, and threads give the bits of one rank: all splines and transfers, 2-D and 3-D.

tests/by_hand/random_cuts_all.py draws twenty sequences for each scene, on up to seven ranks.
"""

import pytest
import random_cuts
from mpi4py import MPI

from pmpm.parallel.comm import World

pytestmark = pytest.mark.mpi(min_size=2)

COMM = World(MPI.COMM_WORLD)
SEQUENCES = 2  # of cuts, of each scene: twenty in all


@pytest.mark.parametrize("case", random_cuts.FEW)
def test_random_cuts_and_threads_give_the_bits_of_one_rank(case):
    expected = random_cuts.bits_of_one(case, COMM)
    for seed in range(SEQUENCES):
        found, edges, sent = random_cuts.cut_at_random(case, seed, COMM)
        assert found == expected, f"seed {seed}: {edges}"
        # Equality would be cheap if cuts stayed, or if nothing ever went over one.
        assert len(set(edges)) >= 3
        assert sent > 0
