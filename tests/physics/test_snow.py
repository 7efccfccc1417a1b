"""Snow of Stomakhin et al. (2013): stretches clamped, hardening with compaction, stress by power series."""

import math
from decimal import Decimal

import numpy as np
import pytest
from flat import EPS, WORDS, flat, flat_symmetric, in_dimension, of_eigenvalues, random_rotation, symmetric
from test_elastic_laws import difference_quotient, squared_waves

from pmpm.kernels import targets
from pmpm.physics.materials import snow
from pmpm.scene.materials import material

DIMS = (2, 3)
# The paper's: E = 1.4e5 Pa, nu = 0.2, rho = 400 kg/m3, theta_c = 0.025, theta_s = 0.0075, xi = 10.
KEYS = {"model": "snow", "density": 400.0, "youngs_modulus": 1.4e5, "poisson_ratio": 0.2}
WIDE = {"critical_compression": 0.3, "critical_stretch": 0.3}
MU, LAM = 1.4e5 / 2.4, 0.2 * 1.4e5 / (1.2 * 0.6)


class Snow:
    """Snow of any keys; a state is (E as a matrix, J_P)."""

    def __init__(self, dim, **keys):
        self.dim, self.keys = dim, material(KEYS | keys).parameters
        self.params = snow.parameters(self.keys, dim)
        self.low = math.log(1.0 - self.keys["critical_compression"])
        self.high = math.log(1.0 + self.keys["critical_stretch"])

    def __call__(self, name, *arguments):
        return in_dimension(getattr(snow, name), self.dim, **snow.choices(self.keys))(*arguments)

    def advance(self, state, G):
        E, J_P = state
        *strain, J_P = self("advance", (*flat_symmetric(E), J_P), flat(G), 1.0, self.params)
        return symmetric(tuple(strain)), J_P

    def rest(self):
        return np.zeros((self.dim, self.dim)), 1.0

    def stress(self, E, J_P=1.0):
        return symmetric(self("kirchhoff_stress", (*flat_symmetric(E), J_P), self.params))

    def tau(self, F):
        return self.stress(of_eigenvalues(F @ F.T, lambda b: 0.5 * np.log(b)))

    def energy(self, F):
        E = of_eigenvalues(F @ F.T, lambda b: 0.5 * np.log(b))
        return self("energy", (*flat_symmetric(E), 1.0), self.params)


def inside(random, law, fraction=1.0):
    """A random deformation gradient with stretches inside the limits."""
    U, V = random_rotation(random, law.dim), random_rotation(random, law.dim)
    return U @ np.diag(np.exp(fraction * random.uniform(law.low, law.high, law.dim))) @ V


def by_numpy(E, G):
    A = np.eye(len(E)) + G
    b = A @ of_eigenvalues(2.0 * E, np.exp) @ A.T
    return of_eigenvalues(0.5 * (b + b.T), lambda s: 0.5 * np.log(s))


def by_series(E, G):
    """The same for small strains by Taylor series in extended precision, rounded once at the end."""
    one = np.eye(len(E), dtype=np.longdouble)
    A, term, squared = one + G, one, one
    for n in range(1, 20):
        term = term @ (2.0 * E.astype(np.longdouble)) / n
        squared = squared + term
    beyond = A @ squared @ A.T - one
    power, found = one, 0.0 * one
    for n in range(1, 60):
        power = power @ beyond
        found = found - (-1.0) ** n * power / n
    return (0.5 * found).astype(float)


def trials(law, seed, count=150, size=0.02):
    """(E, J_P, G): states inside the limits and steps that leave them or not."""
    random = np.random.default_rng(seed)
    for n in range(count):
        Q = random_rotation(random, law.dim)
        E = Q @ np.diag(random.uniform(law.low, law.high, law.dim)) @ Q.T
        yield E, random.uniform(0.7, 1.3), (size, 0.1 * size)[n % 2] * random.normal(size=(law.dim, law.dim))


def clamped(law, E):
    return of_eigenvalues(E, lambda e: np.clip(e, law.low, law.high))


