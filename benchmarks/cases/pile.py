"""Heaps of dry sand below and above the angle at which they flow, and the slope at which they come to rest."""

import math

import numpy as np

import pmpm
from cases import Case, Table, at_least, at_most, between
from cases.gathered import by_id

PHI = 30.0
HEIGHT = 0.1
SAND = {
    "model": "drucker_prager", "density": 2650.0, "youngs_modulus": 8.4e5, "poisson_ratio": 0.3, "friction_angle": PHI,
}  # fmt: skip


def scene(slope, cells, end, damping=0.0, **method):
    """Half a heap, `cells` high, with a straight slope (degrees), beside a wall that slips."""
    dx = HEIGHT / cells
    rows = 2 * cells
    foot = HEIGHT / math.tan(math.radians(slope))
    steps = [
        {
            "type": "box",
            "min": [0.0, row * 0.5 * dx],
            "max": [foot * (1.0 - (row + 0.5) / rows), (row + 1) * 0.5 * dx],
        }
        for row in range(rows)
    ]
    return pmpm.Scene(
        domain={
            "size": [math.ceil(2.0 * foot / dx) * dx, HEIGHT + 4.0 * dx],
            "cell_size": dx,
            "gravity": [0.0, -9.81],
            "walls": {"x_min": "slip", "y_min": "stick"},
        },
        method={"damping": damping} | method,
        time={"end": end},
        materials={"sand": SAND},
        bodies=[{"material": "sand", "shape": {"type": "union", "of": steps}}],
    )


def slope_of(x, dx):
    """Angle (degrees) of a line through the highest particles (of each cell of width) between 0.2 and 0.8 of the height."""
    column = np.floor(x[:, 0] / dx).astype(int)
    columns = np.unique(column)
    top = np.array([x[column == k, 1].max() for k in columns])
    part = (top > 0.2 * top.max()) & (top < 0.8 * top.max())
    return math.degrees(math.atan(-np.polyfit((columns[part] + 0.5) * dx, top[part], 1)[0]))


def settled(slope, cells, end, comm=None, damping=0.0, **method):
    """(slope at the start and at the end in degrees, way of the grains in cells, their largest speed over sqrt(g h)).

    The way is a root mean square. Collective.
    """
    simulation = pmpm.Simulation(scene(slope, cells, end, damping, **method), comm)
    (X,) = by_id(simulation, "x")
    simulation.run()
    x, v = by_id(simulation, "x", "velocity")
    dx = HEIGHT / cells
    way = float(np.sqrt(np.mean(((x - X) ** 2).sum(axis=1)))) / dx
    return slope_of(X, dx), slope_of(x, dx), way, float(np.abs(v).max()) / math.sqrt(9.81 * HEIGHT)


# ---- verification ------------------------------------------------------------------------------------------------------------

CELLS = {"tiny": (20,), "standard": (20, 40), "sweep": (20, 40, 80)}
BELOW, ABOVE, RELEASED, SLOW = (24.0, 28.0), (32.0, 36.0), 36.0, 20.0  # degrees; 1/s
END, SLOW_END = 1.0, 2.0  # s: 10 and 20 of sqrt(h / g)
STAYS = 0.25  # cells: elastic settlement is 0.06 at 20 cells, and grows with the number of cells as they become smaller


def verify(size, comm):
    rows = []
    for cells in CELLS[size]:
        for slope in (BELOW[-1], ABOVE[-1]) if size == "tiny" else (*BELOW, *ABOVE):
            first, last, way, speed = settled(slope, cells, END, comm)
            rows.append((f"{slope:g}", cells, "", f"{first:.1f}", f"{last:.1f}", f"{way:.2f}", f"{speed:.1e}"))
            what = f"slope of {slope:g} degrees, N = {cells}: way of the grains, cells"
            if slope < PHI:
                yield at_most(what, way, STAYS, "below the angle of friction a heap settles elastically, and stays")
            else:
                yield at_least(what, way, 2.0 * STAYS, "above it grains slide")
        if size == "tiny":
            continue
        first, last, way, speed = settled(RELEASED, cells, SLOW_END, comm, SLOW)
        rows.append((f"{RELEASED:g}", cells, f"{SLOW:g}", f"{first:.1f}", f"{last:.1f}", f"{way:.2f}", f"{speed:.1e}"))
        what = f"slope of {RELEASED:g} degrees let down slowly, N = {cells}: angle of repose, degrees"
        yield between(what, last, PHI - 4.0, PHI + 1.0, "between atan(sin phi) = 26.6 and phi, and a cell of doubt")
    head = ("slope", "N", "damping, 1/s", "measured at the start", "at the end", "way, cells", "max v / sqrt(g h)")
    yield Table("Heaps, angles in degrees", head, rows)


ABOUT = """
Half a heap of `drucker_prager` sand (phi = 30 degrees, plane strain, no dilatancy), 0.1 m = N cells high, with a straight
slope, on a floor that sticks, under gravity from the start on. A slope below phi stays, one above it flows. In simple shear
without dilatancy the principal axes stand at 45 degrees to the layer, so that it carries a shear stress of sin phi times
the normal one: what flows comes to rest between atan(sin phi) = 26.6 degrees and phi.

That holds for a heap that is let down slowly (damping of 20 / s: inertia does not count). One that flows freely arrives
with momentum and runs on to slopes below the angle of repose, the lower the steeper and finer it was: in the table, without
a gate.
"""

CASE = Case("V11", "Sand pile and angle of repose", ABOUT, verify)
