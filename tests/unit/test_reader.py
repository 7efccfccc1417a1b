"""What a run wrote is read back the same, while it runs and afterwards; what is no run is named as such."""

import os

import h5py
import numpy as np
import pytest
from fake_simulation import SAND, FakeSimulation, fake_scene

from pmpm.output.diagnostics import Diagnostics
from pmpm.output.files import OutputError
from pmpm.output.reader import describe, load
from pmpm.output.run_directory import RunDirectory
from pmpm.output.snapshots import SnapshotWriter
from pmpm.parallel.comm import Alone

SCENE = """
title = "Block"
[domain]
size = [1.0, 1.0]
cell_size = 0.1
[materials.rubber]
model = "neo_hookean"
density = 1000.0
youngs_modulus = 1e5
poisson_ratio = 0.3
[[bodies]]
material = "rubber"
shape = { type = "box", min = [0.2, 0.2], max = [0.5, 0.5] }
[time]
end = 1.0
"""


@pytest.fixture
def directory(tmp_path):
    return RunDirectory.create(tmp_path / "run", SCENE, Alone())


@pytest.fixture
def simulation(directory):
    """A simulation after three snapshots and three lines of diagnostics."""
    simulation = FakeSimulation(fake_scene(dim=2, fields=("velocity", "pressure", "v_c")))
    observers = SnapshotWriter(directory, simulation.scene), Diagnostics(directory)
    for _ in range(3):
        simulation.advance()
        for observe in observers:
            observe(simulation)
    return simulation


def test_snapshots_come_in_order_with_their_times_and_steps(directory, simulation):
    snapshots = load(directory.path).snapshots
    assert [snapshot.step for snapshot in snapshots] == [8, 9, 10]
    assert snapshots[-1].time == simulation.time


def test_a_slice_of_snapshots_is_a_sequence_of_snapshots(directory, simulation):
    assert [snapshot.step for snapshot in load(directory.path).snapshots[1:]] == [9, 10]


@pytest.mark.parametrize("name", ["x", "id", "velocity", "pressure", "v_c"])
def test_fields_are_attributes_with_the_values_of_the_simulation(directory, simulation, name):
    np.testing.assert_array_equal(getattr(load(directory.path).snapshots[-1], name), simulation.all[name])


def test_a_laws_own_state_is_read_over_its_particles(directory, simulation):
    snapshot = load(directory.path).snapshots[0]
    assert snapshot.laws == {"drucker_prager": ["v_c"]}
    expected = simulation.all["v_c"][simulation.all["material"] == SAND]
    np.testing.assert_array_equal(snapshot.law_field("drucker_prager", "v_c"), expected)


def test_a_field_that_was_not_written_is_an_error_that_lists_the_others(directory, simulation):
    with pytest.raises(AttributeError, match="holds no 'stress'; it holds x, id, pressure, v_c, velocity"):
        _ = load(directory.path).snapshots[0].stress


def test_diagnostics_are_read_bit_for_bit(directory, simulation):
    diagnostics = load(directory.path).diagnostics
    assert list(diagnostics)[:4] == ["step", "time", "dt", "particles"]
    assert diagnostics["time"][-1] == simulation.time
    assert diagnostics["step"].tolist() == [8, 9, 10]
    assert np.isnan(diagnostics["max_speed"]).all()


def test_a_line_of_diagnostics_that_is_being_written_is_left_out(directory, simulation):
    with open(directory.path / "diagnostics.csv", "a") as file:
        file.write("11,0.7,1e-")
    assert load(directory.path).diagnostics["step"].tolist() == [8, 9, 10]


def test_a_damaged_line_of_diagnostics_is_an_error(directory, simulation):
    with open(directory.path / "diagnostics.csv", "a") as file:
        file.write("11,0.7\n")
    with pytest.raises(OutputError, match="damaged"):
        _ = load(directory.path).diagnostics


def test_a_run_that_has_just_begun_has_nothing_yet(directory):
    run = load(directory.path)
    assert (len(run.snapshots), run.diagnostics, run.status) == (0, {}, "running")


def test_a_running_run_can_be_followed(directory):
    snapshots_before, run = [], load(directory.path)
    simulation = FakeSimulation(fake_scene())
    writer = SnapshotWriter(directory, simulation.scene)
    for _ in range(2):
        snapshots_before.append(len(run.snapshots))
        writer(simulation)
    assert [*snapshots_before, len(run.snapshots)] == [0, 1, 2]


def test_a_snapshot_being_written_is_not_listed(directory, simulation):
    (directory.path / "snapshots" / ".000003.hdf.unfinished").write_bytes(b"half")
    assert len(load(directory.path).snapshots) == 3


@pytest.mark.parametrize("status", ["finished", "stopped"])
def test_the_status_is_what_the_run_said_at_its_end(directory, status):
    directory.finish(status, {"steps": 10})
    run = load(directory.path)
    assert (run.status, run.record["report"]) == (status, {"steps": 10})


def test_a_run_whose_process_is_gone_is_interrupted(directory):
    os.unlink(directory.path / "run.lock")
    assert load(directory.path).status == "interrupted"


def test_the_scene_is_the_one_that_was_run(directory):
    scene = load(directory.path).scene
    assert (scene.title, scene.dim, scene.time.end) == ("Block", 2, 1.0)


def test_a_run_is_described_with_all_it_holds(directory, simulation):
    directory.finish("finished")
    text = describe(directory.path)
    for part in (
        "Block",
        "finished after",
        "snapshots     3, t = 0.4 to 0.6 s",
        "particles     40 in 2-D, float64",
        "0 water, 1 sand",
        "drucker_prager/v_c",
        "diagnostics   3 lines",
        "momentum_x",
    ):
        assert part in text


def test_a_run_that_has_just_begun_is_described(directory):
    assert "snapshots     0" in describe(directory.path)


def test_a_snapshot_file_is_described(directory, simulation):
    text = describe(directory.path / "snapshots" / "000001.hdf")
    assert "time          0.5 s, step 9" in text
    assert "pressure             float64      Pa" in text


def another_version(path):
    with h5py.File(path, "w") as file:
        file["VTKHDF/Points"] = np.zeros((0, 3))
        file.create_group("pmpm").attrs["format_version"] = 99


def other_hdf5(path):
    h5py.File(path, "w").close()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda path: None, "does not exist"),
        (lambda path: path.mkdir(), "neither a run"),
        (lambda path: path.write_text("hello"), "cannot be read as a snapshot"),
        (other_hdf5, "not a snapshot of pmpm"),
        (another_version, "format_version 99; this pmpm reads 1"),
    ],
)
def test_what_is_neither_run_nor_snapshot_is_named(tmp_path, make, message):
    make(tmp_path / "thing")
    with pytest.raises(OutputError, match=message):
        describe(tmp_path / "thing")


@pytest.mark.parametrize(
    ("make", "message"), [(lambda path: None, "does not exist"), (lambda path: path.mkdir(), "hold a run")]
)
def test_loading_what_is_no_run_is_an_error(tmp_path, make, message):
    make(tmp_path / "thing")
    with pytest.raises(OutputError, match=message):
        load(tmp_path / "thing")
