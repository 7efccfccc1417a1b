"""Ground that starts at rest: the stress of its weight, K0 across, and no motion when it is let go."""

import math

import numpy as np
import pytest

import pmpm
from pmpm.kernels import targets
from pmpm.kernels.needs import LawNeeds
from pmpm.physics import hencky, tensors2
from pmpm.physics.materials.keys import StateField
from pmpm.scene import geostatic

DENSITY, GRAVITY, HEIGHT, DX = 2000.0, 10.0, 1.0, 0.1
ELASTIC = {"density": DENSITY, "youngs_modulus": 1e6, "poisson_ratio": 0.3}
LAWS = {
    "neo_hookean": {"model": "neo_hookean", **ELASTIC},
    "drucker_prager": {"model": "drucker_prager", **ELASTIC, "friction_angle": 30.0},
}
each_column = pytest.mark.parametrize(("model", "dim"), [(model, dim) for model in LAWS for dim in (2, 3)])


def column(model, dim, stress, keys=None):
    """A column of a metre between slip walls."""
    across = [4.0 * DX] * (dim - 1)
    walls = {f"{axis}_{end}": "slip" for axis in "xyz"[:dim] for end in ("min", "max")}
    del walls[f"{'xyz'[dim - 1]}_max"]
    return pmpm.Scene(
        domain={
            "size": [*across, HEIGHT + 2.0 * DX],
            "cell_size": DX,
            "gravity": [0.0] * (dim - 1) + [-GRAVITY],
            "walls": walls,
        },
        time={"end": 1.0},
        materials={"ground": LAWS[model] | (keys or {})},
        bodies=[
            {
                "material": "ground",
                "shape": {"type": "box", "min": [0.0] * dim, "max": [*across, HEIGHT]},
                **({} if stress is None else {"stress": {"type": "geostatic", **stress}}),
            }
        ],
    )


