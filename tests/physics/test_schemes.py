"""Every transfer with every spline on an axis-aligned manufactured solution: the error that theory of the scheme gives.

u = A sin(k X) sin(w t) in a periodic box, neo-Hookean with nu = 0, A k = 0.1, w = k sqrt(E / rho), the body force of
Wallstedt and Guilkey, J. Comput. Phys. 227 (2008) 9628, at 2 particles per cell and direction and dt = 0.2 dx / sqrt(E / rho).
The expected numbers come from an independent one-dimensional program of the same schemes, rounded to two digits.
"""

import math

import numpy as np
import pytest

from pmpm.physics.words import cos, sin
from pmpm.scene.schema import Scene
from pmpm.simulation import Simulation

K = W = 2.0 * math.pi
A = 0.1 / K
# Largest e_u over one period at 32 cells, and at 64 of some: sqrt(mean |u - u_exact|^2) over the largest such mean of u_exact.
EXPECTED = {
    ("flip", "linear"): (0.15, 0.29),  # cell crossing: refining makes it worse
    ("flip", "quadratic"): (6.1e-2,),
    ("flip", "cubic"): (8.0e-2,),
    ("apic", "linear"): (0.14, 0.32),
    ("apic", "quadratic"): (3.1e-2, 8.0e-3),
    ("apic", "cubic"): (4.0e-2,),
    ("mls", "quadratic"): (2.6e-2,),
    ("mls", "cubic"): (3.6e-2,),
    ("pic", "quadratic"): (0.44,),
}
ROUNDED = 0.04  # half a unit in the second digit of 1.4 is 3.6 %


def body_force(x, X, t):
    motion = sin(W * t)
    u, F = A * sin(K * X[0]) * motion, 1.0 + A * K * cos(K * X[0]) * motion
    return (u * (K * K * (0.5 + 0.5 / (F * F)) - W * W), 0.0 * u)


def scene(cells, transfer, shape_function):
    dx = 1.0 / cells
    return Scene(
        domain={"size": [1.0, 8.0 * dx], "cell_size": dx, "periodic": ["x", "y"]},
        method={"transfer": transfer, "shape_function": shape_function}
        | ({"flip_blend": 1.0} if transfer == "flip" else {}),
        time={"end": 1.0, "step": 0.2 * dx},
        materials={"m": {"model": "neo_hookean", "density": 1.0, "youngs_modulus": 1.0, "poisson_ratio": 0.0}},
        bodies=[{"material": "m", "shape": {"type": "box", "min": [0.0, 0.0], "max": [1.0, 8.0 * dx]}}],
        body_force=body_force,
    )


def largest_error(scene):
    simulation = Simulation(scene)
    X, v = simulation.particles.X[:, 0], simulation.particles.v
    v[:, 0] = A * W * np.sin(K * X)
    simulation.particles.v = v
    reference, worst = math.sqrt(np.mean((A * np.sin(K * X)) ** 2)), 0.0
    while not simulation.finished:
        simulation.step()
        X = simulation.particles.X[:, 0]
        u = simulation.particles.x[:, 0] - X
        error = u - np.round(u) - A * np.sin(K * X) * math.sin(W * simulation.time)
        worst = max(worst, math.sqrt(np.mean(error**2)) / reference)
    return worst


@pytest.mark.parametrize(("transfer", "shape_function"), EXPECTED)
def test_the_error_of_a_scheme_is_that_of_an_independent_program(transfer, shape_function):
    for cells, expected in zip((32, 64), EXPECTED[transfer, shape_function], strict=False):
        assert largest_error(scene(cells, transfer, shape_function)) == pytest.approx(expected, rel=ROUNDED)
