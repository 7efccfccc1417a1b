"""Solids, weakly compressible fluid and the Hencky elasticity of sand and soil.

Stress against energy, limits, waves.
"""

import itertools

import numpy as np
import pytest
from flat import (
    EPS,
    WORDS,
    flat,
    flat_symmetric,
    full,
    in_dimension,
    random_rotation,
    random_stretch,
    symmetric,
)

from pmpm.kernels import targets
from pmpm.physics.materials import LAWS

DIMS = (2, 3)
MODELS = ("neo_hookean", "fixed_corotated", "hencky", "fluid", "drucker_prager", "mohr_coulomb")
KEEP_F = ("neo_hookean", "fixed_corotated")  # laws whose state is the deformation gradient
ELASTIC = {"density": 1000.0, "youngs_modulus": 1e6, "poisson_ratio": 0.3}
KEYS = {
    "neo_hookean": ELASTIC,
    "fixed_corotated": ELASTIC,
    "hencky": ELASTIC,
    "fluid": {"density": 1000.0, "bulk_modulus": 1e6, "gamma": 7.0, "viscosity": 0.0, "tension_cutoff": True},
    "drucker_prager": {
        "density": 2000.0,
        "youngs_modulus": 1e6,
        "poisson_ratio": 0.3,
        "friction_angle": 30.0,
        "cohesion": 0.0,
        "dilatancy_angle": 0.0,
        "volume_correction": True,
    },
    "mohr_coulomb": ELASTIC | {"friction_angle": 30.0, "cohesion": 1e9, "dilatancy_angle": 0.0},  # elastic all the way
}
MU, LAM = 1e6 / 2.6, 0.3e6 / (1.3 * 0.4)  # of E = 1 MPa, nu = 0.3
CASES = [(model, dim) for model in MODELS for dim in DIMS]


class Law:
    """A law's functions as functions of the deformation gradient, in numpy matrices."""

    def __init__(self, model, dim, **keys):
        self.module, self.model, self.dim = LAWS[model], model, dim
        self.keys = KEYS[model] | keys
        self.params = self.module.parameters(self.keys, dim)
        self.choices = self.module.choices(self.keys)

    def __call__(self, name, *arguments):
        return in_dimension(getattr(self.module, name), self.dim, **self.choices)(*arguments)

    def state(self, F):
        """The state of a particle that was deformed elastically by F."""
        return self("state_at", flat(F), self.params)

    def tau(self, F):
        return symmetric(self("kirchhoff_stress", self.state(F), self.params))

    def energy(self, F):
        return self("energy", self.state(F), self.params)

    def advance(self, state, G):
        return self("advance", state, flat(G), 1.0, self.params)


def deformation(random, dim, largest):
    return random_stretch(random, dim, largest) @ random_rotation(random, dim)


def difference_quotient(function, F, direction):
    """Derivative along `direction`, to fourth order in a step at which h^4 and eps / h are both far below 1e-7."""
    h = 2e-4
    near = function(F + h * direction) - function(F - h * direction)
    far = function(F + 2.0 * h * direction) - function(F - 2.0 * h * direction)
    return (8.0 * near - far) / (12.0 * h)


@pytest.mark.parametrize("largest", [0.01, 0.5])
@pytest.mark.parametrize(("model", "dim"), CASES)
def test_stress_is_the_derivative_of_the_energy(model, dim, largest):
    law, random = Law(model, dim), np.random.default_rng(1)
    for _ in range(20):
        F = deformation(random, dim, largest)
        if model == "fluid":  # away from the cut-off at J = 1, where the second derivative jumps
            F = F * (np.exp(-2.0 * largest) if largest > 0.1 else 0.97)
        P = np.empty((dim, dim))
        for i, j in np.ndindex(dim, dim):
            direction = np.zeros((dim, dim))
            direction[i, j] = 1.0
            P[i, j] = difference_quotient(law.energy, F, direction)
        tau = law.tau(F)
        assert np.abs(P @ F.T - tau).max() <= 1e-7 * np.abs(tau).max()


