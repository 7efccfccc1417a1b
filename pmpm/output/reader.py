"""Reading what a run left behind, or is still writing: `load` for Python, `describe` for `pmpm info`.

Files may be damaged, or made by someone else: whatever is wrong with one is told as an OutputError that names it.
"""

import contextlib
import csv
import math
import tomllib
import zipfile
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from pmpm.output import manifests
from pmpm.output.diagnostics import WHOLE
from pmpm.output.files import OutputError
from pmpm.output.layout import FORMAT_VERSION, places_told
from pmpm.output.run_directory import (
    CHECKPOINTS,
    DIAGNOSTICS,
    FAILED,
    GRID_INDEX,
    MAPS,
    RECORD,
    SCENE,
    SERIES,
    grid_files,
    read_record,
    read_status,
    series_files,
    snapshot_files,
)
from pmpm.state.fields import OUTPUT_VECTORS

ATTRIBUTES = {"time": float, "step": int, "dt": float, "title": str, "dim": int, "precision": str, "materials": list}
# What h5py raises for what it finds in damaged files, besides OSError: it has no kind of error of its own.
DAMAGES = (
    OSError,
    KeyError,
    ValueError,
    TypeError,
    RuntimeError,
    AttributeError,
    IndexError,
    ArithmeticError,
    MemoryError,
)


def load(path):
    """The run in the folder `path`, finished or running, as a `Run`. OutputError if there is none."""
    path = existing(path)
    if read_record(path) is None:
        raise OutputError(f"{path} does not hold a run: no {RECORD} of pmpm in it")
    return Run(path)


def existing(path):
    """A path at which there is something; OutputError if there is nothing, or the system cannot even say so."""
    path = Path(path)
    try:
        there = path.exists()
    except OSError as error:  # a name that is too long
        raise OutputError(f"{str(path)[:80]} ... cannot be looked up: {error.strerror}") from error
    if not there:
        raise OutputError(f"{path} does not exist")
    return path


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
    def table(self):
        """What scene.toml says, defaults filled in, as nested dicts of plain values: of any scene, of Python functions too.
        OutputError where it cannot be read."""
        path = self.path / SCENE
        try:
            return tomllib.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError) as error:
            raise OutputError(f"{path} cannot be read: {error}") from error

    @property
    def snapshots(self):
        """The snapshots written so far, in order: a sequence of `Snapshot`."""
        return Snapshots(snapshot_files(self.path))

    @property
    def grids(self):
        """The fields on nodes written so far, in order: a sequence of `GridFields`, of the same numbers as the snapshots that
        they go with if the run had them from its start."""
        return Snapshots(grid_files(self.path), GridFields)

    @property
    def diagnostics(self):
        """{name: array over the lines of diagnostics.csv}; empty if there are none yet."""
        return read_diagnostics(self.path / DIAGNOSTICS)

    @property
    def probes(self):
        """{name: {column: array}} of the probes, as far as they are written."""
        return self.series("probes")

    @property
    def gauges(self):
        """{name: {column: array}} of the gauges, as far as they are written."""
        return self.series("gauges")

    def series(self, kind):
        found = [path for path in series_files(self.path) if path.parent.name == kind]
        return {path.stem: read_diagnostics(path) for path in found}

    @property
    def maps(self):
        """{name: array} of maps.npz: maps over the columns (m, m/s), where these are (m), `time` and `step`; empty without it.
        OutputError where it cannot be read."""
        path = self.path / MAPS
        if not path.exists():
            return {}
        try:
            with np.load(path, allow_pickle=False) as file:
                return {name: file[name] for name in file.files}
        except (*DAMAGES, EOFError, zipfile.BadZipFile) as error:
            raise OutputError(damage(path, error)) from error


class Snapshots(Sequence):
    """Snapshots in order; each is opened only when it is asked for something."""

    def __init__(self, files, kind=None):
        self.files, self.kind = files, kind or Snapshot

    def __len__(self):
        return len(self.files)

    def __getitem__(self, index):
        if isinstance(index, slice):
            return Snapshots(self.files[index], self.kind)
        return self.kind(self.files[index])


class AtOneTime:
    """A file of one time of a run; `attributes` are what it says of itself."""

    attributes: Any

    def __init__(self, path):
        self.path = Path(path)

    @property
    def time(self):
        """Simulated time in s."""
        return self.attributes["time"]

    @property
    def step(self):
        """Number of steps taken before it."""
        return self.attributes["step"]

    def __repr__(self):
        return f"{type(self).__name__}({str(self.path)!r})"


