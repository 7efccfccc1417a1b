"""Cuts that follow the work of a dam break in a long tank: as even as slabs can be, and no bit depends on them."""

import numpy as np
import pytest
from mpi4py import MPI

import pmpm
from pmpm.parallel.balance import MOST_MOVES, imbalance
from pmpm.parallel.comm import World

pytestmark = pytest.mark.mpi(min_size=2)

COMM = World(MPI.COMM_WORLD)
ROW = 9 * 8 + 2 * 4 + 4 + 8  # bytes of a travelling particle: x, v, C and J, its node, table row and id
CELLS, STEPS = 30, 3000  # of the column; until the front is at the other end


def tank(balance):
    """A column of water, twice as wide as high, at the end of a tank four times as long."""
    width = 0.1
    return pmpm.Scene(
        domain={
            "size": [4.0 * width, 0.8 * width], "cell_size": width / CELLS, "gravity": [0.0, -9.81],
            "walls": {"x_min": "slip", "x_max": "slip", "y_min": "slip"},
        },
        time={"end": 1.0},
        materials={"water": {"model": "fluid", "density": 1000.0, "sound_speed": 10.0}},
        bodies=[
            {"material": "water", "pressure": "hydrostatic",
             "shape": {"type": "box", "min": [0.0, 0.0], "max": [width, 0.5 * width]}},
        ],
        parallel={"balance": balance},
    )  # fmt: skip


def run(balance, comm):
    simulation = pmpm.Simulation(tank(balance), comm)
    simulation.run(steps=STEPS)
    return simulation


def state(simulation):
    """All rows of all ranks, in the one global order."""
    own = simulation.fields(["id", "x", "velocity", "C", "J"])
    return {name: np.concatenate(simulation.comm.gather(rows)).tobytes() for name, rows in own.items()}


def counted(simulation):
    """Largest over mean number of particles of a rank."""
    return imbalance(np.array(simulation.comm.gather(simulation.rows())))


@pytest.fixture(scope="module")
def balanced():
    return run(True, COMM)


@pytest.fixture(scope="module")
def fixed():
    return run(False, COMM)


def test_cuts_follow_the_water_and_particles_are_shared_evenly(balanced, fixed):
    said = balanced.report()["balance"]
    assert said["cuts_moved"] > 0
    assert said["imbalance"] <= 1.10
    assert said["imbalance"] <= said["imbalance_before"]
    assert 1.0 <= said["best"] <= said["imbalance"]
    assert counted(balanced) <= 1.10
    assert counted(fixed) > counted(balanced) + 0.2
    assert balanced.slabs.edges != fixed.slabs.edges


def test_what_migration_sends_is_told_in_particles_and_bytes(balanced, fixed):
    for simulation in (balanced, fixed):
        told = simulation.report()
        particles = np.array(told["sent"]).sum(axis=1)
        assert particles.sum() > 0
        assert told["sent_bytes"] == (ROW * particles).tolist()


def test_each_move_of_cuts_is_told_with_what_it_sent_and_what_it_was_good_for(balanced):
    told = balanced.report()
    said, moves = told["balance"], told["balance"]["last_moves"]
    assert len(moves) == min(said["cuts_moved"], MOST_MOVES)
    steps = [move["step"] for move in moves]
    assert steps == sorted(set(steps))
    for move in moves:
        assert 1.0 <= move["best"] <= move["imbalance"] < move["imbalance_before"]
        assert move["bytes_sent"] == ROW * move["particles_sent"] > 0
    assert sum(move["particles_sent"] for move in moves) == said["particles_sent"] <= np.sum(told["sent"])
    assert said["bytes_sent"] == ROW * said["particles_sent"]


def test_cuts_that_may_not_move_stay_and_their_imbalance_is_told(fixed):
    said = fixed.report()["balance"]
    assert (said["cuts_moved"], said["last_moves"], said["bytes_sent"]) == (0, [], 0)
    assert said["imbalance"] > 1.2
    assert said["best"] < said["imbalance"]


def test_no_bit_depends_on_where_cuts_are(balanced, fixed):
    alone = run(True, None)
    expected = state(alone)
    assert state(balanced) == expected
    assert state(fixed) == expected
    assert balanced.time == fixed.time == alone.time
