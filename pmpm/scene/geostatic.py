"""The stress of ground at rest: the weight above, and K0 times that across; and the state of a law that carries it.

Vertical stress: -(surcharge + density g depth), counted on the undeformed volume, J sigma = tau, since the particles start
spaced as at rest. K0 = 1 - sin(phi) in normally consolidated soil: J. Jaky, J. Soc. Hung. Eng. Arch. (1944) 355; an elastic
solid that has sunk between rigid sides has nu/(1 - nu). The state is found by Newton's method in the principal logarithmic
strains, the same way for every law; its stresses are all that is asked.
"""

import math
from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from pmpm.scene.functions import Unfit
from pmpm.scene.part import Part
from pmpm.scene.start import ArrayLaw, columns_of, rows
from pmpm.scene.values import choice, number
from pmpm.state.fields import Layout

STRAIN = 1e-5  # of central differences: 1e-10 of error from their step and from rounding
SINGULAR = (
    1e-8  # directions in which a law is softer than this part of its stiffness carry nothing, as the shear of a fluid
)
STEPS, HALVINGS, LONGEST = 60, 12, 0.5
ENOUGH, NOISE = 1e-10, 1e-13  # of the stress wanted and of the stiffness: where the search ends
ACCEPTED, ACCEPTED_NOISE = 1e-7, 1e-12
YIELDS, YIELDS_NOISE = 1e-6, 1e-9  # changes of stress by a step without motion, that tell a yield surface
LONG = 1.0  # s, such a step


class Geostatic(Part):
    """The stress of a body that has come to rest under its own weight."""

    type: Annotated[str, choice(("geostatic",))] = Field(description='"geostatic"')
    k0: Annotated[float | None, number(at_least=0.0)] = Field(
        default=None, description="horizontal over vertical stress; 1 - sin(friction angle), else nu/(1 - nu)"
    )
    surcharge: Annotated[float, number("Pa", at_least=0.0)] = Field(
        default=0.0, description="vertical pressure on the free surface (Pa)"
    )
    depth_from: Annotated[float | None, number("m")] = Field(
        default=None, description="position of the free surface along gravity's axis, top of the body if not given (m)"
    )


def default_k0(law: Any, keys: Mapping[str, Any]) -> float | None:
    """Return K0 of a material with these keys; a liquid has 1; None where nothing tells."""
    if keys.get("friction_angle") is not None:
        return 1.0 - math.sin(math.radians(keys["friction_angle"]))
    if keys.get("poisson_ratio") is not None:
        return keys["poisson_ratio"] / (1.0 - keys["poisson_ratio"])
    return 1.0 if hasattr(law, "hydrostatic_state") else None


def vertical(gravity: Any) -> tuple[int, float]:
    """Return (axis, direction along it, 1.0 or -1.0) that is up; gravity has one component that is not zero."""
    axis = int(np.flatnonzero(gravity)[0])
    return axis, -math.copysign(1.0, gravity[axis])


def free_surface(shape: Any, gravity: Any) -> float:
    """Return the position of the top of a shape along gravity's axis, m."""
    axis, up = vertical(gravity)
    low, high = shape.bounds()
    return float((high if up > 0.0 else low)[axis])


def depths(shape: Any, gravity: Any, surface: float, count: int) -> np.ndarray:
    """Return `count` depths (m) from just below the top of a shape to its bottom."""
    axis, up = vertical(gravity)
    low, high = shape.bounds()
    top, bottom = (high, low) if up > 0.0 else (low, high)
    places = np.linspace(bottom[axis], top[axis], count, endpoint=False)[::-1]
    return (surface - places) * up


def states(law: ArrayLaw, stress: Geostatic, density: float, gravity: Any, depth: np.ndarray) -> np.ndarray:
    """Return the states (n, size) of particles at these depths (m). Raises Unfit where the law cannot carry the stress."""
    axis, _ = vertical(gravity)
    different, inverse = np.unique(depth, return_inverse=True)
    weight = density * abs(gravity[axis]) * np.maximum(different, 0.0) + stress.surcharge
    entries = law.dim + (out_of_plane_place(law) is not None)
    wanted = np.repeat(-(stress.k0 or 0.0) * weight[:, None], entries, axis=1)
    wanted[:, axis] = -weight
    y, stiffness = search(law, wanted)
    found, extra = stresses(law, y)
    size = np.abs(wanted).max(axis=1)
    off = np.maximum(np.abs(found - wanted).max(axis=1), np.abs(extra).max(axis=1, initial=0.0))
    state = state_of(law, y)
    reached = (off <= ACCEPTED * size + ACCEPTED_NOISE * stiffness) & law.valid(state)
    complain(~reached, different, f"cannot be carried by {law.needs.model}", stress)
    still = (np.zeros(len(y)),) * law.dim**2
    later = rows(law.call("advance", columns_of(state), still, LONG, law.params), len(y))
    change = np.abs(np.concatenate(stresses_of(law, later), axis=1) - np.concatenate((found, extra), axis=1)).max(
        axis=1
    )
    kept = change <= YIELDS * size + YIELDS_NOISE * stiffness
    complain(~kept, different, f"is outside the yield surface of {law.needs.model}", stress)
    return state[inverse.reshape(-1)]


