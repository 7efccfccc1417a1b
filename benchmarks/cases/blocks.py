"""Two equal blocks that collide: no momentum by symmetry, and a centre of mass that stays where it is."""

import math

import numpy as np

import pmpm
from cases import Case, at_most, holds
from cases.gathered import by_id

SPEED = 0.1  # of waves
SIZE = 8  # cells, of a block


def scene(cells=SIZE, dim=2, **method):
    """Blocks of `cells` cubed that meet half a cell off the grid and off each other's axis, and fly apart again."""
    room = [4 * cells + 8] + [2 * cells + 8] * (dim - 1)
    speed = SPEED * math.sqrt(1e6 / 1000.0)
    offset = [0.0] + [0.25 * cells] * (dim - 1)
    bodies = []
    for side in (-1.0, 1.0):
        middle = [0.5 * n + side * 0.5 * o for n, o in zip(room, offset, strict=True)]
        middle[0] += side * (0.5 * cells + 2.3)
        shape = {
            "type": "box",
            "min": [m - 0.5 * cells for m in middle],
            "max": [m + 0.5 * cells for m in middle],
        }
        bodies.append({"material": "rubber", "shape": shape, "velocity": [-side * speed] + [0.0] * (dim - 1)})
    return pmpm.Scene(
        domain={"size": [float(n) for n in room], "cell_size": 1.0},
        method=method,
        time={"end": 8.0 * cells / math.sqrt(1e6 / 1000.0) + 4.0 / speed},
        materials={"rubber": {"model": "neo_hookean", "density": 1000.0, "youngs_modulus": 1e6, "poisson_ratio": 0.3}},
        bodies=bodies,
    )


def collided(comm=None, **keys):
    """What of the symmetry is left. Collective.

    first: |momentum| before the first step; momentum: the largest later, over sum m |v| at the start; centre: the largest
    way of the centre of mass over the size of the domain; contact: the least kinetic energy over the first.
    """
    simulation = pmpm.Simulation(scene(**keys), comm)
    axes = "xyz"[: simulation.dim]
    begin, x0 = simulation.measure(), centre(simulation)
    scale = begin["mass"] * SPEED * math.sqrt(1e6 / 1000.0)
    found = {"first": max(abs(begin[f"momentum_{a}"]) for a in axes), "momentum": 0.0, "centre": 0.0, "contact": 1.0}
    while not simulation.finished:
        simulation.run(steps=50)
        measured, x = simulation.measure(), centre(simulation)
        found["momentum"] = max(found["momentum"], *(abs(measured[f"momentum_{a}"]) / scale for a in axes))
        found["centre"] = max(found["centre"], float(np.abs(x - x0).max()) / max(simulation.scene.domain.size))
        found["contact"] = min(found["contact"], measured["kinetic"] / begin["kinetic"])
    return found


def centre(simulation):
    """Centre of the equal masses of all particles (dim,), summed without rounding."""
    (x,) = by_id(simulation, "x")
    return np.array([math.fsum(values) / len(x) for values in x.T])


# ---- verification ------------------------------------------------------------------------------------------------------------

SIZES = {"tiny": ((2, 8),), "standard": ((2, 8), (2, 32), (3, 8)), "sweep": ((2, 8), (2, 64), (3, 16))}  # (dim, cells)


def verify(size, comm):
    for dim, cells in SIZES[size]:
        for transfer in ("apic", "mls", "flip", "pic"):
            found = collided(comm, cells=cells, dim=dim, transfer=transfer)
            what = f"{dim}-D, {cells} cells, {transfer}:"
            yield holds(f"{what} the momentum before the first step is 0", found["first"] == 0.0, "exact sums")
            yield at_most(f"{what} largest momentum / sum m v", found["momentum"], 1e-13, "round-off, see above")
            yield at_most(f"{what} way of the centre of mass / domain", found["centre"], 1e-13, "round-off")
            yield at_most(f"{what} least kinetic energy", found["contact"], 0.9, "the blocks have met")


ABOUT = """
Two equal blocks meet off each other's axis at 0.1 c each, deform, turn and part. Before the first step the momentum is 0 to
the last bit: totals are sums without rounding. Later it cannot be: a node adds up its particles layer by layer from one
side, an order that no mirror image shares, so that round-off differs left and right. Asked is 1e-13, as of free bodies.
"""

CASE = Case("V10", "Two equal blocks collide", ABOUT, verify)