@pytest.mark.parametrize(("model", "dim"), CASES)
def test_rest_state_is_free_of_stress_and_energy(model, dim):
    law = Law(model, dim)
    assert (law.tau(np.eye(dim)) == 0.0).all()
    assert law.energy(np.eye(dim)) == 0.0
    assert law("out_of_plane_stress", law.state(np.eye(dim)), law.params) == 0.0


@pytest.mark.parametrize("dim", DIMS)
@pytest.mark.parametrize("model", MODELS)
def test_a_rotation_makes_no_stress(model, dim):
    law = Law(model, dim)
    R = random_rotation(np.random.default_rng(2), dim)
    assert np.abs(law.tau(R)).max() < 1e-14 * 1e6 * 7.0


@pytest.mark.parametrize(("model", "dim"), CASES)
def test_stress_turns_with_the_body_and_not_with_the_material(model, dim):
    law, random = Law(model, dim), np.random.default_rng(3)
    for _ in range(20):
        F, Q = deformation(random, dim, 0.5), random_rotation(random, dim)
        tau = law.tau(F)
        scale = 1e-12 * max(np.abs(tau).max(), 1e6)
        assert np.abs(law.tau(Q @ F) - Q @ tau @ Q.T).max() < scale
        assert np.abs(law.tau(F @ Q) - tau).max() < scale
        assert abs(law.energy(Q @ F @ Q.T) - law.energy(F)) < scale


@pytest.mark.parametrize("model", [*KEEP_F, "hencky", "drucker_prager", "mohr_coulomb"])
@pytest.mark.parametrize("dim", DIMS)
def test_small_strain_limit_is_hookes_law(dim, model):
    law, random, small = Law(model, dim), np.random.default_rng(4), 1e-7
    for _ in range(20):
        H = random.normal(size=(dim, dim))
        if model == "drucker_prager":
            H -= (10.0 + np.trace(H)) * np.eye(dim)  # well inside the cone
        state = law.advance(law.state(np.eye(dim)), small * H)
        tau = symmetric(law("kirchhoff_stress", state, law.params)) / small
        expected = MU * (H + H.T) + LAM * np.trace(H) * np.eye(dim)
        assert np.abs(tau - expected).max() < 1e-5 * np.abs(expected).max()


@pytest.mark.parametrize("dim", DIMS)
def test_small_compression_of_a_fluid_meets_its_bulk_modulus(dim):
    law = Law("fluid", dim)
    H = np.random.default_rng(5).normal(size=(dim, dim))
    H -= (1.0 + np.trace(H)) * np.eye(dim)
    (J,) = law.advance((1.0,), 1e-7 * H)
    expected = 1e6 * 1e-7 * np.trace(H)
    assert symmetric(law("kirchhoff_stress", (J,), law.params)) == pytest.approx(expected * np.eye(dim), rel=1e-5)


@pytest.mark.parametrize("dim", DIMS)
def test_in_a_plane_of_space_stress_is_that_of_plane_strain(dim):
    # Plane strain is the 3-D law with F_zz = 1 and no shear out of the plane.
    random = np.random.default_rng(6)
    for model in MODELS:
        plane, space = Law(model, 2), Law(model, 3)
        F = deformation(random, 2, 0.3)
        whole = np.eye(3)
        whole[:2, :2] = F
        tau = space.tau(whole)
        assert np.abs(tau[:2, :2] - plane.tau(F)).max() < 1e-9 * 1e6
        assert abs(tau[2, 2] - plane("out_of_plane_stress", plane.state(F), plane.params)) < 1e-9 * 1e6
        assert abs(space.energy(whole) - plane.energy(F)) < 1e-9 * 1e6


def squared_waves(law, F, n):
    """rho0 c^2 of the plane waves along n in a body deformed by F: eigenvalues of its spatial acoustic tensor.

    rho a_i = d/dx_j (..) gives rho0 c^2 m = Q m with Q_ik = F_jJ F_lL dP_iJ/dF_kL n_j n_l.
    """
    pulled = F.T @ n

    def traction(G):
        return law.tau(G) @ np.linalg.inv(G).T @ pulled

    columns = []
    for k in range(law.dim):
        direction = np.zeros((law.dim, law.dim))
        direction[k] = pulled
        columns.append(difference_quotient(traction, F, direction))
    return np.linalg.eigvals(np.array(columns).T).real