class Snapshot(AtOneTime):
    """One snapshot file. Fields are attributes, read when asked for: `snapshot.x`, `snapshot.pressure`."""

    @cached_property
    def attributes(self):
        """What the file says of itself: time, step, dt, title, dim, precision, materials."""
        with reading(self.path) as file:
            told = {name: plain_attribute(value) for name, value in file["pmpm"].attrs.items()}
            check_attributes(told)
            return told

    @property
    def collider_places(self):
        """{name of a collider: (rotation (dim, dim), shift (dim,) m)} since the start; none in older files."""
        try:
            return places_told(self.attributes, self.attributes["dim"])
        except ValueError as error:
            raise OutputError(damage(self.path, error)) from error

    @property
    def x(self):
        """(count, dim) positions in m."""
        with reading(self.path) as file:
            return file["VTKHDF/Points"][:, : self.attributes["dim"]]

    @cached_property
    def fields(self):
        """Names of the particle fields in the file."""
        with reading(self.path) as file:
            return sorted(file["VTKHDF/PointData"])

    @cached_property
    def laws(self):
        """{law: names of its own state in the file}."""
        with reading(self.path) as file:
            return {law: sorted(group.keys()) for law, group in file["pmpm"].items()}

    def law_field(self, law, name):
        """A law's own state over that law's particles only, in the order of the file. KeyError if it is not in it."""
        if name not in self.laws.get(law, ()):
            raise KeyError(f"snapshot {self.path} holds no {law}/{name}; it holds {self.laws}")
        with reading(self.path) as file:
            return file["pmpm"][law][name][...]

    def __getattr__(self, name):
        if name.startswith("_"):
            raise AttributeError(name)
        with reading(self.path) as file:
            held = file["VTKHDF/PointData"]
            if name in held:
                values = held[name][...]
                return values[:, : self.attributes["dim"]] if name in OUTPUT_VECTORS else values
            known = ", ".join(sorted(held))
        raise AttributeError(f"snapshot {self.path} holds no {name!r}; it holds x, {known}")


class GridFields(AtOneTime):
    """Fields on the nodes of the grid at one time. They are attributes, read when asked for: `grid.pressure`, (nodes along x,
    along y, ...)."""

    @cached_property
    def attributes(self):
        """What the file says of itself: time (s), step, dim, nodes of each axis, cell_size (m)."""
        with reading_grid(self.path) as (_, told):
            return told

    @property
    def x(self):
        """Of each axis where its nodes are, (nodes,) m."""
        told = self.attributes
        return tuple(np.arange(count) * told["cell_size"] for count in told["nodes"])

    @cached_property
    def fields(self):
        """Names of the fields in the file."""
        with reading_grid(self.path) as (file, _):
            return sorted(file["VTKHDF/PointData"])

    def __getattr__(self, name):
        if name.startswith("_"):
            raise AttributeError(name)
        with reading_grid(self.path) as (file, told):
            held, dim = file["VTKHDF/PointData"], told["dim"]
            if name in held:
                values = held[name][...]
                values = values.transpose(*reversed(range(dim)), *range(dim, values.ndim))
                return values[..., :dim] if name in OUTPUT_VECTORS else values
            known = ", ".join(sorted(held))
        raise AttributeError(f"{self.path} holds no {name!r} on nodes; it holds {known}")


@contextlib.contextmanager
def reading_grid(path):
    """(open file of fields on nodes, what it says of itself); whatever does not fit, or cannot be read, raises OutputError."""
    with opened(path, "grid", holds_nodes) as file:
        try:
            told = {name: plain_attribute(value) for name, value in file["pmpm"].attrs.items()}
            check_nodes(file, told)
            yield file, told
        except DAMAGES as error:
            raise OutputError(damage(path, error)) from error


def check_nodes(file, told):
    """Raise ValueError unless a file of fields on nodes holds numbers for all of them."""
    import h5py

    for name, kind in {"time": float, "step": int, "dim": int, "cell_size": float, "nodes": list}.items():
        if type(told.get(name)) is not kind:
            raise ValueError(f"attribute {name} is {told.get(name)!r}")
    nodes = told["nodes"]
    if told["dim"] not in (2, 3) or len(nodes) != told["dim"] or not all(type(count) is int for count in nodes):
        raise ValueError(f"attribute nodes is {nodes} in {told['dim']}-D")
    for dataset in file["VTKHDF/PointData"].values():
        numbers = isinstance(dataset, h5py.Dataset) and dataset.dtype.kind == "f"
        if not numbers or dataset.shape[: len(nodes)] != tuple(reversed(nodes)):
            raise ValueError(f"{dataset.name} holds no numbers of {' x '.join(map(str, nodes))} nodes")


