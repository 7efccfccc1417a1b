"""The particles of one law on one rank: blocks of 16 for the kernels, plain rows for those that travel.

A `Population` is ordered by (layer, table row, cell) and lies in segments of blocks, see kernels.loops. A `Cloud` is rows in
any order. `assemble` makes the one from what stayed and what arrived. `Ordered` is rows in order, with what it takes to make
the very same Population of them again, on any ranks.
"""

from dataclasses import dataclass

import numpy as np

from pmpm.kernels.places import FORMATS
from pmpm.kernels.sorting import SEGMENT_COLUMNS

LANES = 16
GROUP = 1 << 16  # particles whose layers are handled together, if layers have no more: a few MB of numbers beside them
GROUP_BYTES = 1 << 21  # of rows that are made at a time: about what a core's own cache holds


@dataclass
class Ordered:
    """A law's particles as rows in their order: reals (n, size), the places as integers from the base nodes of the segments;
    id (n,) int64; segments (m, 5) int64, each (layer, particles, table row, base along middle, base along row)."""

    reals: np.ndarray
    id: np.ndarray
    segments: np.ndarray

    def __len__(self):
        return len(self.id)

    @property
    def places(self):
        """(n, size) the same memory as integers."""
        return self.reals.view(FORMATS[self.reals.dtype].integer)

    def bases(self, axes):
        """(n, dim) int64 base node of each particle."""
        return np.repeat(segment_bases(self.segments[:, 0], self.segments, axes), self.segments[:, 1], axis=0)


def segment_bases(layer, segments, axes):
    """(m, dim) base node of each segment, from its layer."""
    columns = {axes[0]: layer} | {axis: segments[:, k] for k, axis in ((3, axes[1]), (4, axes[2])) if axis >= 0}
    return np.stack([columns[axis] for axis in sorted(columns)], axis=-1)


@dataclass
class Cloud:
    """Particles as rows: reals (n, size) whose first dim numbers are places, as integers, from the home node; node (n, dim)
    int32 home node per physical axis, row (n,) int32, id (n,) int64."""

    reals: np.ndarray
    node: np.ndarray
    row: np.ndarray
    id: np.ndarray

    @classmethod
    def room(cls, count, size, dim, real):
        """Room for so many particles."""
        return cls(
            np.empty((count, size), real), np.empty((count, dim), np.int32), np.empty(count, np.int32),
            np.empty(count, np.int64),
        )  # fmt: skip

    def __len__(self):
        return len(self.id)

    @property
    def places(self):
        """(n, size) the same memory as integers."""
        return self.reals.view(FORMATS[self.reals.dtype].integer)

    @staticmethod
    def row_bytes(size, dim, real):
        """Bytes of a particle in a message."""
        return size * np.dtype(real).itemsize + 4 * dim + 4 + 8

    @staticmethod
    def join(clouds):
        return Cloud(*(np.concatenate(parts) for parts in zip(*(cloud.parts for cloud in clouds), strict=True)))

    def take(self, index):
        return Cloud(self.reals[index], self.node[index], self.row[index], self.id[index])

    def rows(self, first, last):
        """Some that lie together: the same memory."""
        return self.take(slice(first, last))

    @property
    def parts(self):
        """The arrays that it is made of."""
        return self.reals, self.node, self.row, self.id