def waves_and_bound(model, dim, largest, count=15, **keys):
    """Pairs (largest rho0 c^2 over directions, bound) for random elastic deformations, fluids compressed."""
    law, random = Law(model, dim, **keys), np.random.default_rng(7)
    for _ in range(count):
        F = deformation(random, dim, largest)
        if model == "fluid":
            F = F * (0.9 / max(np.linalg.det(F), 0.9)) ** (1.0 / dim)
        principal = np.linalg.svd(F)[0].T
        directions = [*principal, *random.normal(size=(12, dim))]
        fastest = max(squared_waves(law, F, n / np.linalg.norm(n)).max() for n in directions)
        yield fastest, law.keys["density"] * law("wave_speed_squared", law.state(F), law.params, law.keys["density"])


@pytest.mark.parametrize("largest", [0.01, 0.3, 1.0])
@pytest.mark.parametrize(("model", "dim"), CASES)
def test_no_wave_is_faster_than_the_bound(model, dim, largest):
    for fastest, bound in waves_and_bound(model, dim, largest):
        assert fastest <= bound * (1.0 + 1e-6)


@pytest.mark.parametrize("poisson_ratio", [-0.6, 0.0, 0.45])
@pytest.mark.parametrize("largest", [0.3, 2.0])
@pytest.mark.parametrize("dim", DIMS)
def test_no_wave_in_a_hencky_solid_is_faster_than_the_bound_at_any_strain(dim, largest, poisson_ratio):
    for fastest, bound in waves_and_bound("hencky", dim, largest, poisson_ratio=poisson_ratio):
        assert fastest <= bound * (1.0 + 1e-6)


@pytest.mark.parametrize(("model", "dim"), CASES)
def test_the_bound_is_the_wave_speed_at_rest(model, dim):
    law = Law(model, dim)
    modulus = 1e6 if model == "fluid" else LAM + 2.0 * MU
    found = law("wave_speed_squared", law.state(np.eye(dim)), law.params, law.keys["density"])
    assert found == pytest.approx(modulus / law.keys["density"], rel=1e-14)


@pytest.mark.parametrize(("model", "dim"), CASES)
def test_volume_ratio_is_the_determinant(model, dim):
    law, random = Law(model, dim), np.random.default_rng(8)
    F = deformation(random, dim, 0.5)
    assert law("volume_ratio", law.state(F)) == pytest.approx(np.linalg.det(F), rel=1e-13)


@pytest.mark.parametrize(("model", "dim"), CASES)
def test_deforming_by_increments_multiplies_them(model, dim):
    law, random = Law(model, dim), np.random.default_rng(9)
    F = np.eye(dim) * 0.8  # compressed enough for sand to stay elastic
    state = law.state(F)
    for _ in range(20):
        G = 0.002 * random.normal(size=(dim, dim))
        state, F = law.advance(state, G), F + G @ F
    tau = symmetric(law("kirchhoff_stress", state, law.params))
    # A fluid takes J + J tr G, not J det(I + G): second order in G.
    assert np.abs(tau - law.tau(F)).max() < (1e-3 if model == "fluid" else 1e-12) * np.abs(tau).max()


@pytest.mark.parametrize(("model", "dim"), CASES)
def test_states_turned_inside_out_or_not_numbers_are_invalid(model, dim):
    law = Law(model, dim)
    rest = law.state(np.eye(dim))
    assert law("valid", rest)
    for bad in (-2.0, -1.0, float("nan")):  # I + G has determinant below zero, zero, nan
        G = np.zeros((dim, dim))
        G[0, 0] = bad
        endures = model == "fixed_corotated" and bad == bad
        assert law("valid", law.advance(rest, G)) == endures
    for place in range(len(rest) - (model == "drucker_prager")):
        state = list(rest)
        state[place] = float("nan")
        assert not law("valid", tuple(state))


@pytest.mark.parametrize(("model", "dim"), CASES)
def test_invalid_states_still_give_finite_or_nan_numbers_and_no_error(model, dim):
    law = Law(model, dim)
    G = np.zeros((dim, dim))
    G[0, 0] = -3.0
    state = law.advance(law.state(np.eye(dim)), G)
    law("kirchhoff_stress", state, law.params)
    law("wave_speed_squared", state, law.params, 1000.0)
    law("energy", state, law.params)


