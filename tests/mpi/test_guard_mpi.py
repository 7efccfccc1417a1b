"""What stops a run that makes no sense stops all ranks, with the message of one."""

import re

import numpy as np
import pytest
from mpi4py import MPI

import pmpm
from pmpm.failure import NumericalFailure

COMM = MPI.COMM_WORLD
RUBBER = {"model": "neo_hookean", "density": 1000.0, "youngs_modulus": 1e6, "poisson_ratio": 0.3}
SNOW = {"model": "snow", "density": 400.0, "youngs_modulus": 1.4e5, "poisson_ratio": 0.2, "hardening": 50.0}


def simulate(comm, material, time):
    scene = pmpm.Scene(
        domain={"size": [24.0, 24.0], "cell_size": 1.0},
        time={"end": 100.0} | time,
        guard={"interval": 10},
        materials={"m": material},
        bodies=[{"material": "m", "shape": {"type": "box", "min": [8.0, 8.0], "max": [16.0, 16.0]}}],
    )
    return pmpm.Simulation(scene, comm)


def unstable(comm):
    """Steps 1.4 times as long as the bound."""
    simulation = simulate(comm, RUBBER, {"step": 0.02698, "force_step": True})
    x = simulation.particles.x - 12.0
    simulation.particles.v = 0.01 * np.sin(np.pi * x / 8.0)
    return simulation


def crushed(comm):
    """Two particles that no rank but the last may hold have hardened, one more than the other."""
    simulation = simulate(comm, SNOW, {})
    ids = simulation.particles.id
    J = np.ones(len(ids))
    last = max(simulation.comm.gather(int(ids.max(initial=0))))
    J[ids == last], J[ids == last - 3] = 0.3, 0.31
    simulation.particles.J_P = J
    return simulation


def text_of(simulation):
    with pytest.raises(NumericalFailure) as failure:
        simulation.run(steps=400)
    return re.sub(r"rank \d+", "rank", str(failure.value)), simulation.step_count


@pytest.mark.parametrize("start", [unstable, crushed])
def test_the_message_is_that_of_one_rank(start):
    together, alone = text_of(start(COMM)), text_of(start(None))
    assert together == alone
