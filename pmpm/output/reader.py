"""Reading what a run left behind, or is still writing: `load` for Python, `describe` for `pmpm info`."""

import csv
import tomllib
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path

import numpy as np

from pmpm.output.files import OutputError
from pmpm.output.run_directory import DIAGNOSTICS, RECORD, SCENE, read_record, read_status, snapshot_files
from pmpm.output.snapshots import FORMAT_VERSION

WHOLE_NUMBERS = ("step", "particles")


def load(path):
    """The run in the folder `path`, finished or running, as a `Run`. OutputError if there is none."""
    path = Path(path)
    if not path.exists():
        raise OutputError(f"{path} does not exist")
    if read_record(path) is None:
        raise OutputError(f"{path} does not hold a run: no {RECORD} of pmpm in it")
    return Run(path)


class Run:
    """A run on disk. Every look at an attribute reads the disk anew, so that a running run can be followed."""

    def __init__(self, path):
        self.path = Path(path)

    @property
    def status(self):
        """ "running", "finished", what else stopped it, or "interrupted" if its process is gone without a word."""
        return read_status(self.path)

    @property
    def record(self):
        """What run.json says: versions, hosts, ranks, times, and the report at the end."""
        return read_record(self.path)

    @property
    def scene(self):
        """The `Scene` that was run, defaults filled in."""
        from pmpm.scene.schema import Scene

        return Scene.from_toml(self.path / SCENE)

    @property
    def snapshots(self):
        """The snapshots written so far, in order: a sequence of `Snapshot`."""
        return Snapshots(snapshot_files(self.path))

    @property
    def diagnostics(self):
        """{name: array over the lines of diagnostics.csv}; empty if there are none yet."""
        return read_diagnostics(self.path / DIAGNOSTICS)


class Snapshots(Sequence):
    """Snapshots in order; each is opened only when it is asked for something."""

    def __init__(self, files):
        self.files = files

    def __len__(self):
        return len(self.files)

    def __getitem__(self, index):
        if isinstance(index, slice):
            return Snapshots(self.files[index])
        return Snapshot(self.files[index])


class Snapshot:
    """One snapshot file. Fields are attributes, read when asked for: `snapshot.x`, `snapshot.pressure`."""

    def __init__(self, path):
        self.path = Path(path)

    @cached_property
    def attributes(self):
        """What the file says of itself: time, step, dt, title, dim, precision, materials."""
        with open_snapshot(self.path) as file:
            return {name: plain_attribute(value) for name, value in file["pmpm"].attrs.items()}

    @property
    def time(self):
        """Simulated time in s."""
        return self.attributes["time"]

    @property
    def step(self):
        """Number of steps taken before it."""
        return self.attributes["step"]

    @property
    def x(self):
        """(count, dim) positions in m."""
        with open_snapshot(self.path) as file:
            return file["VTKHDF/Points"][:, : self.attributes["dim"]]

    @cached_property
    def fields(self):
        """Names of the particle fields in the file."""
        with open_snapshot(self.path) as file:
            return sorted(file["VTKHDF/PointData"])

    @cached_property
    def laws(self):
        """{law: names of its own state in the file}."""
        with open_snapshot(self.path) as file:
            return {law: sorted(group) for law, group in file["pmpm"].items()}

    def law_field(self, law, name):
        """A law's own state over that law's particles only, in the order of the file."""
        with open_snapshot(self.path) as file:
            return file["pmpm"][law][name][...]

    def __getattr__(self, name):
        if name.startswith("_"):
            raise AttributeError(name)
        with open_snapshot(self.path) as file:
            held = file["VTKHDF/PointData"]
            if name not in held:
                raise AttributeError(f"snapshot {self.path} holds no {name!r}; it holds x, {', '.join(sorted(held))}")
            values = held[name][...]
        return values[:, : self.attributes["dim"]] if name == "velocity" else values

    def __repr__(self):
        return f"Snapshot({str(self.path)!r})"


def open_snapshot(path):
    """An open h5py file that is a snapshot of this format version; OutputError for anything else."""
    import h5py

    try:
        file = h5py.File(path, "r")
    except OSError as error:
        raise OutputError(f"{path} cannot be read as a snapshot: {error}") from error
    version = file["pmpm"].attrs.get("format_version") if "pmpm" in file and "VTKHDF/Points" in file else None
    if version == FORMAT_VERSION:
        return file
    file.close()
    if version is None:
        raise OutputError(f"{path} is an HDF5 file but not a snapshot of pmpm")
    raise OutputError(f"{path} has snapshot format_version {version}; this pmpm reads {FORMAT_VERSION}")


