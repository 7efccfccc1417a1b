"""A bar or a layer of fluid that runs into a rigid wall: waves and shocks, exact by Rankine and Hugoniot.

Cold material at the speed V stops at the wall x = 0, a plane front runs back into it with the speed W against the material.
Mass and momentum across the front, in uniaxial strain F with P(F) = P_xx = sigma_xx:

    1 - F1 = V / W          -P(F1) = rho0 V W          so that  -P(F1) (1 - F1) = rho0 V^2

which bisection solves for F1; W -> c for V -> 0. In the frame of the wall the front is at x = (W - V) t. A fixed corotated
solid is linear in uniaxial strain: F1 = 1 - V / c, so that at V >= c it would be inverted. A bar that moves along the wall and
sticks to it sends a shear wave instead.
"""

import math
from dataclasses import dataclass

import numpy as np

import pmpm
from cases import Case, Table, at_most, between, holds
from cases.column import Column
from cases.gathered import by_id

WIDTH = 6  # cells across, periodic
REACH = 0.6  # of the bar is behind the front at the end


@dataclass(frozen=True)
class Impact:
    """A speed, in speeds of sound, of a material at rest; a negative one moves along the wall."""

    material: Column
    mach: float
    shears: bool = False

    @property
    def sound(self):
        modulus = self.material.lame[0] if self.shears else self.material.wave_modulus
        return math.sqrt(modulus / self.material.density)

    @property
    def speed(self):
        return self.mach * self.sound

    @property
    def stretch(self):
        """F1 behind the front, nan where none above zero will do."""
        if self.shears:
            return 1.0
        needed, material = self.material.density * self.speed**2, self.material
        low, high = 1e-9, 1.0 - 1e-12

        def too_little(F):
            return -float(material.stress(np.array(F))) * (1.0 - F) < needed

        if too_little(low):
            return math.nan
        for _ in range(100):
            middle = 0.5 * (low + high)
            low, high = (low, middle) if too_little(middle) else (middle, high)
        return high

    @property
    def front_speed(self):
        """W against the material, m/s."""
        return self.sound if self.shears else self.speed / (1.0 - self.stretch)

    @property
    def stress(self):
        """sigma_xx behind the front, of a shear wave sigma_xy, Pa."""
        return -self.material.density * self.speed * self.front_speed


def solid(model):
    return Column(model, 1e6, 0.3, 1000.0, 0.0, 1.0)


WATER = Column("fluid", 1e6, 0.0, 1000.0, 0.0, 1.0)


def scene(impact, cells, viscosity=None, **method):
    """`cells` along the bar, which touches the wall at the start; it is all over before the front comes to the free end."""
    length, material = impact.material.length, impact.material.material
    dx = length / cells
    front = impact.front_speed if math.isfinite(impact.stretch) else impact.speed
    if viscosity is not None:
        material = material | {"viscosity": viscosity * impact.material.density * impact.sound * dx}
    return pmpm.Scene(
        domain={
            "size": [length + 4.0 * dx, WIDTH * dx],
            "cell_size": dx,
            "walls": {"x_min": "stick" if impact.shears else "slip"},
            "periodic": ["y"],
        },
        method=method,
        time={"end": REACH * length / front},
        materials={"material": material},
        bodies=[
            {
                "material": "material",
                "shape": {"type": "box", "min": [0.0, 0.0], "max": [length, WIDTH * dx]},
                "velocity": [0.0, -impact.speed] if impact.shears else [-impact.speed, 0.0],
            }
        ],
        exact={"displacement": displacement(impact)} if math.isfinite(impact.stretch) else None,
    )


def displacement(impact):
    """u(X, t)."""
    axis, W, V = int(impact.shears), impact.front_speed, impact.speed

    def u(X, t):
        moved = np.zeros_like(X)
        moved[:, axis] = -V * np.minimum(t, X[:, 0] / W)
        return moved

    return u


