"""The main job against experiment: gates and their sources stand in benchmarks/dam_break.py, which runs the finer pair."""

import math

import dam_break
import numpy as np
import pytest

import pmpm


def front_history(cells, **changes):
    """(T*, Z) of a dam break with `cells` cells per column width."""
    simulation = pmpm.Simulation(pmpm.Scene.builtin("dam_break", {"domain.cell_size": dam_break.A / cells, **changes}))
    times, fronts = [], []

    def note(simulation):
        times.append(simulation.time * math.sqrt(2.0 * dam_break.GRAVITY / dam_break.A))
        fronts.append(np.quantile(simulation.particles.x[:, 0], 0.995) / dam_break.A)

    simulation.every(note, seconds=0.002)
    simulation.run()
    return np.array(times), np.array(fronts)


@pytest.fixture(scope="module")
def coarse():
    return front_history(10)


def test_the_front_follows_martin_and_moyce(coarse):
    assert dam_break.complaints(coarse, front_history(20)) == []


def test_a_floor_that_sticks_fails_the_gate(coarse):
    assert dam_break.complaints(coarse, front_history(10, **{"domain.walls": {"y_min": "stick"}}))
