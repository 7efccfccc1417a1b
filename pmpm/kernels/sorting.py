"""Loops of a regroup: who leaves, homes, the order by (layer, body, cell), segments, and the move into new blocks.

A regroup goes through the layers in groups, so that what it notes of each particle is of one group alone. Those candidates
stand in the order of the particles, `homes[axis]` too; `source[n]` is where candidate n comes from: a lane (16 block + lane)
of the blocks it lay in, or -1 - k for row k of those that arrived from elsewhere. A candidate that leaves has home NOWHERE.
"""

import numpy as np

from pmpm.kernels.lanes import gather, prefetch, store
from pmpm.kernels.places import NEAR, REACH

SEGMENT_COLUMNS = 5
AHEAD = 48  # particles
NOWHERE = -1  # a layer that no group has


def stays(home, layer, first, last):
    """Whether a particle goes from its layer to a near one among first .. last - 1."""
    return first <= home < last and abs(home - layer) <= NEAR


def settled(place, base, half, fraction, nodes, periodic):
    """(home node 0 .. nodes - 1, place from there) of a place from a base node.

    Exact: places change by whole cells. What is a little beyond a wall has the outermost home: up to a cell from the middle of
    its layer (cubic), but it cannot drift further out, for half a cell beyond a wall the run stops.
    """
    steps = (place + half) >> fraction
    if periodic:
        return (base + steps) % nodes, place - (steps << fraction)
    home = max(0, min(nodes - 1, base + steps))
    return home, place - ((home - base) << fraction)


def is_beyond(cell, cells, open_low, open_high):
    """Whether a particle in this cell of an axis with so many has left through an open face."""
    return (open_low and cell < 0) or (open_high and cell >= cells)


def lies_beyond(places, block, lane, layer, middle, row, fraction, axes, cells, opened):
    """The same of a lane of a block, along all axes; layer, middle, row: its base node. opened: (dim, 2)."""
    beyond = False
    for array_axis in range(3):
        axis = axes[array_axis]
        if axis >= 0:
            base = layer if array_axis == 0 else (middle if array_axis == 1 else row)
            cell = base + (int(places[block, axis, lane]) >> fraction)
            beyond = beyond or is_beyond(cell, cells[axis], opened[axis, 0], opened[axis, 1])
    return beyond


def count_beyond(places, segments, layer_start, first_layer, fraction, axes, cells, opened):
    """How many have left through open faces: cells (dim,) of each axis, opened (dim, 2) which of its faces are open."""
    count = 0
    for layer in range(layer_start.shape[0] - 1):
        for s in range(layer_start[layer], layer_start[layer + 1]):
            middle, row = segments[s, 3], segments[s, 4]
            for n in range(segments[s, 1]):
                block, lane = segments[s, 0] + (n >> 4), n & 15
                count += lies_beyond(
                    places, block, lane, first_layer + layer, middle, row, fraction, axes, cells, opened
                )
    return count


def take_beyond(
    places, ids, segments, layer_start, first_layer, fraction, axes, cells, opened, rows, node, bodies, row_ids
):  # fmt: skip
    """Move all who have left, in order, into rows (n, fields) with places from nodes (n, dim).

    Their segments close up, each in its first blocks; blocks may be left over until particles are ordered anew.
    """
    gone = 0
    for layer in range(layer_start.shape[0] - 1):
        for s in range(layer_start[layer], layer_start[layer + 1]):
            first, middle, row, kept = segments[s, 0], segments[s, 3], segments[s, 4], 0
            for n in range(segments[s, 1]):
                block, lane = first + (n >> 4), n & 15
                if lies_beyond(places, block, lane, first_layer + layer, middle, row, fraction, axes, cells, opened):
                    for f in range(places.shape[1]):
                        rows[gone, f] = places[block, f, lane]
                    for array_axis in range(3):
                        if axes[array_axis] >= 0:
                            base = first_layer + layer if array_axis == 0 else segments[s, 2 + array_axis]
                            node[gone, axes[array_axis]] = base
                    bodies[gone], row_ids[gone] = segments[s, 2], ids[block, lane]
                    gone += 1
                else:
                    if kept < n:
                        to_block, to_lane = first + (kept >> 4), kept & 15
                        for f in range(places.shape[1]):
                            places[to_block, f, to_lane] = places[block, f, lane]
                        ids[to_block, to_lane] = ids[block, lane]
                    kept += 1
            segments[s, 1] = kept


