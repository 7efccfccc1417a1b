"""What drives material from outside gives the bits of one rank on several: see tests/physics/test_drive.py for what it does."""

import numpy as np
import pytest
from mpi4py import MPI

from pmpm.scene.schema import Scene
from pmpm.simulation import Simulation

pytestmark = pytest.mark.mpi(min_size=2)

RUBBER = {"model": "neo_hookean", "density": 1000.0, "youngs_modulus": 1e4, "poisson_ratio": 0.45}


def swaying(x, X, t):
    return (40.0 * (X[0] - x[0]) + 30.0 * t, 2.0 * X[1] - x[1])


def floor_velocity(time):
    return (0.3 * time, 0.0)


def scene():
    """A slab on a floor that speeds up, pressed by a platen, pulled, swayed, ramped and damped; FLIP with F-bar."""
    return Scene(
        domain={
            "size": [1.2, 0.6],
            "cell_size": 0.05,
            "gravity": [0.0, -3.0],
            "walls": {
                "y_min": {"type": "friction", "coefficient": 0.5, "velocity": floor_velocity},
                "x_max": {"type": "slip", "velocity": [0.0, 0.1]},
            },
        },
        method={"transfer": "flip", "flip_blend": 0.97, "f_bar": True, "damping": 0.5},
        time={"end": 10.0, "ramp": 0.05},
        materials={"rubber": RUBBER},
        bodies=[
            {
                "material": "rubber",
                "shape": {"type": "box", "min": [0.1, 0.0], "max": [1.0, 0.3]},
                "velocity": [1.0, 0.0],
            }
        ],
        body_force=swaying,
        loads=[{"shape": {"type": "box", "min": [0.4, 0.1], "max": [0.8, 0.2]}, "force": [20.0, 60.0]}],
        motions=[{"shape": {"type": "box", "min": [0.2, 0.25], "max": [0.9, 0.5]}, "velocity": [0.4, -0.2]}],
        colliders=[
            {"name": "bump", "shape": {"type": "capsule", "start": [0.3, 0.0], "end": [0.9, 0.05], "radius": 0.05}},
            {
                "name": "wheel",
                "shape": {"type": "box", "min": [0.5, 0.2], "max": [0.7, 0.3]},
                "surface": {"type": "friction", "coefficient": 0.4},
                "angular_velocity": 200.0,
                "velocity": [0.1, 0.0],
            },
        ],
    )


def ring():
    """A ball across the end of a ring goes round in it, and a box through the end, turning."""
    return Scene(
        domain={"size": [1.2, 0.6], "cell_size": 0.05, "periodic": ["x"], "gravity": [0.0, -3.0]},
        time={"end": 10.0},
        materials={"rubber": RUBBER},
        bodies=[{"material": "rubber", "shape": {"type": "box", "min": [0.0, 0.0], "max": [1.2, 0.5]}}],
        colliders=[
            {"shape": {"type": "sphere", "center": [1.2, 0.2], "radius": 0.1}, "velocity": [-1.0, 0.0]},
            {
                "shape": {"type": "box", "min": [1.0, 0.4], "max": [1.18, 0.45]},
                "surface": {"type": "friction", "coefficient": 0.4},
                "angular_velocity": 200.0,
                "velocity": [0.6, 0.0],
            },
        ],
    )


def run(comm, scene=scene, steps=150):
    simulation = Simulation(scene(), comm)
    simulation.run(steps=steps)
    return simulation


def bits(simulation):
    """Rows of all ranks in the one global order."""
    own = simulation.fields(["id", "x", "velocity", "stress", "deformation_gradient"])
    return {name: np.concatenate(simulation.comm.gather(rows)).tobytes() for name, rows in own.items()}


def test_what_drives_from_outside_gives_the_bits_of_one_rank():
    together, alone = run(MPI.COMM_WORLD), run(None)
    sent = np.array(together.report()["sent"])
    assert sent[~np.eye(len(sent), dtype=bool)].any()
    assert alone.particles.J.min() < 0.97  # the platen has pressed
    assert together.measure() == alone.measure()
    assert bits(together) == bits(alone)


def test_colliders_come_in_again_on_a_periodic_axis_with_the_bits_of_one_rank():
    together, alone = run(MPI.COMM_WORLD, ring, 80), run(None, ring, 80)
    assert alone.drive.obstacles[1].box()[1][0] > 1.23
    assert alone.impulses()["collider_1"][0].any()
    assert repr(together.impulses()) == repr(alone.impulses())
    assert bits(together) == bits(alone)
