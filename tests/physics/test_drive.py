"""What drives material from outside: walls and regions in motion, loads, body forces, the ramp and the damping."""

import math

import numpy as np
import pytest

from pmpm.scene.errors import SceneError
from pmpm.scene.schema import Scene
from pmpm.simulation import Simulation

RUBBER = {"model": "neo_hookean", "density": 1000.0, "youngs_modulus": 1e4, "poisson_ratio": 0.3}
FREE = {"type": "box", "min": [0.3, 0.3], "max": [0.6, 0.6]}
RESTING = {"type": "box", "min": [0.3, 0.0], "max": [0.6, 0.3]}
ACROSS = {"type": "box", "min": [0.3, 0.0], "max": [0.6, 1.0]}


def simulation(shape=FREE, velocity=(0.0, 0.0), domain=(), method=(), end=1.0, ramp=0.0, **more):
    return Simulation(
        Scene(
            domain={"size": [1.0, 1.0], "cell_size": 0.05, **dict(domain)},
            method=dict(method),
            time={"end": end, "ramp": ramp},
            materials={"rubber": RUBBER},
            bodies=[{"material": "rubber", "shape": shape, "velocity": velocity}],
            **more,
        )
    )


def mean_velocity(simulation):
    return simulation.particles.v.mean(axis=0)


# ---- walls ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("transfer", ["apic", "flip"])
@pytest.mark.parametrize("wall", ["stick", "slip", "separate"])
def test_what_moves_with_its_walls_feels_nothing_of_them(wall, transfer):
    """The rules hold for motion relative to the wall."""
    walls = {face: {"type": wall, "velocity": [0.3, 0.0]} for face in ("y_min", "y_max")}
    moving = simulation(ACROSS, [0.3, 0.0], {"walls": walls, "periodic": ["x"]}, {"transfer": transfer})
    moving.run(steps=100)
    assert np.abs(moving.particles.v - [0.3, 0.0]).max() < 1e-13
    assert np.abs(moving.particles.J - 1.0).max() < 1e-13


def test_a_sticking_wall_drags_what_lies_on_it():
    walls = {"y_min": {"type": "stick", "velocity": [0.3, 0.0]}, "y_max": {"type": "stick", "velocity": [0.3, 0.0]}}
    dragged = simulation(ACROSS, domain={"walls": walls, "periodic": ["x"]})
    dragged.run(steps=400)
    assert mean_velocity(dragged)[0] > 0.05


@pytest.mark.parametrize("transfer", ["apic", "flip"])
def test_a_floor_with_friction_that_moves_accelerates_a_block_by_its_coefficient_times_gravity(transfer):
    """Coulomb, exactly: it gains mu times what the floor gives upwards, which is g t and what the block bounces with."""
    floor = {"type": "friction", "coefficient": 0.2, "velocity": [5.0, 0.0]}
    pushed = simulation(
        RESTING,
        domain={"gravity": [0.0, -0.5], "walls": {"y_min": floor}, "periodic": ["x"]},
        method={"transfer": transfer},
    )
    pushed.run(until=0.5)
    vx, vy = mean_velocity(pushed)
    assert vx == pytest.approx(0.2 * (0.5 * pushed.time + vy), rel=1e-10)
    assert vx > 0.03


def test_the_velocity_of_a_wall_may_be_a_function_of_time():
    def velocity(time):
        return (0.2 * time, 0.0)

    walls = {face: {"type": "stick", "velocity": velocity} for face in ("y_min", "y_max")}
    driven = simulation(ACROSS, domain={"walls": walls, "periodic": ["x"]})
    driven.run(steps=10)
    assert [wall.velocity[0] for wall in driven.walls] == [pytest.approx(0.2 * (driven.time - driven.dt))] * 2
    assert "python:velocity:" in driven.scene.to_toml()


# ---- regions, loads, forces ----------------------------------------------------------------------------------------------


def test_a_region_moves_what_is_in_it_and_travels_with_it():
    platen = {"shape": {"type": "box", "min": [0.2, 0.5], "max": [0.7, 0.7]}, "velocity": [0.0, -0.5]}
    pressed = simulation(RESTING | {"max": [0.6, 0.55]}, motions=[platen], end=0.4)
    pressed.run(until=0.2)
    assert pressed.drive.regions[0].travelled[1] == pytest.approx(-0.5 * pressed.time, rel=1e-12)
    top = pressed.particles.x[:, 1].max()
    assert top < 0.55 - 0.5 * 0.2 + 0.05  # at most a cell behind the platen, which began where the block ended
    assert pressed.particles.J.mean() < 0.95


