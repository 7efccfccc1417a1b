"""Snapshots: all particles at one time in one HDF5 file, written by all ranks at once, and the index over them.

One snapshot file is two things at once: a VTKHDF UnstructuredGrid of one time step, and the heavy data of the XDMF
index DIR/snapshots.xdmf, the file to open in ParaView. Older ParaViews read no time-dependent VTKHDF, and the XDMF
index works in old and new ones. Rows stand in the one global order: rank 0's particles, then rank 1's, so no file
tells how many ranks wrote it.
"""

import socket
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from pmpm.output.datasets import default_parallel, write_datasets
from pmpm.output.files import OutputError, explain, on_every_rank, on_rank_zero, write_atomically
from pmpm.output.layout import place_attributes, snapshot_attributes, three_columns, topology
from pmpm.output.reader import reading
from pmpm.output.run_directory import FAILED, INDEX, SNAPSHOTS, snapshot_files
from pmpm.state.fields import OUTPUT_NAMES, OUTPUT_VECTORS


class SnapshotWriter:
    """Observer that writes DIR/snapshots/000000.hdf, 000001.hdf, ... and the index over them.

    `fields` are the names to write beside `id` (default: scene.output.fields). `parallel`: how several ranks write one
    file, "mpio" (collective MPI-IO, needs an h5py built with MPI; the default where it is) or "pwrite" (rank 0 lays
    the file out, every rank writes its bytes into it). `first`: the number of the next one, where a run goes on.
    """

    def __init__(self, directory, scene, fields=None, parallel=None, first=0):
        self.directory, self.scene, self.comm = directory, scene, directory.comm
        self.names = list(scene.output.fields if fields is None else fields)
        self.parallel = parallel or default_parallel(self.comm)
        self.count = first
        self.entries: list[str] = []
        on_rank_zero(self.comm, lambda: (directory.path / SNAPSHOTS).mkdir(exist_ok=True))
        if first > 0:
            self.entries, damaged = on_rank_zero(self.comm, lambda: entries_on_disk(directory.path, self.names))
            for complaint in damaged:
                directory.log(f"warning: {complaint}: left out of {INDEX}")
            if self.entries:  # the index on the disk may list what has been cut off
                self.write_index()
        hosts = set(self.comm.gather(socket.gethostname()))
        if self.parallel == "pwrite" and len(hosts) > 1:
            directory.log(
                f"snapshots are written from {len(hosts)} hosts by plain writes to one file: on NFS this is not "
                "safe. Use a parallel file system (Lustre, GPFS, BeeGFS), or an h5py built with MPI"
            )

    def __call__(self, simulation):
        """Write one snapshot of `simulation`. Collective; OutputError on all ranks if any rank fails."""
        path = self.directory.path / SNAPSHOTS / f"{self.count:06d}.hdf"
        shapes = write_snapshot(self.comm, path, simulation, self.scene, self.names, self.parallel)
        self.entries.append(index_entry(path, simulation.time, shapes))
        self.count += 1
        self.write_index()

    def write_index(self):
        text = index_text(self.scene.title, self.entries)
        on_rank_zero(self.comm, lambda: write_atomically(self.directory.path / INDEX, text))


def write_failed(directory, simulation, message):
    """Write the state of a run that has failed as a snapshot marked bad, DIR/failed.hdf; returns its path. Collective."""
    comm, scene, path = directory.comm, simulation.scene, directory.path / FAILED
    write_snapshot(comm, path, simulation, scene, scene.output.fields, default_parallel(comm), {"failure": message})
    return path


def write_snapshot(comm, path, simulation, scene, names, parallel, told=None):
    """Write particles with the named fields; returns {dataset path: (shape, dtype)}. `told`: more attributes. Collective."""
    pieces = on_every_rank(comm, lambda: collect(simulation, scene, names))
    first, count = comm.offsets(simulation.rows())
    attributes = snapshot_attributes(scene, simulation.time, simulation.step_count, simulation.dt)
    attributes["pmpm"] |= place_attributes(simulation.collider_places()) | (told or {})
    shapes, _ = write_datasets(
        comm, path, topology(comm, first, simulation.rows(), count) | pieces, attributes, parallel
    )
    return shapes


