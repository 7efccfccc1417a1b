"""Mohr and Coulomb's pyramid: the closed-form return against one that tries every set of active planes, and its limits."""

import itertools
import math

import numpy as np
import pytest
from flat import flat, in_dimension, of_eigenvalues, random_rotation

from pmpm.physics.materials import mohr_coulomb as soil
from pmpm.scene.materials import material

DIMS = (2, 3)
KEYS = {
    "model": "mohr_coulomb",
    "density": 2000.0,
    "youngs_modulus": 1e6,
    "poisson_ratio": 0.3,
    "cohesion": 5e3,
    "friction_angle": 30.0,
}
SOFTENING = {"residual_cohesion": 1e3, "residual_friction_angle": 20.0, "softening_strain": 0.05}
OPTIONS = [
    {},
    {"dilatancy_angle": 10.0},
    {"dilatancy_angle": 30.0},
    {"cohesion": 0.0},
    {"friction_angle": 0.0},
    {"poisson_ratio": -0.3, "dilatancy_angle": 20.0},
    SOFTENING,
    SOFTENING | {"dilatancy_angle": 15.0},
]
PLANES = list(itertools.permutations(range(3), 2))  # (i, j): tau_i as the largest, tau_j as the smallest


class Soil:
    """Soil of any options; a state is (E as a 3 x 3 matrix, e_p, v_p), zero where it is not kept."""

    def __init__(self, dim, **keys):
        self.dim, self.keys = dim, material(KEYS | keys).parameters
        self.params = soil.parameters(self.keys, dim)
        self.fields = [field.name for field in soil.state_fields(self.keys)][1:]
        self.mu, self.lam = self.params[:2]
        self.sin_psi = math.sin(math.radians(self.keys["dilatancy_angle"]))

    def __call__(self, name, *arguments):
        return in_dimension(getattr(soil, name), self.dim, **soil.choices(self.keys))(*arguments)

    def stored(self, state):
        E, *rest = state
        entries = (0, 0), (0, 1), (1, 1), (2, 2)
        if self.dim == 3:
            entries = (0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)
        kept = dict(zip(("e_p", "v_p"), rest, strict=True))
        return (*(float(E[at]) for at in entries), *(kept[name] for name in self.fields))

    def matrix(self, strain):
        if self.dim == 2:
            xx, xy, yy, zz = strain
            return np.array([[xx, xy, 0.0], [xy, yy, 0.0], [0.0, 0.0, zz]])
        xx, xy, xz, yy, yz, zz = strain
        return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])

    def advance(self, state, G):
        new = self("advance", self.stored(state), flat(np.asarray(G)[: self.dim, : self.dim]), 1.0, self.params)
        size = 4 if self.dim == 2 else 6
        kept = dict(zip(self.fields, new[size:], strict=True))
        return self.matrix(new[:size]), kept.get("e_p", 0.0), kept.get("v_p", 0.0)

    def rest(self):
        return np.zeros((3, 3)), 0.0, 0.0

    def tau(self, E):
        return 2.0 * self.mu * E + self.lam * np.trace(E) * np.eye(3)

    def strength(self, e_p=0.0):
        """(c, phi in radians) after an accumulated plastic strain."""
        c, phi = self.keys["cohesion"], self.keys["friction_angle"]
        if "e_p" not in self.fields:
            return c, math.radians(phi)
        softened = min(e_p / self.keys["softening_strain"], 1.0)
        residual_c, residual_phi = soil.residual(self.keys)
        return c + softened * (residual_c - c), math.radians(phi + softened * (residual_phi - phi))

    def yield_function(self, E, e_p=0.0):
        """Largest over the planes of (tau_i - tau_j) + (tau_i + tau_j) sin(phi) - 2 c cos(phi)."""
        c, phi = self.strength(e_p)
        tau = np.linalg.eigvalsh(self.tau(E))
        return tau[2] - tau[0] + (tau[2] + tau[0]) * math.sin(phi) - 2.0 * c * math.cos(phi)


def each_option(function):
    labels = [",".join(f"{name[:8]}={value:g}" for name, value in option.items()) or "plain" for option in OPTIONS]
    return pytest.mark.parametrize("dim", DIMS)(pytest.mark.parametrize("option", OPTIONS, ids=labels)(function))


def random_strain(random, dim, size, compression=0.0):
    A = size * random.normal(size=(3, 3))
    E = 0.5 * (A + A.T) - compression * np.eye(3)
    if dim == 2:
        E[2, :2] = E[:2, 2] = 0.0
    return E


