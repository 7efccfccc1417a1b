"""How the particles of a body start: velocity, displacement and deformation, as constants or as functions of position.

A function of position is plain Python over numpy: it takes the reference positions X (n, dim) of n particles in m and returns
an array with a row for each. It is not compiled. It is tried on a few places before anything large is allocated; at seeding
each rank calls it for its own particles, one layer of the grid at a time, so that what it is given, and with it the result
to the last bit, is the same for any number of ranks.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from pmpm.kernels import targets
from pmpm.kernels.needs import law_needs
from pmpm.physics import tensors2, tensors3
from pmpm.scene.functions import Unfit
from pmpm.scene.messages import Problem, Problems
from pmpm.scene.recorded import function_or
from pmpm.scene.values import Checked, check_vector, checked, number_told, vector_told
from pmpm.state.fields import Layout

TRIED = 5  # places; not a number of dimensions, so that rows and columns cannot be confused
CANDIDATES = 4096
SAME = 1e-6  # how far rows may differ between one point by itself and the same among others, by rounding


# ---- what a scene may give ----


def vector_field(unit: str) -> Checked:
    """Accept two or three finite numbers, or a function of position."""
    return checked(function_or(check_vector(unit)), vector_told(unit))


def matrix_field() -> Checked:
    """Accept a square matrix, row by row, or a function of position."""
    square = [{"minItems": n, "maxItems": n, "items": {"minItems": n, "maxItems": n}} for n in (2, 3)]
    rows = {"type": "array", "items": {"type": "array", "items": number_told()}}
    return checked(function_or(check_matrix), rows | {"anyOf": square})


def check_matrix(value: Any) -> tuple[tuple[float, ...], ...]:
    value = value.tolist() if hasattr(value, "tolist") else value
    if not isinstance(value, list | tuple) or len(value) not in (2, 3):
        raise Problems(Problem((), "must be a square matrix like [[1.1, 0.0], [0.0, 1.0]]", value))
    rows, problems = [], []
    for index, row in enumerate(value):
        try:
            rows.append(check_vector("-")(row))
        except Problems as error:
            problems += [Problem((index, *p.path), p.text, p.value, p.built) for p in error.problems]
    if problems:
        raise Problems(*problems)
    if any(len(row) != len(rows) for row in rows):
        raise Problems(Problem((), f"must have {len(rows)} numbers in each of its {len(rows)} rows", value))
    return tuple(rows)


# ---- functions of position ----


def evaluate(field: Any, X: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Return (n, *shape) float64, a constant or a function of position at X (n, dim). Raises Unfit."""
    wanted = (len(X), *shape)
    if not callable(field):
        return np.broadcast_to(np.asarray(field, float), wanted)
    try:
        with np.errstate(all="ignore"):
            found = np.asarray(field(X.copy()))
    except Exception as error:
        raise Unfit(f"fails for {len(X)} points like {place(X[0])}: {type(error).__name__}: {error}") from None
    if found.shape != wanted:
        raise Unfit(f"must return an array of shape {wanted} for {len(X)} points, not of shape {found.shape}")
    if found.dtype.kind not in "fiu":
        raise Unfit(f"must return real numbers, not {found.dtype}")
    found = found.astype(np.float64)
    wrong = np.flatnonzero(~np.isfinite(found.reshape(len(X), -1)).all(axis=1))
    if len(wrong):
        values = ", ".join(f"{value:g}" for value in found[wrong[0]].ravel())
        raise Unfit(f"must return finite numbers, not ({values}), at {place(X[wrong[0]])}")
    return found


def place(X: np.ndarray) -> str:
    return f"X = ({', '.join(f'{coordinate:.6g}' for coordinate in X)}) m"


def places_in(shapes: Sequence[Any], dim: int) -> np.ndarray:
    """Return a few places (n, dim), m, in the first shape and in none of the others; maybe none if it is thin."""
    low, high = shapes[0].bounds()
    places = low + (high - low) * np.random.default_rng(0).random((CANDIDATES, dim))
    inside = shapes[0].contains(places)
    for later in shapes[1:]:
        inside &= ~later.contains(places)
    return places[inside][:TRIED]


