"""S9, S10, S14: particles at walls, corners and nodes; few and many in a cell; and far from the origin."""

import os
import tempfile
from pathlib import Path

import numpy as np

from .judge import follow
from .matrix import DEFAULT, DOUBLE, SINGLE, STOPPED, SURVIVES, Case, Scheme
from .scenes import box, by_id, disk, simulation, solid

CELL = 0.1

# ---- S9 ------------------------------------------------------------------------------------------------------------------

PRESSED = 0.5  # m/s, against the wall; waves run at 37 m/s
WALLS = ("stick", "slip", "separate", "friction", "free")
POSITIONS = ("lower corner", "upper corner", "on nodes")


def at_walls(scheme, variant):
    """A block whose outermost particles lie exactly on two walls, or all on nodes, pressed into the corner."""
    kind, position = variant.split(", ")
    wall = {"type": "friction", "coefficient": 0.4} if kind == "friction" else kind
    per_cell = 1 if position == "on nodes" else 4
    run = simulation(
        scheme, [2.0, 1.6], CELL, [box([0.6, 0.5], [1.2, 1.1], particles_per_cell=per_cell)], solid(),
        walls=dict.fromkeys(("x_min", "x_max", "y_min", "y_max"), wall),
    )  # fmt: skip
    x = run.particles.x
    toward = -1.0
    if position == "upper corner":
        x, toward = x - x.max(axis=0) + run.scene.domain.size, 1.0
    else:
        x = x - x.min(axis=0)
    run.particles.x = x
    run.particles.v = np.full_like(x, toward * PRESSED)
    return follow(run, steps=2000)


def outside(scheme, variant):
    """Refused when particles are assigned, or seeded, where there is no domain."""
    keys = {"displacement": [0.9, 0.0]} if variant == "displacement" else {}
    run = simulation(scheme, [2.0, 1.6], CELL, [box([0.6, 0.5], [1.2, 1.1], **keys)], solid())
    found = follow(run, steps=1)
    try:
        run.particles.x = run.particles.x + [2.0, 0.0]
    except ValueError as error:
        found.message = f"refused: {error}"
    return found


# Kernels with bounds checks have a cache of their own; the plain loops are those that numba can check.
CHECKED = {
    "NUMBA_BOUNDSCHECK": "1", "PMPM_LOOPS": "scalar",
    "PMPM_CACHE_DIR": str(Path(os.environ.get("PMPM_CACHE_DIR", tempfile.gettempdir())) / "bounds_checked"),
}  # fmt: skip

# ---- S10 -----------------------------------------------------------------------------------------------------------------

FILLINGS = ("1 per cell", "1 per cell, jittered", "7 per cell, random", "16 per cell", "voids")


def filled(scheme, variant):
    """A block that falls on its corner region of the floor at a tenth of its wave speed, spinning."""
    body = box([0.8, 0.2], [1.6, 1.0], velocity=[0.5, -3.0])
    body["particles_per_cell"] = 4 if variant == "voids" else int(variant.split()[0])
    if variant == "voids":
        middles = [[0.95 + 0.25 * i, 0.35 + 0.25 * j] for i in range(3) for j in range(3)]
        body["shape"] = {"type": "difference", "of": [body["shape"], *(disk(x, 0.1)["shape"] for x in middles)]}
    run = simulation(scheme, [2.4, 2.4], CELL, [body], solid())
    if variant.endswith("jittered"):
        random = np.random.default_rng(0)
        run.particles.x = run.particles.x + CELL * (random.random((run.rows(), 2)) - 0.5)
    return follow(run, steps=3000)


# ---- S14 -----------------------------------------------------------------------------------------------------------------

FAR = {"1e4 cells along x": ((10_000, 0), 200), "1e4 cells along x and y": ((10_000, 10_000), 200)}
VERY_FAR = {"1e6 cells along x": ((1_000_000, 0), 20)}


def noisy_block(scheme, away, steps):
    """A block of 12 x 8 cells, so many cells from where it is near the origin, in noisy flight."""
    shift = 0.01 * np.array(away)
    body = box(shift + [0.3, 0.03], shift + [0.42, 0.11], velocity=[12.0, 0.2])
    run = simulation(scheme, shift + [0.8, 0.16], 0.01, [body], solid())
    noise = np.random.default_rng(0).normal(size=run.particles.v.shape)
    run.particles.v = run.particles.v + 0.5 * noise
    return run, follow(run, steps=steps, looks=steps // 20)


def far(scheme, variant):
    """The same bits as near by: no error can be larger."""
    away, steps = (FAR | VERY_FAR)[variant]
    (near, _), (run, found) = noisy_block(scheme, (0, 0), steps), noisy_block(scheme, away, steps)
    if not found.message:
        differ = [name for name in ("v", "F") if not np.array_equal(by_id(near, name), by_id(run, name))]
        (a, b) = (r.populations[0].cells(r.geometry.axes)[1] for r in (near, run))
        found.numbers["different bits"] = ", ".join(differ + ([] if np.array_equal(a, b) else ["places"])) or "none"
        found.claim(found.numbers["different bits"] == "none", "other bits than near the origin")
    return found


PLACED = tuple(f"{wall}, {position}" for wall in WALLS for position in POSITIONS)
EXPECT = {v: SURVIVES + STOPPED for v in PLACED if v.startswith("free")}
CASES = (
    Case("S9", "walls", "particles exactly on walls, in corners, on nodes, pressed into a corner", PLACED, at_walls, EXPECT),
    Case("S9", "outside", "particles beyond the walls", ("assigned", "displacement"), outside, STOPPED, DEFAULT),
    Case(
        "S9", "bounds checked", "the same with kernels that check every index", PLACED, at_walls, EXPECT,
        (Scheme("apic", "quadratic"), Scheme("mls", "cubic")), limit=300.0, environment=CHECKED,
    ),
    Case("S10", "filling", "a block with few, many, random particles per cell, and with holes", FILLINGS, filled),
    Case("S14", "far", "noisy flight far from the origin: the same bits as near it", tuple(FAR), far, schemes=DOUBLE + SINGLE),
    Case(
        "S14", "very far", "the same in a domain of a million cells", tuple(VERY_FAR), far,
        schemes=(Scheme("apic", "quadratic"), Scheme("apic", "quadratic", "float32")), limit=300.0,
    ),
)  # fmt: skip
