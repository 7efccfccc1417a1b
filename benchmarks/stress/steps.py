"""S4: how long a step may be: a manufactured solution and a rotating disk, with a tenth to three times the stable step."""

import math

import numpy as np

from pmpm.physics.words import cos, sin

from .judge import follow
from .matrix import DOUBLE, SINGLE, STOPPED, SURVIVES, Case
from .scenes import box, by_id, root_mean_square, simulation, solid
from .solids import RADIUS, shape_error, spinning_disk

RATIOS = (0.1, 0.2, 0.4, 0.6, 0.8, 0.9, 1.0, 1.1, 1.2, 1.5, 2.0, 3.0)
SAFE = 0.9  # of the bound: what must survive
VARIANTS = tuple(f"{ratio:g} of the bound" for ratio in RATIOS)


def with_step(run, variant):
    """The simulation, its step that ratio of the stable one throughout: past what `time.cfl` allows, hence by hand."""
    run.control.cfl = float(variant.split()[0])
    return run


# ---- a manufactured solution ---------------------------------------------------------------------------------------------

K = W = 2.0 * math.pi
A = 0.1 / K
CELLS, PERIODS = 16, 5
RUBBER = solid(density=1.0, youngs_modulus=1.0, poisson_ratio=0.0)


def body_force(x, X, t):
    """Of Wallstedt and Guilkey (2008) for u_i = A sin(K X_i) sin(W t), neo-Hookean with nu = 0."""
    motion = sin(W * t)
    u, F = A * sin(K * X[0]) * motion, 1.0 + A * K * cos(K * X[0]) * motion
    v, G = A * sin(K * X[1]) * motion, 1.0 + A * K * cos(K * X[1]) * motion
    return (u * (K * K * (0.5 + 0.5 / (F * F)) - W * W), v * (K * K * (0.5 + 0.5 / (G * G)) - W * W))


def work(run):
    """Of the body force in the step just taken, J."""
    t, X = run.time - run.dt, run.particles.X.astype(float)
    motion = math.sin(W * t)
    u, F = A * np.sin(K * X) * motion, 1.0 + A * K * np.cos(K * X) * motion
    b = u * (K * K * (0.5 + 0.5 / (F * F)) - W * W)
    return float((run.particles.mass[:, None] * b * run.particles.v).sum() * run.dt)


def manufactured(scheme, variant):
    run = simulation(
        scheme, [1.0, 1.0], 1.0 / CELLS, [box([0.0, 0.0], [1.0, 1.0])], RUBBER, time={"end": float(PERIODS)},
        periodic=["x", "y"], body_force=body_force,
    )  # fmt: skip
    run.particles.v = A * W * np.sin(K * run.particles.X)
    worst = [0.0]

    def errors(run):
        X = run.particles.X.astype(float)
        u = run.particles.x - X
        error = u - np.rint(u) - A * np.sin(K * X) * math.sin(W * run.time)
        worst[0] = max(worst[0], root_mean_square(error) / (A / math.sqrt(2.0)))

    found = follow(with_step(run, variant), least=1, each=errors, work=work)
    found.numbers["e_u"] = worst[0]
    return found


# ---- a rotating disk -----------------------------------------------------------------------------------------------------

TURNING, TURNS = 10.0, 0.5  # 1/s: so slow that not the motion bounds the step


def disk(scheme, variant):
    run, center = spinning_disk(scheme, solid(), RADIUS / 8.0, spin=TURNING)
    run = with_step(run, variant)
    (before,) = by_id(run, "x")
    found = follow(run, until=TURNS * 2.0 * math.pi / TURNING)
    if not found.message:
        found.numbers["shape error, cells"] = shape_error(run, center, before)
    return found


EXPECT = {variant: SURVIVES + STOPPED for ratio, variant in zip(RATIOS, VARIANTS, strict=True) if ratio > SAFE}
CASES = (
    Case(
        "S4", "manufactured",
        f"a manufactured solution in a periodic box of {CELLS} x {CELLS} cells, A k = 0.1, {PERIODS} periods",
        VARIANTS, manufactured, EXPECT, DOUBLE + SINGLE,
    ),
    Case(
        "S4", "disk", f"a free disk of 8 cells radius makes half a turn, its rim at {TURNING * RADIUS:g} m/s", VARIANTS,
        disk, EXPECT, DOUBLE + SINGLE,
    ),
)  # fmt: skip
