"""How particles start: functions of position, displaced and deformed bodies, and what is said of bad ones."""

import functools
import re
import tomllib

import numpy as np
import pytest
from broken_scenes import GOOD

import pmpm
from pmpm import populate
from pmpm.explain import explain
from pmpm.scene.errors import NotBuilt, SceneError
from pmpm.scene.needs import grid_geometry, scene_needs

RUBBER = {"model": "neo_hookean", "density": 1000.0, "youngs_modulus": 1e5, "poisson_ratio": 0.3}
SAND = RUBBER | {"model": "drucker_prager", "friction_angle": 30.0}
WATER = {"model": "fluid", "density": 1000.0, "sound_speed": 20.0}
STRETCH = [[1.1, 0.02], [-0.03, 0.95]]
TURN = np.array([[0.8, -0.6], [0.6, 0.8]])


def scene(law=RUBBER, precision="float64", periodic=(), low=(0.2, 0.1), high=(0.5, 0.3), **body):
    return pmpm.Scene(
        domain={"size": [1.0, 0.5], "cell_size": 0.05, "gravity": [0.0, -10.0], "periodic": periodic},
        method={"precision": precision},
        time={"end": 0.1},
        materials={"stuff": law},
        bodies=[{"material": "stuff", "shape": {"type": "box", "min": low, "max": high}, **body}],
    )


def start(law=RUBBER, **more):
    """Particles before the first step, in the order of their ids."""
    particles = pmpm.Simulation(scene(law, **more)).particles
    order = np.argsort(particles.id)
    return {name: getattr(particles, name)[order] for name in ("x", "v", "J", "volume0", "mass")} | {
        "particles": particles,
        "order": order,
    }


def swirl(X):
    return np.stack((-X[:, 1], X[:, 0] * X[:, 1]), axis=1)


def shift(X):
    return np.stack((0.3 * np.sin(5.0 * X[:, 0]), 0.1 * X[:, 0]), axis=1)


def stretch(X):
    F = np.zeros((len(X), 2, 2))
    F[:, 0, 0], F[:, 1, 1], F[:, 0, 1] = 1.0 + 0.2 * X[:, 0], 1.0 - 0.2 * X[:, 1], 0.1
    return F


def test_velocity_is_the_function_at_the_position_of_each_particle():
    found = start(velocity=swirl)
    np.testing.assert_allclose(found["v"], swirl(found["x"]), rtol=0.0, atol=1e-15)


def test_displaced_particles_start_at_the_function_beyond_their_reference_positions():
    reference, found = start(), start(displacement=shift, velocity=swirl)
    np.testing.assert_allclose(found["x"], reference["x"] + shift(reference["x"]), rtol=0.0, atol=1e-14)
    assert np.array_equal(found["v"], swirl(reference["x"]))
    assert np.array_equal(found["volume0"], reference["volume0"])


def test_a_function_sees_positions_inside_the_domain_where_it_repeats():
    seen = []

    def watch(X):
        seen.append(X)
        return 0.0 * X

    pmpm.Simulation(scene(periodic=["x"], low=(0.0, 0.1), high=(1.0, 0.3), velocity=watch))
    X = np.concatenate(seen)
    assert X.min() > 0.0
    assert X[:, 0].max() > 0.98
    assert X[:, 0].max() < 1.0


def test_a_particle_displaced_beyond_a_periodic_end_comes_in_at_the_other():
    reference, found = start(periodic=["x"]), start(periodic=["x"], displacement=[0.7, 0.0])
    np.testing.assert_allclose(found["x"][:, 0] % 1.0, (reference["x"][:, 0] + 0.7) % 1.0, rtol=0.0, atol=1e-14)


def test_a_rubber_starts_with_the_deformation_it_is_given():
    reference, found = start(), start(deformation=stretch)
    F = found["particles"].F[found["order"]]
    np.testing.assert_allclose(F, stretch(reference["x"]), rtol=0.0, atol=1e-15)
    assert np.array_equal(found["mass"], reference["mass"])


def test_a_constant_deformation_stands_in_a_scene_file():
    own = scene(deformation=STRETCH)
    assert pmpm.Scene.from_text(own.to_toml()) == own
    F = pmpm.Simulation(own).particles.F
    assert np.array_equal(F, np.broadcast_to(STRETCH, F.shape))


