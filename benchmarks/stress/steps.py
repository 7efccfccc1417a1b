"""S4: how long a step may be: a manufactured solution and a rotating disk, with a tenth to three times the stable step."""

import math

import numpy as np
from cases import mms

from pmpm.accuracy import Errors
from pmpm.kernels import targets
from pmpm.simulation import Simulation

from .judge import follow
from .matrix import DOUBLE, SINGLE, STOPPED, SURVIVES, Case
from .scenes import by_id, solid
from .solids import RADIUS, shape_error, spinning_disk

RATIOS = (0.1, 0.2, 0.4, 0.6, 0.8, 0.9, 1.0, 1.1, 1.2, 1.5, 2.0, 3.0)
SAFE = 0.9  # of the bound: what must survive
VARIANTS = tuple(f"{ratio:g} of the bound" for ratio in RATIOS)


def with_step(run, variant):
    """The simulation, its step that ratio of the stable one throughout: past what `time.cfl` allows, hence by hand."""
    run.control.cfl = float(variant.split()[0])
    return run


# ---- a manufactured solution ---------------------------------------------------------------------------------------------

SOLUTION, CELLS, PERIODS = mms.AxisAligned(), 16, 5


class Work:
    """Work (J) of a body force in the step just taken: its impulse times the mean of the velocities before and after."""

    def __init__(self, run):
        self.force = targets.arrays(np.float64).compile(run.scene.body_force)
        (self.v,) = by_id(run, "v")

    def __call__(self, run):
        X, mass, v = by_id(run, "X", "mass", "v")
        before, self.v = self.v, v
        b = np.stack(self.force(tuple(X.T), tuple(X.T), run.time - run.dt), axis=1)
        return float((mass[:, None] * b * 0.5 * (before + v)).sum() * run.dt)


def manufactured(scheme, variant):
    scene = SOLUTION.scene(CELLS, scheme.transfer, scheme.shape_function, scheme.precision, cfl=0.4, flip_blend=0.99)
    longer = scene.time.model_copy(update={"end": PERIODS * SOLUTION.period})
    run = with_step(Simulation(scene.model_copy(update={"time": longer})), variant)
    errors = Errors(run)
    found = follow(run, least=2, each=errors, work=Work(run))
    found.numbers["e_u"] = errors.largest["displacement"]
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
