"""Scenes that are cut anew at random steps, in random places, by ranks of some threads, and what one process makes of them.

The scenes are those of tests/fast_and_scalar.py that hold every pair of methods, and of tests/several_laws.py with a periodic
slab axis. A regroup sorts particles, so that when it comes changes bits; where cuts are does not. So one run alone, which
regroups at the same steps, is the reference of all sequences of cuts of a scene.
"""

from unittest import mock

import fast_and_scalar
import numpy as np
import several_laws
from bits import state_bits

from pmpm.simulation import Simulation
from pmpm.state import particles

GROUPS = 1, 100, particles.GROUP
STEPS, OFTEN, LOOKS = 40, 0.25, 0.2  # a share of the steps regroups, a share of those by the balance
CASES = {fast_and_scalar.label(row): lambda row=row: fast_and_scalar.scene(row) for row in fast_and_scalar.PAIRS} | {
    "flat, periodic, float32": lambda: several_laws.flat(precision="float32"),
    "flat, periodic, float64": several_laws.flat,
    "deep, periodic": several_laws.deep,
    "tall": several_laws.tall,
}
# For seconds: each spline, transfer and precision, with F-bar and without, 2-D and 3-D, laws alone and together.
FEW = (
    "several 3 cubic flip float64 False",
    "several 3 linear aflip float32 True",
    "fluid 3 quadratic mls float64 True",
    "neo_hookean 2 cubic pic float32 True",
    "several 2 quadratic mls float32 False",
    "several 2 quadratic apic float32 False",
    "neo_hookean 2 quadratic flip float32 False",
    "flat, periodic, float64",
    "deep, periodic",
    "tall",
)


def random_edges(simulation, random):
    """Legal edges for as many ranks as the domain has room for, or fewer."""
    layers, window, ranks = simulation.geometry.layers, simulation.needs.stencil.window, simulation.comm.size
    active = int(random.integers(1, min(ranks, layers // window) + 1))
    spare = np.sort(random.integers(0, layers - active * window + 1, active - 1))
    inner = [int(edge) for edge in spare + window * np.arange(1, active)]
    return (0, *inner, *[layers] * (ranks + 1 - active))


def regroups():
    """Whether there is a regroup before each step: the same in all runs."""
    return np.random.default_rng(STEPS).random(STEPS) < OFTEN


def bits_of_one(case, comm):
    """What one process alone ends with, which rank 0 is. Collective."""
    found = None
    if comm.rank == 0:
        simulation = Simulation(CASES[case]())
        for regroup in regroups():
            if regroup:
                simulation.regroup()
            simulation.step()
        found = state_bits(simulation)
    return comm.broadcast(found)


def cut_at_random(case, seed, comm):
    """(what all ranks end with, the edges they had, particles sent to other ranks) with cuts drawn from a seed, one to three
    threads per rank and groups of particles of that many sizes in a regroup. Collective."""
    threads, group = 1 + (comm.rank + seed) % 3, GROUPS[(comm.rank + seed // 2) % len(GROUPS)]
    with mock.patch.object(particles, "GROUP", group):
        simulation, random, edges = Simulation(CASES[case](), comm, threads=threads), np.random.default_rng(seed), []
        for regroup in regroups():
            if regroup:
                simulation.regroup(edges=None if random.random() < LOOKS else random_edges(simulation, random))
                edges.append(simulation.slabs.edges)
            simulation.step()
        return state_bits(simulation), edges, int(comm.sum(simulation.sent).sum())
