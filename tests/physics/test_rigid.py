"""What flies, falls or spins as a rigid body does not strain; scenes and steady states stand in benchmarks/cases/rigid.py."""

import numpy as np
import pytest
from cases import rigid

import pmpm

PRECISIONS = ("float64", "float32")
TRANSFERS = ("apic", "mls")


@pytest.mark.parametrize("velocity", [(100.0, 0.0), (80.0, 50.0)])
@pytest.mark.parametrize("precision", PRECISIONS)
def test_free_flight_strains_nothing_and_keeps_its_velocity(precision, velocity):
    simulation = pmpm.Simulation(rigid.flying(velocity, 40, precision))
    eps = np.finfo(simulation.real).eps
    simulation.run()
    v, F, x = rigid.deviations(simulation)
    # Measured: 20 eps and 94 eps over 200 steps.
    assert v < 100.0 * eps * 100.0
    assert 500.0 * eps > F
    # Each of 200 steps rounds an offset of about a cell.
    assert x < 200.0 * eps * simulation.step_count


@pytest.mark.parametrize("precision", PRECISIONS)
def test_free_fall_is_the_parabola_of_symplectic_euler(precision):
    simulation = pmpm.Simulation(rigid.falling(400, precision))
    eps = np.finfo(simulation.real).eps
    simulation.run()
    v, F, x = rigid.deviations(simulation)
    assert v < 500.0 * eps
    assert x < 500.0 * eps
    assert 100.0 * eps > F


def test_the_disk_that_spins_is_in_equilibrium():
    """P_R' + (P_R - P_T) / R = -rho0 w^2 r, by differences over the profile, and P_R = 0 at the edge."""
    R, r, slope = rigid.Spinning().profile
    middle = slice(1, None)
    R, F_R, F_T = R[middle], slope[middle], r[middle] / R[middle]
    log_J = np.log(F_R * F_T)
    P_R, P_T = (rigid.MU * (s - 1.0 / s) + rigid.LAM * log_J / s for s in (F_R, F_T))
    load = rigid.MATERIAL["density"] * rigid.SPIN**2 * r[middle]
    left = np.gradient(P_R, R, edge_order=2) + (P_R - P_T) / R + load
    assert np.abs(left[1:-1]).max() < 1e-4 * load.max()
    assert abs(P_R[-1]) < 1e-9 * rigid.MU
    # Linear elasticity, plane strain: the edge moves by (1 - 2 nu)(1 + nu) rho w^2 R^2 / (4 E).
    assert F_T[-1] - 1.0 == pytest.approx(0.4 * 1.3 * 1e-3 / 4.0, rel=2e-3)


@pytest.mark.parametrize("transfer", TRANSFERS)
def test_a_spinning_disk_keeps_its_shape_and_its_angular_momentum_over_a_thousand_steps(transfer):
    body = rigid.Spinning()
    simulation = body.simulation(10.0, transfer)
    before = simulation.measure()["angular_momentum_z"]
    simulation.run(steps=1000)
    assert simulation.measure()["angular_momentum_z"] == pytest.approx(before, rel=1e-10)
    # Measured 3e-5 cells after a fifth of a turn; the centrifugal stretch alone is 7e-4 of them.
    assert body.out_of_shape(simulation) < 1e-4 * body.cell_size
