"""Checkpoints: snapshots that leave nothing out, each with a manifest that says what its bytes must be.

DIR/checkpoints/000042.hdf      as a snapshot, with all that a restart needs; opens in ParaView
DIR/checkpoints/000042.json     its manifest: a checksum per dataset and writer's range, and one over all other bytes

The manifest is renamed into place when all else is on the disk: without it there is no checkpoint. Numbers are never used
again, so that no checkpoint is written over another one.
"""

import contextlib
import json
import os
import re
import time as clock
from pathlib import Path

import numpy as np
from xxhash import xxh3_64

from pmpm.output.files import (
    OutputError,
    explain,
    on_rank_zero,
    raise_together,
    remove_quietly,
    sync_folder,
    unfinished_name,
)
from pmpm.output.run_directory import CHECKPOINTS, now
from pmpm.output.snapshots import FORMAT_VERSION as SNAPSHOT_VERSION
from pmpm.output.snapshots import default_parallel, write_datasets

FORMAT, FORMAT_VERSION = "pmpm checkpoint", 1
MANIFEST = re.compile(r"(\d{6,})\.json")
NUMBERED = re.compile(r"\.?(\d{6,})\.(hdf|json)(\.unfinished)?")
PIECE = 1 << 24  # bytes that are looked at in one go
MOST_HEAD = 200  # bytes of a manifest in which it says what it is
MOST_MANIFEST, MOST_TEXT = 1 << 28, 1 << 26  # bytes


class CheckpointWriter:
    """Observer that writes DIR/checkpoints/000000.hdf, 000001.hdf, ... and deletes all but the newest `keep`.

    `outputs()` gives the numbers of snapshots and lines of diagnostics so far. `bad`: numbers of checkpoints found damaged,
    which do not count among those kept.
    """

    def __init__(self, directory, keep, outputs=dict, parallel=None, bad=()):
        self.folder, self.comm = directory.path / CHECKPOINTS, directory.comm
        self.keep, self.outputs, self.bad = keep, outputs, set(bad)
        self.parallel = parallel or default_parallel(self.comm)
        self.step: int | None = None
        self.newest: Path | None = None
        self.longest = 0.0  # s that a checkpoint has taken

    def __call__(self, simulation):
        """Write a checkpoint of `simulation`, at most one per step. Collective; OutputError on all ranks if any fails."""
        if self.step != simulation.step_count:
            self.write(simulation, simulation.state(self.outputs()))

    def write(self, simulation, state):
        """Write a checkpoint of a state that `simulation` had."""
        began = clock.perf_counter()
        path = self.folder / f"{on_rank_zero(self.comm, self.next_number):06d}.hdf"
        pieces, attributes = simulation.datasets(state)
        write_checkpoint(self.comm, path, pieces, attributes, self.parallel)
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


def write_manifest(path, told, attributes):
    """Rename the manifest into place. `told`: of each rank {dataset: (bytes, checksum)}."""
    import h5py

    ranges: dict[str, list] = {}
    with h5py.File(path, "r") as file:
        for name in dict.fromkeys(name for rank in told for name in rank):
            first = file[name].id.get_offset()
            ranges[name] = []
            for nbytes, checksum in (rank[name] for rank in told if name in rank):
                ranges[name].append([first, nbytes, checksum])
                first += nbytes
    size = os.path.getsize(path)
    held = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "snapshot_version": SNAPSHOT_VERSION,
        "written": now(),
        "step": int(attributes["step"]),
        "time": float(attributes["time"]),
        "precision": attributes["precision"],
        "bytes": size,
        "datasets": ranges,
        "rest": checksum_of_gaps(path, size, [r for of_dataset in ranges.values() for r in of_dataset]),
    }
    unfinished = unfinished_name(manifest_of(path))
    with open(unfinished, "w", encoding="utf-8") as file:
        json.dump(held | {"manifest": xxh3_64(canonical(held)).intdigest()}, file, indent=1)
        file.flush()
        os.fsync(file.fileno())
    os.replace(unfinished, manifest_of(path))
    sync_folder(path.parent)


def manifest_of(path):
    return Path(path).with_suffix(".json")


def canonical(held):
    return json.dumps(held, sort_keys=True).encode()


def checksum_of_gaps(path, size, ranges):
    """Checksum of all bytes of a file that lie in none of the ranges (first byte, bytes, ...)."""
    found, place = xxh3_64(), 0
    with open(path, "rb") as file:
        for first, nbytes in [*sorted((first, nbytes) for first, nbytes, *_ in ranges), (size, 0)]:
            take_in(found, file, place, first - place)
            place = first + nbytes
    return found.intdigest()


def take_in(checksum, file, first, nbytes):
    """Let a checksum see some bytes of an open file; fewer of them if the file ends before. Returns it."""
    file.seek(first)
    while nbytes > 0:
        data = file.read(min(PIECE, nbytes))
        if not data:
            break
        checksum.update(data)
        nbytes -= len(data)
    return checksum