@dataclass
class Population:
    """One law's particles in blocks. Arrays the kernels take: reals (blocks, size, 16), segments (segments, 5) int64,
    layer_start (layers + 1,) int64 first segment of each layer of this rank; and id (blocks, 16) int64."""

    reals: np.ndarray
    id: np.ndarray
    segments: np.ndarray
    layer_start: np.ndarray
    first_layer: int

    @classmethod
    def empty(cls, size, layers, first_layer, real):
        return cls(
            np.zeros((0, size, LANES), real),
            np.zeros((0, LANES), np.int64),
            np.zeros((0, SEGMENT_COLUMNS), np.int64),
            np.zeros(layers + 1, np.int64),
            first_layer,
        )

    def __len__(self):
        return int(self.segments[:, 1].sum())

    @property
    def places(self):
        """(blocks, size, 16) the same memory as integers, which the first fields are."""
        return self.reals.view(FORMATS[self.reals.dtype].integer)

    @property
    def nbytes(self):
        return self.reals.nbytes + self.id.nbytes + self.segments.nbytes + self.layer_start.nbytes

    @property
    def block_segment(self):
        """(blocks,) the segment of each block."""
        return np.repeat(np.arange(len(self.segments)), -(-self.segments[:, 1] // LANES))

    @property
    def block_row(self):
        """(blocks,) the table row of each block."""
        return self.segments[self.block_segment, 2]

    @property
    def block_count(self):
        """(blocks,) how many lanes hold a particle."""
        segment = self.block_segment
        behind = LANES * (np.arange(len(segment)) - self.segments[segment, 0])
        return np.minimum(self.segments[segment, 1] - behind, LANES)

    @property
    def lanes(self):
        """(blocks, 16) bool: lanes that hold a particle."""
        return np.arange(LANES) < self.block_count[:, None]

    @property
    def block_layer(self):
        """(blocks,) global layer of each block."""
        return self.segment_layer[self.block_segment]

    def rows(self, fields):
        """(n, k) the reals `fields` (a slice) of every particle, in the one global order of this law."""
        return self.reals[:, fields].transpose(0, 2, 1)[self.lanes]

    @property
    def segment_layer(self):
        """(segments,) global layer of each segment."""
        return self.first_layer + np.repeat(np.arange(len(self.layer_start) - 1), np.diff(self.layer_start))

    def part(self, first, last):
        """The particles of layers first .. last - 1, counted as in the one global order: the same memory."""
        begin, end = (int(self.layer_start[layer - self.first_layer]) for layer in (first, last))
        starts = np.append(self.segments[:, 0], len(self.reals))
        blocks, segments = slice(starts[begin], starts[end]), self.segments[begin:end].copy()
        segments[:, 0] -= starts[begin]
        layers = self.layer_start[first - self.first_layer : last - self.first_layer + 1] - begin
        return Population(self.reals[blocks], self.id[blocks], segments, layers, first)

    @property
    def layer_counts(self):
        """(layers,) how many particles lie in each layer of this rank."""
        below = np.concatenate([[0], np.cumsum(self.segments[:, 1])])
        return np.diff(below[self.layer_start])

    def copy(self):
        return Population(
            self.reals.copy(), self.id.copy(), self.segments.copy(), self.layer_start.copy(), self.first_layer
        )

    def groups(self, row_bytes):
        """(segments, particles) of consecutive groups of segments, slices: a group's rows of so many bytes fit into a cache."""
        last_row = np.cumsum(self.segments[:, 1])
        first = first_row = 0
        while first < len(self.segments):
            last = max(first + 1, int(np.searchsorted(last_row, first_row + GROUP_BYTES // row_bytes, side="right")))
            yield slice(first, last), int(last_row[last - 1]) - first_row
            first, first_row = last, int(last_row[last - 1])

    def unpacked(self, kernels, fields, columns=None):
        """Yield `rows` of some fields (a slice), by a kernel and group by group, with zeros beside them up to `columns`."""
        count = fields.stop - fields.start
        for segments, particles in self.groups((columns or count) * self.reals.itemsize):
            rows = (np.zeros if columns else np.empty)((particles, columns or count), self.reals.dtype)
            kernels.take_rows(self.places, self.segments[segments], fields.start, count, rows.view(self.places.dtype))
            yield rows

    def ids(self, kernels):
        """Yield ids (n,), in order, group by group."""
        blocks = self.id.reshape(len(self.id), 1, LANES)
        for segments, particles in self.groups(8):
            rows = np.empty((particles, 1), np.int64)
            kernels.take_rows(blocks, self.segments[segments], 0, 1, rows)
            yield rows[:, 0]

    def points(self, kernels, axes, cell_size):
        """Yield positions (n, 3) in m, in the precision of the reals, group by group."""
        form, layer = FORMATS[self.reals.dtype], self.segment_layer
        for segments, particles in self.groups(3 * self.reals.itemsize):
            x = np.zeros((particles, 3), self.reals.dtype)
            kernels.take_positions(
                self.places, self.segments[segments], layer[segments], np.array(axes), form.fraction, form.unit,
                cell_size, x,
            )  # fmt: skip
            yield x

    def of_table_rows(self, values):
        """Yield what an array over table rows holds for each particle (n,), group by group."""
        for segments, _ in self.groups(values.itemsize):
            yield np.repeat(values[self.segments[segments, 2]], self.segments[segments, 1])

    def segment_table(self):
        """(segments, 5) as `Ordered` has them."""
        return np.concatenate([self.segment_layer[:, None], self.segments[:, 1:]], axis=1)

    @classmethod
    def of_ordered(cls, ordered, first_layer, layers, rest, dim):
        """The Population that gave these rows by `ordered`, in layers of a rank. `rest` as for `assemble`."""
        segments = ordered.segments.copy()
        counts = segments[:, 1]
        blocks = -(-counts // LANES)
        segments[:, 0] = np.cumsum(blocks) - blocks
        first_row, of_block = np.cumsum(counts) - counts, np.repeat(np.arange(len(segments)), blocks)
        in_segment = LANES * (np.arange(len(of_block)) - segments[of_block, 0])[:, None] + np.arange(LANES)
        fills = in_segment >= counts[of_block, None]
        source = first_row[of_block, None] + np.minimum(in_segment, counts[of_block, None] - 1)
        reals = np.ascontiguousarray(ordered.reals[source].transpose(0, 2, 1))
        ids = np.where(fills, -1, ordered.id[source])
        block, lane = np.nonzero(fills)
        reals[block, dim:, lane] = rest[dim:]
        layer_start = np.searchsorted(ordered.segments[:, 0] - first_layer, np.arange(layers + 1))
        return cls(reals, ids, segments, layer_start, first_layer)

    def set_rows(self, fields, values):
        """Write back what `rows` gave."""
        block, lane = np.nonzero(self.lanes)
        self.reals[block, fields, lane] = values

    def per_particle(self, per_block):
        """(n, ...) a per-block array, repeated for the particles of each block."""
        return np.repeat(per_block, self.block_count, axis=0)

    def cells(self, axes):
        """(node, part): per particle and physical axis the node below and the part of a cell from it, int64 and float64."""
        dim = 2 if axes[1] < 0 else 3
        bases = segment_bases(self.segment_layer, self.segments, axes)[self.block_segment]
        place = self.places[:, :dim].transpose(0, 2, 1)[self.lanes].astype(np.int64)
        return FORMATS[self.reals.dtype].split(self.per_particle(bases), place)

    def at(self, node, place):
        """The particles as a Cloud, in order, at other places (n, dim) from these nodes (n, dim)."""
        cloud = Cloud(
            self.rows(slice(None)),
            node.astype(np.int32),
            self.per_particle(self.block_row).astype(np.int32),
            self.id[self.lanes],
        )
        cloud.places[:, : node.shape[1]] = place
        return cloud


def layer_groups(counts, first_layer):
    """(first, last + 1) of consecutive layers of about GROUP particles, whole layers each; at least one group.

    counts: (layers,) from `first_layer` on.
    """
    below, first = np.concatenate([[0], np.cumsum(counts)]), 0
    while first < len(counts):
        last = max(first + 1, int(np.searchsorted(below, below[first] + GROUP, side="right")) - 1)
        yield first_layer + first, first_layer + last
        first = last
    if not len(counts):
        yield first_layer, first_layer