def trials(dim, seed, count=100, size=0.02):
    """Random (E, G) on which every region of the return occurs."""
    random = np.random.default_rng(seed)
    for n in range(count):
        E = random_strain(random, dim, size, compression=(0.0, 0.02, 0.1)[n % 3])
        G = np.zeros((3, 3))
        G[:dim, :dim] = size * random.normal(size=(dim, dim))
        yield E, G


def by_numpy(E, G):
    """1/2 ln((I + G) exp(2 E) (I + G)^T)."""
    A = np.eye(3) + G
    b = A @ of_eigenvalues(2.0 * E, np.exp) @ A.T
    return of_eigenvalues(0.5 * (b + b.T), lambda s: 0.5 * np.log(s))


def return_by_enumeration(law, e, e_p):
    """(principal strains after the return, how many planes flow) by trying every set of up to three active planes.

    Koiter's rule: flow is a sum of the planes' own directions with positive multipliers, and yields nowhere is violated.
    Where no set does it, hydrostatic flow joins to the apex: the tension cut-off.
    """
    c, phi = law.strength(e_p)
    D = 2.0 * law.mu * np.eye(3) + law.lam * np.ones((3, 3))
    normals, flows = np.zeros((6, 3)), np.zeros((6, 3))
    for row, (i, j) in enumerate(PLANES):
        normals[row, i], normals[row, j] = 1.0 + math.sin(phi), -1.0 + math.sin(phi)
        flows[row, i], flows[row, j] = 1.0 + law.sin_psi, -1.0 + law.sin_psi
    f = normals @ (D @ e) - 2.0 * c * math.cos(phi)
    scale = 2.0 * law.mu * np.abs(e).max() + c
    if f.max() <= 0.0:
        return e, 0
    for count in (1, 2, 3):
        for active in itertools.combinations(range(6), count):
            rows = list(active)
            A = normals[rows] @ D @ flows[rows].T
            if abs(np.linalg.det(A / law.mu)) < 1e-9:
                continue
            multipliers = np.linalg.solve(A, f[rows])
            after = e - flows[rows].T @ multipliers
            if (multipliers > -1e-13).all() and (normals @ (D @ after) - 2.0 * c * math.cos(phi) < 1e-11 * scale).all():
                return after, count
    return np.full(3, c / math.tan(phi) / (3.0 * law.lam + 2.0 * law.mu)), 4


@each_option
def test_the_return_is_the_one_that_trying_all_sets_of_planes_finds(dim, option):
    law, met = Soil(dim, **option), set()
    e_p = 0.02 if "e_p" in law.fields else 0.0
    for E, G in trials(dim, 1):
        trial = by_numpy(E, G)
        e, Q = np.linalg.eigh(trial)
        after, planes = return_by_enumeration(law, e, e_p)
        found, _, _ = law.advance((E, e_p, 0.0), G)
        assert np.abs(found - (Q * after) @ Q.T).max() < 1e-13
        met.add(planes)
    assert met >= {1, 2}
    assert max(met) >= 3 or option.get("friction_angle") == 0.0


@each_option
def test_no_state_is_outside_the_pyramid(dim, option):
    law = Soil(dim, **option)
    for E, G in trials(dim, 2):
        found, _, _ = law.advance((E, 0.0, 0.0), G)
        assert law.yield_function(found) <= 1e-12 * (2.0 * law.mu * 0.1)


@each_option
def test_returning_twice_changes_nothing_more(dim, option):
    law = Soil(dim, **option)
    if "e_p" in law.fields:  # softened to the end: the strength no longer moves
        law = Soil(dim, **option | {"softening_strain": 1e-9})
    for E, G in trials(dim, 3, count=60):
        once = law.advance((E, 1.0, 0.0), G)
        twice = law.advance(once, 0.0 * G)
        assert np.abs(twice[0] - once[0]).max() < 1e-14
        assert np.abs(np.subtract(twice[1:], once[1:])).max() < 1e-13


@each_option
def test_inside_the_pyramid_nothing_changes(dim, option):
    law, met = Soil(dim, **option), 0
    for E, G in trials(dim, 4, size=2e-3):
        trial = by_numpy(E, G)
        if law.yield_function(trial) < -1e-9:
            found = law.advance((E, 0.0, 0.0), G)
            assert np.abs(found[0] - trial).max() < 1e-15
            assert found[1:] == (0.0, 0.0)
            met += 1
    assert met > 10 or option.get("cohesion") == 0.0


