"""S5: particles that start turned inside out."""

import numpy as np

from .judge import follow
from .matrix import STOPPED, Case
from .scenes import box, root_mean_square, simulation, solid

CELL, NOISE, SHARE, STEPS = 0.1, 0.3, 0.1, 3000
SEEDS = tuple(f"seed {n}" for n in range(10))


def start(scheme, model, seed):
    """A free block of 8 x 8 cells whose particles have F = I + noise, every tenth of them reflected as well."""
    run = simulation(scheme, [2.4, 2.4], CELL, [box([0.8, 0.8], [1.6, 1.6])], solid(model))
    random = np.random.default_rng(seed)
    F = np.eye(2) + NOISE * random.standard_normal((run.rows(), 2, 2))
    F[np.linalg.det(F) < 0.0, :, 0] *= -1.0
    F[random.permutation(len(F))[: int(SHARE * len(F))], :, 0] *= -1.0
    run.particles.F = F
    return run


def strain_error(F):
    """Root mean square of F^T F - I."""
    return root_mean_square(np.swapaxes(F, 1, 2) @ F - np.eye(2))


def released(scheme, variant):
    run = start(scheme, "fixed_corotated", int(variant.split()[1]))
    begun, stored = strain_error(run.particles.F.astype(float)), run.measure()["strain"]
    found = follow(run, steps=STEPS, invertible=True)
    if not found.message:
        F = run.particles.F.astype(float)
        left = run.measure()["strain"] / stored
        found.numbers = {
            "strain energy left": left,
            "F^T F - I left": strain_error(F) / begun,
            "inverted": float((np.linalg.det(F) < 0.0).mean()),
        }
        found.claim(left < 1.0, "strain energy does not decrease")
    return found


def refused_by_law(scheme, variant):
    run = start(scheme, variant, 0)
    found = follow(run, steps=20, with_energy=False, invertible=True)
    found.claim(bool(found.message), "a solid without meaning for det F < 0 ran on")
    return found


CASES = (
    Case("S5", "inside out", "fixed corotated: F = I + noise of 0.3, and a tenth of the particles reflected", SEEDS, released),
    Case(
        "S5", "other laws", "the same start with a law that has no meaning there: it must stop at once and say so",
        ("neo_hookean",), refused_by_law, STOPPED,
    ),
)  # fmt: skip
