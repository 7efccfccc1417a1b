"""Places at the ends of the domain: a little beyond walls, and around periodic axes."""

import numpy as np
import pytest

import pmpm

DX = 0.1


@pytest.mark.parametrize("shape", ["quadratic", "cubic"])
@pytest.mark.parametrize("end", [0, 1])
def test_a_regroup_keeps_particles_a_little_beyond_the_ends_of_the_domain(shape, end):
    """The slab axis is the one whose homes count layers: a home beyond them would be nobody's."""
    size = [1.2, 0.8]
    simulation = pmpm.Simulation(
        pmpm.Scene(
            domain={"size": size, "cell_size": DX},
            method={"shape_function": shape},
            time={"end": 1.0},
            materials={"water": {"model": "fluid", "density": 1000.0, "sound_speed": 10.0}},
            bodies=[{"material": "water", "shape": {"type": "box", "min": [0.0, 0.0], "max": size}}],
        )
    )
    before = simulation.particles.x
    ids = simulation.particles.id
    population, places = simulation.populations[0], simulation.needs.places
    shift = places.from_cells(0.7) * (1 if end else -1)  # the outermost lie a quarter of a cell inside
    population.places[:, :2] += shift
    moved = simulation.particles.x
    assert np.abs(moved - before - (0.7 if end else -0.7) * DX).max() < 1e-14
    simulation.regroup()
    order, as_before = np.argsort(simulation.particles.id), np.argsort(ids)
    assert (simulation.particles.x[order] == moved[as_before]).all()
    simulation.scatter(0, simulation.last_layer - simulation.first_layer, 0.0)
    assert simulation.patch.nodes[..., 3].sum() == pytest.approx(simulation.measure()["mass"], rel=1e-12)


def water(size, low, high, periodic, precision="float64", velocity=(0.0, 0.0)):
    return pmpm.Simulation(
        pmpm.Scene(
            domain={"size": size, "cell_size": DX, "periodic": periodic},
            method={"precision": precision},
            time={"end": 1.0},
            materials={"water": {"model": "fluid", "density": 1000.0, "sound_speed": 10.0}},
            bodies=[
                {
                    "material": "water",
                    "shape": {"type": "box", "min": low, "max": high},
                    "velocity": velocity,
                    "particles_per_cell": 1,
                }
            ],
        )
    )


@pytest.mark.parametrize("far", [0.0, 1.0, -3.0, 1000.0], ids=["inside", "next", "before", "far"])
def test_assigned_positions_are_taken_around_periodic_axes(far):
    """Also those in the last half cell, whose nearest node is the first one again."""
    size = np.array([2.0, 1.0])
    simulation = water(size.tolist(), [0.0, 0.0], size.tolist(), ["x", "y"])
    ids, x = simulation.particles.id, (simulation.particles.x + [0.48 * DX, 0.48 * DX]) % size
    simulation.particles.x = x + far * size
    assert simulation.rows() == 200
    order, before = np.argsort(simulation.particles.id), np.argsort(ids)
    apart = (simulation.particles.x[order] - x[before]) / size
    assert np.abs(apart - np.rint(apart)).max() < 1e-12 * (1.0 + abs(far))
    simulation.step()
    assert simulation.measure()["mass"] == pytest.approx(1000.0 * size.prod(), rel=1e-12)


@pytest.mark.parametrize("loops", ["lanes", "scalar"])
def test_a_wide_periodic_axis_is_no_reason_to_sort(loops, monkeypatch):
    """In float32 places 220 cells apart have no difference that fits into their integers."""
    monkeypatch.setenv("PMPM_LOOPS", loops)
    simulation = water([20.0, 19.9], [1.0, 1.0], [1.4, 18.9], ["y"], "float32", velocity=(0.0, 0.01))
    for _ in range(15):
        simulation.step()
    assert simulation.regroups == 0