def count_moves(
    places, segments, layer_start, first_layer, first, last, half, fraction, slab, nodes, periodic, staying, leaving
):  # fmt: skip
    """Count who will stay in each layer first .. last - 1, and who leaves each layer there is now; see `stays`."""
    for layer in range(layer_start.shape[0] - 1):
        base = first_layer + layer
        inner = first < base < last - 1  # both neighbours are there, and this rank's
        for s in range(layer_start[layer], layer_start[layer + 1]):
            block, left = segments[s, 0], segments[s, 1]
            while left > 0:
                count = min(left, 16)
                lower = higher = far = 0
                for k in range(count):
                    steps = (places[block, slab, k] + half) >> fraction
                    lower += steps < 0
                    higher += steps > 0
                    far += abs(steps) > 1
                if far == 0 and inner:
                    staying[base - 1 - first] += lower
                    staying[base - first] += count - lower - higher
                    staying[base + 1 - first] += higher
                else:
                    for k in range(count):
                        home, _ = settled(places[block, slab, k], base, half, fraction, nodes, periodic)
                        if stays(home, base, first, last):
                            staying[home - first] += 1
                        else:
                            leaving[layer] += 1
                left -= 16
                block += 1


def take_leaving(
    places, ids, segments, layer_start, first_layer, first, last, half, fraction, axes, nodes, periodic, leaving, rows, node,
    bodies, row_ids,
):  # fmt: skip
    """Copy all who leave, in order, into rows (n, fields) with places from their home nodes (n, dim)."""
    n = 0
    for layer in range(layer_start.shape[0] - 1):
        if leaving[layer] == 0:
            continue
        for s in range(layer_start[layer], layer_start[layer + 1]):
            block, left = segments[s, 0], segments[s, 1]
            while left > 0:
                for k in range(min(left, 16)):
                    base, slab = first_layer + layer, axes[0]
                    home, _ = settled(places[block, slab, k], base, half, fraction, nodes[slab], periodic[slab])
                    if stays(home, base, first, last):
                        continue
                    for f in range(places.shape[1]):
                        rows[n, f] = places[block, f, k]
                    for array_axis in range(3):
                        axis = axes[array_axis]
                        if axis >= 0:
                            base = first_layer + layer if array_axis == 0 else segments[s, 2 + array_axis]
                            node[n, axis], rows[n, axis] = settled(
                                places[block, axis, k], base, half, fraction, nodes[axis], periodic[axis]
                            )
                    bodies[n], row_ids[n] = segments[s, 2], ids[block, k]
                    n += 1
                left -= 16
                block += 1


def loosen(
    places, segments, layer_start, first_layer, begin, end, first, last, half, fraction, axes, nodes, periodic, n, homes,
    bodies, source,
):  # fmt: skip
    """Candidates from number `n` on: all of layers begin .. end - 1.

    Their places count from their home nodes afterwards, see `settled`.
    """
    for layer in range(begin - first_layer, end - first_layer):
        for s in range(layer_start[layer], layer_start[layer + 1]):
            block, left, body = segments[s, 0], segments[s, 1], segments[s, 2]
            while left > 0:
                count = min(left, 16)
                for array_axis in range(3):
                    axis = axes[array_axis]
                    if axis >= 0:
                        base = first_layer + layer if array_axis == 0 else segments[s, 2 + array_axis]
                        settle(places[block, axis], homes[axis], n, count, base, half, fraction)
                        if periodic[axis]:
                            for k in range(n, n + count):
                                homes[axis, k] %= nodes[axis]
                        else:
                            for k in range(count):
                                home = max(0, min(nodes[axis] - 1, homes[axis, n + k]))
                                places[block, axis, k] += (homes[axis, n + k] - home) << fraction
                                homes[axis, n + k] = home
                for k in range(count):
                    bodies[n + k] = body
                    source[n + k] = 16 * block + k
                    if not stays(homes[axes[0], n + k], first_layer + layer, first, last):
                        homes[axes[0], n + k] = NOWHERE
                n += count
                left -= count
                block += 1


def settle(places, homes, first, count, base, half, fraction):
    """One axis of one block."""
    for k in range(count):
        steps = (places[k] + half) >> fraction
        places[k] -= steps << fraction
        homes[first + k] = base + steps


