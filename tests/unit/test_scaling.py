"""benchmarks/scaling.py: how ranks are started, what is read from run.json, and what wrong arguments are told."""

import pytest
import scaling
import scaling_pairs
import scaling_runs
import scaling_tables
from scaling_runs import Run, RunError
from scaling_tables import Row

from pmpm.scene.errors import SceneError
from pmpm.scene.schema import Scene

WRONG = [
    (["strong"], "SCENE"),
    (["strong", "dam_brake"], "did you mean dam_break"),
    (["strong", "dam_break", "--ranks", "0"], "at least 1 rank"),
    (["strong", "dam_break", "--ranks", "one"], "'one' is not a list of numbers"),
    (["strong", "dam_break", "--ranks", "1,41"], "--ranks 41: 201 layers of cells have room for 40 ranks"),
    (["strong", "dam_break", "--steps", "0"], "'0' is not a whole number"),
    (["strong", "dam_break", "--threads", "none"], "'none' is not a whole number"),
    (["strong", "dam_break", "--ranks", "1", "--set", "time.ent=1"], "did you mean end"),
    (["strong", "dam_break", "--ranks", "1", "--quick", "--docs", "docs"], "not --quick"),
    (["weak", "dam_break", "--length", "-1"], "'-1' is not a positive number"),
    (["weak", "colliding_disks", "--ranks", "1"], "bodies.0 is a sphere"),
    (["frobnicate"], "'frobnicate'"),
]


@pytest.mark.parametrize(("arguments", "fragment"), WRONG)
def test_wrong_arguments_end_with_status_2_and_one_line(arguments, fragment, capsys):
    try:
        status = scaling.main(arguments)
    except SystemExit as end:
        status = end.code
    error = capsys.readouterr().err
    assert (status, error.count("\n"), error.startswith("scaling: ")) == (2, 1, True)
    assert fragment in error


# ---- starting ranks --------------------------------------------------------------------------------------------------------


@pytest.fixture
def four_cores(monkeypatch):
    """A machine of four cores, with taskset and an mpirun, outside any batch system."""
    for name in ("LAUNCH", "SLURM_JOB_ID", "SLURM_JOB_NUM_NODES", "PBS_NODEFILE"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(scaling_runs, "cores", lambda: [0, 2, 1, 3])
    monkeypatch.setattr(scaling_runs.shutil, "which", lambda name: f"/bin/{name}")
    monkeypatch.setattr(scaling_runs.sys, "executable", "/nowhere/python")


@pytest.mark.usefixtures("four_cores")
def test_each_rank_has_cores_of_its_own():
    words = scaling_runs.start_words(["run"], ranks=2, threads=2)
    assert " ".join(words) == "/bin/mpirun -n 1 taskset -c 0,2 run : -n 1 taskset -c 1,3 run"


@pytest.mark.usefixtures("four_cores")
def test_more_ranks_than_cores_are_not_pinned():
    assert scaling_runs.start_words(["run"], ranks=5) == ["/bin/mpirun", "-n", "5", "run"]


@pytest.mark.usefixtures("four_cores")
def test_a_launcher_that_is_named_places_ranks_itself(monkeypatch):
    monkeypatch.setenv("LAUNCH", "srun --mpi=pmix")
    assert scaling_runs.start_words(["run"], ranks=2) == ["srun", "--mpi=pmix", "-n", "2", "run"]


@pytest.mark.usefixtures("four_cores")
def test_in_a_slurm_job_without_an_mpirun_of_its_own_python_starts_srun(monkeypatch):
    monkeypatch.setenv("SLURM_JOB_ID", "17")
    assert scaling_runs.start_words(["run"], ranks=2) == ["srun", "--exact", "--cpu-bind=cores", "-n", "2", "run"]


@pytest.mark.usefixtures("four_cores")
def test_without_a_launcher_that_is_said(monkeypatch):
    monkeypatch.setattr(scaling_runs.shutil, "which", lambda name: None)
    with pytest.raises(RunError, match=r"no mpirun .*pmpm\[mpi\]"):
        scaling_runs.start_words(["run"], ranks=2)


def test_hardware_threads_are_listed_in_ranges():
    assert scaling_runs.numbers("0-2,64") == [0, 1, 2, 64]


# ---- scenes ----------------------------------------------------------------------------------------------------------------


def test_a_weak_scene_grows_along_the_slab_axis_with_its_boxes():
    settings = scaling.stretched(Scene.builtin("dam_break"), 3.0)
    assert settings == [
        "parallel.slab_axis=x",
        "domain.size=[0.85725, 0.085725]",
        "bodies.0.shape.min=[0.0, 0.0]",
        "bodies.0.shape.max=[0.085725, 0.05715]",
    ]


def test_what_does_not_grow_with_the_domain_is_refused():
    scene = Scene.builtin("dam_break")
    scene = scene.model_copy(update={"loads": ("one",)})
    with pytest.raises(SceneError, match="loads do not grow"):
        scaling.stretched(scene, 2.0)


# ---- reading and tables ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("phase", "kind"),
    [
        ("compile", None),
        ("p2g", "compute"),
        ("p2g before", "compute"),
        ("g2p", "compute"),
        ("regroup", "regroup"),
        ("halo", "communication"),
        ("halo post", "communication"),
        ("halo wait", "waiting"),
    ],
)
def test_every_phase_has_a_kind(phase, kind):
    assert scaling_runs.kind_of(phase) == kind


