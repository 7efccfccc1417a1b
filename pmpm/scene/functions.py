"""Python functions given as laws: checked in plain Python, before a kernel is compiled or anything is allocated.

A kernel takes a function apart and compiles it for lanes of particles, so the rules of `pmpm.physics` hold for it. It is
tried on single numbers and on arrays of numbers that watch what is done with them, and complaints are in the user's words.
"""

import dis
import inspect
import math
from collections.abc import Iterator
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np

from pmpm.kernels import targets
from pmpm.physics import tensors2, tensors3
from pmpm.scene.messages import Problem, Problems
from pmpm.scene.values import finite

STRAIN = 1e-5  # of the finite differences around rest: about 1e-10 of error from the step and from rounding
WITHIN = 1e-4  # how far a given wave speed may miss the one found that way
TRIED = 0.01  # strain at which one particle and arrays of them are compared
WORDS = "exp, expm1, log, log1p, sin, cos, sqrt, abs, min, max, where"
RULES = "see 'A law of your own' in docs/scene.md"


def tensors_of(dim: int) -> ModuleType:
    return tensors2 if dim == 2 else tensors3


def digest(function: FunctionType, dim: int) -> str:
    """Return a hash over the code and constants that a function reaches; it holds for one minor version of Python."""
    return targets.plain(la=tensors_of(dim)).specialise(function, False)[1]


# ---- what can be said of a function without calling it ----


def check_function(value: Any) -> None:
    """Raise Problems unless `value` is a function that can be compiled, with numbers for defaults."""
    complaint = next(complaints(value), None)
    if complaint:
        raise Problems(unfit_problem(value, complaint))


def check_compilable(value: Any, arguments: tuple[str, ...]) -> None:
    """Raise Problems unless `value` is a function of just these arguments that can be compiled."""
    complaint = next(complaints(value), None)
    if not complaint and tuple(inspect.signature(value).parameters) != arguments:
        complaint = f"must take ({', '.join(arguments)}), and nothing else"
    if complaint:
        raise Problems(Problem((), f"{complaint}; {RULES}", value))


def unfit_problem(value: Any, complaint: object) -> Problem:
    return Problem(("model",), f"{complaint}; {RULES}", value)


def complaints(value: Any) -> Iterator[str]:
    """Yield what keeps a callable from being a law."""
    if not isinstance(value, FunctionType) or value.__name__ == "<lambda>":
        kind = "a lambda" if isinstance(value, FunctionType) else f"a {type(value).__name__}"
        yield f"must be a plain function made by def, not {kind}"
        return
    names = list(inspect.signature(value).parameters.values())
    if any(p.kind not in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD) for p in names):
        yield "must name its arguments one by one, without * and **"
    elif not names:
        yield "must take F, and then its parameters"
    elif names[0].default is not names[0].empty:
        yield "must take F without a default"
    for p in names:
        given = p.default is not p.empty
        if given and (isinstance(p.default, bool) or not isinstance(p.default, int | float) or not finite(p.default)):
            yield f"must have a finite number as default of {p.name}"
    yield from unfit(value, ())


def unfit(function: FunctionType, callers: tuple[FunctionType, ...]) -> Iterator[str]:
    """Yield what cannot be compiled in a function or in what it calls outside pmpm."""
    here = f"calls {function.__name__}, which " if callers else ""
    code = function.__code__
    if function in callers:
        yield f"{here}calls itself"
        return
    if function.__closure__:
        names = ", ".join(code.co_freevars)
        yield f"{here}must not close over variables ({names}): make them parameters or module-level numbers"
        return
    if any(isinstance(constant, CodeType) for constant in code.co_consts):
        yield f"{here}must not hold a comprehension, a lambda or another def"
        return
    operators = [step.argrepr for step in dis.get_instructions(code) if step.opname == "BINARY_OP"]
    if any(operator.startswith("**") for operator in operators):
        yield f"{here}must not use **: write x * x, or exp(a * log(x))"
    for name, value in named(function):
        if isinstance(value, FunctionType):
            if not of_pmpm(value.__module__):
                yield from unfit(value, (*callers, function))
        elif not compilable(value):
            kind = "module" if isinstance(value, ModuleType) else type(value).__name__
            yield f"{here}uses {name} ({kind}): kernels know numbers, tuples of numbers, plain functions and {WORDS}"