def profile(simulation, axis):
    """(X, x, |v|) of the columns of particles, means across the bar. Collective."""
    X, x, v = by_id(simulation, "X", "x", "velocity")
    places, column = np.unique(np.round(X[:, 0], 12), return_inverse=True)
    count = np.bincount(column)
    return places, np.bincount(column, x[:, 0]) / count, np.abs(np.bincount(column, v[:, axis]) / count)


def front(x, speeds, speed):
    """Where the outermost column that has lost half of its speed ends, by interpolation between columns at x."""
    slow = np.flatnonzero(speeds < 0.5 * speed)
    if len(slow) == 0 or slow[-1] == len(x) - 1:
        return math.nan
    k = slow[-1]
    return float(np.interp(0.5 * speed, speeds[k : k + 2], x[k : k + 2]))


def measured(impact, cells, comm=None, **keys):
    """What a run shows, against the exact values. Collective. Raises NumericalFailure.

    speed: of the front in the second half of the run, relative; cells: the front is ahead by so many; allowed: as many as one
    and 2 % of the way; stress: of the plateau, sum J sigma / sum J, relative (the mean over space, which momentum asks for);
    noise: its deviation; overshoot: the largest stress, relative.
    """
    simulation = pmpm.Simulation(scene(impact, cells, **keys), comm)
    end, seen = simulation.scene.time.end, []
    for until in (0.5 * end, end):
        simulation.run(until=until)
        X, x, speeds = profile(simulation, int(impact.shears))
        seen.append((simulation.time, front(X, speeds, impact.speed)))
    (t0, X0), (t, X1) = seen
    W, dx = impact.front_speed, impact.material.length / cells
    exact = (W - (0.0 if impact.shears else impact.speed)) * t
    X, J, sigma = by_id(simulation, "X", "J", "stress")
    stress = np.abs(sigma[:, 3 if impact.shears else 0]) / abs(impact.stress)
    plateau = (X[:, 0] > 0.1 * X1) & (X[:, 0] < 0.8 * X1)
    return {
        "speed": (X1 - X0) / (t - t0) / W - 1.0,
        "cells": (front(x, speeds, impact.speed) - exact) / dx,
        "allowed": 1.0 + 0.02 * exact / dx,
        "stress": float((J * stress)[plateau].sum() / J[plateau].sum()) - 1.0,
        "noise": float(stress[plateau].std()),
        "overshoot": float(stress[X[:, 0] < X1].max()) - 1.0,
        "lowest J": float(J.min()),
        "steps": simulation.step_count,
    }


def crushed(impact, cells, comm=None):
    """(lowest J, highest energy over that at the start, nothing but numbers) of an impact without a shock."""
    simulation = pmpm.Simulation(scene(impact, cells), comm)
    first, highest = simulation.measure()["kinetic"], 0.0
    for part in range(1, 21):
        simulation.run(until=part / 20.0 * simulation.scene.time.end)
        found = simulation.measure()
        highest = max(highest, (found["kinetic"] + found["strain"]) / first)
    J, x, v = by_id(simulation, "J", "x", "velocity")
    return float(J.min()), highest, all(bool(np.isfinite(values).all()) for values in (J, x, v))


# ---- verification ------------------------------------------------------------------------------------------------------------

FAINT = 1e-3  # of the speed of sound
CELLS = {"tiny": 100, "standard": 200, "sweep": 400}
SHOCKS = {
    "neo_hookean": (0.1, 0.5, 0.9, 2.0),
    "fixed_corotated": (0.5, 0.9),
    "hencky": (0.5, 2.0),
    "fluid": (0.1, 0.5, 1.0, 2.0, 5.0),
}
TINY_SHOCKS = {"neo_hookean": (0.5, 2.0), "fluid": (0.5, 2.0)}
BEYOND = (1.0, 1.1, 2.0, 5.0)  # of a fixed corotated solid
SMOOTHED = {
    "fluid": (
        {"transfer": "pic"}, {"transfer": "flip"}, {"transfer": "mls"}, {"shape_function": "cubic"},
        {"viscosity": 0.5}, {"viscosity": 2.0},
    ),
    "neo_hookean": ({"transfer": "pic"}, {"transfer": "flip"}, {"transfer": "mls"}, {"shape_function": "cubic"}),
}  # fmt: skip
HEAD = ("law", "V / c", "scheme", "W / c exact", "speed of the front", "ahead, cells", "stress", "noise", "overshoot",
        "lowest J", "steps")  # fmt: skip


