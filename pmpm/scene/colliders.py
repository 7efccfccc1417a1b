"""Rigid things in the way of the material: where they are, how they move, and what their surface does to what touches it."""

import itertools
import math
from collections.abc import Callable, Iterator
from typing import Annotated, Any

import numpy as np
from pydantic import Field, field_serializer, model_serializer, model_validator

from pmpm.scene.forcing import Velocity, wrong_velocity
from pmpm.scene.messages import Problem, Problems, value_text
from pmpm.scene.part import Part
from pmpm.scene.recorded import FROM_PYTHON, function_or, record, refuse_record
from pmpm.scene.shapes import Bounds, Shape, region_misfits, wrong_length
from pmpm.scene.values import (
    Checked,
    check_number,
    check_vector,
    check_word,
    checked,
    choice,
    either,
    flag,
    label,
    number,
    number_told,
    plain,
    short_told,
    vector,
    vector_told,
)

SURFACES = ("stick", "slip", "separate", "friction")
ROUNDING = 1e-9  # of a period
MOST_SAMPLES, PIECE = 2_000_000, 1 << 16  # of a distance that takes long to find, and how many at a time
SPIN = "angular velocity: a number in 2-D, a vector in 3-D, or a function of time (deg/s)"


class Surface(Part):
    """What the surface of a collider does to material that touches it."""

    type: Annotated[str, choice(SURFACES)] = Field(description=f"one of {', '.join(SURFACES)}")
    coefficient: Annotated[float, number(at_least=0.0)] = Field(
        default=0.0, description="coefficient of Coulomb friction"
    )

    @model_validator(mode="after")
    def check_coefficient(self) -> "Surface":
        """Complain about friction without a coefficient, or a coefficient without friction."""
        given = "coefficient" in self.model_fields_set
        if self.type == "friction" and not given:
            text = 'must give the coefficient: { type = "friction", coefficient = 0.4 }'
            raise Problems(Problem((), text, "friction"))
        if self.type != "friction" and given:
            text = f"belongs to a friction {type(self).__name__.lower()}, not to {self.type}"
            raise Problems(Problem(("coefficient",), text, self.coefficient))
        return self

    @model_serializer
    def short(self) -> Any:
        """The type alone where there is nothing else to say."""
        own = {"coefficient": self.coefficient} if self.type == "friction" else {}
        own |= self.motion()
        return {"type": self.type, **own} if own else self.type

    def motion(self) -> dict[str, Any]:
        """What a file says of its motion; the surface of a collider moves with it."""
        return {}


def table_of_type(words: tuple[str, ...]) -> Callable[[Any], Any]:
    """Return what turns the short form of a surface or wall, its type alone, into a table."""

    def table(value: Any) -> Any:
        if not isinstance(value, str):
            return value
        check_word(value, words)
        return {"type": value}

    return table


def check_spin(value: Any) -> Any:
    value = plain(value)
    return check_vector("deg/s")(value) if isinstance(value, list | tuple) else check_number("deg/s")(value)


def check_distance(value: Any) -> Any:
    refuse_record(value)
    if not callable(value):
        raise Problems(Problem((), "must be a function of places (n, dim) and time, given from Python", value))
    return value


TIMES = {"type": "array", "items": number_told(), "minItems": 1, "x-unit": "s"}
PLACES = {"type": "array", "items": vector_told(), "x-unit": "m"}


class Path(Part):
    """Where a collider is at given times: moved from its place in the scene, straight from one time to the next."""

    times: Annotated[tuple[float, ...], checked(lambda value: rising(value), TIMES)] = Field(
        description="times, each later than the one before (s)"
    )
    displacements: Annotated[tuple[tuple[float, ...], ...], checked(lambda value: vectors(value), PLACES)] = Field(
        description="displacement at each of the times (m)"
    )

    @model_validator(mode="after")
    def check_lengths(self) -> "Path":
        if len(self.times) != len(self.displacements):
            text = f"must have {len(self.times)} vectors, one for each of the times, not {len(self.displacements)}"
            raise Problems(Problem(("displacements",), text))
        return self

    def displacement(self, time: float) -> np.ndarray:
        """Return the displacement (m) at a time; before the first and after the last one it rests."""
        table = np.array(self.displacements)
        return np.array([np.interp(time, self.times, column) for column in table.T])


