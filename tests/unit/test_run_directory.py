"""A run directory belongs to one run: nothing of anybody else's is lost, and no two runs write to one."""

import contextlib
import json
import os
import socket
import subprocess
import sys
import time

import numpy as np
import pytest
from fake_simulation import FakeSimulation, fake_scene

from pmpm.output import run_directory
from pmpm.output.diagnostics import Diagnostics
from pmpm.output.files import OutputError, write_atomically
from pmpm.output.run_directory import RunDirectory
from pmpm.output.snapshots import SnapshotWriter
from pmpm.parallel.comm import Alone


def create(path, **options):
    return RunDirectory.create(path, 'title = "new"\n', Alone(), **options)


def listing(path):
    return sorted(str(entry.relative_to(path)) for entry in path.rglob("*"))


@pytest.fixture
def finished(tmp_path):
    """A finished run with everything a run writes."""
    directory = RunDirectory.create(tmp_path / "run", 'title = "old"\n', Alone())
    simulation = FakeSimulation(fake_scene())
    SnapshotWriter(directory, simulation.scene)(simulation)
    Diagnostics(directory)(simulation)
    directory.log("done")
    directory.finish("finished", {})
    return directory.path


def leave_lock(path, pid, host=None, began=None):
    path.mkdir(exist_ok=True)
    (path / "run.lock").write_text(json.dumps({"host": host or socket.gethostname(), "pid": pid, "began": began}))


def dead_process():
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


def test_a_new_run_writes_its_scene_record_and_lock(tmp_path):
    directory = create(tmp_path / "deep" / "run")
    assert listing(directory.path) == ["run.json", "run.lock", "scene.toml"]
    assert (directory.path / "scene.toml").read_text() == 'title = "new"\n'
    assert json.loads((directory.path / "run.json").read_text())["status"] == "running"


def test_an_empty_folder_is_taken(tmp_path):
    assert create(tmp_path).path == tmp_path


def test_the_end_is_recorded_and_the_lock_removed(tmp_path):
    directory = create(tmp_path)
    directory.finish("stopped", {"steps": np.int64(3), "speed": np.float32(0.5), "ratio": float("nan"), "name": ("a",)})
    record = json.loads((tmp_path / "run.json").read_text())
    assert record["status"] == "stopped"
    assert record["report"] == {"steps": 3, "speed": 0.5, "ratio": None, "name": ["a"]}
    assert not (tmp_path / "run.lock").exists()


def test_messages_are_appended_to_the_log(tmp_path):
    directory = create(tmp_path)
    directory.log("first")
    directory.log("second")
    assert [line.split("  ")[1] for line in (tmp_path / "log.txt").read_text().splitlines()] == ["first", "second"]


def test_a_log_that_cannot_be_written_does_not_stop_the_run(tmp_path, capsys):
    directory = create(tmp_path)
    (tmp_path / "log.txt").mkdir()
    directory.log("first")
    directory.log("second")
    assert capsys.readouterr().err.count("messages are lost") == 1


def test_a_file_is_refused(tmp_path):
    (tmp_path / "run").write_text("precious")
    with pytest.raises(OutputError, match="is a file"):
        create(tmp_path / "run", overwrite=True)
    assert (tmp_path / "run").read_text() == "precious"


def test_a_folder_below_a_file_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="file is a file"):
        create(tmp_path / "file" / "run")


@pytest.mark.parametrize("below", ["", "deep/run"])
def test_an_unwritable_folder_is_refused(tmp_path, below, monkeypatch):
    # Root may write everywhere, so the system's answer is replaced.
    monkeypatch.setattr(os, "access", lambda path, mode: path != tmp_path)
    with pytest.raises(OutputError, match=f"{tmp_path}.* not writable"):
        create(tmp_path / below)
    assert listing(tmp_path) == []


def test_a_folder_the_system_will_not_make_is_refused():
    with pytest.raises(OutputError, match="/proc/pmpm"):
        create("/proc/pmpm")


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_folder_with_other_files_is_refused_and_left_alone(tmp_path, overwrite):
    (tmp_path / "thesis.tex").write_text("precious")
    with pytest.raises(OutputError, match=r"does not hold a run \(thesis.tex\)"):
        create(tmp_path, overwrite=overwrite)
    assert listing(tmp_path) == ["thesis.tex"]


def test_a_run_json_of_another_program_does_not_make_a_run(tmp_path):
    (tmp_path / "run.json").write_text('{"status": "finished"}')
    with pytest.raises(OutputError, match="does not hold a run"):
        create(tmp_path, overwrite=True)


def test_a_finished_run_is_refused_and_left_as_it_was(finished):
    before = {name: (finished / name).read_bytes() for name in listing(finished) if (finished / name).is_file()}
    with pytest.raises(OutputError, match="finished run.*--overwrite"):
        create(finished)
    assert before == {name: (finished / name).read_bytes() for name in listing(finished) if (finished / name).is_file()}


@pytest.mark.parametrize("status", ["running", "stopped"])
def test_an_unfinished_run_is_refused_saying_what_to_do(tmp_path, status):
    directory = create(tmp_path)
    if status == "stopped":
        directory.finish(status)
    leave_lock(tmp_path, dead_process())
    expected = "interrupted" if status == "running" else "stopped"
    with pytest.raises(
        OutputError, match=rf"unfinished run \(status: {expected}\).*--restart.*continues it.*--overwrite"
    ):
        create(tmp_path)


def test_overwrite_removes_what_the_old_run_wrote(finished):
    create(finished, overwrite=True)
    assert listing(finished) == ["run.json", "run.lock", "scene.toml"]
    assert (finished / "scene.toml").read_text() == 'title = "new"\n'


