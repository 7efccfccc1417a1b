"""Checkpoints: snapshots that leave nothing out, each with a manifest that says what its bytes must be.

DIR/checkpoints/000042.hdf      as a snapshot, with all that a restart needs; opens in ParaView
DIR/checkpoints/000042.json     its manifest: a checksum per dataset and writer's range, and one over all other bytes

The manifest is renamed into place when all else is on the disk: without it there is no checkpoint. Numbers are never used
again, so that no checkpoint is written over another one.
"""

import contextlib
import os
import re
import time as clock
from collections.abc import Callable
from pathlib import Path

import numpy as np

from pmpm.output.datasets import default_parallel, write_datasets
from pmpm.output.files import OutputError, explain, on_rank_zero, remove_quietly, sync_folder
from pmpm.output.manifests import FORMAT, manifest_of, names_in, numbers, write_manifest
from pmpm.output.reader import open_snapshot, plain_attribute
from pmpm.output.run_directory import CHECKPOINTS

NUMBERED = re.compile(r"\.?(\d{6,})\.(hdf|json)(\.unfinished)?")
MOST_HEAD = 200  # bytes of a manifest in which it says what it is
MOST_TEXT = 1 << 26  # bytes


class CheckpointWriter:
    """Observer that writes DIR/checkpoints/000000.hdf, 000001.hdf, ... and deletes all but the newest `keep`.

    `outputs()` gives the numbers of snapshots and lines of diagnostics so far. `bad`: numbers of checkpoints found damaged,
    which do not count among those kept. `beside(simulation)` gives datasets that watchers of the run need to go on.
    """

    def __init__(self, directory, keep, outputs=dict, parallel=None, bad=(), beside=None):
        self.folder, self.comm = directory.path / CHECKPOINTS, directory.comm
        self.keep, self.outputs, self.bad = keep, outputs, set(bad)
        self.parallel = parallel or default_parallel(self.comm)
        self.beside: Callable = beside or (lambda simulation: {})
        self.step: int | None = None
        self.newest: Path | None = None
        self.longest = 0.0  # s that a checkpoint has taken

    def __call__(self, simulation):
        """Write a checkpoint of `simulation`, at most one per step. Collective; OutputError on all ranks if any fails."""
        if self.step != simulation.step_count:
            self.write(simulation, simulation.state(self.outputs()), self.beside(simulation))

    def write(self, simulation, state, beside=None):
        """Write a checkpoint of a state that `simulation` had, with more datasets `beside` it."""
        began = clock.perf_counter()
        path = self.folder / f"{on_rank_zero(self.comm, self.next_number):06d}.hdf"
        pieces, attributes = simulation.datasets(state)
        write_checkpoint(self.comm, path, pieces | (beside or {}), attributes, self.parallel)
        on_rank_zero(self.comm, lambda: prune(self.folder, self.keep, self.bad))
        self.step, self.newest = state.record["step_count"], path
        self.longest = max(self.longest, clock.perf_counter() - began)

    def next_number(self):
        self.folder.mkdir(exist_ok=True)
        found = [NUMBERED.fullmatch(entry.name) for entry in self.folder.iterdir()]
        return max((int(match[1]) + 1 for match in found if match), default=0)


def save(simulation, path):
    """Write a checkpoint of a simulation to `path`, in the place of one that was there. Collective.

    OutputError on all ranks if any fails, and what was there is as it was: the new one is whole before it takes the name.
    """
    path, comm = Path(path), simulation.comm
    if path.suffix != ".hdf":
        raise OutputError(f"{path}: the name of a checkpoint must end in .hdf")
    on_rank_zero(comm, lambda: check_replaceable(path))
    pieces, attributes = simulation.datasets(simulation.state())
    new = path.with_name(f".{path.stem}.new.hdf")
    try:
        write_checkpoint(comm, new, pieces, attributes, default_parallel(comm))
        on_rank_zero(comm, lambda: rename(new, path))
    except OutputError as error:
        if comm.rank == 0:
            remove_quietly(new)
            remove_quietly(manifest_of(new))
        raise OutputError(str(error).replace(str(new), str(path))) from error


