"""One HDF5 file written by all ranks at once: contiguous datasets whose rows are the ranks' pieces, one after another."""

import os
import sys
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from xxhash import xxh3_64

from pmpm.output.files import (
    OutputError,
    explain,
    on_every_rank,
    on_rank_zero,
    remove_quietly,
    sync_file,
    unfinished_name,
)
from pmpm.physics.materials import LAWS
from pmpm.state.fields import OUTPUT

PIECE = 1 << 28  # bytes that are written at a time where all ranks write together
AHEAD = 3  # groups of rows that wait to be written while the next is made
ABORTED = 1  # exit status when ranks must be ended in the middle of a write
UNITS = {"Points": "m"} | {field.name: field.unit for field in OUTPUT if field.name != "material"}


@dataclass(frozen=True)
class Later:
    """Rows of a dataset that are made, group by group, when they are written: what a checkpoint holds would else be there twice
    at once."""

    shape: tuple[int, ...]
    dtype: np.dtype
    make: Callable[[], Iterable[np.ndarray]]

    def __len__(self):
        return self.shape[0]

    def through(self, function):
        """What a function makes of the rows, group by group."""
        kind = function(np.empty((0, *self.shape[1:]), self.dtype))
        return Later((len(self), *kind.shape[1:]), kind.dtype, lambda: map(function, self.make()))


def default_parallel(comm):
    """ "mpio" if several ranks meet an h5py that was built with MPI, else "pwrite"."""
    if comm.size == 1:
        return "pwrite"
    import h5py

    return "mpio" if h5py.get_config().mpi else "pwrite"


def groups_of(rows):
    """Yield the rows of a dataset as contiguous arrays of the byte order of the file."""
    for group in rows.make() if isinstance(rows, Later) else (rows,):
        group = np.asarray(group)
        yield np.ascontiguousarray(group, group.dtype.newbyteorder("<"))


def write_datasets(comm, path, pieces, attributes, parallel, durable=False):
    """Write one HDF5 file of contiguous datasets whose rows are the ranks' `pieces`, rank after rank. Collective.

    `pieces` is {dataset path: array or Later}, `attributes` {group: {name: value}}; datasets get the unit that goes with their
    name. The file appears at `path` whole or not at all; `durable`: not before it is on the disk. Returns {dataset path:
    (shape, dtype)} and, if durable, {dataset path: (bytes, checksum)} of this rank's rows. A rank may have no rows, or lack a
    dataset that another rank has. OutputError on all ranks if any fails.
    """
    shapes, starts = join_pieces(comm, pieces)
    units = UNITS | {field.name: field.unit for law in LAWS.values() for field in law.STATE}
    named = {name: name.rpartition("/")[2] for name in shapes}
    attributes = attributes | {name: {"unit": units[last]} for name, last in named.items() if last in units}
    unfinished = unfinished_name(path)
    write = write_mpio if parallel == "mpio" and comm.size > 1 else write_pwrite
    sums: dict[str, tuple[int, int]] | None = {} if durable else None
    try:
        write(comm, unfinished, pieces, shapes, starts, attributes, sums)
    except OutputError as error:
        if comm.rank == 0:
            remove_quietly(unfinished)
        raise OutputError(f"{path} cannot be written: {error}") from error
    on_rank_zero(comm, lambda: os.replace(unfinished, path))
    return shapes, sums


def join_pieces(comm, pieces):
    """({path: (shape over all ranks, dtype)}, {path: first row of this rank}); OutputError if pieces do not fit."""
    told = comm.gather({name: (rows.shape, rows.dtype.newbyteorder("<").str) for name, rows in pieces.items()})
    shapes, starts = {}, {}
    for name in dict.fromkeys(name for rank in told for name in rank):
        kinds = {(rank[name][0][1:], rank[name][1]) for rank in told if name in rank}
        if len(kinds) > 1:
            raise OutputError(f"{name} differs in shape or type between ranks: {sorted(map(str, kinds))}")
        columns, dtype = kinds.pop()
        counts = [rank[name][0][0] if name in rank else 0 for rank in told]
        shapes[name] = ((sum(counts), *columns), np.dtype(dtype))
        starts[name] = sum(counts[: comm.rank])
    return shapes, starts


def write_pwrite(comm, path, pieces, shapes, starts, attributes, sums):
    """Rank 0 lays the file out, then every rank writes its bytes to their place: parallel with an h5py without MPI.

    Needs contiguous datasets of a fixed byte order, and rank 0 done with the file before the others open it. Rows are made
    while those before them are written. `sums`: see `write_datasets`; None for no checksums and no waiting for the disk.
    """

    def lay_out():
        import h5py

        with h5py.File(path, "w") as file:
            datasets = {name: create_dataset(file, name, *shapes[name]) for name in shapes}
            write_attributes(file, attributes)
            # An empty dataset has no place in the file.
            return {name: dataset.id.get_offset() for name, dataset in datasets.items()}

    places = on_rank_zero(comm, lay_out)

    def write_rows():
        descriptor = os.open(path, os.O_WRONLY)
        try:
            with ThreadPoolExecutor(max_workers=1) as writer, ThreadPoolExecutor(max_workers=1) as syncing:
                waiting, synced = deque[Future](), list[Future]()
                for name, piece in pieces.items():
                    row_bytes = piece.dtype.itemsize * int(np.prod(piece.shape[1:], dtype=np.int64))
                    place, checksum = (places[name] or 0) + starts[name] * row_bytes, xxh3_64()
                    for group in groups_of(piece):
                        waiting.append(writer.submit(write_bytes, descriptor, group, place))
                        place += group.nbytes
                        if sums is not None:
                            checksum.update(group.reshape(-1).view(np.uint8).data)
                        if len(waiting) > AHEAD:
                            waiting.popleft().result()
                    if sums is not None and piece.shape[0]:
                        sums[name] = piece.shape[0] * row_bytes, checksum.intdigest()
                        synced.append(syncing.submit(os.fsync, descriptor))
                for task in (*waiting, *synced):
                    task.result()
            if sums is not None:
                os.fsync(descriptor)  # of what rank 0 has laid out, too
        finally:
            os.close(descriptor)

    on_every_rank(comm, write_rows)


