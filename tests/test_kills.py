"""A rank that is killed at any moment, also in the middle of a write, costs what came after the last checkpoint, and no bit.

tests/by_hand/kills_all.py does fifty of these; docs/results/reliability.md has the table.
"""

import kills
import pytest

COUNT = 10


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return kills.undisturbed(tmp_path_factory.mktemp("whole"))


def named(kill):
    return f"rank {kill.rank}, {kill.moment} at {kill.when:.2f}, again on {kill.again_on}"


@pytest.mark.parametrize("kill", kills.kills(COUNT), ids=named)
def test_a_killed_run_goes_on_to_the_bits_of_one_that_was_not(kill, whole, tmp_path):
    _, differences = kills.attempt(kill, whole, tmp_path / "killed")
    assert differences == []


def test_the_fifty_kills_are_of_all_kinds():
    """At least 15 of them between the first and the last byte of a write, on any rank, and restarts on 1 to 4 ranks."""
    all_kills = kills.kills(50)
    assert sum(kill.moment == "write" for kill in all_kills) >= 15
    assert {kill.moment for kill in all_kills} == {"write", "step", "outside", "rename"}
    assert {kill.rank for kill in all_kills} == {0, 1, 2}
    assert {kill.again_on for kill in all_kills} == {1, 2, 3, 4}
