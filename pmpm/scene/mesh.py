"""Shapes out of files, and where they stand in the scene: `mesh`, a closed surface, and `particles` as they are."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from pmpm.scene.functions import Unfit
from pmpm.scene.messages import Problem, Problems, known_text
from pmpm.scene.outside import OutsideFile
from pmpm.scene.surfaces import Surface, closed_surface, measures
from pmpm.scene.values import names, number_or_vector, text, vector


class Placed(OutsideFile):
    """Something out of a file, and where it stands in the scene.

    A place p of the file comes to move + R (scale p), where R turns about the x axis first, then y, then z, all fixed.
    """

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

    @property
    def in_file(self) -> Any:
        """What the file holds, with `points` (n, dim) m. Raises Unfit."""
        raise NotImplementedError

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


@dataclass(frozen=True, eq=False)
class Outline:
    """Points (n, dim) m as a file has them, and corners (m, dim) of elements."""

    points: np.ndarray
    corners: np.ndarray


class Mesh(Placed):
    """What a closed surface out of a file holds: triangles, or polygons in 2-D; of a mesh of volumes, the faces around it."""

    type: Literal["mesh"] = "mesh"

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


@dataclass(frozen=True, eq=False)
class CloudInFile:
    """Points (n, dim) m as a file has them, and what else it says of each particle."""

    points: np.ndarray
    cloud: Any


class Particles(Placed):
    """Particles as a file has them: a table, a snapshot or points, or the quadrature points of a mesh's cells.

    They are the particles of a body as they are; as a region they hold nothing.
    """

    type: Literal["particles"] = "particles"
    fields: Annotated[tuple[str, ...] | None, names()] = Field(
        default=None, description="which fields are taken: velocity, F, state variables of the law; all, if not given"
    )

    @model_validator(mode="after")
    def check_fields(self) -> "Particles":
        problems = list(self.wrong_lengths())
        known = [] if problems else list(self.in_file.cloud.fields)
        for index, name in enumerate(() if problems else self.fields or ()):
            if name not in known:
                problems.append(
                    Problem(("fields", index), f"is not in the file; {known_text(name, known, 'fields')}", name)
                )
        if problems:
            raise Problems(*problems)
        return self

    @cached_property
    def in_file(self) -> CloudInFile:
        """What the file holds. Raises Unfit."""
        from pmpm.scene.clouds import read_cloud

        cloud = read_cloud(self.file, self.group)
        return CloudInFile(cloud.x[:, : 2 if cloud.flat else 3], cloud)

    @cached_property
    def x(self) -> np.ndarray:
        """(n, dim) m where the particles stand in the scene."""
        return self.placed(self.in_file.points)

    @cached_property
    def volume(self) -> np.ndarray | None:
        """(n,) m3 (2-D: m2) of each particle at rest, None where the file does not tell."""
        volume, dim = self.in_file.cloud.volume, self.x.shape[1]
        return None if volume is None else volume * float(np.prod(np.broadcast_to(self.scale, dim)))

    def field(self, name: str) -> np.ndarray | None:
        """(n, k) of a field that the file has and that is wanted; velocities as they are in the scene."""
        values = self.in_file.cloud.fields.get(name) if self.fields is None or name in self.fields else None
        dim = self.x.shape[1]
        return values[:, :dim] @ self.turn(dim).T if name == "velocity" and values is not None else values

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Say that none of the points (n, dim), m, lies inside: bool (n,)."""
        return np.zeros(len(points), bool)

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the corners (low, high) of the box around the particles, (dim,) each, m."""
        return self.x.min(axis=0), self.x.max(axis=0)

    def misfits(self, dim: int) -> list[Problem]:
        """List what does not fit a scene of `dim` dimensions."""
        own = self.x.shape[1]
        text = f"has particles {'in one plane' if own == 2 else 'in space'}, the scene is {dim}-D"
        return [] if own == dim else [Problem(("file",), text, self.file)]

    def told(self) -> str:
        """One line about the particles."""
        low, high = self.bounds()
        volume = (
            "" if self.volume is None else f", volume {self.volume.sum():.6g} {'m3' if self.x.shape[1] == 3 else 'm2'}"
        )
        known = [name for name in self.in_file.cloud.fields if self.field(name) is not None]
        return f"{len(self.x)} particles, {measures(high - low)} m{volume}; with {', '.join(known) or 'no fields'}"


def plane_turn(angle: float) -> np.ndarray:
    """(2, 2) rotation by an angle in degrees; right angles are exact."""
    quarter, rest = divmod(angle, 90.0)
    c, s = np.cos(np.radians(rest)), np.sin(np.radians(rest))
    c, s = ((c, s), (-s, c), (-c, -s), (s, -c))[int(quarter) % 4]
    return np.array([[c, -s], [s, c]]) + 0.0
