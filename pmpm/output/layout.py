"""What makes an HDF5 file a snapshot: what VTK needs to draw particles, and attributes."""

import numpy as np

from pmpm.output.datasets import Later

FORMAT_VERSION = 1
VTK_VERTEX = 1
PLACED = "collider "  # begins the name of the attribute that tells where a collider is
GROUP = 1 << 18  # rows that are made at a time


def three_columns(vectors):
    """(n, 3) from (n, dim): in 2-D the third component is zero, for VTK knows only space."""
    vectors = np.asarray(vectors)
    wide = np.zeros((len(vectors), 3), vectors.dtype)
    wide[:, : vectors.shape[1]] = vectors
    return wide


def topology(comm, first, rows, count):
    """This rank's rows of what VTK needs to draw `count` particles as one vertex each, all in one partition.

    One partition, whatever the number of ranks: with several, Connectivity would count anew in each, and mean another
    thing to XDMF than to VTKHDF.
    """
    last, is_last = first + rows, comm.rank == comm.size - 1
    total = np.full(1 if comm.rank == 0 else 0, count, np.int64)
    return {
        "VTKHDF/NumberOfPoints": total,
        "VTKHDF/NumberOfCells": total,
        "VTKHDF/NumberOfConnectivityIds": total,
        "VTKHDF/Connectivity": counted(first, last),
        "VTKHDF/Offsets": counted(first, last + 1 if is_last else last),
        "VTKHDF/Types": Later((rows,), np.dtype(np.uint8), lambda: [np.full(rows, VTK_VERTEX, np.uint8)]),
    }


def counted(first, last):
    """The whole numbers first .. last - 1 as rows."""

    def make():
        return (np.arange(begin, min(begin + GROUP, last), dtype=np.int64) for begin in range(first, last, GROUP))

    return Later((last - first,), np.dtype(np.int64), make)


def snapshot_attributes(scene, time, step, dt):
    """Attributes of the file's two groups. Text has a fixed length: VTK wants that of Type, and parallel HDF5."""
    return {
        "VTKHDF": {"Version": np.array([1, 0], np.int64), "Type": np.bytes_("UnstructuredGrid")},
        "pmpm": {
            "format_version": np.int64(FORMAT_VERSION),
            "time": np.float64(time),
            "step": np.int64(step),
            "dt": np.float64(dt),
            "title": scene.title or "",
            "dim": np.int64(scene.dim),
            "precision": scene.method.precision,
            "materials": list(scene.materials),
        },
    }


def place_attributes(places):
    """{name: (dim, dim + 1)} of colliders, {name: (rotation (dim, dim), shift (dim,) m)} since the start: the rotation, and the
    shift as the last column. One each, for HDF5 keeps 64 KiB in one."""
    return {f"{PLACED}{name}": np.column_stack([turn, shift]) for name, (turn, shift) in places.items()}


def places_told(attributes, dim):
    """What `place_attributes` was made from. Raises ValueError for what is no place."""
    told = {name: np.asarray(value) for name, value in attributes.items() if name.startswith(PLACED)}
    for name, table in told.items():
        if table.shape != (dim, dim + 1) or table.dtype.kind != "f" or not np.isfinite(table).all():
            raise ValueError(f"attribute {name} is no place")
    return {name.removeprefix(PLACED): (table[:, :dim], table[:, dim]) for name, table in told.items()}
