"""`pmpm study` on several ranks: the errors of one rank; killed or stopped at any time it goes on and repeats nothing."""

import csv
import json
import signal
from pathlib import Path

import launch
import pytest

DRIVERS = Path(__file__).parent / "drivers"
LIMIT = 120
SCENE = """
title = "A block that falls onto the floor"
[domain]
size = [0.2, 0.1]
cell_size = 0.0125
gravity = [0.0, -10.0]
[time]
end = 0.02
step = 5e-4
[materials.rubber]
model = "neo_hookean"
density = 1000.0
youngs_modulus = 1e4
poisson_ratio = 0.3
[[bodies]]
material = "rubber"
shape = { type = "box", min = [0.05, 0.0], max = [0.15, 0.05] }
"""
# Runs 0 and 1 take 40 steps, 2 and 3 take 80, 4 and 5 take 160.
STUDY = ["study", "block.toml", "--levels", "3", "--transfer", "apic,mls", "--out", "study"]
PMPM = ["-m", "pmpm"]


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "block.toml").write_text(SCENE, encoding="utf-8")
    return tmp_path


def ended(folder):
    """{number: when it ended and all else that its row says} of the runs in a folder."""
    return {int(path.stem): json.loads(path.read_text()) for path in sorted((folder / "study" / "runs").glob("*.json"))}


def differences(folder):
    with open(folder / "study" / "study.csv", encoding="utf-8", newline="") as file:
        return [float(row["difference_displacement"] or "nan") for row in csv.DictReader(file)]


def test_two_ranks_find_the_differences_of_one(folder, tmp_path_factory):
    """To round-off: sums over the particles of a block are those of ranks."""
    done = launch.python([*PMPM, *STUDY], 2, LIMIT, folder)
    assert done.status == 0, done.text
    assert done.text.count("Most accuracy per second") + done.text.count("No error is known") == 1, done.text
    assert {row["ranks"] for row in ended(folder).values()} == {2}
    alone = tmp_path_factory.mktemp("alone")
    (alone / "block.toml").write_text(SCENE, encoding="utf-8")
    assert launch.python([*PMPM, *STUDY], None, LIMIT, alone).status == 0
    assert differences(folder) == pytest.approx(differences(alone), rel=1e-8, nan_ok=True)
    assert len([value for value in differences(folder) if value == value]) == 4


def test_a_killed_study_goes_on_with_the_run_in_which_a_rank_died(folder):
    """At the hundredth step of all: the twentieth of run 2."""
    arguments = [DRIVERS / "kill_one_rank.py", 1, "step", 100, 0.0, "--", *STUDY]
    assert launch.python(arguments, 2, LIMIT, folder).status not in (0, None)
    before = ended(folder)
    assert list(before) == [0, 1]
    done = launch.python([*PMPM, *STUDY], 2, LIMIT, folder)
    assert done.status == 0, done.text
    after = ended(folder)
    assert list(after) == list(range(6))
    assert {number: after[number] for number in before} == before
    assert "2 of them have ended before and are not repeated" in done.text


@pytest.mark.parametrize(("ranks", "rank"), [(None, 0), (2, 1)])
def test_an_interrupted_study_stops_with_status_3_and_goes_on(ranks, rank, folder):
    arguments = [DRIVERS / "signal_one_rank.py", rank, int(signal.SIGINT), 60, *STUDY]
    done = launch.python(arguments, ranks, LIMIT, folder)
    assert done.status == 3, done.text
    assert "pmpm: stopped on request (SIGINT): 2 of 6 runs have ended and are kept in" in done.text
    before = ended(folder)
    assert list(before) == [0, 1]
    assert launch.python([*PMPM, *STUDY], ranks, LIMIT, folder).status == 0
    assert {number: ended(folder)[number] for number in before} == before


def test_a_study_on_another_number_of_ranks_is_another_one(folder):
    """Its times would not compare."""
    assert launch.python([*PMPM, *STUDY, "--until", "0.001"], None, LIMIT, folder).status == 0
    done = launch.python([*PMPM, *STUDY, "--until", "0.001"], 2, LIMIT, folder)
    assert done.status == 2
    assert "holds another study (it was on 1 ranks, this is on 2)" in done.text
