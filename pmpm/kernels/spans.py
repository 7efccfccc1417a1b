"""Loops that find out which nodes there are: those that particles reach, as bits of rows, then as spans of rows.

A quad is four neighbouring nodes of a row. `marks[layer, middle, word]` holds 32 quads of a row per word. A span is a stretch
of quads of one row, (row of the array, first quad, last quad + 1).
"""

from pmpm.kernels.places import PADDING

QUADS = 32  # of a word
CLOSE = 4  # cells: the box around a block is little more than what its particles reach
FULL = (1 << QUADS) - 1


def mark_cells(places, segments, layer_start, first_layer, last_layer, middle, row, half, fraction, slack, marks):
    """Mark what the particles of layers first .. last - 1 reach, now or `slack` (a place) farther along any axis: the first
    rows of their stencils, and along these the quads of their rows of four nodes. middle, row: physical axes, middle < 0 in
    2-D.

    A block whose particles lie close together is marked as the box around them.
    """
    for layer in range(first_layer, last_layer):
        for s in range(layer_start[layer], layer_start[layer + 1]):
            block, left = segments[s, 0], segments[s, 1]
            i, j = segments[s, 4] + PADDING, segments[s, 3] + PADDING
            while left > 0:
                low, high = lowest(places[block, row]), highest(places[block, row])
                low_j = high_j = 0
                if middle >= 0:
                    low_j, high_j = lowest(places[block, middle]), highest(places[block, middle])
                if left >= 16 and high - low < CLOSE << fraction and high_j - low_j < CLOSE << fraction:
                    low, high = i + ((low + half - slack) >> fraction), i + ((high + half + slack) >> fraction)
                    if middle >= 0:
                        low_j = j + ((low_j + half - slack) >> fraction)
                        high_j = j + ((high_j + half + slack) >> fraction)
                    mark_box(marks, layer, low_j, high_j, low, high)
                else:
                    for lane in range(min(left, 16)):
                        place = int(places[block, row, lane]) + half
                        low, high = i + ((place - slack) >> fraction), i + ((place + slack) >> fraction)
                        if middle >= 0:
                            place = int(places[block, middle, lane]) + half
                            low_j, high_j = j + ((place - slack) >> fraction), j + ((place + slack) >> fraction)
                        mark_box(marks, layer, low_j, high_j, low, high)
                block += 1
                left -= 16


def lowest(numbers):
    """Of the lanes of a block."""
    found = numbers[0]
    for lane in range(1, 16):
        found = min(found, numbers[lane])
    return int(found)


def highest(numbers):
    """Of the lanes of a block."""
    found = numbers[0]
    for lane in range(1, 16):
        found = max(found, numbers[lane])
    return int(found)


def mark_box(marks, layer, low_j, high_j, low, high):
    """Mark rows low_j .. high_j, and along them the quads of rows of four nodes that begin at nodes low .. high."""
    first, last = max(low, 0) >> 2, min((high + 3) >> 2, QUADS * marks.shape[2] - 1)
    for j in range(max(low_j, 0), min(high_j + 1, marks.shape[1])):
        for q in range(first, last + 1):
            marks[layer, j, q >> 5] |= 1 << (q & 31)


def find_spans(marks, spans):
    """Write the spans of (rows, words) of marks, as many as there is room for; returns how many there are."""
    count, room = 0, spans.shape[0]
    words = marks.shape[1]
    for r in range(marks.shape[0]):
        begin = -1
        for w in range(words + 1):
            bits = int(marks[r, w]) if w < words else 0
            if bits == (0 if begin < 0 else FULL):
                continue
            for b in range(QUADS if w < words else 1):
                if (bits >> b) & 1:
                    if begin < 0:
                        begin = QUADS * w + b
                elif begin >= 0:
                    if count < room:
                        spans[count, 0], spans[count, 1], spans[count, 2] = r, begin, QUADS * w + b
                    count += 1
                    begin = -1
    return count


def place_spans(layer_spans, middles, spans, row_start, first_quads, placed):
    """Of each span of a layer: (middle, first quad, last quad + 1, then where its nodes are on each plane that the layer
    reaches, in quads). layer_spans: rows are layer * middles + middle; spans: rows are plane * middles + middle, their nodes
    begin at `first_quads`, those of a row at row_start[row]. Each span of a layer lies in one of each plane."""
    for n in range(layer_spans.shape[0]):
        row, first, last = layer_spans[n, 0], layer_spans[n, 1], layer_spans[n, 2]
        placed[n, 0], placed[n, 1], placed[n, 2] = row % middles, first, last
        for k in range(placed.shape[1] - 3):
            t = row_start[row + k * middles]
            while spans[t, 2] <= first:
                t += 1
            placed[n, 3 + k] = first_quads[t] + first - spans[t, 1]