def rising(value: Any) -> tuple[float, ...]:
    if not isinstance(value, list | tuple) or not value:
        raise Problems(Problem((), "must be a list of times (s)", value))
    times = [check_number("s")(item) for item in value]
    late = [i for i in range(1, len(times)) if not times[i] > times[i - 1]]
    if late:
        raise Problems(
            Problem((late[0],), f"s must be later than the one before, {times[late[0] - 1]} s", times[late[0]])
        )
    return tuple(times)


def vectors(value: Any) -> tuple[tuple[float, ...], ...]:
    if not isinstance(value, list | tuple):
        raise Problems(Problem((), "must be a list of vectors (m)", value))
    return tuple(check_vector("m")(item) for item in value)


class Collider(Part):
    """A rigid body that moves as told, or rests; the material feels it, and it takes note of the force on it."""

    name: Annotated[str | None, label()] = Field(
        default=None, description="in diagnostics; collider_0, collider_1 ... if not given"
    )
    shape: Shape | None = Field(default=None, description="table with a type and its measures")
    distance: Annotated[Any, checked(check_distance, FROM_PYTHON)] = Field(
        default=None,
        description="from Python, instead of a shape: function d(x, t) of places (n, dim) in m and time in s that returns the "
        "distance to the surface (n,), m, negative inside",
    )
    surface: Annotated[Surface, Checked(table_of_type(SURFACES), told=short_told(SURFACES))] = Field(
        default=Surface(type="separate"), description=f"one of {', '.join(SURFACES)}; friction with its coefficient"
    )
    velocity: Velocity = Field(default=None, description="vector, or a function of time (m/s)")
    angular_velocity: Annotated[
        Any, checked(function_or(check_spin), either(number_told("deg/s"), vector_told("deg/s")))
    ] = Field(default=None, description=SPIN)
    pivot: Annotated[tuple[float, ...] | None, vector("m")] = Field(
        default=None, description="point that it turns about and torques are taken about; the middle if not given (m)"
    )
    path: Path | None = Field(default=None, description="times and displacements, instead of a velocity")
    cut: Annotated[bool, flag()] = Field(default=True, description="whether bodies are cut out where the collider is")

    @model_validator(mode="after")
    def check_kind(self) -> "Collider":
        if (self.shape is None) == (self.distance is None):
            given = "both" if self.shape is not None else "none"
            raise Problems(Problem((), f"must give a shape, or from Python a distance: not {given}"))
        if self.path is not None and self.velocity is not None:
            raise Problems(Problem(("path",), "excludes a velocity: give one of the two"))
        return self

    @property
    def moves(self) -> bool:
        """Whether it is somewhere else, or another one, later."""
        return any(way is not None for way in (self.velocity, self.angular_velocity, self.path, self.distance))

    def misfits(self, dim: int) -> Iterator[Problem]:
        """Yield what does not fit a scene of `dim` dimensions."""
        if self.velocity is not None:
            yield from wrong_velocity(self.velocity, dim)
        if self.pivot is not None:
            yield from wrong_length("pivot", self.pivot, dim)
        if self.angular_velocity is not None:
            yield from self.wrong_spin(dim)
        if self.path is not None:
            for index, displacement in enumerate(self.path.displacements):
                for problem in wrong_length(str(index), displacement, dim):
                    yield Problem(("path", "displacements", index), problem.text, problem.value)
        if self.shape is not None:
            yield from (Problem(("shape", *p.path), p.text, p.value) for p in region_misfits(self.shape, dim))
        else:
            yield from self.wrong_distance(dim)

    def wrong_spin(self, dim: int) -> Iterator[Problem]:
        shown = record(self.angular_velocity)
        try:
            found = spin_at(self.angular_velocity, 0.0, dim)
        except Exception as error:
            text = (
                f"fails at t = 0 s: {type(error).__name__}: {error}" if callable(self.angular_velocity) else str(error)
            )
            yield Problem(("angular_velocity",), text, shown)
            return
        if not np.isfinite(found).all():
            yield Problem(("angular_velocity",), f"must be finite, not {value_text(found.tolist())} at t = 0 s", shown)

    def wrong_distance(self, dim: int) -> Iterator[Problem]:
        points = np.linspace(0.0, 1.0, 2 * dim).reshape(2, dim)
        try:
            found = np.asarray(self.distance(points, 0.0))
        except Exception as error:
            text = f"fails for places (2, {dim}) at t = 0 s: {type(error).__name__}: {error}"
            yield Problem(("distance",), text, record(self.distance))
            return
        if found.shape != (2,) or not np.issubdtype(found.dtype, np.floating):
            text = (
                f"must return (n,) distances (m) for places (n, {dim}), not {found.dtype} {found.shape} for two places"
            )
            yield Problem(("distance",), text, record(self.distance))

    def bounds(self, dim: int) -> Bounds:
        """Return the corners (low, high) of the surrounding box at the start, (dim,) each, m; infinite where it has no end."""
        if self.shape is None:
            return np.full(dim, -np.inf), np.full(dim, np.inf)
        return self.shape.bounds()

    def signed_distance(self, points: np.ndarray, time: float) -> np.ndarray:
        """Return how far points (n, dim), m, are from its surface, (n,) m, negative inside, where it was at the start."""
        if self.shape is None:
            return np.asarray(self.distance(points, time), np.float64)
        shape: Any = self.shape
        return shape.signed_distance(points)

    def placed(self, time: float, dim: int) -> tuple[np.ndarray, np.ndarray] | None:
        """Return how far it has turned (dim, dim) and moved (dim,) m at a time; None where functions tell it step by step."""
        if callable(self.velocity) or callable(self.angular_velocity):
            return None
        spin = 0.0 if dim == 2 else (0.0,) * 3
        turn = rotation(time * spin_at(spin if self.angular_velocity is None else self.angular_velocity, 0.0, dim))
        if self.path is not None:
            return turn, self.path.displacement(time) - self.path.displacement(0.0)
        return turn, time * np.array((0.0,) * dim if self.velocity is None else self.velocity)

    def repeats(self, periods: tuple[float, ...]) -> tuple[float, ...]:
        """Return the periods (m) along which it comes in again at the other end: infinite where it is longer than the domain,
        for then it would meet itself; one that turns may be as long as its diagonal along any axis."""
        low, high = self.bounds(len(periods))
        length = high - low
        if self.angular_velocity is not None:
            length = np.full(len(periods), np.linalg.norm(length))
        fits = np.isfinite(length) & (length <= (1.0 + ROUNDING) * np.array(periods))
        return tuple(float(period) if one else math.inf for period, one in zip(periods, fits, strict=True))

    def nearest(self, points: np.ndarray, periods: tuple[float, ...]) -> np.ndarray:
        """Return the images of points (n, dim), m, that are nearest to it at the start, in a domain of these periods (m)."""
        repeats, (low, high) = self.repeats(periods), self.bounds(len(periods))
        if not np.isfinite(repeats).any():
            return points
        columns = [nearest_image(x, *ends) for x, *ends in zip(points.T, low, high, repeats, strict=True)]
        return np.stack(columns, axis=1)

    def center(self, size: tuple[float, ...], periods: tuple[float, ...]) -> np.ndarray:
        """Return the point (dim,) m that it turns about: its pivot, or the middle of what lies in a domain of this size."""
        low, high = self.within(size, periods)
        return 0.5 * (low + high) if self.pivot is None else np.array(self.pivot)

    def within(self, size: tuple[float, ...], periods: tuple[float, ...]) -> Bounds:
        """Return corners (low, high), (dim,) m, of what lies in a domain of this size: all of it where it comes in again."""
        (low, high), whole = self.bounds(len(size)), np.isfinite(self.repeats(periods))
        return np.where(whole, low, np.maximum(low, 0.0)), np.where(whole, high, np.minimum(high, size))

    @field_serializer("velocity", "angular_velocity", "distance")
    def recorded_function(self, value: Any) -> Any:
        return record(value)


