"""What the loops of P2G and G2P share, and the loops over nodes: folding, gravity, velocities, walls, messages at cuts.

A law's particles lie in `reals[block, field, lane]`, 16 lanes a block, fields place, v, C, state; `places` is the same memory
as integers. `segments[s]` = (first block, particles, row of `table`, middle and row number of the base node): particles of
one layer and one body whose places count from one base; along the slab axis they count from the layer. The last block of a
segment is filled up with lanes that nothing adds or counts.

The grid is `nodes[plane, middle, row, (p_x, p_y, p_z, mass)]`. A box (first and last + 1 along middle and row) says where a
plane holds anything; outside of it nodes are zero and no loop goes there, but for the rest of a row of four nodes: rows are
long enough for it.

P2G adds the particles of layers first_layer .. last_layer - 1 (counted from this rank's first), one after another, to the
planes each layer can touch, `windows[(layer - first_layer) % number of windows]`, and widens `boxes[layer]`. The law that
comes last `folds`: it adds each layer's planes to the nodes, layer after layer, and clears them for the next use. P2G returns
the number of runs of particles with the same stencil. Of a body force it leaves max |b|^2 in `scratch`, in FORCES and the 15
reals behind it; what body force and loads do to the particles of a layer, in J, is added to `works[layer]`.

`layer_node` is the global number of this rank's first layer, `time` that of the step's beginning, `load_factor` the part of
the loads that acts. Schemes that blend velocities run P2G twice: without impulses first, for `nodes_before`.

G2P gathers velocity and its gradient, advances state and position of its layers. `limits[axis]`, in 64ths of a cell, where
particles may be, `ends[axis]` where a periodic axis repeats. The first particle that fails is written to `failure` (cause,
block, lane) and keeps its position. G2P returns the maxima (speed^2, wave speed^2, drift in cells, |dt grad v|^2): drift is how
far a particle is from the middle of its layer, or half a cell plus what it is beyond the end of a periodic axis.
"""

from numba.np.unsafe.ndarray import to_fixed_tuple

from pmpm.kernels.lanes import flush_denormals, load, repeat_mass, restore_denormals, store, where, with_mass_of
from pmpm.kernels.places import PADDING  # noqa: F401 - of P2G and G2P
from pmpm.physics import boundary
from pmpm.physics import tensors2 as la

real = float
DIMENSIONS, SLAB, MIDDLE, ROW = 2, 0, -1, 1
FRACTION, HALF, PARAMETERS = 52, 1 << 51, 2
MASS_COLUMN, VOLUME_COLUMN, DENSITY_COLUMN, PARAMETER_COLUMN = 0, 1, 2, 3
FARTHEST = 95  # 64ths of a cell from the middle of a layer: a stencil stays inside the layer's padded planes
SETTLED = 32  # the farthest right after a regroup
OVERFLOW = 125  # cells from the base that fit into the integers of float32 places
CAUSE_POSITION, CAUSE_STATE, CAUSE_LEFT = 1, 2, 3  # why a particle stops the run
NOWHERE = -1
FORCES, WORKS = 1440, 1456  # of `scratch`, behind the columns that the fast loops work in
EMPTY_BOX = (1 << 30, 0, 1 << 30, 0)
wall, image, TWO_SIDED = boundary.wall_stick, boundary.image_reversed, True
BEYOND = 1


def no_force(x, X, t):
    """What stands in the place of a scene's body force."""
    return x


def node_of_axis(axis, a, b, c):
    """Of the stencil node (a, b, c) along (slab, middle, row), its number along a physical axis."""
    return a if axis == SLAB else (b if axis == MIDDLE else c)


def node_of_segment_2(slab, middle, row):
    """Base node per physical axis."""
    return (slab, row) if SLAB == 0 else (row, slab)


def node_of_segment_3(slab, middle, row):
    return (
        node_of_axis(0, slab, middle, row),
        node_of_axis(1, slab, middle, row),
        node_of_axis(2, slab, middle, row),
    )


node_of_segment = node_of_segment_2


def centre_of(place):
    """The centre node of a stencil, counted from the base."""
    return (place + HALF) >> FRACTION


def place_at(sixty_fourths):
    """The place so many 64ths of a cell from the base, or the last one that fits into the integers."""
    return max(-64 * OVERFLOW, min(64 * OVERFLOW, sixty_fourths)) << (FRACTION - 6)


def load_parameters(table, row):
    """The law's parameters of one body as a tuple."""
    return to_fixed_tuple(table[row, PARAMETER_COLUMN:], PARAMETERS)


# ---- sums of layers ------------------------------------------------------------------------------------------------------


def clear(nodes, boxes):
    """Nodes to zero, boxes to empty."""
    for i in range(nodes.shape[0]):
        for j in range(boxes[i, 0], boxes[i, 1]):
            row = nodes[i, j].reshape(-1)
            for q in range(4 * boxes[i, 2], 4 * boxes[i, 3], 16):
                store(row, q, 0.0)
        empty(boxes[i])


