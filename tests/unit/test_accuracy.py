"""A scene may carry an exact solution, and errors against it are what their definition says."""

import math
import re

import numpy as np
import pytest
from broken_scenes import GOOD

import pmpm
from pmpm.scene.errors import NotBuilt

RUBBER = {"model": "neo_hookean", "density": 1000.0, "youngs_modulus": 1e5, "poisson_ratio": 0.3}
WATER = {"model": "fluid", "density": 1000.0, "sound_speed": 10.0}
G = 10.0
SPEED = (2.5, 0.5)  # m/s
STRETCH = np.array([[1.2, 0.1], [0.0, 0.9]])


def fall(X, t):
    return np.array(SPEED) * t - np.array([0.0, 0.5 * G * t * t]) + 0.0 * X


def falling(X, t):
    return np.array(SPEED) - np.array([0.0, G * t]) + 0.0 * X


def stretch(X, t):
    return np.broadcast_to(STRETCH, (len(X), 2, 2))


def undeformed(X, t):
    return np.broadcast_to(np.eye(2), (len(X), 2, 2))


def scene(law=RUBBER, exact=None, periodic=(), **body):
    return pmpm.Scene(
        domain={"size": [1.0, 0.5], "cell_size": 0.05, "gravity": [0.0, -G], "periodic": periodic},
        time={"end": 0.1, "step": 5e-4},
        materials={"stuff": law},
        bodies=[
            {"material": "stuff", "shape": {"type": "box", "min": [0.7, 0.15], "max": [0.9, 0.35]}, "velocity": SPEED}
            | body
        ],
        exact={"displacement": fall} if exact is None else exact,
    )


def measured(made, steps=0):
    simulation = pmpm.Simulation(made)
    errors = pmpm.Errors(simulation)
    simulation.every(errors, steps=1, at_start=True)
    simulation.run(steps=steps)
    return simulation, errors


@pytest.fixture(scope="module")
def fallen():
    """A block that falls freely while it moves over the end of a periodic axis, measured at every step."""
    return measured(scene(exact={"displacement": fall, "velocity": falling}, periodic=["x"]), 200)


def test_the_error_of_free_fall_is_that_of_symplectic_steps(fallen):
    """x_n = x_0 + v_0 t - g t (t + dt) / 2: at time t too low by g t dt / 2, all particles alike."""
    simulation, errors = fallen
    t, dt = simulation.time, 5e-4
    times = dt * np.arange(1, 201)
    largest_motion = np.hypot(SPEED[0] * times, SPEED[1] * times - 0.5 * G * times**2).max()
    assert simulation.particles.x[:, 0].min() < 0.1  # it has come over the end
    assert errors.last["displacement"] == pytest.approx(0.5 * G * t * dt / largest_motion, rel=1e-9)
    assert errors.largest["displacement"] == errors.last["displacement"]  # it grows with t
    assert errors.last_rms["displacement"] == pytest.approx(0.5 * G * t * dt, rel=1e-9)


def test_the_velocity_of_free_fall_is_exact(fallen):
    assert fallen[1].largest["velocity"] < 1e-13
    assert fallen[1].reference_rms["velocity"] == pytest.approx(math.hypot(*SPEED), rel=1e-9)


def test_the_largest_error_is_kept_when_the_last_is_smaller():
    simulation, errors = measured(scene(exact={"displacement": fall, "velocity": falling}))
    moved = simulation.particles.v + [0.3, 0.4]
    simulation.particles.v = moved
    errors(simulation)
    simulation.particles.v = moved - [0.3, 0.4]
    errors(simulation)
    assert errors.largest_rms["velocity"] == pytest.approx(0.5, rel=1e-12)
    assert errors.largest["velocity"] == pytest.approx(0.5 / math.hypot(*SPEED), rel=1e-12)
    assert errors.last_rms["velocity"] < 1e-13


def test_errors_of_a_deformation_are_relative_to_its_distance_from_identity():
    _, errors = measured(scene(exact={"displacement": fall, "deformation": stretch}))  # the body starts undeformed
    assert errors.last["deformation"] == pytest.approx(1.0, rel=1e-12)
    assert errors.last_rms["deformation"] == pytest.approx(math.sqrt(0.04 + 0.01 + 0.01), rel=1e-12)
    assert errors.last_rms["J"] == pytest.approx(0.08, rel=1e-12)  # 1.2 * 0.9 - 1


def test_a_body_that_starts_as_told_has_no_error():
    _, errors = measured(scene(exact={"displacement": fall, "deformation": stretch}, deformation=STRETCH.tolist()))
    assert errors.last["deformation"] < 1e-15
    assert errors.last["J"] < 1e-14


