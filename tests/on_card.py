"""Scenes of tests/fast_and_scalar.py on a simulated graphics card and on the processor, and how far the two have come apart.

    NUMBA_ENABLE_CUDASIM=1 [mpirun -n 2] python -m mpi4py tests/on_card.py FOLDER LABEL ...

prints for each row a line of JSON: distances (fast_and_scalar.distances), by what has happened (migration, restarts). The
simulator runs each thread in Python, so that scenes make few steps.
"""

import json
import sys
from pathlib import Path
from unittest import mock

import fast_and_scalar as agreement
import numpy as np
import random_cuts

from pmpm.failure import NumericalFailure
from pmpm.kernels import build_cuda
from pmpm.parallel.comm import from_launcher
from pmpm.processors import cards
from pmpm.scene.schema import Scene
from pmpm.simulation import Simulation

STEPS = 2  # before and after a regroup


def push(x, X, t):
    """A body force."""
    return (3.0 - x[0], 2.0 * X[1] + t)


def driven():
    """All that drives from outside: body force, load, damping, a moving wall, friction and a region in motion; and particles
    with shares, where the surface of a body cuts cells."""
    walls = {"y_min": agreement.FRICTION, "x_min": "stick", "x_max": {"type": "slip", "velocity": [-1.0, 0.0]}}
    low, high = [0.0, 0.0], [0.5, 0.0]
    return Scene(
        domain={"size": [0.8, 0.8], "cell_size": 0.1, "gravity": [0.0, -9.81], "walls": walls},
        method={"precision": "float64", "transfer": "aflip", "damping": 0.5},
        time={"end": 1.0},
        materials={"a": agreement.EXAMPLES["neo_hookean"], "b": agreement.EXAMPLES["fluid"]},
        bodies=[
            {
                "material": "a",
                "shape": {"type": "box", "min": low, "max": [0.28, 0.3]},
                "velocity": [-0.1, -0.2],
                "seeding": "quadrature",
            },
            {"material": "b", "shape": {"type": "box", "min": high, "max": [0.8, 0.3]}, "velocity": [0.1, 0.1]},
        ],
        body_force=push,
        loads=[{"shape": {"type": "box", "min": low, "max": [0.2, 0.2]}, "acceleration": [5.0, 1.0]}],
        motions=[{"shape": {"type": "box", "min": [0.3, 0.5], "max": [0.5, 0.8]}, "velocity": [0.0, -1.0]}],
        colliders=[
            {"shape": {"type": "sphere", "center": [0.4, 0.1], "radius": 0.15}, "angular_velocity": 90.0, "cut": False}
        ],
    )


def on_nodes():
    """Linear splines, and 256 particles that stand on nodes once they have been moved by half a cell: a neighbouring node gets
    an impulse from them and no mass. It has mass from others, some of which another block of threads sums."""
    return Scene(
        domain={"size": [3.0, 3.0], "cell_size": 0.125, "gravity": [0.0, 0.0]},
        method={"shape_function": "linear", "transfer": "pic"},
        time={"end": 1.0},
        materials={"a": agreement.EXAMPLES["neo_hookean"]},
        bodies=[
            {"material": "a", "shape": {"type": "box", "min": [0.5] * 2, "max": [2.5] * 2}, "particles_per_cell": 1}
        ],
    )


def wide():
    """Home nodes of two tiles of a layer (kernels.cuda_sorting), and a body that lies across where they meet, and swings."""
    domain = {"size": [30.0, 30.0], "cell_size": 0.1, "gravity": [0.0, 0.0]}
    return Scene(
        domain=domain,
        method={"precision": "float32"},  # whose places reach no farther than a tile
        time={"end": 1.0},
        materials={"a": agreement.EXAMPLES["neo_hookean"]},
        bodies=[
            {
                "material": "a",
                "shape": {"type": "box", "min": [1.0, low], "max": [1.3, low + 0.4]},
                "velocity": [0.02, 0.02],
                "deformation": [[1.3, 0.1], [0.0, 0.8]],
            }
            for low in (2.0, 21.8)
        ],
    )


