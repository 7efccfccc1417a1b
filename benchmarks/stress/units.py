"""S12: the same scene in other units of length, mass and time gives the same answer."""

import math

import numpy as np

from .judge import follow
from .matrix import SINGLE, Case
from .scenes import box, by_id, simulation

STEPS = 300
# Units per metre, kilogram and second.


def one_at_a_time(power):
    """Units of length, mass or time alone that are 10^power times smaller or larger."""
    return {
        f"{name}*1e{sign * power:+d}": tuple(10.0 ** (sign * power) if name == other else 1.0 for other in "LMT")
        for name in "LMT"
        for sign in (-1, 1)
    }


UNITS = {"mm": (1e3, 1.0, 1.0), "km": (1e-3, 1.0, 1.0), "mm-N-s": (1e3, 1e-3, 1.0), **one_at_a_time(6)}
SINGLE_UNITS = one_at_a_time(3)
LIMIT = {"float64": 1e-10, "float32": 1e-3}  # of the largest displacement
SLOPE = math.radians(24.0)


def rubber(L, M, T, dim=2):
    """E = 1e6 Pa and 1000 kg/m3; in plane strain a mass is that per unit of thickness: kg/m, Pa = kg/(m s2)."""
    return {
        "model": "neo_hookean", "density": 1000.0 * M / L**3, "youngs_modulus": 1e6 * M / (L * T * T), "poisson_ratio": 0.3,
    }  # fmt: skip


def wave(scheme, L, M, T):
    """A standing wave in a periodic box, strain 0.1."""
    run = simulation(
        scheme, [1.6 * L, 0.8 * L], 0.1 * L, [box([0.0, 0.0], [1.6 * L, 0.8 * L])], rubber(L, M, T), periodic=["x", "y"]
    )
    x = run.particles.x / L
    v = np.zeros_like(x)
    v[:, 0] = 3.0 * np.sin(2.0 * math.pi * x[:, 0] / 1.6)
    run.particles.v = v * L / T
    return run


def bar(scheme, L, M, T):
    """A bar fixed at one end, free at the other."""
    run = simulation(
        scheme, [3.2 * L, 0.6 * L], 0.1 * L, [box([0.0, 0.0], [2.6 * L, 0.6 * L])], rubber(L, M, T),
        walls={"x_min": "stick", "y_min": "slip", "y_max": "slip"},
    )  # fmt: skip
    x = run.particles.x / L
    v = np.zeros_like(x)
    v[:, 0] = np.sin(0.5 * math.pi * x[:, 0] / 2.6)
    run.particles.v = v * L / T
    return run


def slide(scheme, L, M, T):
    """A block that slides down a slope with friction."""
    pull = 9.81 * L / (T * T)
    return simulation(
        scheme, [0.6 * L, 0.1 * L], 0.0125 * L, [box([0.05 * L, 0.0], [0.15 * L, 0.05 * L], velocity=[1.0 * L / T, 0.0])],
        rubber(L, M, T), gravity=[pull * math.sin(SLOPE), -pull * math.cos(SLOPE)],
        walls={"y_min": {"type": "friction", "coefficient": math.tan(math.radians(15.0))}},
    )  # fmt: skip


SCENES = {"wave": wave, "bar": bar, "slide": slide}


def scaled(scheme, variant):
    name, units = variant.split(", ")
    L, M, T = (UNITS | SINGLE_UNITS)[units]
    reference = SCENES[name](scheme, 1.0, 1.0, 1.0)
    (start,) = by_id(reference, "x")
    follow(reference, steps=STEPS)
    run = SCENES[name](scheme, L, M, T)
    found = follow(run, steps=STEPS)
    (x,), (expected,) = by_id(run, "x"), by_id(reference, "x")
    moved = expected - start
    size = np.array(reference.scene.domain.size)
    periodic = np.array(["xyz"[axis] in reference.scene.domain.periodic for axis in range(2)])
    moved, apart = (np.where(periodic, d - size * np.rint(d / size), d) for d in (moved, x / L - expected))
    difference = float(np.abs(apart).max() / np.abs(moved).max())
    found.numbers["difference"] = difference
    found.claim(
        difference <= LIMIT[scheme.precision], f"differs from the scene in SI by more than {LIMIT[scheme.precision]:g}"
    )
    found.claim(run.step_count == reference.step_count, "another number of steps")
    return found


CASES = (
    Case(
        "S12", "units", "a standing wave, a fixed bar and a sliding block in other units",
        tuple(f"{s}, {u}" for s in SCENES for u in UNITS),
        scaled,
    ),
    Case(
        "S12", "units, float32", "the same, units a thousand times smaller or larger one at a time",
        tuple(f"{s}, {u}" for s in SCENES for u in SINGLE_UNITS), scaled, schemes=SINGLE,
    ),
)  # fmt: skip
