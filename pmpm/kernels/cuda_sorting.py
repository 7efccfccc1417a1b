"""Loops of a regroup on graphics cards: homes, who leaves, the order by (layer, body, tile, cell), the move into new blocks.

Each lane of the blocks is a slot, 16 block + lane. A particle's key says where it belongs; slots without one, and particles
that leave, have the last key. Keys are sorted with the numbers of their slots by a radix sort, from the lowest digit on, which
is stable: a thread has ITEMS neighbouring slots. Particles that arrived are slots behind those of the blocks.

Home nodes of a layer lie in tiles of up to TILE nodes along both axes, so that a tile's particles can share one base node.
"""

import numpy as np
from numba import cuda

from pmpm.kernels.places import REACH
from pmpm.kernels.sorting import is_beyond, settled

integer, int32, int64 = float, np.int32, np.int64
DIMENSIONS, SLAB, MIDDLE, ROW = 2, 0, -1, 1
HALF, FRACTION = 0, 52
OPEN = False
THREADS = 128  # of a block of threads
ITEMS = 16  # slots of a thread when keys are sorted
BITS = 4  # of a digit
DIGITS = 1 << BITS
COUNTERS = DIGITS * THREADS
TILE = 2 * REACH + 1  # nodes


def tiling(middles, rows):
    """(cells of a tile, tiles of a layer, tiles along a row) of layers of so many home nodes along middle and row."""
    along = (rows + TILE - 1) // TILE
    return min(middles, TILE) * min(rows, TILE), (middles + TILE - 1) // TILE * along, along


def key_of(layer, body, middle, row, bodies, middles, rows):
    """The number of a home node's cell among all: by layer, body, tile, then cell of the tile. middles and rows: of a layer."""
    cells, tiles, along = tiling(middles, rows)
    tile = middle // TILE * along + row // TILE
    return ((layer * bodies + body) * tiles + tile) * cells + middle % TILE * min(rows, TILE) + row % TILE


def home_of(key, middles, rows):
    """(middle, row) of a key's home node."""
    cells, tiles, along = tiling(middles, rows)
    tile, cell, of_row = key // cells % tiles, key % cells, min(rows, TILE)
    return tile // along * TILE + cell // of_row, tile % along * TILE + cell % of_row


def find_homes(
    places, info, blocks, old_layer, first, last, nodes, periodic, cells, opened, bodies, nobody, keys, order, leaving, leavers,
    their_keys,
):  # fmt: skip
    """Key of each slot, counted from layer `first`; places count from home nodes afterwards. `leavers`: slots of those who do
    not go to layers first .. last - 1, in any order, with keys counted from layer 0; `leaving`: how many. Keys of those who are
    beyond an open face, `opened` two by two as `cells` of each array axis, are -1 less their own."""
    p = cuda.grid(1)
    block, lane = p >> 4, p & 15
    if block < blocks:
        order[p], keys[p] = p, nobody
        if lane < info[block, 4]:
            base_layer = int64(old_layer + info[block, 0])
            base_middle, base_row = int64(info[block, 2]), int64(info[block, 3])
            layer, place = settled(places[block, SLAB, lane], base_layer, HALF, FRACTION, nodes[0], periodic[0])
            places[block, SLAB, lane] = place
            middle = 0
            if DIMENSIONS == 3:
                middle, place = settled(places[block, MIDDLE, lane], base_middle, HALF, FRACTION, nodes[1], periodic[1])
                places[block, MIDDLE, lane] = place
            row, place = settled(places[block, ROW, lane], base_row, HALF, FRACTION, nodes[2], periodic[2])
            places[block, ROW, lane] = place
            body, beyond = info[block, 1], False
            if OPEN:
                beyond = is_beyond(layer + (places[block, SLAB, lane] >> FRACTION), cells[0], opened[0], opened[1])
                if DIMENSIONS == 3:
                    cell = middle + (places[block, MIDDLE, lane] >> FRACTION)
                    beyond = beyond or is_beyond(cell, cells[1], opened[2], opened[3])
                cell = row + (places[block, ROW, lane] >> FRACTION)
                beyond = beyond or is_beyond(cell, cells[2], opened[4], opened[5])
            if first <= layer < last and not beyond:
                keys[p] = key_of(layer - first, body, middle, row, bodies, nodes[1], nodes[2])
            else:
                n = cuda.atomic.add(leaving, 0, 1)
                leavers[n] = p
                key = key_of(layer, body, middle, row, bodies, nodes[1], nodes[2])
                their_keys[n] = -1 - key if beyond else key


def pack_leaving(places, ids, leavers, count, fields, rows, row_ids):
    """Copy the leavers into rows (count, fields)."""
    n = cuda.grid(1)
    if n < count:
        block, lane = leavers[n] >> 4, leavers[n] & 15
        row_ids[n] = ids[block, lane]
        for f in range(fields):
            rows[n, f] = places[block, f, lane]


# ---- sorting ---------------------------------------------------------------------------------------------------------------


def count_by_thread(keys, count, shift, thread, first, counts):
    """How many of a thread's items have each digit, into the thread's places of (DIGITS, THREADS) in shared memory."""
    for d in range(DIGITS):
        counts[d * THREADS + thread] = 0
    for k in range(first, min(first + ITEMS, count)):
        counts[((keys[k] >> shift) & (DIGITS - 1)) * THREADS + thread] += 1