def empty(box):
    box[0], box[1], box[2], box[3] = EMPTY_BOX[0], EMPTY_BOX[1], EMPTY_BOX[2], EMPTY_BOX[3]


def widen(box, other):
    box[0], box[1] = min(box[0], other[0]), max(box[1], other[1])
    box[2], box[3] = min(box[2], other[2]), max(box[3], other[3])


def fold_layer(window, box, targets, nodes, boxes, unsummed, slot_boxes):
    """Add a layer's planes to the nodes and clear them.

    targets[k] >= 0 is the plane of `nodes`; below zero, -1 - slot is a plane kept unsummed for the rank that sums before
    this one at a cut.
    """
    for k in range(window.shape[0]):
        plane, slot = targets[k], -1 - targets[k]
        if plane >= 0:
            widen(boxes[plane], box)
        else:
            empty(slot_boxes[slot])
            widen(slot_boxes[slot], box)
        for j in range(box[0], box[1]):
            gained = window[k, j].reshape(-1)
            if plane >= 0:
                row = nodes[plane, j].reshape(-1)
                for q in range(4 * box[2], 4 * box[3], 16):
                    store(row, q, load(row, q) + load(gained, q))
                    store(gained, q, 0.0)
            else:
                row = unsummed[slot, j].reshape(-1)
                for q in range(4 * box[2], 4 * box[3], 16):
                    store(row, q, load(gained, q))
                    store(gained, q, 0.0)


def pack(planes, boxes, box_message, message):
    """Copy what the boxes of some planes hold into a message; returns how many reals that is."""
    place = 0
    for i in range(planes.shape[0]):
        for q in range(4):
            box_message[i, q] = boxes[i, q]
        for j in range(boxes[i, 0], boxes[i, 1]):
            row = planes[i, j].reshape(-1)
            for q in range(4 * boxes[i, 2], 4 * boxes[i, 3], 16):
                store(message, place, load(row, q))
                place += 16
    return place


def take_planes(nodes, boxes, first, box_message, message):
    """Put the planes of a message in the place of those from `first` on, which hold nothing."""
    place = 0
    for i in range(box_message.shape[0]):
        widen(boxes[first + i], box_message[i])
        for j in range(box_message[i, 0], box_message[i, 1]):
            row = nodes[first + i, j].reshape(-1)
            for q in range(4 * box_message[i, 2], 4 * box_message[i, 3], 16):
                store(row, q, load(message, place))
                place += 16


def add_planes(nodes, boxes, planes, box_message, message):
    """Add the planes of a message, one after another, to the planes of these numbers."""
    before = flush_denormals()
    place = 0
    for i in range(box_message.shape[0]):
        widen(boxes[planes[i]], box_message[i])
        for j in range(box_message[i, 0], box_message[i, 1]):
            row = nodes[planes[i], j].reshape(-1)
            for q in range(4 * box_message[i, 2], 4 * box_message[i, 3], 16):
                store(row, q, load(row, q) + load(message, place))
                place += 16
    restore_denormals(before)


# ---- nodes ---------------------------------------------------------------------------------------------------------------


def add_gravity(nodes, boxes, first_plane, last_plane, velocity_gain):
    """Momentum gains mass times dt times gravity, given for a row of four nodes."""
    before = flush_denormals()
    gain = load(velocity_gain, 0)
    for i in range(first_plane, last_plane):
        for j in range(boxes[i, 0], boxes[i, 1]):
            row = nodes[i, j].reshape(-1)
            for q in range(4 * boxes[i, 2], 4 * boxes[i, 3], 16):
                four = load(row, q)
                store(row, q, four + repeat_mass(four) * gain)
    restore_denormals(before)


def damp(nodes, boxes, first_plane, last_plane, kept):
    """Momentum loses all but the part `kept`, given for a row of four nodes; mass stays."""
    before = flush_denormals()
    factor = load(kept, 0)
    for i in range(first_plane, last_plane):
        for j in range(boxes[i, 0], boxes[i, 1]):
            row = nodes[i, j].reshape(-1)
            for q in range(4 * boxes[i, 2], 4 * boxes[i, 3], 16):
                store(row, q, load(row, q) * factor)
    restore_denormals(before)


def divide_by_mass(nodes, boxes, first_plane, last_plane):
    """Momentum -> velocity; nodes without mass are at rest."""
    before = flush_denormals()
    for i in range(first_plane, last_plane):
        for j in range(boxes[i, 0], boxes[i, 1]):
            row = nodes[i, j].reshape(-1)
            for q in range(4 * boxes[i, 2], 4 * boxes[i, 3], 16):
                four = load(row, q)
                mass = repeat_mass(four)
                store(row, q, with_mass_of(four, where(mass > 0.0, four / mass, 0.0)))
    restore_denormals(before)


def momentum_2(nodes, i, j, k):
    return (nodes[i, j, k, 0], nodes[i, j, k, 1])


