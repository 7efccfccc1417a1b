"""What the scripts of long runs do with an exit status, tried with fake commands in the place of a batch system."""

import os
import signal
import subprocess
import time

import job
import pytest

# A run of `pmpm` that, if asked to, gets as far as step 7, and ends with a status; what it is asked to do stands in files.
MPIRUN = """\
printf '%s\\n' "$*" >> calls.mpirun
mkdir -p run/checkpoints
trap 'echo USR1 >> signals; asked=1' USR1
trap 'echo TERM >> signals' TERM
touch started
while [ -e wait ] && [ -z "${asked:-}" ]; do sleep 0.05; done
[ ! -e progress ] || printf '{\\n "step": 7,\\n "time": 0.5\\n}\\n' > run/checkpoints/000001.json
exit "$(cat status)"
"""
FAKES = {
    "mpirun": MPIRUN,
    "qsub": 'printf "%s\\n" "$*" >> calls.again',
    "scontrol": 'printf "%s\\n" "$*" >> calls.again',
    "squeue": "cat state",
}
SLURM = {"SLURM_JOB_ID": "17", "SLURM_NTASKS": "2"}
KINDS = ("slurm", "pbs")


class Batch:
    """One of the scripts in a folder of its own, with fakes around it."""

    def __init__(self, kind, folder, status, progress=True, state="RUNNING"):
        self.kind, self.folder = kind, folder
        bin_folder = folder / "bin"
        bin_folder.mkdir()
        for name, text in FAKES.items():
            job.write_script(bin_folder / name, text)
        (folder / "status").write_text(str(status))
        (folder / "state").write_text(state)
        (folder / "nodes").write_text("a\nb\n")
        if progress:
            (folder / "progress").touch()
        self.environment = job.environment(bin_folder) | {
            "PBS_O_WORKDIR": str(folder),
            "PBS_NODEFILE": str(folder / "nodes"),
            "SCENE": "scene.toml",
            "OUT": "run",
            "WALLTIME": "01:00:00",
            "SELECT": "1:ncpus=2:mpiprocs=2",
            "OPTIONS": "--set time.end=2",
            "SCRIPT": str(job.JOBS / "long_run.pbs"),
        }

    def start(self, **more):
        """The script, running."""
        if self.kind == "pbs":
            command = ["bash", job.JOBS / "long_run.pbs"]
        else:
            command = ["bash", job.JOBS / "long_run.sh", "scene.toml", "run", "--set", "time.end=2"]
        return subprocess.Popen(
            list(map(str, command)),
            cwd=self.folder,
            env=self.environment | (SLURM if self.kind == "slurm" else {}) | more,
            stdin=subprocess.DEVNULL,
            start_new_session=True,
        )

    def run(self, **more):
        return self.end_of(self.start(**more))

    def end_of(self, process):
        """The exit status; a script that does not end within 30 s is ended with all it has started."""
        try:
            return process.wait(timeout=30)
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()

    def again(self):
        """What was asked of the batch system, call by call."""
        path = self.folder / "calls.again"
        return path.read_text().splitlines() if path.exists() else []

    def started_and_sent(self, number):
        """The exit status of the script that was sent a signal when its run was under way."""
        (self.folder / "wait").touch()
        process = self.start()
        until = time.monotonic() + 20
        while not (self.folder / "started").exists() and time.monotonic() < until:
            time.sleep(0.05)
        process.send_signal(number)
        return self.end_of(process)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("status", [0, 1, 2, 137])
def test_a_run_that_ended_by_itself_is_not_queued_again(kind, status, tmp_path):
    batch = Batch(kind, tmp_path, status)
    assert (batch.run(), batch.again()) == (status, [])


def test_a_stopped_run_is_requeued_under_slurm(tmp_path):
    batch = Batch("slurm", tmp_path, 3)
    assert (batch.run(), batch.again()) == (3, ["requeue 17"])


def test_a_stopped_task_of_an_array_is_requeued_alone(tmp_path):
    batch = Batch("slurm", tmp_path, 3)
    batch.run(SLURM_ARRAY_JOB_ID="17", SLURM_ARRAY_TASK_ID="4")
    assert batch.again() == ["requeue 17_4"]


def test_a_run_that_slurm_has_stopped_is_left_to_slurm(tmp_path):
    """Cancelled, preempted or requeued: such a job is completing, not running."""
    batch = Batch("slurm", tmp_path, 3, state="COMPLETING")
    assert (batch.run(), batch.again()) == (3, [])


def test_a_stopped_run_submits_itself_again_under_pbs(tmp_path):
    batch = Batch("pbs", tmp_path, 3)
    assert batch.run() == 3
    (call,) = batch.again()
    script = job.JOBS / "long_run.pbs"
    told = f"SCENE=scene.toml,OUT=run,WALLTIME=01:00:00,SELECT=1:ncpus=2:mpiprocs=2,OPTIONS=--set time.end=2,SCRIPT={script}"
    assert call == f"-l select=1:ncpus=2:mpiprocs=2 -l walltime=01:00:00 -v {told} {script}"


@pytest.mark.parametrize("kind", KINDS)
def test_a_stretch_without_a_step_is_not_repeated(kind, tmp_path):
    batch = Batch(kind, tmp_path, 3, progress=False)
    assert (batch.run(), batch.again()) == (3, [])


@pytest.mark.parametrize("kind", KINDS)
def test_the_command_is_the_same_at_every_start(kind, tmp_path):
    batch = Batch(kind, tmp_path, 3)
    batch.run()
    batch.run()
    first, second = (tmp_path / "calls.mpirun").read_text().splitlines()
    assert first == second
    assert first.startswith("-n 2 pmpm run scene.toml --out run --restart run")
    assert "--set time.end=2" in first


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("number", [signal.SIGUSR1, signal.SIGTERM])
def test_a_signal_is_handed_on_and_the_status_of_the_run_is_waited_for(kind, number, tmp_path):
    """As SIGUSR1, whatever it was: of both, srun and mpirun hand on only that one."""
    batch = Batch(kind, tmp_path, 3)
    assert batch.started_and_sent(number) == 3
    assert (tmp_path / "signals").read_text() == "USR1\n"


@pytest.mark.parametrize("kind", KINDS)
def test_a_run_that_the_signal_has_killed_when_it_did_not_listen_is_queued_again(kind, tmp_path):
    batch = Batch(kind, tmp_path, 128 + signal.SIGUSR1)
    batch.started_and_sent(signal.SIGUSR1)
    assert len(batch.again()) == 1


def test_a_run_that_pbs_has_stopped_is_not_submitted_again(tmp_path):
    batch = Batch("pbs", tmp_path, 3)
    batch.started_and_sent(signal.SIGTERM)
    assert batch.again() == []


def test_pbs_leaves_pmpm_a_tenth_of_a_short_wall_time_less(tmp_path):
    Batch("pbs", tmp_path, 0).run(WALLTIME="00:10:00")
    assert " --walltime 0:09:00 " in (tmp_path / "calls.mpirun").read_text()
