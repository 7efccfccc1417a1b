"""When a process of a run fails, all end, soon, with a status that says so and with one message."""

import re
import time
from pathlib import Path

import bits
import launch
import pytest
import several_laws

from pmpm.output.run_directory import read_status

RAISE = Path(__file__).parent / "drivers" / "raise_on_one_rank.py"
SOON = 90  # s, most of it the start of Python


@pytest.fixture
def scene_file(tmp_path):
    path = tmp_path / "drop.toml"
    path.write_text(several_laws.short(end=50.0).to_toml(), encoding="utf-8")
    return path


@pytest.mark.parametrize("rank", [0, 1, 2])
def test_an_error_on_one_rank_ends_all_with_its_traceback(rank, scene_file, tmp_path):
    arguments = [RAISE, rank, 20, "run", scene_file, "--set", "domain.size=[0.6, 0.2]"]
    done = launch.python(arguments, 3, SOON, tmp_path)
    assert done.status not in (0, None), done.text
    assert "Traceback" in done.text
    assert f"RuntimeError: no luck on rank {rank}" in done.text


def test_an_error_without_mpirun_shows_its_traceback(scene_file, tmp_path):
    done = launch.python([RAISE, 0, 20, "run", scene_file], None, SOON, tmp_path)
    assert (done.status, done.text.count("RuntimeError: no luck on rank 0")) == (1, 1), done.text


def test_a_run_that_was_ended_is_not_taken_for_a_finished_one(scene_file, tmp_path):
    assert status_of_ended_run(scene_file, tmp_path) == "interrupted"


def test_a_run_that_was_ended_can_be_replaced(scene_file, tmp_path):
    status_of_ended_run(scene_file, tmp_path)
    bits.run(several_laws.short(), tmp_path / "run", 2, options=["--overwrite"])


def status_of_ended_run(scene_file, tmp_path):
    """What is said of a run one rank of which failed, as soon as the process that wrote it is surely gone."""
    launch.python([RAISE, 1, 20, "run", scene_file, "--out", "run"], 2, SOON, tmp_path)
    began = time.monotonic()
    while (status := read_status(tmp_path / "run")) == "running" and time.monotonic() - began < 10:
        time.sleep(0.1)
    return status


@pytest.mark.parametrize("variable", ["PMI_SIZE", "PMIX_SIZE", "SLURM_STEP_NUM_TASKS"])
def test_a_launcher_that_mpi_does_not_know_of_is_refused(variable, scene_file, tmp_path):
    done = launch.python(["-m", "pmpm", "run", scene_file], None, SOON, tmp_path, **{variable: "2"})
    assert done.status == 2, done.text
    assert done.text.startswith("pmpm: the launcher started 2 processes but MPI reports a world of 1"), done.text
    assert done.text.count("\n") == 1, done.text
    assert [path.name for path in tmp_path.iterdir()] == ["drop.toml"]


ASK = "import mpi4py; mpi4py.rc.initialize = False; from mpi4py import MPI; print(MPI.Get_library_version())"


def test_an_mpich_that_open_mpi_has_launched_is_refused_before_it_aborts(scene_file, tmp_path):
    """With all that Open MPI's launcher says MPICH would end in MPI_Init, with a message of its own."""
    library = launch.python(["-c", ASK], None, SOON, tmp_path).text.lower()
    if "mpich" not in library or "pmix" in library:
        pytest.skip("mpi4py is not that of an MPICH without PMIx")
    launched = {
        "OMPI_COMM_WORLD_SIZE": "2",
        "PMIX_NAMESPACE": "1",
        "PMIX_RANK": "0",
        "PMIX_SERVER_URI2": "1.0;tcp4://0:1",
    }
    texts = []
    for rank in ("0", "1"):
        told = launched | {"OMPI_COMM_WORLD_RANK": rank, "PMIX_RANK": rank}
        done = launch.python(["-m", "pmpm", "run", scene_file], None, SOON, tmp_path, **told)
        assert done.status == 2, done.text
        texts.append(done.text)
    assert texts[0].startswith(
        "pmpm: the launcher that started 2 processes is Open MPI's, but mpi4py belongs to MPICH. Use "
    )
    assert (texts[0].count("\n"), texts[1]) == (1, "")
    assert [path.name for path in tmp_path.iterdir()] == ["drop.toml"]


def test_of_two_processes_that_do_not_know_of_each_other_one_speaks(scene_file, tmp_path):
    texts = [
        launch.python(["-m", "pmpm", "run", scene_file], None, SOON, tmp_path, PMI_SIZE="2", PMI_RANK=rank).text
        for rank in ("0", "1")
    ]
    assert [text.count("the launcher started 2 processes") for text in texts] == [1, 0], texts


BROKEN = {
    "mistake in the file": (["run", "drop.toml", "--set", "materials.water.density=-1.0"], "density"),
    "no such scene": (["run", "dam_brake"], "dam_break"),
    "body without particles": (["run", "drop.toml", "--set", "bodies.0.shape.max=[0.001, 0.001]"], "no particle"),
    "step too long": (["run", "dam_break", "--set", "time.step=0.1"], "stable step"),
    "no card": (["run", "drop.toml", "--backend", "cuda"], "no NVIDIA driver"),
    "a check of it": (["check", "drop.toml", "--set", "materials.water.density=-1.0"], "density"),
    "no such option": (["run", "drop.toml", "--fast"], "--fast"),
}


@pytest.mark.parametrize("what", BROKEN)
def test_wrong_input_on_two_ranks_gives_one_message_status_2_and_no_folder(what, scene_file, tmp_path):
    arguments, named = BROKEN[what]
    done = launch.python(["-m", "pmpm", *arguments], 2, SOON, tmp_path)
    assert done.status == 2, done.text
    assert len(re.findall(r"^pmpm: ", done.text, re.MULTILINE)) == 1, done.text
    assert named in done.text
    assert "Traceback" not in done.text
    assert [path.name for path in tmp_path.iterdir()] == ["drop.toml"]


def test_a_numerical_failure_ends_all_ranks_with_status_1_and_one_message(tmp_path):
    """Water that falls out through a floor that is not there."""
    path = tmp_path / "drop.toml"
    path.write_text(several_laws.corner(end=1.0).to_toml(), encoding="utf-8")
    arguments = ["-m", "pmpm", "run", path, "--quiet", "--set", "domain.walls.y_min=free"]
    done = launch.python(arguments, 2, SOON, tmp_path)
    assert done.status == 1, done.text
    assert done.text.count("pmpm: stopped: step") == 1, done.text
    assert "left the domain" in done.text
    assert bits.report(tmp_path / "drop")["failure"] in done.text


def test_the_version_is_said_once_on_two_ranks(tmp_path):
    done = launch.python(["-m", "pmpm", "--version"], 2, SOON, tmp_path)
    assert (done.status, done.text.count("pmpm")) == (0, 1), done.text
