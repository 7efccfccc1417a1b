"""Shapes that bodies are cut from: which points they hold, where they end. Dimension enters only at validation."""

from collections.abc import Iterator
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Discriminator, Field, Tag, model_validator

from pmpm.scene.mesh import Mesh, Particles
from pmpm.scene.messages import TAG, Problem, Problems, known_text, path_text
from pmpm.scene.part import Part
from pmpm.scene.terrain import Terrain
from pmpm.scene.values import check_vector, check_word, checked, either, number, tables, vector, vector_told

AXES = ("x", "y", "z")

Bounds = tuple[np.ndarray, np.ndarray]


class Box(Part):
    """An axis-parallel box (a rectangle in 2-D), boundary included."""

    type: Literal["box"] = "box"
    min: Annotated[tuple[float, ...], vector("m")] = Field(description="lower corner (m)")
    max: Annotated[tuple[float, ...], vector("m")] = Field(description="upper corner (m)")

    @model_validator(mode="after")
    def check_corners(self) -> "Box":
        if len(self.min) != len(self.max):
            raise Problems(Problem(("max",), f"must have {len(self.min)} numbers like min", list(self.max)))
        flat = [axis for axis in range(len(self.min)) if not self.min[axis] < self.max[axis]]
        if flat:
            raise Problems(*(Problem(("max", i), f"must be > min[{i}] = {self.min[i]} m", self.max[i]) for i in flat))
        return self

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Say which of the points (n, dim), m, lie inside: bool (n,)."""
        return np.all((points >= np.array(self.min)) & (points <= np.array(self.max)), axis=1)

    def signed_distance(self, points: np.ndarray) -> np.ndarray:
        """Return how far points (n, dim), m, are from the surface, (n,) m, negative inside."""
        beyond = np.maximum(np.array(self.min) - points, points - np.array(self.max))
        return np.linalg.norm(np.maximum(beyond, 0.0), axis=1) + np.minimum(beyond.max(axis=1), 0.0)

    def bounds(self) -> Bounds:
        """Return the corners (low, high) of the surrounding box, (dim,) each, m."""
        return np.array(self.min), np.array(self.max)

    def misfits(self, dim: int) -> list[Problem]:
        """List what does not fit a scene of `dim` dimensions."""
        return wrong_length("min", self.min, dim) + wrong_length("max", self.max, dim)


class Sphere(Part):
    """A ball (a disk in 2-D), boundary included."""

    type: Literal["sphere"] = "sphere"
    center: Annotated[tuple[float, ...], vector("m")] = Field(description="centre (m)")
    radius: Annotated[float, number("m", above=0.0)] = Field(description="radius (m)")

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Say which of the points (n, dim), m, lie inside: bool (n,)."""
        # Measured in radii, so that neither tiny nor huge scenes leave the range of the numbers.
        with np.errstate(over="ignore"):  # far outside of the tiniest
            offset = (points - np.array(self.center)) / self.radius
            return np.sum(offset * offset, axis=1) <= 1.0

    def signed_distance(self, points: np.ndarray) -> np.ndarray:
        """Return how far points (n, dim), m, are from the surface, (n,) m, negative inside."""
        return np.linalg.norm(points - np.array(self.center), axis=1) - self.radius

    def bounds(self) -> Bounds:
        """Return the corners (low, high) of the surrounding box, (dim,) each, m."""
        return np.array(self.center) - self.radius, np.array(self.center) + self.radius

    def misfits(self, dim: int) -> list[Problem]:
        """List what does not fit a scene of `dim` dimensions."""
        return wrong_length("center", self.center, dim)


def axis_vector(value: Any) -> Any:
    """Turn the name of an axis into its direction; check a direction given by numbers."""
    if isinstance(value, str):
        check_word(value, AXES)
        return tuple(float(value == axis) for axis in AXES)
    direction = check_vector("-")(value)
    if len(direction) != 3 or not any(direction):
        raise Problems(Problem((), 'must be "x", "y", "z" or three numbers that are not all zero', value))
    return direction


AXIS_TOLD = either({"enum": list(AXES)}, vector_told() | {"minItems": 3})


