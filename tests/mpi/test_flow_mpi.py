"""What leaves and what comes in is the same, bit for bit and to the particle, on any number of ranks and over restarts."""

import pytest
from bits import state_bits as bits
from mpi4py import MPI

from pmpm.parallel.comm import World
from pmpm.scene.schema import Scene
from pmpm.simulation import Simulation

pytestmark = pytest.mark.mpi(min_size=2)

COMM = World(MPI.COMM_WORLD)
RUBBER = {"model": "neo_hookean", "density": 1000.0, "youngs_modulus": 1e4, "poisson_ratio": 0.3}
WATER = {"model": "fluid", "density": 1000.0, "sound_speed": 10.0}


def fading(time):
    return (2.0 - 4.0 * time, 0.0)


def scene(slab_axis):
    """Water that flows out at two faces, a jet that grows slower and crosses cuts, and rubber let in askew for a while."""
    return Scene(
        domain={
            "size": [1.6, 0.8],
            "cell_size": 0.05,
            "gravity": [0.0, -9.81],
            "walls": {"x_max": "open", "y_min": "open"},
        },
        time={"end": 0.3},
        materials={"rubber": RUBBER, "water": WATER},
        bodies=[
            {
                "material": "water",
                "shape": {"type": "box", "min": [1.2, 0.0], "max": [1.5, 0.3]},
                "velocity": [2.0, 0.5],
            }
        ],
        inflows=[
            {"material": "water", "shape": {"type": "box", "min": [0.0, 0.1], "max": [0.1, 0.3]}, "velocity": fading},
            {
                "material": "rubber",
                "shape": {"type": "sphere", "center": [0.75, 0.6], "radius": 0.11},
                "velocity": [0.8, -1.5],
                "start": 0.03,
                "limit": 0.06,
            },
        ],
        parallel={"slab_axis": slab_axis},
    )


@pytest.mark.parametrize("slab_axis", ["x", "y"])
def test_flows_give_the_bits_of_one_rank_and_balance_over_a_restart_in_between(slab_axis, tmp_path):
    made, path = scene(slab_axis), COMM.broadcast(tmp_path) / "a.hdf"
    alone, together = Simulation(made), Simulation(made, COMM, threads=2)
    alone.run(until=0.12)
    together.run(until=0.12)
    together.save(path)
    assert bits(together) == bits(alone)
    alone.run()
    again = Simulation.restart(path, made, COMM)
    again.run()
    measured = again.measure()
    assert bits(again) == bits(alone)
    assert measured == alone.measure()
    assert measured["particles"] + measured["left"] == 144 + measured["emitted"]
    assert again.flow.left.min() > 0
    assert again.flow.emitted[2] == 96  # 0.06 m2 of 0.05^2 / 4 each
    assert COMM.sum(together.sent + again.sent).sum() > 100
    if COMM.rank == 0:
        one = Simulation.restart(path, made)
        one.run()
        assert bits(one) == bits(alone)
    COMM.barrier()
