"""Manifests: what the bytes of a checkpoint must be, and whether they are.

A manifest holds a checksum (XXH3, 64 bits) of each dataset and each writer's range in it, one of all other bytes of the file,
and one of itself. A checkpoint without a manifest is none.
"""

import json
import os
import re
from pathlib import Path

from xxhash import xxh3_64

from pmpm.output.files import OutputError, now, on_every_rank, on_rank_zero, sync_folder, unfinished_name
from pmpm.output.layout import FORMAT_VERSION as SNAPSHOT_VERSION

FORMAT, FORMAT_VERSION = "pmpm checkpoint", 1
MANIFEST = re.compile(r"(\d{6,})\.json")
PIECE = 1 << 24  # bytes that are looked at in one go
MOST_MANIFEST = 1 << 28  # bytes


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


def names_in(folder):
    return [entry.name for entry in Path(folder).iterdir()] if Path(folder).is_dir() else []


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
        on_every_rank(comm, lambda: check_share(path, held, comm.rank, comm.size))
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