def cell_order(homes, bodies, ranges, axes, first_layer, layers, body_count, count, scratch, order):
    """The order by (layer, body, middle, row), stable, of those candidates in ranges (n, 2) that come into these layers, as
    many as `order` has room for. `count` needs room for layers x bodies, for nodes of an axis and for as many numbers as
    `order`.

    Counting sorts: all particles by layer and body, then each such group, which fits into a core's cache, by cell. Returns how
    many come; if there is no room for just as many there is no order.
    """
    groups = layers * body_count
    layer = homes[axes[0]]
    for g in range(groups + 1):
        count[g] = 0
    for r in range(ranges.shape[0]):
        for n in range(ranges[r, 0], ranges[r, 1]):
            if first_layer <= layer[n] < first_layer + layers:
                count[(layer[n] - first_layer) * body_count + bodies[n] + 1] += 1
    for g in range(groups):
        count[g + 1] += count[g]
    if count[groups] != order.shape[0]:
        return count[groups]
    for r in range(ranges.shape[0]):
        for n in range(ranges[r, 0], ranges[r, 1]):
            if first_layer <= layer[n] < first_layer + layers:
                g = (layer[n] - first_layer) * body_count + bodies[n]
                scratch[count[g]] = n
                count[g] += 1
    first, end = 0, order.shape[0]
    while first < end:
        lead = scratch[first]
        last = first + 1
        while last < end and layer[scratch[last]] == layer[lead] and bodies[scratch[last]] == bodies[lead]:
            last += 1
        group, ordered = scratch[first:last], order[first:last]
        row = homes[axes[2]]
        low_row, high_row = extent(row, group)
        rows = high_row - low_row + 1
        if axes[1] < 0:
            by_axis(row, low_row, rows, group, ordered, count)
        else:
            middle = homes[axes[1]]
            low_middle, high_middle = extent(middle, group)
            middles = high_middle - low_middle + 1
            if rows * middles <= group.shape[0]:
                by_cell(middle, row, low_middle, low_row, middles, rows, group, ordered, count)
            else:
                by_axis(row, low_row, rows, group, ordered, count)
                for k in range(group.shape[0]):
                    group[k] = ordered[k]
                by_axis(middle, low_middle, middles, group, ordered, count)
        first = last
    return end


def extent(home, group):
    """(lowest, highest) home node of a group along one axis."""
    low = high = home[group[0]]
    for k in range(group.shape[0]):
        low, high = min(low, home[group[k]]), max(high, home[group[k]])
    return low, high


def by_axis(home, low, nodes, group, ordered, count):
    """Stable counting sort of a group by the home node along one axis."""
    for g in range(nodes + 1):
        count[g] = 0
    for k in range(group.shape[0]):
        count[home[group[k]] - low + 1] += 1
    for g in range(nodes):
        count[g + 1] += count[g]
    for k in range(group.shape[0]):
        g = home[group[k]] - low
        ordered[count[g]] = group[k]
        count[g] += 1


def by_cell(middle, row, low_middle, low_row, middles, rows, group, ordered, count):
    """Stable counting sort of a group by middle and row at once."""
    for g in range(middles * rows + 1):
        count[g] = 0
    for k in range(group.shape[0]):
        count[(middle[group[k]] - low_middle) * rows + row[group[k]] - low_row + 1] += 1
    for g in range(middles * rows):
        count[g + 1] += count[g]
    for k in range(group.shape[0]):
        g = (middle[group[k]] - low_middle) * rows + row[group[k]] - low_row
        ordered[count[g]] = group[k]
        count[g] += 1


def cut_segments(homes, bodies, order, axes, first_layer, segments, layer_start):
    """Segments of ordered particles: one layer, one body, home nodes within REACH of a base. Returns how many
    segments and blocks there are.

    `segments` has a row for every particle; only the first are used.
    """
    count, blocks, n = 0, 0, 0
    layers = layer_start.shape[0] - 1
    for layer in range(layers):
        layer_start[layer] = count
        while n < order.shape[0] and homes[axes[0], order[n]] == first_layer + layer:
            lead = order[n]
            low_row = high_row = homes[axes[2], lead]
            low_middle = high_middle = homes[axes[1], lead] if axes[1] >= 0 else 0
            last = n
            while last < order.shape[0]:
                p = order[last]
                if homes[axes[0], p] != first_layer + layer or bodies[p] != bodies[lead]:
                    break
                row, middle = homes[axes[2], p], homes[axes[1], p] if axes[1] >= 0 else 0
                low, high = min(low_row, row), max(high_row, row)
                if high - low > 2 * REACH or middle - low_middle > 2 * REACH:
                    break
                low_row, high_row, high_middle = low, high, middle
                last += 1
            segments[count, 0], segments[count, 1], segments[count, 2] = blocks, last - n, bodies[lead]
            segments[count, 3], segments[count, 4] = (low_middle + high_middle) // 2, (low_row + high_row) // 2
            blocks += (last - n + 15) // 16
            n = last
            count += 1
    layer_start[layers] = count
    return count, blocks


