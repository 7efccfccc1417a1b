"""Material leaves through open faces and comes in through inflows: nothing is lost, nothing is counted twice.

test_flow_mpi.py compares ranks; the chute and the jet that come with pmpm meet theory in tests/physics/test_inflow.py.
"""

from unittest import mock

import numpy as np
import pytest
from bits import state_bits

import pmpm
from pmpm import cli, guard
from pmpm.failure import NumericalFailure
from pmpm.output.files import OutputError
from pmpm.scene.errors import SceneError
from pmpm.scene.schema import Scene
from pmpm.simulation import Simulation
from pmpm.studies.study import study

WATER = {"model": "fluid", "density": 1000.0, "sound_speed": 10.0}
CELL = 0.05
BLOCK = {"material": "water", "shape": {"type": "box", "min": [0.5, 0.2], "max": [0.8, 0.4]}, "velocity": [2.0, 0.0]}
MOUTH = {"material": "water", "shape": {"type": "box", "min": [0.0, 0.1], "max": [0.15, 0.3]}, "velocity": [2.0, 0.0]}
# Lattice of four per cell: six columns of eight places in the mouth, a new one of eight every half cell.
AT_FIRST, COLUMN, SPACING = 48, 8, 0.5 * CELL


def scene(walls=None, **more):
    """Water in a box of 20 x 12 cells, cut into slabs across x, open at its right face."""
    domain = {"size": [1.0, 0.6], "cell_size": CELL, "walls": {"x_max": "open"} if walls is None else walls}
    domain |= more.pop("domain", {})
    return Scene(**{"domain": domain, "time": {"end": 0.6}, "materials": {"water": WATER}} | more)


def run(made, **limits):
    simulation = Simulation(made)
    simulation.run(**limits)
    return simulation


def balance(simulation):
    """Particles inside + left - emitted, of all sources."""
    measured = simulation.measure()
    return measured["particles"] + measured.get("left", 0) - measured.get("emitted", 0)


# ---- out -------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("slab_axis", ["x", "y"])
def test_a_block_that_flies_out_is_counted_with_its_mass_momentum_and_energy(slab_axis):
    """Nothing acts on it: 96 particles of 1000 kg/m3 (0.05 m)^2 / 4 leave at 2 m/s."""
    measured = run(scene(bodies=[BLOCK], parallel={"slab_axis": slab_axis})).measure()
    mass = 96 * 1000.0 * CELL**2 / 4
    assert (measured["particles"], measured["mass"], measured["left"]) == (0, 0.0, 96)
    assert measured["left_mass"] == pytest.approx(mass, rel=1e-14)
    assert measured["left_momentum_x"] == pytest.approx(2.0 * mass, rel=1e-12)
    assert measured["left_energy"] == pytest.approx(0.5 * mass * 2.0**2, rel=1e-12)
    assert abs(measured["dissipated"]) < 1e-12 * mass


def test_who_is_not_beyond_a_face_stays():
    simulation = run(scene(bodies=[BLOCK]), until=0.2)
    assert 0 < simulation.measure()["left"] < 96
    assert balance(simulation) == 96
    simulation.regroup()
    assert simulation.particles.x[:, 0].max() < 1.0  # m, where the face is
    ids = simulation.particles.id
    assert len(np.unique(ids)) == len(ids) == 96 - simulation.flow.left[0]


def test_particles_leave_through_every_open_face_of_three_dimensions():
    faces = {f"{axis}_{end}": "open" for axis in "xyz" for end in ("min", "max")}
    for axis in range(3):  # one after another, for what moves along the axis of slabs makes regroups due
        bodies = []
        for side in (-1.0, 1.0):
            way = side * np.eye(3)[axis]
            low = 0.35 + 0.25 * way  # m, near the face of a box of 0.8 m
            shape = {"type": "box", "min": low.tolist(), "max": (low + 0.1).tolist()}
            bodies.append({"material": "water", "shape": shape, "velocity": (5.0 * way).tolist()})
        domain = {"size": [0.8] * 3, "cell_size": CELL}
        simulation = run(scene(faces, domain=domain, bodies=bodies, time={"end": 0.1}))
        assert simulation.flow.left.tolist() == [64, 64]


