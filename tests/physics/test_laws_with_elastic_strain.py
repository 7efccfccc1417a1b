"""What holds for every law that keeps its elastic logarithmic strain: energy, objectivity, plane strain, waves, volume."""

import math

import numpy as np
import pytest
from flat import flat, in_dimension, random_rotation, random_stretch
from materials_by_hand import Particle, in_space, random_increment

from pmpm.physics import hencky

ELASTIC = {"density": 1000.0, "youngs_modulus": 1000.0, "poisson_ratio": 0.3}
CLAY = {
    "model": "cam_clay",
    "density": 1000.0,
    "shear_modulus": 400.0,
    "swelling_index": 0.1,
    "compression_index": 0.3,
    "friction_angle": 25.0,
    "preconsolidation_pressure": 50.0,
}
MUD = {
    "model": "bingham",
    "density": 1000.0,
    "bulk_modulus": 1000.0,
    "shear_modulus": 400.0,
    "yield_stress": 20.0,
    "viscosity": 0.5,
}
MATERIALS = {
    "metal": {"model": "von_mises", **ELASTIC, "yield_stress": 50.0, "hardening_modulus": 100.0},
    "clay": {**CLAY, "initial_pressure": 30.0},
    "clay with attraction": {**CLAY, "attraction": 30.0},
    "grains": {
        "model": "mu_i",
        **ELASTIC,
        "static_friction": 0.38,
        "dynamic_friction": 0.64,
        "grain_diameter": 1e-3,
        "grain_density": 2500.0,
    },
    "mud": MUD,
    "thinning mud": MUD | {"viscosity": 5.0, "flow_index": 0.5},
    "thickening mud": MUD | {"flow_index": 1.5, "gamma": 1.0},
}
STIFFNESS, DT = 1000.0, 1e-3
each_material = pytest.mark.parametrize("name", MATERIALS)
each_dimension = pytest.mark.parametrize("dim", [2, 3])


def particle(name, dim, F=None):
    return Particle(dim, F, **MATERIALS[name])


def deformation(random, dim, largest):
    """Compressed by 5 % at least, so that no law is at the kink where it opens."""
    F = random_stretch(random, dim, largest) @ random_rotation(random, dim)
    return F * (min(0.95 / np.linalg.det(F), 1.0)) ** (1.0 / dim)


def difference_quotient(function, F, direction):
    """Derivative along `direction`, to fourth order in a step at which h^4 and eps / h are both far below 1e-7."""
    h = 2e-4
    near = function(F + h * direction) - function(F - h * direction)
    far = function(F + 2.0 * h * direction) - function(F - 2.0 * h * direction)
    return (8.0 * near - far) / (12.0 * h)


def elastic_tau(name, dim, F):
    return particle(name, dim, F).tau()[:dim, :dim]


@each_dimension
@each_material
def test_stress_is_the_derivative_of_the_energy(name, dim):
    random = np.random.default_rng(1)
    for _ in range(8):
        F = deformation(random, dim, 0.3)
        P = np.empty((dim, dim))
        for i, j in np.ndindex(dim, dim):
            direction = np.zeros((dim, dim))
            direction[i, j] = 1.0
            P[i, j] = difference_quotient(lambda A: particle(name, dim, A).energy, F, direction)
        tau = elastic_tau(name, dim, F)
        assert np.abs(P @ F.T - tau).max() <= 1e-7 * np.abs(tau).max()


def path(random, dim, steps=20, size=0.02):
    """Increments that shear, compress and open."""
    for n in range(steps):
        yield random_increment(random, dim, size) + 0.02 * math.sin(0.6 * n) * np.diag([1.0, 1.0, float(dim == 3)])


@each_dimension
@each_material
def test_stress_turns_with_the_body(name, dim):
    random = np.random.default_rng(2)
    F, Q = deformation(random, dim, 0.1), random_rotation(random, dim)
    one, turned, R = particle(name, dim, F), particle(name, dim, Q @ F), np.eye(3)
    R[:dim, :dim] = Q
    for G in path(random, dim):
        one.advance(G, DT)
        turned.advance(R @ G @ R.T, DT)
        assert np.abs(R @ one.tau() @ R.T - turned.tau()).max() < 1e-10 * STIFFNESS


@each_material
def test_in_a_plane_of_space_all_is_as_in_plane_strain(name):
    # Plane strain is the law of space without motion along z.
    random = np.random.default_rng(3)
    plane, space = particle(name, 2), particle(name, 3)
    for G in path(random, 2):
        plane.advance(G, DT)
        space.advance(G, DT)
        assert np.abs(plane.tau() - space.tau()).max() < 1e-10 * STIFFNESS
        assert plane.energy == pytest.approx(space.energy, abs=1e-10 * STIFFNESS)
        assert plane.rest == pytest.approx(space.rest, abs=1e-12)