class Cylinder(Part):
    """A solid round cylinder about an axis, boundary included; 3-D only. `center` is the middle of its axis."""

    type: Literal["cylinder"] = "cylinder"
    center: Annotated[tuple[float, ...], vector("m")] = Field(description="middle of the cylinder (m)")
    axis: Annotated[tuple[float, ...], checked(axis_vector, AXIS_TOLD)] = Field(
        description='direction of the axis: "x", "y", "z" or three numbers'
    )
    radius: Annotated[float, number("m", above=0.0)] = Field(description="radius (m)")
    height: Annotated[float, number("m", above=0.0)] = Field(description="length along the axis (m)")

    @model_validator(mode="after")
    def check_center(self) -> "Cylinder":
        if len(self.center) != 3:
            raise Problems(Problem(("center",), "must have 3 numbers: a cylinder is 3-D only", list(self.center)))
        return self

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Say which of the points (n, 3), m, lie inside: bool (n,)."""
        with np.errstate(over="ignore", invalid="ignore"):  # far outside of the tiniest
            offset = (points - np.array(self.center)) / self.radius
            along = offset @ self.direction()
            across = offset - along[:, None] * self.direction()
            return (np.abs(along) <= 0.5 * self.height / self.radius) & (np.sum(across * across, axis=1) <= 1.0)

    def signed_distance(self, points: np.ndarray) -> np.ndarray:
        """Return how far points (n, 3), m, are from the surface, (n,) m, negative inside."""
        offset = points - np.array(self.center)
        along = offset @ self.direction()
        across = np.linalg.norm(offset - along[:, None] * self.direction(), axis=1)
        beyond = np.stack([np.abs(along) - 0.5 * self.height, across - self.radius], axis=1)
        return np.linalg.norm(np.maximum(beyond, 0.0), axis=1) + np.minimum(beyond.max(axis=1), 0.0)

    def bounds(self) -> Bounds:
        """Return the corners (low, high) of the surrounding box, (3,) each, m."""
        direction = self.direction()
        reach = 0.5 * self.height * np.abs(direction) + self.radius * np.sqrt(np.maximum(1.0 - direction**2, 0.0))
        return np.array(self.center) - reach, np.array(self.center) + reach

    def direction(self) -> np.ndarray:
        """Return the unit vector along the axis, (3,)."""
        axis = np.array(self.axis) / np.max(np.abs(self.axis))
        return axis / np.linalg.norm(axis)

    def misfits(self, dim: int) -> list[Problem]:
        """List what does not fit a scene of `dim` dimensions."""
        return [] if dim == 3 else [Problem(("type",), "is 3-D only; in 2-D use sphere (a disk) or box", self.type)]


class Capsule(Part):
    """All that lies within a radius of a line between two points (a stadium in 2-D), boundary included."""

    type: Literal["capsule"] = "capsule"
    start: Annotated[tuple[float, ...], vector("m")] = Field(description="one end of the line (m)")
    end: Annotated[tuple[float, ...], vector("m")] = Field(description="other end of the line (m)")
    radius: Annotated[float, number("m", above=0.0)] = Field(description="radius (m)")

    @model_validator(mode="after")
    def check_ends(self) -> "Capsule":
        if len(self.start) != len(self.end):
            raise Problems(Problem(("end",), f"must have {len(self.start)} numbers like start", list(self.end)))
        if self.start == self.end:
            raise Problems(Problem(("end",), "is the start as well: give a sphere instead", list(self.end)))
        return self

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Say which of the points (n, dim), m, lie inside: bool (n,)."""
        return self.signed_distance(points) <= 0.0

    def signed_distance(self, points: np.ndarray) -> np.ndarray:
        """Return how far points (n, dim), m, are from the surface, (n,) m, negative inside."""
        start, line = np.array(self.start), np.array(self.end) - np.array(self.start)
        length = np.linalg.norm(line)
        along = np.clip((points - start) @ (line / length), 0.0, length)
        return np.linalg.norm(points - start - along[:, None] * (line / length), axis=1) - self.radius

    def bounds(self) -> Bounds:
        """Return the corners (low, high) of the surrounding box, (dim,) each, m."""
        ends = np.array([self.start, self.end])
        return ends.min(axis=0) - self.radius, ends.max(axis=0) + self.radius

    def misfits(self, dim: int) -> list[Problem]:
        """List what does not fit a scene of `dim` dimensions."""
        return wrong_length("start", self.start, dim)


