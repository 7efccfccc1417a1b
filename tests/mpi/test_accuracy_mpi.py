"""Errors against an exact solution are the same bits on any number of ranks, and what is wrong with it ends all of them."""

import numpy as np
import pytest
from mpi4py import MPI

import pmpm

pytestmark = pytest.mark.mpi(min_size=2)

WATER = {"model": "fluid", "density": 1000.0, "sound_speed": 4.0}
RUBBER = {"model": "neo_hookean", "density": 1000.0, "youngs_modulus": 1e4, "poisson_ratio": 0.3}


def churn(X, t):
    """A product of matrices and a sum, of which numpy rounds each to its own taste."""
    return (
        0.01
        * np.stack((np.sin(9.0 * X[:, 1]), np.cos(7.0 * X[:, 0] - t)), axis=1)
        @ np.array([[1.0, 0.3], [0.2, -0.9]])
    )


def squeeze(X, t):
    F = np.zeros((len(X), 2, 2))
    F[:, 0, 0], F[:, 1, 1], F[:, 0, 1] = 1.0 - 0.1 * X[:, 0], 1.0 + 0.1 * np.sin(X[:, 1]), 0.05
    return F


def spot(X, t):
    return np.where((X[:, :1] > 1.1) & (0.0 < t < 1.0), np.nan, 0.0) + 0.0 * X


def scene(displacement):
    shapes = [{"type": "box", "min": [low, 0.05], "max": [low + 0.55, 0.35]} for low in (0.05, 0.6)]
    return pmpm.Scene(
        domain={"size": [1.2, 0.6], "cell_size": 0.05, "gravity": [0.0, -3.0], "periodic": ["x"]},
        time={"end": 1.0},
        materials={"rubber": RUBBER, "water": WATER},
        bodies=[
            {"material": name, "shape": shape, "velocity": [0.8, 0.0]}
            for name, shape in zip(("rubber", "water"), shapes, strict=True)
        ],
        exact={"displacement": displacement, "velocity": churn, "deformation": squeeze},
    )


def errors_of(comm):
    simulation = pmpm.Simulation(scene(churn), comm)
    errors = pmpm.Errors(simulation)
    simulation.every(errors, steps=5, at_start=True)
    simulation.run(steps=60)
    return simulation, errors


def test_errors_are_those_of_one_rank():
    (together, many), (_, one) = errors_of(MPI.COMM_WORLD), errors_of(None)
    sent = np.array(together.report()["sent"])
    assert sent[~np.eye(len(sent), dtype=bool)].any()
    assert set(many.last) == {"displacement", "velocity", "deformation", "J"}
    assert (many.largest, many.last, many.reference_rms) == (one.largest, one.last, one.reference_rms)


def test_a_function_that_fails_on_one_rank_is_told_on_all():
    simulation = pmpm.Simulation(scene(spot), MPI.COMM_WORLD)
    errors = pmpm.Errors(simulation)
    simulation.time = 0.5
    with pytest.raises(pmpm.SceneError, match=r"scene: exact.displacement = spot must return finite numbers"):
        errors(simulation)
