"""Modified Cam-Clay against its closed forms: consolidation lines, undrained and drained tests, the critical state."""

import math

import numpy as np
import pytest
from flat import flat, in_dimension
from materials_by_hand import Particle, in_space, mises, pressure, random_increment, simple_shear, stretch

from pmpm.physics import hencky
from pmpm.physics.materials import cam_clay

KAPPA, LAMBDA, M, INITIAL, LARGEST = 0.02, 0.1, 1.2, 50e3, 100e3
KEYS = {
    "model": "cam_clay",
    "density": 1800.0,
    "shear_modulus": 3e6,
    "swelling_index": KAPPA,
    "compression_index": LAMBDA,
    "critical_state_slope": M,
    "preconsolidation_pressure": LARGEST,
    "initial_pressure": INITIAL,
}
DIMS = (2, 3)
each_dimension = pytest.mark.parametrize("dim", DIMS)


def clay(dim=3, **keys):
    return Particle(dim, **KEYS | keys)


def consolidation(particle):
    """P_c in Pa: the attraction added."""
    _, kappa, slope, _, P_0, log_ratio, *_ = particle.params
    return P_0 * math.exp(log_ratio - particle.rest[0] / (slope - kappa))


def compress(particle, volume_strain):
    return particle.advance(stretch(*[-volume_strain / 3.0] * 3))


@pytest.mark.parametrize("steps", [1, 7, 100])
def test_isotropic_compression_is_the_swelling_line_and_then_the_line_of_first_loading(steps):
    # ln p = ln p_0 - v / kappa up to the preconsolidation pressure, from there on with lambda.
    particle, elastic = clay(), KAPPA * math.log(LARGEST / INITIAL)
    for _ in range(steps):
        compress(particle, 0.9 * elastic / steps)
    assert math.log(pressure(particle.tau()) / INITIAL) == pytest.approx(0.9 * elastic / KAPPA, rel=1e-12)
    for n in range(1, steps + 1):
        compress(particle, (0.1 * elastic if n == 1 else 0.0) + 0.15 / steps)
        expected = math.log(LARGEST) + 0.15 * n / steps / LAMBDA
        assert math.log(pressure(particle.tau())) == pytest.approx(expected, rel=1e-13)
        assert consolidation(particle) == pytest.approx(pressure(particle.tau()), rel=1e-12)


@pytest.mark.parametrize("steps", [1, 10])
def test_unloading_and_reloading_follow_the_swelling_line(steps):
    particle = compress(clay(), 0.2)
    top = pressure(particle.tau())
    for sign in (-1.0, 1.0):
        for n in range(1, steps + 1):
            compress(particle, sign * 0.05 / steps)
            done = n / steps if sign < 0.0 else 1.0 - n / steps
            assert pressure(particle.tau()) == pytest.approx(top * math.exp(-0.05 * done / KAPPA), rel=1e-11)
    assert consolidation(particle) == pytest.approx(top, rel=1e-11)


def undrained(particle, strain=0.002, steps=300):
    """Triaxial compression along z without change of volume."""
    for _ in range(steps):
        particle.advance(stretch(0.5 * strain, 0.5 * strain, -strain))
    return particle


@pytest.mark.parametrize("preconsolidation", [50e3, 100e3, 1000e3], ids=["normal", "light", "heavy"])
def test_undrained_shear_ends_at_the_critical_state(preconsolidation):
    # kappa ln P + (lambda - kappa) ln P_c keeps its value, and at the end P_c = 2 P (Roscoe and Burland 1968).
    particle = undrained(clay(preconsolidation_pressure=preconsolidation), steps=600)
    P = math.exp((KAPPA * math.log(INITIAL) + (LAMBDA - KAPPA) * math.log(preconsolidation / 2.0)) / LAMBDA)
    # The approach is exponential in the strain: measured 1e-9 at 120 %.
    assert pressure(particle.tau()) == pytest.approx(P, rel=1e-7)
    assert mises(particle.tau()) == pytest.approx(M * P, rel=1e-7)
    assert consolidation(particle) == pytest.approx(2.0 * P, rel=1e-7)


