"""The kinds of values a scene key can take; each checks type, finiteness and range before anything is allocated.

Each also tells what it accepts as a JSON schema, for editors and for the reference of all keys (`json_schema`).
"""

import math
import re
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from typing import Any

from pydantic import BeforeValidator

from pmpm.scene.messages import Problem, Problems, known_text

Check = Callable[[Any], Any]
Told = dict[str, Any]
# What XML cannot hold, and what makes a terminal do something; lines and tabs may be.
LABEL = "[A-Za-z0-9][A-Za-z0-9_-]{0,63}"
CONTROLS = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\ud800-\udfff\ufffe\uffff]")


@dataclass(frozen=True, eq=False)
class Checked(BeforeValidator):
    """A check of a value before pydantic sees it, that tells what it accepts: `told` gets the JSON schema of the annotated
    type and returns that of what may stand in a file."""

    told: Callable[[Told], Told] = field(kw_only=True)

    def __get_pydantic_json_schema__(self, core_schema: Any, handler: Any) -> Told:
        return self.told(handler(core_schema))


def checked(check: Check, told: Told) -> Checked:
    """Return a check that tells this JSON schema, whatever the annotated type is."""
    return Checked(check, told=lambda _: dict(told))


def number(unit: str = "-", only: float | None = None, **bounds: float | None) -> Checked:
    """Accept one finite number within `bounds` (above, at_least, below, at_most); only `only` is built, if given."""
    told = number_told(unit, **bounds) | ({} if only is None else {"const": only})
    return checked(check_number(unit, only, **bounds), told)


def vector(unit: str = "-", **bounds: float | None) -> Checked:
    """Accept two or three finite numbers, each within `bounds`."""
    return checked(check_vector(unit, **bounds), vector_told(unit, **bounds))


def number_told(unit: str = "-", **bounds: float | None) -> Told:
    """JSON schema of a number within `bounds`."""
    words = {"above": "exclusiveMinimum", "at_least": "minimum", "below": "exclusiveMaximum", "at_most": "maximum"}
    limits = {words[name]: bound for name, bound in bounds.items() if bound is not None}
    return {"type": "number", **limits, **unit_told(unit)}


def vector_told(unit: str = "-", **bounds: float | None) -> Told:
    """JSON schema of two or three numbers, each within `bounds`."""
    return {"type": "array", "items": number_told("-", **bounds), "minItems": 2, "maxItems": 3, **unit_told(unit)}


def unit_told(unit: str) -> Told:
    return {} if unit == "-" else {"x-unit": unit}


def either(*told: Told) -> Told:
    """JSON schema of what any of these accepts; the unit is theirs."""
    units = {one["x-unit"] for one in told if "x-unit" in one}
    return {"anyOf": list(told), **(unit_told(units.pop()) if len(units) == 1 else {})}


def short_told(words: Collection[str]) -> Callable[[Told], Told]:
    """JSON schema of a table that may be given by its type alone, except for friction, which needs a coefficient."""
    return lambda table: either({"enum": [word for word in words if word != "friction"]}, table)


def number_or_vector(unit: str = "-", **bounds: float | None) -> Checked:
    """Accept one finite number, or two or three, each within `bounds`."""
    one, several = check_number(unit, None, **bounds), check_vector(unit, **bounds)

    def check(value: Any) -> Any:
        value = plain(value)
        return several(value) if isinstance(value, list | tuple) else one(value)

    return checked(check, either(number_told(unit, **bounds), vector_told(unit, **bounds)))


def check_number(unit: str, only: float | None = None, **bounds: float | None) -> Check:
    allowed = range_text(unit, **bounds)

    def check(value: Any) -> Any:
        value = plain(value)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise Problems(Problem((), f"must be a number{allowed}", value))
        if not finite(value):
            raise Problems(Problem((), f"must be a finite number{allowed}", value))
        if not within(value, **bounds):
            raise Problems(Problem((), f"must be a number{allowed}", value))
        if only is not None and value != only:
            raise Problems(Problem((), f"{unit_text(unit)}is not built yet; only {only:g} is", value, built=False))
        return float(value)

    return check


def check_vector(unit: str, **bounds: float | None) -> Check:
    return check_numbers(unit, 2, **bounds)


def check_numbers(unit: str, least: int, **bounds: float | None) -> Check:
    """Return a check of a list of `least` to three numbers."""
    check_one = check_number(unit, None, **bounds)
    lengths = ("one", "two", "three")[least - 1 :]
    how_many = f"{', '.join(lengths[:-1])} or {lengths[-1]}"

    def check(value: Any) -> Any:
        value = plain(value)
        if not isinstance(value, list | tuple) or not least <= len(value) <= 3:
            raise Problems(Problem((), f"must be a list of {how_many} numbers{range_text(unit, **bounds)}", value))
        numbers, problems = [], []
        for index, item in enumerate(value):
            try:
                numbers.append(check_one(item))
            except Problems as error:
                problems += [
                    Problem((index,), problem.text, problem.value, problem.built) for problem in error.problems
                ]
        if problems:
            raise Problems(*problems)
        return tuple(numbers)

    return check


