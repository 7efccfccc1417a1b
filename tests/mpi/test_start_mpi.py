"""Functions of position, displaced bodies and laws of one's own give the bits of one rank on several, and fail together."""

import numpy as np
import own_laws
import pytest
from mpi4py import MPI

import pmpm

pytestmark = pytest.mark.mpi(min_size=2)


def churn(X):
    """A product of matrices and a sum, of which numpy rounds each to its own taste."""
    return np.stack((np.sin(9.0 * X[:, 1]), np.cos(7.0 * X[:, 0])), axis=1) @ np.array([[1.0, 0.3], [0.2, -0.9]])


def across(X):
    """Far over the cuts, and so that particles from several layers come to lie in one cell."""
    return np.stack((1.5 - 0.6 * X[:, 0] + 0.3 * X[:, 1], 0.02 * np.sin(40.0 * X[:, 0])), axis=1)


def squeeze(X):
    F = np.zeros((len(X), 2, 2))
    F[:, 0, 0], F[:, 1, 1], F[:, 0, 1] = 1.0 - 0.1 * X[:, 0], 1.0 + 0.1 * np.sin(X[:, 1]), 0.05
    return F


def displaced(**body):
    return pmpm.Scene(
        domain={"size": [2.0, 0.4], "cell_size": 0.04, "gravity": [0.0, -9.81], "periodic": ["x"]},
        time={"end": 0.1},
        materials={
            "rubber": {"model": "neo_hookean", "density": 1e3, "youngs_modulus": 1e5, "poisson_ratio": 0.3},
            "sand": {
                "model": "drucker_prager", "density": 1e3, "youngs_modulus": 1e5, "poisson_ratio": 0.3, "friction_angle": 30
            },
        },
        bodies=[
            {
                "material": "rubber",
                "shape": {"type": "box", "min": [0.0, 0.1], "max": [2.0, 0.3]},
                "particles_per_cell": 5,
                "velocity": churn,
                "displacement": across,
                "deformation": squeeze,
            }
            | body,
            {
                "material": "sand",
                "shape": {"type": "box", "min": [0.0, 0.0], "max": [2.0, 0.1]},
                "stress": {"type": "geostatic"},
            },
        ],
    )  # fmt: skip


def rows(simulation, names):
    own = simulation.fields(names)
    return {name: np.concatenate(simulation.comm.gather(values)).tobytes() for name, values in own.items()}


@pytest.mark.parametrize("steps", [0, 20])
def test_a_displaced_start_has_the_bits_of_one_rank_on_several(steps):
    together, alone = pmpm.Simulation(displaced(), MPI.COMM_WORLD), pmpm.Simulation(displaced())
    for simulation in (together, alone):
        simulation.run(steps=steps)
    names = ["id", "x", "velocity", "stress", "F", "hencky_strain"]
    assert rows(together, names) == rows(alone, names)


def test_a_law_with_a_state_has_the_bits_of_one_rank_on_several():
    together, alone = pmpm.Simulation(own_laws.scene(), MPI.COMM_WORLD), pmpm.Simulation(own_laws.scene())
    for simulation in (together, alone):
        simulation.run(steps=40)
    names = ["id", "x", "velocity", "stress", "damage", "most"]
    assert rows(together, names) == rows(alone, names)
    assert alone.particles.damage.max() > 0.1


def test_all_ranks_are_told_of_the_first_particle_that_starts_outside():
    def lift(X):
        return np.stack((0.0 * X[:, 0], 0.5 * (X[:, 0] > 1.2)), axis=1)

    messages = []
    for comm in (MPI.COMM_WORLD, None):
        with pytest.raises(pmpm.SceneError) as raised:
            pmpm.Simulation(displaced(displacement=lift), comm)
        messages.append(str(raised.value))
    assert len(set(MPI.COMM_WORLD.allgather(messages[0]))) == 1
    assert messages[0] == messages[1]