@each_dimension
@each_material
def test_volume_ratio_is_that_of_the_motion(name, dim):
    random, one, volume = np.random.default_rng(4), particle(name, dim), 1.0
    for G in path(random, dim, steps=60):
        one.advance(G, DT)
        volume *= np.linalg.det(np.eye(3) + G)
        assert one.volume == pytest.approx(volume, rel=1e-12)


@each_dimension
@each_material
def test_plastic_flow_dissipates(name, dim):
    random, one, flowed = np.random.default_rng(5), particle(name, dim), 0
    trial_strain = in_dimension(hencky.trial_strain_solid, dim)
    size = 4 if dim == 2 else 6
    for G in path(random, dim, steps=60):
        trial = trial_strain(one.state[:size], flat(G[:dim, :dim]))
        one.advance(G, DT)
        trial = in_space(trial[:3], trial[3]) if dim == 2 else in_space(trial, None)
        dissipated = np.tensordot(one.tau(), trial - one.strain)
        flowed += dissipated > 1e-3
        assert dissipated > -1e-12 * STIFFNESS
    assert flowed > 5


def squared_waves(name, dim, F, n):
    """rho0 c^2 of the plane waves along n: eigenvalues of the spatial acoustic tensor, see test_elastic_laws."""
    pulled = F.T @ n
    columns = []
    for k in range(dim):
        direction = np.zeros((dim, dim))
        direction[k] = pulled
        columns.append(
            difference_quotient(lambda A: elastic_tau(name, dim, A) @ np.linalg.inv(A).T @ pulled, F, direction)
        )
    return np.linalg.eigvals(np.array(columns).T).real


@pytest.mark.parametrize("largest", [0.01, 0.3])
@each_dimension
@each_material
def test_no_wave_is_faster_than_the_bound(name, dim, largest):
    random = np.random.default_rng(6)
    for _ in range(5):
        F = deformation(random, dim, largest)
        one = particle(name, dim, F)
        bound = 1000.0 * one("wave_speed_squared", one.state, one.params, 1000.0)
        for n in [*np.linalg.svd(F)[0].T, *random.normal(size=(5, dim))]:
            assert squared_waves(name, dim, F, n / np.linalg.norm(n)).max() <= bound * (1.0 + 1e-6)


@each_dimension
@each_material
def test_the_bound_is_tight_in_a_slightly_strained_particle(name, dim):
    F = np.eye(dim) * 0.998  # mud opens at 1, where its derivative jumps
    one = particle(name, dim, F)
    bound = 1000.0 * one("wave_speed_squared", one.state, one.params, 1000.0)
    # Strains of 0.2 % count with either sign; clay counts the attraction as pressure, by swelling_index of its bulk modulus.
    assert squared_waves(name, dim, F, np.eye(dim)[0]).max() == pytest.approx(
        bound, rel=0.06 if "clay" in name else 0.01
    )


@each_dimension
@each_material
def test_a_particle_turned_inside_out_is_not_valid(name, dim):
    G = np.zeros((3, 3))
    G[0, 0] = -2.0
    assert particle(name, dim).valid
    assert not particle(name, dim).advance(G, DT).valid


@each_dimension
@each_material
def test_not_a_number_is_not_valid(name, dim):
    one = particle(name, dim)
    for place in range(dim * dim):
        G = np.zeros((dim, dim))
        G.flat[place] = math.nan
        assert not particle(name, dim).advance(np.pad(G, (0, 3 - dim)), DT).valid
    for place in range(4 if dim == 2 else 6):
        state = list(one.state)
        state[place] = math.nan
        one.state = tuple(state)
        assert not one.valid
        assert not one.advance(np.zeros((3, 3)), DT).valid
        one = particle(name, dim)


@each_dimension
@pytest.mark.parametrize("name", [name for name in MATERIALS if name != "clay"])
def test_an_undeformed_particle_bears_no_stress_and_stores_no_energy(name, dim):
    one = particle(name, dim)
    assert np.abs(one.tau()).max() < 1e-14 * STIFFNESS
    assert abs(one.energy) < 1e-14 * STIFFNESS


@each_dimension
@each_material
def test_state_at_a_deformation_is_its_logarithm(name, dim):
    F = deformation(np.random.default_rng(7), dim, 0.3)
    s, Q = np.linalg.eigh(F @ F.T)
    found = particle(name, dim, F).strain[:dim, :dim]
    assert np.abs(found - (Q * (0.5 * np.log(s))) @ Q.T).max() < 1e-14