def test_a_region_that_stays_holds_what_is_in_it():
    clamp = {"shape": {"type": "box", "min": [0.0, 0.5], "max": [1.0, 0.7]}, "velocity": [0.0, 0.0]}
    hung = simulation(domain={"gravity": [0.0, -1.0]}, motions=[clamp])
    hung.run(until=0.5)
    held = hung.particles.x[:, 1] > 0.55
    assert np.abs(hung.particles.v[held]).max() < 1e-3
    assert hung.particles.x[:, 1].min() > 0.2  # free, it would have fallen by 0.125


def test_a_region_that_does_not_travel_goes_on_pushing_where_it_is():
    belt = {"shape": {"type": "box", "min": [0.0, 0.0], "max": [1.0, 0.1]}, "velocity": [0.3, 0.0], "moves": False}
    pushed = simulation(RESTING, motions=[belt])
    pushed.run(until=0.3)
    (region,) = pushed.drive.regions
    assert (region.travelled == 0.0).all()
    low = pushed.particles.x[:, 1] < 0.05
    assert np.abs(pushed.particles.v[low] - [0.3, 0.0]).max() < 1e-3


def test_a_load_is_a_force_in_newtons_on_all_particles_of_its_shape():
    loaded = simulation(loads=[{"shape": {"type": "box", "min": [0.3, 0.3], "max": [0.6, 0.4]}, "force": [7.0, -3.0]}])
    loaded.run(steps=50)
    momentum = [loaded.measure()[f"momentum_{axis}"] for axis in "xy"]
    assert momentum == pytest.approx([7.0 * loaded.time, -3.0 * loaded.time], rel=1e-12)


def test_an_acceleration_of_all_is_gravity():
    fallen, loaded = (
        simulation(domain={"gravity": [0.5, -2.0]}),
        simulation(loads=[{"shape": FREE, "acceleration": [0.5, -2.0]}]),
    )
    for each in (fallen, loaded):
        each.run(steps=50)
    assert np.abs(fallen.particles.v - loaded.particles.v).max() < 1e-14
    assert loaded.particles.v[0, 1] == pytest.approx(-2.0 * loaded.time, rel=1e-12)


def test_a_load_on_nothing_is_refused():
    with pytest.raises(SceneError, match=r"loads\[0\].shape holds no particle"):
        simulation(loads=[{"shape": {"type": "box", "min": [0.8, 0.8], "max": [0.9, 0.9]}, "force": [1.0, 0.0]}])


def pull(x, X, t):
    return (0.0 * x[0] + t, 0.0 * x[1])


def spring(x, X, t):
    return (100.0 * (X[0] - x[0]), 100.0 * (X[1] - x[1]))


@pytest.mark.parametrize("loops", ["lanes", "scalar"])
def test_a_body_force_knows_time_place_and_reference_place(loops, monkeypatch):
    monkeypatch.setenv("PMPM_LOOPS", loops)
    pulled = simulation(body_force=pull)
    expected = 0.0
    for _ in range(40):
        time = pulled.time
        pulled.step()
        expected += pulled.dt * time
    assert mean_velocity(pulled) == pytest.approx([expected, 0.0], rel=1e-12, abs=1e-14)
    assert "X" not in [field.name for field in pulled.layouts[0].fields]  # not kept: the function does not read it
    # A spring to where each particle began: the whole body swings with omega = 10 / s.
    swung = simulation(velocity=[0.5, 0.0], body_force=spring)
    swung.run(until=0.2)
    assert mean_velocity(swung)[0] == pytest.approx(0.5 * math.cos(10.0 * swung.time), abs=0.02)


def test_the_ramp_lets_gravity_and_loads_grow():
    ramped = simulation(domain={"gravity": [0.0, -2.0]}, loads=[{"shape": FREE, "acceleration": [1.0, 0.0]}], ramp=0.2)
    expected = 0.0
    while ramped.time < 0.3:
        part = min(ramped.time / 0.2, 1.0)
        ramped.step()
        expected += ramped.dt * part
    assert mean_velocity(ramped) == pytest.approx([expected, -2.0 * expected], rel=1e-12)


@pytest.mark.parametrize("transfer", ["apic", "flip"])
def test_damping_takes_motion_away_at_its_rate(transfer):
    damped = simulation(velocity=[0.2, 0.1], method={"damping": 3.0, "transfer": transfer})
    damped.run(until=0.4)
    assert mean_velocity(damped) == pytest.approx(np.array([0.2, 0.1]) * math.exp(-3.0 * damped.time), rel=1e-12)


def test_what_drives_is_in_the_record_of_the_run_and_reads_back():
    platen = {"shape": FREE, "velocity": [0.0, -0.5], "moves": False}
    scene = simulation(motions=[platen], loads=[{"shape": FREE, "force": [1.0, 0.0]}], ramp=0.1).scene
    assert Scene.from_text(scene.to_toml()) == scene
