"""From complaints about single keys to one line each: file, dotted key, value, what is allowed."""

import difflib
import json
import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from pmpm.scene.errors import NotBuilt, SceneError

LINES = 5
WIDTH = 80
# Marks the places where pydantic's path names the chosen member of a union; a user's path does not have them.
TAG = "kind:"
ABSENT: Any = object()

Path = tuple[str | int, ...]


@dataclass(frozen=True)
class Problem:
    """One complaint: `path` from where it is raised, `text` continues the sentence "path = value ..."."""

    path: Path
    text: str
    value: Any = ABSENT
    built: bool = True


class Problems(ValueError):  # noqa: N818
    """Carries complaints through pydantic, which adds the path down to where they were raised."""

    def __init__(self, *problems: Problem):
        super().__init__("; ".join(problem.text for problem in problems))
        self.problems = problems


def path_text(path: Iterable[str | int]) -> str:
    """Write a path as a dotted key: `bodies[0].shape.radius`; names that TOML would quote are quoted."""
    text = ""
    for part in path:
        if isinstance(part, int):
            text += f"[{part}]"
        else:
            name = part if re.fullmatch(r"[A-Za-z0-9_-]+", part) else json.dumps(part, ensure_ascii=False)
            name = cut_short(name)
            text += f".{name}" if text else name
    return text


def value_text(value: Any) -> str:
    """Write a value as it would stand in the scene file, on one line and cut short."""
    return cut_short(literal(value))


def cut_short(text: str) -> str:
    """Cut a text that would fill the screen, and write what is no visible character as an escape."""
    text = text if len(text) <= WIDTH else text[: WIDTH - 4] + " ..."
    return "".join(letter if letter.isprintable() else json.dumps(letter)[1:-1] for letter in text)


def literal(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(literal, value[:WIDTH]))}]"
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{key} = {literal(item)}' for key, item in value.items())}}}"
    if isinstance(value, int) and value.bit_length() > 512:
        return f"an integer of {value.bit_length()} bits"
    if callable(value):
        return getattr(value, "__name__", type(value).__name__)
    return " ".join((value.isoformat() if hasattr(value, "isoformat") else repr(value)).split())


def known_text(name: object, known: Collection[str], plural: str) -> str:
    """Name the known word nearest to `name`, then all of them."""
    near = difflib.get_close_matches(str(name).lower(), known, n=1, cutoff=0.5)
    guess = f"did you mean {near[0]}? " if near else ""
    return f"{guess}{plural}: {', '.join(known) or 'none'}"


def line(problem: Problem, source: str, overridden: Collection[Path] = ()) -> str:
    """Write one complaint as one line; says so where the value was set on top of the file."""
    key = path_text(problem.path)
    value = "" if problem.value is ABSENT else f" = {value_text(problem.value)}"
    subject = f"{key}{value} " if key else ""
    above = any(problem.path[: len(path)] == path for path in overridden)
    return f"{source}: {subject}{problem.text}{' (set on top of the file)' if above else ''}"


def problems_in(errors: Iterable[Mapping[str, Any]]) -> Iterator[Problem]:
    """Yield the complaints in pydantic's list of errors, each with its full path."""
    for error in errors:
        path = tuple(part for part in error["loc"] if not str(part).startswith(TAG))
        cause = error.get("ctx", {}).get("error")
        if isinstance(cause, Problems):
            for problem in cause.problems:
                yield Problem(path + problem.path, problem.text, problem.value, problem.built)
        else:
            yield Problem(path, f"is not valid: {error['msg']}", error["input"])


def scene_error(errors: Iterable[Mapping[str, Any]], source: str, overridden: Collection[Path] = ()) -> SceneError:
    """Turn pydantic's list of errors into one SceneError; NotBuilt if nothing else is wrong."""
    problems = list(problems_in(errors))
    lines = [line(problem, source, overridden) for problem in problems[:LINES]]
    if len(problems) > LINES:
        lines.append(f"{source}: and {len(problems) - LINES} more")
    kind = SceneError if any(problem.built for problem in problems) else NotBuilt
    return kind("\n".join(lines))