def is_grid(path):
    """Whether a file is one of fields on nodes, as far as its head tells."""
    import h5py

    try:
        with h5py.File(path, "r") as file:
            return holds_nodes(file)
    except DAMAGES:
        return False


def holds_particles(file):
    return "pmpm" in file and "VTKHDF/Points" in file


def holds_nodes(file):
    return "pmpm" in file and "nodes" in file["pmpm"].attrs


def open_snapshot(path):
    """An open h5py file that is a snapshot of this format version; OutputError for anything else."""
    return opened(path, "snapshot", holds_particles)


def opened(path, kind, is_one):
    """An open h5py file of a kind, which `is_one` knows by what it holds, in this format version; OutputError for anything
    else."""
    import h5py

    try:
        file = h5py.File(path, "r")
    except (OSError, ValueError, RuntimeError) as error:
        raise OutputError(f"{path} cannot be read as a {kind}: {error}") from error
    try:
        check_version(file, path, kind, is_one)
    except DAMAGES as error:
        file.close()
        raise OutputError(damage(path, error)) from error
    except OutputError:
        file.close()
        raise
    return file


@contextlib.contextmanager
def reading(path):
    """A snapshot while it is being read: whatever does not fit, or cannot be read, raises OutputError."""
    with open_snapshot(path) as file:
        try:
            check_layout(file)
            yield file
        except DAMAGES as error:
            raise OutputError(damage(path, error)) from error


def damage(path, error):
    return f"{path} is damaged: {' '.join(str(error).split()) or type(error).__name__}"


def check_version(file, path, kind, is_one):
    """Raise OutputError for an HDF5 file that is not of a kind, or of another version."""
    version = plain_attribute(file["pmpm"].attrs.get("format_version")) if is_one(file) else None
    if version is None:
        raise OutputError(f"{path} is an HDF5 file but not a {kind} of pmpm")
    if version != FORMAT_VERSION:
        raise OutputError(f"{path} has {kind} format_version {version}; this pmpm reads {FORMAT_VERSION}")


def check_layout(file):
    """Raise ValueError unless groups are groups, and datasets have a row for each particle."""
    import h5py

    points, fields, pmpm = file["VTKHDF/Points"], file["VTKHDF/PointData"], file["pmpm"]
    if not isinstance(points, h5py.Dataset) or points.ndim != 2 or points.shape[1] != 3 or points.dtype.kind != "f":
        raise ValueError("VTKHDF/Points holds no points")
    for group in (fields, pmpm, *pmpm.values()):
        if not isinstance(group, h5py.Group):
            raise ValueError(f"{group.name} is no group")
    for dataset in (item for group in (fields, *pmpm.values()) for item in group.values()):
        if not isinstance(dataset, h5py.Dataset) or not dataset.shape or dataset.dtype.kind not in "fiu":
            raise ValueError(f"{dataset.name} holds no numbers of particles")
        if dataset.parent.name == fields.name and len(dataset) != len(points):
            raise ValueError(f"{dataset.name} has {len(dataset)} rows for {len(points)} particles")


def check_attributes(told):
    """Raise ValueError unless the file says of itself what all snapshots say."""
    for name, kind in ATTRIBUTES.items():
        if type(told.get(name)) is not kind:
            raise ValueError(f"attribute {name} is {told.get(name)!r}")
    if told["dim"] not in (2, 3):
        raise ValueError(f"attribute dim is {told['dim']}")


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
        rows = list(csv.reader(text[: text.rfind("\n") + 1].splitlines()))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, csv.Error) as error:
        raise OutputError(f"{path} cannot be read: {error}") from error
    if not rows:
        return {}
    names, lines = rows[0], rows[1:]
    if any(len(line) != len(names) for line in lines):
        raise OutputError(f"{path} is damaged: a line has not the {len(names)} entries of the header")
    try:
        columns = zip(*lines, strict=True) if lines else ((),) * len(names)
        return {
            name: np.array(column, np.int64 if name in WHOLE else np.float64)
            for name, column in zip(names, columns, strict=True)
        }
    except (ValueError, OverflowError) as error:
        raise OutputError(f"{path} is damaged: {error}") from error