def test_a_sand_starts_with_the_logarithm_of_its_stretch():
    """F = V R: a turned stretch has the strain ln V whatever R."""
    V = np.array([[0.96, 0.01], [0.01, 0.98]])
    stretches, axes = np.linalg.eigh(V)
    expected = axes @ np.diag(np.log(stretches)) @ axes.T
    strain = pmpm.Simulation(scene(SAND, deformation=(V @ TURN).tolist())).particles.hencky_strain
    np.testing.assert_allclose(strain, np.tile(expected[[0, 0, 1], [0, 1, 1]], (len(strain), 1)), rtol=0.0, atol=1e-14)


def test_a_fluid_starts_with_the_volume_ratio_of_its_deformation():
    J = pmpm.Simulation(scene(WATER, deformation=STRETCH)).particles.J
    np.testing.assert_allclose(J, np.linalg.det(STRETCH), rtol=1e-15)


def test_the_step_knows_of_the_deformation_at_the_start():
    assert (
        start(deformation=[[3.0, 0.0], [0.0, 3.0]])["particles"].simulation.dt
        < 0.7 * start()["particles"].simulation.dt
    )


# ---- the record ----


def test_a_function_is_recorded_by_name_and_hash():
    assert re.search(r'^velocity = "python:swirl:[0-9a-f]{12}"$', scene(velocity=swirl).to_toml(), re.MULTILINE)


def test_the_record_of_a_function_changes_with_what_it_reaches():
    def scaled(factor, table=None):
        return lambda X: factor * X + (0.0 if table is None else table.sum())

    records = [
        re.search(r"python:[^\"]+", scene(velocity=field).to_toml())[0]
        for field in (
            scaled(1.0),
            scaled(1.0),
            scaled(2.0),
            scaled(1.0, np.zeros(2000)),
            scaled(1.0, np.arange(2000.0)),
            functools.partial(np.multiply, 2.0),
            functools.partial(np.multiply, 3.0),
        )
    ]
    assert records[0] == records[1]
    assert len(set(records)) == 6


def test_a_scene_file_with_a_function_of_position_is_refused_and_names_it():
    with pytest.raises(
        pmpm.SceneError, match=r"bodies\[0\].velocity = .*a file does not hold: give swirl here"
    ) as raised:
        pmpm.Scene.from_text(scene(velocity=swirl).to_toml())
    assert not isinstance(raised.value, NotBuilt)


def test_the_functions_given_on_top_of_the_record_make_the_same_scene(tmp_path):
    own = scene(velocity=swirl, displacement=shift)
    (tmp_path / "scene.toml").write_text(own.to_toml(), encoding="utf-8")
    given = {"bodies.0.velocity": swirl, "bodies.0.displacement": shift}
    assert pmpm.Scene.from_toml(tmp_path / "scene.toml", given) == own


def test_a_scene_with_a_velocity_function_can_be_explained():
    def fast(X):
        return np.full_like(X, 500.0)

    slow, quick = (explain(scene(velocity=field), 1) for field in (swirl, fast))
    steps = [float(re.search(r"time step +([0-9.e+-]+)", text)[1]) for text in (slow, quick)]
    assert steps[1] < 0.1 * steps[0]


# ---- what is refused ----


def short(X):
    return X[:, 0]


def turned(X):
    return np.zeros((2, len(X)))


def imaginary(X):
    return 1j * X


def broken(X):
    return X / (X[:, :1] > 9.0)


def failing(X):
    raise KeyError("no table")


def mean(X):
    return X - X.mean(axis=0)


def inverted(X):
    F = stretch(X)
    F[:, 0, 0] *= -1.0
    return F


def far(X):
    return np.stack((0.0 * X[:, 0], 10.0 * (X[:, 0] > 0.4)), axis=1)


BAD = [
    ("short", {"velocity": short}, "bodies[0].velocity = short must return an array of shape (5, 2) for 5 points, not"),
    ("columns", {"velocity": turned}, "not of shape (2, 5)"),
    ("imaginary", {"velocity": imaginary}, "must return real numbers, not complex128"),
    ("not finite", {"velocity": broken}, "must return finite numbers, not (inf, inf), at X = (0."),
    ("failing", {"displacement": failing}, "bodies[0].displacement = failing fails for 5 points like X = (0."),
    ("mean", {"velocity": mean}, "must depend on the position alone"),
    ("vector for a matrix", {"deformation": swirl}, "must return an array of shape (5, 2, 2)"),
    ("inverted", {"deformation": inverted}, "bodies[0].deformation = inverted is no state of neo_hookean: F = (-1."),
    ("inverted constant", {"deformation": [[-1, 0], [0, 1]]}, "det F = -1; det F must be > 0"),
    ("far", {"displacement": far}, "takes particle"),
    ("far constant", {"displacement": [0.0, 1.0]}, "out of the domain, to (0.2125, 1.1125) m"),
]  # fmt: skip


