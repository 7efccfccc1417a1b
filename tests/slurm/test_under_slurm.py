"""The scripts in jobs/ under a real Slurm of one node: interrupted and going on, scaling, and a study."""

import json
import time

import bits
import job
import one_node
import pytest
import several_laws

from pmpm.output import manifests
from pmpm.scene.schema import Scene

RANKS = 2
SOON = 90  # s, for what takes some seconds on a machine with nothing else to do


@pytest.fixture(scope="module")
def slurm(tmp_path_factory):
    missing = one_node.missing()
    if missing:
        pytest.skip(f"no Slurm to start on this machine: {', '.join(missing)} not found (Debian: slurm-wlm, munge)")
    with one_node.one_node_slurm(tmp_path_factory.mktemp("slurm"), cores=RANKS) as running:
        yield running


@pytest.fixture(scope="module")
def scene_file(tmp_path_factory):
    """A scene that takes some seconds, with material moving across every cut."""
    path = tmp_path_factory.mktemp("scene") / "several_laws.toml"
    scene = several_laws.flat(end=1.2)
    output = scene.output.model_copy(update={"fields": tuple(bits.all_fields(scene))})
    path.write_text(scene.model_copy(update={"output": output}).to_toml(), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def undisturbed(scene_file, tmp_path_factory):
    out = tmp_path_factory.mktemp("undisturbed") / "run"
    bits.run(Scene.from_toml(scene_file), out, 1)
    return out


class Jobs:
    """Submits scripts of jobs/ from the folder of a test."""

    def __init__(self, slurm, folder):
        self.slurm, self.folder = slurm, folder
        self.environment = job.environment(job.commands(folder))

    def submit(self, script, *arguments, options=(), **environment):
        where = {"SCALING": job.JOBS.parent / "benchmarks" / "scaling.py", "LONG_RUN": job.JOBS / "long_run.sh"}
        where |= {"SCENE": job.JOBS / "weak_scaling.toml"} if script == "weak_scaling.sh" else {}
        surroundings = self.environment | {name: str(path) for name, path in where.items()} | environment
        options = [f"--ntasks={RANKS}", f"--output={self.folder}/log", *options]
        return self.slurm.submit(*options, job.JOBS / script, *arguments, cwd=self.folder, **surroundings)

    def log(self):
        return (self.folder / "log").read_text(errors="replace")

    def wait_for_steps(self, out):
        """Until the run has written its second snapshot and so is well under way."""
        until = time.monotonic() + SOON
        while not (out / "snapshots" / "000001.hdf").exists():
            assert time.monotonic() < until, self.log()
            time.sleep(0.05)


@pytest.fixture
def jobs(slurm, tmp_path):
    return Jobs(slurm, tmp_path)


def requeue(slurm, number):
    slurm.call("scontrol", "requeue", number)


def ask_the_script(slurm, number):
    """As Slurm does by itself before the time is up, for `--signal=B:USR1`."""
    slurm.call("scancel", "--signal=USR1", "--batch", number)


def ask_the_ranks(slurm, number):
    slurm.call("scancel", "--signal=TERM", number)


def preempt(slurm, number):
    """In a partition that leaves time to stop: a job that uses it has ended by itself, and Slurm does not requeue it."""
    slurm.submit("--partition=high", f"--ntasks={RANKS}", "--output=/dev/null", "--wrap=true")


INTERRUPTIONS = [(requeue, "low"), (ask_the_script, "low"), (ask_the_ranks, "low"), (preempt, "patient")]


@pytest.mark.parametrize(("interrupt", "partition"), INTERRUPTIONS)
def test_a_long_run_that_is_interrupted_goes_on_by_itself_bit_for_bit(
    interrupt, partition, jobs, scene_file, undisturbed, tmp_path
):
    out = tmp_path / "run"
    number = jobs.submit("long_run.sh", scene_file, out, options=[f"--partition={partition}"])
    jobs.wait_for_steps(out)
    interrupt(jobs.slurm, number)
    ended = jobs.slurm.ended(number, SOON)
    assert (ended.state, ended.status, ended.restarts) == ("COMPLETED", 0, 1), jobs.log()
    assert [start["step"] > 0 for start in json.loads((out / "run.json").read_text())["restarts"]] == [True]
    assert bits.differences(out, undisturbed) == []


@pytest.mark.parametrize("launcher", ["mpirun", "srun --mpi=pmi2"])
def test_a_cancelled_long_run_leaves_a_checkpoint_and_status_3_and_stays_ended(launcher, jobs, scene_file, tmp_path):
    out = tmp_path / "run"
    number = jobs.submit("long_run.sh", scene_file, out, LAUNCH=f"{launcher} -n {RANKS}")
    jobs.wait_for_steps(out)
    jobs.slurm.call("scancel", number)
    ended = jobs.slurm.ended(number, SOON)
    assert (ended.state, ended.status, ended.restarts) == ("CANCELLED", 3, 0), jobs.log()
    assert manifests.numbers(out / "checkpoints") != [], jobs.log()


@pytest.mark.parametrize("script", ["strong_scaling.sh", "weak_scaling.sh"])
def test_scaling_runs_on_1_and_2_ranks_and_gives_a_table(script, jobs, scene_file, tmp_path):
    out = tmp_path / "scaling"
    coarse = ["--set", "domain.cell_size=0.04"]
    arguments = [scene_file, out] if script == "strong_scaling.sh" else [out, *coarse]
    ended = jobs.slurm.ended(jobs.submit(script, *arguments, STEPS="20", ROUNDS="1"), SOON)
    assert ended.status == 0, jobs.log()
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in (out / "table.md").read_text().splitlines()]
    particles = [int(row[3]) for row in rows[2:]]
    assert [row[:3] + row[4:5] for row in rows[2:]] == [["1", "1", "1", "20"], ["2", "2", "1", "20"]]
    assert particles[1] == particles[0] * (2 if script == "weak_scaling.sh" else 1)
    assert rows[2][7] == "100.0%"


def test_a_study_runs_every_line_of_its_list(jobs, tmp_path):
    study = tmp_path / "list"
    study.write_text("# two ends and a slope\n\ntime.end=0.002\ntime.end=0.001 domain.gravity=[1.0,-9.81]\n")
    scene = tmp_path / "short.toml"
    scene.write_text(several_laws.short().to_toml(), encoding="utf-8")
    out = tmp_path / "study"
    number = jobs.submit("parameter_study.sh", scene, out, study, options=["--array=1-2"])
    ended = [jobs.slurm.ended(f"{number}_{task}", SOON).status for task in (1, 2)]
    scenes = [Scene.from_toml(out / task / "scene.toml") for task in ("1", "2")]
    assert ended == [0, 0], jobs.log()
    assert [(scene.time.end, scene.domain.gravity[0]) for scene in scenes] == [(0.002, 0.0), (0.001, 1.0)]


def test_a_task_beyond_the_list_of_a_study_is_refused(jobs, tmp_path):
    study = tmp_path / "list"
    study.write_text("time.end=0.001\n")
    number = jobs.submit("parameter_study.sh", "dam_break", tmp_path / "study", study, options=["--array=2"])
    assert jobs.slurm.ended(f"{number}_2", SOON).status == 2
    assert "has no line 2: --array=1-1" in jobs.log()
