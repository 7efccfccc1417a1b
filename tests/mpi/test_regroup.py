"""Regroup and moved cuts: particles go to the owner of their layer, none is lost, and no cut changes a bit."""

import numpy as np
import pytest
import several_laws
from mpi4py import MPI
from random_cuts import random_edges

from pmpm.parallel import balance
from pmpm.parallel import comm as communication
from pmpm.parallel.comm import World
from pmpm.simulation import Simulation

pytestmark = pytest.mark.mpi(min_size=2)

COMM = World(MPI.COMM_WORLD)
SCENES = {"flat": several_laws.flat, "deep": several_laws.deep, "tall": several_laws.tall}
NAMES = [
    "id",
    "x",
    "velocity",
    "stress",
    "deformation_gradient",
    "J",
    "density",
    "material",
    "hencky_strain",
    "v_c",
    "C",
]


@pytest.fixture(params=SCENES)
def scene(request):
    return SCENES[request.param]()


def everything(simulation):
    """All rows of all ranks in the one global order, as bytes by name."""
    own = simulation.fields(NAMES)
    return {name: np.concatenate(simulation.comm.gather(rows)).tobytes() for name, rows in own.items()}


def differing(scene, steps, events):
    """Names that differ between all ranks and one rank after `steps` steps; `events`: (simulation, step) -> None."""
    together, alone = Simulation(scene, COMM), Simulation(scene)
    for simulation in (together, alone):
        for step in range(steps):
            events(simulation, step)
            simulation.step()
        simulation.check()
    here, there = everything(together), everything(alone)
    wrong = [name for name in NAMES if here[name] != there[name]]
    wrong += ["time"] if together.time != alone.time else []
    return wrong + [key for key, value in alone.measure().items() if together.measure()[key] != value]


def nothing(simulation, step):
    pass


def cuts_at_random(simulation, step):
    """At the same random steps: new random cuts with several ranks, a regroup with one."""
    random = np.random.default_rng([3, step])
    if random.random() < 0.1:
        simulation.regroup(edges=random_edges(simulation, random) if simulation.comm.size > 1 else None)


def test_random_cuts_are_of_all_kinds(scene):
    simulation = Simulation(scene, COMM)
    found = {random_edges(simulation, np.random.default_rng([3, step])) for step in range(200)}
    assert {len(set(edges)) - 1 for edges in found} == set(range(1, COMM.size + 1))


def test_several_ranks_give_the_bits_of_one(scene):
    assert differing(scene, 120, nothing) == []


def test_moved_cuts_give_the_bits_of_one_rank(scene):
    assert differing(scene, 120, cuts_at_random) == []


@pytest.mark.parametrize("where", ["left", "right"])
def test_cuts_that_leave_a_rank_almost_nothing_give_the_bits_of_one_rank(scene, where):
    def events(simulation, step):
        if step == 10:
            layers, window, size = simulation.geometry.layers, simulation.needs.stencil.window, simulation.comm.size
            few = [window * rank for rank in range(size)]
            edges = [*few, layers] if where == "left" else [0, *(layers - window * n for n in range(size - 1, -1, -1))]
            simulation.regroup(edges=edges)

    assert differing(scene, 60, events) == []


def test_regroup_brings_every_particle_to_the_rank_of_its_layer(scene):
    simulation = Simulation(scene, COMM)
    simulation.run(steps=40)
    simulation.regroup(edges=random_edges(simulation, np.random.default_rng(8)))
    slab = simulation.geometry.axes[0]
    layer = np.floor(simulation.particles.x[:, slab] / scene.domain.cell_size + 0.5) % simulation.geometry.layers
    strays = np.count_nonzero((layer < simulation.first_layer) | (layer >= simulation.last_layer))
    assert COMM.gather(strays) == [0] * COMM.size


def test_regroup_loses_and_doubles_no_particle(scene):
    simulation = Simulation(scene, COMM)
    before = sorted(np.concatenate(COMM.gather(simulation.particles.id)).tolist())
    for number in range(5):
        simulation.run(steps=10)
        simulation.regroup(edges=random_edges(simulation, np.random.default_rng(number)))
    after = sorted(np.concatenate(COMM.gather(simulation.particles.id)).tolist())
    assert (before == after, len(set(after))) == (True, len(after))


