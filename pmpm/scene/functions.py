"""Python functions given as laws: checked in plain Python, before a kernel is compiled or anything is allocated.

A kernel takes a function apart and compiles it for lanes of particles, so the rules of `pmpm.physics` hold for it. It is
tried on single numbers and on arrays of numbers that watch what is done with them, and complaints are in the user's words.
"""

import dis
import hashlib
import inspect
import math
from collections.abc import Iterator
from keyword import iskeyword
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np

from pmpm.kernels import targets
from pmpm.physics import tensors2, tensors3
from pmpm.physics.materials import own_law
from pmpm.physics.materials.own_law import Law
from pmpm.scene.messages import Problem, Problems
from pmpm.scene.values import finite
from pmpm.state.fields import COMMON, OPTIONAL, OUTPUT

STRAIN = 1e-5  # of the finite differences around rest: about 1e-10 of error from the step and from rounding
WITHIN = 1e-4  # how far a given wave speed may miss the one found that way
TRIED = 0.01  # strain at which one particle and arrays of them are compared
STEP = 1e-3  # s, of an advance that is tried
MOST_NUMBERS = 12  # that kernels know as the state of a particle
# What a state variable cannot be called, for it has a meaning in the output, beside particles, or in the functions.
TAKEN = (
    *(field.name for field in (*COMMON, *OPTIONAL, *OUTPUT)),
    *("F", "G", "dt", "id", "mass", "volume", "volume0", "sound_speed", "model", "Points"),
)
WORDS = "exp, expm1, log, log1p, sin, cos, sqrt, abs, min, max, where"
RULES = "see 'A law of your own' in docs/scene.md"


def tensors_of(dim: int) -> ModuleType:
    return tensors2 if dim == 2 else tensors3


def digest(law: Law, dim: int) -> str:
    """Return a hash over the code and constants that a law reaches; it holds for one minor version of Python."""
    target = targets.plain(la=tensors_of(dim))
    known = sorted(own_law.bound(law).items())
    marks = [target.specialise(value)[1] if isinstance(value, FunctionType) else repr(value) for _, value in known]
    return hashlib.sha256(f"{marks}{law.state}".encode()).hexdigest()[:12]


# ---- what can be said of a function without calling it ----


def check_law(law: Law) -> None:
    """Raise Problems unless the functions of a law can be compiled and its state has sensible names and numbers."""
    for function in law.functions.values():
        complaint = next(complaints(function), None)
        if complaint:
            raise Problems(unfit_problem(function, complaint))
    complaint = next(wrong_state(law), None) or next(wrong_arguments(law), None)
    if complaint:
        raise Problems(unfit_problem(law.stress, complaint))


def check_compilable(value: Any, arguments: tuple[str, ...]) -> None:
    """Raise Problems unless `value` is a function of just these arguments that can be compiled."""
    complaint = next(complaints(value), None)
    if not complaint and tuple(inspect.signature(value).parameters) != arguments:
        complaint = f"must take ({', '.join(arguments)}), and nothing else"
    if complaint:
        raise Problems(Problem((), f"{complaint}; {RULES}", value))


def unfit_problem(value: Any, complaint: object) -> Problem:
    return Problem(("model",), f"{complaint}; {RULES}", value)


def wrong_state(law: Law) -> Iterator[str]:
    """Yield what keeps the state of a law from being one."""
    if law.name is not None and not (isinstance(law.name, str) and law.name.isidentifier()):
        yield f"belongs to a law whose name must be a word, not {law.name!r}"
    pairs = isinstance(law.state, tuple) and all(isinstance(item, tuple) and len(item) == 2 for item in law.state)
    if not pairs:
        yield f'must have its state as a table like {{"damage": 0.0}}, not {law.state!r}'
        return
    for name, rest in law.state:
        if not isinstance(name, str) or not name.isidentifier() or iskeyword(name) or name.startswith("_"):
            yield f"must not call a state variable {name!r}: it must be a word that Python can have for a name"
        elif name in TAKEN:
            yield f"must not call a state variable {name}: the name is taken"
        numbers = rest if isinstance(rest, tuple) else (rest,)
        if not numbers or not all(is_number(number) for number in numbers):
            yield f"must have a finite number, or a tuple of them, for {name} at rest, not {rest!r}"


def wrong_arguments(law: Law) -> Iterator[str]:
    """Yield what does not fit between the functions of a law."""
    for kind, function in law.functions.items():
        for name in own_law.argument_names(function)[1:]:
            if kind == "valid" and name not in law.own:
                yield f"must have a valid function of F and state variables only, not of {name}"
            if law.advance is not None and kind != "advance" and name in own_law.OF_A_STEP:
                yield f"must not take {name} in {kind}: beside advance, {' and '.join(own_law.OF_A_STEP)} belong to it"
    if law.own and law.advance is None:
        yield f"must have an advance function: without it the state ({', '.join(law.own)}) never changes"


def is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and finite(value)


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
        if p.default is not p.empty and not is_number(p.default):
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


