"""A block on a plane inclined by 24 degrees, made by tilting gravity: Coulomb friction, exact for a rigid block.

A block slides by s = g t^2 (sin theta - mu cos theta) / 2, mu = tan 15 degrees (the tests of larsblatny/matter have the same
block and a gate of 1e-3), and stays where mu = tan 30 degrees. A wall that slips, or that may be left, takes nothing; one that
sticks holds.
"""

import math

import pmpm
from cases import Case, Table, at_least, at_most
from cases.gathered import by_id

ANGLE, GRAVITY = math.radians(24.0), 9.81
LENGTH, HEIGHT = 0.1, 0.05
RUBBER = {"model": "neo_hookean", "density": 1000.0, "youngs_modulus": 1e6, "poisson_ratio": 0.3}
DAMPING, RAMP = 500.0, 0.1  # 1/s and s, with which a block is laid on the plane: critical for its lowest vibrations
COEFFICIENT = math.tan(math.radians(15.0))


def friction(degrees):
    return {"type": "friction", "coefficient": math.tan(math.radians(degrees))}


def pull(coefficient):
    """Acceleration along the plane, m/s2."""
    return GRAVITY * (math.sin(ANGLE) - coefficient * math.cos(ANGLE))


def scene(wall, cells, end, far=0.0, laid=False, speed=0.0, **method):
    """`cells` along the height of a block that goes as far as `far` (m), let go at once, or `laid` down.

    `speed`: m/s along the plane at the start. Laid down is with a ramp of gravity and under damping.
    """
    dx = HEIGHT / cells
    size = math.ceil((far + 4.0 * LENGTH) / dx) * dx
    place = {"min": [LENGTH, 0.0], "max": [2.0 * LENGTH, HEIGHT]}
    return pmpm.Scene(
        title="Block on an inclined plane",
        domain={
            "size": [size, 3.0 * HEIGHT],
            "cell_size": dx,
            "gravity": [GRAVITY * math.sin(ANGLE), -GRAVITY * math.cos(ANGLE)],
            "walls": {"y_min": wall},
        },
        method={"damping": DAMPING if laid else 0.0} | method,
        time={"end": end, "cfl": 0.5, "ramp": RAMP if laid else 0.0},
        materials={"material": RUBBER},
        bodies=[{"material": "material", "shape": {"type": "box", **place}, "velocity": [speed, 0.0]}],
    )


def slid(wall, cells, end, coefficient, comm=None, speed=0.0, **method):
    """(way, way of a rigid block, acceleration over the last three quarters of the time, exact), m and s. Collective.

    The acceleration is that of v_x + mu v_y: the wall takes mu times what it gives, bounces included.
    """
    a, far = pull(coefficient), speed * end + 0.5 * pull(coefficient) * end**2
    simulation = pmpm.Simulation(scene(wall, cells, end, far, speed=speed, **method), comm)
    start = mean_place(simulation)
    simulation.run(until=0.25 * end)
    early, v = simulation.time, mean_velocity(simulation, coefficient)
    simulation.run()
    gained = (mean_velocity(simulation, coefficient) - v) / (simulation.time - early)
    return mean_place(simulation) - start, far, gained, a


def stuck(wall, cells, end, comm=None, laid=True, **method):
    """(way of the particles at the base after a third of the time, in cells, all of it). Collective."""
    simulation = pmpm.Simulation(scene(wall, cells, end, LENGTH, laid, **method), comm)
    X, x = by_id(simulation, "x")[0], []
    base = X[:, 1] == X[:, 1].min()
    for until in (end / 3.0, end):
        simulation.run(until=until)
        x.append(by_id(simulation, "x")[0][base, 0])
    dx = HEIGHT / cells
    return float((x[1] - x[0]).mean()) / dx, float((x[1] - X[base, 0]).mean()) / dx


def mean_place(simulation):
    return float(by_id(simulation, "x")[0][:, 0].mean())


def mean_velocity(simulation, coefficient):
    v = by_id(simulation, "velocity")[0].mean(axis=0)
    return float(v[0] + coefficient * v[1])


# ---- verification ------------------------------------------------------------------------------------------------------------

ENDS = {
    "tiny": (0.5, 0.25),
    "standard": (5.0, 1.0),
    "sweep": (5.0, 2.0),
}  # s, of blocks that slide along walls and that stay
CELLS = {"tiny": (4,), "standard": (4, 8), "sweep": (4, 8, 16)}
WAY, BALANCE, STAYS = 1e-3, 1e-6, 1e-3


def verify(size, comm):
    (long, short), rows = ENDS[size], []
    walls = {"friction, tan 15": (friction(15.0), COEFFICIENT), "slip": ("slip", 0.0), "separate": ("separate", 0.0)}
    cells = CELLS[size][0]
    for name, (wall, coefficient) in walls.items():
        end = long if coefficient > 0.0 else short
        speed = 1.0 if size == "tiny" else 0.0  # a block that moves from the start on is not held while it bounces
        way, exact, gained, a = slid(wall, cells, end, coefficient, comm, speed)
        rows.append((name, cells, f"{end:g}", f"{way:.5f}", f"{exact:.5f}", f"{gained / a - 1.0:.1e}"))
        yield at_most(f"{name}: error of the way after {end:g} s", abs(way / exact - 1.0), WAY, "a rigid block")
        yield at_most(f"{name}: error of the acceleration", abs(gained / a - 1.0), BALANCE, "Coulomb, at any time")
    for cells in CELLS[size]:
        for name, wall in {"friction, tan 30": friction(30.0), "stick": "stick"}.items():
            way, whole = stuck(wall, cells, short, comm)
            rows.append((f"{name}, laid", cells, f"{short:g}", f"{whole * HEIGHT / cells:.1e}", "0", ""))
            yield at_most(
                f"{name}, N = {cells}: way of the base after it came to rest, cells", abs(way), STAYS, "stays"
            )
            yield at_most(f"{name}, N = {cells}: all the way of the base, cells", abs(whole), STAYS, "stays")
        way, _ = stuck(friction(20.0), cells, short, comm)
        reason = "the same damping does not hold a block that must slide"
        yield at_least(f"friction, tan 20, N = {cells}: way of the base, cells", way, 10.0 * STAYS, reason)
        _, whole = stuck(friction(30.0), cells, short, comm, laid=False)
        rows.append(("friction, tan 30, let go", cells, f"{short:g}", f"{whole * HEIGHT / cells:.1e}", "0", ""))
    yield Table(
        "Ways on the plane", ("wall", "N", "t, s", "way, m", "of a rigid block, m", "error of the acceleration"), rows
    )


ABOUT = """
A block of 0.1 x 0.05 m (E = 1 MPa, nu = 0.3, rho0 = 1000, N cells along its height, cfl 0.5) on a plane inclined by 24
degrees: gravity is tilted. A rigid block slides by s = g t^2 (sin theta - mu cos theta) / 2. Here gravity is there at once
and the block bounces; while it hardly moves along the plane the wall takes less than mu times what it gives. That leaves an
error of the way that falls as 1 / t. The acceleration, of v_x + mu v_y after a quarter of the time, knows of no bounces.

`laid`: gravity grows over 0.1 s under a damping of 500 / s. Laid on a plane with mu = tan 30 the block stays; on one with
tan 20 it slides under the same damping. `let go`, without either, it bounces on and moves with every bounce, in the finer
grid by several cells, and its base comes to lie half a cell above the plane: contact through the grid begins before bodies
touch.

Planes oblique to the grid and the bead on a circular arc need colliders: not built.
"""

CASE = Case("V7", "Inclined plane with Coulomb friction", ABOUT, verify)