def named(function: FunctionType) -> Iterator[tuple[str, Any]]:
    """Yield (name, value) of what a function takes from its module, and from modules known there, outside pmpm."""
    names = function.__code__.co_names
    for name in names:
        if name in function.__globals__:
            value = function.__globals__[name]
            yield name, value
            if isinstance(value, ModuleType) and not known(value):
                yield from ((f"{name}.{n}", vars(value)[n]) for n in names if n in vars(value))


def of_pmpm(module: str | None) -> bool:
    return (module or "").startswith("pmpm.physics")


def known(module: ModuleType) -> bool:
    return module is math or of_pmpm(module.__name__)


def compilable(value: Any) -> bool:
    """Say whether a kernel can hold a module-level value that is no function of the user."""
    if isinstance(value, tuple):
        return all(map(compilable, value))
    if isinstance(value, ModuleType):
        return known(value) or value.__name__.split(".")[0] not in targets.OUTSIDE
    return isinstance(value, int | float) or (
        isinstance(value, BuiltinFunctionType) and value.__name__ in WORDS.split(", ")
    )


# ---- what shows when it is called ----


class Unfit(Exception):  # noqa: N818
    """What a function does that a kernel cannot, as the rest of a sentence."""


class Watched(np.ndarray):
    """Numbers of several particles that complain where a kernel would fail or leave the precision of the scene."""

    def __array_ufunc__(self, ufunc, method, *inputs, **more):
        if "out" in more:
            raise Unfit("must give min and max two numbers at a time")
        check_real(inputs)
        numbers = [value.view(np.ndarray) if isinstance(value, Watched) else value for value in inputs]
        return getattr(ufunc, method)(*numbers).view(Watched)

    def __array_function__(self, function, types, inputs, more):
        check_real(inputs)
        return super().__array_function__(function, types, inputs, more).view(Watched)

    def __bool__(self):
        raise Unfit(
            "must not use if, and, or on numbers that differ between particles: use where(condition, a, b), & and |"
        )

    def __float__(self):
        raise Unfit(f"calls a function that kernels do not know; known are {WORDS}")


def check_real(inputs: tuple[Any, ...]) -> None:
    whole = [value for value in inputs if type(value) is int]
    if whole:
        raise Unfit(f"mixes the whole number {whole[0]} with reals: write {whole[0]}.0")


def check_stress(function: FunctionType, dim: int, numbers: tuple[float, ...]) -> None:
    """Raise Unfit unless a function gives a stress at rest and near it, for one particle and for many alike."""
    one_by_one = [stress(function, dim, numbers, F) for F in near_rest(dim)]
    together = stresses(function, dim, numbers, near_rest(dim))
    if not np.allclose(one_by_one, together, rtol=0.0, atol=1e-8 * np.abs(one_by_one).max()):
        raise Unfit("gives other stresses to many particles at once than to one of them")


def near_rest(dim: int) -> np.ndarray:
    """(3, dim dim) deformation gradients: undeformed, and strained a little both ways."""
    pattern = np.sin(np.arange(1.0, dim * dim + 1.0))
    return np.eye(dim).ravel() + TRIED * np.outer((0.0, 1.0, -1.0), pattern)


def stress(function: FunctionType, dim: int, numbers: tuple[float, ...], F: np.ndarray) -> tuple[float, ...]:
    """Return what a function gives to one particle. Raises Unfit unless that is a stress."""
    place = f"at F = ({', '.join(f'{entry:g}' for entry in F)})"
    try:
        with np.errstate(all="ignore"):
            tau = targets.plain(la=tensors_of(dim)).compile(function)(tuple(map(float, F)), *numbers)
    except Exception as error:
        raise Unfit(f"fails in {dim}-D {place}: {type(error).__name__}: {error}") from None
    wanted = "(xx, xy, yy) or (xx, xy, yy, zz)" if dim == 2 else "(xx, xy, xz, yy, yz, zz)"
    if not isinstance(tau, tuple) or len(tau) not in ((3, 4) if dim == 2 else (6,)):
        what = f"a tuple of {len(tau)}" if isinstance(tau, tuple) else f"a {type(tau).__name__}"
        raise Unfit(f"must return {wanted} in {dim}-D, not {what}")
    for value in tau:
        if not isinstance(value, float):
            raise Unfit(f"must return reals such as 0.0, not {value}, {place}")
        if not math.isfinite(value):
            raise Unfit(f"must return finite numbers, not {value}, {place}")
    return tau


