"""Disks that are full or gone, and runs that go wrong: a message, a status, and every older file as it was."""

import os
import shutil
import subprocess
from pathlib import Path
from types import SimpleNamespace

import bits
import h5py
import launch
import numpy as np
import pytest
import several_laws

from pmpm import restart
from pmpm.explain import explain
from pmpm.output import manifests
from pmpm.output.files import OutputError
from pmpm.output.reader import Snapshot, describe, load
from pmpm.output.snapshots import write_failed
from pmpm.parallel.comm import Alone
from pmpm.run import run_scene
from pmpm.scene.schema import Scene
from pmpm.simulation import NumericalFailure, Simulation

LIMIT = 120
IS_MPIO = "PMPM_TEST_MPIRUN" in os.environ  # under an h5py built with MPI, which may end in an abort
RUN = ["-m", "pmpm", "run", "scene.toml", "--out", "run", "--quiet"]


def scene(**output):
    told = several_laws.flat(end=0.05).model_dump(exclude_none=True)
    told["output"] |= {"fields": bits.all_fields(several_laws.flat()), "checkpoint_interval": 0.005} | output
    return Scene(**told)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole") / "run"
    bits.run(scene(), folder, 2)
    return folder


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "scene.toml").write_text(scene().to_toml(), encoding="utf-8")
    return tmp_path


def stopped_on_the_way(folder, until="0.021"):
    """A run that has stopped with three checkpoints or more behind it, two of them kept."""
    done = launch.python([*RUN, "--until", until], 2, LIMIT, folder)
    assert done.status == 0, done.text
    return folder / "run" / "checkpoints"


def contents(place):
    return {path.name: path.read_bytes() for path in sorted(place.iterdir())}


def continued(folder, ranks=3):
    return launch.python([*RUN, "--restart", "run"], ranks, LIMIT, folder)


# ---- damaged checkpoints -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("damage", ["cut short", "a flipped bit", "no manifest", "another version", "gone"])
def test_a_restart_falls_back_to_the_last_good_checkpoint(damage, folder, whole):
    place = stopped_on_the_way(folder)
    newest = place / f"{manifests.numbers(place)[0]:06d}.hdf"
    harm(newest, damage)
    before = contents(place)
    done = launch.python([*RUN, "--restart", "run", "--steps", "1"], 2, LIMIT, folder)
    assert done.status == 0, done.text
    kept = {name: data for name, data in contents(place).items() if name in before}
    assert kept.items() <= before.items()
    assert continued(folder).status == 0
    assert bits.differences(whole, folder / "run") == []
    told = (folder / "run" / "log.txt").read_text()
    assert ("an older checkpoint is taken" in told) == (damage != "no manifest")