def in_and_out():
    """A stretched body that leaves through two faces, one along each axis, and, after a step, one that flows in at a wall."""
    walls = {"x_max": "open", "y_min": "open", "x_min": "stick"}
    body = {"material": "a", "shape": {"type": "box", "min": [0.85, 0.0], "max": [1.2, 0.35]}, "velocity": [0.1, -0.1]}
    mouth = {"material": "a", "shape": {"type": "box", "min": [0.0, 0.3], "max": [0.2, 0.5]}, "velocity": [5.0, 0.0]}
    return Scene(
        domain={"size": [1.2, 0.8], "cell_size": 0.1, "gravity": [0.0, -9.81], "walls": walls},
        time={"end": 1.0},
        materials={"a": agreement.EXAMPLES["neo_hookean"]},
        bodies=[body | {"deformation": [[1.3, 0.1], [0.0, 0.8]]}],
        inflows=[mouth | {"particles_per_cell": 16, "start": 1e-6}],
    )


def touching():
    """Two bodies that press on each other beside walls, and one that is bonded to the first."""
    box = {"type": "box", "min": [0.1, 0.0], "max": [0.4, 0.3]}
    other = {"type": "box", "min": [0.4, 0.0], "max": [0.8, 0.4]}
    return Scene(
        domain={"size": [1.6, 0.8], "cell_size": 0.1, "gravity": [0.0, -9.81], "walls": {"y_min": agreement.FRICTION}},
        method={"precision": "float64", "transfer": "flip"},
        time={"end": 1.0},
        materials={
            "a": agreement.EXAMPLES["neo_hookean"],
            "b": agreement.EXAMPLES["fluid"],
            "c": agreement.EXAMPLES["hencky"],
        },
        contact={"friction": 0.3, "together": [["a", "c"]]},
        bodies=[
            {"material": "a", "shape": box, "velocity": [0.3, 0.0]},
            {"material": "b", "shape": other, "velocity": [-0.1, 0.1]},
            {"material": "c", "shape": {"type": "box", "min": [0.8, 0.0], "max": [1.1, 0.3]}, "velocity": [-0.2, 0.0]},
        ],
    )


def many():
    """More particles than one tile of the sort holds counts of."""
    return Scene(
        domain={"size": [4.0] * 3, "cell_size": 0.1},
        method={"precision": "float32"},
        time={"end": 1.0},
        materials={"m": agreement.EXAMPLES["neo_hookean"]},
        bodies=[{"material": "m", "shape": {"type": "box", "min": [0.5] * 3, "max": [1.5] * 3}}],
    )


MANY = "many"
IN_AND_OUT = "in and out"
TOUCHING = "in contact"
FAILING = "driven, failing"
ON_NODES = "linear, on nodes"
IN_SPACE = 2, 1, 2  # particles per cell of bodies in 3-D: 200 in all
FEWEST, FEW, FULL = 16, 32, build_cuda.THREADS  # of a block of threads: the simulator takes its time with many
ALL_THREADS = "driven", ON_NODES  # rows with as many as on a card
SMALL_TILE = "driven, no room to sum in"  # shared memory of 400 bytes: each particle adds to the nodes itself
FACTORS = agreement.FACTORS | {"material": list(agreement.MATERIALS)}
SCENES = {
    agreement.label(row): lambda row=row: agreement.scene(row, IN_SPACE)
    for row in agreement.SINGLE + agreement.every_pair.full_product(FACTORS, agreement.allowed)
} | {"driven": driven, "two tiles, float32": wide, SMALL_TILE: driven, FAILING: driven, MANY: many, ON_NODES: on_nodes}
SCENES |= {IN_AND_OUT: in_and_out, TOUCHING: touching}


def start(scene, comm, backend):
    """A simulation whose bodies fly fast, so that particles change cells, layers and ranks within few steps."""
    simulation = Simulation(scene, comm, backend=backend)
    simulation.particles.v = 40.0 * simulation.particles.v
    return simulation


def moved_onto_nodes(scene, comm, backend):
    """A simulation after one step of particles that stood on nodes, stretched one more than the other."""
    simulation = Simulation(scene, comm, backend=backend)
    particles = simulation.particles
    particles.F = particles.F * np.linspace(1.0, 1.1, len(particles.F))[:, None, None]
    particles.x = particles.x + 0.5 * scene.domain.cell_size
    simulation.step()
    return simulation


def moved_alike(one, other):
    """Whether two simulations hold the same particles to the bit, each in order of their cells, after a regroup."""
    axes, dim = one.geometry.axes, one.dim
    for ours, theirs in zip(one.populations, other.populations, strict=True):
        rows = []
        for population in (ours, theirs):
            node, part = population.cells(axes)
            ids = population.id[population.lanes]
            order = np.argsort(ids)
            rows.append((ids[order], (node + part)[order], population.rows(slice(dim, None))[order].tobytes()))
        if not (np.array_equal(rows[0][0], rows[1][0]) and np.array_equal(rows[0][1], rows[1][1])):
            return False
        if rows[0][2] != rows[1][2] or not in_order(theirs, one.geometry):
            return False
    return True