def test_a_law_without_a_deformation_gradient_is_measured_by_its_volume():
    _, errors = measured(scene(WATER, exact={"displacement": fall, "deformation": stretch}))
    assert list(errors.last) == ["displacement", "J"]
    assert errors.last_rms["J"] == pytest.approx(0.08, rel=1e-12)


def test_an_error_relative_to_nothing_is_infinite():
    _, errors = measured(scene(exact={"displacement": fall, "deformation": undeformed}, deformation=STRETCH.tolist()))
    assert errors.last["deformation"] == math.inf
    assert errors.last["displacement"] == 0.0  # zero relative to zero


def test_bodies_count_by_their_volume():
    """Half of the volume has twice the particles: the mean of squares is that of the volumes."""

    def jump(X, t):
        return np.where(X[:, :1] < 0.8, [[0.1, 0.0]], 0.0)

    shapes = [{"type": "box", "min": [low, 0.2], "max": [low + 0.1, 0.4]} for low in (0.7, 0.8)]
    made = scene(exact={"displacement": jump}).model_dump()
    made["bodies"] = [
        made["bodies"][0] | {"shape": s, "particles_per_cell": n} for s, n in zip(shapes, (16, 4), strict=True)
    ]
    made["exact"] = {"displacement": jump}
    made["time"].pop("cfl")
    simulation = pmpm.Simulation(pmpm.Scene(**made))
    errors = pmpm.Errors(simulation)
    errors(simulation)
    assert errors.last_rms["displacement"] == pytest.approx(0.1 * math.sqrt(0.5), rel=1e-12)


# ---- what a scene takes ----


def test_a_scene_without_an_exact_solution_has_no_errors():
    made = scene().model_copy(update={"exact": None})
    simulation = pmpm.Simulation(made)
    with pytest.raises(pmpm.SceneError, match="scene: exact is missing"):
        pmpm.Errors(simulation)


def test_the_functions_are_recorded_by_name_and_hash_and_given_back_to_a_file(tmp_path):
    made = scene(exact={"displacement": fall, "deformation": stretch})
    file = tmp_path / "scene.toml"
    file.write_text(made.to_toml())
    records = re.findall(r'^(\w+) = "python:(\w+):[0-9a-f]{12}"$', file.read_text(), re.MULTILINE)
    assert records == [("displacement", "fall"), ("deformation", "stretch")]
    with pytest.raises(pmpm.SceneError, match=r"exact\.displacement = .* a file does not hold: give fall here"):
        pmpm.Scene.from_toml(file)
    given = {"exact.displacement": fall, "exact.deformation": stretch}
    assert pmpm.Scene.from_toml(file, given).to_toml() == made.to_toml()


@pytest.mark.parametrize(
    ("exact", "fragment"),
    [
        ({}, "exact.displacement is missing"),
        ({"displacement": [0.0, 0.0]}, "exact.displacement = [0.0, 0.0] must be a function u(X, t), from Python"),
        ({"displacement": fall, "stress": fall}, "exact.stress is not a known key"),
        ({"displacement": lambda X: X}, "exact.displacement = <lambda> fails for 5 points"),
        ({"displacement": fall, "velocity": lambda X, t: X[:, 0]}, "exact.velocity = <lambda> must return an array of shape"),
        ({"displacement": lambda X, t: X / (t - 0.1)}, "must return finite numbers"),
        ({"displacement": lambda X, t: X / (t - 0.1)}, "t = 0.1 s"),
        ({"displacement": lambda X, t: X - X.mean(axis=0)}, "must depend on the position alone"),
    ],
)  # fmt: skip
def test_what_is_no_exact_solution_is_told_in_one_line(exact, fragment):
    with pytest.raises(pmpm.SceneError) as raised:
        scene(exact=exact)
    message = str(raised.value)
    assert message.startswith("scene: exact.")
    assert fragment in message
    assert "\n" not in message
    assert not isinstance(raised.value, NotBuilt)


def test_a_file_cannot_hold_an_exact_solution():
    with pytest.raises(pmpm.SceneError, match=r'exact\.displacement = "X" must be a function u\(X, t\), from Python'):
        pmpm.Scene.from_text(GOOD + '[exact]\ndisplacement = "X"\n')


def test_a_function_that_fails_on_the_way_ends_the_run_with_time_and_place():
    def fades(X, t):
        return X / np.where(np.abs(t - 1e-3) < 1e-6, 0.0, 1.0)

    with pytest.raises(pmpm.SceneError, match=r"scene: exact.displacement = fades must return .* X = .*, t = 0.001 s"):
        measured(scene(exact={"displacement": fades}), 5)