def check_calls(law: Law, dim: int, numbers: tuple[float, ...]) -> None:
    """Raise Unfit unless the functions of a law give what they should at rest and near it, to one particle and to many."""
    check_stress(law, dim, numbers)
    for kind in law.functions:
        if kind != "stress":
            check_call(law, kind, dim, numbers)


def check_stress(law: Law, dim: int, numbers: tuple[float, ...]) -> None:
    """Raise Unfit unless a law gives a stress at rest and near it, for one particle and for many alike."""
    one_by_one = [stress(law, dim, numbers, F) for F in near_rest(dim)]
    together = stresses(law, dim, numbers, near_rest(dim))
    if not np.allclose(one_by_one, together, rtol=0.0, atol=1e-8 * np.abs(one_by_one).max()):
        raise Unfit("gives other stresses to many particles at once than to one of them")


def near_rest(dim: int) -> np.ndarray:
    """(3, dim dim) deformation gradients: undeformed, and strained a little both ways."""
    pattern = np.sin(np.arange(1.0, dim * dim + 1.0))
    return np.eye(dim).ravel() + TRIED * np.outer((0.0, 1.0, -1.0), pattern)


def at(F: np.ndarray) -> str:
    return f"at F = ({', '.join(f'{entry:g}' for entry in F)})"


def state_at(law: Law, F: np.ndarray) -> tuple[float, ...]:
    """The flat state of a particle whose own variables are at rest."""
    rest = (number for numbers in law.own.values() for number in numbers)
    return (*map(float, F), *map(float, rest))


def stress(law: Law, dim: int, numbers: tuple[float, ...], F: np.ndarray) -> tuple[float, ...]:
    """Return what a law gives to one particle. Raises Unfit unless that is a stress."""
    try:
        with np.errstate(all="ignore"):
            tau = plain_call(law, "stress", dim)(state_at(law, F), (0.0, *numbers))
    except Exception as error:
        raise Unfit(f"fails in {dim}-D {at(F)}: {type(error).__name__}: {error}") from None
    wanted = "(xx, xy, yy) or (xx, xy, yy, zz)" if dim == 2 else "(xx, xy, xz, yy, yz, zz)"
    if not isinstance(tau, tuple) or len(tau) not in ((3, 4) if dim == 2 else (6,)):
        what = f"a tuple of {len(tau)}" if isinstance(tau, tuple) else f"a {type(tau).__name__}"
        raise Unfit(f"must return {wanted} in {dim}-D, not {what}")
    check_reals(tau, at(F))
    return tau


def check_reals(values: tuple[Any, ...], place: str) -> None:
    for value in values:
        if not isinstance(value, float):
            raise Unfit(f"must return reals such as 0.0, not {value}, {place}")
        if not math.isfinite(value):
            raise Unfit(f"must return finite numbers, not {value}, {place}")


def plain_call(law: Law, kind: str, dim: int) -> Any:
    return targets.plain(la=tensors_of(dim)).compile(own_law.raw(law, kind))


def arguments(kind: str, state: Any, G: Any, params: Any) -> tuple[Any, ...]:
    return {"advance": (state, G, STEP, params), "valid": (state,)}.get(kind, (state, params))


def check_call(law: Law, kind: str, dim: int, numbers: tuple[float, ...]) -> None:
    """Raise Unfit, naming the function, unless it gives what it should to one particle and the same to many."""
    name = f"has {law.functions[kind].__name__} for {kind}, which"
    tried = near_rest(dim)
    G = TRIED * np.outer((1.0, -0.5, 0.5), np.cos(np.arange(1.0, dim * dim + 1.0)))
    one_by_one = []
    for F, gradient in zip(tried, G, strict=True):
        try:
            with np.errstate(all="ignore"):
                given = arguments(kind, state_at(law, F), tuple(map(float, gradient)), (0.0, *numbers))
                found = plain_call(law, kind, dim)(*given)
        except Exception as error:
            raise Unfit(f"{name} fails in {dim}-D {at(F)}: {type(error).__name__}: {error}") from None
        try:
            flat = flat_result(law, kind, dim, found)
            check_reals(flat if kind != "valid" else (), at(F))
        except Unfit as complaint:
            raise Unfit(f"{name} {complaint}") from None
        if kind == "valid" and not found:
            raise Unfit(f"{name} must hold {at(F)}, near rest")
        if kind == "wave_speed" and not found > 0.0:
            raise Unfit(f"{name} must return a speed > 0 m/s, not {found}, {at(F)}")
        one_by_one.append(flat)
    together = flat_of_many(law, kind, dim, numbers, tried, G, name)
    if not np.allclose(one_by_one, together, rtol=1e-8, atol=1e-8 * np.abs(np.array(one_by_one, float)).max()):
        raise Unfit(f"{name} gives other values to many particles at once than to one of them")