def write_bytes(descriptor, rows, place):
    """Write all bytes of a contiguous array at `place` of an open file: the system may take only a part at a time."""
    waiting = memoryview(rows.reshape(-1).view(np.uint8))
    while len(waiting):
        written = os.pwrite(descriptor, waiting, place)
        if written <= 0:
            raise OSError(f"the system took none of {len(waiting)} bytes")
        waiting, place = waiting[written:], place + written


def write_mpio(comm, path, pieces, shapes, starts, attributes, sums):
    """All ranks write through HDF5 and MPI-IO, collectively: needs an h5py built with MPI.

    A rank that fails in the middle ends all ranks: they no longer agree on what HDF5 does next, and would wait for each other.
    """
    import h5py

    file = on_every_rank(comm, lambda: h5py.File(path, "w", driver="mpio", comm=comm.communicator))
    try:
        write_collectively(comm, file, pieces, shapes, starts, attributes, sums)
        file.close()  # not where writing has failed: closing waits for all ranks
        if sums is not None:
            sync_file(path)
    except Exception as error:
        print(f"pmpm: stopped: {path} cannot be written: {explain(error)}", file=sys.stderr, flush=True)
        remove_quietly(path)
        comm.abort(ABORTED)
        raise


def write_collectively(comm, file, pieces, shapes, starts, attributes, sums):
    """Write all datasets of an open file; a rank without rows takes part with nothing selected."""
    import h5py

    transfer = h5py.h5p.create(h5py.h5p.DATASET_XFER)
    transfer.set_dxpl_mpio(h5py.h5fd.MPIO_COLLECTIVE)
    datasets = {name: create_dataset(file, name, *shapes[name]) for name in shapes}
    write_attributes(file, attributes)
    for name, dataset in datasets.items():
        shape, dtype = shapes[name]
        if not np.prod(shape, dtype=np.int64):
            continue
        place, checksum = starts[name], xxh3_64()
        for rows in in_rounds(comm, groups_of(pieces[name]) if name in pieces else (), shape[1:], dtype):
            here, there = h5py.h5s.create_simple((max(len(rows), 1), *shape[1:])), dataset.id.get_space()
            if len(rows):
                there.select_hyperslab((place, *[0] * (rows.ndim - 1)), rows.shape)
                checksum.update(rows.reshape(-1).view(np.uint8).data)
            else:
                here.select_none()
                there.select_none()
            dataset.id.write(here, there, rows, dxpl=transfer)
            place += len(rows)
        if sums is not None and place > starts[name]:
            row_bytes = dtype.itemsize * int(np.prod(shape[1:], dtype=np.int64))
            sums[name] = (place - starts[name]) * row_bytes, checksum.intdigest()


def in_rounds(comm, groups, columns, dtype):
    """Yield this rank's groups of rows, each at most PIECE bytes, and no rows as long as another rank has some left."""
    left = iter(pieces_of(groups))
    while True:
        rows = next(left, None)
        if not comm.max(np.array([rows is not None], np.int64))[0]:
            return
        yield np.empty((0, *columns), dtype) if rows is None else rows


def pieces_of(groups):
    """Yield groups of rows in pieces of at most PIECE bytes: what MPI counts in 32 bits."""
    for rows in groups:
        step = max(1, PIECE // max(rows[:1].nbytes, 1))
        for first in range(0, len(rows), step):
            yield rows[first : first + step]


def create_dataset(file, name, shape, dtype):
    """Create a contiguous dataset whose place in the file is fixed at once and which is not filled."""
    import h5py

    kind = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    kind.set_layout(h5py.h5d.CONTIGUOUS)
    kind.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    kind.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
    kind.set_obj_track_times(False)
    group, _, last = name.rpartition("/")
    space, datatype = h5py.h5s.create_simple(shape), h5py.h5t.py_create(dtype)
    return h5py.Dataset(h5py.h5d.create(file.require_group(group).id, last.encode(), datatype, space, kind))


def write_attributes(file, attributes):
    for path, values in attributes.items():
        for name, value in values.items():
            write_attribute(file[path] if path in file else file.create_group(path), name, value)


def write_attribute(item, name, value):
    """Write one attribute; text and lists of text as UTF-8 of a fixed length."""
    import h5py

    if isinstance(value, str | list) and not isinstance(value, np.bytes_):
        encoded = np.char.encode(np.array(value, dtype=np.str_), "utf-8")
        item.attrs.create(name, encoded, dtype=h5py.string_dtype("utf-8", max(encoded.dtype.itemsize, 1)))
    else:
        item.attrs.create(name, value)
