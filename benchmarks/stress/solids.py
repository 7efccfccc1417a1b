"""S1 to S3: a cube that drops at any stiffness, nearly incompressible bodies, and bodies of unequal density or stiffness."""

import math

import numpy as np

from .judge import follow
from .matrix import DOUBLE, SINGLE, Case
from .scenes import box, by_id, disk, lame, root_mean_square, set_in_motion, simulation, solid, wave_speed

CFL = 0.4
FOLLOWS = 0.2  # how far cfl dx / (c sqrt d) may be from the step that is taken

# ---- S1 ------------------------------------------------------------------------------------------------------------------

EDGE, FALL, PASSES = 0.1, 1.0, 30.0  # m, m/s, passings of a wave through the cube


def drop(scheme, variant):
    material = solid(youngs_modulus=float(variant.removeprefix("E=")))
    c, dx = wave_speed(material), EDGE / 8.0
    run = simulation(
        scheme, [3.0 * EDGE] * 3, dx, [box([EDGE, 0.0, EDGE], [2 * EDGE, EDGE, 2 * EDGE], velocity=[0.0, -FALL, 0.0])],
        material, gravity=[0.0, -9.81, 0.0],
    )  # fmt: skip
    fastest = []

    def upward(run):
        fastest.append(float(run.particles.v[:, 1].mean()))

    found = follow(run, until=PASSES * EDGE / c, each=upward)
    found.numbers = {
        "mach": FALL / c,
        "rebound": max(fastest, default=0.0) / FALL,
        "dt c / dx": found.smallest_dt * c / dx,
    }
    return found


# ---- S2 ------------------------------------------------------------------------------------------------------------------

RATIOS = ("nu=0.3", "nu=0.45", "nu=0.49", "nu=0.499", "nu=0.4999")
LENGTH, CELLS, GRAVITY = 10.0, 16, 9.81
SPIN, RADIUS, SPINNING_STEPS = 5.0, 0.2, 3000


def follows_waves(found, c, dx, start):
    """Claim that the step taken at the `start` (s) is that of waves of speed c in 2-D."""
    ratio = start * c * math.sqrt(2.0) / dx
    found.numbers["dt c sqrt(2) / dx"] = ratio
    found.claim(abs(ratio / CFL - 1.0) < FOLLOWS, "dt does not follow the wave speed")


def strains_under_weight(material, depths):
    """F_yy of a confined neo-Hookean column under `depths` (m) of itself: mu (F - 1/F) + lam ln F / F = -rho g depth."""
    mu, lam = lame(material)
    F = np.ones_like(depths)
    for _ in range(50):
        stress = mu * (F - 1.0 / F) + lam * np.log(F) / F
        F -= (stress + material["density"] * GRAVITY * depths) / (mu * (1.0 + F**-2) + lam * (1.0 - np.log(F)) / F**2)
    return F


def column(scheme, variant):
    material = solid(poisson_ratio=float(variant.removeprefix("nu=")))
    c, dx = wave_speed(material), LENGTH / CELLS
    period = 4.0 * LENGTH / c
    run = simulation(
        scheme, [3.0 * dx, LENGTH + 2.0 * dx], dx, [box([0.0, 0.0], [3.0 * dx, LENGTH])], material,
        time={"ramp": 8.0 * period}, method={"damping": 1.64 / period}, gravity=[0.0, -GRAVITY],
        walls={"x_min": "slip", "x_max": "slip", "y_min": "slip"},
    )  # fmt: skip
    (X,) = by_id(run, "x")
    start = run.dt
    found = follow(run, until=16.0 * period)
    if not found.message:
        (x,) = by_id(run, "x")
        middles = (np.arange(20_000) + 0.5) * LENGTH / 20_000
        heights = np.append(0.0, np.cumsum(strains_under_weight(material, LENGTH - middles)) * LENGTH / 20_000)
        exact = np.interp(X[:, 1], np.linspace(0.0, LENGTH, 20_001), heights)
        weight = material["density"] * GRAVITY
        stress = np.asarray(run.particles.stress, float)[np.argsort(run.particles.id)]
        found.numbers = {
            "settlement error": root_mean_square(x[:, 1] - exact) / root_mean_square(X[:, 1] - exact),
            "stress error": root_mean_square(stress[:, 1] + weight * (LENGTH - X[:, 1])) / (weight * LENGTH),
        }
    follows_waves(found, c, dx, start)
    return found


def spinning_disk(scheme, material, cell_size, radius=RADIUS, spin=SPIN, size=3.0, **keys):
    """A free disk in the middle of `size` radii that turns as a rigid body."""
    center = [0.5 * size * radius] * 2
    run = simulation(scheme, [size * radius] * 2, cell_size, [disk(center, radius)], material, **keys)
    set_in_motion(run, center, [[0.0, -spin], [spin, 0.0]])
    return run, center


def shape_error(run, center, before):
    """Root mean square of what distances from the middle have changed, in cells."""
    (x,) = by_id(run, "x")
    middle = x.mean(axis=0)
    radii, radii_before = (np.linalg.norm(places - about, axis=1) for places, about in ((x, middle), (before, center)))
    return root_mean_square(radii - radii_before) / run.scene.domain.cell_size