def test_energy_that_has_left_does_not_stop_a_run():
    """What falls to the right leaves with less than no energy: without a count of it, energy would come out of nothing."""
    falling = scene(
        domain={"gravity": [9.81, 0.0]},
        bodies=[BLOCK | {"velocity": [0.0, 0.0]}],
        guard={"interval": 1},
    )
    assert run(falling).measure()["particles"] == 0
    with (
        mock.patch.object(guard.EnergyWatch, "net_flow", return_value=0),
        pytest.raises(NumericalFailure, match="energy"),
    ):
        run(falling)


def test_a_scene_without_flows_holds_counts_and_compiles_nothing_of_them():
    simulation = run(scene({"x_max": "slip"}, bodies=[BLOCK]), steps=3)
    simulation.regroup()
    assert simulation.flow is None
    assert not any(name.startswith(("left", "emitted")) for name in simulation.measure())
    assert "flow" not in {*simulation.report(), *simulation.state().record}
    entries = simulation.kernels.entries
    assert [entries[name].signatures for name in ("count_beyond", "take_beyond")] == [[], []]


def test_particles_put_beyond_an_open_face_by_hand_have_left():
    simulation = run(scene(bodies=[BLOCK]), steps=1)
    x = simulation.particles.x
    x[:5, 0] = 1.0 + 0.4 * CELL
    simulation.particles.x = x
    assert (simulation.rows(), simulation.flow.left[0]) == (91, 5)


def test_a_face_that_is_opened_at_a_restart_lets_go_what_is_beyond_it(tmp_path):
    closed = scene({"x_max": "separate"}, bodies=[BLOCK])
    simulation = run(closed, steps=1)
    x = simulation.particles.x
    x[:5, 0] = 1.0 + 0.4 * CELL
    simulation.particles.x = x
    simulation.save(tmp_path / "1.hdf")
    again = Simulation.restart(tmp_path / "1.hdf", scene({"x_max": "open"}, bodies=[BLOCK]))
    assert (again.rows(), again.flow.left[0]) == (91, 5)
    again.run()
    assert (again.rows(), again.flow.left[0]) == (0, 96)


# ---- in --------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("velocity", [[2.0, 0.0], [1.0, 0.5]])
def test_a_stream_is_one_lattice_that_moves_as_told(velocity):
    """Nothing acts on it behind its region: all of it moves as told, with the same distances and without strain."""
    simulation = run(scene(inflows=[MOUTH | {"velocity": velocity}]), until=0.25)
    particles = simulation.particles
    assert np.abs(particles.v - velocity).max() < 1e-12
    assert np.abs(particles.J - 1.0).max() < 1e-12
    places = (particles.x - simulation.drive.regions[0].travelled) / SPACING - 0.5
    assert np.abs(places - np.rint(places)).max() < 1e-9
    assert len(np.unique(np.rint(places), axis=0)) == simulation.rows() > 2 * AT_FIRST


def test_a_stream_brings_as_much_as_its_way_says():
    simulation = run(scene(inflows=[MOUTH]), until=0.25)
    way = simulation.drive.regions[0].travelled[0]
    assert way == pytest.approx(2.0 * simulation.time, rel=1e-12)
    emitted = AT_FIRST + COLUMN * int((way - 2.0 * simulation.dt) / SPACING)  # the last step brings nothing yet
    assert simulation.flow.emitted.tolist() == [emitted]
    assert simulation.measure()["emitted_mass"] == pytest.approx(emitted * 1000.0 * CELL**2 / 4, rel=1e-14)


