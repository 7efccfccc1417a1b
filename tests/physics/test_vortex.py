"""The generalized vortex: a body force that balances, its order, and a shear of seven; scenes in benchmarks/cases/vortex.py."""

import cases
import numpy as np
import pytest
from cases import vortex

STEP = 1e-5  # of finite differences


def places():
    generator = np.random.default_rng(0)
    R, angle = 0.76 + 0.48 * generator.random(50), 2.0 * np.pi * generator.random(50)
    return vortex.CENTRE + np.stack([R * np.cos(angle), R * np.sin(angle)], axis=-1)


def first_piola(F):
    """Neo-Hookean, J = 1: mu (F - F^-T)."""
    return vortex.SHEAR_MODULUS * (F - np.linalg.inv(F).swapaxes(1, 2))


def test_the_body_force_is_what_is_left_of_inertia_and_stress():
    ring, X, t = vortex.Vortex(0.3), places(), 0.37
    divergence = np.zeros_like(X)
    for axis in range(2):
        shift = STEP * np.eye(2)[axis]
        ends = [first_piola(ring.deformation(X + sign * shift, t))[:, :, axis] for sign in (1.0, -1.0)]
        divergence += (ends[0] - ends[1]) / (2.0 * STEP)
    moved = [ring.velocity(X, t + sign * STEP) for sign in (1.0, -1.0)]
    expected = (moved[0] - moved[1]) / (2.0 * STEP) - divergence / vortex.DENSITY
    found = [ring.body_force(x, x, t) for x in X]
    assert np.abs(found - expected).max() < 1e-7 * np.abs(expected).max()


def test_the_motion_has_the_gradient_that_it_says_and_changes_no_volume():
    ring, X, t = vortex.Vortex(1.0), places(), 0.2
    F = ring.deformation(X, t)
    for axis in range(2):
        shift = STEP * np.eye(2)[axis]
        column = (ring.displacement(X + shift, t) - ring.displacement(X - shift, t)) / (2.0 * STEP)
        assert np.abs(column + np.eye(2)[axis] - F[:, :, axis]).max() < 1e-5
    assert np.linalg.det(F) == pytest.approx(np.ones(len(X)), abs=1e-12)


def test_errors_fall_with_order_one_and_a_half_at_least():
    found = [vortex.measure(None, 0.1, cells, particles_per_cell=16) for cells in (20, 40)]
    assert cases.order([run.e_u for run in found], (1 / 20, 1 / 40)) > 1.5  # measured 1.92
    assert found[1].e_J < 0.01  # measured 0.003
    assert found[1].turned == pytest.approx(1.0, abs=0.01)  # measured 1.0004


def test_a_shear_of_seven_comes_to_its_end():
    # Stretch makes waves up to seven times faster: the step must follow.
    assert np.isfinite(vortex.measure(None, 1.0, 20, cfl=0.4).e_u)