def in_order(population, geometry):
    """Whether particles stand by layer, body and cell, in a domain of one tile."""
    node, part = population.cells(geometry.axes)
    home = node + np.floor(part + geometry.stencil.round).astype(int)
    slab, middle, row = geometry.axes
    columns = [home[:, row], *([home[:, middle]] if middle >= 0 else []), population.per_particle(population.block_row)]
    return np.array_equal(np.lexsort((*columns, home[:, slab])), np.arange(len(home)))


def failing(scene, comm, backend):
    """What is said when some particles of the second law have no volume any more."""
    simulation = Simulation(scene, comm, backend=backend)
    particles, J = simulation.particles, simulation.particles.J
    J[np.isin(particles.id, np.sort(particles.id[particles.material == 1])[[7, 20, 21]])] = -1.0
    particles.J = J
    try:
        simulation.run(steps=5)
    except NumericalFailure as failure:
        return str(failure)
    return "nothing"


def go(simulation, edges):
    """Some steps, a regroup with other cuts, some steps; one rank takes other nodes while the others keep theirs."""
    simulation.run(steps=STEPS)
    simulation.regroup(edges=edges)
    for _ in range(STEPS):
        simulation.run(steps=1)
        simulation.patch.stale |= simulation.comm.rank == 0
    return simulation


def apart(label, folder, comm):
    """{what has happened: distances} of one scene."""
    scene = SCENES[label]()
    if label == MANY:
        one, other = (Simulation(scene, comm, backend=backend) for backend in ("cpu", "cuda"))
        for simulation in (one, other):
            simulation.regroup()
        other.lay_out()
        held, estimated = other.processor.nbytes, int(cards.of_scene(scene))
        return {"alike": moved_alike(one, other), "held": held, "estimated": estimated, "particles": other.rows()}
    if label == FAILING:
        one, other = (failing(scene, comm, backend) for backend in ("cpu", "cuda"))
        return {"failures": [one, other]}
    if label == ON_NODES:  # one step: surfaces of linear splines turn unstable
        one, other = (moved_onto_nodes(scene, comm, backend) for backend in ("cpu", "cuda"))
        return {"apart": {"steps": agreement.distances(one, other)}, "sent": 0, "energies": 0.0, "alike": True}
    simulations = {backend: start(scene, comm, backend) for backend in ("cpu", "cuda")}
    edges = other_edges = None
    if comm.size > 1:
        edges, other_edges = (random_cuts.random_edges(simulations["cpu"], np.random.default_rng(n)) for n in (2, 3))
    for simulation in simulations.values():
        simulation.regroup(edges=edges)
    alike = moved_alike(*simulations.values())
    for simulation in simulations.values():
        go(simulation, other_edges)
    found = {"steps": agreement.distances(simulations["cpu"], simulations["cuda"])}
    sent = int(comm.sum(simulations["cuda"].sent).sum())
    energies = [comm.sum(simulation.energies().sum(axis=0)) for simulation in simulations.values()]
    for backend, other in (("cpu", "cuda"), ("cuda", "cpu")):  # a checkpoint of each goes on on both
        path = folder / f"{backend}.hdf"
        simulations[backend].save(path)
        again = [Simulation.restart(path, scene, comm, backend=name) for name in (backend, other)]
        for simulation in again:
            simulation.step()
        found[f"{backend} goes on as {other}"] = agreement.distances(*again)
    gap = float(np.abs(energies[0] - energies[1]).max() / np.abs(energies[0]).max())
    direct = simulations["cuda"].processor.direct
    if label == IN_AND_OUT:
        one, other = (simulation.flow.report() for simulation in simulations.values())
        alike = alike and one == other and one["left"][0] > 0 and one["emitted"][1] > 4 * 16
    return {"apart": found, "sent": sent, "energies": gap, "alike": all(comm.gather(alike)), "direct": direct}


def main():
    comm, folder = from_launcher(), Path(sys.argv[1])
    for label in sys.argv[2:]:
        tile = 400 if label == SMALL_TILE else build_cuda.TILE_BYTES
        threads = FULL if label in ALL_THREADS else FEWEST if label == MANY else FEW
        with mock.patch.multiple(build_cuda, TILE_BYTES=tile, THREADS=threads):
            found = apart(label, folder, comm)
        if comm.rank == 0:
            print(json.dumps({"row": label, **found}), flush=True)


if __name__ == "__main__":
    main()
