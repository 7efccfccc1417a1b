"""The folder of a study: what is studied, a row for each run that has ended, and which process writes here.

DIR/study.json          the scene and what was asked of the study
DIR/runs/000.json       the row of a run, written once the run has ended; its number is that of the plan
DIR/runs/000.npz        what is compared with other levels, where there is no exact solution; written before the row
DIR/study.csv, study.md, study.png      tables and picture
DIR/run.lock            host and process of the study that writes here
"""

import contextlib
import hashlib
import json
import os
from pathlib import Path

import numpy as np

from pmpm import __version__
from pmpm.output import run_directory
from pmpm.output.files import OutputError, now, on_rank_zero, plain, to_json, unfinished_name, write_atomically

FORMAT, FORMAT_VERSION = "pmpm study", 1
RECORD, RUNS = "study.json", "runs"
TABLE, PAGE, PICTURE = "study.csv", "study.md", "study.png"


def what_is_studied(plan, ranks):
    """The part of study.json by which a folder is known as that of this study."""
    return plain(
        {
            "scene": plan.base.to_toml(),
            "options": plan.options.table(),
            "ranks": ranks,
            "pmpm": __version__,
            "runs": [mark(entry.scene) for entry in plan.entries],
        }
    )


def mark(scene):
    """A hash over all that a scene says."""
    return hashlib.sha256(scene.to_toml().encode()).hexdigest()[:16]


class StudyFolder:
    """The folder of a study, held by this process until `close`. Rank 0 reads and writes; calls are collective.

    Raises OutputError, before anything is written, for a folder with another study in it (unless `overwrite`) or with other
    files, and for one that another process is writing.
    """

    def __init__(self, path, plan, comm, overwrite=False):
        self.comm, self.plan = comm, plan
        self.marks = [mark(entry.scene) for entry in plan.entries]
        studied = what_is_studied(plan, comm.size)
        self.path, self.lock = on_rank_zero(comm, lambda: take(path, studied, overwrite))

    def close(self):
        """Let other processes have the folder."""
        if self.comm.rank == 0:
            with contextlib.suppress(OSError):
                run_directory.release_lock(self.path, self.lock)

    def rows(self):
        """{number: row} of the runs that have ended."""
        return on_rank_zero(self.comm, self.read_rows)

    def read_rows(self):
        found = {}
        for number, expected in enumerate(self.marks):
            row = read_json(self.row_path(number))
            if row is None or row.get("hash") != expected:
                continue
            if row.get("samples") and not self.row_path(number).with_suffix(".npz").is_file():
                continue
            found[number] = row
        return found

    def keep(self, row, samples):
        """Write the row of a run that has ended, whole or not at all; returns it as it will be read."""
        row = plain(row | {"hash": self.marks[row["number"]], "samples": samples is not None, "ended": now()})

        def write():
            path = self.row_path(row["number"])
            if samples is not None:
                unfinished = unfinished_name(path.with_suffix(".npz"))
                with open(unfinished, "wb") as file:
                    np.savez_compressed(file, **samples)
                    file.flush()
                    os.fsync(file.fileno())
                os.replace(unfinished, path.with_suffix(".npz"))
            write_atomically(path, to_json(row))
            return row

        return on_rank_zero(self.comm, write)

    def samples(self, number):
        """What was kept of a run for comparison; rank 0 alone."""
        with np.load(self.row_path(number).with_suffix(".npz"), allow_pickle=False) as file:
            return {name: file[name] for name in file.files}

    def row_path(self, number):
        return self.path / RUNS / f"{number:03d}.json"


def take(path, studied, overwrite):
    """(absolute path, lock) of a folder for this study, new or that of the same study."""
    place = Path(os.path.abspath(path))
    if place.exists() and not place.is_dir():
        raise OutputError(f"{place} is a file, not a folder: give another output folder (--out DIR)")
    run_directory.check_writable(place)
    if place.exists():
        run_directory.check_unlocked(place)
    record = check_study(place, studied, overwrite)
    (place / RUNS).mkdir(parents=True, exist_ok=True)
    lock = run_directory.take_lock(place)
    try:
        if record is not None and record.get("study") != studied:
            remove_study(place)
            record = None
        remove_unfinished(place)
        if record is None:
            opening = {"format": FORMAT, "format_version": FORMAT_VERSION, "started": now(), "study": studied}
            write_atomically(place / RECORD, to_json(opening))
    except BaseException:
        run_directory.release_lock(place, lock)
        raise
    return place, lock


def check_study(place, studied, overwrite):
    """The record of the study in a folder, None without one. Raises OutputError for what may not be written over."""
    if not place.exists():
        return None
    record = read_json(place / RECORD)
    if record is None or record.get("format") != FORMAT:
        strangers = sorted(e.name for e in place.iterdir() if e.name not in (RUNS, run_directory.LOCK))
        if strangers:
            shown = ", ".join(strangers[:3]) + (", ..." if len(strangers) > 3 else "")
            raise OutputError(
                f"{place} is not empty and does not hold a study ({shown}): give a new or empty folder (--out DIR)"
            )
        return None
    other = record.get("study")
    if other == studied or overwrite:
        return record if not overwrite else record | {"study": None}
    raise OutputError(
        f"{place} holds another study ({what_differs(other, studied)}): give another output folder (--out DIR), or "
        "--overwrite to replace it"
    )


def what_differs(other, studied):
    """What another study says differently, in a few words."""
    other = other if isinstance(other, dict) else {}
    told = other.get("options") if isinstance(other.get("options"), dict) else {}
    options = [
        f"--{name.replace('_', '-')} was {short(told.get(name))}, is {short(value)}"
        for name, value in studied["options"].items()
        if told.get(name) != value
    ]
    if other.get("ranks") != studied["ranks"]:
        options.append(f"it was on {other.get('ranks')} ranks, this is on {studied['ranks']}")
    if other.get("pmpm") != studied["pmpm"]:
        options.append(f"of pmpm {other.get('pmpm')}")
    return ", ".join(options) or "the scene is another"


def short(value):
    """A value of an option as it stands on the command line."""
    if isinstance(value, list):
        return ",".join(map(str, value)) or "not given"
    return "not given" if value is None else str(value)


def remove_study(place):
    """Delete, by name, what a study wrote; files that are not a study's stay."""
    for name in (RECORD, TABLE, PAGE, PICTURE):
        (place / name).unlink(missing_ok=True)
    for entry in (place / RUNS).iterdir():
        if entry.stem.isdecimal() and entry.suffix in (".json", ".npz"):
            entry.unlink()


def remove_unfinished(place):
    for folder in (place, place / RUNS):
        for entry in folder.glob(".*.unfinished"):
            entry.unlink()


def read_json(path):
    """A table of a JSON file, None where there is none that can be read."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) else None
