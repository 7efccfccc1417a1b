"""S13: a hundred thousand steps: a rotating disk, a resting column, a pile of sand."""

import numpy as np

from .judge import follow
from .matrix import Case
from .scenes import box, by_id, root_mean_square, simulation, solid
from .solids import spinning_disk

STEPS, SETTLING = 100_000, 20_000
LOOKS = 1000
ANGULAR, VOLUME, CREEP = 1e-10, 0.005, 0.1  # relative, relative, cells


def disk(scheme, variant):
    """L is conserved by APIC and MLS alone, to round-off; volume by none exactly."""
    run, _ = spinning_disk(scheme, solid(), 0.05, radius=0.2, spin=5.0)
    before, volume = run.measure()["angular_momentum_z"], float(run.particles.volume.sum())
    found = follow(run, steps=STEPS, looks=LOOKS)
    if not found.message:
        F = run.particles.F.astype(float)
        drift = abs(run.measure()["angular_momentum_z"] / before - 1.0)
        grown = float(run.particles.volume.sum()) / volume - 1.0
        found.numbers = {
            "drift of L": drift, "change of volume": grown, "turns": 5.0 * run.time / (2.0 * np.pi),
            "F^T F - I": root_mean_square(np.swapaxes(F, 1, 2) @ F - np.eye(2)),
        }  # fmt: skip
        found.claim(abs(grown) <= VOLUME, "volume drifts by more than 0.5 %")
        if scheme.transfer in ("apic", "mls") and not scheme.linear:
            found.claim(drift <= ANGULAR, "angular momentum drifts by more than 1e-10")
    return found


def at_rest(scheme, bodies, material, size, cell, **keys):
    """Follow a scene that is to stay as it is: what particles move after it has settled, and what volume changes."""
    run = simulation(scheme, size, cell, bodies, material, **keys)
    volume = float(run.particles.volume.sum())
    found = follow(run, steps=SETTLING, looks=LOOKS // 5)
    if not found.message:
        (settled,) = by_id(run, "x")
        rest = follow(run, steps=STEPS, looks=LOOKS)
        rest.energy = max(found.energy, rest.energy)
        found = rest
    if not found.message:
        (x,) = by_id(run, "x")
        creep = float(np.linalg.norm(x - settled, axis=1).max()) / cell
        grown = float(run.particles.volume.sum()) / volume - 1.0
        found.numbers = {"creep, cells": creep, "change of volume": grown, "largest speed": run.measure()["max_speed"]}
        found.claim(creep <= CREEP, "creeps by more than 0.1 cells")
        found.claim(abs(grown) <= VOLUME, "volume drifts by more than 0.5 %")
    return found


def column(scheme, variant):
    dx = 0.05
    return at_rest(
        scheme, [box([0.0, 0.0], [3 * dx, 10 * dx], stress={"type": "geostatic"})], solid(), [3 * dx, 14 * dx], dx,
        gravity=[0.0, -9.81], walls={"x_min": "slip", "x_max": "slip", "y_min": "slip"},
    )  # fmt: skip


def pile(scheme, variant):
    """A trapezoid of 30 degrees of sand with a friction angle of 35."""
    dx = 0.025
    sand = solid("drucker_prager", density=1500.0, youngs_modulus=1e6, friction_angle=35.0)
    steps = [box([(4 + 1.75 * n) * dx, n * dx], [(24 - 1.75 * n) * dx, (n + 1) * dx]) for n in range(5)]
    heap = {"material": "m", "shape": {"type": "union", "of": [part["shape"] for part in steps]}}
    return at_rest(
        scheme, [heap], sand, [28 * dx, 8 * dx], dx, gravity=[0.0, -9.81], walls={"y_min": "stick"},
        method={"damping": 2.0},
    )  # fmt: skip


CASES = (
    Case("S13", "disk", f"a free disk of 4 cells radius turns for {STEPS} steps", ("1e5 steps",), disk, limit=600.0),
    Case("S13", "column", "a resting column of rubber, 3 x 10 cells", ("1e5 steps",), column, limit=600.0),
    Case("S13", "pile", "a pile of sand, 5 cells high, with damping", ("1e5 steps",), pile, limit=600.0),
)
