"""A cantilever under a dead load at its end: the elastica at rest, in plane strain.

theta'' = -alpha cos(theta) along s / L, theta(0) = 0, theta'(1) = 0, alpha = P L^2 / (E' I), E' = E / (1 - nu^2), for the angle
theta of an inextensible axis (Bisshopp and Drucker, Quart. Appl. Math. 3 (1945) 272).
"""

import math

import numpy as np

import pmpm
from cases import Case, Table, near
from cases.gathered import by_id

SLENDERNESS = 20.0
YOUNGS_MODULUS, POISSON_RATIO, DENSITY, HEIGHT = 1e6, 0.3, 1000.0, 1.0
PLANE_MODULUS = YOUNGS_MODULUS / (1.0 - POISSON_RATIO**2)
MATERIAL = {
    "model": "neo_hookean", "density": DENSITY, "youngs_modulus": YOUNGS_MODULUS, "poisson_ratio": POISSON_RATIO,
}  # fmt: skip
SECOND_MOMENT = HEIGHT**3 / 12.0
LENGTH = SLENDERNESS * HEIGHT
# First period of a slender cantilever, (1.875104 / L)^2 sqrt(E' I / rho A) being its angular frequency.
PERIOD = 2.0 * math.pi * (LENGTH / 1.875104) ** 2 * math.sqrt(DENSITY * HEIGHT / (PLANE_MODULUS * SECOND_MOMENT))


def elastica(alpha, steps=200):
    """(deflection, shortening) of the end over L: theta by shooting for the angle of the end, with Runge and Kutta's method."""

    def slope(state):
        """Of (theta, theta', integral of sin theta, of 1 - cos theta) on the way from the end to the clamp, s falling."""
        theta, bend = state[0], state[1]
        return np.array([-bend, alpha * math.cos(theta), math.sin(theta), 1.0 - math.cos(theta)])

    def clamped(angle):
        state, h = np.array([angle, 0.0, 0.0, 0.0]), 1.0 / steps
        for _ in range(steps):
            k1 = slope(state)
            k2 = slope(state + 0.5 * h * k1)
            k3 = slope(state + 0.5 * h * k2)
            k4 = slope(state + h * k3)
            state = state + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        return state

    low, high = 0.0, 0.5 * math.pi
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if clamped(middle)[0] > 0.0 else (middle, high)
    return tuple(map(float, clamped(low)[2:]))


def scene(alpha, cells, particles_per_cell=4, periods=2.0, **method):
    """`cells` along the height. The load sits on the last column of particles, L from the clamp but for a part of a cell.

    Damping is critical for the first bending mode: after n periods exp(-2 pi n) (1 + 2 pi n) of it is left.
    """
    dx, load = HEIGHT / cells, alpha * PLANE_MODULUS * SECOND_MOMENT / LENGTH**2
    below = math.ceil(elastica(alpha)[0] * LENGTH / HEIGHT + 1.0) * HEIGHT
    beam = {"type": "box", "min": [0.0, below], "max": [LENGTH, below + HEIGHT]}
    return pmpm.Scene(
        title="Cantilever",
        domain={
            "size": [LENGTH + 2.0 * dx, below + HEIGHT + 2.0 * dx],
            "cell_size": dx,
            "walls": {"x_min": "stick"},
        },
        method={"damping": 4.0 * math.pi / PERIOD} | method,
        time={"end": periods * PERIOD},
        materials={"material": MATERIAL},
        bodies=[{"material": "material", "shape": beam, "particles_per_cell": particles_per_cell}],
        loads=[{"shape": beam | {"min": [LENGTH - 0.5 * dx, below]}, "force": [0.0, -load]}],
    )


def bent(alpha, cells, comm=None, **keys):
    """{deflection, shortening: (over L, as the elastica has it)} of the loaded column, L its distance. Collective."""
    simulation = pmpm.Simulation(scene(alpha, cells, **keys), comm)
    (X,) = by_id(simulation, "x")
    simulation.run()
    (x,) = by_id(simulation, "x")
    end = X[:, 0] > LENGTH - 0.5 * HEIGHT / cells
    length = float(X[end, 0].mean())
    moved = (x - X)[end].mean(axis=0) / length
    exact = elastica(alpha * (length / LENGTH) ** 2)
    return {"deflection": (-float(moved[1]), exact[0]), "shortening": (-float(moved[0]), exact[1])}


# ---- verification ------------------------------------------------------------------------------------------------------------

LOADS = (0.25, 1.0)
# (shape function, particles per cell, whether the gate holds for it).
SCHEMES = (("quadratic", 4, False), ("quadratic", 9, True), ("cubic", 4, True))
CELLS = {"tiny": (), "standard": (4, 6, 10), "sweep": (4, 6, 10, 14)}
GATE, GATED_FROM = 0.02, 10


def verify(size, comm):
    rows = []
    for alpha in LOADS:
        deflection, shortening = elastica(alpha)
        exact = {0.25: (0.08275, 0.00412), 1.0: (0.30172, 0.05643)}[alpha]
        yield near(f"elastica, alpha = {alpha:g}: deflection / L", deflection, exact[0], 1e-4, "Bisshopp and Drucker")
        yield near(f"elastica, alpha = {alpha:g}: shortening / L", shortening, exact[1], 1e-3, "the same integral")
    for cells in CELLS[size]:
        for alpha in LOADS:
            for spline, particles, gated in SCHEMES:
                found = bent(alpha, cells, comm, particles_per_cell=particles, shape_function=spline)
                for name, (value, exact) in found.items():
                    error = f"{value / exact - 1.0:+.2%}"
                    rows.append((alpha, spline, particles, cells, name, f"{value:.5f}", f"{exact:.5f}", error))
                if gated and cells >= GATED_FROM:
                    what = f"alpha = {alpha:g}, {spline}, {particles} particles and {cells} cells: deflection / L"
                    yield near(what, *found["deflection"], GATE, "a beam with shear: 0.2 % more than the elastica")
    if rows:
        head = ("alpha", "spline", "particles per cell", "cells", "", "measured", "elastica", "error")
        yield Table("Cantilevers at rest", head, rows)


ABOUT = """
A beam in plane strain, L / h = 20, E = 1 MPa, nu = 0.3, clamped by a wall that sticks, under a dead load P on its last
column of particles, from the straight state at once: two periods of the first bending mode under its critical damping.
theta'' = -alpha cos theta, alpha = P L^2 / (E' I), E' = E / (1 - nu^2), for the angle theta of an inextensible axis; with
shear such a beam bends by 3 E' I / (kappa G A L^2) = 0.2 % more. A run takes 2e4 steps per cell of the height: size tiny
solves the elastica alone.

Under the larger load the end sinks by six heights and turns by 26 degrees, so that particles end in all places within cells
and turned against them. Four per cell then sum the forces of quadratic splines too coarsely, whose gradients have kinks at
cell edges: the beam bends by 4 to 7 % too much, and refining the grid alone does not help. Nine per cell bring it to where
cubic splines, whose gradients are smooth, are with four. The gate holds for these two; four with quadratic splines stay in
the table.
"""

CASE = Case("V8", "Cantilever: static elastica", ABOUT, verify)
