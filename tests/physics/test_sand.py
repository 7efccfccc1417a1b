"""Drucker-Prager return map with volume correction (Klar et al. 2016; Tampubolon et al. 2017, 4.3.4), cohesion, dilatancy."""

import math

import numpy as np
import pytest
from flat import EPS, flat, flat_symmetric, in_dimension, of_eigenvalues, random_rotation, symmetric

from pmpm.physics import hencky
from pmpm.physics.materials import drucker_prager as sand

DIMS = (2, 3)
KEYS = {"density": 2000.0, "youngs_modulus": 1e6, "poisson_ratio": 0.3, "friction_angle": 30.0}


def law(name, dim, volume_correction=True):
    return in_dimension(getattr(sand, name), dim, VOLUME_CORRECTION=volume_correction)


def parameters(dim, friction_angle=30.0, fit=None):
    return sand.parameters(KEYS | {"friction_angle": friction_angle, "friction_fit": fit}, dim)


def advance(E, v_c, G, params):
    """(E, v_c) after a step, E as a matrix."""
    *strain, v_c = law("advance", len(E))((*flat_symmetric(E), v_c), flat(G), 1.0, params)
    return symmetric(tuple(strain)), v_c


def deviator(E):
    return E - np.trace(E) / len(E) * np.eye(len(E))


def by_numpy(E, G):
    """1/2 ln((I + G) exp(2 E) (I + G)^T)."""
    A = np.eye(len(E)) + G
    b = A @ of_eigenvalues(2.0 * E, np.exp) @ A.T
    return of_eigenvalues(0.5 * (b + b.T), lambda s: 0.5 * np.log(s))


def by_series(E, G):
    """The same for tiny E and G, by power series in which nothing cancels."""
    H = 2.0 * E + 2.0 * E @ E + 4.0 / 3.0 * E @ E @ E
    X = H + G + G.T + G @ H + H @ G.T + G @ G.T + G @ H @ G.T
    return 0.5 * (X - X @ X / 2.0 + X @ X @ X / 3.0)


def random_strain(random, dim, size, compression=0.0):
    A = size * random.normal(size=(dim, dim))
    return 0.5 * (A + A.T) - compression * np.eye(dim)


def trials(dim, seed, count=200, size=0.02):
    """Random (E, v_c, G) on which every branch of the return occurs."""
    random = np.random.default_rng(seed)
    for n in range(count):
        E = random_strain(random, dim, size, compression=(0.0, 0.02, 0.2)[n % 3])
        v_c = 0.01 * max(random.normal(), 0.0)
        yield E, v_c, size * random.normal(size=(dim, dim))


def branch(E_trial, v_c, params):
    """Which branch the paper takes for this trial strain."""
    trace = np.trace(E_trial) + v_c
    if trace >= 0.0:
        return "tip"
    return "elastic" if np.linalg.norm(deviator(E_trial)) <= -params[2] * trace else "shear"


@pytest.mark.parametrize("dim", DIMS)
def test_trial_strain_is_the_logarithm_of_the_advanced_b(dim):
    for E, _, G in trials(dim, 1, size=0.1):
        found = symmetric(in_dimension(hencky.trial_strain, dim)(flat_symmetric(E), flat(G)))
        assert np.abs(found - by_numpy(E, G)).max() < 1e-14


@pytest.mark.parametrize("size", [1e-12, 1e-8, 1e-6])
@pytest.mark.parametrize("dim", DIMS)
def test_trial_strain_keeps_all_digits_of_small_strains(dim, size):
    for E, _, G in trials(dim, 2, count=50, size=size):
        E = size * E / np.abs(E).max()
        found = symmetric(in_dimension(hencky.trial_strain, dim)(flat_symmetric(E), flat(G)))
        # A logarithm of b itself would be off by eps / size.
        assert np.abs(found - by_series(E, G)).max() < 20.0 * EPS * (np.abs(E).max() + np.abs(G).max())


@pytest.mark.parametrize("dim", DIMS)
def test_trials_meet_every_branch(dim):
    params = parameters(dim)
    assert {branch(by_numpy(E, G), v_c, params) for E, v_c, G in trials(dim, 3)} == {"tip", "elastic", "shear"}


