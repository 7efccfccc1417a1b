"""Fields on the nodes of the background grid, one file beside each snapshot and an index over them for ParaView.

A file is at once the heavy data of DIR/grid.xdmf and, in 3-D, a VTKHDF ImageData. Rows are planes of nodes across the last
axis, whatever axis is cut into slabs: neither format knows another order. In 2-D it is no VTKHDF: ParaView 5.11 ends on one.
"""

import numpy as np

from pmpm.output.datasets import default_parallel, write_datasets
from pmpm.output.files import OutputError, explain, on_rank_zero, write_atomically
from pmpm.output.layout import FORMAT_VERSION
from pmpm.output.reader import reading_grid
from pmpm.output.run_directory import GRID_INDEX, GRIDS, grid_files
from pmpm.output.snapshots import index_item, index_text

POINTS = "VTKHDF/PointData"
# Of fields with so many components; of others, which it calls a matrix, XDMF takes the axes of the grid for rows and columns.
KINDS = {1: "Scalar", 3: "Vector", 6: "Tensor6", 9: "Tensor"}


class GridWriter:
    """Writes DIR/grid/000000.hdf, 000001.hdf, ... with the numbers of the snapshots, and the index over them.

    `fields_of(simulation, names)` gives this rank's rows of the named fields, see grid_fields.of_nodes. `first`: the number of
    the next snapshot, where a run goes on.
    """

    def __init__(self, directory, scene, fields_of, first=0):
        self.directory, self.scene, self.comm = directory, scene, directory.comm
        self.fields_of, self.names = fields_of, list(scene.output.grid_fields)
        self.parallel = default_parallel(self.comm)
        self.entries: list[str] = []
        on_rank_zero(self.comm, lambda: (directory.path / GRIDS).mkdir(exist_ok=True))
        if first > 0:
            self.entries, damaged = on_rank_zero(self.comm, lambda: entries_on_disk(directory.path))
            for complaint in damaged:
                directory.log(f"warning: {complaint}: left out of {GRID_INDEX}")
            if self.entries:
                self.write_index()

    def __call__(self, simulation, number):
        """Write the fields that go with the snapshot of this number. Collective; OutputError on all ranks if any rank fails."""
        path = self.directory.path / GRIDS / f"{number:06d}.hdf"
        pieces = {f"{POINTS}/{name}": rows for name, rows in self.fields_of(simulation, self.names).items()}
        nodes = self.scene.domain.nodes
        attributes = grid_attributes(self.scene, simulation)
        if "mass" in self.names:
            attributes[f"{POINTS}/mass"] = {"unit": "kg"}
        shapes, _ = write_datasets(self.comm, path, pieces, attributes, self.parallel)
        self.entries.append(index_entry(path.name, simulation.time, nodes, self.scene.domain.cell_size, shapes))
        self.write_index()

    def write_index(self):
        text = index_text(self.scene.title, self.entries)
        on_rank_zero(self.comm, lambda: write_atomically(self.directory.path / GRID_INDEX, text))


def grid_attributes(scene, simulation):
    """Attributes of the file's groups: what VTK needs to place the nodes, and what pmpm reads."""
    nodes = scene.domain.nodes
    extent = [number for count in (*nodes, 1)[:3] for number in (0, count - 1)]
    image = {
        "Version": np.array([1, 0], np.int64),
        "Type": np.bytes_("ImageData"),
        "WholeExtent": np.array(extent, np.int64),
        "Origin": np.zeros(3),
        "Spacing": np.full(3, scene.domain.cell_size),
        "Direction": np.eye(3).ravel(),
    }
    own = {
        "format_version": np.int64(FORMAT_VERSION),
        "time": np.float64(simulation.time),
        "step": np.int64(simulation.step_count),
        "dim": np.int64(scene.dim),
        "nodes": np.array(nodes, np.int64),
        "cell_size": np.float64(scene.domain.cell_size),
    }
    return {"pmpm": own} | ({"VTKHDF": image} if scene.dim == 3 else {})


def entries_on_disk(place):
    """(entries of the index for the files that a run has left in its folder, complaints about those that cannot be read)."""
    entries, complaints = [], []
    for path in grid_files(place):
        try:
            with reading_grid(path) as (file, told):
                shapes = {f"{POINTS}/{name}": (item.shape, item.dtype) for name, item in file[POINTS].items()}
            entries.append(index_entry(path.name, told["time"], told["nodes"], told["cell_size"], shapes))
        except OutputError as error:
            complaints.append(explain(error))
    return entries, complaints


def rewrite_index(directory, title):
    """List what is left in a run's folder, where no more is to come. Collective."""

    def rewrite():
        if (directory.path / GRID_INDEX).exists():
            write_atomically(directory.path / GRID_INDEX, index_text(title, entries_on_disk(directory.path)[0]))

    on_rank_zero(directory.comm, rewrite)


def index_entry(name, time, nodes, cell_size, shapes):
    """XDMF text of the fields at one time: a uniform grid in space, in 2-D of one plane: VTK turns grids of two axes round."""
    flat = (1,) * (3 - len(nodes))
    dimensions = " ".join(map(str, (*flat, *reversed(nodes))))
    size = repr(float(cell_size))
    lines = [
        f'<Grid Name="{name.partition(".")[0]}">',
        f'<Time Value="{float(time)!r}"/>',
        f'<Topology TopologyType="3DCoRectMesh" Dimensions="{dimensions}"/>',
        '<Geometry GeometryType="ORIGIN_DXDYDZ">',
        '<DataItem Dimensions="3" NumberType="Float" Precision="8" Format="XML">0 0 0</DataItem>',
        f'<DataItem Dimensions="3" NumberType="Float" Precision="8" Format="XML">{size} {size} {size}</DataItem>',
        "</Geometry>",
    ]
    for path in sorted(shapes):
        shape, dtype = shapes[path]
        components = int(np.prod(shape[len(nodes) :], dtype=np.int64))
        if components not in KINDS:
            continue
        lines += [
            f'<Attribute Name="{path.rpartition("/")[2]}" AttributeType="{KINDS[components]}" Center="Node">',
            index_item(f"{GRIDS}/{name}", path, {path: ((*flat, *shape), dtype)}),
            "</Attribute>",
        ]
    return "\n".join([*lines, "</Grid>\n"])