def test_overwrite_leaves_what_the_run_did_not_write(finished):
    strangers = ["notes.md", "snapshots/000000.png", "snapshots/best.hdf"]
    for name in strangers:
        (finished / name).write_text("precious")
    create(finished, overwrite=True)
    assert [name for name in listing(finished) if name in strangers] == strangers
    assert not (finished / "snapshots" / "000000.hdf").exists()


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_folder_that_a_live_process_writes_to_is_refused(tmp_path, overwrite):
    create(tmp_path)
    with pytest.raises(OutputError, match=f"being written by process {os.getpid()} on {socket.gethostname()}"):
        create(tmp_path, overwrite=overwrite)


def test_a_lock_of_another_host_is_taken_for_live(tmp_path):
    leave_lock(tmp_path, dead_process(), host="elsewhere")
    with pytest.raises(OutputError, match="on elsewhere.*delete"):
        create(tmp_path)


@pytest.mark.parametrize(
    ("left_by", "respected"), [([17, 0], False), ([17, 1], True), ([17, 2], True), ([16, 0], True), (None, True)]
)
def test_a_lock_on_another_host_is_ignored_if_an_earlier_start_of_this_slurm_job_left_it(
    left_by, respected, tmp_path, monkeypatch
):
    """Slurm starts a job again, on other nodes, when its earlier start is over; of other jobs nobody here can know."""
    monkeypatch.setenv("SLURM_JOB_ID", "17")
    monkeypatch.setenv("SLURM_RESTART_COUNT", "1")
    (tmp_path / "run.lock").write_text(json.dumps({"host": "elsewhere", "pid": 1, "slurm_job": left_by}))
    with pytest.raises(OutputError, match="on elsewhere") if respected else contextlib.nullcontext():
        create(tmp_path)


def test_a_lock_names_the_slurm_job_and_its_start(tmp_path, monkeypatch):
    monkeypatch.setenv("SLURM_JOB_ID", "17")
    monkeypatch.delenv("SLURM_RESTART_COUNT", raising=False)
    create(tmp_path)
    assert json.loads((tmp_path / "run.lock").read_text())["slurm_job"] == [17, 0]


def test_a_lock_of_a_dead_process_is_ignored(tmp_path):
    leave_lock(tmp_path, dead_process())
    create(tmp_path)
    assert json.loads((tmp_path / "run.lock").read_text())["pid"] == os.getpid()
    assert listing(tmp_path) == ["run.json", "run.lock", "scene.toml"]


def test_a_lock_whose_process_number_came_round_again_is_ignored(tmp_path):
    leave_lock(tmp_path, os.getpid(), began=run_directory.process_start(os.getpid()) - 1)
    create(tmp_path)


def test_a_lock_put_there_between_looking_and_taking_is_respected(tmp_path, monkeypatch):
    leave_lock(tmp_path, dead_process())
    rename = os.rename

    def rename_late(source, target):
        monkeypatch.setattr(os, "rename", rename)
        leave_lock(tmp_path, os.getpid())
        rename(source, target)

    monkeypatch.setattr(os, "rename", rename_late)
    with pytest.raises(OutputError, match="being written by process"):
        create(tmp_path)
    assert json.loads((tmp_path / "run.lock").read_text())["pid"] == os.getpid()


def test_a_failure_while_starting_leaves_no_lock(tmp_path, monkeypatch):
    def fail(path, text):
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr(run_directory, "write_atomically", fail)
    with pytest.raises(OutputError, match="No space left"):
        create(tmp_path)
    assert listing(tmp_path) == []


def test_a_file_is_replaced_whole_or_not_at_all(tmp_path, monkeypatch):
    path = tmp_path / "file"
    write_atomically(path, "old")
    monkeypatch.setattr(os, "replace", lambda source, target: (_ for _ in ()).throw(OSError("cut off")))
    with pytest.raises(OSError, match="cut off"):
        write_atomically(path, "new")
    assert path.read_text() == "old"


def test_a_run_stays_where_it_began_when_the_working_folder_changes(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    directory = create("run")
    monkeypatch.chdir("/")
    directory.finish("finished")
    assert json.loads((tmp_path / "run" / "run.json").read_text())["status"] == "finished"


def test_diagnostics_give_the_same_bits_back(tmp_path):
    directory = create(tmp_path)
    simulation = FakeSimulation(fake_scene())
    diagnostics = Diagnostics(directory)
    diagnostics(simulation)
    header, line = (tmp_path / "diagnostics.csv").read_text().splitlines()
    assert header == "step,time,dt,particles,mass,momentum_x,max_speed"
    assert line == f"7,{0.1 + 0.2!r},{1e-5 / 3.0!r},40,{2.0 / 3.0!r},1e-300,nan"


def test_every_line_of_diagnostics_is_on_disk_at_once(tmp_path):
    diagnostics = Diagnostics(create(tmp_path))
    for lines in (2, 3, 4):
        diagnostics(FakeSimulation(fake_scene()))
        assert (tmp_path / "diagnostics.csv").read_text().count("\n") == lines


def test_a_process_that_only_waits_for_its_parent_to_ask_for_its_status_is_not_live():
    """A zombie: where nobody asks, as in many containers, it stays for ever."""
    process = subprocess.Popen([sys.executable, "-c", ""])
    began = run_directory.process_start(process.pid)
    while run_directory.process_state(process.pid) != "Z":
        time.sleep(0.01)
    lock = {"host": socket.gethostname(), "pid": process.pid, "began": began}
    assert not run_directory.is_live(lock)
    process.wait()
