"""The particles of one law on one rank: blocks of 16 for the kernels, plain rows for regrouping and output.

A `Cloud` is rows in any order; a `Population` is the same particles ordered by (layer, table row, cell), in blocks that hold
one layer and one table row each, padded at their end.
"""

from dataclasses import dataclass

import numpy as np

LANES = 16


@dataclass
class Cloud:
    """Particles as rows: reals (n, size), node (n, dim) int32 home node per physical axis, row (n,) int32, id (n,) int64."""

    reals: np.ndarray
    node: np.ndarray
    row: np.ndarray
    id: np.ndarray

    @classmethod
    def empty(cls, size, dim, real):
        return cls(
            np.zeros((0, size), real), np.zeros((0, dim), np.int32), np.zeros(0, np.int32), np.zeros(0, np.int64)
        )

    def __len__(self):
        return len(self.id)

    def take(self, index):
        return Cloud(self.reals[index], self.node[index], self.row[index], self.id[index])

    @staticmethod
    def join(clouds):
        return Cloud(*(np.concatenate([getattr(c, name) for c in clouds]) for name in ("reals", "node", "row", "id")))

    def to_bytes(self):
        return b"".join(np.ascontiguousarray(a).tobytes() for a in (self.reals, self.node, self.row, self.id))

    @classmethod
    def from_bytes(cls, data, count, size, dim, real):
        """The inverse of `to_bytes` for `count` particles."""
        parts, first = [], 0
        for dtype, width in ((real, size), (np.int32, dim), (np.int32, 1), (np.int64, 1)):
            length = count * width * np.dtype(dtype).itemsize
            parts.append(np.frombuffer(data[first : first + length].tobytes(), dtype).reshape(count, width))
            first += length
        return cls(parts[0], parts[1], parts[2][:, 0], parts[3][:, 0])


@dataclass
class Population:
    """One law's particles in blocks. Arrays the kernels take: reals (blocks, size, 16), home (blocks, 16) int32 packed
    place of the home node in its plane, id (blocks, 16) int64, block_row, block_count (blocks,) int32, layer_start
    (layers + 1,) int64 first block of each layer of this rank."""

    reals: np.ndarray
    home: np.ndarray
    id: np.ndarray
    block_row: np.ndarray
    block_count: np.ndarray
    layer_start: np.ndarray
    first_layer: int

    @classmethod
    def pack(cls, cloud, axes, first_layer, layers, rest):
        """Order a cloud and lay it in blocks; `rest` fills the pad lanes. Stable with respect to the order before."""
        slab, middle, row_axis = axes
        layer = cloud.node[:, slab].astype(np.int64) - first_layer
        home = cloud.node[:, row_axis].astype(np.int64)
        if middle >= 0:
            home = home | (cloud.node[:, middle].astype(np.int64) << 16)
        order = np.lexsort((home, cloud.row, layer))
        layer, home, row = layer[order], home[order], cloud.row[order]
        count = len(order)

        begins = np.ones(count, bool)
        begins[1:] = (layer[1:] != layer[:-1]) | (row[1:] != row[:-1])
        group_first = np.flatnonzero(begins)
        group_size = np.diff(np.append(group_first, count))
        group_blocks = -(-group_size // LANES)
        group_block = np.concatenate([[0], np.cumsum(group_blocks)])
        blocks = int(group_block[-1])
        within = np.arange(count) - np.repeat(group_first, group_size)
        place = np.repeat(group_block[:-1], group_size) * LANES + within
        block, lane = place // LANES, place % LANES

        reals = np.empty((blocks, cloud.reals.shape[1], LANES), cloud.reals.dtype)
        reals[:] = rest[:, None]
        reals[block, :, lane] = cloud.reals[order]
        homes = np.zeros((blocks, LANES), np.int32)
        homes[block, lane] = home
        ids = np.full((blocks, LANES), -1, np.int64)
        ids[block, lane] = cloud.id[order]
        block_count = np.bincount(block, minlength=blocks).astype(np.int32)
        block_row, block_layer = np.zeros(blocks, np.int32), np.zeros(blocks, np.int64)
        block_row[block], block_layer[block] = row, layer
        layer_start = np.searchsorted(block_layer, np.arange(layers + 1)).astype(np.int64)
        return cls(reals, homes, ids, block_row, block_count, layer_start, first_layer)

    def __len__(self):
        return int(self.block_count.sum())

    @property
    def lanes(self):
        """(blocks, 16) bool: lanes that hold a particle."""
        return np.arange(LANES) < self.block_count[:, None]

    @property
    def block_layer(self):
        """(blocks,) global layer of each block."""
        return self.first_layer + np.repeat(np.arange(len(self.layer_start) - 1), np.diff(self.layer_start))

    def rows(self, fields):
        """(n, k) the reals `fields` (a slice) of every particle, in the one global order of this law."""
        return self.reals[:, fields].transpose(0, 2, 1)[self.lanes]

    def set_rows(self, fields, values):
        """Write back what `rows` gave."""
        block, lane = np.nonzero(self.lanes)
        self.reals[block, fields, lane] = values

    def per_particle(self, per_block):
        """(n,) a per-block array, repeated for the particles of each block."""
        return np.repeat(per_block, self.block_count)

    def unpack(self, axes):
        """The particles as a Cloud, in order."""
        slab, middle, row_axis = axes
        lanes = self.lanes
        home = self.home[lanes]
        node = np.empty((len(home), 2 if middle < 0 else 3), np.int32)
        node[:, slab] = self.per_particle(self.block_layer)
        node[:, row_axis] = home if middle < 0 else home & 0xFFFF
        if middle >= 0:
            node[:, middle] = home >> 16
        return Cloud(self.rows(slice(None)), node, self.per_particle(self.block_row), self.id[lanes])