def spin_at(spin: Any, time: float, dim: int) -> np.ndarray:
    """Return an angular velocity that may be a function of time as a vector (1,) in 2-D or (3,) in 3-D, rad/s."""
    found = np.atleast_1d(np.asarray(spin(time) if callable(spin) else spin, np.float64))
    size = 1 if dim == 2 else 3
    if found.shape != (size,):
        kind = "one number" if dim == 2 else "three numbers"
        raise ValueError(f"must be {kind} in {dim}-D (deg/s)")
    return math.pi / 180.0 * found


def nearest_image(x: np.ndarray, low: float, high: float, period: float) -> np.ndarray:
    """Move coordinates (n,), m, by whole periods to where they are nearest to the middle of low .. high; none if endless."""
    return x - period * np.round((x - 0.5 * (low + high)) / period) if math.isfinite(period) else x


def cut_out(colliders: tuple[Collider, ...], periods: tuple[float, ...], points: np.ndarray) -> np.ndarray:
    """Say which points (n, dim), m, lie inside colliders that bodies are cut by, at the start: bool (n,)."""
    inside = np.zeros(len(points), bool)
    for collider in colliders:
        if collider.cut:
            shape, near = collider.shape, collider.nearest(points, periods)
            inside |= collider.signed_distance(near, 0.0) < 0.0 if shape is None else shape.contains(near)
    return inside


