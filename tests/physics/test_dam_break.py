"""The main job against experiment: gates and their sources stand in benchmarks/dam_break.py, which runs the finer pair."""

import dam_break
import pytest
from cases.dam_break import front_history


@pytest.fixture(scope="module")
def coarse():
    return front_history(10)[0]


def test_the_front_follows_martin_and_moyce(coarse):
    assert dam_break.complaints(coarse, front_history(20)[0]) == []


def test_a_floor_that_sticks_fails_the_gate(coarse):
    assert dam_break.complaints(coarse, front_history(10, **{"domain.walls": {"y_min": "stick"}})[0])
