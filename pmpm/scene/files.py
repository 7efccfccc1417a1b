"""From files and `--set` texts to plain tables, before anything is checked; needs no pydantic."""

import os
import re
import select
import stat
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pmpm.scene.errors import SceneError
from pmpm.scene.messages import cut_short, known_text, path_text, value_text

MOST_BYTES = 16 << 20  # of a scene file
PATIENCE = 30  # s
BUILTIN = Path(__file__).parent / "builtin"


def builtin_scenes() -> dict[str, Path]:
    """Return the built-in scenes: name -> file."""
    return {path.stem: path for path in sorted(BUILTIN.glob("*.toml"))}


def builtin_path(name: str) -> Path:
    """Return the file of a built-in scene; raises SceneError with the nearest name."""
    scenes = builtin_scenes()
    if name not in scenes:
        raise SceneError(f"{name}: is not a built-in scene; {known_text(name, scenes, 'built-in are')}")
    return scenes[name]


def find_scene(name: str) -> Path:
    """Return the file a user means by `name`: a file, else a built-in scene; raises SceneError if it is neither.

    A directory does not stand in the way of a built-in scene: `pmpm run dam_break` leaves one of that name.
    """
    scenes = builtin_scenes()
    try:
        is_file, exists = Path(name).is_file(), Path(name).exists()
    except OSError as error:  # a name that is too long
        raise SceneError(f"{cut_short(name)}: cannot be looked up: {error.strerror}") from None
    if not is_file and name in scenes:
        return scenes[name]
    if not exists:
        raise SceneError(f"{name}: no such file, nor a built-in scene; {known_text(name, scenes, 'built-in are')}")
    return Path(name)


def read_text(path: str | Path) -> str:
    """Read a scene file; raises SceneError for whatever keeps it from being read."""
    try:
        content = read_bytes(Path(path))
        return content.decode("utf-8-sig")
    except FileNotFoundError:
        raise SceneError(f"{path}: no such file") from None
    except IsADirectoryError:
        raise SceneError(f"{path}: is a directory, not a scene file") from None
    except UnicodeDecodeError as error:
        raise SceneError(f"{path}: is not UTF-8 text: byte {error.object[error.start]:#04x} at {error.start}") from None
    except (OSError, ValueError) as error:
        raise SceneError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from None


def read_bytes(path: Path) -> bytes:
    """Read a file, device or pipe; raises SceneError for one that never ends or that nothing comes out of."""
    mode = path.stat().st_mode
    if stat.S_ISDIR(mode):
        raise SceneError(f"{path}: is a directory, not a scene file")
    if stat.S_ISFIFO(mode):
        return bounded(path, read_pipe(path))
    with path.open("rb") as file:
        return bounded(path, file.read(MOST_BYTES + 1))


def bounded(path: Path, content: bytes) -> bytes:
    if len(content) > MOST_BYTES:
        raise SceneError(f"{path}: is longer than {MOST_BYTES >> 20} MB: no scene file")
    return content


def read_pipe(path: Path) -> bytes:
    """Read what comes out of a pipe; where nobody writes, that is nothing. Raises SceneError after a time without a word."""
    pipe = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    try:
        content = b""
        while len(content) <= MOST_BYTES:
            if not select.select([pipe], [], [], PATIENCE)[0]:
                raise SceneError(f"{path}: is a pipe out of which nothing came for {PATIENCE} s")
            piece = os.read(pipe, 1 << 16)
            if not piece:
                break
            content += piece
        return content
    finally:
        os.close(pipe)


def parse_toml(text: str, source: str) -> dict[str, Any]:
    """Parse a scene file; raises SceneError with line and column."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise SceneError(f"{source}: is not valid TOML: {' '.join(str(error).split())}") from None
    except RecursionError:
        raise SceneError(f"{source}: is not valid TOML: nested too deeply") from None
    except ValueError as error:  # an integer of thousands of digits
        raise SceneError(f"{source}: holds a number that cannot be read: {error}") from None


def parse_setting(text: str) -> tuple[str, Any]:
    """Split `key.path=value`; the value is a TOML literal, else a string. Raises SceneError without a key or `=`."""
    key, sign, value = text.partition("=")
    if not sign or not key.strip():
        raise SceneError(f"--set {cut_short(text)}: must be key.path=value, for example --set time.end=0.5")
    return key.strip(), parse_literal(value.strip())


def parse_literal(text: str) -> Any:
    """Read a TOML value; what is none is the text itself, so that words need no quotes."""
    try:
        table = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):
        return text
    return table["value"] if len(table) == 1 else text


def split_key(key: str) -> tuple[str, ...]:
    """Split a dotted key as TOML does; `bodies[0].velocity`, as messages write it, is `bodies.0.velocity`."""
    dotted = key if '"' in key or "'" in key else re.sub(r"\[(\d+)\]", r".\1", key)
    try:
        table: Any = tomllib.loads(f"{dotted} = true")
    except (ValueError, RecursionError):
        raise SceneError(f"--set {cut_short(key)}: is not a dotted key like time.end or bodies.0.velocity") from None
    path = []
    while isinstance(table, dict):
        (name,) = table if len(table) == 1 else ("",)
        path.append(name)
        table = table.get(name)
    return tuple(path)


def override(table: dict[str, Any], overrides: Mapping[str, Any], source: str) -> list[tuple[str | int, ...]]:
    """Set dotted keys in nested tables and lists, in place; returns their paths. Raises SceneError where none leads."""
    return [put(table, split_key(key), value, source) for key, value in overrides.items()]


def put(table: dict[str, Any], names: tuple[str, ...], value: Any, source: str) -> tuple[str | int, ...]:
    """Set the value at one path; tables that are missing on the way are made, entries of lists are not."""
    place: Any = table
    path: tuple[str | int, ...] = ()
    for depth, name in enumerate(names):
        last = depth == len(names) - 1
        if isinstance(place, dict):
            step: str | int = name
            if not last:
                place.setdefault(name, {})
        elif isinstance(place, list):
            step = list_index(place, name, path, source)
        else:
            raise SceneError(f"{source}: {path_text((*path, name))} cannot be set: {path_text(path)} is no table")
        path = (*path, step)
        if last:
            place[step] = value
        else:
            place = place[step]
    return path


def list_index(place: list[Any], name: str, path: tuple[str | int, ...], source: str) -> int:
    """Return `name` as an index into a list; raises SceneError with the allowed range."""
    if not name.isdecimal() or int(name) >= len(place):
        count = f"an index from 0 to {len(place) - 1}" if place else "nothing: the list is empty"
        raise SceneError(f"{source}: {path_text(path)} = {value_text(place)} is a list: {name} must be {count}")
    return int(name)
