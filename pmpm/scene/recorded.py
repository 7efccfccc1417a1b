"""Functions in the place of values: what a scene file says of them, and that it cannot hold them."""

import functools
import hashlib
from collections.abc import Callable
from types import CodeType, FunctionType
from typing import Any

import numpy as np

from pmpm.physics.materials.python_law import PREFIX
from pmpm.scene.messages import Problem, Problems

FROM_PYTHON = {"not": {}, "x-python": True}  # JSON schema of a key that a file cannot hold
MOST_DEPTH = 10  # of functions that call functions, in a fingerprint


def refuse_record(value: Any) -> None:
    """Raise Problems for what stands in a file in the place of a function, which the file does not hold."""
    if isinstance(value, str) and value.startswith(PREFIX):
        name = value.split(":")[1]
        text = f"is a Python function, which a file does not hold: give {name} here, from Python"
        raise Problems(Problem((), text, value))


def function_or(check: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Accept a function as it is, and else what `check` accepts."""

    def check_field(value: Any) -> Any:
        refuse_record(value)
        return value if callable(value) else check(value)

    return check_field


def record(field: Any) -> Any:
    """Return what stands in a scene file: a constant itself, a function as python:<name>:<hash>."""
    if not callable(field):
        return field
    name = getattr(field, "__name__", type(field).__name__)
    return f"{PREFIX}{name}:{hashlib.sha256(fingerprint(field).encode()).hexdigest()[:12]}"


def fingerprint(value: Any, above: tuple[Any, ...] = ()) -> str:
    """Write down the code and the values that a function reaches, as far as they show; holds for one version of Python."""
    if any(value is other for other in above) or len(above) > MOST_DEPTH:
        return "again"
    inside = functools.partial(fingerprint, above=(*above, value))
    if isinstance(value, FunctionType):
        names = [name for name in value.__code__.co_names if name in value.__globals__]
        known = [f"{name}={inside(value.__globals__[name])}" for name in names]
        closed = [inside(cell.cell_contents) for cell in value.__closure__ or ()]
        return f"{inside(value.__code__)}{known}{closed}{inside(value.__defaults__)}{inside(value.__kwdefaults__)}"
    if isinstance(value, CodeType):
        return f"{value.co_code.hex()}{value.co_names}{[inside(constant) for constant in value.co_consts]}"
    if isinstance(value, functools.partial):
        return f"partial {inside(value.func)}{inside(value.args)}{inside(value.keywords)}"
    if isinstance(value, np.ndarray | np.generic):
        return f"{value.dtype}{value.shape}{hashlib.sha256(value.tobytes()).hexdigest()}"
    if isinstance(value, tuple | list):
        return f"{[inside(item) for item in value]}"
    if isinstance(value, dict):
        return f"{[(str(key), inside(item)) for key, item in value.items()]}"
    if value is None or isinstance(value, bool | int | float | complex | str | bytes):
        return repr(value)
    if callable(getattr(value, "__func__", None)):
        return f"method {inside(value.__func__)}{inside(value.__self__)}"
    own = {} if isinstance(value, type) or hasattr(value, "__spec__") else getattr(value, "__dict__", {})
    call = vars(type(value)).get("__call__")
    named = getattr(value, "__qualname__", getattr(value, "__name__", ""))
    return f"{type(value).__qualname__} {named}{inside(own)}{inside(call) if isinstance(call, FunctionType) else ''}"
