"""The folder a run leaves behind: who may write it, its log and its record of how the run began and ended.

DIR/scene.toml       exactly what was run
DIR/log.txt          every message of the run
DIR/run.json         versions, hosts, ranks, status, and the report at the end
DIR/run.lock         host and process of the run that writes here; gone when it has ended
DIR/snapshots/, DIR/snapshots.xdmf, DIR/checkpoints/, DIR/diagnostics.csv      written by their own files of this room
DIR/probes/, DIR/gauges/, DIR/maps.npz, DIR/grid/, DIR/grid.xdmf     where a scene asks for them
DIR/failed.hdf       the state of a run that went wrong, as a snapshot
"""

import contextlib
import json
import os
import platform
import re
import socket
import sys
import time
from importlib import metadata
from pathlib import Path

from pmpm.output import manifests
from pmpm.output.files import (
    OutputError,
    explain,
    now,
    on_rank_zero,
    remove_quietly,
    to_json,
    unfinished_name,
    write_atomically,
)

FORMAT = "pmpm run"
FORMAT_VERSION = 1
SCENE, LOG, RECORD, LOCK = "scene.toml", "log.txt", "run.json", "run.lock"
FAILED = "failed.hdf"
INDEX, DIAGNOSTICS, SNAPSHOTS, CHECKPOINTS = "snapshots.xdmf", "diagnostics.csv", "snapshots", "checkpoints"
MAPS, SERIES = "maps.npz", ("probes", "gauges")
GRID_INDEX, GRIDS = "grid.xdmf", "grid"
OWN_FILES = (SCENE, LOG, INDEX, DIAGNOSTICS, FAILED, MAPS, GRID_INDEX)
OWN_FOLDERS = (SNAPSHOTS, CHECKPOINTS, GRIDS)
DIAGNOSTICS_HEAD = b"step,time,dt,"  # with which a file of diagnostics, of a probe or a gauge begins
NUMBERED = re.compile(r"\d{6,}\.hdf")
OWN_NAMES = re.compile(r"\d{6,}\.(hdf|json)|\.\d{6,}\.(hdf|json)\.unfinished")
ENDED = ("Z", "X")  # states of processes that only stand in the table
VERSIONS_OF = ("pmpm", "numpy", "numba", "h5py", "mpi4py", "numba-cuda")