def harm(path, damage):
    if damage == "cut short":
        os.truncate(path, path.stat().st_size // 2)
    elif damage == "a flipped bit":
        data = bytearray(path.read_bytes())
        data[len(data) // 3] ^= 1
        path.write_bytes(data)
    elif damage == "no manifest":
        path.with_suffix(".json").unlink()
    elif damage == "another version":
        manifest = path.with_suffix(".json")
        manifest.write_text(manifest.read_text().replace('"format_version": 1', '"format_version": 2'))
    else:
        path.unlink()


def test_without_any_good_checkpoint_a_restart_says_so_and_touches_nothing(folder):
    place = stopped_on_the_way(folder)
    for path in place.glob("*.hdf"):
        os.truncate(path, 100)
    before = contents(place) | contents(folder / "run" / "snapshots")
    done = continued(folder)
    assert done.status == 2
    assert "holds no good checkpoint" in done.text
    assert done.text.count("pmpm:") == 1
    assert contents(place) | contents(folder / "run" / "snapshots") == before


def test_an_older_checkpoint_is_taken_only_if_what_came_later_may_go(folder, whole):
    place = stopped_on_the_way(folder)
    older = place / f"{manifests.numbers(place)[-1]:06d}.hdf"
    done = launch.python([*RUN, "--restart", older], 2, LIMIT, folder)
    assert done.status == 2
    assert "holds newer checkpoints than" in done.text
    assert launch.python([*RUN, "--restart", older, "--overwrite"], 2, LIMIT, folder).status == 0
    assert bits.differences(whole, folder / "run") == []


def test_snapshots_from_after_the_checkpoint_do_not_stay(folder):
    place = stopped_on_the_way(folder, "0.033")
    older = place / f"{manifests.numbers(place)[-1]:06d}.hdf"
    settings = ["--overwrite", "--set", "output.snapshot_interval=0.04", "--until", "0.03"]
    assert launch.python([*RUN, "--restart", older, *settings], 2, LIMIT, folder).status == 0
    times = [snapshot.time for snapshot in load(folder / "run").snapshots]
    assert times == sorted(times)
    assert max(times) < 0.031
    assert (folder / "run" / "snapshots.xdmf").read_text().count("<Time") == len(times)


def test_a_branch_goes_into_a_folder_of_its_own_and_goes_on_counting(folder, whole):
    place = stopped_on_the_way(folder)
    before = contents(place) | contents(folder / "run" / "snapshots")
    newest = place / f"{manifests.numbers(place)[0]:06d}.hdf"
    done = launch.python(["-m", "pmpm", "run", "--restart", newest, "--out", "branch", "--quiet"], 2, LIMIT, folder)
    assert done.status == 0, done.text
    assert contents(place) | contents(folder / "run" / "snapshots") == before
    names = sorted(path.name for path in (folder / "branch" / "snapshots").iterdir())
    assert names == [f"{number:06d}.hdf" for number in range(3, 6)]
    assert all((folder / "branch/snapshots" / n).read_bytes() == (whole / "snapshots" / n).read_bytes() for n in names)
    lines = (whole / "diagnostics.csv").read_text().splitlines()
    own = (folder / "branch" / "diagnostics.csv").read_text().splitlines()
    assert own[0] == lines[0]
    assert own[1:] == lines[-len(own) + 1 :]
    assert load(folder / "branch").record["restarts"][0]["checkpoint"] == str(newest)


# ---- full disks ----------------------------------------------------------------------------------------------------------


LIMITED = """
import resource, sys
from pmpm import cli
from pmpm.parallel import comm
comm.from_launcher()  # MPI's own shared memory counts as files
resource.setrlimit(resource.RLIMIT_FSIZE, ({nbytes}, {nbytes}))
sys.exit(cli.main({arguments!r}))
"""


@pytest.mark.parametrize("ranks", [None, 2])
def test_a_file_that_may_not_grow_ends_the_run_with_a_message_and_older_files_intact(ranks, folder, whole):
    place = stopped_on_the_way(folder)
    before = contents(place)
    largest = max(map(len, before.values()))
    script = LIMITED.format(nbytes=largest // 2, arguments=[*RUN[2:], "--restart", "run"])
    done = launch.python(["-c", script], ranks, LIMIT, folder)
    assert done.status == 1, done.text
    assert "pmpm: stopped:" in done.text
    assert "cannot be written:" in done.text
    assert "File too large" in done.text or IS_MPIO  # whose complaint tells no reason
    assert "Traceback" not in done.text
    assert {name: data for name, data in contents(place).items() if name in before} == before
    assert manifests.newest_good(place, Alone())[0] is not None
    assert not list((folder / "run").rglob("*.unfinished")) or IS_MPIO
    assert continued(folder).status == 0
    assert bits.differences(whole, folder / "run") == []


@pytest.fixture
def small_disk(tmp_path):
    """A file system of 3 MB."""
    place = tmp_path / "disk"
    place.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=3m", "tmpfs", place], capture_output=True, text=True)
    if mounted.returncode:
        pytest.skip(f"no file system can be mounted here: {mounted.stderr.strip()}")
    yield place
    subprocess.run(["umount", "-l", place], check=True)


def test_a_full_disk_ends_the_run_with_a_message_and_the_last_checkpoint_goes_on(small_disk, folder, whole):
    """3 MB hold two checkpoints of 0.6 MB and a few snapshots; with more disk the run goes on to the same bits."""
    shutil.copy(folder / "scene.toml", small_disk)
    done = launch.python(RUN, 2, LIMIT, small_disk)
    assert done.status == 1, done.text
    assert "No space left on device" in done.text
    assert "the newest good checkpoint is" in done.text or IS_MPIO
    assert "Traceback" not in done.text
    shutil.copytree(small_disk / "run", folder / "run")
    assert manifests.numbers(folder / "run" / "checkpoints")
    assert continued(folder).status == 0
    assert bits.differences(whole, folder / "run") == []


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_read_only_folder_is_refused_at_the_start(folder):
    folder.chmod(0o500)
    done = launch.python(RUN, 2, LIMIT, folder)
    folder.chmod(0o700)
    assert done.status == 2
    assert "not writable" in done.text


def test_a_read_only_file_system_is_refused_at_the_start(small_disk, folder):
    subprocess.run(["mount", "-o", "remount,ro", small_disk], check=True)
    done = launch.python(["-m", "pmpm", "run", folder / "scene.toml", "--out", small_disk / "run"], 2, LIMIT, folder)
    assert done.status == 2, done.text
    assert "not writable" in done.text
    assert done.text.count("pmpm:") == 1


def test_a_full_file_system_at_the_start_is_a_message(small_disk, folder):
    (small_disk / "filler").write_bytes(bytes((3 << 20) - (4 << 10)))
    done = launch.python(["-m", "pmpm", "run", folder / "scene.toml", "--out", small_disk / "run"], 2, LIMIT, folder)
    assert done.status in (1, 2), done.text
    assert "No space left on device" in done.text
    assert "Traceback" not in done.text


def test_a_folder_that_vanishes_ends_the_run_with_a_message(folder):
    script = (
        "import shutil, sys; from pmpm import cli; from pmpm.simulation import Simulation\n"
        "advance = Simulation.advance\n"
        "def vanishing(self, dt):\n"
        "    advance(self, dt)\n"
        "    if self.step_count == 50 and self.comm.rank == 1: shutil.rmtree('run')\n"
        "Simulation.advance = vanishing\n"
        f"sys.exit(cli.main({RUN[2:]!r}))"
    )
    done = launch.python(["-c", script], 2, LIMIT, folder)
    assert done.status == 1, done.text
    assert "pmpm: stopped:" in done.text
    assert "no such file or directory" in done.text.lower()  # the system's words, or those of MPI-IO
    assert "Traceback" not in done.text


# ---- runs that go wrong --------------------------------------------------------------------------------------------------


def falling(**tables):
    """Water that falls out through a floor that is not there."""
    told = several_laws.corner(end=1.0).model_dump(exclude_none=True)
    told["domain"]["walls"]["y_min"] = "free"
    return Scene(**(told | tables))


def failed(scene, tmp_path, **options):
    with pytest.raises(NumericalFailure) as raised:
        run_scene(scene, tmp_path / "run", Alone(), quiet=True, **options)
    return str(raised.value), tmp_path / "run"


def test_the_state_of_a_failed_run_is_a_snapshot_marked_bad(tmp_path):
    message, run = failed(falling(), tmp_path)
    assert f"its state is in {run / 'failed.hdf'}" in message
    assert "there is no checkpoint" in message
    assert "left the domain" in Snapshot(run / "failed.hdf").attributes["failure"]
    assert "failed        step" in describe(run / "failed.hdf")
    assert f"failed state  {run / 'failed.hdf'}" in describe(run)
    assert "failed.hdf" not in (run / "snapshots.xdmf").read_text()


def test_a_failed_state_is_no_checkpoint(tmp_path):
    _, run = failed(falling(), tmp_path)
    with pytest.raises(OutputError, match="is no finished checkpoint"):
        restart.find(run / "failed.hdf", Alone())


def test_the_newest_good_checkpoint_is_named(tmp_path):
    scene = falling(output={"checkpoint_interval": 0.02})
    message, run = failed(scene, tmp_path)
    newest = run / "checkpoints" / f"{manifests.numbers(run / 'checkpoints')[0]:06d}.hdf"
    assert f"the newest good checkpoint is {newest}" in message
    assert f", the newest at step {manifests.read_manifest(newest)['step']}" in describe(run)
    assert Simulation.restart(newest).step_count > 0


@pytest.mark.parametrize("interval", [7, 50])
def test_a_copy_in_memory_becomes_a_checkpoint_at_most_so_many_steps_back(interval, tmp_path):
    message, run = failed(falling(guard={"keep_copy": True, "interval": interval}), tmp_path)
    (number,) = manifests.numbers(run / "checkpoints")
    back = int(message.split("step ")[1].split(",")[0]) - Simulation.restart(run).step_count
    assert 0 < back <= interval
    resumed = Simulation.restart(run)
    with pytest.raises(NumericalFailure) as raised:
        resumed.run()
    assert str(raised.value) == message.partition(";")[0]


def test_the_copy_is_of_particles_that_move_on(tmp_path):
    simulation = Simulation(several_laws.flat())
    simulation.run(steps=5)
    copy = simulation.state().copy()
    before = [population.reals.tobytes() for population in copy.populations]
    simulation.run(steps=5)
    assert [population.reals.tobytes() for population in copy.populations] == before
    assert [population.reals.tobytes() for population in simulation.populations] != before


def test_a_failed_run_goes_on_from_its_checkpoint_with_what_was_wrong_mended(tmp_path):
    failed(falling(output={"checkpoint_interval": 0.02}), tmp_path)
    arguments = ["-m", "pmpm", "run", "--restart", "run", "--quiet", "--set", "domain.walls.y_min=separate"]
    done = launch.python([*arguments, "--steps", "100"], 2, LIMIT, tmp_path)
    assert done.status == 0, done.text
    assert "changed since: domain.walls.y_min" in (tmp_path / "run" / "log.txt").read_text()
    assert not (tmp_path / "run" / "failed.hdf").exists()


def test_what_check_says_of_the_copy_is_what_it_takes():
    """Within the tenth that fills up blocks."""
    scene = Scene.builtin("dam_break", {"guard.keep_copy": True, "domain.cell_size": 0.000714375})
    (line,) = (line for line in explain(scene, 1).splitlines() if "keep_copy" in line)
    copy = Simulation(scene).state().copy()
    held = sum(population.nbytes for population in copy.populations)
    assert float(line.split("and ")[1].split(" MB")[0]) == pytest.approx(held / 1e6, rel=0.1)
    assert "copy" not in explain(Scene.builtin("dam_break"), 1)


def test_a_failed_state_that_is_not_a_number_is_written_as_it_is(tmp_path):
    simulation = Simulation(several_laws.flat())
    simulation.run(steps=5)
    velocities = simulation.particles.v
    velocities[3] = np.nan
    simulation.particles.v = velocities
    path = write_failed(SimpleNamespace(path=tmp_path, comm=Alone()), simulation, "why")
    with h5py.File(path) as file:
        assert np.isnan(file["VTKHDF/PointData/velocity"][3]).any()
    assert Path(path).name == "failed.hdf"