def check_acceleration(function: FunctionType, dim: int, middle: np.ndarray) -> None:
    """Raise Unfit unless b(x, X, t) gives `dim` finite reals (m/s2) around `middle`, to one particle and to many alike."""
    places = middle + np.array([[0.0], [0.01], [-0.02]]) * middle
    one_by_one = [acceleration(function, dim, tuple(map(float, x))) for x in places]
    x, t = tuple(column.copy().view(Watched) for column in places.T), 0.0
    try:
        with np.errstate(all="ignore"):
            found = targets.arrays(np.float64, la=tensors_of(dim)).compile(function)(x, x, t)
    except Unfit:
        raise
    except Exception as error:
        raise Unfit(f"fails for many particles at once: {type(error).__name__}: {error}") from None
    together = np.stack([np.broadcast_to(np.asarray(entry), len(places)) for entry in found], axis=-1)
    if not np.allclose(one_by_one, together, rtol=1e-9, atol=1e-9 * np.abs(one_by_one).max()):
        raise Unfit("gives other accelerations to many particles at once than to one of them")


def acceleration(function: FunctionType, dim: int, x: tuple[float, ...]) -> tuple[float, ...]:
    """Return b(x, x, 0). Raises Unfit unless that is an acceleration."""
    place = f"at x = X = ({', '.join(f'{entry:g}' for entry in x)}), t = 0"
    try:
        with np.errstate(all="ignore"):
            found = targets.plain(la=tensors_of(dim)).compile(function)(x, x, 0.0)
    except Exception as error:
        raise Unfit(f"fails in {dim}-D {place}: {type(error).__name__}: {error}") from None
    if not isinstance(found, tuple) or len(found) != dim:
        raise Unfit(f"must return a tuple of {dim} accelerations (m/s2)")
    for value in found:
        if not isinstance(value, float) or not math.isfinite(value):
            raise Unfit(f"must return finite reals such as 0.0, not {value}, {place}")
    return found


def stresses(function: FunctionType, dim: int, numbers: tuple[float, ...], tried: np.ndarray) -> np.ndarray:
    """(n, entries) stresses of several particles at once. Raises Unfit where that fails."""
    F = tuple(column.copy().view(Watched) for column in tried.T)
    values = tuple(np.full(len(tried), number).view(Watched) for number in numbers)
    try:
        with np.errstate(all="ignore"):
            tau = targets.arrays(np.float64, la=tensors_of(dim)).compile(function)(F, *values)
    except Unfit:
        raise
    except Exception as error:
        raise Unfit(f"fails for many particles at once: {type(error).__name__}: {error}") from None
    return np.stack([np.broadcast_to(np.asarray(entry), len(tried)) for entry in tau], axis=-1)


def speed_at_rest(function: FunctionType, dim: int, numbers: tuple[float, ...], density: float) -> float | None:
    """Return the speed in m/s of the fastest wave along an axis in the undeformed material; None without stiffness.

    Raises Unfit as `stress` does.
    """
    pairs = [(i, j) for i in range(dim) for j in range(i, dim)]
    rest, stiffest = np.eye(dim), 0.0
    for entry, (i, j) in enumerate(pairs):
        bend = np.zeros((dim, dim))
        bend[i, j] = STRAIN
        high, low = (stress(function, dim, numbers, (rest + sign * bend).ravel())[entry] for sign in (1.0, -1.0))
        stiffest = max(stiffest, (high - low) / (2.0 * STRAIN))
    return math.sqrt(stiffest / density) if 0.0 < stiffest < math.inf else None