def test_shares_are_means_over_ranks_without_compiling():
    phases = {"compile": {"mean": 9.0}, "p2g": {"mean": 2.0}, "g2p": {"mean": 1.0}, "halo": {"mean": 0.5}}
    assert scaling_runs.shares(phases, 4.0) == {"compute": 0.75, "communication": 0.125, "waiting": 0.0, "regroup": 0.0}


def test_messages_of_all_ranks_count_per_step():
    halo = [{"messages": 10, "bytes": 4000}, {"messages": 20, "bytes": 6000}]
    assert scaling_runs.sent_per_step(halo, 10) == (3.0, 1000.0)


def run_of(ranks, seconds, **facts):
    told = {"name": str(ranks), "ranks": ranks, "threads": 1, "hosts": 1, "particles": 1000, "steps": 10}
    shares = dict.fromkeys(scaling_runs.KINDS, 0.0)
    return Run(seconds=seconds, shares=shares, imbalance=1.0, halo=None, theory=None, **(told | facts))


def test_efficiency_is_against_the_best_run_on_one_rank():
    one, two = Row("1", [run_of(1, 2.0), run_of(1, 1.0)]), Row("2", [run_of(2, 1.0), run_of(2, 1.0)])
    cells = scaling_tables.cells(two, one)
    assert cells[7:9] == ["50.0%", "0.500 / 0.750 / 1.000"]


def test_threads_count_as_cores():
    one, two = Row("1", [run_of(1, 1.0)]), Row("1 rank, 4 threads", [run_of(1, 0.5, threads=4)])
    assert scaling_tables.cells(two, one)[7] == "50.0%"


def test_a_run_that_failed_stays_in_the_table():
    table = scaling_tables.table([Row("1", [run_of(1, 1.0)]), Row("2", [], "2 ranks ended with status 1: pmpm: nan")])
    assert any("2 ranks ended with status 1: pmpm: nan" in line for line in table)


@pytest.mark.parametrize(("ranks", "threads", "holds"), [(1.90, 1.72, True), (1.89, 1.72, False), (1.90, 1.70, False)])
def test_two_ranks_must_reach_95_percent_of_two_processes_and_two_threads_90_percent_of_that(ranks, threads, holds):
    found = dict(zip(scaling_pairs.NAMES, ([1e6], [2e6], [ranks * 1e6], [threads * 1e6]), strict=True))
    assert scaling_pairs.row("W1", found)[1] is holds