@pytest.mark.parametrize("keys", [{}, WIDE], ids=["paper", "wide"])
@pytest.mark.parametrize("dim", DIMS)
def test_principal_stretches_are_clamped_and_directions_kept(dim, keys):
    law, met = Snow(dim, **keys), {True: 0, False: 0}
    for E, J_P, G in trials(law, 1, size=0.02 if not keys else 0.3):
        if np.linalg.det(np.eye(dim) + G) <= 0.1:
            continue
        trial = by_numpy(E, G)
        found, _ = law.advance((E, J_P), G)
        assert np.abs(found - clamped(law, trial)).max() < 5e-14
        met[bool(np.abs(clamped(law, trial) - trial).max() > 1e-9)] += 1
    assert min(met.values()) > 10


@pytest.mark.parametrize("dim", DIMS)
def test_inside_the_limits_nothing_yields(dim):
    law, met = Snow(dim), 0
    for E, J_P, G in trials(law, 2, size=0.005):
        trial = by_numpy(E, G)
        e = np.linalg.eigvalsh(trial)
        if law.low < e[0] and e[-1] < law.high:
            found, found_J_P = law.advance((E, J_P), G)
            assert np.abs(found - by_series(E, G)).max() < 1e-16
            assert found_J_P == J_P
            met += 1
    assert met > 10


@pytest.mark.parametrize("dim", DIMS)
def test_no_stretch_is_ever_beyond_its_limit(dim):
    law = Snow(dim)
    for E, J_P, G in trials(law, 3):
        found, _ = law.advance((E, J_P), G)
        e = np.linalg.eigvalsh(found)
        assert e[0] >= law.low - 1e-15
        assert e[-1] <= law.high + 1e-15


@pytest.mark.parametrize("dim", DIMS)
def test_elastic_times_plastic_volume_is_the_volume_of_the_trial(dim):
    # F_E F_P = F, whose determinant is all an isotropic law keeps of it.
    law = Snow(dim)
    for E, J_P, G in trials(law, 4):
        found, found_J_P = law.advance((E, J_P), G)
        volume = J_P * math.exp(np.trace(E)) * np.linalg.det(np.eye(dim) + G)
        assert found_J_P * math.exp(np.trace(found)) == pytest.approx(volume, rel=1e-14)
        assert law("volume_ratio", (*flat_symmetric(found), found_J_P)) == pytest.approx(volume, rel=1e-14)


@pytest.mark.parametrize("dim", DIMS)
def test_over_a_path_the_volume_is_the_true_one(dim):
    law, random, steps = Snow(dim), np.random.default_rng(5), 500
    state, log_J = law.rest(), 0.0
    for n in range(steps):
        G = 0.01 * random.normal(size=(dim, dim)) + 0.005 * math.sin(0.05 * n) * np.eye(dim)
        state = law.advance(state, G)
        log_J += math.log(np.linalg.det(np.eye(dim) + G))
    volume = law("volume_ratio", (*flat_symmetric(state[0]), state[1]))
    assert volume == pytest.approx(math.exp(log_J), rel=1e-12 * steps)


@pytest.mark.parametrize("dim", DIMS)
def test_returning_twice_changes_nothing_more(dim):
    law = Snow(dim)
    for E, J_P, G in trials(law, 6):
        once = law.advance((E, J_P), G)
        twice = law.advance(once, 0.0 * G)
        assert np.abs(twice[0] - once[0]).max() < 1e-15
        assert twice[1] == pytest.approx(once[1], rel=1e-14)


@pytest.mark.parametrize("dim", DIMS)
def test_the_step_turns_with_the_body(dim):
    law, random = Snow(dim), np.random.default_rng(7)
    for E, J_P, G in trials(law, 7, count=60):
        Q = random_rotation(random, dim)
        found, found_J_P = law.advance((E, J_P), G)
        turned, turned_J_P = law.advance((Q @ E @ Q.T, J_P), Q @ G @ Q.T)
        assert np.abs(turned - Q @ found @ Q.T).max() < 1e-14
        assert abs(turned_J_P - found_J_P) < 1e-13


@pytest.mark.parametrize("dim", DIMS)
def test_crushing_lowers_the_plastic_volume_step_by_step(dim):
    law = Snow(dim)
    state, steps = law.rest(), []
    for _ in range(100):
        state = law.advance(state, -0.005 * np.eye(dim))
        steps.append(state[1])
    falling = [J_P for J_P in steps if J_P < 1.0]
    assert len(falling) > 80
    assert (np.diff(falling) < 0.0).all()