class Plane(Part):
    """All that lies on one side of a plane (of a line in 2-D): the side that the normal points away from."""

    type: Literal["plane"] = "plane"
    point: Annotated[tuple[float, ...], vector("m")] = Field(description="any point of the plane (m)")
    normal: Annotated[tuple[float, ...], vector("-")] = Field(description="direction out of the solid, of any length")

    @model_validator(mode="after")
    def check_normal(self) -> "Plane":
        if len(self.point) != len(self.normal):
            raise Problems(Problem(("normal",), f"must have {len(self.point)} numbers like point", list(self.normal)))
        if not any(self.normal):
            raise Problems(Problem(("normal",), "must not be zero", list(self.normal)))
        return self

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Say which of the points (n, dim), m, lie inside: bool (n,)."""
        return self.signed_distance(points) <= 0.0

    def signed_distance(self, points: np.ndarray) -> np.ndarray:
        """Return how far points (n, dim), m, are from the surface, (n,) m, negative inside."""
        normal = np.array(self.normal) / np.max(np.abs(self.normal))
        return (points - np.array(self.point)) @ (normal / np.linalg.norm(normal))

    def bounds(self) -> Bounds:
        """Return the corners (low, high) of the surrounding box, (dim,) each, m, infinite but for one side of one axis."""
        dim = len(self.point)
        low, high = np.full(dim, -np.inf), np.full(dim, np.inf)
        for axis in range(dim):
            if np.count_nonzero(self.normal) == 1 and self.normal[axis]:
                (high if self.normal[axis] > 0.0 else low)[axis] = self.point[axis]
        return low, high

    def misfits(self, dim: int) -> list[Problem]:
        """List what does not fit a scene of `dim` dimensions."""
        return wrong_length("point", self.point, dim)


class Union(Part):
    """Everything that lies in at least one of the shapes."""

    type: Literal["union"] = "union"
    of: Annotated[tuple["Shape", ...], tables("shape")] = Field(description="list of shapes to join")

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Say which of the points (n, dim), m, lie inside: bool (n,)."""
        return np.any([shape.contains(points) for shape in self.of], axis=0)

    def signed_distance(self, points: np.ndarray) -> np.ndarray:
        """Return a bound of how far points (n, dim), m, are from the surface, (n,) m: exact in sign, negative inside."""
        return np.min(distances(self.of, points), axis=0)

    def bounds(self) -> Bounds:
        """Return the corners (low, high) of the surrounding box, (dim,) each, m."""
        lows, highs = zip(*(shape.bounds() for shape in self.of), strict=True)
        return np.min(lows, axis=0), np.max(highs, axis=0)

    def misfits(self, dim: int) -> list[Problem]:
        """List what does not fit a scene of `dim` dimensions."""
        return misfits_of(self.of, dim)


class Difference(Part):
    """The first shape without all that follow."""

    type: Literal["difference"] = "difference"
    of: Annotated[tuple["Shape", ...], tables("shape")] = Field(description="list: a shape, then shapes to take away")

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Say which of the points (n, dim), m, lie inside: bool (n,)."""
        inside = self.of[0].contains(points)
        for shape in self.of[1:]:
            inside &= ~shape.contains(points)
        return inside

    def signed_distance(self, points: np.ndarray) -> np.ndarray:
        """Return a bound of how far points (n, dim), m, are from the surface, (n,) m: exact in sign, negative inside."""
        first, *taken = distances(self.of, points)
        return np.max([first, *(-distance for distance in taken)], axis=0)

    def bounds(self) -> Bounds:
        """Return the corners (low, high) of the box around the first shape, (dim,) each, m."""
        return self.of[0].bounds()

    def misfits(self, dim: int) -> list[Problem]:
        """List what does not fit a scene of `dim` dimensions."""
        return misfits_of(self.of, dim)


class Intersection(Part):
    """Everything that lies in all the shapes."""

    type: Literal["intersection"] = "intersection"
    of: Annotated[tuple["Shape", ...], tables("shape")] = Field(description="list of shapes that overlap")

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Say which of the points (n, dim), m, lie inside: bool (n,)."""
        return np.all([shape.contains(points) for shape in self.of], axis=0)

    def signed_distance(self, points: np.ndarray) -> np.ndarray:
        """Return a bound of how far points (n, dim), m, are from the surface, (n,) m: exact in sign, negative inside."""
        return np.max(distances(self.of, points), axis=0)

    def bounds(self) -> Bounds:
        """Return the corners (low, high), (dim,) each, m, of what all boxes share; low >= high if nothing."""
        lows, highs = zip(*(shape.bounds() for shape in self.of), strict=True)
        return np.max(lows, axis=0), np.min(highs, axis=0)

    def misfits(self, dim: int) -> list[Problem]:
        """List what does not fit a scene of `dim` dimensions."""
        problems = misfits_of(self.of, dim)
        if problems:
            return problems
        low, high = self.bounds()
        return [] if np.all(low < high) else [Problem(("of",), "is empty: these shapes do not all overlap")]


