"""What drives the material of a scene from outside, besides gravity: a body force, loads, walls and regions in motion."""

import math
from collections.abc import Iterator
from types import FunctionType
from typing import Annotated, Any

import numpy as np
from pydantic import Field, field_serializer, model_validator

from pmpm.scene import functions
from pmpm.scene.messages import Problem, Problems
from pmpm.scene.part import Part
from pmpm.scene.recorded import FROM_PYTHON, function_or, record, refuse_record
from pmpm.scene.shapes import Shape, region_misfits, wrong_length
from pmpm.scene.values import check_vector, checked, flag, vector, vector_told

Path = tuple[str | int, ...]
NODES_AT_A_TIME, MOST_NODES_TRIED = 1 << 17, 20_000_000


# ---- velocities that may change with time --------------------------------------------------------------------------------


def velocity_at(velocity: Any, time: float) -> tuple[float, ...]:
    """Return a velocity (m/s) that may be a function of time (s)."""
    return tuple(map(float, velocity(time))) if callable(velocity) else velocity


def wrong_velocity(velocity: Any, dim: int) -> Iterator[Problem]:
    """Yield what does not fit: at the start, if it is a function."""
    if not callable(velocity):
        yield from wrong_length("velocity", velocity, dim)
        return
    try:
        found = velocity_at(velocity, 0.0)
    except Exception as error:
        yield Problem(("velocity",), f"fails at t = 0 s: {type(error).__name__}: {error}", record(velocity))
        return
    if len(found) != dim or not all(map(math.isfinite, found)):
        yield Problem(
            ("velocity",), f"must return {dim} finite numbers (m/s), not {found} at t = 0 s", record(velocity)
        )


# Constant, or a function of time (s).
Velocity = Annotated[Any, checked(function_or(check_vector("m/s")), vector_told("m/s"))]


# ---- loads and regions -----------------------------------------------------------------------------------------------------


class Load(Part):
    """A force on the particles that lie in a shape at the start; it stays with them."""

    shape: Shape = Field(description="table with a type and its measures: which particles, at the start")
    force: Annotated[tuple[float, ...] | None, vector("N")] = Field(
        default=None,
        description="on all of them together, spread by volume: a traction, if they are a thin layer (N, 2-D: N/m)",
    )
    acceleration: Annotated[tuple[float, ...] | None, vector("m/s2")] = Field(
        default=None, description="of each, instead of force (m/s2)"
    )

    @model_validator(mode="after")
    def check_kind(self) -> "Load":
        if (self.force is None) == (self.acceleration is None):
            given = "both" if self.force is not None else "none"
            raise Problems(Problem((), f"must give exactly one of force (N) and acceleration (m/s2), not {given}"))
        return self

    def misfits(self, dim: int) -> Iterator[Problem]:
        """Yield what does not fit a scene of `dim` dimensions."""
        for name in ("force", "acceleration"):
            if getattr(self, name) is not None:
                yield from wrong_length(name, getattr(self, name), dim)
        yield from (Problem(("shape", *p.path), p.text, p.value) for p in region_misfits(self.shape, dim))


class Motion(Part):
    """A region of the grid that moves as told: a platen, a plug, a paddle."""

    shape: Shape = Field(description="table with a type and its measures: which nodes, at the start")
    velocity: Velocity = Field(description="vector, or a function of time (m/s)")
    moves: Annotated[bool, flag()] = Field(default=True, description="whether the region travels with its velocity")

    def misfits(self, dim: int) -> Iterator[Problem]:
        """Yield what does not fit a scene of `dim` dimensions."""
        yield from wrong_velocity(self.velocity, dim)
        yield from (Problem(("shape", *p.path), p.text, p.value) for p in region_misfits(self.shape, dim))

    @field_serializer("velocity")
    def recorded_velocity(self, velocity: Any) -> Any:
        return record(velocity)


def reaches_out(shape: Any, size: tuple[float, ...]) -> bool:
    """Say whether a shape reaches out of the domain."""
    low, high = shape.bounds()
    return bool(np.any(low < 0.0) or np.any(high > np.array(size)))


def holds_node(shape: Any, geometry: Any) -> bool:
    """Say whether a node of the grid lies in a shape; taken for granted where very many would have to be tried."""
    stencil, dx = geometry.stencil, geometry.cell_size
    low, high = shape.bounds()
    cells = np.array(geometry.cells)
    with np.errstate(over="ignore"):
        first = np.clip(np.ceil(low / dx) - 1.0, -stencil.reach_low, cells + stencil.reach_high).astype(np.int64)
        last = np.clip(np.floor(high / dx) + 1.0, -stencil.reach_low - 1, cells + stencil.reach_high).astype(np.int64)
    widths = np.maximum(last - first + 1, 0)
    count = float(np.prod(widths, dtype=float))
    if count > MOST_NODES_TRIED:
        return True
    for begin in range(0, int(count), NODES_AT_A_TIME):
        numbers = np.unravel_index(np.arange(begin, min(begin + NODES_AT_A_TIME, int(count))), widths)
        if shape.contains((first + np.stack(numbers, -1)) * dx).any():
            return True
    return False


# ---- body force ----------------------------------------------------------------------------------------------------------


def body_force_function(value: Any) -> Any:
    """Accept a function b(x, X, t) of plain Python that kernels can compile."""
    refuse_record(value)
    functions.check_compilable(value, ("x", "X", "t"))
    return value


def reads(function: FunctionType, argument: str) -> bool:
    """Say whether a function uses one of its arguments."""
    import dis

    return any(
        argument in np.atleast_1d(step.argval) for step in dis.get_instructions(function) if "FAST" in step.opname
    )


def reads_reference(function: Any) -> bool:
    """Say whether a body force, or None, asks for the reference position of a particle."""
    return isinstance(function, FunctionType) and reads(function, "X")


def wrong_body_force(function: Any, dim: int, size: tuple[float, ...]) -> Iterator[Problem]:
    """Yield what a body force gets wrong in the middle of the domain, for one particle and for many."""
    try:
        functions.check_acceleration(function, dim, 0.5 * np.array(size))
    except functions.Unfit as complaint:
        yield Problem(("body_force",), f"{complaint}; {functions.RULES}", record(function))


BodyForce = Annotated[Any, checked(body_force_function, FROM_PYTHON)]
