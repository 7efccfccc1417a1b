"""Mud: Bingham's and Herschel and Bulkley's stress in steady shear, rest below yield, and the pressure of the fluid."""

import math

import numpy as np
import pytest
from flat import flat_symmetric, in_dimension
from materials_by_hand import Particle, equivalent_shear, pressure, simple_shear, stretch

from pmpm.physics.materials import bingham

YIELD, SHEAR, BULK = 50.0, 1e6, 1e7
KEYS = {
    "model": "bingham",
    "density": 1500.0,
    "bulk_modulus": BULK,
    "shear_modulus": SHEAR,
    "yield_stress": YIELD,
    "viscosity": 3.0,
}
each_dimension = pytest.mark.parametrize("dim", [2, 3])
each_index = pytest.mark.parametrize("n", [0.3, 0.5, 1.0, 1.5, 2.0])


def mud(dim, **keys):
    return Particle(dim, **KEYS | keys)


def sheared(particle, rate, dt, steps):
    for _ in range(steps):
        particle.advance(simple_shear(rate * dt), dt)
    return particle


@pytest.mark.parametrize("rate", [0.1, 1.0, 10.0])
@each_index
@each_dimension
def test_steady_shear_stress_is_yield_stress_and_consistency_times_a_power_of_the_rate(dim, n, rate):
    particle, expected = mud(dim, flow_index=n), YIELD + 3.0 * rate**n
    sheared(particle, rate, 1e-4 / rate, 2000)
    # Elastic strains of stress over modulus are turned by the flow: second order in the shear, and 1e-4 of it in a step.
    assert particle.tau()[0, 1] == pytest.approx(expected, rel=1e-6)
    assert equivalent_shear(particle.tau()) == pytest.approx(expected, rel=1e-6)


@each_index
def test_the_steady_stress_does_not_depend_on_the_time_step(n):
    # Explicit viscosity would need dt < rho dx^2 / (4 eta); here a step may shear by 10 times the elastic strain.
    stresses = [equivalent_shear(sheared(mud(3, flow_index=n), 1.0, dt, 400).tau()) for dt in (5e-4, 5e-6)]
    assert stresses[0] == pytest.approx(stresses[1], rel=1e-5)


@each_index
@each_dimension
def test_below_yield_mud_is_elastic_and_rests(dim, n):
    particle = sheared(mud(dim, flow_index=n), 1.0, 0.99 * YIELD / SHEAR / 50, 50)
    loaded = equivalent_shear(particle.tau())
    assert loaded == pytest.approx(0.99 * YIELD, rel=1e-8)
    sheared(particle, 0.0, 10.0, 100)
    assert equivalent_shear(particle.tau()) == pytest.approx(loaded, rel=1e-12)
    sheared(particle, -1.0, 0.99 * YIELD / SHEAR / 50, 50)
    assert equivalent_shear(particle.tau()) < 1e-8 * YIELD


@each_index
@each_dimension
def test_stopped_mud_keeps_the_yield_stress(dim, n):
    particle = sheared(mud(dim, flow_index=n), 10.0, 1e-5, 2000)
    before = equivalent_shear(particle.tau())
    assert before > 1.05 * YIELD
    sheared(particle, 0.0, 1.0, 1)
    relaxed = equivalent_shear(particle.tau())
    assert YIELD <= relaxed < before
    sheared(particle, 0.0, 1e9, 3)
    assert equivalent_shear(particle.tau()) == pytest.approx(YIELD, rel=0.01 if n > 1.0 else 1e-6)


def test_bingham_relaxes_by_backward_euler():
    # d excess / dt = -(mu / eta) excess.
    particle, dt = sheared(mud(3), 10.0, 1e-5, 2000), 1e-6
    for _ in range(5):
        before = equivalent_shear(particle.tau()) - YIELD
        sheared(particle, 0.0, dt, 1)
        assert equivalent_shear(particle.tau()) - YIELD == pytest.approx(before / (1.0 + dt * SHEAR / 3.0), rel=1e-9)


@pytest.mark.parametrize("n", [0.1, 0.2, 0.5, 0.9, 0.999, 1.001, 1.5, 3.0, 10.0])
def test_newtons_method_solves_the_power_law_to_round_off(n):
    # y + time (excess / dt)^n / excess y^n = 1 for the share y that flows.
    function = in_dimension(bingham.share_of_flow, 3, LINEAR=False, THICKENING=n > 1.0)
    for log_k in np.linspace(-30.0, 30.0, 121):
        excess, dt = 1e-3, 1e-4
        time = math.exp(log_k) * dt**n / excess ** (n - 1.0)
        left = function(excess, dt, time, n)
        flown_from_left = math.exp((math.log(left) - log_k) / n)  # left = k y^n
        assert abs(flown_from_left + left - 1.0) < 1e-13 * max(1.0, abs(log_k) / n)


@each_dimension
def test_mud_without_yield_stress_is_a_newtonian_fluid(dim):
    particle = sheared(mud(dim, yield_stress=0.0), 2.0, 1e-5, 500)
    assert particle.tau()[0, 1] == pytest.approx(6.0, rel=1e-6)


@pytest.mark.parametrize("gamma", [1.0, 4.0, 7.0])
@each_dimension
def test_pressure_is_that_of_the_fluid(dim, gamma):
    particle, step = mud(dim, gamma=gamma), stretch(*[-0.01] * dim + [0.0] * (3 - dim))
    fluid = Particle(dim, model="fluid", density=1500.0, bulk_modulus=BULK, gamma=gamma)
    for _ in range(10):
        particle.advance(step)
        fluid.state = (particle.volume,)
        assert pressure(particle.tau()) == pytest.approx(pressure(fluid.tau()), rel=1e-11)
        assert particle.energy == pytest.approx(fluid.energy + particle_shear_energy(particle), rel=1e-10)


def particle_shear_energy(particle):
    s = particle.strain - np.trace(particle.strain) / 3.0 * np.eye(3)
    return SHEAR * np.tensordot(s, s)


def test_the_smallest_compression_makes_pressure():
    # Differences of powers would lose what is below eps.
    particle = mud(3).advance(-1e-20 * np.eye(3))
    assert pressure(particle.tau()) == pytest.approx(3e-20 * BULK, rel=1e-12)


@each_dimension
def test_opened_mud_bears_no_tension_and_remembers_its_volume(dim):
    particle, step = mud(dim), stretch(*[0.1] * dim + [0.0] * (3 - dim))
    for _ in range(20):
        particle.advance(step, 1e-4)
        assert abs(pressure(particle.tau())) < 1e-9 * YIELD
    assert particle.volume == pytest.approx(math.exp(2.0 * dim), rel=1e-12)


def test_what_has_opened_far_leaves_the_power_series_alone():
    # The trace is 3, beyond the reach of the series; the deviator, which alone is advanced, is not.
    particle, called = mud(3), []
    E = flat_symmetric(np.eye(3))

    def watched(D, G):
        called.append(np.abs(D).max())
        return D

    module = type("hencky", (), {"trial_strain_solid": staticmethod(watched), "kept_if_forward": lambda G: 1.0})
    in_dimension(bingham.advance, 3, hencky=module)(E, (0.0,) * 9, 1e-3, particle.params)
    assert called == [0.0]
