"""Solids, weakly compressible fluid and the Hencky elasticity of sand and soil: stress against energy, limits, waves."""

import numpy as np
import pytest
from flat import flat, full, in_dimension, random_rotation, random_stretch, symmetric

from pmpm.physics.materials import LAWS

DIMS = (2, 3)
MODELS = ("neo_hookean", "hencky", "fluid", "drucker_prager", "mohr_coulomb")
ELASTIC = {"density": 1000.0, "youngs_modulus": 1e6, "poisson_ratio": 0.3}
KEYS = {
    "neo_hookean": ELASTIC,
    "hencky": ELASTIC,
    "fluid": {"density": 1000.0, "bulk_modulus": 1e6, "gamma": 7.0},
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


@pytest.mark.parametrize("model", ["neo_hookean", "hencky", "drucker_prager", "mohr_coulomb"])
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
        assert not law("valid", law.advance(rest, G))
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


def test_sound_speed_and_bulk_modulus_are_two_names_for_one_stiffness():
    module = LAWS["fluid"]
    by_speed = module.parameters({"density": 1000.0, "sound_speed": 20.0, "gamma": 7.0}, 2)
    assert by_speed == module.parameters({"density": 1000.0, "bulk_modulus": 4e5, "gamma": 7.0}, 2)


@pytest.mark.parametrize("gamma", [1.0, 1.4, 7.0])
def test_hydrostatic_state_carries_the_weight_above(gamma):
    # The internal force is V0 times the gradient of tau = -J p, and seeded particles are spaced as at rest.
    law = Law("fluid", 2, gamma=gamma)
    for depth in (0.0, 0.1, 1.0, 20.0, 90.0):  # m; up to 0.9 of the bulk modulus
        state = law("hydrostatic_state", depth, 10.0, law.params, 1000.0)
        tau = symmetric(law("kirchhoff_stress", state, law.params))
        assert tau == pytest.approx(-1000.0 * 10.0 * depth * np.eye(2), rel=1e-9, abs=1e-9)
