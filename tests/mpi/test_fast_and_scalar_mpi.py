"""On several ranks the fast kernels agree with the scalar ones as they do on one, see tests/test_fast_and_scalar.py."""

import fast_and_scalar as agreement
import numpy as np
import pytest
from mpi4py import MPI

pytestmark = pytest.mark.mpi(min_size=2)

ROWS = [row for row in agreement.PAIRS if row["material"] == "several"]


@pytest.mark.parametrize("row", ROWS, ids=agreement.label)
def test_fast_and_scalar_kernels_agree_to_round_off_on_several_ranks(row):
    scene = agreement.scene(row)
    fast, scalar = (agreement.run(scene, loops, MPI.COMM_WORLD) for loops in ("lanes", "scalar"))
    apart = agreement.distances(fast, scalar)
    assert {name: distance for name, distance in apart.items() if not distance <= agreement.BOUND} == {}
    assert apart["v"] > 0.0
    sent = np.array(fast.report()["sent"])
    if row["shape_function"] != "linear":  # too few steps for any to cross
        assert sent[~np.eye(len(sent), dtype=bool)].any()


def bits(simulation):
    """Rows of all ranks in the one global order."""
    own = simulation.fields(["id", "x", "velocity", "C", "stress", "density"])
    return {name: np.concatenate(simulation.comm.gather(rows)).tobytes() for name, rows in own.items()}


@pytest.mark.parametrize("row", ROWS, ids=agreement.label)
def test_fast_kernels_give_the_bits_of_one_rank_on_several(row):
    scene = agreement.scene(row)
    together, alone = (agreement.run(scene, "lanes", comm) for comm in (MPI.COMM_WORLD, None))
    assert bits(together) == bits(alone)