class RunDirectory:
    """A run's folder while it is being written; `path` is absolute. Made by `RunDirectory.create`."""

    def __init__(self, path, comm, record, lock):
        self.path, self.comm = path, comm
        self.record, self.lock = record, lock
        self.began = time.monotonic()
        self.log_lost = False

    @classmethod
    def create(cls, path, scene_toml, comm, overwrite=False, beginning=None):
        """Take the folder `path` for a new run, write scene.toml and run.json and lock it. Collective.

        Raises OutputError, the same on all ranks and before anything is written, if the path is a file, cannot be
        written, holds a run (unless `overwrite`) or files that are not a run's, or if a live process is writing there.
        `overwrite` removes what a run wrote and leaves everything else. `beginning`: what run.json says of a restart from the
        checkpoint of another folder.
        """
        hosts = comm.gather(socket.gethostname())

        def prepare():
            place = check_new(path, overwrite)
            place.mkdir(parents=True, exist_ok=True)
            lock = take_lock(place)
            try:
                record = opening_record(hosts) | ({"restarts": [beginning]} if beginning else {})
                # A folder with the new record must not hold the old run's checkpoints.
                remove_checkpoints(place)
                # First, so that a folder left halfway from here on is still known as a run's.
                write_atomically(place / RECORD, to_json(record))
                remove_run(place)
                write_atomically(place / SCENE, scene_toml)
            except BaseException:
                release_lock(place, lock)
                raise
            return str(place), record, lock

        place, record, lock = on_rank_zero(comm, prepare)
        return cls(Path(place), comm, record, lock)

    @classmethod
    def resume(cls, path, scene_toml, comm, beginning, outputs, discarded=(), found=None):
        """Take the folder `path` of a run to go on with it. Collective. OutputError as for `create`.

        `beginning`: what run.json says of this restart. What was written after the checkpoint goes: snapshots beyond
        `outputs["snapshots"]` and lines of diagnostics beyond `outputs["diagnostics"]`, for they come again, and the
        checkpoints with numbers in `discarded`. `found`: numbers of all that were there when the one to go on from was chosen;
        if there are others now, another process has gone on meanwhile, and what it did is not cut.
        """
        hosts = comm.gather(socket.gethostname())

        def prepare():
            place = Path(os.path.abspath(path))
            check_writable(place)
            lock = take_lock(place)
            try:
                if found is not None and manifests.numbers(place / CHECKPOINTS) != found:
                    raise OutputError(
                        f"{place}: another process has gone on with this run meanwhile: start again to go on from there"
                    )
                before = read_record(place) or {}
                record = opening_record(hosts)
                told = before.get("restarts")
                earlier = [
                    *(told if isinstance(told, list) else ()),
                    beginning | {"at": record["started"], "ranks": len(hosts)},
                ]
                record["started"] = before.get("started", record["started"])
                remove_checkpoints(place, discarded)
                remove_unfinished(place)
                for snapshot in (*snapshot_files(place), *grid_files(place)):
                    if int(snapshot.stem) >= outputs.get("snapshots", 0):
                        snapshot.unlink()
                lost = keep_lines(place / DIAGNOSTICS, outputs.get("diagnostics", 0))
                for series in series_files(place):
                    keep_lines(series, outputs.get(f"{series.parent.name}/{series.stem}", 0))
                (place / FAILED).unlink(missing_ok=True)
                write_atomically(place / SCENE, scene_toml)
                write_atomically(place / RECORD, to_json(record | {"restarts": earlier}))
            except BaseException:
                release_lock(place, lock)
                raise
            return str(place), record | {"restarts": earlier}, lock, lost

        place, record, lock, lost = on_rank_zero(comm, prepare)
        directory = cls(Path(place), comm, record, lock)
        if lost:
            directory.log(f"{DIAGNOSTICS} has lost {lost} lines that it had at the checkpoint")
        return directory

    def log(self, message):
        """Append a message to log.txt, with the time of day. Rank 0 writes, the others do nothing; not collective.

        A message that cannot be written (disk full) is dropped with one warning on stderr: a run is worth more than its
        log, and an error raised here would reach one rank only.
        """
        if self.comm.rank != 0:
            return
        try:
            with open(self.path / LOG, "a", encoding="utf-8") as file:
                file.write(f"{now()}  {message}\n")
        except OSError as error:
            if not self.log_lost:
                with contextlib.suppress(OSError):
                    print(f"pmpm: {self.path / LOG} cannot be written ({error}); messages are lost", file=sys.stderr)
            self.log_lost = True

    def finish(self, status, report=None):
        """Write how the run ended into run.json and remove the lock. `status`: "finished", or another word for why not.

        Rank 0 writes, the others do nothing; not collective, so that it may be called while a run is failing.
        """
        if self.comm.rank != 0:
            return
        self.record |= {
            "status": status,
            "ended": now(),
            "wall_seconds": round(time.monotonic() - self.began, 3),
            "report": report or {},
        }
        try:
            write_atomically(self.path / RECORD, to_json(self.record))
        except OSError as error:
            # Not raised: whatever ended the run is the message, and one rank alone knows of this.
            remove_quietly(unfinished_name(self.path / RECORD))
            with contextlib.suppress(OSError):
                print(f"pmpm: {self.path / RECORD} cannot be written: {explain(error)}", file=sys.stderr)
        finally:
            with contextlib.suppress(OSError):
                release_lock(self.path, self.lock)


def check_new(path, overwrite):
    """The absolute path of the folder `path`; OutputError if a new run may not be written there. Changes nothing."""
    place = Path(os.path.abspath(path))
    if place.exists() and not place.is_dir():
        raise OutputError(f"{place} is a file, not a folder: give another output folder (--out DIR)")
    check_writable(place)
    if not place.exists():
        return place
    check_unlocked(place)
    record = read_record(place)
    if record is None:
        strangers = sorted(entry.name for entry in place.iterdir() if not entry.name.startswith(LOCK))
        if strangers:
            shown = ", ".join(strangers[:3]) + (", ..." if len(strangers) > 3 else "")
            raise OutputError(
                f"{place} is not empty and does not hold a run ({shown}): give a new or empty folder (--out DIR); "
                "--overwrite only replaces runs"
            )
    elif not overwrite and record["status"] == "finished":
        raise OutputError(
            f"{place} holds a finished run: give another output folder (--out DIR), or --overwrite to replace it "
            "(overwrite=True in Python)"
        )
    elif not overwrite:
        raise OutputError(
            f"{place} holds an unfinished run (status: {read_status(place)}): --restart {path} continues it; else give "
            "another output folder (--out DIR), or --overwrite to start anew (overwrite=True in Python)"
        )
    return place