@pytest.mark.parametrize("dim", DIMS)
def test_hydrostatic_compression_is_elastic(dim):
    params, E, v_c = parameters(dim), np.zeros((dim, dim)), 0.0
    for n in range(1, 11):
        E, v_c = advance(E, v_c, -0.01 * np.eye(dim), params)
        assert np.abs(E - n * math.log(0.99) * np.eye(dim)).max() < 1e-15 * n
        assert v_c == 0.0


@pytest.mark.parametrize("dim", DIMS)
def test_inside_the_cone_nothing_changes(dim):
    params, met = parameters(dim), 0
    for E, v_c, G in trials(dim, 3):
        trial = by_numpy(E, G)
        if branch(trial, 0.0, params) == branch(trial, v_c, params) == "elastic" and v_c == 0.0:
            found, found_v_c = advance(E, v_c, G, params)
            assert np.abs(found - trial).max() < 1e-14
            assert found_v_c == 0.0
            met += 1
    assert met > 10


@pytest.mark.parametrize("dim", DIMS)
def test_shear_branch_lands_on_the_cone_along_the_deviator_and_keeps_the_trace(dim):
    params, met = parameters(dim), 0
    for E, v_c, G in trials(dim, 3):
        trial = by_numpy(E, G)
        if branch(trial, v_c, params) == "shear":
            found, _ = advance(E, v_c, G, params)
            s, s_trial = deviator(found), deviator(trial)
            assert abs(np.linalg.norm(s) + params[2] * np.trace(found)) < 1e-12
            assert abs(np.trace(found) - np.trace(trial) - v_c) < 1e-13
            assert np.abs(s / np.linalg.norm(s) - s_trial / np.linalg.norm(s_trial)).max() < 1e-11
            met += 1
    assert met > 10


@pytest.mark.parametrize("dim", DIMS)
def test_expansion_ends_at_the_tip_without_stress(dim):
    params, met = parameters(dim), 0
    for E, v_c, G in trials(dim, 3):
        trial = by_numpy(E, G)
        if branch(trial, v_c, params) == "tip":
            found, found_v_c = advance(E, v_c, G, params)
            assert (found == 0.0).all()
            assert abs(found_v_c - v_c - np.trace(trial)) < 1e-14
            met += 1
    assert met > 10


@pytest.mark.parametrize("dim", DIMS)
def test_no_state_is_outside_the_cone(dim):
    params = parameters(dim)
    for E, v_c, G in trials(dim, 4):
        found, _ = advance(E, v_c, G, params)
        assert np.linalg.norm(deviator(found)) + params[2] * np.trace(found) < 1e-14


@pytest.mark.parametrize("dim", DIMS)
def test_returning_twice_changes_nothing_more(dim):
    params = parameters(dim)
    for E, v_c, G in trials(dim, 5):
        once, once_v_c = advance(E, v_c, G, params)
        twice, twice_v_c = advance(once, once_v_c, 0.0 * G, params)
        assert np.abs(twice - once).max() < 1e-12
        assert abs(twice_v_c - once_v_c) < 1e-12


@pytest.mark.parametrize("dim", DIMS)
def test_v_c_plus_the_elastic_trace_is_unchanged_by_the_return(dim):
    params = parameters(dim)
    for E, v_c, G in trials(dim, 6):
        found, found_v_c = advance(E, v_c, G, params)
        assert abs(found_v_c + np.trace(found) - v_c - np.trace(by_numpy(E, G))) < 1e-13


@pytest.mark.parametrize("dim", DIMS)
def test_over_a_path_v_c_plus_the_elastic_trace_is_the_logarithm_of_the_volume(dim):
    params, random = parameters(dim), np.random.default_rng(7)
    E, v_c, log_J, steps = np.zeros((dim, dim)), 0.0, 0.0, 1000
    for n in range(steps):
        G = 0.01 * random.normal(size=(dim, dim)) + 0.01 * math.sin(0.05 * n) * np.eye(dim)
        E, v_c = advance(E, v_c, G, params)
        log_J += math.log(np.linalg.det(np.eye(dim) + G))
        assert v_c >= 0.0
        assert v_c == 0.0 or (E == 0.0).all()
    assert abs(v_c + np.trace(E) - log_J) < 1e-12 * steps
    volume = law("volume_ratio", dim)((*flat_symmetric(E), v_c))
    assert volume == pytest.approx(math.exp(log_J), rel=1e-12 * steps)


