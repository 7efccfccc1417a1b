"""Inflows: regions of the domain through which new material comes in, as fast as told."""

import math
from collections.abc import Iterator
from typing import Annotated, Any

import numpy as np
from pydantic import Field, field_serializer, model_validator

from pmpm.scene import forcing
from pmpm.scene.messages import Problem, Problems
from pmpm.scene.part import Part
from pmpm.scene.recorded import record
from pmpm.scene.seeding import lattice_range
from pmpm.scene.shapes import AXES, Shape, region_misfits
from pmpm.scene.values import number, text, whole

LATER: Any = None  # filled in once the rest of the scene is known
THINNEST = 2.0  # cells along the motion: nothing may pass through the region between two looks at what has entered it


class Inflow(Part):
    """A region that a stream of undeformed material passes through; inside the stream moves as told, behind it it is free."""

    material: Annotated[str, text()] = Field(description="name of one of the materials")
    shape: Shape = Field(description="table with a type and its measures: the region, which the stream fills")
    velocity: forcing.Velocity = Field(
        description="of the stream: vector, or a function of time (m/s) that keeps its direction"
    )
    particles_per_cell: Annotated[int, whole(1, 4096)] = Field(
        default=LATER,
        description="number of particles in a full cell, a square or cube; 4 in 2-D and 8 in 3-D if not given",
    )
    start: Annotated[float, number("s", at_least=0.0)] = Field(default=0.0, description="when the region is filled (s)")
    until: Annotated[float, number("s", above=0.0)] = Field(
        default=LATER, description="when the stream ends and its last particles are free, time.end if not given (s)"
    )
    limit: Annotated[float | None, number("m3", above=0.0)] = Field(
        default=None, description="volume after which the stream ends, none if not given (m3, 2-D: m2)"
    )

    @model_validator(mode="after")
    def check_times(self) -> "Inflow":
        if self.until is not None and self.until <= self.start:
            raise Problems(Problem(("until",), f"s must be > start = {self.start} s", self.until))
        return self

    def misfits(self, dim: int) -> Iterator[Problem]:
        """Yield what does not fit a scene of `dim` dimensions."""
        yield from forcing.wrong_velocity(self.velocity, dim)
        yield from (Problem(("shape", *p.path), p.text, p.value) for p in region_misfits(self.shape, dim))
        count, along = self.lattice(dim)
        if along**dim != count:
            kind = "square" if dim == 2 else "cube"
            near = [n**dim for n in (int(count ** (1 / dim)), int(count ** (1 / dim)) + 1) if n > 0]
            text = (
                f"must be a perfect {kind}, for a stream comes on a lattice; the nearest are {near[0]} and {near[-1]}"
            )
            yield Problem(("particles_per_cell",), text, count)

    def lattice(self, dim: int) -> tuple[int, int]:
        """Return particles per cell, and along each axis of one."""
        count = 2**dim if self.particles_per_cell is None else self.particles_per_cell
        return count, round(count ** (1 / dim))

    def too_small(self, dim: int, cell_size: float) -> Iterator[Problem]:
        """Yield what keeps a stream from being whole, in cells of this size (m), where nothing else is wrong."""
        low, high = self.shape.bounds()
        spacing = cell_size / self.lattice(dim)[1]
        velocity = forcing.velocity_at(self.velocity, self.start)
        thin = [axis for axis in range(dim) if high[axis] - low[axis] < THINNEST * cell_size * (1.0 - 1e-9)]
        thin = [axis for axis in thin if velocity[axis] or not any(velocity)]
        for axis in thin:
            width = f"{high[axis] - low[axis]:.6g} m along {AXES[axis]}"
            text = f"is too thin: {width}, at least {THINNEST:g} cells = {THINNEST * cell_size:.6g} m where the stream moves"
            yield Problem(("shape",), text)
        if self.limit is not None and self.limit < (1.0 - 1e-9) * spacing**dim:
            unit = "m2" if dim == 2 else "m3"
            yield Problem(("limit",), f"{unit} is less than one particle has, {spacing**dim:.6g} {unit}", self.limit)
        if not thin and math.prod((high - low) / spacing) < 1e6:
            places = (lattice_range((low, high), spacing, np.zeros(dim)) + 0.5) * spacing
            if not self.shape.contains(places).any():
                yield Problem(("shape",), "holds no particle: it is smaller than the distance between particles")

    @field_serializer("velocity")
    def recorded_velocity(self, velocity: Any) -> Any:
        return record(velocity)