@each_option
def test_the_step_turns_with_the_body(dim, option):
    law, random = Soil(dim, **option), np.random.default_rng(5)
    for E, G in trials(dim, 5, count=60):
        Q = np.eye(3)
        Q[:dim, :dim] = random_rotation(random, dim)
        found = law.advance((E, 0.01, 0.0), G)
        turned = law.advance((Q @ E @ Q.T, 0.01, 0.0), Q @ G @ Q.T)
        assert np.abs(turned[0] - Q @ found[0] @ Q.T).max() < 1e-13
        assert np.abs(np.subtract(turned[1:], found[1:])).max() < 1e-13


@each_option
def test_plastic_flow_dissipates(dim, option):
    law = Soil(dim, **option)
    for E, G in trials(dim, 6):
        found, _, _ = law.advance((E, 0.0, 0.0), G)
        assert np.sum(law.tau(found) * (by_numpy(E, G) - found)) > -1e-9


@pytest.mark.parametrize("dim", DIMS)
def test_associated_flow_returns_to_the_nearest_admissible_state_in_energy(dim):
    law, random = Soil(dim, dilatancy_angle=30.0), np.random.default_rng(7)
    others = [random_strain(random, dim, 0.02, 0.02) for _ in range(400)]
    others = [E for E in others if law.yield_function(E) <= 0.0]
    assert len(others) > 50

    def energy(E):
        return np.sum(law.tau(E) * E)

    for E, G in trials(dim, 7, count=60):
        trial, found = by_numpy(E, G), law.advance((E, 0.0, 0.0), G)[0]
        for other in others:  # from the found state a little towards each of them: the admissible states are convex
            assert energy(trial - found) <= energy(trial - found - 1e-3 * (other - found)) * (1.0 + 1e-12) + 1e-20


def principal_strain(law, tau):
    tau = np.array(tau)
    return np.diag((tau - law.lam * tau.sum() / (3.0 * law.lam + 2.0 * law.mu)) / (2.0 * law.mu))


def is_elastic(law, tau):
    """Whether a state of these principal stresses stays as it is."""
    E = principal_strain(law, tau)
    found, _, _ = law.advance((E, 0.0, 0.0), np.zeros((3, 3)))
    return np.abs(found - E).max() < 1e-14


@pytest.mark.parametrize("dim", DIMS)
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_uniaxial_compressive_strength_is_2_c_cos_over_1_less_sin(dim, axis):
    law, phi = Soil(dim), math.radians(30.0)
    strength = 2.0 * 5e3 * math.cos(phi) / (1.0 - math.sin(phi))
    for factor in (1.0 - 1e-9, 1.0 + 1e-9):
        tau = [0.0, 0.0, 0.0]
        tau[axis] = -factor * strength
        assert is_elastic(law, tau) == (factor < 1.0)


@pytest.mark.parametrize("dim", DIMS)
@pytest.mark.parametrize("middle", [0.0, 0.5, 1.0])
def test_without_cohesion_the_peak_ratio_of_stresses_is_1_plus_sin_over_1_less_sin(dim, middle):
    # Of the largest to the smallest pressure, whatever the middle one: triaxial compression, plane strain, extension.
    law, s = Soil(dim, cohesion=0.0), math.sin(math.radians(30.0))
    for factor in (1.0 - 1e-9, 1.0 + 1e-9):
        ratio = factor * (1.0 + s) / (1.0 - s)
        tau = [-1e4 * ratio, -1e4, -1e4 * (1.0 + middle * (ratio - 1.0))]
        assert is_elastic(law, tau) == (factor < 1.0)


@pytest.mark.parametrize("dim", DIMS)
@pytest.mark.parametrize("dilatancy_angle", [0.0, 15.0])
def test_tension_is_cut_off_at_c_over_tan_phi(dim, dilatancy_angle):
    law = Soil(dim, dilatancy_angle=dilatancy_angle)
    E = law.advance(law.rest(), 0.05 * np.eye(3))[0]
    E = law.advance((E + 0.05 * np.diag([0.0, 0.0, 1.0]), 0.0, 0.0), np.zeros((3, 3)))[0]
    assert law.tau(E) == pytest.approx(5e3 / math.tan(math.radians(30.0)) * np.eye(3), rel=1e-12)


