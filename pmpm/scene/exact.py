"""An exact solution that a scene may carry: functions of reference position and time, against which errors are measured.

Plain Python over numpy, as in `start`; nothing of it is compiled, and nothing of it acts on a run.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import Field, field_serializer

from pmpm.scene import start
from pmpm.scene.functions import Unfit
from pmpm.scene.messages import Problem, Problems
from pmpm.scene.part import Part
from pmpm.scene.recorded import FROM_PYTHON, record, refuse_record
from pmpm.scene.values import Checked, checked, finite


def function_of(name: str) -> Checked:
    """Accept a function of (X, t)."""

    def check(value: Any) -> Any:
        refuse_record(value)
        if not callable(value):
            raise Problems(Problem((), f"must be a function {name}(X, t), from Python", value))
        return value

    return checked(check, FROM_PYTHON)


class Exact(Part):
    """The exact solution: each a function of X (n, dim) in m and t in s over numpy arrays."""

    displacement: Annotated[Any, function_of("u")] = Field(description="function u(X, t) -> (n, dim) (m)")
    velocity: Annotated[Any, function_of("v")] = Field(default=None, description="function v(X, t) -> (n, dim) (m/s)")
    deformation: Annotated[Any, function_of("F")] = Field(
        default=None, description="function F(X, t) -> (n, dim, dim), the deformation gradient"
    )

    @field_serializer("displacement", "velocity", "deformation")
    def recorded(self, function: Any) -> Any:
        return function and record(function)

    def shapes(self, dim: int) -> dict[str, tuple[int, ...]]:
        """Return {key: shape of what it gives to one particle} of the functions that are given."""
        known = {"displacement": (dim,), "velocity": (dim,), "deformation": (dim, dim)}
        return {key: shape for key, shape in known.items() if getattr(self, key) is not None}

    def at(self, key: str, X: np.ndarray, t: float, shape: tuple[int, ...]) -> np.ndarray:
        """Return (n, *shape) float64, one of the functions at X (n, dim) in m and t in s. Raises Unfit."""
        try:
            return start.evaluate(at_time(getattr(self, key), t), X, shape)
        except Unfit as complaint:
            raise Unfit(f"{complaint}, t = {t:.6g} s") from None


def at_time(function: Any, t: float) -> Callable[[np.ndarray], Any]:
    return lambda X: function(X, t)


def wrong_exact(exact: Exact, bodies: Sequence[Any], dim: int, end: float) -> Iterator[Problem]:
    """Yield what shows when the functions are tried on a few places of the bodies, at the start and at the end (s)."""
    X = tried_places(bodies, dim)
    if not len(X):
        return
    for key, shape in exact.shapes(dim).items():
        try:
            for t in filter(finite, (0.0, end)):
                exact.at(key, X, t, shape)
                start.check_field(at_time(getattr(exact, key), t), X, shape)
        except Unfit as complaint:
            yield Problem(("exact", key), str(complaint), getattr(exact, key))


def tried_places(bodies: Sequence[Any], dim: int) -> np.ndarray:
    """Return a few places (n, dim), m, in the first body that has any which later ones leave to it."""
    shapes = [body.shape for body in bodies]
    found = (start.places_in(shapes[index:], dim) for index in range(len(shapes)))
    return next((X for X in found if len(X)), np.zeros((0, dim)))