def complain(wrong: np.ndarray, depth: np.ndarray, text: str, stress: Geostatic) -> None:
    if wrong.any():
        raise Unfit(f"{text} at a depth of {depth[np.flatnonzero(wrong)[0]]:.6g} m, with k0 = {stress.k0:.6g}")


def out_of_plane_place(law: ArrayLaw) -> int | None:
    """Return which number of a state is the out-of-plane entry of a solid tensor; None where there is none."""
    layout = Layout.of(law.needs, law.dim)
    for field in law.needs.fields:
        where = layout.where(field.name)
        if field.kind == "solid" and law.dim == 2 and where is not None:
            return where.start - layout.state_first + 3
    return None


def state_of(law: ArrayLaw, y: np.ndarray) -> np.ndarray:
    """Return the states (n, size) at principal logarithmic strains y along the axes, the one out of the plane last."""
    F = np.zeros((len(y), law.dim, law.dim))
    for axis in range(law.dim):
        F[:, axis, axis] = np.exp(y[:, axis])
    state = law.state_at(F)
    if y.shape[1] > law.dim:
        state[:, out_of_plane_place(law)] += y[:, law.dim]
    return state


def stresses(law: ArrayLaw, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return stresses_of(law, state_of(law, y))


def stresses_of(law: ArrayLaw, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the Kirchhoff stresses of states: those along the axes (n, dim), with that out of the plane where the state
    tells it, and those in shear."""
    columns = columns_of(state)
    tau = rows(law.call("kirchhoff_stress", columns, law.params), len(state))
    if law.dim == 3:
        return tau[:, [0, 3, 5]], tau[:, [1, 2, 4]]
    normal = tau[:, [0, 2]]
    if out_of_plane_place(law) is not None:
        across = rows((law.call("out_of_plane_stress", columns, law.params),), len(state))
        normal = np.concatenate((normal, across), axis=1)
    return normal, tau[:, [1]]


def slopes(law: ArrayLaw, y: np.ndarray) -> np.ndarray:
    """Return (n, entries, entries) derivatives of the normal stresses by the strains."""
    columns = []
    for entry in range(y.shape[1]):
        bend = STRAIN * (np.arange(y.shape[1]) == entry)
        columns.append((stresses(law, y + bend)[0] - stresses(law, y - bend)[0]) / (2.0 * STRAIN))
    return np.stack(columns, axis=-1)


def search(law: ArrayLaw, wanted: np.ndarray) -> tuple[np.ndarray, float]:
    """Return (strains (n, entries), stiffness): Newton's method, each step shortened until it helps.

    Every particle goes its own way, whatever the others do.
    """
    y = np.zeros_like(wanted)
    stiffness = float(np.nan_to_num(np.abs(slopes(law, y[:1]))).max())
    enough = ENOUGH * np.abs(wanted).max(axis=1) + NOISE * stiffness
    miss = stresses(law, y)[0] - wanted
    open_ones = np.arange(len(y))
    for _ in range(STEPS):
        open_ones = open_ones[largest(miss[open_ones]) > enough[open_ones]]
        if not len(open_ones):
            break
        here = y[open_ones]
        slope = slopes(law, here)
        usable = np.isfinite(slope).all(axis=(1, 2))
        step = np.zeros_like(here)
        inverse = np.linalg.pinv(slope[usable], rcond=SINGULAR)
        step[usable] = -(inverse * miss[open_ones][usable][:, None, :]).sum(axis=2)
        step *= np.minimum(1.0, LONGEST / np.maximum(largest(step), LONGEST))[:, None]
        better = np.zeros(len(open_ones), bool)
        for _ in range(HALVINGS):
            tried = stresses(law, here + step)[0] - wanted[open_ones]
            now = ~better & (largest(tried) < largest(miss[open_ones]))
            y[open_ones[now]] = (here + step)[now]
            miss[open_ones[now]] = tried[now]
            better |= now
            if better.all():
                break
            step *= 0.5
        open_ones = open_ones[better]
    return y, stiffness


def largest(rows_of_numbers: np.ndarray) -> np.ndarray:
    """Return the largest number of each row, infinite where one is nan."""
    return np.nan_to_num(np.abs(rows_of_numbers), nan=np.inf).max(axis=1, initial=0.0)