def permute(
    blocks, rows, ids, row_ids, source, order, homes, axes, fraction, segments, count, new_blocks, new_ids, rest
):  # fmt: skip
    """Move the numbers of all particles, taken as integers, into their new blocks; places count from the new bases.

    The lanes that fill up a segment's last block get `rest`, at the place of the segment's last particle.
    """
    n = 0
    fields, dim = new_blocks.shape[1], homes.shape[0]
    old_values, new_values = blocks.reshape(-1), new_blocks.reshape(-1)
    shifts, base = np.zeros(16 * dim, new_blocks.dtype), np.zeros(3, np.int64)
    old_places = np.zeros(16, np.int64)
    for s in range(count):
        for array_axis in range(1, 3):
            if axes[array_axis] >= 0:
                base[axes[array_axis]] = segments[s, 2 + array_axis]
        new, left = segments[s, 0], segments[s, 1]
        while left > 0:
            here = min(left, 16)
            coming = max(source[order[min(n + AHEAD, order.shape[0] - 1)]], 0) >> 4
            arrived = False
            for lane in range(16):
                p = order[n + min(lane, here - 1)]
                for axis in range(dim):
                    shifts[16 * axis + lane] = (homes[axis, p] - base[axis]) << fraction
                shifts[16 * axes[0] + lane] = 0
                old = source[p]
                arrived |= old < 0
                old_places[lane] = (old >> 4) * (16 * fields) + (old & 15)
                new_ids[new, lane] = ids[old >> 4, old & 15] if old >= 0 else row_ids[-1 - old]
            o = new * (16 * fields)
            if arrived:
                for lane in range(here):
                    old = source[order[n + lane]]
                    for f in range(fields):
                        value = blocks[old >> 4, f, old & 15] if old >= 0 else rows[-1 - old, f]
                        new_values[o + 16 * f + lane] = value
            else:
                for f in range(fields):
                    for part in range(16 * f, 16 * (f + 1), 64 // new_blocks.itemsize):
                        prefetch(old_values, coming * fields * 16 + part, False)
                        prefetch(new_values, (new + 2) * fields * 16 + part, True)
                    store(new_values, o + 16 * f, gather(old_values, old_places, 0, 16 * f))
            for lane in range(here, 16):
                new_ids[new, lane] = -1
                for f in range(fields):
                    new_values[o + 16 * f + lane] = rest[f]
            for axis in range(dim):
                for lane in range(16):
                    new_values[o + 16 * axis + lane] += shifts[16 * axis + lane]
            n += here
            left -= here
            new += 1


def take_rows(blocks, segments, first, fields, rows):
    """Copy fields first .. first + fields - 1 of all particles out of their blocks into the first columns of rows (n, ...)."""
    values, out = blocks.reshape(-1), rows.reshape(-1)
    size, width = np.uint64(16 * blocks.shape[1]), np.uint64(rows.shape[1])
    begin, step, ahead = np.uint64(16 * first), np.uint64(16), np.uint64(8)
    o = np.uint64(0)
    for s in range(segments.shape[0]):
        i = np.uint64(segments[s, 0]) * size + begin
        left = segments[s, 1]
        while left > 0:
            for part in range(0, 16 * fields, 64 // values.itemsize):
                prefetch(values, int(i + ahead * size) + part, False)
            for lane in range(np.uint64(min(left, 16))):
                for f in range(np.uint64(fields)):
                    out[o + f] = values[i + lane + step * f]
                o += width
            i += size
            left -= 16


def take_positions(places, segments, layers, axes, fraction, unit, cell_size, x):
    """Positions (m) of all particles into the first columns of x (n, ...); `layers`: of each segment."""
    n = 0
    for s in range(segments.shape[0]):
        block, left = segments[s, 0], segments[s, 1]
        while left > 0:
            count = min(left, 16)
            for array_axis in range(3):
                axis = axes[array_axis]
                if axis >= 0:
                    base = layers[s] if array_axis == 0 else segments[s, 2 + array_axis]
                    for lane in range(count):
                        place = np.int64(places[block, axis, lane])
                        whole = place >> fraction
                        x[n + lane, axis] = (base + whole + (place - (whole << fraction)) * unit) * cell_size
            n += count
            left -= count
            block += 1