def count_digits(keys, count, shift, counts):
    """How often each block of threads meets each digit, counts[digit x blocks + block]."""
    of_threads = cuda.shared.array(COUNTERS, int32)
    thread = cuda.threadIdx.x
    count_by_thread(keys, count, shift, thread, cuda.grid(1) * ITEMS, of_threads)
    cuda.syncthreads()
    if thread < DIGITS:
        total = 0
        for t in range(THREADS):
            total += of_threads[thread * THREADS + t]
        counts[thread * cuda.gridDim.x + cuda.blockIdx.x] = total


def move_by_digit(keys, order, count, shift, starts, new_keys, new_order):
    """Move keys and slots to where their digit's begin, see `count_digits`, of equal ones the earlier first."""
    nexts = cuda.shared.array(COUNTERS, int32)
    thread, first = cuda.threadIdx.x, cuda.grid(1) * ITEMS
    count_by_thread(keys, count, shift, thread, first, nexts)
    cuda.syncthreads()
    if thread < DIGITS:
        begin = starts[thread * cuda.gridDim.x + cuda.blockIdx.x]
        for t in range(THREADS):
            here = nexts[thread * THREADS + t]
            nexts[thread * THREADS + t] = begin
            begin += here
    cuda.syncthreads()
    for k in range(first, min(first + ITEMS, count)):
        d = ((keys[k] >> shift) & (DIGITS - 1)) * THREADS + thread
        new_keys[nexts[d]] = keys[k]
        new_order[nexts[d]] = order[k]
        nexts[d] += 1


def sum_tiles(values, count, totals):
    """Sums of what stands before each value in the tile of its block of threads, in place, and of each tile."""
    sums = cuda.shared.array(THREADS, int32)
    thread, first = cuda.threadIdx.x, cuda.grid(1) * ITEMS
    sums[thread] = 0
    for k in range(first, min(first + ITEMS, count)):
        sums[thread] += values[k]
    cuda.syncthreads()
    if thread == 0:
        total = 0
        for t in range(THREADS):
            here = sums[t]
            sums[t] = total
            total += here
        totals[cuda.blockIdx.x] = total
    cuda.syncthreads()
    total = sums[thread]
    for k in range(first, min(first + ITEMS, count)):
        here = values[k]
        values[k] = total
        total += here


def add_totals(values, count, totals):
    """Add to each value what stands before its tile."""
    first = cuda.grid(1) * ITEMS
    for k in range(first, min(first + ITEMS, count)):
        values[k] += totals[cuda.blockIdx.x]


def find_segments(keys, count, cells, nobody, found, firsts, first_keys):
    """Where a new layer, body or tile begins in sorted keys, in any order, and its key; `found`: how many."""
    k = cuda.grid(1)
    if k < count and keys[k] < nobody and (k == 0 or keys[k - 1] // cells != keys[k] // cells):
        n = cuda.atomic.add(found, 0, 1)
        firsts[n], first_keys[n] = k, keys[k]


# ---- into new blocks -------------------------------------------------------------------------------------------------------


def describe_blocks(segments, count, blocks, info):
    """info[block] = (layer, body, middle and row node of the base, particles, the first of them in the order) from segments
    (first block, particles, layer, body, base along middle, base along row, first in the order)."""
    block = cuda.grid(1)
    if block < blocks:
        low, high = 0, count
        while high - low > 1:
            half = (low + high) >> 1
            if segments[half, 0] <= block:
                low = half
            else:
                high = half
        behind = 16 * (block - segments[low, 0])
        for column in range(4):
            info[block, column] = segments[low, 2 + column]
        info[block, 4] = min(segments[low, 1] - behind, 16)
        info[block, 5] = segments[low, 6] + behind


def gather_fields(places, rows, old_blocks, order, keys, info, blocks, nodes, first_field, last_field, rest, taken):
    """Fields first_field .. last_field - 1 of the particles in their new order, taken as integers, with places from their new
    bases; lanes that fill up a block have `rest` at the place of its last particle."""
    p = cuda.grid(1)
    block, lane = p >> 4, p & 15
    if block < blocks:
        here = info[block, 4]
        k = info[block, 5] + min(lane, here - 1)
        slot = order[k]
        middle, row = home_of(keys[k], nodes[1], nodes[2])
        for f in range(first_field, last_field):
            value = places[slot >> 4, f, slot & 15] if slot < 16 * old_blocks else rows[slot - 16 * old_blocks, f]
            if f >= DIMENSIONS and lane >= here:
                value = rest[f]
            if f == MIDDLE:
                value += integer((middle - int64(info[block, 2])) << FRACTION)
            if f == ROW:
                value += integer((row - int64(info[block, 3])) << FRACTION)
            taken[f - first_field, p] = value


def put_fields(taken, blocks, first_field, last_field, places):
    """Write what `gather_fields` has taken."""
    p = cuda.grid(1)
    if p < 16 * blocks:
        for f in range(first_field, last_field):
            places[p >> 4, f, p & 15] = taken[f - first_field, p]


def gather_ids(ids, row_ids, old_blocks, order, info, blocks, taken):
    """Ids of the particles in their new order; of lanes that fill up a block -1."""
    p = cuda.grid(1)
    block, lane = p >> 4, p & 15
    if block < blocks:
        taken[p] = -1
        if lane < info[block, 4]:
            slot = order[info[block, 5] + lane]
            taken[p] = ids[slot >> 4, slot & 15] if slot < 16 * old_blocks else row_ids[slot - 16 * old_blocks]


def put_ids(taken, blocks, ids):
    """Write what `gather_ids` has taken."""
    p = cuda.grid(1)
    if p < 16 * blocks:
        ids[p >> 4, p & 15] = taken[p]