@each_dimension
def test_simple_shear_ends_at_the_critical_state(dim):
    particle = clay(dim)
    for _ in range(1500):
        particle.advance(simple_shear(1e-3))
    P = math.exp((KAPPA * math.log(INITIAL) + (LAMBDA - KAPPA) * math.log(LARGEST / 2.0)) / LAMBDA)
    # The flow turns the elastic strain, M P / (2 mu) = 1 %: second order.
    assert pressure(particle.tau()) == pytest.approx(P, rel=1e-3)
    assert mises(particle.tau()) == pytest.approx(M * pressure(particle.tau()), rel=1e-3)


def drained_step(particle, axial, lateral_stress):
    """A step of triaxial compression at constant Kirchhoff stress across, found by bisection."""
    before, low, high = particle.state, -0.1, 0.1
    for _ in range(60):
        across = 0.5 * (low + high)
        particle.state = before
        particle.advance(stretch(across, across, -axial))
        if particle.tau()[0, 0] < -lateral_stress:
            low = across
        else:
            high = across


def test_drained_triaxial_compression_ends_where_the_stress_path_meets_the_critical_line():
    # q = 3 (p - p_0) and q = M p: p = 3 p_0 / (3 - M) (Wood 1990, chapter 5).
    particle = clay()
    for _ in range(120):
        drained_step(particle, 0.01, INITIAL)
        tau = particle.tau()
        assert mises(tau) == pytest.approx(3.0 * (pressure(tau) - INITIAL), rel=1e-6)
    p = 3.0 * INITIAL / (3.0 - M)
    # Exponential approach: measured 1e-4 at 120 %.
    assert pressure(particle.tau()) == pytest.approx(p, rel=1e-3)
    assert mises(particle.tau()) == pytest.approx(M * p, rel=1e-3)


def test_yield_begins_on_the_ellipse():
    # At p = 50 kPa and P_c = 100 kPa, the middle of the ellipse: q = M p.
    particle, before, step = clay(), 0.0, 1e-5
    while particle.rest[0] == 0.0:
        before = mises(particle.tau())
        particle.advance(stretch(0.5 * step, 0.5 * step, -step))
    assert before <= M * INITIAL <= before + 3.0 * 3e6 * step


def random_material(random):
    """Parameters of soils from stiff sand to soft clay."""
    kappa = 10.0 ** random.uniform(-2.5, -1.0)
    largest = 10.0 ** random.uniform(3, 6)
    attraction = random.choice([0.0, 0.1 * largest])
    return {
        "shear_modulus": largest * 10.0 ** random.uniform(0.8, 3),
        "swelling_index": kappa,
        "compression_index": kappa * random.uniform(1.5, 15.0),
        "critical_state_slope": random.uniform(0.5, 1.8),
        "preconsolidation_pressure": largest,
        "initial_pressure": largest * random.uniform(0.05, 1.0),
        "attraction": float(attraction),
    }


def trial_of(particle, G):
    """The trial strain in space."""
    dim, size = particle.dim, 4 if particle.dim == 2 else 6
    E = in_dimension(hencky.trial_strain_solid, dim)(particle.state[:size], flat(G[:dim, :dim]))
    return in_space(E[:3], E[3]) if dim == 2 else in_space(E, None)


def plastic_steps(dim, count=120, seed=1):
    """(particle after a yielding step, plastic strain in space) over random materials and steps from 1e-5 to 3e-2."""
    random = np.random.default_rng(seed)
    for _ in range(count):
        particle = clay(dim, **random_material(random))
        attraction = particle.params[6]
        for _ in range(4):
            G = random_increment(random, dim, 10.0 ** random.uniform(-5, -1.5))
            trial, before = trial_of(particle, G), particle.rest
            particle.advance(G)
            opened = attraction > 0.0 and particle.rest[1] > 0.0
            if particle.rest[0] != before[0] and not opened:
                plastic = trial - particle.strain
                if attraction > 0.0:
                    plastic = plastic + before[1] / 3.0 * np.eye(3)
                yield particle, plastic


@each_dimension
def test_a_yielding_step_lands_on_the_ellipse(dim):
    met = 0
    for particle, _ in plastic_steps(dim):
        P, P_c = pressure(particle.tau()) + particle.params[6], consolidation(particle)
        q = mises(particle.tau()) / particle.params[3]
        # Logarithms of pressures are strains over kappa, 0.003 at least.
        assert abs(q * q + P * (P - P_c)) < 1e-11 * P_c * P_c
        met += 1
    assert met > 150