def prune(folder, keep, bad=()):
    """Delete all but the newest `keep` checkpoints, and what was left of unfinished or damaged ones before them."""
    kept = [number for number in numbers(folder) if number not in bad][:keep]
    oldest, newest = kept[-1] if len(kept) == keep else -1, kept[0]
    for name in sorted(names_in(folder), key=lambda name: not name.endswith(".json")):  # manifests first
        match = NUMBERED.fullmatch(name)
        leftover = match and (match[3] or f"{match[1]}.json" not in names_in(folder)) and int(match[1]) < newest
        if match and (int(match[1]) < oldest or leftover):
            (folder / name).unlink(missing_ok=True)


def names_in(folder):
    return [entry.name for entry in Path(folder).iterdir()] if Path(folder).is_dir() else []


# ---- reading ----


def numbers(folder):
    """Numbers of the finished checkpoints in a folder, newest first."""
    return sorted({int(match[1]) for match in map(MANIFEST.fullmatch, names_in(folder)) if match})[::-1]


def newest_good(folder, comm):
    """(path of the newest checkpoint in a folder whose bytes are what its manifest says, or None; [(number, complaint)] of
    newer ones). Collective."""
    complaints: list[tuple[int, str]] = []
    for number in on_rank_zero(comm, lambda: numbers(folder)):
        path = Path(folder) / f"{number:06d}.hdf"
        complaint = complaint_about(path, comm)
        if complaint is None:
            return path, complaints
        complaints.append((number, complaint))
    return None, complaints


def complaint_about(path, comm):
    """What is wrong with a checkpoint file, the same on all ranks, or None: each rank reads a share of it. Collective."""
    try:
        held = on_rank_zero(comm, lambda: read_manifest(path))
    except OutputError as error:
        return str(error)
    failure = None
    try:
        check_share(path, held, comm.rank, comm.size)
    except Exception as error:
        failure = error
    try:
        raise_together(comm, failure)
    except OutputError as error:
        return str(error)
    return None


def read_manifest(path):
    """What the manifest of a checkpoint says, checked. OutputError if there is none that can be trusted."""
    path, manifest = Path(path), manifest_of(path)
    if not path.is_file():
        raise OutputError(f"{path} does not exist")
    if path.suffix != ".hdf":
        raise OutputError(f"{path} is no checkpoint: the name of one ends in .hdf")
    if not manifest.is_file():
        raise OutputError(f"{path} is no finished checkpoint: it has no manifest {manifest.name}")
    if manifest.stat().st_size > MOST_MANIFEST:
        raise OutputError(f"{manifest} is damaged: it is larger than {MOST_MANIFEST} bytes")
    try:
        held = json.loads(manifest.read_bytes())
    except (ValueError, RecursionError) as error:
        raise OutputError(f"{manifest} is damaged: {type(error).__name__}") from error
    if not isinstance(held, dict) or held.get("format") != FORMAT:
        raise OutputError(f"{manifest} is not the manifest of a checkpoint")
    said = held.pop("manifest", None)
    if said != xxh3_64(canonical(held)).intdigest():
        raise OutputError(f"{manifest} is damaged: its checksum is another one")
    if held.get("format_version") != FORMAT_VERSION or held.get("snapshot_version") != SNAPSHOT_VERSION:
        versions = f"{held.get('format_version')} (snapshot {held.get('snapshot_version')})"
        wanted = f"{FORMAT_VERSION} (snapshot {SNAPSHOT_VERSION})"
        raise OutputError(f"{path} has checkpoint format_version {versions}; this pmpm reads {wanted}")
    if not is_manifest(held):
        raise OutputError(f"{manifest} is damaged: it does not say what a manifest says")
    return held


def is_manifest(held):
    """Whether what a manifest says can be looked up in its file: ranges one after another, inside the file."""
    datasets = held.get("datasets")
    if not isinstance(datasets, dict) or not all(is_whole(held.get(name)) for name in ("bytes", "rest", "step")):
        return False
    if held.get("precision") not in ("float32", "float64") or not isinstance(held.get("time"), float):
        return False
    if not all(isinstance(ranges, list) for ranges in datasets.values()):
        return False
    ranges = [entry for of_dataset in datasets.values() for entry in of_dataset]
    if not all(isinstance(entry, list) and len(entry) == 3 and all(map(is_whole, entry)) for entry in ranges):
        return False
    place = 0
    for first, nbytes, _ in sorted(ranges):
        if first < place:
            return False
        place = first + nbytes
    return place <= held["bytes"]


def is_whole(value):
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0


def check_share(path, held, rank, size):
    """Raise OutputError if bytes of this rank's share of the ranges are not what the manifest says."""
    found = os.path.getsize(path)
    if found != held["bytes"]:
        raise OutputError(f"{path} is damaged: it has {found} bytes, not {held['bytes']}")
    ranges = [(name, *entry) for name, entries in held["datasets"].items() for entry in entries]
    with open(path, "rb") as file:
        for name, first, nbytes, said in ranges[rank::size]:
            if take_in(xxh3_64(), file, first, nbytes).intdigest() != said:
                raise OutputError(f"{path} is damaged: {name} has another checksum")
    if rank == size - 1 and checksum_of_gaps(path, found, [r[1:] for r in ranges]) != held["rest"]:
        raise OutputError(f"{path} is damaged: what lies between its datasets has another checksum")


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
        from pmpm.output.reader import open_snapshot, plain_attribute

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