def first_stress(dim, volume_correction):
    """ln J of the whole path at the first stress when sand is expanded to J = 1.2 and then compressed, in steps of 0.1 %."""
    params, step = parameters(dim), law("advance", dim, volume_correction)
    state, size, steps = (0.0,) * (dim * (dim + 1) // 2 + volume_correction), dim * (dim + 1) // 2, 200
    ratio = 1.2 ** (1.0 / dim / steps)
    log_J = 0.0
    for n in range(3 * steps):
        factor = ratio if n < steps else 1.0 / ratio
        state = step(state, flat((factor - 1.0) * np.eye(dim)), 1.0, params)
        log_J += dim * math.log(factor)
        if np.linalg.norm(state[:size]) > 1e-13:
            return log_J
    return None


@pytest.mark.parametrize("dim", DIMS)
def test_expanded_sand_bears_load_only_when_the_expansion_is_undone(dim):
    step = math.log(1.2) / 200
    assert first_stress(dim, True) == pytest.approx(-step, rel=1e-9)
    assert first_stress(dim, False) == pytest.approx(math.log(1.2) - step, rel=1e-9)


@pytest.mark.parametrize("dim", DIMS)
def test_a_thousand_cycles_of_dilation_leave_the_true_volume(dim):
    params, E, v_c = parameters(dim), np.zeros((dim, dim)), 0.0
    for _ in range(1000):
        for G in (0.01, 1.0 / 1.01 - 1.0):
            E, v_c = advance(E, v_c, G * np.eye(dim), params)
    assert abs(law("volume_ratio", dim)((*flat_symmetric(E), v_c)) - 1.0) < 1e-10


@pytest.mark.parametrize("dim", DIMS)
def test_plastic_flow_dissipates(dim):
    mu, lam, _ = params = parameters(dim)
    for E, _, G in trials(dim, 8):
        found, _ = advance(E, 0.0, G, params)
        tau = 2.0 * mu * found + lam * np.trace(found) * np.eye(dim)
        assert np.sum(tau * (by_numpy(E, G) - found)) > -1e-9


@pytest.mark.parametrize("dim", DIMS)
def test_the_step_turns_with_the_body(dim):
    params, random = parameters(dim), np.random.default_rng(9)
    for E, v_c, G in trials(dim, 9, count=60):
        Q = random_rotation(random, dim)
        found, found_v_c = advance(E, v_c, G, params)
        turned, turned_v_c = advance(Q @ E @ Q.T, v_c, Q @ G @ Q.T, params)
        assert np.abs(turned - Q @ found @ Q.T).max() < 1e-13
        assert abs(turned_v_c - found_v_c) < 1e-13
        after, _ = advance(found, found_v_c, Q - np.eye(dim), params)
        assert np.abs(after - Q @ found @ Q.T).max() < 1e-13


@pytest.mark.parametrize("dim", DIMS)
def test_without_friction_there_is_no_shear_strength(dim):
    params = parameters(dim, friction_angle=0.0)
    for E, v_c, G in trials(dim, 10, count=60):
        found, _ = advance(E, v_c, G, params)
        assert np.abs(deviator(found)).max() < 1e-16


@pytest.mark.parametrize("dim", DIMS)
def test_small_strains_yield_like_large_ones(dim):
    # No absolute epsilon: the same path at 1e-9 of the strain lands on the same cone.
    params = parameters(dim)
    G = np.zeros((dim, dim))
    G[0, 1] = 1e-9
    found, _ = advance(-1e-10 * np.eye(dim), 0.0, G, params)
    assert np.linalg.norm(deviator(found)) == pytest.approx(-params[2] * np.trace(found), rel=1e-6)


def shear_plateau(dim, fit):
    """Stress after simple shear of 5 % under hydrostatic pressure."""
    mu, lam, _ = params = parameters(dim, fit=fit)
    E, v_c, G = -0.001 * np.eye(dim), 0.0, np.zeros((dim, dim))
    G[0, 1] = 1e-4
    for _ in range(500):
        E, v_c = advance(E, v_c, G, params)
    return 2.0 * mu * E + lam * np.trace(E) * np.eye(dim)


@pytest.mark.parametrize(("dim", "fit"), [(2, "plane_strain"), (2, "triaxial"), (3, "plane_strain"), (3, "triaxial")])
def test_simple_shear_ends_at_the_friction_ratio(dim, fit):
    tau = shear_plateau(dim, fit)
    ratio = np.linalg.norm(deviator(tau)) / -np.trace(tau)
    assert ratio == pytest.approx(sand.friction_slope(30.0, fit, dim), rel=1e-6)


def test_in_the_plane_the_default_is_mohr_coulomb_itself():
    # (tau_1 - tau_2) / 2 = -(tau_1 + tau_2) / 2 sin(phi).
    low, high = np.linalg.eigvalsh(shear_plateau(2, None))
    assert (high - low) / -(high + low) == pytest.approx(math.sin(math.radians(30.0)), rel=1e-12)


def test_triaxial_compression_meets_mohr_coulomb():
    # tau = (-p1, -p3, -p3) at yield: p1 / p3 = (1 + sin phi) / (1 - sin phi).
    alpha, s = sand.friction_slope(30.0, "triaxial", 3), math.sin(math.radians(30.0))
    p = np.array([(1.0 + s) / (1.0 - s), 1.0, 1.0])
    assert np.linalg.norm(p - p.mean()) == pytest.approx(alpha * p.sum(), rel=1e-12)


@pytest.mark.parametrize(
    ("dim", "fit", "alpha"),
    [
        (3, "triaxial", 0.2079),
        (3, "plane_strain", 0.1567),
        (2, "plane_strain", 0.2395),
        (2, None, 0.2395),
        (3, None, 0.2079),
    ],
)
def test_friction_slopes_at_the_angle_of_the_literature(dim, fit, alpha):
    # Klar et al. 2016 (triaxial) and the plane-strain match of Drucker and Prager's cone, at 19.8 degrees.
    assert sand.friction_slope(19.8, fit, dim) == pytest.approx(alpha, abs=6e-5)


# ---- cohesion and dilatancy ---------------------------------------------------------------------------------------------

COHESION = 5e3  # Pa: the tip at a strain of 0.35 % (3-D)
OPTIONS = [
    {"cohesion": COHESION},
    {"dilatancy_angle": 12.0},
    {"cohesion": COHESION, "dilatancy_angle": 12.0},
    {"cohesion": COHESION, "dilatancy_angle": 30.0},
    {"cohesion": COHESION, "friction_angle": 0.0},
    {"cohesion": COHESION, "dilatancy_angle": 12.0, "volume_correction": False},
    {"dilatancy_angle": 12.0, "volume_correction": False},
]


class Sand:
    """Sand of any options; a state is (E as a matrix, v_c, v_p), zero where it is not kept."""

    def __init__(self, dim, **keys):
        defaults = {"cohesion": 0.0, "dilatancy_angle": 0.0, "volume_correction": True, "friction_fit": None}
        self.dim, self.keys = dim, KEYS | defaults | keys
        assert sand.conflicts(self.keys) is None
        self.params = sand.parameters(self.keys, dim)
        self.fields = [field.name for field in sand.state_fields(self.keys)][1:]
        self.mu, self.lam = self.params[:2]
        phi, psi, fit = self.keys["friction_angle"], self.keys["dilatancy_angle"], self.keys["friction_fit"]
        self.alpha, self.a = sand.friction_slope(phi, fit, dim), sand.friction_slope(psi, fit, dim)
        self.k = sand.strength(self.keys["cohesion"], phi, fit, dim)

    def __call__(self, name, *arguments):
        return in_dimension(getattr(sand, name), self.dim, **sand.choices(self.keys))(*arguments)

    def stored(self, state):
        E, *volumes = state
        kept = dict(zip(("v_c", "v_p"), volumes, strict=True))
        return (*flat_symmetric(E), *(kept[name] for name in self.fields))

    def advance(self, state, G):
        new = self("advance", self.stored(state), flat(G), 1.0, self.params)
        size = self.dim * (self.dim + 1) // 2
        kept = dict(zip(self.fields, new[size:], strict=True))
        return symmetric(tuple(new[:size])), kept.get("v_c", 0.0), kept.get("v_p", 0.0)

    def rest(self):
        return np.zeros((self.dim, self.dim)), 0.0, 0.0

    def tau(self, E):
        return 2.0 * self.mu * E + self.lam * np.trace(E) * np.eye(self.dim)

    def yield_function(self, E):
        tau = self.tau(E)
        return np.linalg.norm(deviator(tau)) + self.alpha * np.trace(tau) - self.k


def each_option(function):
    labels = [",".join(f"{name[:5]}={value}" for name, value in option.items()) for option in OPTIONS]
    return pytest.mark.parametrize("dim", DIMS)(pytest.mark.parametrize("option", OPTIONS, ids=labels)(function))


def return_by_bisection(law, E):
    """The return of a trial strain beyond the cone: bisection along the flow, to the tip where the axis comes first."""
    trace, s = np.trace(E), deviator(E)
    norm = np.linalg.norm(s)
    direction = s / norm + law.a * np.eye(law.dim)
    if law.yield_function(E - norm * direction) > 0.0:
        return law.k / (law.alpha * law.dim * (law.dim * law.lam + 2.0 * law.mu)) * np.eye(law.dim)
    low, high = 0.0, norm
    for _ in range(200):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if law.yield_function(E - middle * direction) > 0.0 else (low, middle)
    assert trace < 1.0
    return E - low * direction


@each_option
def test_with_options_the_return_is_the_one_that_bisection_finds(dim, option):
    law, met = Sand(dim, **option), {"elastic": 0, "plastic": 0}
    for E, v_c, G in trials(dim, 11, count=120):
        v_c = v_c if "v_c" in law.fields else 0.0
        trial = by_numpy(E, G) + v_c / dim * np.eye(dim)
        found, _, _ = law.advance((E, v_c, 0.0), G)
        outside = law.yield_function(trial) > 0.0
        expected = return_by_bisection(law, trial) if outside else trial
        assert np.abs(found - expected).max() < 1e-13
        met["plastic" if outside else "elastic"] += 1
    assert met["plastic"] > 3
    assert met["elastic"] > 3 or law.alpha == 0.0


@each_option
def test_with_options_no_state_is_outside_the_cone(dim, option):
    law = Sand(dim, **option)
    for E, v_c, G in trials(dim, 12):
        found, _, _ = law.advance((E, v_c if "v_c" in law.fields else 0.0, 0.0), G)
        assert law.yield_function(found) <= 1e-12 * (law.k + 1e6)


@each_option
def test_with_options_returning_twice_changes_nothing_more(dim, option):
    law = Sand(dim, **option)
    for E, v_c, G in trials(dim, 13, count=60):
        once = law.advance((E, v_c, 0.0), G)
        twice = law.advance(once, 0.0 * G)
        assert np.abs(twice[0] - once[0]).max() < 1e-12
        assert np.abs(np.subtract(twice[1:], once[1:])).max() < 1e-12


@each_option
def test_with_options_the_step_turns_with_the_body(dim, option):
    law, random = Sand(dim, **option), np.random.default_rng(14)
    for E, v_c, G in trials(dim, 14, count=60):
        Q = random_rotation(random, dim)
        found = law.advance((E, v_c, 0.01), G)
        turned = law.advance((Q @ E @ Q.T, v_c, 0.01), Q @ G @ Q.T)
        assert np.abs(turned[0] - Q @ found[0] @ Q.T).max() < 1e-13
        assert np.abs(np.subtract(turned[1:], found[1:])).max() < 1e-13


@each_option
def test_with_options_plastic_flow_dissipates(dim, option):
    law = Sand(dim, **option)
    for E, _, G in trials(dim, 15):
        found, _, _ = law.advance((E, 0.0, 0.0), G)
        assert np.sum(law.tau(found) * (by_numpy(E, G) - found)) > -1e-9


@each_option
def test_with_options_the_volume_over_a_path_is_the_true_one(dim, option):
    law, random = Sand(dim, **option), np.random.default_rng(16)
    if option.get("volume_correction", True) is False and "v_p" not in law.fields:
        pytest.skip("nothing keeps the volume of openings")
    state, log_J, steps, before = law.rest(), 0.0, 500, 0.0
    tip = np.inf if law.alpha == 0.0 else law.k / (law.alpha * (dim * law.lam + 2.0 * law.mu))
    for n in range(steps):
        G = 0.01 * random.normal(size=(dim, dim)) + 0.01 * math.sin(0.05 * n) * np.eye(dim)
        state = law.advance(state, G)
        log_J += math.log(np.linalg.det(np.eye(dim) + G))
        E, v_c, v_p = state
        assert v_c >= 0.0
        assert v_c == 0.0 or np.trace(E) == pytest.approx(tip, abs=1e-15)
        assert v_p >= before
        before = v_p
    assert abs(v_c + v_p + np.trace(E) - log_J) < 1e-12 * steps
    assert law("volume_ratio", law.stored(state)) == pytest.approx(math.exp(log_J), rel=1e-12 * steps)


@pytest.mark.parametrize(("dim", "fit"), [(2, "plane_strain"), (2, "triaxial"), (3, "plane_strain"), (3, "triaxial")])
def test_with_cohesion_the_tip_is_mohr_coulombs_apex(dim, fit):
    law = Sand(dim, cohesion=COHESION, friction_fit=fit)
    E, v_c, _ = law.advance(law.rest(), 0.1 * np.eye(dim))
    assert law.tau(E) == pytest.approx(COHESION / math.tan(math.radians(30.0)) * np.eye(dim), rel=1e-12)
    assert v_c == pytest.approx(dim * math.log(1.1) - law.k / (law.alpha * (dim * law.lam + 2.0 * law.mu)), rel=1e-12)


@pytest.mark.parametrize(("dim", "fit"), [(2, "plane_strain"), (3, "triaxial")])
def test_uniaxial_compressive_strength_is_mohr_coulombs(dim, fit):
    # sigma_c = 2 c cos(phi) / (1 - sin(phi)): elastic just below it, plastic just above.
    s, c = math.sin(math.radians(30.0)), math.cos(math.radians(30.0))
    law, strength = Sand(dim, cohesion=COHESION, friction_fit=fit), 2.0 * COHESION * c / (1.0 - s)
    for factor, yields in ((1.0 - 1e-9, False), (1.0 + 1e-9, True)):
        tau = np.zeros((dim, dim))
        tau[0, 0] = -factor * strength
        E = (tau - law.lam * np.trace(tau) / (dim * law.lam + 2.0 * law.mu) * np.eye(dim)) / (2.0 * law.mu)
        found, _, _ = law.advance((E, 0.0, 0.0), np.zeros((dim, dim)))
        assert (np.abs(found - E).max() > 1e-13) == yields


@pytest.mark.parametrize(
    ("dim", "fit", "ratio"),
    # |dev tau| / c where tau_1 - tau_3 = 2 c: of (c, -c), of (4, -2, -2) c / 3, and of (c, 0, -c).
    [(2, None, math.sqrt(2.0)), (3, "triaxial", 2.0 * math.sqrt(2.0 / 3.0)), (3, "plane_strain", math.sqrt(2.0))],
)
def test_without_friction_cohesion_is_von_mises_and_there_is_no_tip(dim, fit, ratio):
    law = Sand(dim, cohesion=COHESION, friction_angle=0.0, friction_fit=fit)
    for pressure in (-0.2, 0.0, 0.2):
        G = pressure * np.eye(dim)
        G[0, 1] = 0.05
        E, v_c, _ = law.advance(law.rest(), G)
        assert np.linalg.norm(deviator(law.tau(E))) == pytest.approx(ratio * COHESION, rel=1e-12)
        assert np.trace(E) == pytest.approx(math.log(np.linalg.det(np.eye(dim) + G)), abs=1e-14)
        assert v_c == 0.0


@pytest.mark.parametrize("dim", DIMS)
def test_cohesive_sand_stays_at_the_tip_until_its_opening_is_undone(dim):
    law, ratio = Sand(dim, cohesion=COHESION), 1.2 ** (1.0 / dim / 200)
    tip = law.k / (law.alpha * (dim * law.lam + 2.0 * law.mu))
    state, log_J = law.rest(), 0.0
    for n in range(450):
        factor = ratio if n < 200 else 1.0 / ratio
        state = law.advance(state, (factor - 1.0) * np.eye(dim))
        log_J += dim * math.log(factor)
        assert np.trace(state[0]) == pytest.approx(min(tip, log_J), abs=1e-13)


def test_the_dilatancy_angle_is_plastic_volume_over_plastic_shear_in_the_plane():
    # sin(psi) = (d e_1 + d e_2) / (d e_1 - d e_2) of plastic strains in the plane.
    law = Sand(2, dilatancy_angle=12.0)
    E = np.diag([0.004, -0.01])
    found, _, v_p = law.advance((E, 0.0, 0.0), np.zeros((2, 2)))
    plastic = np.diag(E - found)
    assert v_p == pytest.approx(plastic.sum(), rel=1e-12)
    assert plastic.sum() / (plastic[0] - plastic[1]) == pytest.approx(math.sin(math.radians(12.0)), rel=1e-12)


@pytest.mark.parametrize("dim", DIMS)
def test_associated_flow_returns_to_the_nearest_admissible_state_in_energy(dim):
    law, random = Sand(dim, cohesion=COHESION, dilatancy_angle=30.0), np.random.default_rng(17)
    others = [random_strain(random, dim, 0.02, 0.02) for _ in range(400)]
    others = [E for E in others if law.yield_function(E) <= 0.0]
    assert len(others) > 50

    def energy(E):
        return np.sum(law.tau(E) * E)

    for E, _, G in trials(dim, 17, count=60):
        trial, found = by_numpy(E, G), law.advance((E, 0.0, 0.0), G)[0]
        for other in others:  # also from the found state a little towards each of them
            assert energy(trial - found) <= energy(trial - found - 1e-3 * (other - found)) * (1.0 + 1e-12) + 1e-20


@pytest.mark.parametrize("dim", DIMS)
def test_closed_sand_that_has_dilated_is_compressed_from_its_new_volume(dim):
    law, G = Sand(dim, dilatancy_angle=12.0), np.zeros((dim, dim))
    G[0, 1] = 1e-3
    state = law.advance(law.rest(), -0.01 * np.eye(dim))
    for _ in range(100):
        state = law.advance(state, G)
    E, v_c, v_p = state
    assert v_p > 1e-3
    after, _, after_v_p = law.advance(state, -0.01 * np.eye(dim))
    assert np.trace(after) == pytest.approx(np.trace(E) + dim * math.log(0.99), rel=1e-9)
    assert after_v_p == pytest.approx(v_p, rel=1e-3)


def test_options_that_are_off_are_neither_kept_nor_computed():
    plain = KEYS | {"cohesion": 0.0, "dilatancy_angle": 0.0, "volume_correction": True}
    assert sand.choices(plain) == {"VOLUME_CORRECTION": True, "COHESION": False, "DILATANCY": False}
    assert [field.name for field in sand.state_fields(plain)] == ["hencky_strain", "v_c"]
    assert len(sand.parameters(plain, 3)) == 3


@each_option
def test_states_with_options_that_are_not_numbers_are_invalid(dim, option):
    law = Sand(dim, **option)
    rest = list(law.stored(law.rest()))
    assert law("valid", tuple(rest))
    for place in range(len(rest)):
        if place == len(rest) - 1 - ("v_p" in law.fields) and "v_c" in law.fields:
            continue  # a v_c that is no number makes the strain one in the next step
        state = rest.copy()
        state[place] = math.nan
        assert not law("valid", tuple(state))
    G = -2.0 * np.diag([1.0, 0.0, 0.0][:dim])
    assert not law("valid", law.stored(law.advance(law.rest(), G)))