# ---- laws that keep F, far from rest -------------------------------------------------------------------------------------


def of_stretches(random, s):
    """U diag(s) V^T with random rotations U and V."""
    return (random_rotation(random, len(s)) * s) @ random_rotation(random, len(s)).T


def far_stretches(dim):
    """Stretches of condition 1, 10 and 1000 and of determinant 1e-6 to 1000, graded, or the first or last two equal."""
    for condition, det in itertools.product((1.0, 10.0, 1e3), (1e-6, 1e-3, 1.0, 1e3)):
        for between in (0.5, 0.0, 1.0) if dim == 3 and condition > 1.0 else (0.5,):
            exponents = (0.0, between, 1.0) if dim == 3 else (0.0, 1.0)
            s = condition ** -np.array(exponents)
            yield s * (det / s.prod()) ** (1.0 / dim)


def far_deformations(model, dim):
    """Deformations of far_stretches, those of fixed corotated also turned inside out: (F, whether energy is smooth at F)."""
    random = np.random.default_rng(10)
    for s in far_stretches(dim):
        yield of_stretches(random, s), True
        if model == "fixed_corotated":
            inside_out = np.append(s[:-1], -s[-1])
            yield of_stretches(random, inside_out), s[-2] > 1.5 * s[-1]  # at s_i = -s_j the energy has a ridge


@pytest.mark.parametrize("dim", DIMS)
@pytest.mark.parametrize("model", KEEP_F)
def test_far_from_rest_stress_is_still_the_derivative_of_the_energy(model, dim):
    # tau:D is the derivative of psi((I + h D) F): a step that suits stretches of any size.
    law, unit = Law(model, dim), np.eye(dim)
    for F, smooth in far_deformations(model, dim):
        tau = law.tau(F)
        if not smooth:
            assert np.isfinite(tau).all()
            continue
        slope = np.empty((dim, dim))
        for i, j in np.ndindex(dim, dim):
            slope[i, j] = difference_quotient(
                lambda D, F=F: law.energy((unit + D) @ F), 0.0, np.outer(unit[i], unit[j])
            )
        assert np.abs(slope - tau).max() <= 1e-7 * max(
            np.abs(tau).max(), law.energy(F), 10.0
        )  # Pa; a rotation has none


@pytest.mark.parametrize("dim", DIMS)
@pytest.mark.parametrize("model", KEEP_F)
def test_far_from_rest_stress_turns_with_the_body_and_not_with_the_material(model, dim):
    law, random = Law(model, dim), np.random.default_rng(11)
    for F, smooth in far_deformations(model, dim):
        Q = random_rotation(random, dim)
        psi, tau = law.energy(F), law.tau(F)
        # Turning F rounds it, and its determinant by as much as condition^(dim - 1) eps, at most 1e-10.
        scale = 1e-9 * max(np.abs(tau).max(), psi, 1e6)
        assert psi >= 0.0
        assert abs(law.energy(Q @ F) - psi) < scale
        assert abs(law.energy(F @ Q) - psi) < scale
        if smooth:
            assert np.abs(law.tau(Q @ F) - Q @ tau @ Q.T).max() < scale
            assert np.abs(law.tau(F @ Q) - tau).max() < scale


@pytest.mark.parametrize("det", [1e-8, 1e-16, 1e-300])
@pytest.mark.parametrize("dim", DIMS)
@pytest.mark.parametrize("model", KEEP_F)
def test_a_vanishing_volume_gives_finite_numbers(model, dim, det):
    law = Law(model, dim)
    for s in (np.array([1.0] * (dim - 1) + [det]), np.full(dim, det ** (1.0 / dim))):
        for F in (np.diag(s), of_stretches(np.random.default_rng(12), s)):
            speed = law("wave_speed_squared", law.state(F), law.params, 1000.0)
            assert np.isfinite([*law.tau(F).ravel(), law.energy(F), speed]).all() or not law("valid", law.state(F))


