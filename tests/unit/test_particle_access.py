"""Reading and writing particles from Python."""

import numpy as np
import pytest

import pmpm
from pmpm.scene.errors import SceneError


@pytest.fixture
def simulation():
    return pmpm.Simulation(
        pmpm.Scene(
            domain={"size": [60.0, 10.0], "cell_size": 1.0},
            time={"end": 1.0},
            materials={"rubber": {"model": "neo_hookean", "density": 1e3, "youngs_modulus": 1e6, "poisson_ratio": 0.3}},
            bodies=[{"material": "rubber", "shape": {"type": "box", "min": [2.0, 3.0], "max": [6.0, 7.0]}}],
        )
    )


def test_a_velocity_set_by_hand_bounds_the_next_step(simulation):
    """0.2 cells of motion at 1000 m/s on cells of 1 m: 2e-4 s, below the 0.0077 s of the waves."""
    simulation.particles.v = np.broadcast_to([1000.0, 0.0], (simulation.rows(), 2))
    simulation.step()
    assert simulation.dt == pytest.approx(2e-4, rel=1e-12)


def test_a_velocity_set_by_hand_in_a_run_bounds_the_next_steps(simulation):
    simulation.run(steps=5)
    simulation.particles.v = np.broadcast_to([1000.0, 0.0], (simulation.rows(), 2))
    for _ in range(3):
        simulation.step()
        assert simulation.dt < 2.1e-4


def test_dissipation_is_counted_from_the_state_set_by_hand(simulation):
    simulation.particles.v = np.broadcast_to([10.0, 0.0], (simulation.rows(), 2))
    assert simulation.measure()["dissipated"] == 0.0


def test_positions_set_by_hand_are_read_back(simulation):
    x = simulation.particles.x + [20.3, 0.4]
    ids = simulation.particles.id
    simulation.particles.x = x
    by_id = np.argsort(ids), np.argsort(simulation.particles.id)
    np.testing.assert_allclose(simulation.particles.x[by_id[1]], x[by_id[0]], rtol=0, atol=1e-14 * 60)


def test_positions_outside_the_domain_are_refused(simulation):
    with pytest.raises(ValueError, match="not inside the domain"):
        simulation.particles.x = simulation.particles.x - 10.0


@pytest.mark.parametrize("kind", ["slip", "free"])
@pytest.mark.parametrize("spline", ["linear", "quadratic", "cubic"])
def test_walls_belong_to_the_domain_and_a_free_one_ends_it(spline, kind):
    simulation = pmpm.Simulation(
        pmpm.Scene(
            domain={
                "size": [8.0, 8.0],
                "cell_size": 1.0,
                "walls": dict.fromkeys(("x_min", "x_max", "y_min", "y_max"), kind),
            },
            method={"shape_function": spline},
            time={"end": 1.0},
            materials={"rubber": {"model": "neo_hookean", "density": 1e3, "youngs_modulus": 1e6, "poisson_ratio": 0.3}},
            bodies=[{"material": "rubber", "shape": {"type": "box", "min": [2.0, 2.0], "max": [4.0, 4.0]}}],
        )
    )
    corners = np.array([[0.0, 0.0], [8.0, 0.0], [0.0, 8.0], [8.0, 8.0]])
    for corner in corners:
        x = simulation.particles.x
        reach = x.max(axis=0) - x.min(axis=0)
        simulation.particles.x = np.where(corner == 0.0, x - x.min(axis=0), x - x.max(axis=0) + corner)
        assert np.array_equal(simulation.particles.x.min(axis=0), np.where(corner == 0.0, 0.0, corner - reach))
        simulation.particles.v = np.zeros_like(x)
        simulation.step()
        simulation.check()
    x = simulation.particles.x - simulation.particles.x.min(axis=0)
    for beyond, refused in ((0.49, kind == "free"), (0.51, True)):
        if not refused:
            simulation.particles.x = x - [beyond, 0.0]
            continue
        with pytest.raises(ValueError, match="not inside the domain"):
            simulation.particles.x = x - [beyond, 0.0]


@pytest.mark.parametrize("name", ["mass", "volume0", "id", "J", "density", "stress", "no_such_field"])
def test_what_cannot_be_assigned_says_so(simulation, name):
    with pytest.raises(AttributeError, match=f"{name} cannot be assigned"):
        setattr(simulation.particles, name, 1.0)


@pytest.mark.parametrize("dim", [2, 3])
def test_the_von_mises_stress_is_that_of_the_whole_tensor(dim):
    """Of a simple shear sqrt(3) G gamma; of any strain what the deviator of the stress gives, out of the plane too."""
    solid = {"model": "neo_hookean", "density": 1e3, "youngs_modulus": 1e6, "poisson_ratio": 0.25}
    scene = pmpm.Scene(
        domain={"size": [8.0] * dim, "cell_size": 1.0},
        time={"end": 1.0},
        materials={"solid": solid},
        bodies=[{"material": "solid", "shape": {"type": "box", "min": [2.0] * dim, "max": [4.0] * dim}}],
    )
    simulation = pmpm.Simulation(scene)
    particles = simulation.particles
    F = np.tile(np.eye(dim), (len(particles.id), 1, 1))
    F[:, 0, 1] = 1e-4
    particles.F = F
    shear = simulation.fields(["von_mises_stress"])["von_mises_stress"]
    assert shear == pytest.approx(np.sqrt(3.0) * 4e5 * 1e-4, rel=1e-3)  # G = E / 2.5
    particles.F = F + 0.1 * np.random.default_rng(1).normal(size=F.shape)
    found = simulation.fields(["von_mises_stress", "stress"])
    xx, yy, zz, xy, yz, xz = found["stress"].T
    sigma = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]).transpose(2, 0, 1)
    deviator = sigma - np.trace(sigma, axis1=1, axis2=2)[:, None, None] / 3.0 * np.eye(3)
    assert found["von_mises_stress"] == pytest.approx(np.sqrt(1.5) * np.linalg.norm(deviator, axis=(1, 2)), rel=1e-12)


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("model", ["drucker_prager", "mohr_coulomb"])
def test_a_cohesive_law_without_friction_whose_surface_has_no_tip_runs(model, precision):
    law = {
        "model": model,
        "density": 1e3,
        "youngs_modulus": 1e6,
        "poisson_ratio": 0.3,
        "friction_angle": 0.0,
        "cohesion": 1e4,
    }
    shape = {"type": "box", "min": [2.0, 2.0], "max": [4.0, 4.0]}
    scene = pmpm.Scene(
        domain={"size": [8.0, 8.0], "cell_size": 1.0, "gravity": [0.0, -10.0]},
        method={"precision": precision},
        time={"end": 1.0},
        materials={"clay": law},
        bodies=[{"material": "clay", "shape": shape, "velocity": [0.0, -20.0]}],
    )
    simulation = pmpm.Simulation(scene)
    simulation.run(steps=100)
    assert np.isfinite(simulation.particles.stress).all()
    assert simulation.measure()["dissipated"] > 0.0


def test_a_modulus_beyond_the_precision_of_the_scene_is_refused(simulation):
    stiff = simulation.scene.model_dump() | {"method": {"precision": "float32"}}
    stiff["materials"]["rubber"]["youngs_modulus"] = 1e40
    with pytest.raises(SceneError, match="materials.rubber: .* beyond the range of float32"):
        pmpm.Simulation(pmpm.Scene(**stiff))


def test_an_unknown_name_lists_the_known_ones(simulation):
    with pytest.raises(AttributeError, match="known: x, v, C, F"):
        _ = simulation.particles.velocities