def turning_disk(scheme, variant):
    material = solid(poisson_ratio=float(variant.removeprefix("nu=")))
    dx = RADIUS / 8.0
    run, center = spinning_disk(scheme, material, dx)
    (before,) = by_id(run, "x")
    L0, start = run.measure()["angular_momentum_z"], run.dt
    found = follow(run, steps=SPINNING_STEPS)
    scale = material["density"] * (SPIN * RADIUS) ** 2
    if not found.message:
        pressure = run.fields(["pressure"])["pressure"]
        found.numbers = {
            "turns": SPIN * run.time / (2.0 * math.pi),
            "shape error, cells": shape_error(run, center, before),
            "L": run.measure()["angular_momentum_z"] / L0,
            "pressure noise": root_mean_square(pressure - pressure.mean()) / scale,
        }
    follows_waves(found, wave_speed(material), dx, start)
    return found


# ---- S3 ------------------------------------------------------------------------------------------------------------------

STACKS = {
    "heavy on light, 1e2": ((1e3, 1e8), (1e5, 1e8)),
    "heavy on light, 1e4": ((1e3, 1e8), (1e7, 1e8)),
    "light on heavy, 1e2": ((1e5, 1e8), (1e3, 1e8)),
    "light on heavy, 1e4": ((1e7, 1e8), (1e3, 1e8)),
    "stiff on soft, 1e6": ((1e3, 1e5), (1e3, 1e11)),
    "soft on stiff, 1e6": ((1e3, 1e11), (1e3, 1e5)),
}
PAIRS = {
    "density 1": ((1e3, 1e8), (1e3, 1e8)),
    "density 1e2": ((1e3, 1e8), (1e5, 1e8)),
    "density 1e4": ((1e3, 1e8), (1e7, 1e8)),
    "stiffness 1e6": ((1e3, 1e5), (1e3, 1e11)),
}
TILE, STEPS_OF_PAIRS = 0.025, 4000


def two(pair):
    return {name: solid(density=rho, youngs_modulus=E) for name, (rho, E) in zip("ab", pair, strict=True)}


def stack(scheme, variant):
    materials = two(STACKS[variant])
    run = simulation(
        scheme, [16 * TILE, 16 * TILE], TILE,
        [box([4 * TILE, 0.0], [12 * TILE, 4 * TILE], "a"), box([4 * TILE, 4 * TILE], [12 * TILE, 8 * TILE], "b")],
        materials, gravity=[0.0, -9.81],
    )  # fmt: skip
    start = run.dt
    found = follow(run, steps=STEPS_OF_PAIRS)
    follows_waves(found, max(map(wave_speed, materials.values())), TILE, start)
    if not found.message:
        found.numbers["penetration, cells"] = penetration(run)
        found.claim(penetration(run) <= 1.0, "one body lies in the other")
    return found


def penetration(run):
    """Largest depth of the upper body in the lower one in any column of cells, in cells; none at the start."""
    x, upper = run.particles.x / TILE, run.particles.material == 1
    deepest = -math.inf
    for number in np.unique(np.floor(x[:, 0])):
        here = np.floor(x[:, 0]) == number
        if (here & upper).any() and (here & ~upper).any():
            deepest = max(deepest, float(x[here & ~upper, 1].max() - x[here & upper, 1].min()) + 0.5)
    return deepest


def pair(scheme, variant):
    """They meet at a twentieth of the slower wave speed, in a periodic box, where nothing else takes momentum."""
    materials = two(PAIRS[variant])
    fast = 0.05 * min(map(wave_speed, materials.values()))
    bodies = [
        box([4 * TILE, 6 * TILE], [12 * TILE, 10 * TILE], "a", velocity=[fast, 0.0]),
        box([13 * TILE, 6 * TILE], [21 * TILE, 10 * TILE], "b"),
    ]
    run = simulation(scheme, [32 * TILE, 16 * TILE], TILE, bodies, materials, periodic=["x", "y"])
    before = run.measure()
    found = follow(run, steps=STEPS_OF_PAIRS)
    if not found.message:
        after = run.measure()
        error = max(abs(after[name] - before[name]) for name in ("momentum_x", "momentum_y")) / before["momentum_x"]
        found.numbers["momentum error"] = error
        found.claim(error < 1e-12, "momentum is not conserved to 1e-12")
    return found


BOTH = DOUBLE + SINGLE
CASES = (
    Case(
        "S1", "cube drop",
        f"a neo-Hookean cube of 8 cells hits the floor at {FALL:g} m/s; {PASSES:g} passings of a wave",
        tuple(f"E=1e{n}" for n in range(3, 13)), drop, schemes=BOTH,
    ),
    Case(
        "S2", "column", f"{LENGTH:g} m of rubber settle under their weight, laid to rest by damping", RATIOS, column,
        schemes=BOTH,
    ),
    Case(
        "S2", "disk", f"a free disk of 8 cells radius turns for {SPINNING_STEPS} steps", RATIOS, turning_disk, schemes=BOTH,
    ),
    Case("S3", "stack", "two blocks on a floor, one on the other", tuple(STACKS), stack),
    Case("S3", "pair", "two blocks meet in free flight", tuple(PAIRS), pair),
)  # fmt: skip