def entries_on_disk(place, names):
    """(entries of the index for the snapshots that a run has left in its folder, fields in the order of `names`; complaints
    about those that cannot be read)."""
    entries, complaints = [], []
    for path in snapshot_files(place):
        try:
            with reading(path) as file:
                fields = {f"VTKHDF/PointData/{name}": None for name in ["id", *names]}
                fields |= {f"VTKHDF/PointData/{name}": None for name in file["VTKHDF/PointData"]}
                wanted = ["VTKHDF/Points", "VTKHDF/Connectivity", *fields]
                shapes = {name: (file[name].shape, file[name].dtype) for name in wanted if name in file}
                entries.append(index_entry(path, file["pmpm"].attrs["time"], shapes))
        except OutputError as error:
            complaints.append(explain(error))
    return entries, complaints


def collect(simulation, scene, names):
    """This rank's rows of every particle dataset, by path in the file. OutputError if rows are missing."""
    names = [name for name in names if name != "id"]
    fields = simulation.fields_later(["id", "x", *names])
    own_state = [name for name in names if name not in OUTPUT_NAMES]
    laws = simulation.law_fields_later(own_state) if own_state else {}

    real = np.dtype(scene.method.precision)
    pieces = {"VTKHDF/Points": fields["x"].through(lambda x: three_columns(x).astype(real))}
    for name in ["id", *names]:
        rows = fields[name]
        pieces[f"VTKHDF/PointData/{name}"] = rows.through(three_columns) if name in OUTPUT_VECTORS else rows
    for path, rows in pieces.items():
        if len(rows) != simulation.rows():
            raise OutputError(f"{path} has {len(rows)} rows for {simulation.rows()} particles")
    for law, state in laws.items():
        pieces |= {f"pmpm/{law}/{name}": rows for name, rows in state.items()}
    return pieces


def index_text(title, entries):
    """XDMF text of a collection over time."""
    return (
        '<?xml version="1.0" encoding="utf-8"?>\n'
        '<Xdmf Version="3.0">\n<Domain>\n'
        f'<Grid Name={quoteattr(title or "pmpm")} GridType="Collection" CollectionType="Temporal">\n'
        + "".join(entries)
        + "</Grid>\n</Domain>\n</Xdmf>\n"
    )


def index_entry(path, time, shapes):
    """XDMF text of one snapshot; none for one without particles, which VTK's XDMF reader takes for an error.

    The vertices are listed one by one: without Connectivity, ParaView 5.11 reads points but no cells, and its Surface
    view stays empty.
    """
    file = f"{SNAPSHOTS}/{Path(path).name}"
    count = shapes["VTKHDF/Points"][0][0]
    if count == 0:
        return ""
    lines = [
        f"<Grid Name={quoteattr(Path(path).stem)}>",
        f'<Time Value="{float(time)!r}"/>',
        f'<Topology TopologyType="Polyvertex" NumberOfElements="{count}" NodesPerElement="1">',
        index_item(file, "VTKHDF/Connectivity", shapes),
        "</Topology>",
        '<Geometry GeometryType="XYZ">',
        index_item(file, "VTKHDF/Points", shapes),
        "</Geometry>",
    ]
    for name in shapes:
        if name.startswith("VTKHDF/PointData/"):
            kind = {1: "Scalar", 3: "Vector", 6: "Tensor6", 9: "Tensor"}.get(columns_of(shapes[name][0]), "Matrix")
            lines += [
                f'<Attribute Name={quoteattr(name.rpartition("/")[2])} AttributeType="{kind}" Center="Node">',
                index_item(file, name, shapes),
                "</Attribute>",
            ]
    return "\n".join([*lines, "</Grid>\n"])


def columns_of(shape):
    return int(np.prod(shape[1:], dtype=np.int64))


def index_item(file, name, shapes):
    shape, dtype = shapes[name]
    number = {"f": "Float", "i": "Int", "u": "UInt"}[dtype.kind]
    size = " ".join(str(length) for length in shape)
    return (
        f'<DataItem Dimensions="{size}" NumberType="{number}" Precision="{dtype.itemsize}" Format="HDF">'
        f"{file}:/{name}</DataItem>"
    )
