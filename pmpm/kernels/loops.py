"""What the loops of P2G and G2P share, and the loops over nodes: folding, gravity, velocities, walls, messages at cuts.

A law's particles lie in `reals[block, field, lane]`, 16 lanes a block, fields place, v, C, state; `places` is the same memory
as integers. `segments[s]` = (first block, particles, row of `table`, middle and row number of the base node): particles of
one layer and one body whose places count from one base; along the slab axis they count from the layer. The last block of a
segment is filled up with lanes that nothing adds or counts.

The grid is `nodes[node, (p_x, p_y, p_z, mass)]`: the nodes that there are, in quads, four neighbours of a row, plane after
plane, row after row; see kernels.spans and state.grid. `placed[n]` = (middle, first quad, last quad + 1 of a row, then the
quad of `nodes` where it lies on each plane that the layer reaches) are the nodes of layers, `placed_start` the first of each.

P2G adds the particles of layers first_layer .. last_layer - 1 (counted from this rank's first), one after another, to the
planes each layer can touch, `windows[(layer - first_layer) % number of windows]`, which begin at row `corner[0]` and node
`corner[1]` of it. The law that comes last `folds`: it adds each layer's planes to the nodes, layer after layer, and clears them
for the next use. Where slots[layer, plane of the window] >= 0 they are kept apart instead, in `unsummed` from that quad on. P2G
returns the number of runs of particles with the same stencil. Of a body force it leaves max |b|^2 in `scratch`, in FORCES and
the 15 reals behind it; what body force and loads do to the particles of a layer, in J, is added to `works[layer]`.

`layer_node` is the global number of this rank's first layer, `time` that of the step's beginning, `load_factor` the part of
the loads that acts. Schemes that blend velocities run P2G twice: without impulses first, for `nodes_before`.

G2P gathers velocity and its gradient, advances state and position of its layers. It unfolds plane after plane into a `ring`,
as wide as the windows, whose first planes stand behind its last ones again, so that a stencil's planes follow each other.
`limits[axis]`, in 64ths of a cell, where particles may be, `ends[axis]` where a periodic axis repeats, or where its open faces
are. The first particle that fails is written to `failure` (cause, block, lane) and keeps its position. G2P returns the maxima
(speed^2, wave speed^2, drift in cells, |dt grad v|^2, the step along any axis in cells): drift is how far a particle is from
the middle of its layer, or half a cell plus what it is beyond an end of another axis.
"""

from numba.np.unsafe.ndarray import to_fixed_tuple

from pmpm.kernels.lanes import flush_denormals, load, repeat_mass, restore_denormals, store, where, with_mass_of
from pmpm.kernels.places import PADDING  # noqa: F401 - of P2G and G2P
from pmpm.physics import boundary, contact
from pmpm.physics import tensors2 as la
from pmpm.physics.words import floor

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
wall, image, TWO_SIDED = boundary.wall_stick, boundary.image_reversed, True
BEYOND = 1
MOMENTS = 1
WINDOW, NODES = 5, 3


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


def fold_layer(windows, number, layer, placed, placed_start, corner, slots, nodes, unsummed):
    """Add a layer's planes, window `number` of all, to the nodes, or keep them apart, and clear them."""
    reach, middles, row = windows.shape[1], windows.shape[2], windows.shape[3]
    window, sums, apart = windows.reshape(-1), nodes.reshape(-1), unsummed.reshape(-1)
    for k in range(reach):
        slot = 16 * slots[layer, k]
        for n in range(placed_start[layer], placed_start[layer + 1]):
            first, size = placed[n, 1], 16 * (placed[n, 2] - placed[n, 1])
            o = 4 * (((number * reach + k) * middles + placed[n, 0] - corner[0]) * row + 4 * first - corner[1])
            if slot < 0:
                to = 16 * placed[n, 3 + k]
                for q in range(0, size, 16):
                    store(sums, to + q, load(sums, to + q) + load(window, o + q))
                    store(window, o + q, 0.0)
            else:
                for q in range(0, size, 16):
                    store(apart, slot + q, load(window, o + q))
                    store(window, o + q, 0.0)
                slot += size