def check_writable(place):
    standing = place
    while not standing.exists() and standing != standing.parent:
        standing = standing.parent
    if not standing.is_dir():
        raise OutputError(f"{place} cannot be made: {standing} is a file")
    if not os.access(standing, os.W_OK | os.X_OK):
        what = "is" if standing == place else f"cannot be made: {standing} is"
        raise OutputError(f"{place} {what} not writable for you: give another output folder (--out DIR)")


def remove_run(place):
    """Delete, by name, what a run wrote into `place`, all but its record; files that are not a run's stay."""
    for name in OWN_FILES:
        (place / name).unlink(missing_ok=True)
        unfinished_name(place / name).unlink(missing_ok=True)
    for name in OWN_FOLDERS:
        folder = place / name
        if not folder.is_dir():
            continue
        for entry in folder.iterdir():
            if OWN_NAMES.fullmatch(entry.name):
                entry.unlink()
        if not folder.is_symlink() and not any(folder.iterdir()):
            folder.rmdir()
    for path in series_files(place):
        path.unlink()
        if not path.parent.is_symlink() and not any(path.parent.iterdir()):
            path.parent.rmdir()


def series_files(place):
    """Paths of the files of probes and gauges of the run in `place`, by name."""
    found = [path for kind in SERIES for path in sorted((Path(place) / kind).glob("*.csv"))]
    return [path for path in found if path.is_file() and begins_as_diagnostics(path)]


def begins_as_diagnostics(path):
    with open(path, "rb") as file:
        return file.read(len(DIAGNOSTICS_HEAD)) == DIAGNOSTICS_HEAD


def remove_checkpoints(place, numbers=None):
    """Delete checkpoints of a run, all or those with these numbers: manifests first, so that none is half there."""
    folder = place / CHECKPOINTS
    for ending in ("json", "hdf"):
        for entry in sorted(folder.glob(f"*.{ending}")):
            if OWN_NAMES.fullmatch(entry.name) and (numbers is None or int(entry.stem) in numbers):
                entry.unlink()


def remove_unfinished(place):
    """Delete files that a process was writing when it died."""
    for folder in (place, *(place / name for name in OWN_FOLDERS)):
        for entry in folder.iterdir() if folder.is_dir() else ():
            if entry.name.startswith(".") and entry.name.endswith(".unfinished"):
                entry.unlink()


def keep_lines(path, count):
    """Cut a file of lines after its head and `count` lines; returns how many are missing.

    One that does not begin as it should is put aside: nobody can say what may still be read of it.
    """
    if count == 0 or not path.exists():
        path.unlink(missing_ok=True)
        return count
    lines = path.read_bytes().splitlines(keepends=True)
    if not lines or not lines[0].startswith(DIAGNOSTICS_HEAD):
        os.replace(path, path.with_name(f"{path.name}.damaged"))
        return count
    whole = [line for line in lines[: count + 1] if line.endswith(b"\n")]
    if len(whole) < len(lines):
        unfinished_name(path).write_bytes(b"".join(whole))
        os.replace(unfinished_name(path), path)
    return count + 1 - len(whole)


def opening_record(hosts):
    return {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "status": "running",
        "started": now(),
        "command": sys.argv,
        "ranks": len(hosts),
        "hosts": {host: hosts.count(host) for host in sorted(set(hosts))},
        "platform": platform.platform(),
        "versions": {"python": platform.python_version()} | {name: version_of(name) for name in VERSIONS_OF},
    }


def version_of(package):
    """The installed version of a package, without importing it; None if it is not installed."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def read_record(place):
    """What run.json of the folder `place` holds, or None if that folder holds no run."""
    try:
        record = json.loads((Path(place) / RECORD).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    if not isinstance(record, dict) or record.get("format") != FORMAT or "status" not in record:
        return None
    return record


def is_run(place):
    """Whether a folder is a run's: it has the record of one, or, should that be lost, the scene."""
    return read_record(place) is not None or (Path(place) / SCENE).is_file()


def read_status(place):
    """Status of the run in `place`: what run.json says, but "interrupted" for a run whose process is gone."""
    record = read_record(place)
    if record is None:
        raise OutputError(f"{place} does not hold a run: no {RECORD} of pmpm in it")
    if record["status"] == "running" and not is_live(read_lock(Path(place))):
        return "interrupted"
    return record["status"]