def momentum_3(nodes, i, j, k):
    return (nodes[i, j, k, 0], nodes[i, j, k, 1], nodes[i, j, k, 2])


def normal_2(normal):
    return (normal[0], normal[1])


def normal_3(normal):
    return (normal[0], normal[1], normal[2])


momentum_at, load_normal = momentum_2, normal_2


def put_vector(nodes, i, j, k, v):
    for q in range(DIMENSIONS):
        nodes[i, j, k, q] = v[q]


def apply_wall(nodes, boxes, i0, i1, j0, j1, k0, k1, di, dj, dk, normal, coefficient, velocity):
    """One face, on momenta: nodes i0 .. i1 - 1, ... are those just beyond it, one step (di, dj, dk) leads to the node on it.

    A particle that has passed the wall by less than half a cell reaches BEYOND nodes beyond it. The rules hold for what moves
    relative to the wall. A wall that may be left mirrors only where material presses on it and the wall as a whole pushes;
    elsewhere the rule acts on the nodes on and beyond it. A mirrored node beyond is left without mass.
    """
    before = flush_denormals()
    n, u = load_normal(normal), load_normal(velocity)
    none = real(0.0)
    for i in range(i0, i1):
        box = boxes[i + di]
        for j in range(max(j0, box[0] - dj), min(j1, box[1] - dj)):
            for k in range(max(k0, box[2] - dk), min(k1, box[3] - dk)):
                mass_on = nodes[i + di, j + dj, k + dk, 3]
                on = la.add_scaled_vector(momentum_at(nodes, i + di, j + dj, k + dk), -mass_on, u)
                impulse = none
                for far in range(BEYOND):
                    ib, jb, kb = i - far * di, j - far * dj, k - far * dk
                    i2, j2, k2 = i + (2 + far) * di, j + (2 + far) * dj, k + (2 + far) * dk
                    mass_beyond, mass_inner = nodes[ib, jb, kb, 3], nodes[i2, j2, k2, 3]
                    if mass_beyond > 0.0:
                        past = la.add_scaled_vector(momentum_at(nodes, ib, jb, kb), -mass_beyond, u)
                        inner = la.add_scaled_vector(momentum_at(nodes, i2, j2, k2), -mass_inner, u)
                        impulse += boundary.mirror_impulse(past, mass_beyond, inner, mass_inner, n)
                normal_on = la.dot(on, n)
                holds = TWO_SIDED or (normal_on < 0.0 and normal_on + impulse <= 0.0)
                pressed = -impulse if holds else none
                for far in range(BEYOND):
                    ib, jb, kb = i - far * di, j - far * dj, k - far * dk
                    i2, j2, k2 = i + (2 + far) * di, j + (2 + far) * dj, k + (2 + far) * dk
                    mass_beyond, mass_inner = nodes[ib, jb, kb, 3], nodes[i2, j2, k2, 3]
                    if mass_beyond > 0.0:
                        past = la.add_scaled_vector(momentum_at(nodes, ib, jb, kb), -mass_beyond, u)
                        if holds:
                            inner = la.add_scaled_vector(momentum_at(nodes, i2, j2, k2), -mass_inner, u)
                            mirrored = la.add_scaled_vector(inner, 1.0, image(past, n))
                            mass_inner = mass_inner + mass_beyond
                            put_vector(nodes, i2, j2, k2, la.add_scaled_vector(mirrored, mass_inner, u))
                            nodes[i2, j2, k2, 3] = mass_inner
                            put_vector(nodes, ib, jb, kb, la.scale_vector(none, past))
                            nodes[ib, jb, kb, 3] = none
                        else:
                            past = wall(past, n, coefficient, none)
                            put_vector(nodes, ib, jb, kb, la.add_scaled_vector(past, mass_beyond, u))
                on = wall(on, n, coefficient, pressed)
                put_vector(nodes, i + di, j + dj, k + dk, la.add_scaled_vector(on, mass_on, u))
    restore_denormals(before)


def fill_beyond_wall(nodes, boxes, i0, i1, j0, j1, k0, k1, di, dj, dk, normal, velocity):
    """Nodes beyond one face that were mirrored move as the image of the inner ones."""
    n, u = load_normal(normal), load_normal(velocity)
    for far in range(BEYOND):
        for i in range(i0 - far * di, i1 - far * di):
            box = boxes[i]
            for j in range(max(j0 - far * dj, box[0]), min(j1 - far * dj, box[1])):
                for k in range(max(k0 - far * dk, box[2]), min(k1 - far * dk, box[3])):
                    if nodes[i, j, k, 3] == 0.0:
                        i2, j2, k2 = i + (2 + 2 * far) * di, j + (2 + 2 * far) * dj, k + (2 + 2 * far) * dk
                        seen = image(la.add_scaled_vector(momentum_at(nodes, i2, j2, k2), -1.0, u), n)
                        put_vector(nodes, i, j, k, la.add_scaled_vector(seen, 1.0, u))