def check_replaceable(path):
    """Raise OutputError where a checkpoint would take the place of what is none."""
    if path.is_dir():
        raise OutputError(f"{path} is a folder")
    manifest = manifest_of(path)
    if manifest.exists() and not (manifest.is_file() and FORMAT.encode() in manifest.read_bytes()[:MOST_HEAD]):
        raise OutputError(
            f"{manifest} is no manifest of a checkpoint, and {path.name} would need one there: give another name"
        )


def rename(old, new):
    """Give a checkpoint another name. The manifests go last and first: never is one beside another's file."""
    manifest_of(new).unlink(missing_ok=True)
    os.replace(old, new)
    os.replace(manifest_of(old), manifest_of(new))
    sync_folder(new.parent)


def write_checkpoint(comm, path, pieces, attributes, parallel):
    """Write a checkpoint file and then its manifest. Collective; OutputError on all ranks if any fails."""
    _, sums = write_datasets(comm, path, pieces, attributes, parallel, durable=True)
    told = comm.gather(sums)
    on_rank_zero(comm, lambda: write_manifest(path, told, attributes["pmpm"]))


def prune(folder, keep, bad=()):
    """Delete all but the newest `keep` checkpoints, and what was left of unfinished or damaged ones before them."""
    kept = [number for number in numbers(folder) if number not in bad][:keep]
    oldest, newest = kept[-1] if len(kept) == keep else -1, kept[0]
    names = set(names_in(folder))
    for name in sorted(names, key=lambda name: not name.endswith(".json")):  # manifests first
        match = NUMBERED.fullmatch(name)
        leftover = match and (match[3] or f"{match[1]}.json" not in names) and int(match[1]) < newest
        if match and (int(match[1]) < oldest or leftover):
            (folder / name).unlink(missing_ok=True)


@contextlib.contextmanager
def taken_for_damage(path):
    """Turn whatever HDF5 says of a file into one complaint about it."""
    try:
        yield
    except (OSError, KeyError, ValueError, TypeError, RuntimeError, MemoryError) as error:
        raise OutputError(f"{path} is damaged: {explain(error)}") from error


class CheckpointFile:
    """A good checkpoint, open for reading on this rank. Whatever does not fit raises OutputError."""

    def __init__(self, path):
        self.path = Path(path)
        with taken_for_damage(path):
            self.file = open_snapshot(self.path)
            self.precision = plain_attribute(self.file["pmpm"].attrs.get("precision"))
        if self.precision not in ("float32", "float64"):
            raise OutputError(f"{self.path} is damaged: precision {self.precision!r}")

    def dataset(self, name):
        import h5py

        with taken_for_damage(self.path):
            item = self.file.get(name)
            if isinstance(item, h5py.Dataset) and not item.external and not item.is_virtual:
                return item
        raise OutputError(f"{self.path} is damaged: it holds no dataset {name}")

    def names(self, group):
        """Names of the datasets in a group."""
        with taken_for_damage(self.path):
            return list(self.file.get(group) or ())

    def shape(self, name):
        shape = self.dataset(name).shape
        if not shape:
            raise OutputError(f"{self.path} is damaged: {name} has no rows")
        return shape

    def rows(self, name, first=0, last=None, columns=None, kind=np.integer):
        """Rows of a dataset, each of shape `columns` and of a number type of `kind`."""
        item = self.dataset(name)
        last = self.shape(name)[0] if last is None else last
        fits = columns is None or item.shape[1:] == columns
        if not fits or not np.issubdtype(item.dtype, kind) or not 0 <= first <= last <= item.shape[0]:
            raise OutputError(
                f"{self.path} is damaged: {name} is {item.dtype} {item.shape}, not {columns} per particle"
            )
        with taken_for_damage(self.path):
            return item[first:last]

    def bytes_of(self, name):
        """Contents of a dataset of bytes, no more than a text may have."""
        if self.shape(name)[0] > MOST_TEXT:
            raise OutputError(f"{self.path} is damaged: {name} has {self.shape(name)[0]} bytes")
        return self.rows(name, columns=(), kind=np.uint8).tobytes()

    def close(self):
        self.file.close()