def snapshot_files(place):
    """Paths of the finished snapshots of the run in `place`, in order."""
    return numbered_files(Path(place) / SNAPSHOTS)


def grid_files(place):
    """Paths of the fields on nodes that go with snapshots of the run in `place`, in order."""
    return numbered_files(Path(place) / GRIDS)


def numbered_files(folder):
    if not folder.is_dir():
        return []
    return sorted(
        (entry for entry in folder.iterdir() if NUMBERED.fullmatch(entry.name)), key=lambda path: int(path.stem)
    )


def check_unlocked(place):
    holder = read_lock(place)
    if is_live(holder):
        raise OutputError(
            f"{place} is being written by process {holder.get('pid', '?')} on {holder.get('host', '?')}: give another "
            f"output folder (--out DIR), or, if that process is surely gone, delete {place / LOCK}"
        )


def take_lock(place):
    """Create the lock file of `place` for this process; returns its text. OutputError if another process holds it."""
    writer = {"host": socket.gethostname(), "pid": os.getpid(), "began": process_start(os.getpid())}
    text = json.dumps(writer | ({"slurm_job": slurm_start()} if slurm_start() else {}))
    move_stale_lock(place)
    try:
        descriptor = os.open(place / LOCK, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o644)
    except FileExistsError:
        raise OutputError(
            f"{place} was taken by another process just now: give another output folder (--out DIR)"
        ) from None
    try:
        os.write(descriptor, text.encode())
    finally:
        os.close(descriptor)
    return text


def move_stale_lock(place):
    """Take the lock of a dead process out of the way. Of two processes that try, at most one gets through.

    Between reading and removing, another process may have put its own lock there: the rename is atomic, so whoever
    renamed a lock that is not the one it read puts it back and leaves.
    """
    stale = read_text(place / LOCK)
    if stale is None:
        return
    check_unlocked(place)
    aside = place / f"{LOCK}.{os.getpid()}"
    try:
        os.rename(place / LOCK, aside)
    except FileNotFoundError:
        return
    if read_text(aside) != stale:
        os.rename(aside, place / LOCK)
        check_unlocked(place)
    aside.unlink(missing_ok=True)


def release_lock(place, text):
    """Remove the lock of `place` if it is still the one with `text`."""
    if read_text(place / LOCK) == text:
        (place / LOCK).unlink(missing_ok=True)


def read_lock(place):
    """The lock of `place` as a dict with host and pid; {} for an unreadable one, None if there is none."""
    text = read_text(place / LOCK)
    if text is None:
        return None
    try:
        lock = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    return lock if isinstance(lock, dict) else {}


def read_text(path):
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except FileNotFoundError:
        return None
    except OSError:  # no file, but something: as good as a lock that nobody can read
        return ""


def is_live(lock):
    """Whether the process that wrote a lock may still run; one on another host is taken to."""
    if lock is None or is_of_earlier_start(lock.get("slurm_job")):
        return False
    pid = lock.get("pid")
    if lock.get("host") != socket.gethostname() or not isinstance(pid, int) or pid <= 0:
        return True
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        pass
    if process_state(pid) in ENDED:  # nobody has asked for its exit status: in containers that may last
        return False
    # Process numbers come round again, in containers soon: a later process under the same number is not the writer.
    return None in (lock.get("began"), process_start(pid)) or lock["began"] == process_start(pid)


def slurm_start():
    """[number, how often it was restarted] of the Slurm job around this process; None without one."""
    job, restarts = os.environ.get("SLURM_JOB_ID", ""), os.environ.get("SLURM_RESTART_COUNT") or "0"
    return [int(job), int(restarts)] if job.isdigit() and restarts.isdigit() else None


def is_of_earlier_start(job):
    """Whether a lock was taken by an earlier start of this very job: Slurm has ended that, on whatever host it was."""
    here = slurm_start()
    known = isinstance(job, list) and len(job) == 2 and all(isinstance(number, int) for number in job)
    return known and here is not None and job[0] == here[0] and job[1] < here[1]


def process_start(pid):
    """When a process on this host began, in clock ticks since the machine's start; None where /proc does not say."""
    fields = process_fields(pid)
    return int(fields[19]) if fields else None


def process_state(pid):
    """The letter for what a process on this host is doing, such as R or S; None where /proc does not say."""
    fields = process_fields(pid)
    return fields[0] if fields else None


def process_fields(pid):
    """Fields of /proc/PID/stat from the third on: the second is the program's name in brackets and may hold spaces."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return []
