"""The built-in flows meet theory once they are steady: as much leaves as comes in, as fast as it must."""

import numpy as np
import pytest

from pmpm.scene.schema import Scene
from pmpm.simulation import Simulation


def steady(name, cell_size, begin, end):
    """A built-in scene run to `end` (s), and the rates in 1/s of what `measure` tells, since `begin`."""
    simulation = Simulation(Scene.builtin(name, {"domain.cell_size": cell_size, "time.end": end}))
    simulation.run(until=begin)
    before, since = simulation.measure(), simulation.time
    simulation.run()
    after = simulation.measure()
    return simulation, {key: (after[key] - before[key]) / (simulation.time - since) for key in after}


def test_grains_slide_down_a_chute_as_savage_and_hutter_say():
    """v^2 = v0^2 + 2 g (sin 30 - 0.4 cos 30) x, in cells twice those of the scene: 2 % measured."""
    simulation, rates = steady("chute_flow", 0.01, 0.6, 0.9)
    assert rates["left_mass"] == pytest.approx(rates["emitted_mass"], rel=0.03)
    assert rates["emitted_mass"] == pytest.approx(2650.0 * 0.04 * 1.0, rel=0.02)
    x, v = simulation.particles.x[:, 0], simulation.particles.v[:, 0]
    for place in (0.1, 0.2, 0.3, 0.4, 0.5):
        near = abs(x - place) < 0.02
        assert v[near].mean() == pytest.approx(np.sqrt(1.0 + 2.0 * 1.507 * (place - 0.04)), rel=0.04), place


def test_a_jet_parts_in_halves_that_run_off_as_fast_as_it_came():
    """Bernoulli: 1.5 m/s; of five cells across the jet the plate takes 7 % of that."""
    simulation, rates = steady("jet", 0.004, 0.15, 0.2)
    assert abs(rates["left_momentum_x"]) < 1e-9 * rates["left_mass"]
    assert rates["left_mass"] == pytest.approx(rates["emitted_mass"], rel=0.15)
    x, v = simulation.particles.x, simulation.particles.v
    film = abs(x[:, 0] - 0.12) > 0.08
    assert abs(v[film, 0]).mean() == pytest.approx(1.5, rel=0.1)
    assert film.sum() * 0.004**2 / 4 / 0.08 == pytest.approx(0.01, rel=0.1)  # m, half of the jet
