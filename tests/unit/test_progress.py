"""Progress says the first and the last, something every few seconds between, and costs nothing in most steps."""

import io
import time
from types import SimpleNamespace

import pytest
from fake_simulation import FakeSimulation, fake_scene

from pmpm.output.progress import Progress, duration
from pmpm.output.run_directory import RunDirectory
from pmpm.parallel.comm import Alone


class Clock:
    """Wall clock of a test: moves only when told."""

    now = 100.0

    def __call__(self):
        return self.now


class Terminal(io.StringIO):
    def isatty(self):
        return True


class SecondRank(Alone):
    rank, size = 1, 2


def run(steps, seconds_per_step, stream, end=1.0, comm=None, **options):
    """Take `steps` steps of end/steps simulated seconds."""
    clock = Clock()
    simulation = FakeSimulation(fake_scene(), comm)
    simulation.time, simulation.step_count = 0.0, 0
    progress = Progress(end, simulation.comm, stream=stream, clock=clock, **options)
    progress(simulation)
    for step in range(steps):
        clock.now += seconds_per_step
        simulation.advance(end / steps)
        simulation.time = end * (step + 1) / steps
        progress(simulation)
    return progress, simulation


def test_the_first_and_the_last_are_always_said():
    stream = io.StringIO()
    run(10, 0.01, stream)
    first, last = stream.getvalue().splitlines()
    assert first.startswith("t = 0 of 1 s (0 %), step 0")
    assert last.startswith("t = 1 of 1 s (100 %), step 10")


def test_between_them_a_line_comes_every_five_seconds():
    stream = io.StringIO()
    run(21, 1.0, stream)
    steps = [line.split("step ")[1].split(",")[0] for line in stream.getvalue().splitlines()]
    assert steps == ["0", "5", "10", "15", "20", "21"]


def test_a_line_tells_speed_and_time_left():
    stream = io.StringIO()
    run(20, 1.0, stream)
    line = stream.getvalue().splitlines()[1]
    assert line.endswith("dt 3.33e-06 s, 1 steps/s, 40 particle-steps/s, 15 s left")


def test_a_line_tells_the_speed_since_the_line_before():
    stream = io.StringIO()
    progress, simulation = run(0, 1.0, stream, end=1000.0)
    for seconds_per_step in (5.0, 0.5):
        for _ in range(round(5.0 / seconds_per_step)):
            progress.clock.now += seconds_per_step
            simulation.advance()
            progress(simulation)
    assert [line.split(", ")[3] for line in stream.getvalue().splitlines()[1:]] == ["0.2 steps/s", "2 steps/s"]


def test_the_last_line_gives_the_averages_of_the_whole_run():
    stream = io.StringIO()
    run(21, 0.5, stream)
    assert stream.getvalue().splitlines()[-1].endswith("2 steps/s, 80 particle-steps/s, took 10 s")


def test_a_run_that_stops_early_says_its_last_line_once():
    stream = io.StringIO()
    progress, simulation = run(10, 0.01, stream, end=1.0)
    progress.finish(simulation)
    assert stream.getvalue().count("took") == 1
    stream = io.StringIO()
    progress = Progress(99.0, simulation.comm, stream=stream)
    progress(simulation)
    progress.finish(simulation)
    progress.finish(simulation)
    assert stream.getvalue().count("took") == 1


def test_quiet_says_nothing_on_the_screen_but_all_in_the_log(tmp_path):
    stream = Terminal()
    directory = RunDirectory.create(tmp_path, "", Alone())
    progress, _ = run(10, 1.0, stream, directory=directory, quiet=True)
    progress.stage("writing ...")
    assert stream.getvalue() == ""
    assert (tmp_path / "log.txt").read_text().count("\n") == 4


def test_other_ranks_are_silent():
    stream = Terminal()
    progress, simulation = run(10, 6.0, stream, comm=SecondRank())
    progress.stage("compiling kernels ...")
    progress.finish(simulation)
    assert stream.getvalue() == ""


def test_a_stage_is_said_before_the_first_step():
    stream = io.StringIO()
    Progress(1.0, Alone(), stream=stream).stage("compiling kernels ...")
    assert stream.getvalue() == "compiling kernels ...\n"


def test_a_terminal_gets_one_live_bar():
    stream = Terminal()
    progress, simulation = run(10, 1.0, stream)
    assert stream.getvalue().count("\n") == 1
    assert "100 %|" in stream.getvalue().split("\r")[-1]


def test_a_stage_does_not_break_the_bar():
    stream = Terminal()
    progress = Progress(1.0, Alone(), stream=stream)
    progress(FakeSimulation(fake_scene()))
    progress.stage("balancing ...")
    assert "\rbalancing ...\n" in stream.getvalue()


def test_a_bar_is_logged_like_lines(tmp_path):
    directory = RunDirectory.create(tmp_path, "", Alone())
    run(10, 1.0, Terminal(), directory=directory)
    assert [line.split("step ")[1].split(",")[0] for line in (tmp_path / "log.txt").read_text().splitlines()] == [
        "0",
        "5",
        "10",
    ]


@pytest.mark.parametrize("stream", [io.StringIO(), Terminal()])
def test_a_step_in_which_nothing_is_due_costs_about_a_microsecond(stream):
    progress = Progress(1.0, Alone(), stream=stream, interval=1000.0)
    simulation = SimpleNamespace(time=0.0, step_count=0, dt=1.0, rows=lambda: 1)
    progress(simulation)
    times = []
    for _ in range(20):
        began = time.perf_counter()
        for _ in range(1000):
            progress(simulation)
        times.append((time.perf_counter() - began) / 1000)
    # Measured at 0.2 us; a shared machine gets room.
    assert min(times) < 2e-6


@pytest.mark.parametrize(
    ("seconds", "said"),
    [(0.4, "0 s"), (59.6, "1 min 0 s"), (125, "2 min 5 s"), (7260, "2 h 1 min"), (90000, "1 d 1 h")],
)
def test_durations_are_said_in_two_units(seconds, said):
    assert duration(seconds) == said
