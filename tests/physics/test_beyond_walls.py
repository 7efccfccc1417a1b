"""What a wall has let through by less than half a cell keeps its place when particles are sorted."""

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
