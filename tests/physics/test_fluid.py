"""Viscosity, tension and the three ways to give a fluid its stiffness."""

import math

import numpy as np
import pytest
from flat import flat, in_dimension, random_rotation, symmetric
from materials_by_hand import Particle, pressure

import pmpm
from pmpm.kernels import targets
from pmpm.physics import stability, tensors2, tensors3
from pmpm.physics.materials import fluid, law_of

KEYS = {"model": "fluid", "density": 1000.0, "bulk_modulus": 1e6, "viscosity": 2.0}
each_dimension = pytest.mark.parametrize("dim", [2, 3])


def viscous_stress(dim, J, L, **keys):
    particle = Particle(dim, **KEYS | keys)
    return symmetric(particle("viscous_stress", (J,), flat(L), particle.params))


@each_dimension
def test_viscous_stress_is_twice_the_viscosity_times_the_deviator_of_the_rate_of_strain(dim):
    # Kirchhoff's: J times Cauchy's. The deviator is that of space: in the plane a third of the trace goes, not a half.
    random = np.random.default_rng(1)
    for _ in range(20):
        L, J = random.normal(size=(dim, dim)), random.uniform(0.8, 1.2)
        D = 0.5 * (L + L.T) - np.trace(L) / 3.0 * np.eye(dim)
        assert np.abs(viscous_stress(dim, J, L) - J * 2.0 * 2.0 * D).max() < 1e-14


@each_dimension
def test_a_rotating_fluid_has_no_viscous_stress(dim):
    spin = np.random.default_rng(2).normal(size=(dim, dim))
    assert (viscous_stress(dim, 1.0, spin - spin.T) == 0.0).all()


@each_dimension
def test_viscous_stress_turns_with_the_observer(dim):
    random = np.random.default_rng(3)
    L, Q = random.normal(size=(dim, dim)), random_rotation(random, dim)
    assert np.abs(viscous_stress(dim, 1.0, Q @ L @ Q.T) - Q @ viscous_stress(dim, 1.0, L) @ Q.T).max() < 1e-13


@each_dimension
def test_kinematic_viscosity_is_that_over_the_current_density(dim):
    particle = Particle(dim, **KEYS)
    assert particle("kinematic_viscosity", (0.5,), particle.params, 1000.0) == pytest.approx(2.0 / 2000.0)


def test_a_fluid_without_viscosity_compiles_none():
    assert not fluid.choices(Particle(2, **KEYS | {"viscosity": 0.0}).keys)["VISCOUS"]
    assert fluid.choices(Particle(2, **KEYS).keys)["VISCOUS"]


@each_dimension
def test_viscosity_shortens_the_step_to_that_of_diffusion(dim):
    # Stable for dt < dx^2 / (2 d nu 4/3) where viscosity rules: symplectic Euler's 2/(4/3 nu k^2), k^2 = 4 d / dx^2.
    particle, dx = Particle(dim, **KEYS | {"viscosity": 1e6}), 0.01
    bound = in_dimension(stability.signal_speed_squared, dim, law=law_of("fluid"), **particle.choices)
    speed = math.sqrt(bound((1.0,), particle.params, 1000.0, 1.0 / dx))
    nu = 1e6 / 1000.0
    assert dx / (speed * math.sqrt(dim)) == pytest.approx(dx * dx / (2.0 * dim * nu * 4.0 / 3.0), rel=1e-3)


# ---- tension -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("gamma", [1.0, 7.0])
def test_without_the_cut_off_taits_equation_goes_on_below_zero(gamma):
    particle = Particle(3, **KEYS | {"tension_cutoff": False, "gamma": gamma})
    for J in (0.9, 1.01, 1.5, 4.0):
        assert pressure(particle.tau((J,))) / J == pytest.approx(1e6 / gamma * (J**-gamma - 1.0), rel=1e-12)


@pytest.mark.parametrize("gamma", [1.0, 7.0])
def test_without_the_cut_off_energy_is_the_work_of_pressure_both_ways(gamma):
    particle, h = Particle(3, **KEYS | {"tension_cutoff": False, "gamma": gamma}), 1e-5
    for J in (0.8, 1.2, 2.0):
        slope = (particle("energy", (J + h,), particle.params) - particle("energy", (J - h,), particle.params)) / (
            2 * h
        )
        assert -slope == pytest.approx(pressure(particle.tau((J,))) / J, rel=1e-7)


def test_with_the_cut_off_an_expanded_fluid_bears_nothing():
    particle = Particle(3, **KEYS)
    assert pressure(particle.tau((1.01,))) == 0.0
    assert particle("energy", (1.01,), particle.params) == 0.0


# ---- stiffness -----------------------------------------------------------------------------------------------------------


def test_the_three_ways_to_give_the_stiffness_agree():
    # c = 10 flow_speed keeps the density within 1 % (Monaghan 1994); B = rho0 c^2.
    found = [
        Particle(3, model="fluid", density=800.0, **{name: value}).params
        for name, value in (("flow_speed", 2.0), ("sound_speed", 20.0), ("bulk_modulus", 800.0 * 400.0))
    ]
    assert found[0] == found[1] == found[2]