def describe(path):
    """What a run directory or a snapshot file holds, as lines for a person. OutputError for anything else."""
    path = existing(path)
    if path.is_file() and is_grid(path):
        return describe_grid(GridFields(path))
    if path.is_file():
        return describe_snapshot(Snapshot(path))
    if read_record(path) is None:
        raise OutputError(f"{path} holds neither a run (no {RECORD} of pmpm in it) nor is it a snapshot file")
    return describe_run(Run(path))


def describe_run(run):
    record, snapshots, diagnostics = run.record, run.snapshots, run.diagnostics
    wall = f" after {record['wall_seconds']} s" if "wall_seconds" in record else ""
    hosts, versions = table_in(record, "hosts"), table_in(record, "versions")
    lines = [
        f"run           {run.path}",
        f"title         {title_of(run.path / SCENE)}",
        f"status        {run.status}{wall}",
        f"started       {record.get('started', 'unknown')}",
        f"ranks         {record.get('ranks', 'unknown')} on {', '.join(hosts) or 'unknown'}",
        f"pmpm          {versions.get('pmpm') or 'unknown version'}",
        f"snapshots     {len(snapshots)}",
    ]
    if len(snapshots):
        first, last = snapshots[0], snapshots[-1]
        lines[-1] += f", t = {first.time:.6g} to {last.time:.6g} s; open {run.path / 'snapshots.xdmf'} in ParaView"
        lines += ["last snapshot", *("  " + line for line in describe_snapshot(last).splitlines())]
    lines += grid_lines(run)
    lines += checkpoint_lines(run.path)
    if diagnostics:
        times = diagnostics.get("time", np.empty(0))
        span = f", t = {times[0]:.6g} to {times[-1]:.6g} s" if len(times) else ""
        lines += [f"diagnostics   {len(times)} lines{span}", "  " + ", ".join(diagnostics)]
    for kind in SERIES:
        names = [path.stem for path in series_files(run.path) if path.parent.name == kind]
        lines += [f"{kind:<13} {', '.join(names)}"] if names else []
    if maps := run.maps:
        lines.append(f"maps          {', '.join(name for name in maps if maps[name].ndim and name not in 'xyz')}")
    return "\n".join(lines)


def grid_lines(run):
    """What there is of fields on nodes."""
    if not len(run.grids):
        return []
    named = f"{', '.join(run.grids[-1].fields)}; open {run.path / GRID_INDEX} in ParaView"
    return [f"grid fields   {len(run.grids)}, {named}"]


def describe_grid(grid):
    told = grid.attributes
    lines = [
        f"grid fields   {grid.path}",
        f"time          {grid.time:.6g} s after {grid.step} steps",
        f"nodes         {' x '.join(map(str, told['nodes']))}, {told['cell_size']:.6g} m apart",
        "fields",
    ]
    with reading_grid(grid.path) as (file, _):
        dim, held = told["dim"], sorted(file["VTKHDF/PointData"].items())
        fields = [f"  {name:<20} {kind_of(item, dim)}" for name, item in held]
    return "\n".join([*lines, *fields])


def checkpoint_lines(place):
    """What there is to go on from, as the manifests say: whether the files are as good is seen when one is used."""
    folder = place / CHECKPOINTS
    held = manifests.numbers(folder)
    lines = [f"checkpoints   {len(held)}"]
    if held:
        try:
            newest = manifests.read_manifest(folder / f"{held[0]:06d}.hdf")
            lines[-1] += f", the newest at step {newest['step']}, t = {newest['time']:.6g} s"
        except OutputError as error:
            lines[-1] += f"; {error}"
        lines[-1] += f"; pmpm run --restart {place} goes on"
    if (place / FAILED).exists():
        lines.append(f"failed state  {place / FAILED}")
    return lines


def table_in(record, name):
    """A table of run.json, empty if there is none."""
    return record[name] if isinstance(record.get(name), dict) else {}


def describe_snapshot(snapshot):
    told = snapshot.attributes
    with reading(snapshot.path) as file:
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
        *([f"failed        {told['failure']}"] if "failure" in told else []),
        "fields",
        *fields,
        *states,
    ]
    return "\n".join(lines)


def kind_of(dataset, axes=1):
    columns = math.prod(dataset.shape[axes:])
    unit = plain_attribute(dataset.attrs["unit"]) if "unit" in dataset.attrs else "-"
    return f"{dataset.dtype.name} {f'x {columns}' if columns > 1 else '':<4} {unit}"


def title_of(path):
    try:
        return tomllib.loads(path.read_text(encoding="utf-8")).get("title", "")
    except (OSError, ValueError, RecursionError):
        return "(scene.toml cannot be read)"