@pytest.mark.parametrize("walls", ["stick", "slip", "separate"])
def test_a_wall_does_not_hold_back_what_comes_in_at_it(walls):
    at_wall = MOUTH | {"shape": {"type": "box", "min": [0.0, 0.0], "max": [0.15, 0.2]}}
    made = scene({"x_min": walls, "y_min": walls, "x_max": "open"}, inflows=[at_wall], domain={"gravity": [0.0, -9.81]})
    simulation = run(made, until=0.1)
    inside = at_wall["shape"]["max"][0] - 2e-3 > simulation.particles.x[:, 0]
    assert inside.sum() >= 40
    assert np.abs(simulation.particles.v[inside] - [2.0, 0.0]).max() < 1e-9


def test_a_stream_begins_and_ends_when_told_and_leaves_all_of_it_free():
    made = scene(inflows=[MOUTH | {"start": 0.1, "until": 0.2}], domain={"gravity": [0.0, -9.81]})
    simulation = run(made, until=0.09)
    assert (simulation.rows(), simulation.flow.emitted[0]) == (0, 0)
    simulation.run(until=0.21)
    emitted = simulation.flow.emitted[0]
    assert emitted == AT_FIRST + COLUMN * 7  # 0.2 m are eight spacings, the last of which ends with the stream
    simulation.run(until=0.25)
    assert simulation.flow.emitted[0] == emitted
    assert simulation.particles.v[:, 1].max() < -0.3  # m/s, of all that fall freely for 0.04 s


def test_a_limit_is_met_to_the_particle():
    volume = 75.4 * CELL**2 / 4  # of 75.4 particles
    simulation = run(scene(inflows=[MOUTH | {"limit": volume}], domain={"gravity": [0.0, -9.81]}), until=0.1)
    assert simulation.flow.emitted.tolist() == [75]
    assert simulation.particles.v[:, 1].max() < -0.3  # m/s, of what falls freely since four columns came, at 0.05 s


def test_a_stream_may_change_its_speed_and_stand_still():
    def pulse(t):
        return (2.0 if t < 0.05 or t > 0.1 else 0.0, 0.0)

    simulation = run(scene(inflows=[MOUTH | {"velocity": pulse}]), until=0.2)
    way = simulation.drive.regions[0].travelled[0]
    assert way == pytest.approx(2.0 * (simulation.time - 0.05), abs=2.0 * 2e-3)  # m, what a step at either end may do
    assert simulation.flow.emitted[0] == AT_FIRST + COLUMN * int((way - 2.0 * simulation.dt) / SPACING)
    assert len(np.unique(simulation.particles.id)) == simulation.rows()


def test_a_stream_that_turns_round_stops_the_run():
    with pytest.raises(NumericalFailure, match=r"inflows\[0\].velocity at t = 0.05.* has turned"):
        run(scene(inflows=[MOUTH | {"velocity": lambda t: (2.0 if t < 0.05 else -2.0, 0.0)}]), until=0.2)


def test_what_comes_in_has_ids_of_its_own_beyond_those_of_bodies():
    two = [MOUTH, MOUTH | {"shape": {"type": "sphere", "center": [0.2, 0.45], "radius": 0.08}, "velocity": [0.0, -0.5]}]
    simulation = run(scene(bodies=[BLOCK], inflows=two), until=0.1)
    particles = simulation.particles
    places = 20 * 12 * 4
    assert (particles.id < places).sum() == 96 - simulation.flow.left[0]
    assert sorted(particles.id[particles.id >= places]) == list(range(places, places + simulation.flow.emitted.sum()))


def test_a_step_is_bounded_by_what_is_about_to_come():
    """Waves of 10 m/s, though nothing is there yet: cfl 0.4 dx / (c sqrt 2)."""
    simulation = run(scene(inflows=[MOUTH | {"start": 0.1}]), steps=1)
    assert simulation.dt == pytest.approx(0.4 * CELL / (10.0 * np.sqrt(2.0)), rel=1e-6)


def test_what_comes_in_and_leaves_balances_to_the_particle_at_any_time():
    made = scene(bodies=[BLOCK], inflows=[MOUTH], time={"end": 1.0}, domain={"gravity": [0.0, -2.0]})
    simulation = Simulation(made)
    found = []
    simulation.every(lambda s: found.append(balance(s)), steps=20, at_start=True)
    simulation.run()
    assert found == [96] * len(found)
    assert len(found) > 10
    assert min(simulation.flow.left) > 0