def add_slots(nodes, unsummed, placed, placed_start, slots, pairs):
    """Add what is kept apart of (layer, plane of its window), one after another, to the nodes."""
    before = flush_denormals()
    sums, apart = nodes.reshape(-1), unsummed.reshape(-1)
    for pair in range(pairs.shape[0]):
        layer, k = pairs[pair, 0], pairs[pair, 1]
        slot = 16 * slots[layer, k]
        for n in range(placed_start[layer], placed_start[layer + 1]):
            to, size = 16 * placed[n, 3 + k], 16 * (placed[n, 2] - placed[n, 1])
            for q in range(0, size, 16):
                store(sums, to + q, load(sums, to + q) + load(apart, slot + q))
            slot += size
    restore_denormals(before)


def add_planes(nodes, spans, row_start, first_quads, middles, planes, counts, message_spans, reals, first_real):
    """Add the planes of a message, one after another, to the planes of these numbers: what lies on nodes that there are.

    Of each plane the message tells how many spans it has (counts) and each span's (middle, first quad, last quad + 1); their
    nodes begin at first_real.
    """
    before = flush_denormals()
    sums = nodes.reshape(-1)
    place, span = first_real, 0
    for i in range(planes.shape[0]):
        for _ in range(counts[i]):
            row, first, last = (
                planes[i] * middles + message_spans[span],
                message_spans[span + 1],
                message_spans[span + 2],
            )
            for t in range(row_start[row], row_start[row + 1]):
                begin, end = max(first, spans[t, 1]), min(last, spans[t, 2])
                to, o = 16 * (first_quads[t] + begin - spans[t, 1]), place + 16 * (begin - first)
                for q in range(0, 16 * (end - begin), 16):
                    store(sums, to + q, load(sums, to + q) + load(reals, o + q))
            place += 16 * (last - first)
            span += 3
    restore_denormals(before)


def unfold_plane(nodes, plane, spans, row_start, first_quads, corner, ring, at):
    """Copy the nodes of a plane to where a ring's plane number `at` is, for G2P."""
    values, out = nodes.reshape(-1), ring.reshape(-1)
    middles, row = ring.shape[1], ring.shape[2]
    rows = corner[2]
    for t in range(row_start[plane * rows], row_start[(plane + 1) * rows]):
        o = 4 * ((at * middles + spans[t, 0] - plane * rows - corner[0]) * row + 4 * spans[t, 1] - corner[1])
        frm = 16 * first_quads[t]
        for q in range(0, 16 * (spans[t, 2] - spans[t, 1]), 16):
            store(out, o + q, load(values, frm + q))


def unfold(nodes, unfolded, layer, spans, row_start, first_quads, corner, ring):
    """Bring the planes that a layer reaches into the ring, those from plane `unfolded` on."""
    for plane in range(max(unfolded, layer), layer + WINDOW):
        at = plane % WINDOW
        unfold_plane(nodes, plane, spans, row_start, first_quads, corner, ring, at)
        if at < NODES - 1:
            unfold_plane(nodes, plane, spans, row_start, first_quads, corner, ring, at + WINDOW)


# ---- nodes ---------------------------------------------------------------------------------------------------------------


def add_gravity(nodes, first, last, velocity_gain):
    """Momentum gains mass times dt times gravity, given for a quad, on quads first .. last - 1."""
    before = flush_denormals()
    values, gain = nodes.reshape(-1), load(velocity_gain, 0)
    for q in range(16 * first, 16 * last, 16):
        four = load(values, q)
        store(values, q, four + repeat_mass(four) * gain)
    restore_denormals(before)


def damp(nodes, first, last, kept):
    """Momentum loses all but the part `kept`, given for a quad; mass stays."""
    before = flush_denormals()
    values, factor = nodes.reshape(-1), load(kept, 0)
    for q in range(16 * first, 16 * last, 16):
        store(values, q, load(values, q) * factor)
    restore_denormals(before)


def divide_by_mass(nodes, first, last):
    """Momentum -> velocity; nodes without mass are at rest."""
    before = flush_denormals()
    values = nodes.reshape(-1)
    for q in range(16 * first, 16 * last, 16):
        four = load(values, q)
        mass = repeat_mass(four)
        store(values, q, with_mass_of(four, where(mass > 0.0, four / mass, 0.0)))
    restore_denormals(before)


def momentum_2(nodes, n):
    return (nodes[n, 0], nodes[n, 1])


def momentum_3(nodes, n):
    return (nodes[n, 0], nodes[n, 1], nodes[n, 2])


def normal_2(normal):
    return (normal[0], normal[1])


def normal_3(normal):
    return (normal[0], normal[1], normal[2])


momentum_at, load_normal = momentum_2, normal_2


def vector_in_2(rows, i):
    return (rows[i, 0], rows[i, 1])


