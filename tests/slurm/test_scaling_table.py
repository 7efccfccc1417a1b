"""Scaling of a scene on different numbers of ranks, and the table of runs from their run.json."""

import json

import launch
import pytest
import several_laws

SCALING = launch.ROOT / "benchmarks" / "scaling.py"


def table_of(*folders):
    return launch.python([SCALING, "table", *folders])


def rows(text):
    """Cells of the lines below the head."""
    return [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines()[2:]]


@pytest.fixture
def record(tmp_path):
    """Writes a run.json of so many ranks, particles, steps and seconds."""

    def write(ranks, particles, steps, seconds):
        folder = tmp_path / str(ranks)
        folder.mkdir()
        phases = {"halo": {"min": 0.0, "mean": seconds / 4, "max": seconds}}
        stretch = {"steps": steps, "seconds": seconds}
        report = {"ranks": ranks, "particles": particles, "stretch": stretch, "seconds_per_phase": phases}
        (folder / "run.json").write_text(json.dumps({"status": "finished", "hosts": {"a": ranks}, "report": report}))
        return folder

    return write


def test_a_run_in_a_fifth_of_the_time_on_eight_ranks_is_62_percent_efficient(record):
    (eight, one) = record(8, 1000, 100, 2.0), record(1, 1000, 100, 10.0)
    assert [row[7] for row in rows(table_of(eight, one).text)] == ["100.0%", "62.5%"]


def test_twice_the_particles_in_the_same_time_on_two_ranks_are_fully_efficient(record):
    (one, two) = record(1, 1000, 100, 10.0), record(2, 2000, 100, 10.0)
    assert [row[7] for row in rows(table_of(one, two).text)] == ["100.0%", "100.0%"]


def test_rates_are_particle_steps_per_second(record):
    """3 million particles, 100 steps, 6 s."""
    assert rows(table_of(record(2, 3_000_000, 100, 6.0)).text)[0][6] == "50"


def test_a_run_that_did_not_end_is_named(tmp_path):
    (tmp_path / "run.json").write_text(json.dumps({"status": "running"}))
    done = table_of(tmp_path)
    assert (done.status, done.text) == (
        1,
        f"scaling: {tmp_path}/run.json: the run is running and tells of no steps\n",
    )


def test_steps_before_a_restart_do_not_count(tmp_path):
    scene = tmp_path / "drop.toml"
    scene.write_text(several_laws.short().to_toml(), encoding="utf-8")
    run = ["-m", "pmpm", "run", scene, "--out", tmp_path / "run", "--restart", tmp_path / "run", "--steps"]
    for steps in (10, 4):
        done = launch.python([*run, steps], folder=tmp_path)
        assert done.status == 0, done.text
    assert rows(table_of(tmp_path / "run").text)[0][4] == "4"


def test_strong_scaling_takes_turns_and_leaves_table_and_csv(tmp_path):
    scene, out = tmp_path / "drop.toml", tmp_path / "scaling"
    scene.write_text(several_laws.short().to_toml(), encoding="utf-8")
    done = launch.python([SCALING, "strong", scene, "--ranks", "1,2", "--steps", 5, "--rounds", 2, "--out", out])
    assert done.status == 0, done.text
    told = [line.split(",")[:2] for line in done.text.splitlines() if "] round " in line]
    assert [[round_.split("] ")[1], ranks.split(":")[0]] for round_, ranks in told] == [
        ["round 1 of 2", " 1 ranks"], ["round 1 of 2", " 2 ranks"], ["round 2 of 2", " 1 ranks"], ["round 2 of 2", " 2 ranks"],
    ]  # fmt: skip
    assert [row[:2] for row in rows((out / "table.md").read_text())] == [["1", "1"], ["2", "2"]]
    assert len((out / "runs.csv").read_text().splitlines()) == 1 + 4


def test_a_run_that_fails_is_told_with_its_last_words(tmp_path):
    scene = tmp_path / "drop.toml"
    scene.write_text(several_laws.short().to_toml(), encoding="utf-8")
    (tmp_path / "scaling").write_text("no folder")
    done = launch.python([SCALING, "strong", scene, "--ranks", "1", "--quick", "--out", tmp_path / "scaling"])
    assert done.status == 1
    assert "FAILED: 1 ranks ended with status 2: pmpm: " in done.text
