"""The particles of one law on a graphics card, and their regroup there: who leaves, a sort, the move into new blocks.

The host keeps of them what says where they are, a Population whose numbers nobody has written yet, and the card what they are.
"""

from typing import Any

import numpy as np

from pmpm.kernels.cuda_sorting import BITS, DIGITS, ITEMS, TILE, home_of, key_of, tiling
from pmpm.kernels.places import FORMATS
from pmpm.kernels.sorting import SEGMENT_COLUMNS
from pmpm.scene.needs import open_faces
from pmpm.state.memory import room
from pmpm.state.particles import LANES, Cloud, Population

AT_A_TIME = 4  # fields that are moved into new blocks
INFO = 6  # numbers that kernels know of a block
SPARE = 1 / 16  # of the blocks
ROOM = 4096  # slots for those who come, besides an eighth of those there are


class OnCard:
    """reals (blocks, size, 16), places, the same memory as integers, id (blocks, 16), info (blocks, 6) int32; see
    cuda_sorting.describe_blocks. There is room for more blocks than are in use."""

    def __init__(self, processor, law):
        simulation = processor.simulation
        self.processor, self.memory, self.law = processor, processor.memory, law
        self.kernels = processor.on_card.sorting
        self.real, self.size = np.dtype(simulation.real), simulation.layouts[law].size
        self.form, self.bodies, self.dim = FORMATS[self.real], len(simulation.scene.sources), simulation.dim
        geometry = simulation.geometry
        self.axes = geometry.axes
        self.nodes = tuple(geometry.homes(axis) if axis >= 0 else 1 for axis in self.axes)
        self.periodic = tuple(int(axis >= 0 and geometry.periodic[axis]) for axis in self.axes)
        self.cell_counts = tuple(geometry.cells[axis] if axis >= 0 else 1 for axis in self.axes)
        opened = open_faces(simulation.scene)
        self.opened = tuple(bool(axis >= 0 and opened[axis, end]) for axis in self.axes for end in (0, 1))
        self.driven = simulation.needs.driven
        rest = np.ascontiguousarray(simulation.pad_values(simulation.layouts[law]))
        self.rest = processor.card.to_device(rest.view(self.form.integer))
        self.cells, self.tiles, self.tiles_of_row = tiling(*self.nodes[1:])
        self.blocks, self.capacity = 0, -1
        self.population: Any = None  # until the first is taken

    def take(self, population):
        """Hold the particles of a Population."""
        blocks = len(population.reals)
        self.make_room(blocks)
        if blocks:
            self.processor.send(population.reals, self.reals[:blocks])
            self.processor.send(population.id, self.id[:blocks])
        self.describe(population)
        self.ids_are_known = True

    def give(self):
        """Write them to the Population."""
        if self.blocks:
            self.processor.bring(self.reals[: self.blocks], self.population.reals)
            if not self.ids_are_known:
                self.processor.bring(self.id[: self.blocks], self.population.id)
        self.ids_are_known = True

    def make_room(self, blocks):
        """Have room for so many blocks; what was there is lost if there was less."""
        if blocks <= self.capacity:
            return
        self.capacity = blocks + int(SPARE * blocks) + 1
        card, shape = self.processor.card, (self.capacity, self.size, LANES)
        self.reals = card.device_array(shape, self.real)
        self.places = as_integers(self.reals, self.form)
        self.id = card.device_array((self.capacity, LANES), np.int64)
        self.info = card.device_array((self.capacity, INFO), np.int32)

    def describe(self, population):
        """Tell the card which blocks hold what, by the segments of a Population."""
        segments = population.segments
        self.population, self.blocks = population, len(population.reals)
        starts = np.append(segments[:, 0], self.blocks)
        self.layer_blocks = starts[population.layer_start]
        self.layers = len(population.layer_start) - 1
        below = np.cumsum(segments[:, 1]) - segments[:, 1]
        layer = population.segment_layer - population.first_layer
        columns = [segments[:, :2], layer[:, None], segments[:, 2:], below[:, None]]
        told = self.memory.array("segments", (max(len(segments), 1), SEGMENT_COLUMNS + 2), np.int32)
        if len(segments):
            self.processor.send(np.ascontiguousarray(np.concatenate(columns, axis=1), np.int32), told)
        self.launch("describe_blocks", self.blocks, told, len(segments), self.blocks, self.info)
        works = self.blocks if self.driven else 0
        self.works = self.memory.array(("works", self.law), (works + 1,), self.real)  # J, by block

    @property
    def lanes(self):
        return LANES * self.blocks

    def blocks_of(self, layers):
        """(first, last + 1) blocks of a range of layers."""
        first, last = layers
        return int(self.layer_blocks[first]), int(self.layer_blocks[last])

    def by_layer(self, of_blocks):
        """(layers, ...) float64 sums of what each block has."""
        found, held = np.zeros((self.layers, *of_blocks.shape[1:])), np.diff(self.layer_blocks) > 0
        if held.any():
            found[held] = np.add.reduceat(of_blocks[: self.blocks].astype(np.float64), self.layer_blocks[:-1][held])
        return found

    def launch(self, name, count, *arguments):
        self.processor.launch(self.kernels[name], count, *arguments)

    # ---- a regroup ----

    def take_leaving(self, first, last):
        """The Cloud of those who do not go to layers first .. last - 1, ordered by where they go. `settle_in` follows.
        `gone` has those who have left through open faces."""
        slots = self.lanes
        self.first, self.last = first, last
        self.nobody = (last - first) * self.bodies * self.tiles * self.cells
        room = slots + slots // 8 + ROOM  # for those who come
        self.keys = self.memory.array(("keys", self.law), (room,), np.int64)
        self.order = self.memory.array(("order", self.law), (room,), np.int32)
        their_keys, leavers = self.others(slots)
        counter = self.processor.counter()
        self.launch(
            "find_homes", slots, self.places, self.info, self.blocks, self.population.first_layer, first, last, self.nodes,
            self.periodic, self.cell_counts, self.opened, self.bodies, self.nobody, self.keys, self.order, counter, leavers,
            their_keys,
        )  # fmt: skip
        count = self.processor.count_of(counter)
        rows = self.memory.array("rows", (count + 1, self.size), self.form.integer)
        ids = self.memory.array("row ids", (count + 1,), np.int64)
        self.launch("pack_leaving", count, self.places, self.id, leavers, count, self.size, rows, ids)
        self.staying = len(self.population) - count
        return self.cloud(count, rows, ids, their_keys)

    def others(self, count):
        """Other arrays (keys, order) for so many slots, of use to one law at a time."""
        return (
            self.memory.array("other keys", (count + 1,), np.int64),
            self.memory.array("other order", (count + 1,), np.int32),
        )

    def cloud(self, count, rows, ids, keys):
        """A Cloud of what has been packed, ordered by key and id."""
        found, key = Cloud.room(count, self.size, self.dim, self.real), np.empty(count, np.int64)
        self.gone = found
        if not count:
            return found
        for there, here in ((rows, found.places), (ids, found.id), (keys, key)):
            self.processor.bring(there[:count], here)
        beyond, key = key < 0, np.where(key < 0, -1 - key, key)
        middle, row = home_of(key, *self.nodes[1:])
        layer = key // self.cells // (self.tiles * self.bodies)
        for axis, home in zip(self.axes, (layer, middle, row), strict=True):
            if axis >= 0:
                found.node[:, axis] = home
        found.row[:] = key // self.cells // self.tiles % self.bodies
        in_order = np.lexsort((found.id, key))
        self.gone = found.take(in_order[beyond[in_order]])
        return found.take(in_order[~beyond[in_order]])

    def settle_in(self, cloud):
        """Order those who stay and those of a Cloud, all of whom go to the layers that `take_leaving` was told."""
        old, coming = self.lanes, len(cloud)
        slots, particles = old + coming, self.staying + coming
        rows = self.memory.array("rows", (coming + 1, self.size), self.form.integer)
        ids = self.memory.array("row ids", (coming + 1,), np.int64)
        self.make_longer(slots)
        if coming:
            homes = [cloud.node[:, axis].astype(np.int64) if axis >= 0 else 0 for axis in self.axes]
            layer, middle, row = homes
            keys = key_of(layer - self.first, cloud.row, middle, row, self.bodies, *self.nodes[1:])
            slot = old + np.arange(coming, dtype=np.int32)
            told = (cloud.places, rows), (cloud.id, ids), (keys + 0 * slot, self.keys[old:]), (slot, self.order[old:])
            for here, there in told:
                self.processor.send(np.ascontiguousarray(here), there[:coming])
        keys, order, *spare = self.sort(slots)
        segments, layer_start = self.segments_of(keys, slots, particles, *spare)
        blocks = int((-(-segments[:, 1] // LANES)).sum())
        places, old_id, old_blocks = self.places, self.id, self.blocks  # kept until all is moved
        self.make_room(blocks)
        self.describe(Population(
            room(blocks, (self.size, LANES), self.real), room(blocks, (LANES,), np.int64), segments, layer_start, self.first
        ))  # fmt: skip
        taken = self.memory.array("taken", (AT_A_TIME, self.lanes + 1), self.form.integer)
        for first in range(0, self.size, AT_A_TIME):
            last = min(first + AT_A_TIME, self.size)
            self.launch(
                "gather_fields", self.lanes, places, rows, old_blocks, order, keys, self.info, blocks, self.nodes, first, last,
                self.rest, taken,
            )  # fmt: skip
            self.launch("put_fields", self.lanes, taken, blocks, first, last, self.places)
        taken = spare[0] if len(spare[0]) >= self.lanes else self.memory.array("taken ids", (self.lanes,), np.int64)
        self.launch("gather_ids", self.lanes, old_id, ids, old_blocks, order, self.info, blocks, taken)
        self.launch("put_ids", self.lanes, taken, blocks, self.id)
        self.ids_are_known = False
        return self.population

    def make_longer(self, slots):
        """Keys and order for so many slots, with what they hold."""
        if slots > len(self.keys):
            for name in ("keys", "order"):
                old = getattr(self, name)
                new = self.processor.card.device_array(slots + ROOM, old.dtype)
                new[: len(old)].copy_to_device(old, stream=self.processor.stream)
                setattr(self, name, new)

    def sort(self, slots):
        """(keys, order) sorted, and two arrays as long as these that are of no use any more."""
        keys, order, (other_keys, other_order) = self.keys, self.order, self.others(slots)
        threads = -(-slots // ITEMS)
        tiles = -(-threads // self.processor.on_card.threads)
        counts = self.memory.array("digits", (DIGITS * tiles + 1,), np.int32)
        for shift in range(0, max(int(self.nobody).bit_length(), 1), BITS):
            self.launch("count_digits", threads, keys, slots, shift, counts)
            self.sum_before(counts, DIGITS * tiles)
            self.launch("move_by_digit", threads, keys, order, slots, shift, counts, other_keys, other_order)
            keys, order, other_keys, other_order = other_keys, other_order, keys, order
        return keys, order, other_keys, other_order

    def sum_before(self, values, count, level=0):
        """In place of each value the sum of those before it."""
        threads = -(-count // ITEMS)
        tiles = -(-threads // self.processor.on_card.threads)
        totals = self.memory.array(("totals", level), (tiles + 1,), np.int32)
        self.launch("sum_tiles", threads, values, count, totals)
        if tiles > 1:
            self.sum_before(totals, tiles, level + 1)
        self.launch("add_totals", threads if tiles > 1 else 0, values, count, totals)

    def segments_of(self, keys, slots, particles, first_keys, firsts):
        """(segments, layer_start) of a Population from sorted keys, with room for as many numbers as slots."""
        counter = self.processor.counter()
        self.launch("find_segments", slots, keys, slots, self.cells, self.nobody, counter, firsts, first_keys)
        count = self.processor.count_of(counter)
        first, key = np.zeros(count, np.int32), np.zeros(count, np.int64)
        if count:
            self.processor.bring(firsts[:count], first)
            self.processor.bring(first_keys[:count], key)
        by_place = np.argsort(first)
        prefix, sizes = key[by_place] // self.cells, np.diff(np.append(first[by_place], particles))
        layer, body, tile = (
            prefix // (self.tiles * self.bodies),
            prefix // self.tiles % self.bodies,
            prefix % self.tiles,
        )
        blocks = -(-sizes // LANES)
        _, middles, rows = self.nodes
        bases = base_of(tile // self.tiles_of_row, middles), base_of(tile % self.tiles_of_row, rows)
        segments = np.stack([np.cumsum(blocks) - blocks, sizes, body, *bases], axis=1).astype(np.int64)
        return segments, np.searchsorted(layer, np.arange(self.last - self.first + 1))


def base_of(tile, nodes):
    """The base node of a tile: no home node is farther from it than REACH."""
    return tile * TILE + np.minimum(TILE, nodes - tile * TILE) // 2


def as_integers(reals, form):
    """The same memory as integers."""
    if hasattr(reals, "_ary"):  # simulated: a view would be an array of the host, which kernels are given copies of
        return type(reals)(reals._ary.view(form.integer))
    return reals.view(form.integer)