def rotation(angle: np.ndarray) -> np.ndarray:
    """Return the rotation by a vector of angles (rad): (1,) in the plane, (3,) in space (Rodrigues)."""
    if len(angle) == 1:
        c, s = math.cos(angle[0]), math.sin(angle[0])
        return np.array([[c, -s], [s, c]])
    size = float(np.linalg.norm(angle))
    if size == 0.0:
        return np.eye(3)
    x, y, z = angle / size
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + math.sin(size) * K + (1.0 - math.cos(size)) * (K @ K)


def normals_of(distance: Any, points: np.ndarray, step: float) -> np.ndarray:
    """Return unit vectors (n, dim) along which a distance grows, differenced over a step (m); upwards if it does not tell."""
    slopes = np.empty_like(points)
    for axis in range(points.shape[1]):
        shift = np.zeros(points.shape[1])
        shift[axis] = step
        slopes[:, axis] = distance(points + shift) - distance(points - shift)
    lengths = np.linalg.norm(slopes, axis=1)
    up = np.zeros(points.shape[1])
    up[-1] = 1.0
    told = lengths > 0.0
    return np.where(told[:, None], slopes / np.where(told, lengths, 1.0)[:, None], up)


class SampledDistance:
    """A signed distance known on the corners of a regular mesh around a shape, multilinear in between; what is farther out is
    as far as the mesh is wide."""

    def __init__(self, shape: Any, spacing: float):
        low, high = shape.bounds()
        extent = high - low
        self.spacing = max(spacing, float(np.prod(extent) / MOST_SAMPLES) ** (1.0 / len(extent)))
        self.low = low - 2.0 * self.spacing
        self.counts = np.ceil(extent / self.spacing).astype(np.int64) + 5
        self.far = float(np.linalg.norm(extent)) + spacing
        axes = [start + self.spacing * np.arange(n) for start, n in zip(self.low, self.counts, strict=True)]
        places = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, len(extent))
        pieces = [shape.signed_distance(places[i : i + PIECE]) for i in range(0, len(places), PIECE)]
        self.values = np.concatenate(pieces).reshape(self.counts)

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Return the distance (n,) m at points (n, dim) m."""
        cells = (points - self.low) / self.spacing
        inside = np.all((cells >= 0.0) & (cells <= self.counts - 1), axis=1)
        found = np.full(len(points), self.far)
        first = np.minimum(cells[inside].astype(np.int64), self.counts - 2)
        t = cells[inside] - first
        sums = np.zeros(len(first))
        for corner in itertools.product((0, 1), repeat=points.shape[1]):
            weight = np.prod(np.where(corner, t, 1.0 - t), axis=1)
            sums += weight * self.values[tuple((first + corner).T)]
        found[inside] = sums
        return found


def named(colliders: tuple[Collider, ...]) -> Iterator[Collider]:
    """Yield colliders that all have a name."""
    for index, collider in enumerate(colliders):
        yield collider if collider.name else collider.model_copy(update={"name": f"collider_{index}"})


def wrong_names(colliders: tuple[Collider, ...]) -> Iterator[Problem]:
    """Yield names that would stand twice in the diagnostics."""
    names = [collider.name for collider in named(colliders)]
    for index, name in enumerate(names):
        if name in names[:index]:
            yield Problem((index, "name"), "is the name of another collider", name)
