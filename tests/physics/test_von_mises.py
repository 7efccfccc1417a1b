"""Metal: radial return in logarithmic strains against the curves that linear hardening has in closed form."""

import math

import numpy as np
import pytest
from flat import flat, in_dimension
from materials_by_hand import Particle, deviator, in_space, mises, random_increment, simple_shear, stretch

from pmpm.physics import hencky

E, NU, YIELD, HARDENING = 200e9, 0.3, 250e6, 2e9
MU = E / 2.6
KEYS = {"model": "von_mises", "density": 7850.0, "youngs_modulus": E, "poisson_ratio": NU, "yield_stress": YIELD}
DIMS = (2, 3)
each_dimension = pytest.mark.parametrize("dim", DIMS)
each_hardening = pytest.mark.parametrize("hardening", [0.0, HARDENING])


def metal(dim, hardening=HARDENING, **keys):
    return Particle(dim, **KEYS | {"hardening_modulus": hardening} | keys)


def alpha(particle):
    return particle.rest[0] if particle.rest else None


def trials(dim, seed=1, count=100, **keys):
    """Pairs (trial strain in space, particle after the step) of random steps, most of them beyond yield."""
    random, size = np.random.default_rng(seed), 4 if dim == 2 else 6
    particle = metal(dim, **keys)
    for n in range(count):
        G = random_increment(random, dim, (1e-5, 1e-3, 1e-2)[n % 3])
        trial = in_dimension(hencky.trial_strain_solid, dim)(particle.state[:size], flat(G[:dim, :dim]))
        before = alpha(particle)
        particle.advance(G)
        yield (in_space(trial[:3], trial[3]) if dim == 2 else in_space(trial, None)), before, particle


@pytest.mark.parametrize("steps", [3, 50])
@each_hardening
def test_a_bar_in_tension_follows_the_two_straight_lines_of_linear_hardening(hardening, steps):
    # Beyond yield: stress s, strain e = s/E + (s - yield)/hardening, width -nu s/E - (e - s/E)/2 (Simo and Hughes 1998, 1.2).
    bar, before = metal(3, hardening), (0.0, 0.0)
    for n in range(1, steps + 1):
        strain = 0.01 * n / steps
        stress = min(E * strain, (hardening * strain + YIELD) / (1.0 + hardening / E))
        width = -NU * stress / E - 0.5 * (strain - stress / E)
        bar.advance(stretch(strain - before[0], width - before[1], width - before[1]))
        before = strain, width
        expected = np.diag([stress, 0.0, 0.0])
        assert np.abs(bar.tau() - expected).max() < 1e-11 * YIELD * n
        if hardening:
            assert alpha(bar) == pytest.approx(strain - stress / E, abs=1e-14)


@each_hardening
@each_dimension
def test_pure_shear_follows_the_two_straight_lines_of_linear_hardening(dim, hardening):
    # tau along x, -tau along y: q = sqrt(3) tau, and alpha grows by 2/sqrt(3) of the plastic stretch.
    block = metal(dim, hardening)
    for n in range(1, 21):
        block.advance(stretch(5e-4, -5e-4, 0.0))
        strain = 5e-4 * n
        yielding = (YIELD + 2.0 / math.sqrt(3.0) * hardening * strain) / math.sqrt(3.0) / (1.0 + hardening / (3.0 * MU))
        tau = min(2.0 * MU * strain, yielding)
        assert np.abs(block.tau() - np.diag([tau, -tau, 0.0])).max() < 1e-11 * YIELD * n


@each_hardening
@each_dimension
def test_simple_shear_follows_the_yield_curve(dim, hardening):
    block, step = metal(dim, hardening), 1e-4
    for n in range(1, 2001):
        block.advance(simple_shear(step))
        gamma = step * n
    shear = (YIELD / math.sqrt(3.0) + hardening / 3.0 * gamma) / (1.0 + hardening / (3.0 * MU))
    # The axes of the elastic strain lag behind by its own size, about yield / mu: second order in the shear stress.
    assert block.tau()[0, 1] == pytest.approx(shear, rel=10.0 * YIELD / MU)
    assert mises(block.tau()) == pytest.approx(math.sqrt(3.0) * shear, rel=10.0 * YIELD / MU)


@each_hardening
@each_dimension
def test_a_yielding_step_lands_on_the_surface(dim, hardening):
    landed = 0
    for trial, _, particle in trials(dim, hardening=hardening):
        limit = YIELD + (hardening * alpha(particle) if hardening else 0.0)
        q_trial, q = 2.0 * MU * math.sqrt(1.5) * np.linalg.norm(deviator(trial)), mises(particle.tau())
        assert q <= limit * (1.0 + 1e-12)
        if q_trial > limit:
            assert q == pytest.approx(limit, rel=1e-12)
            landed += 1
    assert landed > 30


@each_hardening
@each_dimension
def test_the_return_keeps_the_trace_and_the_direction(dim, hardening):
    for trial, _, particle in trials(dim, hardening=hardening):
        found = particle.strain
        assert abs(np.trace(found) - np.trace(trial)) < 1e-16
        s, s_trial = deviator(found), deviator(trial)
        assert np.abs(s / np.linalg.norm(s) - s_trial / np.linalg.norm(s_trial)).max() < 1e-10


@each_dimension
def test_alpha_grows_by_the_norm_of_the_plastic_strain(dim):
    for trial, before, particle in trials(dim):
        plastic = np.linalg.norm(trial - particle.strain)
        assert alpha(particle) - before == pytest.approx(math.sqrt(2.0 / 3.0) * plastic, abs=1e-15)


@each_hardening
@each_dimension
def test_inside_the_surface_nothing_changes(dim, hardening):
    particle = metal(dim, hardening)
    for _ in range(20):
        particle.advance(stretch(3e-5, -2e-5, 0.0))
    assert np.abs(particle.strain - np.diag([6e-4, -4e-4, 0.0])).max() < 1e-18
    assert not hardening or alpha(particle) == 0.0


@each_hardening
@each_dimension
def test_returning_twice_changes_nothing_more(dim, hardening):
    for _, _, particle in trials(dim, hardening=hardening):
        once = np.array(particle.state)
        particle.advance(np.zeros((3, 3)))
        assert np.abs(np.array(particle.state) - once).max() < 1e-16  # two eps of strains up to 0.05


@each_dimension
def test_an_unloaded_bar_yields_again_at_the_hardened_stress(dim):
    block = metal(dim)
    for _ in range(40):
        block.advance(stretch(5e-4, -5e-4, 0.0))
    peak = mises(block.tau())
    for sign in (-1.0, 1.0):
        for _ in range(2):
            block.advance(stretch(sign * 4e-4, -sign * 4e-4, 0.0))
    assert mises(block.tau()) == pytest.approx(peak, rel=1e-12)


def test_alpha_is_kept_only_where_the_metal_hardens():
    assert len(metal(3, 0.0).state) == 6
    assert len(metal(3).state) == 7


def test_pressure_never_yields():
    block = metal(3)
    for _ in range(50):
        block.advance(stretch(-0.01, -0.01, -0.01))
    assert np.abs(block.strain + 0.5 * np.eye(3)).max() < 1e-14
    assert alpha(block) < 1e-15