def plain_attribute(value):
    """An HDF5 attribute as Python's own number, text or list of text."""
    if isinstance(value, np.ndarray):
        return [plain_attribute(entry) for entry in value]
    if isinstance(value, bytes):
        return value.decode("utf-8")
    return value.item() if isinstance(value, np.generic) else value


def read_diagnostics(path):
    """{name: array} of a CSV file of numbers. A last line that is still being written is left out."""
    try:
        text = Path(path).read_text(encoding="utf-8")
    except FileNotFoundError:
        return {}
    rows = list(csv.reader(text[: text.rfind("\n") + 1].splitlines()))
    if not rows:
        return {}
    names, lines = rows[0], rows[1:]
    if any(len(line) != len(names) for line in lines):
        raise OutputError(f"{path} is damaged: a line has not the {len(names)} entries of the header")
    try:
        columns = zip(*lines, strict=True) if lines else ((),) * len(names)
        return {
            name: np.array(column, np.int64 if name in WHOLE_NUMBERS else np.float64)
            for name, column in zip(names, columns, strict=True)
        }
    except ValueError as error:
        raise OutputError(f"{path} is damaged: {error}") from error


def describe(path):
    """What a run directory or a snapshot file holds, as lines for a person. OutputError for anything else."""
    path = Path(path)
    if not path.exists():
        raise OutputError(f"{path} does not exist")
    if path.is_file():
        return describe_snapshot(Snapshot(path))
    if read_record(path) is None:
        raise OutputError(f"{path} holds neither a run (no {RECORD} of pmpm in it) nor is it a snapshot file")
    return describe_run(Run(path))


def describe_run(run):
    record, snapshots, diagnostics = run.record, run.snapshots, run.diagnostics
    wall = f" after {record['wall_seconds']} s" if "wall_seconds" in record else ""
    lines = [
        f"run           {run.path}",
        f"title         {title_of(run.path / SCENE)}",
        f"status        {run.status}{wall}",
        f"started       {record.get('started', 'unknown')}",
        f"ranks         {record.get('ranks', 'unknown')} on {', '.join(record.get('hosts', {})) or 'unknown'}",
        f"pmpm          {record.get('versions', {}).get('pmpm') or 'unknown version'}",
        f"snapshots     {len(snapshots)}",
    ]
    if len(snapshots):
        first, last = snapshots[0], snapshots[-1]
        lines[-1] += f", t = {first.time:.6g} to {last.time:.6g} s; open {run.path / 'snapshots.xdmf'} in ParaView"
        lines += ["last snapshot", *("  " + line for line in describe_snapshot(last).splitlines())]
    if diagnostics:
        times = diagnostics.get("time", np.empty(0))
        span = f", t = {times[0]:.6g} to {times[-1]:.6g} s" if len(times) else ""
        lines += [f"diagnostics   {len(times)} lines{span}", "  " + ", ".join(diagnostics)]
    return "\n".join(lines)


def describe_snapshot(snapshot):
    told = snapshot.attributes
    with open_snapshot(snapshot.path) as file:
        fields = [f"  {name:<20} {kind_of(item)}" for name, item in sorted(file["VTKHDF/PointData"].items())]
        states = [
            f"  {law + '/' + name:<20} {kind_of(item)}, {len(item)} particles of {law}"
            for law, group in sorted(file["pmpm"].items())
            for name, item in sorted(group.items())
        ]
        count = len(file["VTKHDF/Points"])
    lines = [
        f"snapshot      {snapshot.path}",
        f"title         {told['title']}",
        f"time          {told['time']:.6g} s, step {told['step']}, dt {told['dt']:.3g} s",
        f"particles     {count} in {told['dim']}-D, {told['precision']}",
        f"materials     {', '.join(f'{index} {name}' for index, name in enumerate(told['materials']))}",
        "fields",
        *fields,
        *states,
    ]
    return "\n".join(lines)


def kind_of(dataset):
    columns = int(np.prod(dataset.shape[1:], dtype=np.int64))
    unit = plain_attribute(dataset.attrs["unit"]) if "unit" in dataset.attrs else "-"
    return f"{dataset.dtype.name} {f'x {columns}' if columns > 1 else '':<4} {unit}"


def title_of(path):
    try:
        return tomllib.loads(path.read_text(encoding="utf-8")).get("title", "")
    except (OSError, ValueError):
        return "(scene.toml cannot be read)"
