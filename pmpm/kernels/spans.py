"""Loops that find out which nodes there are: those that particles reach, as bits of rows, then as spans of rows.

A quad is four neighbouring nodes of a row. `marks[layer, middle, word]` holds 32 quads of a row per word. A span is a stretch
of quads of one row, (row of the array, first quad, last quad + 1).
"""

from pmpm.kernels.places import PADDING

QUADS = 32  # of a word
FULL = (1 << QUADS) - 1


def mark_cells(places, segments, layer_start, middle, row, half, fraction, slack, marks):
    """Mark where the particles of each layer stand: the first row of their stencils, and along it the quads that rows of four
    nodes reach from there, and from up to `slack` nodes beside. middle, row: physical axes, middle < 0 in 2-D."""
    last_quad = QUADS * marks.shape[2] - 1
    for layer in range(layer_start.shape[0] - 1):
        for s in range(layer_start[layer], layer_start[layer + 1]):
            block, left = segments[s, 0], segments[s, 1]
            j = held_j = 0
            held_k = -1 << 40
            while left > 0:
                for lane in range(min(left, 16)):
                    k = segments[s, 4] + ((places[block, row, lane] + half) >> fraction)
                    if middle >= 0:
                        j = segments[s, 3] + ((places[block, middle, lane] + half) >> fraction) + PADDING
                    if k != held_k or j != held_j:
                        held_k, held_j = k, j
                        first = max(k + PADDING - slack, 0) >> 2
                        last = min((k + PADDING + slack + 3) >> 2, last_quad)
                        for q in range(first, last + 1):
                            marks[layer, j, q >> 5] |= 1 << (q & 31)
                block += 1
                left -= 16


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