def flat_result(law: Law, kind: str, dim: int, found: Any) -> tuple[Any, ...]:
    """What a function other than stress returned, as one tuple. Raises Unfit where it has another form."""
    if kind == "valid":
        if not isinstance(found, bool | np.bool_ | np.ndarray):
            raise Unfit(f"must return a comparison such as damage <= 1.0, not a {type(found).__name__}")
        return (found,)
    if kind != "advance":
        if isinstance(found, tuple):
            raise Unfit("must return one number, not a tuple")
        return (found,)
    own = [(name, rest) for name, rest in law.state]
    form = f"({', '.join(['F', *(name for name, _ in own)])})" if own else "F"
    parts = found if own else (found,)
    if not isinstance(parts, tuple) or len(parts) != 1 + len(own):
        raise Unfit(f"must return {form}")
    F, *variables = parts
    if not isinstance(F, tuple) or len(F) != dim * dim:
        raise Unfit(f"must return {form}, with F a tuple of {dim * dim} in {dim}-D")
    flat = list(F)
    for (name, rest), value in zip(own, variables, strict=True):
        if isinstance(rest, tuple) and not (isinstance(value, tuple) and len(value) == len(rest)):
            raise Unfit(f"must return {form}, with {name} a tuple of {len(rest)}")
        if not isinstance(rest, tuple) and isinstance(value, tuple):
            raise Unfit(f"must return {form}, with {name} a number")
        flat += value if isinstance(rest, tuple) else [value]
    return tuple(flat)


def check_acceleration(function: FunctionType, dim: int, middle: np.ndarray) -> None:
    """Raise Unfit unless b(x, X, t) gives `dim` finite reals (m/s2) around `middle`, to one particle and to many alike."""
    places = middle + np.array([[0.0], [0.01], [-0.02]]) * middle
    one_by_one = [acceleration(function, dim, tuple(map(float, x))) for x in places]
    found = of_many(function, dim, (watched(places.T), watched(places.T), 0.0))
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
    check_reals(found, place)
    return found


def watched(columns: Any) -> tuple[Watched, ...]:
    return tuple(np.ascontiguousarray(column, float).view(Watched) for column in columns)


def many(law: Law, kind: str, dim: int, numbers: tuple[float, ...], tried: np.ndarray, G: Any = None) -> Any:
    """What a function returns to several particles at once. Raises Unfit where that fails."""
    state = watched(np.array([state_at(law, F) for F in tried]).T)
    params = watched(np.full((1 + len(numbers), len(tried)), [[0.0], *([number] for number in numbers)]))
    return of_many(own_law.raw(law, kind), dim, arguments(kind, state, None if G is None else watched(G.T), params))


def of_many(function: FunctionType, dim: int, given: tuple[Any, ...]) -> Any:
    """What a function makes of arrays of numbers. Raises Unfit where it fails."""
    try:
        with np.errstate(all="ignore"):
            return targets.arrays(np.float64, la=tensors_of(dim)).compile(function)(*given)
    except Unfit:
        raise
    except Exception as error:
        raise Unfit(f"fails for many particles at once: {type(error).__name__}: {error}") from None


def stresses(law: Law, dim: int, numbers: tuple[float, ...], tried: np.ndarray) -> np.ndarray:
    """(n, entries) stresses of several particles at once. Raises Unfit where that fails."""
    tau = many(law, "stress", dim, numbers, tried)
    return np.stack([np.broadcast_to(np.asarray(entry), len(tried)) for entry in tau], axis=-1)


def flat_of_many(
    law: Law, kind: str, dim: int, numbers: tuple[float, ...], tried: np.ndarray, G: np.ndarray, name: str
) -> np.ndarray:
    """(n, entries) of what a function gives to several particles at once. Raises Unfit, naming it, where that fails."""
    try:
        flat = flat_result(law, kind, dim, many(law, kind, dim, numbers, tried, G))
        if kind == "advance" and not all(isinstance(entry, np.ndarray) for entry in flat[: dim * dim]):
            raise Unfit("must make F from the F and G of the particle, not from constants")
    except Unfit as complaint:
        raise Unfit(f"{name} {complaint}") from None
    return np.stack([np.broadcast_to(np.asarray(entry), len(tried)) for entry in flat], axis=-1)


def told_speed_at_rest(law: Law, dim: int, numbers: tuple[float, ...]) -> float | None:
    """Return the wave speed in m/s that the law itself tells of the undeformed material, if it does."""
    if law.wave_speed is None:
        return None
    return float(plain_call(law, "wave_speed", dim)(state_at(law, np.eye(dim).ravel()), (0.0, *numbers)))


def speed_at_rest(law: Law, dim: int, numbers: tuple[float, ...], density: float) -> float | None:
    """Return the speed in m/s of the fastest wave along an axis in the undeformed material; None without stiffness.

    Raises Unfit as `stress` does.
    """
    pairs = [(i, j) for i in range(dim) for j in range(i, dim)]
    rest, stiffest = np.eye(dim), 0.0
    for entry, (i, j) in enumerate(pairs):
        bend = np.zeros((dim, dim))
        bend[i, j] = STRAIN
        high, low = (stress(law, dim, numbers, (rest + sign * bend).ravel())[entry] for sign in (1.0, -1.0))
        stiffest = max(stiffest, (high - low) / (2.0 * STRAIN))
    return math.sqrt(stiffest / density) if 0.0 < stiffest < math.inf else None