def vector_in_3(rows, i):
    return (rows[i, 0], rows[i, 1], rows[i, 2])


vector_in = vector_in_2


def put_vector(nodes, n, v):
    for q in range(DIMENSIONS):
        nodes[n, q] = v[q]


def apply_wall(nodes, met, first, last, normal, coefficient, velocity):
    """One face, on momenta. met[n]: a node on it, then for each of BEYOND nodes the one beyond and its image inside; of these
    first .. last - 1.

    A particle that has passed the wall by less than half a cell reaches BEYOND nodes beyond it. The rules hold for what moves
    relative to the wall. A wall that may be left mirrors only where material presses on it and the wall as a whole pushes;
    elsewhere the rule acts on the nodes on and beyond it. A mirrored node beyond is left without mass. Beside an edge of the
    domain another wall may have mirrored the inner node and let go of the one beyond, which then has next to no mass and any
    velocity: that is dropped, for no particle of a wider stencil than a linear one reaches a node beyond without the inner one.
    """
    before = flush_denormals()
    n, u = load_normal(normal), load_normal(velocity)
    for i in range(first, last):
        apply_wall_at(nodes, met, i, n, coefficient, u)
    restore_denormals(before)


def apply_wall_at(nodes, met, i, n, coefficient, u):
    """The same on one node and those beyond it, of a wall with normal n that moves at u."""
    none = real(0.0)
    at = met[i, 0]
    mass_on = nodes[at, 3]
    on = la.add_scaled_vector(momentum_at(nodes, at), -mass_on, u)
    impulse = none
    for far in range(BEYOND):
        beyond, inside = met[i, 1 + 2 * far], met[i, 2 + 2 * far]
        mass_beyond, mass_inner = nodes[beyond, 3], nodes[inside, 3]
        if mass_beyond > 0.0:
            past = la.add_scaled_vector(momentum_at(nodes, beyond), -mass_beyond, u)
            inner = la.add_scaled_vector(momentum_at(nodes, inside), -mass_inner, u)
            impulse += boundary.mirror_impulse(past, mass_beyond, inner, mass_inner, n)
    normal_on = la.dot(on, n)
    holds = TWO_SIDED or (normal_on < 0.0 and normal_on + impulse <= 0.0)
    pressed = -impulse if holds else none
    for far in range(BEYOND):
        beyond, inside = met[i, 1 + 2 * far], met[i, 2 + 2 * far]
        mass_beyond, mass_inner = nodes[beyond, 3], nodes[inside, 3]
        if mass_beyond > 0.0:
            past = la.add_scaled_vector(momentum_at(nodes, beyond), -mass_beyond, u)
            if holds:
                if mass_inner > 0.0 or NODES == 2:
                    inner = la.add_scaled_vector(momentum_at(nodes, inside), -mass_inner, u)
                    mirrored = la.add_scaled_vector(inner, 1.0, image(past, n))
                    mass_inner = mass_inner + mass_beyond
                    put_vector(nodes, inside, la.add_scaled_vector(mirrored, mass_inner, u))
                    nodes[inside, 3] = mass_inner
                put_vector(nodes, beyond, la.scale_vector(none, past))
                nodes[beyond, 3] = none
            else:
                past = wall(past, n, coefficient, none)
                put_vector(nodes, beyond, la.add_scaled_vector(past, mass_beyond, u))
    on = wall(on, n, coefficient, pressed)
    put_vector(nodes, at, la.add_scaled_vector(on, mass_on, u))


def collide(nodes, numbers, first, last, normals, velocities, arms, counted, coefficient, per_unit, per_reach, found):
    """The surface of a rigid body, on momenta: of nodes numbers[first:last], which lie inside of it. normals, velocities and
    arms (from the pivot, m) are the surface's there.

    What these nodes give to the body is added to `found`, momentum in units and its moment in units times a reach, as whole
    numbers: their sums do not depend on their order. Nodes with counted = 0 another rank counts.
    """
    before = flush_denormals()
    for i in range(first, last):
        given = collide_at(
            nodes, numbers[i], vector_in(normals, i), vector_in(velocities, i), coefficient, counted[i] * per_unit
        )
        torque = la.moment(vector_in(arms, i), given)
        for q in range(DIMENSIONS):
            found[q] += whole(given[q])
        for q in range(MOMENTS):
            found[DIMENSIONS + q] += whole(torque[q] * per_reach)
    restore_denormals(before)