@pytest.mark.parametrize("dim", DIMS)
def test_without_friction_tension_has_no_limit_and_shear_has_trescas(dim):
    law, G = Soil(dim, friction_angle=0.0), 0.1 * np.eye(3)
    G[0, 1] = 0.1
    E, _, _ = law.advance(law.rest(), G)
    tau = np.linalg.eigvalsh(law.tau(E))
    assert tau[2] - tau[0] == pytest.approx(2.0 * 5e3, rel=1e-12)
    log_J = math.log(np.linalg.det((np.eye(3) + G)[:dim, :dim]))
    assert np.trace(E) == pytest.approx(log_J, rel=1e-12)


@pytest.mark.parametrize("dim", DIMS)
def test_without_friction_and_cohesion_there_is_no_shear_strength_and_the_trace_is_kept(dim):
    # Round-off decides whether edges cross: without a tip of their own they must meet where the trace says.
    law = Soil(dim, friction_angle=0.0, cohesion=0.0)
    for E, G in trials(dim, 12, count=60):
        trial, found = by_numpy(E, G), law.advance((E, 0.0, 0.0), G)[0]
        assert np.abs(found - np.trace(trial) / 3.0 * np.eye(3)).max() < 1e-15 * 10.0


def test_in_plane_strain_plastic_flow_strains_the_plane_elastically_along_z():
    # Total strain along z is zero; where tau_z is no longer the middle stress, flow takes part of it.
    law, E = Soil(2, cohesion=0.0, poisson_ratio=0.0), np.zeros((3, 3))
    state = E, 0.0, 0.0
    for _ in range(50):
        state = law.advance(state, np.diag([-1e-3, 0.0, 0.0]))
    tau, s = law.tau(state[0]), math.sin(math.radians(30.0))
    assert state[0][2, 2] < -1e-4
    assert tau[0, 0] / tau[2, 2] == pytest.approx((1.0 + s) / (1.0 - s), rel=1e-12)
    found = law("out_of_plane_stress", law.stored(state), law.params)
    assert found == pytest.approx(tau[2, 2], rel=1e-14)


def test_the_plane_is_a_slice_of_space():
    plane, space = (Soil(dim, **SOFTENING, dilatancy_angle=10.0) for dim in DIMS)
    for E, G in trials(2, 8):
        for a, b in zip(plane.advance((E, 0.01, 0.0), G), space.advance((E, 0.01, 0.0), G), strict=True):
            assert np.abs(a - b).max() < 1e-14


@each_option
def test_the_bound_that_spares_eigenvectors_is_a_bound_and_near_in_compression(dim, option):
    law = Soil(dim, **option)
    for s in (0.0, 0.3, 0.7, 0.99):
        for E, _ in trials(dim, 9):
            e = np.linalg.eigvalsh(E) - np.trace(E) / 3.0
            exact = e[2] - e[0] + s * (e[2] + e[0])
            assert law("range_bound", law.stored((E, 0.0, 0.0))[: 4 if dim == 2 else 6], s) >= exact * (1.0 - 1e-12)
    compressed = principal_strain(law, [0.0, 0.0, -1e4])
    e = np.linalg.eigvalsh(compressed) - np.trace(compressed) / 3.0
    exact, strain = e[2] - e[0] + 0.5 * (e[2] + e[0]), law.stored((compressed, 0.0, 0.0))[: 4 if dim == 2 else 6]
    assert law("range_bound", strain, 0.5) < 1.05 * exact


def test_soil_at_rest_under_its_own_weight_needs_no_eigenvectors():
    # K0 = 1 - sin(phi) is inside the pyramid, and the bound must say so.
    law, s = Soil(3, cohesion=0.0), math.sin(math.radians(30.0))
    E = principal_strain(law, [-(1.0 - s) * 1e4, -1e4, -(1.0 - s) * 1e4])
    found = law("range_bound", law.stored((E, 0.0, 0.0)), s)
    assert found + s * (law.lam / law.mu + 2.0 / 3.0) * np.trace(E) < 0.0


# ---- softening ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dim", DIMS)
def test_each_step_returns_to_the_strength_of_its_beginning_until_it_is_residual(dim):
    law = Soil(dim, **SOFTENING)
    state, G = law.advance(law.rest(), -0.01 * np.eye(3)), np.zeros((3, 3))
    G[0, 1] = 1e-3
    flowing = 0
    for _ in range(200):
        before, trial = state[1], by_numpy(state[0], G)
        state = law.advance(state, G)
        if state[1] > before:
            flowing += 1
            assert abs(law.yield_function(state[0], before)) < 1e-12 * law.mu
            plastic = trial - state[0]
            plastic -= np.trace(plastic) / 3.0 * np.eye(3)
            assert state[1] - before == pytest.approx(math.sqrt(2.0 / 3.0) * np.linalg.norm(plastic), rel=1e-9)
    assert flowing > 100
    assert state[1] > law.keys["softening_strain"]
    assert law.strength(state[1]) == pytest.approx((1e3, math.radians(20.0)))