def fastest(scene, steps=60):
    """Largest speed of a particle over some steps, in units of sqrt(g h); and the time they took."""
    simulation, speeds = pmpm.Simulation(scene), []
    for _ in range(steps // 10):
        simulation.run(steps=10)
        speeds.append(np.abs(simulation.particles.v).max())
    return max(speeds) / math.sqrt(GRAVITY * HEIGHT), simulation.time


def kirchhoff_stress(scene):
    """(depth, vertical, horizontal) of every particle, J sigma in Pa."""
    simulation, dim = pmpm.Simulation(scene), scene.dim
    sigma = simulation.fields(["stress"])["stress"] * simulation.particles.J[:, None]
    return HEIGHT - simulation.particles.x[:, -1], sigma[:, dim - 1], sigma[:, : dim - 1]


@each_column
def test_a_column_under_its_own_weight_starts_in_equilibrium(model, dim):
    """Without the stress it falls for these steps, g t; with it what moves is the surface, whose nodes are half empty."""
    held, time = fastest(column(model, dim, {}))
    falling, _ = fastest(column(model, dim, None))
    assert falling > 0.5 * math.sqrt(GRAVITY / HEIGHT) * time
    assert held < 1e-3  # measured 2.4e-4
    assert held < 0.01 * falling


@each_column
def test_the_vertical_stress_is_the_weight_above_and_the_horizontal_k0_times_that(model, dim):
    depth, vertical, horizontal = kirchhoff_stress(column(model, dim, {"k0": 0.55, "surcharge": 500.0}))
    expected = -(DENSITY * GRAVITY * depth + 500.0)
    np.testing.assert_allclose(vertical, expected, rtol=1e-9)
    np.testing.assert_allclose(horizontal, 0.55 * expected[:, None] * np.ones(dim - 1), rtol=1e-9)


def test_a_free_surface_above_the_body_presses_on_it():
    depth, vertical, _ = kirchhoff_stress(column("neo_hookean", 2, {"depth_from": 1.5}))
    np.testing.assert_allclose(vertical, -DENSITY * GRAVITY * (depth + 0.5), rtol=1e-9)


@pytest.mark.parametrize(
    ("model", "expected"), [("drucker_prager", 1.0 - math.sin(math.radians(30.0))), ("neo_hookean", 0.3 / 0.7)]
)
def test_k0_is_jakys_of_a_law_with_a_friction_angle_and_else_that_of_an_elastic_solid(model, expected):
    assert column(model, 2, {}).bodies[0].stress.k0 == pytest.approx(expected, rel=1e-15)


def test_k0_of_an_elastic_solid_strains_nothing_across():
    """nu/(1 - nu) is that of uniaxial strain, to first order in the strain of 1.5 %."""
    F = pmpm.Simulation(column("neo_hookean", 2, {})).particles.F
    assert np.abs(F[:, 0, 0] - 1.0).max() < 0.05 * np.abs(F[:, 1, 1] - 1.0).max()


def test_the_scene_that_is_recorded_tells_k0_and_the_free_surface():
    scene = column("drucker_prager", 2, {})
    assert pmpm.Scene.from_text(scene.to_toml()) == scene
    assert "depth_from = 1.0" in scene.to_toml()


def test_a_fluid_can_only_carry_a_stress_that_is_the_same_all_ways():
    fluid = {"model": "fluid", "density": 1000.0, "sound_speed": 30.0}
    scene = column("neo_hookean", 2, {"k0": 1.0}).model_dump() | {"materials": {"ground": fluid}}
    depth, vertical, horizontal = kirchhoff_stress(pmpm.Scene(**scene))
    np.testing.assert_allclose(vertical, -1000.0 * GRAVITY * depth, rtol=1e-6)
    scene["bodies"][0]["stress"]["k0"] = 0.9
    with pytest.raises(pmpm.SceneError, match=r"bodies\[0\].stress cannot be carried by fluid at a depth of"):
        pmpm.Scene(**scene)


def test_a_stress_beyond_the_yield_surface_is_refused_with_the_depth():
    """At 30 degrees the active limit of Rankine is 1/3, which the cone meets in the plane."""
    assert column("drucker_prager", 2, {"k0": 0.34})
    with pytest.raises(
        pmpm.SceneError, match=r"bodies\[0\].stress is outside the yield surface of drucker_prager at a depth"
    ):
        column("drucker_prager", 2, {"k0": 0.32})


def test_a_soft_column_finds_its_state_far_from_rest():
    """The weight at the bottom is half of Young's modulus."""
    depth, vertical, horizontal = kirchhoff_stress(column("neo_hookean", 3, {}, {"youngs_modulus": 4e4}))
    np.testing.assert_allclose(vertical, -DENSITY * GRAVITY * depth, rtol=1e-8)


class SolidLaw(geostatic.ArrayLaw):
    """Hencky elasticity in 2-D whose state keeps the strain out of the plane, after a number of another kind."""

    def __init__(self):
        fields = (StateField("hardening", "scalar", "-", ""), StateField("hencky_strain", "solid", "-", ""))
        self.dim, self.params, self.needs = 2, (4e5, 6e5), LawNeeds("neo_hookean", (), fields)

    def call(self, name, *arguments):
        compiled = targets.arrays(np.float64, la=tensors2).compile
        if name == "state_at":
            return (0.0 * arguments[0][0], *compiled(hencky.strain_of_solid)(arguments[0]))
        if name == "advance":
            return arguments[0]
        if name == "valid":
            return np.isfinite(arguments[0][1])
        function = {"kirchhoff_stress": hencky.stress, "out_of_plane_stress": hencky.out_of_plane_stress}[name]
        return compiled(function)(arguments[0][1:], *self.params)


def test_a_law_that_keeps_its_strain_out_of_the_plane_has_k0_along_z_too():
    law, stress = SolidLaw(), geostatic.Geostatic(type="geostatic", k0=0.6)
    state = geostatic.states(law, stress, 2000.0, np.array([0.0, -10.0]), np.array([0.3, 0.7, 0.3]))
    normal, _ = geostatic.stresses_of(law, state)
    weight = -2e4 * np.array([0.3, 0.7, 0.3])
    np.testing.assert_allclose(normal, weight[:, None] * [0.6, 1.0, 0.6], rtol=1e-9)
