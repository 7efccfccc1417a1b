"""Loops of a regroup: homes of particles, their order by (layer, body, cell), segments, and the move into new blocks.

Arrays of one number per particle stand in the order of the particles; `source[n]` is where particle n comes from: a lane
(16 block + lane) of the blocks it lay in, or -1 - k for row k of those that arrived from other ranks.
"""

from pmpm.kernels.places import REACH

SEGMENT_COLUMNS = 5


def loosen(places, segments, layer_start, first_layer, half, fraction, axes, cells, homes, bodies, source):
    """Home nodes of all particles, per physical axis; places count from them afterwards.

    `cells[axis]` > 0 where an axis is periodic. Exact: places change by whole cells.
    """
    n = 0
    for layer in range(layer_start.shape[0] - 1):
        for s in range(layer_start[layer], layer_start[layer + 1]):
            for k in range(segments[s, 1]):
                block, lane = segments[s, 0] + (k >> 4), k & 15
                for array_axis in range(3):
                    axis = axes[array_axis]
                    if axis >= 0:
                        base = first_layer + layer if array_axis == 0 else segments[s, 2 + array_axis]
                        steps = (places[block, axis, lane] + half) >> fraction
                        places[block, axis, lane] -= steps << fraction
                        node = base + steps
                        if cells[axis] > 0:
                            node %= cells[axis]
                        homes[n, axis] = node
                bodies[n] = segments[s, 2]
                source[n] = 16 * block + lane
                n += 1


def cell_order(homes, bodies, axes, first_layer, layers, body_count, count, scratch, order):
    """The order of particles by (layer, body, middle, row), stable; `count` needs room for layers x bodies and for nodes.

    Counting sorts: all particles by layer and body, then each such group, which fits into a core's cache, by row and middle.
    """
    groups = layers * body_count
    for g in range(groups + 1):
        count[g] = 0
    for n in range(homes.shape[0]):
        count[(homes[n, axes[0]] - first_layer) * body_count + bodies[n] + 1] += 1
    for g in range(groups):
        count[g + 1] += count[g]
    for n in range(homes.shape[0]):
        g = (homes[n, axes[0]] - first_layer) * body_count + bodies[n]
        order[count[g]] = n
        count[g] += 1
    first = 0
    while first < homes.shape[0]:
        lead = order[first]
        last = first
        while (
            last < homes.shape[0]
            and homes[order[last], axes[0]] == homes[lead, axes[0]]
            and bodies[order[last]] == bodies[lead]
        ):
            last += 1
        by_axis(homes, axes[2], order, first, last, count, scratch)
        if axes[1] >= 0:
            by_axis(homes, axes[1], order, first, last, count, scratch)
        first = last


def by_axis(homes, axis, order, first, last, count, scratch):
    """Stable counting sort of order[first:last] by the home node along one axis."""
    low = high = homes[order[first], axis]
    for k in range(first, last):
        low, high = min(low, homes[order[k], axis]), max(high, homes[order[k], axis])
    for g in range(high - low + 2):
        count[g] = 0
    for k in range(first, last):
        count[homes[order[k], axis] - low + 1] += 1
    for g in range(high - low + 1):
        count[g + 1] += count[g]
    for k in range(first, last):
        g = homes[order[k], axis] - low
        scratch[count[g]] = order[k]
        count[g] += 1
    for k in range(first, last):
        order[k] = scratch[k - first]


def cut_segments(homes, bodies, order, axes, first_layer, segments, layer_start):
    """Segments of ordered particles: one layer, one body, home nodes within REACH of a base. Returns (segments, blocks).

    `segments` has a row for every particle; only the first are used.
    """
    count, blocks, n = 0, 0, 0
    layers = layer_start.shape[0] - 1
    for layer in range(layers):
        layer_start[layer] = count
        while n < order.shape[0] and homes[order[n], axes[0]] == first_layer + layer:
            lead = order[n]
            low_row = high_row = homes[lead, axes[2]]
            low_middle = high_middle = homes[lead, axes[1]] if axes[1] >= 0 else 0
            last = n
            while last < order.shape[0]:
                p = order[last]
                if homes[p, axes[0]] != first_layer + layer or bodies[p] != bodies[lead]:
                    break
                row, middle = homes[p, axes[2]], homes[p, axes[1]] if axes[1] >= 0 else 0
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


def permute(blocks, rows, ids, row_ids, source, order, segments, count, new_blocks, new_ids, rest):
    """Move the numbers of all particles, taken as integers, into their new blocks; fill up with `rest`."""
    n = 0
    fields = new_blocks.shape[1]
    for s in range(count):
        for k in range(segments[s, 1]):
            new, lane = segments[s, 0] + (k >> 4), k & 15
            old = source[order[n]]
            if old >= 0:
                for f in range(fields):
                    new_blocks[new, f, lane] = blocks[old >> 4, f, old & 15]
                new_ids[new, lane] = ids[old >> 4, old & 15]
            else:
                for f in range(fields):
                    new_blocks[new, f, lane] = rows[-1 - old, f]
                new_ids[new, lane] = row_ids[-1 - old]
            n += 1
        for k in range(segments[s, 1], 16 * ((segments[s, 1] + 15) // 16)):
            new, lane = segments[s, 0] + (k >> 4), k & 15
            for f in range(fields):
                new_blocks[new, f, lane] = rest[f]
            new_ids[new, lane] = -1


def fasten(places, segments, count, homes, order, axes, first_layer, fraction):
    """Places from the base of their segment again; the lanes that fill up a block stand where its last particle does."""
    n = 0
    for s in range(count):
        for k in range(16 * ((segments[s, 1] + 15) // 16)):
            block, lane = segments[s, 0] + (k >> 4), k & 15
            live = k < segments[s, 1]
            p = order[n] if live else order[n - 1]
            for array_axis in range(1, 3):
                axis = axes[array_axis]
                if axis >= 0:
                    if not live:
                        places[block, axis, lane] = 0
                    places[block, axis, lane] += (homes[p, axis] - segments[s, 2 + array_axis]) << fraction
            if live:
                n += 1
