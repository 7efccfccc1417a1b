"""How output touches the disk: whole files or none, and a failure on one rank is the same failure on all."""

import contextlib
import datetime
import json
import math
import os
from pathlib import Path

import numpy as np

MOST_TEXT = 300  # letters of another program's complaint that are passed on


class OutputError(Exception):
    """What a run should leave behind cannot be written, or what it left cannot be read; its text is for the user."""


def on_rank_zero(comm, action):
    """Run `action()` on rank 0 and give its (picklable) result to every rank.

    Collective. What goes wrong on rank 0 is raised as the same OutputError on all ranks.
    """
    result = failure = cause = None
    if comm.rank == 0:
        try:
            result = action()
        except Exception as error:
            failure, cause = explain(error), error
    result, failure = comm.broadcast((result, failure))
    if failure is not None:
        raise OutputError(failure) from cause
    return result


def explain(error):
    """One line on an exception: path and reason for the system's errors."""
    if isinstance(error, OutputError):
        return str(error)
    if isinstance(error, OSError) and error.strerror and error.filename:
        return f"{error.filename}: {error.strerror}"
    if isinstance(error, OSError):
        return os.strerror(error.errno) if error.errno else one_line(error)  # HDF5's own text fills a page
    return f"{type(error).__name__}: {one_line(error)}"


def one_line(error):
    text = " ".join(str(error).split())
    return text if len(text) <= MOST_TEXT else f"{text[: MOST_TEXT - 4]} ..."


def on_every_rank(comm, action):
    """Run `action()` on every rank and return what it gives there.

    Collective. What goes wrong on any rank is raised as the same OutputError on all ranks.
    """
    result = failure = cause = None
    try:
        result = action()
    except Exception as error:
        failure, cause = explain(error), error
    told = comm.gather(failure)
    failures = [f"rank {rank}: {text}" if comm.size > 1 else text for rank, text in enumerate(told) if text is not None]
    if failures:
        raise OutputError(failures[0]) from cause
    return result


def sync_file(path):
    """Wait until what was written to a file is on the disk."""
    descriptor = os.open(path, os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def sync_folder(path):
    """Wait until renames in a folder are on the disk; what the file system cannot do is left."""
    try:
        descriptor = os.open(path, os.O_RDONLY)
    except OSError:
        return
    try:
        os.fsync(descriptor)
    except OSError:
        pass
    finally:
        os.close(descriptor)


def remove_quietly(path):
    """Remove a file if that can be done: where a disk fails, what failed first is the message."""
    with contextlib.suppress(OSError):
        Path(path).unlink(missing_ok=True)


def now():
    """The time of day as files tell it."""
    return datetime.datetime.now().astimezone().isoformat(timespec="seconds")


def write_atomically(path, text):
    """Replace the file at `path` by `text`: a reader sees the old file or the new one, never a part."""
    path = Path(path)
    unfinished = unfinished_name(path)
    unfinished.write_text(text, encoding="utf-8")
    os.replace(unfinished, path)


def unfinished_name(path):
    """Where a file is written before it is renamed to `path`: in the same folder, for a rename must not cross disks."""
    return path.with_name(f".{path.name}.unfinished")


def to_json(value):
    """JSON text of nested dicts, lists and numbers; NaN and infinity, which JSON has not, become null."""
    return json.dumps(plain(value), indent=2, allow_nan=False) + "\n"


def plain(value):
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, dict):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, str | bool | int):
        return value
    return str(value)