# ---- fixed corotated -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dim", DIMS)
def test_a_rotation_of_a_corotated_solid_is_free_of_stress_to_a_few_eps_of_its_stiffness(dim):
    law, random = Law("fixed_corotated", dim), np.random.default_rng(13)
    for _ in range(500):
        assert np.abs(law.tau(random_rotation(random, dim))).max() <= 1e-15 * 1e6


@pytest.mark.parametrize("dim", DIMS)
def test_principal_stresses_of_a_corotated_solid_follow_its_stretches_through_inversion(dim):
    """tau_i = s_i dpsi/ds_i, psi = mu sum (s_i - 1)^2 + lam/2 (J - 1)^2; at s_i < 0 it is above zero, which pushes s_i to 1."""
    law, random = Law("fixed_corotated", dim), np.random.default_rng(14)
    others = np.array([1.4, 0.8][: dim - 1])
    for smallest in (0.7, 0.1, 1e-9, 0.0, -1e-9, -0.1, -0.7):
        s = np.append(others, smallest)
        U, V = random_rotation(random, dim), random_rotation(random, dim)
        J = s.prod()
        expected = 2.0 * MU * (s - 1.0) * s + LAM * (J - 1.0) * J
        found = U.T @ law.tau((U * s) @ V.T) @ U
        # Where two stretches of opposite sign are of nearly one size, R follows the round-off of F: 1 / (0.8 - 0.7) here.
        assert np.abs(found - np.diag(expected)).max() <= 100.0 * EPS * 1e6
        assert (expected[-1] > 0.0) == (smallest < 0.0)


@pytest.mark.parametrize("dim", DIMS)
def test_the_force_on_a_corotated_solid_opens_the_smallest_stretch_toward_one(dim):
    law, random = Law("fixed_corotated", dim), np.random.default_rng(15)
    for _ in range(20):
        s = np.sort(random.uniform(0.5, 1.5, dim))[::-1]
        U, V = random_rotation(random, dim), random_rotation(random, dim)
        energies = []
        for smallest in np.linspace(-0.95, 0.95, 20) * s[-1]:
            s[-1] = smallest
            energies.append(law.energy((U * s) @ V.T))
        J_rest = s[:-1].prod()
        if J_rest * 0.95 * s[-1] < 1.0 and s[-1] < 1.0:
            assert (np.diff(energies) < 0.0).all()


@pytest.mark.parametrize("dim", DIMS)
def test_a_corotated_state_is_refused_only_where_it_is_no_number_or_absurd(dim):
    law = Law("fixed_corotated", dim)
    for F in (np.zeros((dim, dim)), -np.eye(dim), np.diag([1.0, -1.0, 1.0][:dim]), 1e5 * np.eye(dim)):
        assert law("valid", flat(F))
    for bad in (np.nan, np.inf, -np.inf, 1e7, 1e200):
        for place in range(dim * dim):
            state = list(flat(np.eye(dim)))
            state[place] = bad
            assert not law("valid", tuple(state))


@pytest.mark.parametrize(
    "stretches",
    [
        (1.0, 0.3, 0.05),
        (0.1, 0.08, 0.05),
        (5.0, 3.0, 2.0),
        (5.0, 1.0, 0.2),
        (1.2, 1.0, -0.6),
        (0.5, 0.3, -0.1),
        (3.0, 2.0, -1.0),
    ],
)
@pytest.mark.parametrize("nu", [-0.4, 0.0, 0.3, 0.49])
@pytest.mark.parametrize("dim", DIMS)
def test_no_wave_in_a_corotated_solid_is_faster_than_the_bound_in_compression_stretch_and_inversion(dim, nu, stretches):
    law, random = Law("fixed_corotated", dim, poisson_ratio=nu), np.random.default_rng(16)
    mu, lam = law.params
    s = np.array(stretches[-dim:])
    F = of_stretches(random, s)
    principal = np.linalg.svd(F)[0].T
    directions = [*principal, *random.normal(size=(12, dim))]
    fastest = max(squared_waves(law, F, n / np.linalg.norm(n)).max() for n in directions)
    bound = 1000.0 * law("wave_speed_squared", law.state(F), law.params, 1000.0)
    assert fastest <= bound * (1.0 + 1e-6)
    if lam >= 0.0:  # along the longest axis the bound is met but for the row sums
        assert fastest == pytest.approx(2.0 * mu * s[0] * s[0] + lam * s.prod() ** 2, rel=1e-5)


