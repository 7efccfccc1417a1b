"""What a restart makes of paths written in another way, of folders that are not what they were, and of other processes.

All on one process, with runs of a few steps.
"""

import os
import shutil
import subprocess
import sys

import bits
import launch
import pytest
import several_laws

from pmpm import cli, restart
from pmpm.output import manifests
from pmpm.output.files import OutputError
from pmpm.output.reader import load
from pmpm.parallel.comm import Alone
from pmpm.run import run_scene
from pmpm.scene.schema import Scene
from pmpm.simulation import Simulation


def scene():
    told = several_laws.flat(end=0.02).model_dump(exclude_none=True)
    told["output"] |= {"checkpoint_interval": 0.005, "diagnostics_interval": 0.001}
    return Scene(**told)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole")
    run_scene(scene(), folder / "run", Alone(), quiet=True)
    return folder / "run"


@pytest.fixture(scope="module")
def half(tmp_path_factory):
    folder = tmp_path_factory.mktemp("half")
    run_scene(scene(), folder / "run", Alone(), until=0.011, quiet=True)
    return folder / "run"


@pytest.fixture
def folder(half, tmp_path, monkeypatch):
    shutil.copytree(half, tmp_path / "run")
    (tmp_path / "scene.toml").write_text(scene().to_toml(), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(*arguments):
    return cli.main(["run", "--quiet", *map(str, arguments)])


def contents(place):
    return {path.relative_to(place): path.read_bytes() for path in place.rglob("*") if path.is_file()}


@pytest.mark.parametrize("out", [(), ("--out", "run/"), ("--out", "link")])
def test_a_run_goes_on_in_its_folder_however_that_is_written(out, folder, whole):
    """Behind a link lies the work space of many a cluster."""
    (folder / "link").symlink_to("run")
    assert run("--restart", "link", *out) == 0
    assert bits.differences(whole, folder / "run") == []


def test_a_finished_run_has_nothing_to_do_however_its_folder_is_written(folder, whole, capsys):
    assert run("--restart", "run") == 0
    before = contents(folder / "run")
    assert run("scene.toml", "--restart", folder / "run", "--out", "run/") == 0
    assert "nothing is left to do" in capsys.readouterr().err
    assert contents(folder / "run") == before


def test_a_finished_run_goes_on_to_a_later_end_if_it_has_left_a_checkpoint(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scene.toml").write_text(several_laws.flat(end=0.004).to_toml(), encoding="utf-8")
    assert run("scene.toml", "--out", "run") == run("--restart", "run") == 0
    assert not (tmp_path / "run" / "checkpoints").exists()
    before = contents(tmp_path / "run")
    assert run("--restart", "run", "--set", "time.end=0.006") == 2
    assert "output.checkpoint_at_end = true would have left one" in capsys.readouterr().err
    assert contents(tmp_path / "run") == before

    assert run("scene.toml", "--out", "run", "--overwrite", "--set", "output.checkpoint_at_end=true") == 0
    assert run("--restart", "run", "--set", "time.end=0.006") == 0
    done = load("run")
    assert done.status == "finished"
    steps, times = done.diagnostics["step"], [snapshot.time for snapshot in done.snapshots]
    assert (steps[1:] > steps[:-1]).all()
    assert times == sorted(set(times))
    assert (times[-1], done.diagnostics["time"][-1]) == (0.006, 0.006)
    assert sorted(path.name for path in (tmp_path / "run" / "checkpoints").glob("*.hdf")) == [
        "000000.hdf",
        "000001.hdf",
    ]


def test_a_restart_that_takes_no_step_writes_no_second_last_snapshot(folder, whole):
    assert run("--restart", "run") == 0
    assert run("--restart", "run", "--set", "output.checkpoint_keep=3") == 0
    assert bits.differences(whole, folder / "run") == []


def test_a_branch_that_takes_no_step_holds_the_state_it_began_with(folder):
    assert run("--restart", "run", "--out", "branch", "--until", "0.001") == 0
    assert len(load("branch").snapshots) == 1


def test_a_checkpoint_that_is_not_there_is_no_folder_for_a_new_run(folder, capsys):
    before = contents(folder)
    assert run("scene.toml", "--restart", "run/checkpoints/000099.hdf") == 2
    assert "there is no such checkpoint" in capsys.readouterr().err
    assert contents(folder) == before


def test_a_manifest_is_not_called_a_damaged_checkpoint(folder, capsys):
    (number, *_) = manifests.numbers("run/checkpoints")
    assert run("--restart", f"run/checkpoints/{number:06d}.json") == 2
    assert "the name of one ends in .hdf; the newest good checkpoint beside it is" in capsys.readouterr().err


def test_checkpoints_copied_beside_other_files_harm_none_of_them(folder, capsys):
    place = folder / "mine"
    shutil.copytree("run/checkpoints", place / "checkpoints")
    (place / "snapshots").mkdir()
    (place / "snapshots" / "000123.hdf").write_text("mine")
    (place / "diagnostics.csv").write_text("mine")
    before = contents(place)
    (number, *_) = manifests.numbers(place / "checkpoints")
    assert run("--restart", "mine") == 2
    assert run("--restart", f"mine/checkpoints/{number:06d}.hdf") == 2
    assert "give an output folder" in capsys.readouterr().err
    assert contents(place) == before


def test_a_file_saved_among_the_checkpoints_begins_a_branch(folder, capsys):
    Simulation.restart("run").save("run/checkpoints/here.hdf")
    assert run("--restart", "run/checkpoints/here.hdf", "--steps", 1) == 2
    assert "does not lie in a run's folder" in capsys.readouterr().err
    assert run("--restart", "run/checkpoints/here.hdf", "--steps", 1, "--out", "branch") == 0


def test_a_run_without_its_record_goes_on(folder, whole):
    (folder / "run" / "run.json").write_text("{")
    assert run("--restart", "run") == 0
    assert bits.differences(whole, folder / "run") == []


def test_a_damaged_snapshot_is_left_out_of_the_index_and_the_run_goes_on(folder, whole):
    (folder / "run" / "snapshots" / "000001.hdf").write_text("no HDF5")
    assert run("--restart", "run") == 0
    assert "000001.hdf" not in (folder / "run" / "snapshots.xdmf").read_text()
    assert "000001.hdf cannot be read as a snapshot" in (folder / "run" / "log.txt").read_text()
    assert (folder / "run/snapshots/000005.hdf").read_bytes() == (whole / "snapshots/000005.hdf").read_bytes()


@pytest.mark.parametrize("text", [b"", b"a,b\n1,2\n", b"\xff\xfe\x00"])
def test_diagnostics_that_are_none_are_put_aside_and_begin_anew(text, folder, whole):
    (folder / "run" / "diagnostics.csv").write_bytes(text)
    assert run("--restart", "run") == 0
    assert (folder / "run" / "diagnostics.csv.damaged").read_bytes() == text
    lines, own = ((at / "diagnostics.csv").read_text().splitlines() for at in (whole, folder / "run"))
    assert own == [lines[0], *lines[-len(own) + 1 :]]


def test_what_another_process_has_done_meanwhile_is_not_cut(folder, whole):
    """It took the lock and gave it back between this one's look at the checkpoints and its turn."""
    origin = restart.find("run", Alone())
    assert (
        run("--restart", "run", "--set", "output.checkpoint_keep=9") == 0
    )  # so that the one chosen here is still there
    before = contents(folder / "run")
    with pytest.raises(OutputError, match="another process has gone on with this run meanwhile"):
        run_scene(scene(), folder / "run", Alone(), quiet=True, origin=origin)
    assert before.items() <= contents(folder / "run").items()


@pytest.mark.parametrize("screen", ["2>&1 | head -n 1", "2> /dev/full > /dev/full", ">&- 2>&-"])
def test_a_screen_that_is_gone_ends_no_run(screen, folder):
    """The terminal closed, the reader of a pipe gone, the disk of a redirection full."""
    command = f"{sys.executable} -m pmpm run scene.toml --out other {screen}"
    environment = os.environ | {"PYTHONPATH": str(launch.ROOT)}
    done = subprocess.run(["bash", "-c", command], env=environment, timeout=120, capture_output=True)
    assert done.returncode == 0, done.stderr
    assert load("other").status == "finished"