def test_particles_cross_the_seam_of_a_periodic_axis():
    """With three ranks only the seam joins the first and the last one."""
    simulation = Simulation(several_laws.flat(), COMM)
    simulation.run()
    sent = np.array(simulation.report()["sent"])
    assert (sent + sent.T)[~np.eye(COMM.size, dtype=bool)].all(), sent


@pytest.mark.parametrize("edges", ["too few", "too narrow", "idle first", "beyond the domain", "backwards"])
def test_edges_that_are_no_slabs_are_refused_on_all_ranks_and_change_nothing(edges):
    simulation = Simulation(several_laws.flat(), COMM)
    layers, size = simulation.geometry.layers, COMM.size
    before = everything(simulation)
    wrong = {
        "too few": [0, *[layers] * (size - 1)],
        "too narrow": [0, 4, *[layers] * (size - 1)],
        "idle first": [*[0] * size, layers],
        "beyond the domain": [0, *[layers + 1] * size],
        "backwards": [0, 30, 20, *[layers] * (size - 2)] if size > 2 else [0, layers + 5, layers],
    }[edges]
    with pytest.raises(ValueError):
        simulation.regroup(edges=wrong)
    simulation.run(steps=1)
    simulation_of_one = Simulation(several_laws.flat())
    simulation_of_one.run(steps=1)
    assert before.keys() == everything(simulation).keys()
    assert everything(simulation) == everything(simulation_of_one)


def test_assigned_positions_bring_particles_to_other_ranks_with_the_bits_of_one():
    def events(simulation, step):
        if step == 5:
            simulation.particles.x = (simulation.particles.x + [0.37, 0.0]) % [1.0, 0.6]

    assert differing(several_laws.flat(), 30, events) == []


def test_positions_outside_the_domain_on_one_rank_are_refused_on_all():
    simulation = Simulation(several_laws.flat(), COMM)
    x = simulation.particles.x
    if COMM.rank == COMM.size - 1:
        x[0, 1] = np.nan
        x[1, 1] = 0.7
    with pytest.raises(ValueError, match="2 of the new positions"):
        simulation.particles.x = x


def test_migration_compiles_no_kernel_again():
    """Every rank would wait for it in the middle of the run: arrays of what stays and what comes are laid out alike."""
    simulation = Simulation(several_laws.flat(), COMM)
    before = {name: len(kernel.signatures) for name, kernel in simulation.kernels.entries.items()}
    while COMM.sum(simulation.sent).sum() == 0:
        simulation.step()
    simulation.step()
    assert {name: len(kernel.signatures) for name, kernel in simulation.kernels.entries.items()} == before


def test_cuts_that_move_far_go_in_several_ways_with_the_bits_of_one_rank(monkeypatch):
    """At most a sixteenth of a rank's particles at a time, in messages of at most 1000 bytes."""
    monkeypatch.setattr(balance, "FEW", 1)
    monkeypatch.setattr(communication, "MESSAGE", 1000)
    ways = []

    def events(simulation, step):
        if step == 10 and simulation.comm.size > 1:
            before, window, layers = simulation.slabs.edges, simulation.needs.stencil.window, simulation.geometry.layers
            few = [window * rank for rank in range(simulation.comm.size)]
            ways.extend(simulation.ways(before, (*few, layers)))
            simulation.regroup(edges=[*few, layers])
        elif step == 10:
            simulation.regroup()

    assert differing(several_laws.flat(), 30, events) == []
    assert len(ways) > 2


def test_a_regroup_asks_nobody_but_neighbours(monkeypatch):
    """While cuts stay, who leaves goes to the next layer: no message for all."""
    simulation = Simulation(several_laws.flat(), COMM)

    def refuse(self, counts):
        raise AssertionError("all ranks were asked")

    monkeypatch.setattr(World, "exchange_counts", refuse)
    simulation.run(steps=40)
    simulation.regroup(edges=simulation.slabs.edges)
    assert simulation.regroups > 0