# ---- whole time steps ----------------------------------------------------------------------------------------------------


def periodic_shear(viscosity, cells=16, **method):
    """A fluid in a periodic square of 1 m with v_x = 0.01 sin(2 pi y) m/s, sound speed 1 m/s."""
    scene = pmpm.Scene(
        domain={"size": [1.0, 1.0], "cell_size": 1.0 / cells, "periodic": ["x", "y"]},
        method=method,
        time={"end": 1e3},
        materials={
            "oil": {
                "model": "fluid",
                "density": 1.0,
                "sound_speed": 1.0,
                "viscosity": viscosity,
                "tension_cutoff": False,
            }
        },
        bodies=[{"material": "oil", "shape": {"type": "box", "min": [0.0, 0.0], "max": [1.0, 1.0]}}],
    )
    simulation = pmpm.Simulation(scene)
    y = simulation.particles.x[:, 1]
    v, C = np.zeros((len(y), 2)), np.zeros((len(y), 2, 2))
    v[:, 0] = 0.01 * np.sin(2.0 * math.pi * y)
    C[:, 0, 1] = 0.02 * math.pi * np.cos(2.0 * math.pi * y)
    simulation.particles.v, simulation.particles.C = v, C
    return simulation


def amplitude(simulation):
    particles = simulation.particles
    return 2.0 * float(np.mean(particles.v[:, 0] * np.sin(2.0 * math.pi * particles.x[:, 1])))


def rate_of_decay(viscosity):
    simulation = periodic_shear(viscosity)
    simulation.run(until=0.2)
    start, first = simulation.time, amplitude(simulation)
    simulation.run(until=1.2)
    return -math.log(amplitude(simulation) / first) / (simulation.time - start)


def test_a_shear_wave_decays_at_the_rate_of_viscosity():
    # nu k^2. APIC damps waves of 16 cells by 0.03 / s, also without viscosity: the difference of two viscosities is free of
    # that. What is left is of the order of (k dx)^2 / 24 = 0.6 %; measured 0.2 %.
    assert rate_of_decay(0.02) - rate_of_decay(0.01) == pytest.approx(0.01 * (2.0 * math.pi) ** 2, rel=0.01)


def test_a_very_viscous_fluid_is_stable_at_the_default_cfl():
    simulation = periodic_shear(50.0, cells=8)
    x = simulation.particles.x
    noise = 0.01 * np.random.default_rng(4).normal(size=x.shape)
    simulation.particles.v = noise
    energy = simulation.measure()["kinetic"]
    simulation.run(steps=300)
    assert simulation.measure()["kinetic"] < energy


@pytest.mark.parametrize("J", [0.5, 0.9, 1.0, 1.5, 3.0, 10.0, 50.0])
def test_the_wave_speed_bounds_what_a_particle_alone_swings_with(J):
    # dtau/dlnJ of tau = -J p, which under tension grows with J; by central differences.
    params, eps = (1000.0, 7.0, 0.0), 1e-6
    whole = targets.plain(la=tensors2, TENSION_CUTOFF=False)
    stress, wave = whole.compile(fluid.kirchhoff_stress), whole.compile(fluid.wave_speed_squared)
    ends = [stress((J * math.exp(sign * eps),), params)[0] for sign in (1.0, -1.0)]
    assert wave((J,), params, 1.0) >= (ends[0] - ends[1]) / (2.0 * eps) * (1.0 - 1e-6)


@pytest.mark.parametrize("la", [tensors2, tensors3])
def test_the_volume_follows_the_determinant_of_the_step(la):
    dim = int(la.DIM)
    G = np.array([[0.1, 0.05, 0.0], [-0.2, 0.03, 0.1], [0.0, 0.2, -0.1]])[:dim, :dim]
    (J,) = targets.plain(la=la).compile(fluid.advance)((1.1,), tuple(map(float, G.ravel())), 1e-3, (1000.0, 7.0, 0.0))
    assert pytest.approx(1.1 * np.linalg.det(np.eye(dim) + G), rel=1e-14) == J


def test_a_drop_that_flies_apart_for_long_stays_a_number():
    # A lone particle's velocity gradient lasts: J would grow by e every 0.1 s, and pass the range of float32 after 9 s.
    scene = pmpm.Scene(
        domain={"size": [24.0, 24.0], "cell_size": 1.0},
        method={"precision": "float32"},
        time={"end": 100.0},
        materials={"m": {"model": "fluid", "density": 1000.0, "sound_speed": 10.0}},
        bodies=[
            {"material": "m", "shape": {"type": "box", "min": [8.0, 8.0], "max": [9.0, 9.0]}, "particles_per_cell": 1}
        ],
    )
    simulation = pmpm.Simulation(scene)
    simulation.particles.C = np.array([[[5.0, 0.0], [0.0, 5.0]]])
    simulation.run(until=10.0)
    assert simulation.particles.J[0] == fluid.LARGEST
    assert np.isfinite(simulation.particles.v).all()
