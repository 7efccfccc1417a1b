"""Granular flow: the mu(I) rheology in steady simple shear, rest below the static friction, and the state free of contact."""

import math

import numpy as np
import pytest
from flat import EPS, in_dimension
from materials_by_hand import Particle, equivalent_shear, pressure, random_increment, simple_shear, stretch

from pmpm.physics.materials import mu_i

MU_S, MU_2, I_0, GRAIN, RHO_S = 0.38, 0.64, 0.279, 5e-4, 2450.0  # glass beads: Jop et al. (2006)
YOUNG = 1e9
KEYS = {
    "model": "mu_i",
    "density": 1470.0,
    "youngs_modulus": YOUNG,
    "poisson_ratio": 0.3,
    "static_friction": MU_S,
    "dynamic_friction": MU_2,
    "grain_diameter": GRAIN,
    "grain_density": RHO_S,
}
BULK, SHEAR = YOUNG / (3.0 * 0.4), YOUNG / 2.6
each_dimension = pytest.mark.parametrize("dim", [2, 3])


def grains(dim, p=1000.0, **keys):
    """Grains under the isotropic pressure p."""
    particle, each = Particle(dim, **KEYS | keys), -p / BULK / 3.0
    particle.state = (each, 0.0, each, each, 0.0) if dim == 2 else (each, 0.0, 0.0, each, 0.0, each, 0.0)
    return particle


def ratio(particle):
    return equivalent_shear(particle.tau()) / pressure(particle.tau())


def shear_rate(inertial_number, p):
    return inertial_number / GRAIN * math.sqrt(p / RHO_S)


def in_steady_shear(dim, inertial_number, p, shear=1e-3, steps=300):
    """Grains after so many steps that shear by `shear` each."""
    particle = grains(dim, p)
    for _ in range(steps):
        particle.advance(simple_shear(shear), shear / shear_rate(inertial_number, p))
    return particle


@pytest.mark.parametrize("p", [100.0, 10000.0])
@pytest.mark.parametrize("inertial_number", [1e-3, 0.03, 0.279, 1.0, 30.0])
@each_dimension
def test_steady_simple_shear_has_the_friction_of_its_inertial_number(dim, inertial_number, p):
    particle = in_steady_shear(dim, inertial_number, p)
    found = particle.tau()
    assert pressure(found) == pytest.approx(p, rel=1e-6)  # eps in each of 300 steps, of a strain of 1e-7 at 100 Pa
    friction = MU_S + (MU_2 - MU_S) / (I_0 / inertial_number + 1.0)
    # The elastic strain, p over the modulus, lags by its own size behind the flow that turns it; a step shears by 1e-3.
    assert ratio(particle) == pytest.approx(friction, rel=20.0 * p / SHEAR + 1e-6)


def test_the_steady_friction_does_not_depend_on_the_time_step():
    coarse, fine = (in_steady_shear(3, 0.1, 1000.0, shear) for shear in (1e-3, 1e-5))
    assert ratio(coarse) == pytest.approx(ratio(fine), rel=20.0 * 1000.0 / SHEAR)


@each_dimension
def test_below_the_static_friction_grains_are_elastic(dim):
    particle = grains(dim)
    gamma = 0.99 * MU_S * 1000.0 / SHEAR
    for _ in range(100):
        particle.advance(simple_shear(gamma / 100), 1e-3)
    loaded = equivalent_shear(particle.tau())
    assert loaded == pytest.approx(SHEAR * gamma, rel=1e-5)
    for _ in range(100):
        particle.advance(np.zeros((3, 3)), 1.0)
    assert equivalent_shear(particle.tau()) == pytest.approx(loaded, rel=1e-10)  # it rests, and does not creep


@each_dimension
def test_flow_that_is_stopped_relaxes_to_the_static_friction_and_no_further(dim):
    particle = in_steady_shear(dim, 0.3, 1000.0)
    assert ratio(particle) > MU_S + 0.1
    for _ in range(2000):
        particle.advance(np.zeros((3, 3)), 1e-5)
    assert ratio(particle) == pytest.approx(MU_S, rel=1e-9)


def test_the_fastest_flow_has_the_dynamic_friction():
    assert ratio(in_steady_shear(3, 1e5, 1000.0)) == pytest.approx(MU_2, rel=1e-5)


def test_the_shear_after_a_step_solves_the_quadratic_of_dunatunga_and_kamrin():
    # s^2 - (S_2 + s_trial + A) s + S_2 s_trial + S_0 A = 0, the root below S_2.
    random = np.random.default_rng(1)
    for _ in range(200):
        s_0 = 10.0 ** random.uniform(-6, 0)
        s_2 = s_0 * (1.0 + random.uniform(0, 2))
        trial, a = s_0 * (1.0 + 10.0 ** random.uniform(-6, 3)), 10.0 ** random.uniform(-8, 4)
        found = in_dimension(mu_i.sheared, 3)(trial, s_0, s_2, a)
        assert s_0 * (1.0 - 4.0 * EPS) <= found <= min(s_2, trial) * (1.0 + 4.0 * EPS)
        assert abs((trial - found) * (s_2 - found) - a * (found - s_0)) < 20.0 * EPS * (s_2 + trial + a) * trial


@each_dimension
def test_flow_keeps_the_volume_and_the_pressure(dim):
    particle, random = grains(dim), np.random.default_rng(2)
    for _ in range(50):
        G = random_increment(random, dim, 1e-3)
        G /= np.cbrt(np.linalg.det(np.eye(3) + G)) if dim == 3 else 1.0
        before = np.trace(particle.strain) + particle.rest[0]
        particle.advance(G, 1e-4)
        after = np.trace(particle.strain) + particle.rest[0]
        assert after - before == pytest.approx(math.log(np.linalg.det(np.eye(3) + G)), abs=1e-14)


@each_dimension
def test_grains_that_parted_bear_nothing_until_they_meet_again(dim):
    particle, step = grains(dim), stretch(*[1e-3] * dim + [0.0] * (3 - dim))
    log_J = -1000.0 / BULK
    for _ in range(50):
        particle.advance(step, 1e-4).advance(simple_shear(0.01), 1e-4)
        log_J += 1e-3 * dim
        assert (particle.tau() == 0.0).all()
        assert particle.rest[0] == pytest.approx(log_J, rel=1e-12)
    while log_J > 1e-3 * dim:
        particle.advance(np.linalg.inv(np.eye(3) + step) - np.eye(3), 1e-4)
        log_J -= 1e-3 * dim
        assert (particle.tau() == 0.0).all()
    particle.advance(stretch(*[-2e-3] * dim + [0.0] * (3 - dim)), 1e-4)
    assert pressure(particle.tau()) == pytest.approx(-BULK * (log_J - 2e-3 * dim), rel=1e-9)
    assert particle.rest[0] == 0.0


def test_the_friction_angle_is_the_steepest_incline_of_rest():
    # On an incline shear stress over pressure is the tangent: GDR MiDi, Eur. Phys. J. E 14 (2004) 341.
    keys = KEYS | {"friction_angle": 20.9, "static_friction": None}
    assert mu_i.parameters(keys | {"reference_inertial_number": I_0}, 3)[2] == math.tan(math.radians(20.9))


def test_equal_frictions_make_a_law_without_rate():
    particle = grains(3, dynamic_friction=MU_S)
    for n in range(100):
        particle.advance(simple_shear(1e-4), 10.0 ** -(n % 7))
    assert ratio(particle) == pytest.approx(MU_S, rel=1e-12)