def check_field(field: Any, X: np.ndarray, shape: tuple[int, ...]) -> None:
    """Raise Unfit unless a function of position gives rows that depend on nothing but their place."""
    if not callable(field) or not len(X):
        return
    together = evaluate(field, X, shape)
    alone = np.concatenate([evaluate(field, X[n : n + 1], shape) for n in range(len(X))])
    if not np.allclose(alone, together, rtol=SAME, atol=SAME * np.abs(together).max()):
        raise Unfit(f"must depend on the position alone: {place(X[0])} has another value by itself than among others")


def largest_speed(body: Any, dim: int) -> float:
    """Return the largest speed that a body starts with, m/s; of a function, at the places where it is tried. May be inf."""
    X = places_in([body.shape], dim) if callable(body.velocity) else np.zeros((1, dim))
    if not len(X):
        return 0.0
    v = evaluate(body.velocity, X, (dim,))
    with np.errstate(over="ignore"):
        return float(np.sqrt((v * v).sum(axis=1)).max())


# ---- the record ----


class ArrayLaw:
    """The law of a material over arrays of particles in double precision, with the numbers of its formulas."""

    def __init__(self, material: Any, dim: int):
        self.dim, self.needs = dim, law_needs(material.model, material.parameters)
        self.module: Any = self.needs.module
        self.params = tuple(map(float, self.module.parameters(material.parameters, dim)))
        self.target = targets.arrays(
            np.float64, la=tensors2 if dim == 2 else tensors3, law=self.module, **dict(self.needs.choices)
        )

    def call(self, name: str, *arguments: Any) -> Any:
        with np.errstate(all="ignore"):
            return self.target.compile(getattr(self.module, name))(*arguments)

    def state_at(self, F: np.ndarray) -> np.ndarray:
        """Return the states (n, size) of particles that are elastically deformed by F (n, dim, dim)."""
        columns = tuple(np.ascontiguousarray(column) for column in F.reshape(len(F), -1).T)
        return rows(self.call("state_at", columns, self.params), len(F))

    def valid(self, state: np.ndarray) -> np.ndarray:
        """Say which states (n, size) are finite and valid: bool (n,)."""
        valid = np.broadcast_to(self.call("valid", columns_of(state)), len(state))
        return valid & np.isfinite(state).all(axis=1)


def columns_of(state: np.ndarray) -> tuple[np.ndarray, ...]:
    return tuple(np.ascontiguousarray(column) for column in state.T)


def rows(columns: Any, count: int) -> np.ndarray:
    """Return (count, columns) from the tuple that a law gives, whose entries may be single numbers."""
    return np.stack([np.broadcast_to(np.asarray(column, float), count) for column in columns], axis=-1)


def deformed_states(law: ArrayLaw, deformation: Any, X: np.ndarray) -> np.ndarray:
    """Return the states (n, size) of particles at X with a deformation. Raises Unfit where the law has none."""
    F = evaluate(deformation, X, (law.dim, law.dim))
    states = law.state_at(F)
    wrong = np.flatnonzero(~law.valid(states))
    if len(wrong):
        first = F[wrong[0]]
        entries = ", ".join(f"{entry:g}" for entry in first.ravel())
        where = f" at {place(X[wrong[0]])}" if callable(deformation) else ""
        raise Unfit(
            f"is no state of {law.needs.model}: F = ({entries}) with det F = {np.linalg.det(first):.6g}{where}; "
            "det F must be > 0"
        )
    return states


def fields_of_file(shape: Any, needs: Any) -> list[str]:
    """Return the names of what a file of particles says about the state of a law: F, from which any state follows, and the
    law's own variables."""
    return [name for name in dict.fromkeys(("F", *needs.state)) if shape.field(name) is not None]