def material(law):
    return WATER if law == "fluid" else solid(law)


def row(law, impact, scheme, found):
    shown = [f"{found[key]:+.2%}" for key in ("speed",)] + [f"{found['cells']:+.2f}"]
    shown += [f"{found['stress']:+.2%}", f"{found['noise']:.1%}", f"{found['overshoot']:.0%}", found["lowest J"]]
    return law, f"{impact.mach:g}", scheme, impact.front_speed / impact.sound, *shown, str(found["steps"])


def verify(size, comm):
    cells, rows = CELLS[size], []
    for law in ("neo_hookean", "fluid") if size == "tiny" else SHOCKS:
        for shears in (False,) if law == "fluid" else (False, True):
            impact = Impact(material(law), FAINT, shears)
            found = measured(impact, max(cells, 100), comm)
            rows.append(row(law, impact, "shear wave" if shears else "wave", found))
            what = f"{law}: speed of a {'shear wave' if shears else 'wave'} / c - 1"
            yield between(what, found["speed"], -0.01, 0.01, "linear waves")
    for law, numbers in (TINY_SHOCKS if size == "tiny" else SHOCKS).items():
        for mach in numbers:
            impact = Impact(material(law), mach)
            found = measured(impact, cells, comm)
            rows.append(row(law, impact, "apic", found))
            what = f"{law}, V = {mach:g} c, N = {cells}:"
            yield between(f"{what} stress behind / exact - 1", found["stress"], -0.02, 0.02, "momentum over the front")
            reason = "a cell and 2 % of the way"
            yield at_most(f"{what} cells from the exact place", abs(found["cells"]), found["allowed"], reason)
    for mach in () if size == "tiny" else BEYOND:
        lowest, energy, finite = crushed(Impact(solid("fixed_corotated"), mach), cells, comm)
        what = f"fixed_corotated, V = {mach:g} c, no shock:"
        yield holds(f"{what} all is finite", finite, "the law is defined at any F")
        yield at_most(f"{what} highest energy / first", energy, 1.05, "nothing is gained")
        rows.append(("fixed_corotated", f"{mach:g}", "apic", "none", *[""] * 5, lowest, ""))
    for law, schemes in () if size == "tiny" else SMOOTHED.items():
        impact = Impact(material(law), 0.5)
        for keys in schemes:
            scheme = ", ".join(
                f"{value} rho c dx viscosity" if k == "viscosity" else value for k, value in keys.items()
            )
            rows.append(row(law, impact, scheme, measured(impact, cells, comm, **keys)))
    yield Table(f"Fronts, N = {cells}, of waves at least 100", HEAD, rows)


ABOUT = """
A bar, or a layer of fluid (gamma = 7), at the speed V runs into a rigid wall: a plane front runs back, F1 and W from -P(F1)
(1 - F1) = rho0 V^2 and W = V / (1 - F1) (Rankine and Hugoniot; mechanical jump conditions, the laws know no heat). At V =
0.001 c it is a wave of speed c; a bar that moves along a wall it sticks to sends a shear wave. Measured: speed of the front
in the second half of the run, its place at the end, where half of the speed is lost, mean stress over 0.1 to 0.8 of the
way.

The mean is over space, sum J sigma / sum J. Behind a strong shock particles keep oscillating, and as p(J) is convex their
mean over mass lies above the exact pressure: by 5 % in a fluid at V = 5 c, where the mean over space is off by 1 %. The
oscillations are what is left of the energy that a real shock turns into heat. There is no artificial viscosity of the kind
of von Neumann and Richtmyer (not built): PIC, or a fluid's `viscosity`, take them away. A fixed corotated solid at V >= c
has no shock. It is crushed to a J that is zero but for 1e-20 and less, of either sign, finite and without a gain of energy.
"""

CASE = Case("V5", "Waves and impact shocks", ABOUT, verify)