@each_dimension
def test_plastic_flow_is_normal_to_the_ellipse(dim):
    # d(volume) : d(shear) = -(2 P - P_c) : 2 q / M^2, so that the equation of the return is solved, not only the surface met.
    for particle, plastic in plastic_steps(dim):
        P, P_c = pressure(particle.tau()) + particle.params[6], consolidation(particle)
        q, slope = mises(particle.tau()), particle.params[3]
        volume = np.trace(plastic)
        shear = math.sqrt(2.0 / 3.0) * np.linalg.norm(plastic - volume / 3.0 * np.eye(3))
        across, along = -(2.0 * P - P_c), 2.0 * q / slope**2
        error = abs(volume * along - shear * across) / math.hypot(across, along)
        assert error < 1e-13 + 1e-10 * math.hypot(volume, shear)


@each_dimension
def test_returning_twice_changes_nothing_more(dim):
    for particle, _ in plastic_steps(dim):
        once = np.array(particle.state)
        particle.advance(np.zeros((3, 3)))
        assert np.abs(np.array(particle.state) - once).max() < 1e-14


def test_heavily_consolidated_clay_peaks_dilates_and_softens():
    particle, q = clay(preconsolidation_pressure=1000e3), []
    for _ in range(60):
        drained_step(particle, 0.01, INITIAL)
        q.append(mises(particle.tau()))
    assert max(q) > 2.0 * q[-1]
    assert particle.rest[0] > 0.01
    assert consolidation(particle) < 1000e3


# ---- attraction: stiffness at zero pressure and the cut-off of tension --------------------------------------------------


def attracted(dim=3):
    return clay(dim, initial_pressure=0.0, attraction=10e3)


def test_at_zero_pressure_the_bulk_modulus_is_attraction_over_kappa():
    assert pressure(compress(attracted(), 1e-8).tau()) == pytest.approx(1e-8 * 10e3 / KAPPA, rel=1e-6)


@each_dimension
def test_the_mean_stress_is_never_tension(dim):
    particle, random = attracted(dim), np.random.default_rng(3)
    for _ in range(100):
        particle.advance(random_increment(random, dim, 3e-3) + stretch(*[1e-3] * dim + [0.0] * (3 - dim)))
        assert pressure(particle.tau()) > -1e-12 * 10e3
    assert particle.rest[1] > 0.01


def test_opened_clay_bears_nothing_until_it_is_closed_again():
    particle, dim, step = attracted(), 3, [1e-3] * 3
    for _ in range(20):
        particle.advance(stretch(*step))
        assert abs(pressure(particle.tau())) < 1e-12 * 10e3
    opened = particle.rest[1]
    assert opened + np.trace(particle.strain) + particle.rest[0] == pytest.approx(20e-3 * dim, rel=1e-12)
    closing = 0.0
    while closing + 1e-3 * dim < opened:
        particle.advance(stretch(*[-s for s in step]))
        closing += 1e-3 * dim
        assert abs(pressure(particle.tau())) < 1e-12 * 10e3
    for _ in range(5):
        particle.advance(stretch(*[-s for s in step]))
    assert particle.rest[1] == 0.0
    assert pressure(particle.tau()) > 1e3


def test_shear_ends_at_q_of_the_pressure_and_the_attraction():
    particle = undrained(clay(attraction=10e3), steps=600)
    assert mises(particle.tau()) == pytest.approx(M * (pressure(particle.tau()) + 10e3), rel=1e-6)


def test_gap_is_kept_only_with_attraction():
    assert len(clay().state) == 7
    assert len(attracted().state) == 8


# ---- parameters ---------------------------------------------------------------------------------------------------------


@each_dimension
def test_a_fresh_particle_has_the_initial_pressure(dim):
    assert clay(dim).tau() == pytest.approx(-INITIAL * np.eye(3), rel=1e-14)


def test_slope_of_the_critical_state_meets_mohr_coulomb_in_triaxial_compression():
    # sigma_1 = sigma_3 (1 + sin) / (1 - sin).
    sine = math.sin(math.radians(25.0))
    major = (1.0 + sine) / (1.0 - sine)
    assert cam_clay.critical_state_slope({"friction_angle": 25.0}) == pytest.approx(
        (major - 1.0) / ((major + 2.0) / 3.0)
    )