def states_of_file(law: ArrayLaw, shape: Any, numbers: np.ndarray) -> np.ndarray:
    """Return the states (n, size) of the particles of a file with these numbers. Raises Unfit."""
    dim, count = law.dim, len(numbers)
    F = np.broadcast_to(np.eye(dim), (count, dim, dim))
    if shape.field("F") is not None:
        F = sized(shape.field("F")[numbers], dim * dim, "F").reshape(count, dim, dim)
    states, layout = law.state_at(F), Layout.of(law.needs, dim)
    for name in law.needs.state:
        where, values = layout.where(name), shape.field(name)
        if values is not None and where is not None:
            inside = slice(where.start - layout.state_first, where.stop - layout.state_first)
            states[:, inside] = sized(values[numbers], where.stop - where.start, name)
    wrong = np.flatnonzero(~law.valid(states))
    if len(wrong):
        raise Unfit(f"holds no state of {law.needs.model} for particle {numbers[wrong[0]]}")
    return states


def sized(values: np.ndarray, size: int, name: str) -> np.ndarray:
    """Values (n, size) of a field, of tensors of space the four of the plane. Raises Unfit for another size."""
    if values.shape[1] == 9 and size == 4:
        values = values[:, [0, 1, 3, 4]]
    if values.shape[1] != size:
        raise Unfit(f"has {values.shape[1]} numbers for {name} of a particle, not {size}")
    return values


def wrong_file(body: Any, law: ArrayLaw) -> Iterator[Problem]:
    """Yield what does not fit in what a file says about the particles of a body, with paths within its shape."""
    shape = body.shape
    velocity = shape.field("velocity")
    if velocity is not None and velocity.shape[1] < law.dim:
        yield Problem(("file",), f"has {velocity.shape[1]} numbers for the velocity of a particle", shape.file)
    told = fields_of_file(shape, law.needs)
    turned = [name for name in told if shape.field(name).shape[1] > 1]
    if turned and shape.rotate is not None:
        text = f"turns places and velocities, not {', '.join(turned)}: leave them out of fields, or turn the file"
        yield Problem(("rotate",), text, shape.rotate)
    others = [key for key in ("deformation", "stress") if getattr(body, key) is not None]
    others += ["pressure"] if body.pressure != "zero" else []
    if told and others:
        text = f"says in which state the particles start ({', '.join(told)}), and so does {others[0]}: leave one out"
        yield Problem(("fields",), text)
    elif told:
        try:
            states_of_file(law, shape, np.arange(len(shape.x)))
        except Unfit as complaint:
            yield Problem(("file",), str(complaint), shape.file)


def wrong_start(body: Any, dim: int) -> Iterator[Problem]:
    """Yield what is wrong with the start of a body, as far as neither law nor functions matter."""
    for key in ("velocity", "displacement", "deformation"):
        field = getattr(body, key)
        if field is not None and not callable(field) and len(field) != dim:
            kind = f"must have {dim} numbers" if key != "deformation" else f"must be a {dim} x {dim} matrix"
            yield Problem((key,), f"{kind} like domain.size", field)
    starts = [key for key in ("deformation", "stress") if getattr(body, key) is not None]
    starts += ["pressure"] if body.pressure != "zero" else []
    if len(starts) > 1:
        yield Problem((starts[0],), f"excludes {starts[1]}: both say in which state the particles start")


def wrong_functions(body: Any, shapes: Sequence[Any], law: ArrayLaw) -> Iterator[Problem]:
    """Yield what shows when the functions of a body are tried on a few places; shapes: its own and those of later bodies."""
    dim = law.dim
    fields = {"velocity": (dim,), "displacement": (dim,), "deformation": (dim, dim)}
    # Constants need no places: with thousands of bodies these would take long.
    X = places_in(shapes, dim) if any(callable(getattr(body, key)) for key in fields) else np.zeros((0, dim))
    for key, shape in fields.items():
        field = getattr(body, key)
        try:
            if field is not None:
                check_field(field, X, shape)
            if key == "deformation" and field is not None:
                deformed_states(law, field, X if callable(field) else np.zeros((1, dim)))
        except Unfit as complaint:
            yield Problem((key,), str(complaint), field)