def collide_at(nodes, at, n, u, coefficient, per_unit):
    """The same on one node; returns what it gives to the body, in units."""
    mass, none = nodes[at, 3], real(0.0)
    momentum = la.add_scaled_vector(momentum_at(nodes, at), -mass, u)
    kept = wall(momentum, n, coefficient, none) if mass > none else momentum
    put_vector(nodes, at, la.add_scaled_vector(kept, mass, u))
    return la.scale_vector(per_unit, la.add_scaled_vector(momentum, -1.0, kept))


def touch(nodes, volumes, room, pairs, frictions, first, last):
    """Contact between velocity fields, on momenta of nodes first .. last - 1: nodes and volumes are those of all fields,
    (fields, nodes, 4), volumes[field, node] = (gradient, volume) of what lies around. pairs (pairs, 2) of fields.

    Bodies touch where together they fill `room` (m3) around a node.
    """
    before = flush_denormals()
    for i in range(first, last):
        touch_on_node(nodes, volumes, room, pairs, frictions, i)
    restore_denormals(before)


def touch_on_node(nodes, volumes, room, pairs, frictions, i):
    """The same on one node."""
    held, filled = 0, real(0.0)
    for field in range(volumes.shape[0]):
        if nodes[field, i, 3] > 0.0:
            held += 1
        filled += volumes[field, i, 3]
    if held > 1 and filled >= room:
        for pair in range(pairs.shape[0]):
            a, b = pairs[pair, 0], pairs[pair, 1]
            if nodes[a, i, 3] > 0.0 and nodes[b, i, 3] > 0.0:
                touch_at(nodes[a], nodes[b], volumes[a], volumes[b], i, 1.0 / room, frictions[pair])


def touch_at(nodes_a, nodes_b, volumes_a, volumes_b, i, per_room, friction):
    """The same of one pair."""
    a, b = momentum_at(nodes_a, i), momentum_at(nodes_b, i)
    out_of_a, out_of_b = momentum_at(volumes_a, i), momentum_at(volumes_b, i)
    n = contact.normal_between(la.scale_vector(per_room, out_of_a), la.scale_vector(per_room, out_of_b))
    gained = contact.momentum_gained(a, nodes_a[i, 3], b, nodes_b[i, 3], n, friction)
    put_vector(nodes_a, i, la.add_scaled_vector(a, 1.0, gained))
    put_vector(nodes_b, i, la.add_scaled_vector(b, -1.0, gained))


def whole(x):
    """The nearest whole number, or the largest that there is room for."""
    return int(floor(max(-4611686018427387904.0, min(4611686018427387904.0, x)) + 0.5))


def mirror_volumes(volumes, met, first, last, normal):
    """Add what a face mirrors to volumes and gradients: met and first .. last - 1 as in apply_wall."""
    n = load_normal(normal)
    for i in range(first, last):
        mirror_volumes_at(volumes, met, i, n)


def mirror_volumes_at(volumes, met, i, n):
    """The same on one node of a wall and those beyond it: all walls mirror what lies there, whether it sticks or slips."""
    on = met[i, 0]
    add_image(volumes, on, on, n)
    for far in range(BEYOND):
        beyond, inside = met[i, 1 + 2 * far], met[i, 2 + 2 * far]
        add_image(volumes, inside, beyond, n)
        put_vector(volumes, beyond, boundary.image_mirrored(momentum_at(volumes, inside), n))
        volumes[beyond, 3] = volumes[inside, 3]


def add_image(volumes, to, of, n):
    """A node gains the image of what another one has."""
    seen = boundary.image_mirrored(momentum_at(volumes, of), n)
    put_vector(volumes, to, la.add_scaled_vector(momentum_at(volumes, to), 1.0, seen))
    volumes[to, 3] += volumes[of, 3]


def fill_beyond_wall(nodes, met, first, last, normal, velocity):
    """Nodes beyond one face that were mirrored move as the image of the inner ones; arguments as in apply_wall."""
    n, u = load_normal(normal), load_normal(velocity)
    for far in range(BEYOND):
        for i in range(first, last):
            fill_beyond_wall_at(nodes, met, i, far, n, u)


def fill_beyond_wall_at(nodes, met, i, far, n, u):
    """The same on the node so far beyond one node of the wall."""
    beyond, inside = met[i, 1 + 2 * far], met[i, 2 + 2 * far]
    if nodes[beyond, 3] == 0.0:
        seen = image(la.add_scaled_vector(momentum_at(nodes, inside), -1.0, u), n)
        put_vector(nodes, beyond, la.add_scaled_vector(seen, 1.0, u))
