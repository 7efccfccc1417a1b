"""Particles with shares of a volume have the bits of one rank on several: where they are put, and after some steps."""

import numpy as np
import pytest
import random_cuts
from mpi4py import MPI

import pmpm

pytestmark = pytest.mark.mpi(min_size=2)


def two_balls():
    """Two balls of which cells are cut, one pushed over the cuts, and a load on one of them."""
    rubber = {"model": "neo_hookean", "density": 1e3, "youngs_modulus": 1e5, "poisson_ratio": 0.3}
    left = {"type": "sphere", "center": [0.8, 0.33, 0.3], "radius": 0.19}
    return pmpm.Scene(
        domain={"size": [2.4, 0.6, 0.6], "cell_size": 0.1, "gravity": [0.0, -1.0, 0.0]},
        time={"end": 1.0},
        materials={"rubber": rubber},
        bodies=[
            {"material": "rubber", "shape": left, "seeding": "quadrature", "velocity": [3.0, 0.0, 0.0]},
            {"material": "rubber", "shape": left | {"center": [1.5, 0.3, 0.3]}, "seeding": "poisson_disk"},
        ],
        loads=[{"shape": left, "force": [50.0, 0.0, 0.0]}],
    )


def test_particles_with_shares_have_the_bits_of_one_rank_on_several():
    together, alone = pmpm.Simulation(two_balls(), MPI.COMM_WORLD), pmpm.Simulation(two_balls())
    for steps in (0, 30):
        for simulation in (together, alone):
            simulation.run(steps=steps)
        assert random_cuts.state_bits(together) == random_cuts.state_bits(alone)
        assert together.measure() == alone.measure()
    share = np.concatenate(MPI.COMM_WORLD.allgather(together.particles.share))
    assert 0.0 < share.min() < 0.5
    assert share.max() == 1.0
