"""S6: snow between slip walls crushed to a tenth of its height by a platen."""

import numpy as np

from .judge import follow
from .matrix import DOUBLE, SINGLE, STOPPED, SURVIVES, Case
from .scenes import box, simulation, solid

CELL, HEIGHT, WIDTH, SPEED = 0.02, 0.32, 0.08, 1.0
MOST_STEPS = 40_000  # stiffened e^22-fold, snow allows steps so short that the platen never arrives
TARGETS = (0.8, 0.5, 0.3, 0.1)


def crush(scheme, variant):
    """The work of the platen is not known, so that energy is not judged."""
    snow = solid(
        "snow", density=400.0, youngs_modulus=1.4e5, poisson_ratio=0.2, hardening=float(variant.removeprefix("xi="))
    )
    platen = {"type": "box", "min": [0.0, HEIGHT - CELL], "max": [WIDTH, 1.5 * HEIGHT]}
    end = (1.0 - TARGETS[-1]) * HEIGHT / SPEED
    run = simulation(
        scheme, [WIDTH, 1.5 * HEIGHT], CELL, [box([0.0, 0.0], [WIDTH, HEIGHT])], snow, time={"end": end},
        walls={"x_min": "slip", "x_max": "slip", "y_min": "slip"},
        motions=[{"shape": platen, "velocity": [0.0, -SPEED]}],
    )  # fmt: skip
    first = run.dt
    found = follow(run, steps=MOST_STEPS, with_energy=False)
    reached = 1.0 - SPEED * run.time / HEIGHT
    found.numbers = {"height": reached, "dt shrank": first / found.smallest_dt}
    if not found.message:
        found.numbers["J"] = float(np.median(run.particles.J))
        found.numbers["stopped by its number of steps"] = not run.finished
    return found


EXPECT = {"xi=25": SURVIVES + STOPPED, "xi=50": SURVIVES + STOPPED, "xi=90": STOPPED}
CASES = (
    Case(
        "S6", "snow crush", f"to a tenth of the height, or for {MOST_STEPS} steps, with more and more hardening",
        ("xi=5", "xi=10", "xi=25", "xi=50", "xi=90"), crush, EXPECT,
        DOUBLE + SINGLE,
    ),
)  # fmt: skip