@pytest.mark.parametrize("largest", [0.005, 0.3])
@pytest.mark.parametrize("dim", DIMS)
def test_stress_is_the_derivative_of_the_energy(dim, largest):
    law, random = Snow(dim, critical_compression=largest, critical_stretch=largest), np.random.default_rng(9)
    for _ in range(20):
        F, P = inside(random, law, 0.95), np.empty((dim, dim))
        for i, j in np.ndindex(dim, dim):
            direction = np.zeros((dim, dim))
            direction[i, j] = 1.0
            P[i, j] = difference_quotient(law.energy, F, direction)
        tau = law.tau(F)
        assert np.abs(P @ F.T - tau).max() <= 1e-7 * np.abs(tau).max()


@pytest.mark.parametrize("dim", DIMS)
def test_stress_is_that_of_the_fixed_corotated_solid(dim):
    # tau_i = 2 mu (s_i - 1) s_i + lam (J - 1) J.
    law, random = Snow(dim, **WIDE), np.random.default_rng(10)
    for _ in range(40):
        F = inside(random, law)
        U, s, _ = np.linalg.svd(F)
        J = s.prod()
        expected = (U * (2.0 * MU * (s - 1.0) * s + LAM * (J - 1.0) * J)) @ U.T
        assert np.abs(law.tau(F) - expected).max() < 1e-14 * 1.4e5 * 3.0
        E = flat_symmetric(of_eigenvalues(F @ F.T, lambda b: 0.5 * np.log(b)))
        out_of_plane = law("out_of_plane_stress", (*E, 1.0), law.params)
        assert out_of_plane == pytest.approx(LAM * (J - 1.0) * J, rel=1e-11, abs=1e-9)


@pytest.mark.parametrize("real", [np.float32, np.float64])
@pytest.mark.parametrize("dim", DIMS)
def test_the_series_of_the_stress_is_exact_to_round_off_up_to_the_widest_limits(dim, real):
    polynomial = targets.scalar(real, la=WORDS[dim]).compile(stress_series)
    for e in (*np.linspace(math.log(0.7), math.log(1.3), 41), 1e-6):
        e = float(real(e))
        S = polynomial(tuple(map(real, flat_symmetric(np.diag([e, 0.0, 0.0][:dim])))))
        many = (2 * Decimal(e)).exp() - Decimal(e).exp()
        # Horner's scheme rounds the terms up to exp(2 |e|) |e|.
        assert abs(Decimal(float(S[0])) - many) <= Decimal(6.0 * float(np.finfo(real).eps) * abs(e))


def stress_series(S):
    return la.polynomial(EXP_OF_TWICE_LESS_EXP, S)


la = WORDS[2]  # replaced by each target
EXP_OF_TWICE_LESS_EXP = snow.EXP_OF_TWICE_LESS_EXP


@pytest.mark.parametrize("dim", DIMS)
def test_rest_and_small_strains_are_hookes(dim):
    law, random = Snow(dim), np.random.default_rng(11)
    assert (law.tau(np.eye(dim)) == 0.0).all()
    assert law.energy(np.eye(dim)) == 0.0
    for _ in range(20):
        H = random.normal(size=(dim, dim))
        E, J_P = law.advance(law.rest(), 1e-7 * H)
        expected = MU * (H + H.T) + LAM * np.trace(H) * np.eye(dim)
        assert J_P == 1.0
        assert np.abs(law.stress(E) / 1e-7 - expected).max() < 1e-5 * np.abs(expected).max()


@pytest.mark.parametrize(
    ("J_P", "factor"), [(1.0, 1.0), (0.8, math.exp(2.0)), (0.5, math.exp(5.0)), (1.3, math.exp(-3.0))]
)
@pytest.mark.parametrize("dim", DIMS)
def test_both_moduli_grow_by_exp_of_xi_times_the_compaction(dim, J_P, factor):
    law, E = Snow(dim), np.diag([0.004, -0.01, 0.002][:dim])
    assert law.stress(E, J_P) == pytest.approx(factor * law.stress(E), rel=1e-14)
    soft, hard = ((*flat_symmetric(E), J) for J in (1.0, J_P))
    for name, more in (("energy", ()), ("wave_speed_squared", (400.0,))):
        expected = factor * law(name, soft, law.params, *more)
        assert law(name, hard, law.params, *more) == pytest.approx(expected, rel=1e-13)