def whole(at_least: int, at_most: int) -> Checked:
    """Accept one whole number in a closed range."""

    def check(value: Any) -> Any:
        value = plain(value)
        if isinstance(value, bool) or not isinstance(value, int) or not at_least <= value <= at_most:
            raise Problems(Problem((), f"must be a whole number from {at_least} to {at_most}", value))
        return value

    return checked(check, {"type": "integer", "minimum": at_least, "maximum": at_most})


def choice(built: Collection[str], planned: Collection[str] = ()) -> Checked:
    """Accept one of the `built` words; those `planned` are known but not built yet."""

    def check(value: Any) -> Any:
        check_word(plain(value), built, planned)
        return value

    return checked(check, {"enum": list(built)})


def check_word(value: Any, built: Collection[str], planned: Collection[str] = (), path: tuple = ()) -> None:
    """Raise Problems unless `value` is one of the `built` words."""
    if isinstance(value, str) and value in built:
        return
    if isinstance(value, str) and value in planned:
        raise Problems(Problem(path, f"is not built yet; {known_text('', built, 'built so far')}", value, built=False))
    raise Problems(Problem(path, f"is not known; {known_text(value, built, 'known are')}", value))


def names(known: Collection[str] = (), least: int = 0, most: int | None = None) -> Checked:
    """Accept a list of `least` to `most` words without repetition; if any are `known`, no others may stand in a file: checked
    elsewhere."""

    def check(value: Any) -> Any:
        if not isinstance(value, list | tuple) or not all(isinstance(item, str) for item in value):
            raise Problems(Problem((), "must be a list of names in quotes", value))
        twice = [index for index, item in enumerate(value) if item in value[:index]]
        if twice:
            raise Problems(*(Problem((index,), "is named twice", value[index]) for index in twice))
        if not least <= len(value) <= (len(value) if most is None else most):
            count = f"{least}" if least == most else f"at least {least}"
            raise Problems(Problem((), f"must be a list of {count} names", value))
        return tuple(value)

    word = {"enum": list(known)} if known else {"type": "string"}
    lengths = ({"minItems": least} if least else {}) | ({} if most is None else {"maxItems": most})
    return checked(check, {"type": "array", "items": word, "uniqueItems": True, **lengths})


def flag() -> Checked:
    """Accept true or false."""

    def check(value: Any) -> Any:
        if not isinstance(plain(value), bool):
            raise Problems(Problem((), "must be true or false", value))
        return bool(value)

    return checked(check, {"type": "boolean"})


def text() -> Checked:
    """Accept a string that can stand in the index of the snapshots and on a screen."""

    def check(value: Any) -> Any:
        if not isinstance(value, str):
            raise Problems(Problem((), "must be a text in quotes", value))
        if CONTROLS.search(value):
            raise Problems(Problem((), "must hold no control characters", value))
        return value

    return checked(check, {"type": "string"})


def label() -> Checked:
    """Accept a name that a file or a column of a table can have, on any file system."""

    def check(value: Any) -> Any:
        if not isinstance(value, str) or not re.fullmatch(LABEL, value):
            text = "must be a name of 1 to 64 letters, digits, - and _, which a file or a column gets"
            raise Problems(Problem((), text, value))
        return value

    return checked(check, {"type": "string", "pattern": f"^{LABEL}$"})


def tables(singular: str, least: int = 1) -> Checked:
    """Accept a list with at least so many entries."""

    def check(value: Any) -> Any:
        if not isinstance(value, list | tuple):
            raise Problems(Problem((), f"must be a list with one table for each {singular}", value))
        if len(value) < least:
            raise Problems(Problem((), f"must have at least one {singular}", value))
        return list(value)

    return Checked(check, told=lambda inner: inner | ({"minItems": least} if least else {}))


def plain(value: Any) -> Any:
    """Turn numpy scalars and arrays into Python's numbers and lists; refuse functions, which are not built yet."""
    if callable(value):
        raise Problems(Problem((), "as a Python function is not built yet; give numbers", value, built=False))
    return value.tolist() if hasattr(value, "tolist") else value


def finite(value: int | float) -> bool:
    try:
        return math.isfinite(float(value))
    except OverflowError:
        return False


def within(
    value: float,
    above: float | None = None,
    at_least: float | None = None,
    below: float | None = None,
    at_most: float | None = None,
) -> bool:
    """Say whether `value` lies within the bounds; None stands for no bound."""
    return (
        (above is None or value > above)
        and (at_least is None or value >= at_least)
        and (below is None or value < below)
        and (at_most is None or value <= at_most)
    )


def range_text(unit: str, **bounds: float | None) -> str:
    """Write bounds and unit: ` > 0 and <= 1`, ` > 0 m`, ` in m/s2`, or nothing."""
    signs = {"above": ">", "at_least": ">=", "below": "<", "at_most": "<="}
    limits = [f"{sign} {bounds[name]:g}" for name, sign in signs.items() if bounds.get(name) is not None]
    if limits:
        return f" {' and '.join(limits)} {unit_text(unit)}".rstrip()
    return f" in {unit}" if unit != "-" else ""


def unit_text(unit: str) -> str:
    return "" if unit == "-" else f"{unit} "