# ---- restarts and files ----------------------------------------------------------------------------------------------------


def test_a_restart_goes_on_with_the_bits_of_a_run_that_never_stopped(tmp_path):
    """From checkpoints before, while and after the stream, between two columns and where one is due."""
    made = scene(bodies=[BLOCK | {"velocity": [5.0, 0.0]}], inflows=[MOUTH | {"start": 0.03, "until": 0.1}])
    alone, left = Simulation(made), []
    for steps in (10, 20, 4, 5, 6, 30):
        alone.run(steps=steps)
        alone.save(tmp_path / f"{alone.step_count}.hdf")
        left.append(alone.flow.left[0])
    assert 0 < left[2] < left[4]
    alone.run(steps=10)
    for path in tmp_path.glob("*.hdf"):
        again = Simulation.restart(path)
        again.run(steps=alone.step_count - again.step_count)
        assert state_bits(again) == state_bits(alone), path
        assert again.measure() == alone.measure()


def test_a_run_without_bodies_leaves_files_that_can_be_read(tmp_path):
    made = scene(inflows=[MOUTH | {"start": 0.1, "until": 0.2}], output={"diagnostics_interval": 0.05})
    (tmp_path / "stream.toml").write_text(made.to_toml(), encoding="utf-8")
    assert cli.main(["run", str(tmp_path / "stream.toml"), "--out", str(tmp_path / "run"), "--quiet"]) == 0
    found = pmpm.load(tmp_path / "run")
    assert len(found.snapshots[0].x) == 0
    assert len(found.snapshots[len(found.snapshots) // 2].x) > AT_FIRST
    diagnostics = found.diagnostics
    assert (diagnostics["particles"] + diagnostics["left"] == diagnostics["emitted"]).all()
    assert found.record["report"]["flow"]["emitted"] == [diagnostics["emitted"][-1]]


def test_a_study_refuses_material_that_comes_and_goes(tmp_path):
    with pytest.raises(
        SceneError, match=r"x_max is open: levels are compared by material that is there from the start"
    ):
        study(scene(bodies=[BLOCK]), tmp_path / "study")


def test_the_step_is_short_enough_for_a_stream_that_ends_as_it_begins():
    """What it has put in is known to all ranks two steps later; until then nothing else in the scene bounds the step."""
    one_sheet = AT_FIRST * CELL**2 / 4
    for steps in (3, 4, 5):
        simulation = run(scene(inflows=[MOUTH | {"limit": one_sheet, "start": 0.01}], time={"end": 0.6}), steps=steps)
        assert simulation.dt <= 0.2 * CELL / 2.0
    simulation.run(steps=20)
    assert balance(simulation) == 0 < simulation.measure()["particles"]


RECORDS = {
    "more have left than can be counted": ("left", [0, 1 << 63]),
    "shares that cannot be counted": ("left_steps", [0, 10**400]),
    "more have come than can be counted": ("emitted", [0, 1 << 70]),
    "a body has flowed in": ("emitted", [7, 48]),
    "another number of inflows": ("unknown", []),
    "nothing": (None, None),
}


@pytest.mark.parametrize("what", RECORDS)
def test_a_record_of_flows_that_cannot_be_is_refused(what, tmp_path):
    name, value = RECORDS[what]
    simulation = run(scene(bodies=[BLOCK], inflows=[MOUTH]), steps=3)
    told = simulation.flow.state()
    wrong = None if name is None else told | {name: value}
    with mock.patch.object(simulation.flow, "state", return_value=wrong):
        simulation.save(tmp_path / "0.hdf")
    with pytest.raises(OutputError, match="is damaged"):
        Simulation.restart(tmp_path / "0.hdf")


def test_a_stream_of_less_than_a_particle_is_refused():
    with pytest.raises(SceneError, match=r"inflows\[0\].limit = 1e-12 m2 is less than one particle has, 0.000625 m2"):
        scene(inflows=[MOUTH | {"limit": 1e-12}])