def test_waves_in_hardened_snow_are_as_much_faster():
    # sqrt(exp(10 (1 - J_P))): 2.7 times at J_P = 0.8, 12 times at 0.5, 148 times at most.
    law = Snow(3)
    fresh = law("wave_speed_squared", (0.0,) * 6 + (1.0,), law.params, 400.0)
    assert fresh == pytest.approx((LAM + 2.0 * MU) / 400.0, rel=1e-14)
    for J_P, ratio in ((0.8, 2.718), (0.5, 12.18), (1e-6, 148.4)):
        hard = law("wave_speed_squared", (0.0,) * 6 + (J_P,), law.params, 400.0)
        assert math.sqrt(hard / fresh) == pytest.approx(ratio, rel=1e-3)


@pytest.mark.parametrize("keys", [{}, WIDE, WIDE | {"poisson_ratio": -0.5}, WIDE | {"poisson_ratio": 0.45}])
@pytest.mark.parametrize("dim", DIMS)
def test_no_wave_is_faster_than_the_bound(dim, keys):
    law, random = Snow(dim, **keys), np.random.default_rng(12)
    for _ in range(15):
        F = inside(random, law)
        E = of_eigenvalues(F @ F.T, lambda b: 0.5 * np.log(b))
        bound = 400.0 * law("wave_speed_squared", (*flat_symmetric(E), 1.0), law.params, 400.0)
        directions = [*np.linalg.svd(F)[0].T, *random.normal(size=(12, dim))]
        assert max(squared_waves(law, F, n / np.linalg.norm(n)).max() for n in directions) <= bound * (1.0 + 1e-6)


def test_a_cap_holds_the_hardening_and_nothing_else():
    law, capped = Snow(3), Snow(3, largest_hardening=20.0)
    E = np.diag([0.004, -0.01, 0.002])
    assert capped.stress(E, 0.1) == pytest.approx(20.0 * law.stress(E), rel=1e-13)
    assert (capped.stress(E, 0.9) == law.stress(E, 0.9)).all()
    assert snow.choices(law.keys) == {"CAPPED": False}
    assert len(law.params) == 5


@pytest.mark.parametrize("dim", DIMS)
def test_plastic_volumes_at_or_below_zero_or_not_finite_are_invalid(dim):
    law, size = Snow(dim), dim * (dim + 1) // 2
    assert law("valid", (0.0,) * size + (1.0,))
    for J_P in (0.0, -1.0, math.nan, math.inf):
        assert not law("valid", (0.0,) * size + (J_P,))
    for place in range(size):
        state = [0.0] * size + [1.0]
        state[place] = math.nan
        assert not law("valid", tuple(state))
        assert not law("valid", law("advance", tuple(state), (0.0,) * dim * dim, 1.0, law.params))
    for bad in (-1.0, -2.0, math.nan):
        G = np.zeros((dim, dim))
        G[0, 0] = bad
        E, J_P = law.advance(law.rest(), G)
        assert not law("valid", (*flat_symmetric(E), J_P))


@pytest.mark.parametrize("real", [np.float32, np.float64])
def test_snow_that_is_torn_for_ever_stays_valid_and_finite(real):
    """J_P stops: a lone particle in flight does not end the run."""
    law = Snow(3)
    words = {"la": WORDS[3], **snow.choices(law.keys)}
    advance, stress, valid, wave = (
        targets.arrays(real, **words).compile(getattr(snow, name))
        for name in ("advance", "kirchhoff_stress", "valid", "wave_speed_squared")
    )
    state, params = (real(0.0),) * 6 + (real(1.0),), tuple(map(real, law.params))
    G = tuple(map(real, flat(0.1 * np.eye(3))))
    for _ in range(2000):
        state = advance(state, G, real(1.0), params)
    assert valid(state)
    assert state[-1] == snow.LARGEST_J_P
    for value in (*stress(state, params), wave(state, params, real(400.0))):
        assert np.isfinite(value)
    for _ in range(100):
        state = advance(state, tuple(-g for g in G), real(1.0), params)
    assert valid(state)
    assert state[-1] < 0.01 * snow.LARGEST_J_P


@pytest.mark.parametrize("dim", DIMS)
def test_a_fresh_particle_beyond_the_limits_is_one_that_has_yielded(dim):
    law = Snow(dim)
    F = np.diag([1.2, 0.9, 1.0][:dim])
    *E, J_P = law("state_at", flat(F), law.params)
    assert np.abs(symmetric(tuple(E)) - np.diag([law.high, law.low, 0.0][:dim])).max() < 1e-15
    assert J_P * math.exp(law.high + law.low) == pytest.approx(np.linalg.det(F), rel=4.0 * EPS)