@pytest.mark.parametrize(("body", "fragment"), [case[1:] for case in BAD], ids=[case[0] for case in BAD])
def test_what_cannot_be_a_start_is_told_in_one_line(body, fragment):
    with pytest.raises(pmpm.SceneError) as raised:
        pmpm.Simulation(scene(**body))
    message = str(raised.value)
    assert message.startswith("scene: bodies[0].")
    assert fragment in message
    assert "\n" not in message
    assert not isinstance(raised.value, NotBuilt)


def test_functions_are_tried_before_anything_is_allocated():
    with pytest.raises(pmpm.SceneError):
        scene(velocity=short)


def test_a_function_that_fails_at_one_particle_only_is_told_with_its_place():
    def spot(X):
        return np.where(np.abs(X - [0.2125, 0.1125]).max(axis=1) < 1e-6, np.nan, 0.0)[:, None] + 0.0 * X

    with pytest.raises(
        pmpm.SceneError, match=r"bodies\[0\].velocity = spot must return finite .* at X = \(0.2125, 0.1125\)"
    ):
        pmpm.Simulation(scene(velocity=spot))


def test_what_other_keys_of_a_file_take_is_still_no_function():
    table = tomllib.loads(GOOD)
    table["bodies"][0]["particles_per_cell"] = swirl
    with pytest.raises(NotBuilt, match=r"bodies\[0\].particles_per_cell"):
        pmpm.Scene(**table)


@pytest.mark.filterwarnings("error")
def test_a_velocity_beyond_the_precision_is_refused():
    """In float32 it would be infinite, which bounds no step."""
    made = scene(WATER, "float32", velocity=[1e200, 0.0])
    with pytest.raises(SceneError, match=r"bodies\[0\].velocity is too large for float32"):
        pmpm.Simulation(made)


# ---- the seam of a periodic axis -----------------------------------------------------------------------------------------


def ring():
    """Five cells around, with a load on all of them."""
    whole = {"type": "box", "min": [0.0, 0.0], "max": [0.5, 0.2]}
    return pmpm.Scene(
        domain={"size": [0.5, 0.4], "cell_size": 0.1, "periodic": ["x"], "gravity": [0.0, 0.0]},
        time={"end": 1.0},
        parallel={"slab_axis": "x"},
        materials={"stuff": WATER},
        bodies=[{"material": "stuff", "shape": whole, "particles_per_cell": 4}],
        loads=[{"shape": whole, "acceleration": [1.0, 0.0]}],
    )


@pytest.mark.parametrize("ranks", [1, 2, 5, 6, 12])
def test_seeds_of_the_seam_are_counted_once_on_any_number_of_ranks(ranks):
    """4 of each cell, 2 cells across, also where there are more ranks than layers."""
    made = ring()
    geometry = grid_geometry(made, scene_needs(made))
    found = [populate.counted(made, geometry, *(geometry.layers * r // ranks for r in (rank, rank + 1)))
             for rank in range(ranks)]  # fmt: skip
    counts, loaded = (sum(parts) for parts in zip(*found, strict=True))
    assert counts.ravel().tolist() == [8] * 5
    assert loaded.ravel().tolist() == [40]


def test_a_load_on_a_whole_ring_acts_on_those_beside_the_seam_too():
    simulation = pmpm.Simulation(ring())
    load = simulation.populations[0].rows(simulation.layouts[0].where("load"))
    assert len(load) == 40
    assert (load == [1.0, 0.0]).all()


def test_fewer_layers_than_a_stencil_belong_to_one_rank():
    """3 x 2 cells have 4 layers, a stencil with its padding reaches 5 planes."""
    made = pmpm.Scene(
        domain={"size": [0.3, 0.2], "cell_size": 0.1, "gravity": [0.0, -9.81]},
        time={"end": 1.0},
        materials={"stuff": WATER},
        bodies=[{"material": "stuff", "shape": {"type": "box", "min": [0.0, 0.0], "max": [0.3, 0.1]}}],
    )
    simulation = pmpm.Simulation(made, threads=3)
    mass = simulation.measure()["mass"]
    simulation.run(steps=20)
    assert simulation.patch.nodes[0, :, 3].sum() == pytest.approx(mass, rel=1e-12)
