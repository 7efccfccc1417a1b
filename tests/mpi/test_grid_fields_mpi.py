"""Fields on nodes are the same bits on any number of ranks, with any cuts, whichever axis is cut and repeats."""

import numpy as np
import pytest
from mpi4py import MPI

from pmpm.grid_fields import of_nodes
from pmpm.parallel.comm import World
from pmpm.scene.schema import Scene
from pmpm.simulation import Simulation

pytestmark = pytest.mark.mpi(min_size=2)

COMM = World(MPI.COMM_WORLD)
RUBBER = {"model": "neo_hookean", "density": 1000.0, "youngs_modulus": 1e4, "poisson_ratio": 0.3}
WATER = {"model": "fluid", "density": 1000.0, "sound_speed": 10.0}


def scene(dim, slab_axis, periodic, walls):
    """Water, in 2-D with rubber in it that flies; across the seam and every cut there is some of both."""
    cells = [6] * dim
    cells["xyz".index(slab_axis)] = 18
    size = [0.05 * n for n in cells]
    water = {"material": "water", "shape": {"type": "box", "min": [0.0] * dim, "max": size}, "seeding": "jittered"}
    inside = {"type": "box", "min": [0.1] * dim, "max": [s - 0.06 for s in size]}
    rubber = {"material": "rubber", "shape": inside, "velocity": [1.0, 0.5, 0.3][:dim]}
    return Scene(
        domain={"size": size, "cell_size": 0.05, "gravity": [0.0, -9.81, 0.0][:dim], "periodic": periodic} | walls,
        time={"end": 0.3},
        materials={"rubber": RUBBER, "water": WATER},
        bodies=[water, rubber] if dim == 2 else [water],
        parallel={"slab_axis": slab_axis},
    )


def whole(simulation, names):
    """Every field on all nodes, as the file would hold it."""
    own = of_nodes(simulation, names)
    told = COMM.gather(own) if simulation.comm.size > 1 else [own]
    return {name: np.concatenate([rank[name] for rank in told]) for name in names}


@pytest.mark.parametrize(
    ("dim", "slab_axis", "periodic", "walls"),
    [(2, "y", ["x", "y"], {}), (2, "x", [], {"walls": {"x_min": "open", "y_max": "open"}}), (3, "y", ["y"], {})],
)
def test_nodes_hold_the_bits_of_one_rank(dim, slab_axis, periodic, walls):
    made = scene(dim, slab_axis, periodic, walls)
    names = ["mass", "density", "velocity", "stress", *(["F"] if dim == 2 else [])]
    alone, together = Simulation(made), Simulation(made, COMM)
    for simulation in (alone, together):
        simulation.run(steps=4)
    assert len(set(together.slabs.edges)) == COMM.size + 1
    one, many = whole(alone, names), whole(together, names)
    for name in names:
        assert one[name].shape == many[name].shape
        assert one[name].tobytes() == many[name].tobytes(), name
    assert np.isfinite(one["velocity"]).any()
