"""S15, S18, S20: huge gravity, bursting and tearing; fluids under tension; sand at the tip of its cone."""

import numpy as np

from .judge import follow
from .matrix import STOPPED, SURVIVES, Case
from .scenes import box, set_in_motion, simulation, solid, wave_speed
from .solids import spinning_disk

CELL, STEPS = 0.1, 3000
RUBBER = solid()

# ---- S15 -----------------------------------------------------------------------------------------------------------------


def heavy(scheme, variant):
    """g = 1e4 m/s2 on a block whose weight then is eight times its modulus."""
    run = simulation(scheme, [2.4, 2.4], CELL, [box([0.8, 0.0], [1.6, 0.8])], RUBBER, gravity=[0.0, -1e4])
    return follow(run, steps=STEPS)


def burst(scheme, variant):
    """A disk that turns so fast that its rim moves at three times the wave speed."""
    run, _ = spinning_disk(scheme, RUBBER, 0.05, radius=0.4, spin=3.0 * wave_speed(RUBBER) / 0.4, size=8.0)
    return follow(run, steps=STEPS)


def stretch(scheme, variant):
    """A free block that starts stretched 1e3 : 1 along x, 1 : 1e3 along y."""
    run = simulation(scheme, [6.4, 6.4], CELL, [box([2.8, 2.8], [3.6, 3.6])], RUBBER)
    run.particles.F = np.tile(np.diag([1e3, 1e-3]), (run.rows(), 1, 1))
    return follow(run, steps=STEPS)


def needle(scheme, variant):
    """A bar of 12 x 2 cells torn along itself until particles lie cells apart: numerical fracture."""
    run = simulation(scheme, [12.8, 2.0], CELL, [box([5.8, 0.9], [7.0, 1.1])], RUBBER)
    rate = 2.0 * wave_speed(RUBBER) / 1.2
    set_in_motion(run, [6.4, 1.0], [[rate, 0.0], [0.0, 0.0]])
    found = follow(run, steps=STEPS)
    if not found.message:
        x = np.sort(run.particles.x[:, 0])
        found.numbers = {
            "length, of the first": float(np.ptp(x)) / 1.2,
            "largest gap, cells": float(np.diff(x).max()) / CELL,
        }
    return found


EXTREMES = {"g = 1e4": heavy, "spin to burst": burst, "stretch 1e3:1": stretch, "needle": needle}

# ---- S18 -----------------------------------------------------------------------------------------------------------------


def tension(scheme, variant):
    """A square of fluid that flies apart, v = a r, until without stress its volume would be tenfold."""
    gamma, cutoff = variant.split(", ")
    fluid = {
        "model": "fluid", "density": 1000.0, "sound_speed": 10.0, "gamma": float(gamma.removeprefix("gamma=")),
        "tension_cutoff": cutoff == "no tension",
    }  # fmt: skip
    run = simulation(scheme, [6.4, 6.4], CELL, [box([2.7, 2.7], [3.7, 3.7])], fluid)
    rate = 10.0
    set_in_motion(run, [3.2, 3.2], [[rate, 0.0], [0.0, rate]])
    volume = float(run.particles.volume.sum())
    found = follow(run, until=(np.sqrt(10.0) - 1.0) / rate)
    J = run.particles.J
    grown = float(run.particles.volume.sum()) / volume
    found.numbers = {"volume": grown, "smallest J": float(J.min()), "largest J": float(J.max())}
    return found


# ---- S20 -----------------------------------------------------------------------------------------------------------------

SANDS = {
    "cohesionless": {"friction_angle": 30.0},
    "no friction": {"friction_angle": 0.0},
    "no friction, cohesion": {"friction_angle": 0.0, "cohesion": 1e4},
    "large cohesion": {"friction_angle": 30.0, "cohesion": 1e8},
    "dilatant": {"friction_angle": 40.0, "dilatancy_angle": 40.0},
}


def sand_column(scheme, variant):
    """A column on a floor without friction."""
    sand = solid("drucker_prager", density=1500.0, **SANDS[variant])
    run = simulation(
        scheme, [4.8, 1.2], CELL, [box([2.0, 0.0], [2.8, 0.8])], sand, gravity=[0.0, -9.81], walls={"y_min": "slip"},
    )  # fmt: skip
    return follow(run, steps=2 * STEPS)


def tossed(scheme, variant):
    """Free sand that shears and opens: zero shear and the tip in the same body."""
    sand = solid("drucker_prager", density=1500.0, **SANDS[variant])
    run = simulation(scheme, [4.0, 4.0], CELL, [box([1.6, 1.6], [2.4, 2.4])], sand)
    set_in_motion(run, [2.0, 2.0], [[0.5, 2.0], [0.0, -0.5]])
    return follow(run, steps=STEPS)


TENSIONS = tuple(f"gamma={gamma}, {cutoff}" for gamma in (7, 1) for cutoff in ("no tension", "tension"))
CASES = (
    *(
        Case("S15", name, function.__doc__.rstrip("."), ("run",), function, SURVIVES + STOPPED)
        for name, function in EXTREMES.items()
    ),
    Case(
        "S18", "tension", "a square of fluid flies apart", TENSIONS,
        tension,
    ),
    Case("S20", "sand column", "on a floor without friction", tuple(SANDS), sand_column),
    Case("S20", "sand tossed", "free, sheared and opened", tuple(SANDS), tossed),
)  # fmt: skip
