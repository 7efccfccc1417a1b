"""Signals and the end of the wall time: all ranks stop after the same step, with a checkpoint, status 3, and nothing lost."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import bits
import launch
import pytest
import several_laws

from pmpm import requests
from pmpm.output import manifests
from pmpm.output.reader import load
from pmpm.parallel.comm import Alone
from pmpm.scene.errors import SceneError
from pmpm.scene.schema import Scene
from pmpm.watching import CHECKPOINT, OUT_OF_TIME, SIGNALLED

DRIVER = Path(__file__).parent / "drivers" / "signal_one_rank.py"
LIMIT = 120


def scene():
    """With lines of diagnostics that do not come in every step: else a last one would not be too many."""
    told = several_laws.flat(end=0.05).model_dump(exclude_none=True)
    return Scene(**(told | {"output": told["output"] | {"diagnostics_interval": 0.004}}))


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole") / "run"
    bits.run(scene(), folder, 2)
    return folder


def stopped(folder, number, rank, ranks, step=40, options=()):
    """A run of which one rank gets a signal before some step."""
    (folder / "scene.toml").write_text(scene().to_toml(), encoding="utf-8")
    fields = bits.arguments_of({"output.fields": bits.all_fields(scene())})
    arguments = [DRIVER, rank, int(number), step, "run", "scene.toml", "--out", "run", "--quiet", *fields, *options]
    return launch.python(arguments, ranks, LIMIT, folder)


def continued(folder, ranks):
    done = launch.python(["-m", "pmpm", "run", "--restart", "run", "--quiet"], ranks, LIMIT, folder)
    assert done.status == 0, done.text
    return folder / "run"


@pytest.mark.parametrize(("number", "rank"), [(signal.SIGTERM, 1), (signal.SIGINT, 0), (signal.SIGUSR1, 2)])
def test_a_signal_to_any_rank_stops_all_with_a_checkpoint_and_status_3(number, rank, whole, tmp_path):
    done = stopped(tmp_path, number, rank, 3)
    assert done.status == 3, done.text
    assert f"pmpm: stopped on request ({number.name}) after step 4" in done.text
    assert done.text.count("pmpm:") == 1, done.text
    assert load(tmp_path / "run").status == f"stopped on request: {number.name}"
    assert len(manifests.numbers(tmp_path / "run" / "checkpoints")) == 1
    assert bits.differences(whole, continued(tmp_path, 2)) == []


def test_one_process_stops_likewise(whole, tmp_path):
    assert stopped(tmp_path, signal.SIGTERM, 0, None).status == 3
    assert bits.differences(whole, continued(tmp_path, 3)) == []


def test_sigusr2_writes_a_checkpoint_and_the_run_goes_on(whole, tmp_path):
    done = stopped(tmp_path, signal.SIGUSR2, 1, 2)
    assert done.status == 0, done.text
    (number,) = manifests.numbers(tmp_path / "run" / "checkpoints")
    assert 40 < manifests.read_manifest(tmp_path / "run" / "checkpoints" / f"{number:06d}.hdf")["step"] < 45
    assert bits.differences(whole, tmp_path / "run") == []


def test_a_second_interrupt_ends_at_once(tmp_path):
    """While the first one waits for a step that takes for ever."""
    (tmp_path / "scene.toml").write_text(scene().to_toml(), encoding="utf-8")
    script = (
        "import sys, time; from pmpm import cli; from pmpm.simulation import Simulation\n"
        "advance = Simulation.advance\n"
        "def slow(self, dt):\n"
        "    advance(self, dt)\n"
        "    if self.step_count == 3:\n"
        "        open('slow', 'w').close()\n"
        "        end = time.monotonic() + 100\n"
        "        while time.monotonic() < end: time.sleep(0.05)\n"
        "Simulation.advance = slow\n"
        "sys.exit(cli.main(['run', 'scene.toml', '--quiet']))"
    )
    environment = os.environ | {"PYTHONPATH": str(launch.ROOT)}
    process = subprocess.Popen([sys.executable, "-c", script], cwd=tmp_path, env=environment)
    began = time.monotonic()
    while not (tmp_path / "slow").exists() and time.monotonic() - began < LIMIT:
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    time.sleep(0.5)
    assert process.poll() is None
    process.send_signal(signal.SIGINT)
    assert process.wait(10) == -signal.SIGINT


@pytest.mark.parametrize("ranks", [None, 2])
def test_a_run_out_of_wall_time_stops_before_it_is_over(ranks, tmp_path):
    long = several_laws.flat(end=1000.0).to_toml()
    (tmp_path / "scene.toml").write_text(long, encoding="utf-8")
    arguments = ["-m", "pmpm", "run", "scene.toml", "--out", "run", "--quiet", "--walltime", "00:00:12"]
    done = launch.python(arguments, ranks, LIMIT, tmp_path)
    assert done.status == 3, done.text
    assert "stopped on request (out of wall time)" in done.text
    assert len(manifests.numbers(tmp_path / "run" / "checkpoints")) == 1


def test_the_same_command_begins_continues_and_at_last_has_nothing_to_do(whole, tmp_path):
    """What a job script that may be started again any number of times says."""
    same = [*bits.arguments_of({"output.fields": bits.all_fields(scene())}), "--restart", "run"]
    assert stopped(tmp_path, signal.SIGTERM, 0, 2, 30, same).status == 3
    assert stopped(tmp_path, signal.SIGTERM, 1, 2, 60, same).status == 3
    assert stopped(tmp_path, signal.SIGTERM, 0, 1, 10**6, same).status == 0
    assert bits.differences(whole, tmp_path / "run") == []
    done = stopped(tmp_path, signal.SIGTERM, 0, 2, 10**6, same)
    assert done.status == 0
    assert "has finished, nothing is left to do" in done.text
    assert bits.differences(whole, tmp_path / "run") == []


def test_a_run_that_stops_early_goes_on_without_gap_or_repeat(whole, tmp_path):
    """--until leaves a last snapshot and a last line, which belong to no interval: they go when the run goes on."""
    (tmp_path / "scene.toml").write_text(scene().to_toml(), encoding="utf-8")
    fields = bits.arguments_of({"output.fields": bits.all_fields(scene())})
    arguments = ["-m", "pmpm", "run", "scene.toml", "--out", "run", "--quiet", "--until", "0.013", *fields]
    assert launch.python(arguments, 2, LIMIT, tmp_path).status == 0
    held = load(tmp_path / "run")
    assert [round(s.time / 0.01, 1) for s in held.snapshots] == [0.0, 1.0, 1.3]
    assert bits.differences(whole, continued(tmp_path, 3)) == []


# ---- clocks ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "seconds"),
    [("01:30", 5400), ("00:00:20", 20), ("2-00:00:01", 172801), ("100:00", 360000), ("1-01:00", 90000)],
)
def test_wall_times_are_read_as_batch_systems_write_them(text, seconds):
    assert requests.seconds_of(text) == seconds


@pytest.mark.parametrize(
    "text", ["", "20", "1:2:3:4", "00:00", "-1:00", "01:60", "01:00:99", "1h", "00:00:00", "9" * 400]
)
def test_other_wall_times_are_refused(text):
    with pytest.raises(SceneError, match="--walltime .*: must be"):
        requests.seconds_of(text)


def test_the_end_of_a_slurm_job_is_read_from_its_environment(monkeypatch):
    monkeypatch.setenv("SLURM_JOB_ID", "7")
    monkeypatch.setenv("SLURM_JOB_END_TIME", "1700000000")
    assert requests.deadline_of(None, 0.0) == 1.7e9
    assert requests.deadline_of("none", 0.0) is None
    assert requests.deadline_of("00:01:00", 5.0) == 65.0


@pytest.mark.parametrize(
    ("text", "left"), [("1:00", 60), ("2:00:00", 7200), ("3-00:00:00", 259200), ("UNLIMITED", None), ("INVALID", None)]
)
def test_what_squeue_says_is_left_is_understood(text, left):
    assert requests.left_of_slurm(text, 100.0) == (None if left is None else 100.0 + left)


class Asked:
    """A simulation that only notes what it is asked for."""

    comm, nbytes = Alone(), 10**8

    def __init__(self):
        self.requests = []

    def ask(self, request):
        self.requests.append(request)


@pytest.fixture
def clock(monkeypatch):
    """A clock on the wall that stands still until it is set."""
    hands = {"now": 1000.0}
    monkeypatch.setattr(requests.clock, "monotonic", lambda: hands["now"])
    monkeypatch.setattr(requests.clock, "time", lambda: hands["now"])
    return hands


def test_a_run_stops_when_what_is_left_is_needed_for_the_last_steps_and_the_checkpoint(clock):
    """2 s, 6 steps of 1 s, and twice the second that 1e8 bytes take on a slow disk: 10 s before the end."""
    asked, looked = Asked(), requests.Requests(Alone(), deadline=1100.0)
    for now in range(1001, 1089):
        clock["now"] = float(now)
        looked(asked)
    assert asked.requests == []
    for now in (1090.0, 1091.0, 1092.0):
        clock["now"] = now
        looked(asked)
    assert asked.requests == [OUT_OF_TIME]


def test_checkpoints_by_the_wall_clock_count_from_the_last_one(clock):
    asked, looked = Asked(), requests.Requests(Alone(), interval=60.0)
    for now, wrote in ((1059.0, True), (1100.0, False), (1120.0, False), (1121.0, False)):
        clock["now"] = now
        looked(asked)
        if wrote:
            looked.wrote_checkpoint(1.0)
    assert asked.requests == [CHECKPOINT]


def test_a_signal_comes_before_a_checkpoint_and_is_passed_on_once(clock):
    asked, looked = Asked(), requests.Requests(Alone())
    looked.note(signal.SIGUSR2, None)
    looked.note(signal.SIGTERM, None)
    looked(asked)
    looked(asked)
    assert asked.requests == [SIGNALLED + signal.SIGTERM]


def test_signals_are_as_before_when_a_run_is_over():
    before = [signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT, signal.SIGUSR1, signal.SIGUSR2)]
    with requests.Requests(Alone()).listening():
        assert signal.getsignal(signal.SIGTERM) != before[0]
    after = [signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT, signal.SIGUSR1, signal.SIGUSR2)]
    assert after == before