@pytest.mark.parametrize("dim", DIMS)
def test_softened_soil_is_soil_of_the_residual_strength(dim):
    soft = Soil(dim, **SOFTENING)
    residual = Soil(dim, cohesion=1e3, friction_angle=20.0)
    for E, G in trials(dim, 10):
        assert np.abs(soft.advance((E, 1.0, 0.0), G)[0] - residual.advance((E, 0.0, 0.0), G)[0]).max() < 1e-14


def test_cohesion_alone_or_friction_alone_may_soften():
    for one, strength in (
        ({"residual_cohesion": 1e3}, (3e3, math.radians(30.0))),
        ({"residual_friction_angle": 20.0}, (5e3, math.radians(25.0))),
    ):
        law = Soil(3, **one, softening_strain=0.05)
        s, cohesive, apex = law("pyramid", law.stored((np.zeros((3, 3)), 0.025, 0.0)), law.params)
        c, phi = strength
        assert s == pytest.approx(math.sin(phi), rel=1e-14)
        assert cohesive == pytest.approx(c * math.cos(phi) / law.mu, rel=1e-14)
        assert apex == pytest.approx(c / math.tan(phi) / (3.0 * law.lam + 2.0 * law.mu), rel=1e-14)


@pytest.mark.parametrize("degrees", [0.0, 1e-9, 10.0, 45.0, 89.99])
def test_the_sine_by_its_series_is_exact_to_round_off(degrees):
    x = math.radians(degrees)
    assert soil.sine(x) == pytest.approx(math.sin(x), rel=5e-16, abs=0.0)


# ---- volume, states -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("softening", [{}, SOFTENING], ids=["perfect", "softening"])
@pytest.mark.parametrize("dim", DIMS)
def test_with_dilatancy_the_volume_over_a_path_is_the_true_one(dim, softening):
    law, random = Soil(dim, dilatancy_angle=10.0, **softening), np.random.default_rng(11)
    state, log_J, steps = law.rest(), 0.0, 500
    for n in range(steps):
        G = np.zeros((3, 3))
        G[:dim, :dim] = 0.01 * random.normal(size=(dim, dim)) + 0.01 * math.sin(0.05 * n) * np.eye(dim)
        state = law.advance(state, G)
        log_J += math.log(np.linalg.det(np.eye(3) + G))
    assert abs(state[2] + np.trace(state[0]) - log_J) < 1e-12 * steps
    assert law("volume_ratio", law.stored(state)) == pytest.approx(math.exp(log_J), rel=1e-12 * steps)


def test_only_what_options_need_is_kept():
    def kept(**keys):
        return Soil(2, **keys).fields

    assert kept() == []
    assert kept(dilatancy_angle=5.0) == ["v_p"]
    assert kept(**SOFTENING) == ["e_p"]
    assert kept(**SOFTENING, dilatancy_angle=5.0) == ["e_p", "v_p"]


@each_option
def test_states_that_are_not_numbers_or_turned_inside_out_are_invalid(dim, option):
    law = Soil(dim, **option)
    rest = list(law.stored(law.rest()))
    assert law("valid", tuple(rest))
    for place in range(len(rest)):
        state = rest.copy()
        state[place] = math.nan
        assert not law("valid", tuple(state))
        assert not law("valid", law("advance", tuple(state), (0.0,) * (dim * dim), 1.0, law.params))
    for bad in (-1.0, -2.0, math.nan):
        G = np.zeros((3, 3))
        G[0, 0] = bad
        assert not law("valid", law.stored(law.advance(law.rest(), G)))


@pytest.mark.parametrize("dim", DIMS)
def test_small_strains_yield_like_large_ones(dim):
    # No absolute epsilon: the same path at 1e-9 of the strain ends at the same ratio of stresses.
    law, s = Soil(dim, cohesion=0.0), math.sin(math.radians(30.0))
    G = np.zeros((3, 3))
    G[0, 1] = 1e-9
    E, _, _ = law.advance((-1e-10 * np.eye(3), 0.0, 0.0), G)
    tau = np.linalg.eigvalsh(law.tau(E))
    assert tau[0] / tau[2] == pytest.approx((1.0 + s) / (1.0 - s), rel=1e-6)