SHAPES = {"box": Box, "sphere": Sphere, "cylinder": Cylinder, "capsule": Capsule, "plane": Plane, "terrain": Terrain}
SHAPES |= {"mesh": Mesh, "particles": Particles}
SHAPES |= {"union": Union, "difference": Difference, "intersection": Intersection}


def check_shape(value: Any) -> Any:
    """Complain about a shape without a type, or of a type that is unknown or not built yet."""
    if isinstance(value, tuple(SHAPES.values())):
        return value
    if not isinstance(value, dict):
        raise Problems(Problem((), f"must be a table with a type; {known_text('', SHAPES, 'known')}", value))
    if "type" not in value:
        raise Problems(Problem(("type",), f"is missing; {known_text('', SHAPES, 'known')}"))
    check_word(value["type"], SHAPES, path=("type",))
    return value


def shape_tag(value: Any) -> str:
    return TAG + (value["type"] if isinstance(value, dict) else value.type)


Shape = Annotated[
    Annotated[Box, Tag(TAG + "box")]
    | Annotated[Sphere, Tag(TAG + "sphere")]
    | Annotated[Cylinder, Tag(TAG + "cylinder")]
    | Annotated[Capsule, Tag(TAG + "capsule")]
    | Annotated[Plane, Tag(TAG + "plane")]
    | Annotated[Terrain, Tag(TAG + "terrain")]
    | Annotated[Mesh, Tag(TAG + "mesh")]
    | Annotated[Particles, Tag(TAG + "particles")]
    | Annotated[Union, Tag(TAG + "union")]
    | Annotated[Difference, Tag(TAG + "difference")]
    | Annotated[Intersection, Tag(TAG + "intersection")],
    Discriminator(shape_tag),
    BeforeValidator(check_shape),
]

for compound in (Union, Difference, Intersection):
    compound.model_rebuild()


def wrong_length(key: str, value: tuple[float, ...], dim: int) -> list[Problem]:
    """Complain where a vector does not have `dim` numbers."""
    if len(value) == dim:
        return []
    return [Problem((key,), f"must have {dim} numbers like domain.size", list(value))]


def leaves_of(shape: Any, path: tuple[str | int, ...] = ()) -> Iterator[tuple[tuple[str | int, ...], Any]]:
    """Yield (path, shape) of the shapes without shapes within that a shape is made of."""
    if not hasattr(shape, "of"):
        yield path, shape
        return
    for index, part in enumerate(shape.of):
        yield from leaves_of(part, (*path, "of", index))


def shapes_in(scene: Any) -> Iterator[tuple[str, Any]]:
    """Yield (dotted key, shape) of all shapes of a scene that have none within."""
    yield from ((path_text(path), shape) for path, shape in shapes_at(scene))


def shapes_at(scene: Any) -> Iterator[tuple[tuple[str | int, ...], Any]]:
    """Yield (path, shape) of the same."""
    for key in ("bodies", "inflows", "loads", "motions", "colliders"):
        for index, part in enumerate(getattr(scene, key)):
            if part.shape is not None:
                yield from (((key, index, "shape", *path), shape) for path, shape in leaves_of(part.shape))


def distances(shapes: tuple[Any, ...], points: np.ndarray) -> list[np.ndarray]:
    """Return the signed distances (n,) of points to each of the shapes."""
    return [shape.signed_distance(points) for shape in shapes]


def misfits_of(shapes: tuple[Any, ...], dim: int) -> list[Problem]:
    """List what does not fit in shapes within a shape, with their paths."""
    return [
        Problem(("of", index, *problem.path), problem.text, problem.value)
        for index, shape in enumerate(shapes)
        for problem in region_misfits(shape, dim)
    ]


def region_misfits(shape: Any, dim: int) -> list[Problem]:
    """List what does not fit where points are asked for that lie in a shape."""
    if shape.type == "particles":
        return [Problem(("type",), "can only be the whole shape of a body", shape.type)]
    return shape.misfits(dim)