@pytest.mark.parametrize("dim", DIMS)
def test_in_float32_a_corotated_stress_errs_by_the_round_off_of_stretches_of_one(dim):
    """So strains below 1e-6 are noise there: F - R of numbers near 1, however small the strain."""
    random, eps = np.random.default_rng(17), float(np.finfo(np.float32).eps)
    law = Law("fixed_corotated", dim)
    F = np.stack([flat(deformation(random, dim, 1e-4)) for _ in range(500)]).astype(np.float32)
    target = targets.arrays(np.float32, la=WORDS[dim])
    found = target.compile(law.module.kirchhoff_stress)(tuple(F.T), tuple(map(np.float32, law.params)))
    expected = np.array([flat_symmetric(law.tau(row.reshape(dim, dim).astype(float))) for row in F]).T
    assert np.abs(np.subtract(found, expected)).max() <= 10.0 * eps * 1e6


@pytest.mark.parametrize("dim", DIMS)
def test_stretching_a_hencky_solid_along_an_axis_gives_its_closed_form(dim):
    # tau = (lam + 2 mu) ln F along the axis, lam ln F across: largest nominal stress where ln F = 1.
    law = Law("hencky", dim)
    F = np.eye(dim)
    F[0, 0] = np.e
    expected = np.diag([LAM + 2.0 * MU, LAM, LAM][:dim])
    assert np.abs(law.tau(F) - expected).max() < 1e-14 * 1e6 * dim


@pytest.mark.parametrize("gamma", [1.0, 4.0, 7.0])
def test_fluid_pressure_is_taits_equation_and_never_suction(gamma):
    law = Law("fluid", 3, gamma=gamma)
    for J in (0.5, 0.9, 0.999):
        tau = full((*law("kirchhoff_stress", (J,), law.params)[:3], 0, 0, 0, 0, 0, 0))
        assert -tau[0, 0] / J == pytest.approx(1e6 / gamma * (J**-gamma - 1.0), rel=1e-11)
    assert law("pressure", 1.1, law.params) == 0.0


@pytest.mark.parametrize("gamma", [1.0, 4.0, 7.0])
def test_sound_speed_squared_is_dp_drho(gamma):
    law, h = Law("fluid", 3, gamma=gamma), 1e-5
    for density in (1100.0, 1500.0):
        above, below = (law("pressure", 1000.0 / rho, law.params) for rho in (density * (1 + h), density * (1 - h)))
        slope = (above - below) / (2.0 * h * density)
        assert law("wave_speed_squared", (1000.0 / density,), law.params, 1000.0) == pytest.approx(slope, rel=1e-8)


@pytest.mark.parametrize("gamma", [1.0, 4.0, 7.0])
def test_fluid_energy_is_the_work_of_pressure(gamma):
    law = Law("fluid", 3, gamma=gamma)
    nodes, weights = np.polynomial.legendre.leggauss(20)
    J = 0.7
    places = J + 0.5 * (1.0 - J) * (nodes + 1.0)
    work = (
        0.5 * (1.0 - J) * sum(w * law("pressure", float(s), law.params) for w, s in zip(weights, places, strict=True))
    )
    assert law("energy", (J,), law.params) == pytest.approx(work, rel=1e-12)


@pytest.mark.parametrize("gamma", [1.0, 1.4, 7.0])
def test_hydrostatic_state_carries_the_weight_above(gamma):
    # The internal force is V0 times the gradient of tau = -J p, and seeded particles are spaced as at rest.
    law = Law("fluid", 2, gamma=gamma)
    for depth in (0.0, 0.1, 1.0, 20.0, 90.0):  # m; up to 0.9 of the bulk modulus
        state = law("hydrostatic_state", depth, 10.0, law.params, 1000.0)
        tau = symmetric(law("kirchhoff_stress", state, law.params))
        assert tau == pytest.approx(-1000.0 * 10.0 * depth * np.eye(2), rel=1e-9, abs=1e-9)
