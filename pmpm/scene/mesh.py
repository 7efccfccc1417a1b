"""The shape `mesh`: a closed surface out of a file, and where it stands in the scene."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from pmpm.scene.functions import Unfit
from pmpm.scene.messages import Problem, Problems
from pmpm.scene.outside import OutsideFile
from pmpm.scene.surfaces import Surface, closed_surface, measures
from pmpm.scene.values import number_or_vector, text, vector


@dataclass(frozen=True, eq=False)
class Outline:
    """Points (n, dim) m as a file has them, and corners (m, dim) of elements."""

    points: np.ndarray
    corners: np.ndarray


class Mesh(OutsideFile):
    """What a closed surface out of a file holds: triangles, or polygons in 2-D; of a mesh of volumes, the faces around it.

    A place p of the file comes to move + R (scale p), where R turns about the x axis first, then y, then z, all fixed.
    """

    type: Literal["mesh"] = "mesh"
    group: Annotated[str | None, text()] = Field(
        default=None, description="name of the one group of cells that is meant; all, if not given"
    )
    scale: Annotated[float | tuple[float, ...], number_or_vector("-", above=0.0)] = Field(
        default=1.0,
        description="what lengths in the file are multiplied by: a number, or one for each axis of the file",
    )
    rotate: Annotated[float | tuple[float, ...] | None, number_or_vector("deg")] = Field(
        default=None,
        description="angles about the x, the y and then the z axis, in 2-D one angle, about the origin (deg)",
    )
    move: Annotated[tuple[float, ...] | None, vector("m")] = Field(default=None, description="by which it is moved (m)")

    @model_validator(mode="after")
    def check_surface(self) -> "Mesh":
        problems = list(self.wrong_lengths())
        if problems:
            raise Problems(*problems)
        try:
            self.surface  # noqa: B018 - read now, so that a file that is no body is told before anything is run
        except Unfit as complaint:
            raise Problems(Problem(("file",), str(complaint), self.file)) from None
        return self

    @cached_property
    def in_file(self) -> Outline:
        """What the file holds. Raises Unfit."""
        from pmpm.scene.mesh_files import boundary, read_mesh

        mesh = read_mesh(self.file)
        dim = 2 if mesh.flat else 3
        return Outline(mesh.points[:, :dim], boundary(mesh, dim, self.group))

    @cached_property
    def surface(self) -> Surface:
        """The surface where it stands in the scene. Raises Unfit."""
        return closed_surface(self.placed(self.in_file.points), self.in_file.corners)

    def placed(self, points: np.ndarray) -> np.ndarray:
        """Points of the file (n, dim) as they stand in the scene."""
        dim = points.shape[1]
        return (np.array(self.scale) * points) @ self.turn(dim).T + (0.0 if self.move is None else np.array(self.move))

    def turn(self, dim: int) -> np.ndarray:
        """(dim, dim) rotation matrix; right angles are exact."""
        if dim == 2:
            return plane_turn(float(self.rotate or 0.0))  # type: ignore[arg-type]
        whole = np.eye(3)
        for axis, angle in enumerate(self.rotate or (0.0,) * 3):  # type: ignore[arg-type]
            rest = [(axis + 1) % 3, (axis + 2) % 3]
            about = np.eye(3)
            about[np.ix_(rest, rest)] = plane_turn(angle)
            whole = about @ whole
        return whole

    def wrong_lengths(self) -> Iterator[Problem]:
        """Yield what does not agree on a number of dimensions; one that the file will not have is told by it."""
        try:
            dim = self.in_file.points.shape[1]
        except Unfit as complaint:
            yield Problem(("file",), str(complaint), self.file)
            return
        kind = "is flat, for 2-D" if dim == 2 else "is 3-D"
        for key in ("scale", "move"):
            value = getattr(self, key)
            if isinstance(value, tuple) and len(value) != dim:
                yield Problem((key,), f"must have {dim} numbers, for {self.file} {kind}", list(value))
        if self.rotate is not None and isinstance(self.rotate, tuple) != (dim == 3):
            yield Problem(
                ("rotate",),
                f"must be {'one angle' if dim == 2 else 'three angles'}, for {self.file} {kind}",
                self.rotate,
            )

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Say which of the points (n, dim), m, lie inside: bool (n,)."""
        return self.surface.contains(points)

    def near(self, points: np.ndarray, reach: float) -> np.ndarray:
        """Say to which of the points (n, dim), m, the surface comes nearer than `reach` (m): bool (n,)."""
        return self.surface.near(points, reach)

    def signed_distance(self, points: np.ndarray) -> np.ndarray:
        """Return the distance (n,) in m of points (n, dim), m, to the surface, negative inside."""
        return self.surface.signed_distance(points)

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the corners (low, high) of the surrounding box, (dim,) each, m."""
        return self.surface.bounds()

    def misfits(self, dim: int) -> list[Problem]:
        """List what does not fit a scene of `dim` dimensions."""
        own = self.surface.dim
        if own == dim:
            return []
        text = (
            "is flat: a 3-D scene needs a surface around a body"
            if own == 2
            else "is 3-D: a 2-D scene needs polygons in one plane z"
        )
        return [Problem(("file",), text, self.file)]

    def advice(self, size: tuple[float, ...]) -> str:
        """What to say where the mesh does not lie in a domain of this size: how large it is, and what would fit."""
        low, high = self.bounds()
        text = f"; the mesh is {measures(high - low)} m large"
        if np.ndim(self.scale) > 0:
            return text
        turned = self.in_file.points @ self.turn(len(size)).T
        low, high = turned.min(axis=0), turned.max(axis=0)
        most = float(np.min(np.array(size) / (high - low)))
        power = 10.0 ** np.floor(np.log10(most))
        usual = [unit for unit in (1.0, 1e-3) if 0.05 * most < unit <= most]  # metres, millimetres
        scale = (usual or [step * power for step in (5.0, 2.0, 1.0) if step * power <= most])[0]
        corner = 0.5 * (np.array(size) - scale * (low + high))
        move = ", ".join(f"{place:.4g}" for place in corner)
        return f"{text}: scale = {scale:.6g} and move = [{move}] would put it into the middle"

    def told(self) -> str:
        """One line about the surface: how many elements, how large, and what had to be mended."""
        surface, solid = self.surface, self.surface.dim == 3
        low, high = self.bounds()
        text = f"{len(surface.elements)} {'triangles' if solid else 'segments'}, {measures(high - low)} m, "
        text += f"{'volume' if solid else 'area'} {surface.volume:.6g} {'m3' if solid else 'm2'}, "
        text += f"{'area' if solid else 'length'} {surface.area:.6g} {'m2' if solid else 'm'}"
        return f"{text}; {'; '.join(self.flaws()) or 'closed'}"

    def flaws(self) -> list[str]:
        """What was wrong with the surface and has been mended."""
        mended, found = self.surface.mended, []
        if mended.holes:
            found.append(
                f"{mended.holes} holes closed, the largest {mended.largest_hole:.3g} m across, {mended.open_part:.2g} of all"
            )
        counts = {"without extent": mended.empty, "repeated": mended.repeated, "turned around": mended.turned}
        found += [f"{count} elements {what}" for what, count in counts.items() if count]
        if mended.turned_pieces:
            found.append(f"{mended.turned_pieces} pieces turned inside out")
        return found


def plane_turn(angle: float) -> np.ndarray:
    """(2, 2) rotation by an angle in degrees; right angles are exact."""
    quarter, rest = divmod(angle, 90.0)
    c, s = np.cos(np.radians(rest)), np.sin(np.radians(rest))
    c, s = ((c, s), (-s, c), (-c, -s), (s, -c))[int(quarter) % 4]
    return np.array([[c, -s], [s, c]]) + 0.0
