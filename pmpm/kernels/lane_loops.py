"""P2G and G2P on SIMD lanes. Same arguments and same physics as scalar_loops.py, which is the reference.

A block of 16 particles is worked on in two ways. For weights, stress and state a lane is a particle. For the transfer a lane
is a component of a node: a row of 4 neighbouring nodes x (3 components, mass) is contiguous in memory and one value here
(quadratic: the fourth node's weight is zero). The rows of a stencil stay in registers while consecutive particles share
their nodes. Array axes are (slab, middle, row); in 2-D there is no middle.

What a particle gives to node i at distance d, with M the affine momentum (and the stress impulse of MLS) and F the impulse
on weight gradients, is w (M_s d_s + M_m d_m + M_r d_r + m v) + F . grad w. With w = w_s w_m w_r it is summed as
  constant = w_r (M_r d_r + m v) [+ w'_r F_r],   X = w_s constant + w_s d_s (w_r M_s) [+ w'_s (w_r F_s)],
  Y = w_s (w_r M_m),   row += w_m X + w_m d_m Y [+ w'_m w_s (w_r F_m)].
"""

from pmpm.kernels.lanes import (
    any_of,
    flush_denormals,
    in_all_lanes,
    lanes_below,
    largest_lane,
    load,
    load_repeated,
    load_transposed,
    prefetch,
    restore_denormals,
    store,
    store_quads,
    sum_nodes,
    to_int32,
    to_integer,
    to_real,
    where,
)
from pmpm.kernels.loops import (
    CAUSE_LEFT,
    CAUSE_POSITION,
    CAUSE_STATE,
    DENSITY_COLUMN,
    FARTHEST,
    FORCES,
    FRACTION,
    MASS_COLUMN,
    NOWHERE,
    PADDING,
    SETTLED,
    VOLUME_COLUMN,
    WORKS,
    centre_of,
    fold_layer,
    load_parameters,
    no_force,
    node_of_segment,
    place_at,
    unfold,
)
from pmpm.physics import stability, transfer
from pmpm.physics import tensors2 as la
from pmpm.physics.bspline import slopes_quadratic as slopes
from pmpm.physics.bspline import weights_quadratic as weights
from pmpm.physics.materials import neo_hookean as law
from pmpm.physics.words import floor

real = integer = float
DIMENSIONS, SLAB, MIDDLE, ROW = 2, 0, -1, 1
NODES, WINDOW, INERTIA = 3, 5, 4.0
BEFORE_RING = DIVERGENCE_RING = 0
CENTRE, UNIT, ONE_CELL = 0, 2.0**-52, 2.0**52
# What the transfer does. AFFINE: particles have an affine field; BY_INERTIA: C from its sums, else from the gradient; MLS:
# forces without weight gradients; BLENDS: a part of the particle's own velocity is kept; IMPULSE: P2G adds what changes
# velocities; STORES_C: particles keep C, whoever asks for it; F_BAR: G2P takes the divergence from nodes, for which DIVERGENCE
# lets P2G tell volumes and divergences in place of masses and velocities; VOLUMES: volumes as they are and their gradients.
AFFINE, BY_INERTIA, MLS, BLENDS, IMPULSE, STORES_C = True, True, False, False, True, True
BY_GRADIENT = True  # IMPULSE and not MLS
VOLUMES = DIVERGENCE = F_BAR = VISCOUS = FORCED = LOADED = DRIVEN = ENDS_MIDDLE = ENDS_ROW = SHARED = False
FIELDS, V_FIELD, C_FIELD, REFERENCE_FIELD, LOAD_FIELD, SHARE_FIELD, STATE_FIELD = 12, 2, 4, 8, 8, 8, 8
DIVERGENCE_FIELD = 8
body_force = no_force
OFFSETS = (-1.0, 0.0, 1.0)

# Columns of 16 reals of the scratch table: weights, first moments and slopes of up to 4 nodes along two axes, the offset
# along rows, then 7 quads of 64.
SLAB_W, SLAB_E, SLAB_D = 0, 64, 128
MIDDLE_W, MIDDLE_E, MIDDLE_D = 192, 256, 320
ROW_G = 384
QUAD_SLAB, QUAD_MIDDLE, QUAD_ROW, QUAD_CONSTANT = 400, 464, 528, 592
QUAD_F_SLAB, QUAD_F_MIDDLE, QUAD_F_ROW = 656, 720, 784
GATHERED, GRADIENTS = 400, 656
BEFORE, DIVERGENCES, CAUSES = 912, 1168, 1424
AHEAD, LINE, LINES = 2, 8, 2  # blocks fetched ahead; reals of a cache line; lines per particle
SCRATCH = WORKS + 16
# Of the constants of a row: distances of its nodes, origins, then the coefficients of weights and slopes.
ROW_DISTANCE, ROW_ORIGIN, ROW_WEIGHT, ROW_SLOPE = 0, 16, 32, 96
CONSTANTS = 160


# ---- fields of a block ---------------------------------------------------------------------------------------------------


def fields_1(a, o):
    return (load(a, o),)


def fields_2(a, o):
    return (load(a, o), load(a, o + 16))


def fields_3(a, o):
    return (load(a, o), load(a, o + 16), load(a, o + 32))


def fields_4(a, o):
    return fields_2(a, o) + fields_2(a, o + 32)


def fields_5(a, o):
    return fields_4(a, o) + fields_1(a, o + 64)


def fields_6(a, o):
    return fields_4(a, o) + fields_2(a, o + 64)


def fields_7(a, o):
    return fields_4(a, o) + fields_3(a, o + 64)


def fields_8(a, o):
    return fields_4(a, o) + fields_4(a, o + 64)


def fields_9(a, o):
    return fields_8(a, o) + fields_1(a, o + 128)


def fields_10(a, o):
    return fields_8(a, o) + fields_2(a, o + 128)


def fields_11(a, o):
    return fields_8(a, o) + fields_3(a, o + 128)


def fields_12(a, o):
    return fields_8(a, o) + fields_4(a, o + 128)


# By how many there are: a loop would have to make a tuple of unknown length.
FIELD_TUPLES = dict(enumerate((fields_1, fields_2, fields_3, fields_4, fields_5, fields_6, fields_7, fields_8, fields_9,
                               fields_10, fields_11, fields_12), 1))  # fmt: skip
load_vector, load_matrix, load_state = fields_2, fields_4, fields_4


def put(a, o, values):
    """A tuple of lanes into consecutive columns."""
    for i in range(len(values)):
        store(a, o + 16 * i, values[i])


# ---- where 16 particles stand --------------------------------------------------------------------------------------------


def offset_from(place, centre):
    """Distance from the centre node in cells."""
    return to_real(place - (centre << FRACTION)) * UNIT


def moments_2(w, g):
    """w d of each node."""
    return (w[0] * (OFFSETS[0] - g), w[1] * (OFFSETS[1] - g))


def moments_3(w, g):
    return (w[0] * (OFFSETS[0] - g), w[1] * (OFFSETS[1] - g), w[2] * (OFFSETS[2] - g))


def moments_4(w, g):
    return moments_3(w, g) + (w[3] * (OFFSETS[3] - g),)


moments = moments_3


def place_along(table, column, g):
    """Weights, first moments and slopes of one axis."""
    w = weights(g)
    put(table, column + SLAB_W, w)
    if AFFINE:
        put(table, column + SLAB_E, moments(w, g))
    if not MLS:
        put(table, column + SLAB_D, slopes(g))


def place_block(places, o, table, first_nodes, turn, base_middle, base_row, plane, row):
    """Stencils of 16 particles. first_nodes[lane]: where the stencil begins in a window, or in a ring whose plane number `turn`
    is the first that the layer reaches, in reals; bases count from its corner."""
    place = load(places, o + 16 * SLAB)
    centre = centre_of(place)
    place_along(table, 0, offset_from(place, centre))
    first = to_int32(centre) + (turn + PADDING)
    first = where(first < WINDOW, first, first - WINDOW) * plane
    place = load(places, o + 16 * ROW)
    centre = centre_of(place)
    store(table, ROW_G, offset_from(place, centre))
    first = first + (to_int32(centre) + (base_row + PADDING))
    if DIMENSIONS == 3:
        place = load(places, o + 16 * MIDDLE)
        centre = centre_of(place)
        place_along(table, MIDDLE_W, offset_from(place, centre))
        first = first + (to_int32(centre) + (base_middle + PADDING)) * row
    store(first_nodes, 0, first * 4)


def row_weights_2(constants, at, t):
    """A polynomial of each node of a row, repeated for the node's 4 components: linear."""
    return load(constants, at + 16) * t + load(constants, at)


def row_weights_3(constants, at, t):
    """Quadratic."""
    return (load(constants, at + 32) * t + load(constants, at + 16)) * t + load(constants, at)


def row_weights_4(constants, at, t):
    """Cubic."""
    return ((load(constants, at + 48) * t + load(constants, at + 32)) * t + load(constants, at + 16)) * t + load(
        constants, at
    )


row_weights = row_weights_3


# ---- P2G -----------------------------------------------------------------------------------------------------------------


def no_rows():
    return in_all_lanes(real(0.0))


def rows_1():
    return (no_rows(),)


def rows_2():
    return (no_rows(), no_rows())


def rows_3():
    return (no_rows(), no_rows(), no_rows())


def rows_4():
    return (no_rows(), no_rows(), no_rows(), no_rows())


def stencil_2():
    return (middle_rows(), middle_rows())


def stencil_3():
    return (middle_rows(), middle_rows(), middle_rows())


def stencil_4():
    return (middle_rows(), middle_rows(), middle_rows(), middle_rows())


middle_rows, empty_stencil = rows_1, stencil_3


def add_row(row, table, at, X, Y, Z):
    """One row of a slab: X and Y as in the head of this file, Z what multiplies the slope along the middle axis."""
    row = row + table[at] * X
    if AFFINE:
        row = row + table[at + (MIDDLE_E - MIDDLE_W)] * Y
    if BY_GRADIENT:
        row = row + table[at + (MIDDLE_D - MIDDLE_W)] * Z
    return row


def add_slab_1(rows, table, lane, X, Y, Z):
    return (rows[0] + X,)


def add_slab_2(rows, table, lane, X, Y, Z):
    at = MIDDLE_W + lane
    return (add_row(rows[0], table, at, X, Y, Z), add_row(rows[1], table, at + 16, X, Y, Z))


def add_slab_3(rows, table, lane, X, Y, Z):
    at = MIDDLE_W + lane
    return (
        add_row(rows[0], table, at, X, Y, Z),
        add_row(rows[1], table, at + 16, X, Y, Z),
        add_row(rows[2], table, at + 32, X, Y, Z),
    )


def add_slab_4(rows, table, lane, X, Y, Z):
    return add_slab_3(rows, table, lane, X, Y, Z) + (add_row(rows[3], table, MIDDLE_W + 48 + lane, X, Y, Z),)


add_slab = add_slab_1


def add_particle_to(rows, table, lane, i, constant, slab, middle, force_slab, force_middle):
    """Slab i of a stencil gains what a particle gives it."""
    w = table[SLAB_W + 16 * i + lane]
    X = w * constant
    if AFFINE:
        X = X + table[SLAB_E + 16 * i + lane] * slab
    if BY_GRADIENT:
        X = X + table[SLAB_D + 16 * i + lane] * force_slab
    return add_slab(rows, table, lane, X, w * middle, w * force_middle)


def add_particle_2(rows, table, lane, constant, slab, middle, force_slab, force_middle):
    return (
        add_particle_to(rows[0], table, lane, 0, constant, slab, middle, force_slab, force_middle),
        add_particle_to(rows[1], table, lane, 1, constant, slab, middle, force_slab, force_middle),
    )


def add_particle_3(rows, table, lane, constant, slab, middle, force_slab, force_middle):
    return (
        add_particle_to(rows[0], table, lane, 0, constant, slab, middle, force_slab, force_middle),
        add_particle_to(rows[1], table, lane, 1, constant, slab, middle, force_slab, force_middle),
        add_particle_to(rows[2], table, lane, 2, constant, slab, middle, force_slab, force_middle),
    )


def add_particle_4(rows, table, lane, constant, slab, middle, force_slab, force_middle):
    return add_particle_3(rows, table, lane, constant, slab, middle, force_slab, force_middle) + (
        add_particle_to(rows[3], table, lane, 3, constant, slab, middle, force_slab, force_middle),
    )


add_particle = add_particle_3


def scatter(rows, table, constants, lane):
    """Add one particle of the block to the rows of its stencil."""
    q = 16 * (lane & 3) + 4 * (lane >> 2)  # where store_quads puts lane's values
    g = in_all_lanes(table[ROW_G + lane])
    t = g - load(constants, ROW_ORIGIN)
    w = row_weights(constants, ROW_WEIGHT, t)
    constant = load_repeated(table, QUAD_CONSTANT + q)
    if AFFINE:
        constant = load_repeated(table, QUAD_ROW + q) * (load(constants, ROW_DISTANCE) - g) + constant
    constant = w * constant
    slab = middle = force_slab = force_middle = constant
    if AFFINE:
        slab = w * load_repeated(table, QUAD_SLAB + q)
        if DIMENSIONS == 3:
            middle = w * load_repeated(table, QUAD_MIDDLE + q)
    if BY_GRADIENT:
        constant = constant + row_weights(constants, ROW_SLOPE, t) * load_repeated(table, QUAD_F_ROW + q)
        force_slab = w * load_repeated(table, QUAD_F_SLAB + q)
        if DIMENSIONS == 3:
            force_middle = w * load_repeated(table, QUAD_F_MIDDLE + q)
    return add_particle(rows, table, lane, constant, slab, middle, force_slab, force_middle)


def add_at(window, o, row):
    store(window, o, load(window, o) + row)


def flush_slab_1(window, o, row, rows):
    add_at(window, o, rows[0])


def flush_slab_2(window, o, row, rows):
    add_at(window, o, rows[0])
    add_at(window, o + row, rows[1])


def flush_slab_3(window, o, row, rows):
    add_at(window, o, rows[0])
    add_at(window, o + row, rows[1])
    add_at(window, o + 2 * row, rows[2])


def flush_slab_4(window, o, row, rows):
    flush_slab_3(window, o, row, rows)
    add_at(window, o + 3 * row, rows[3])


flush_slab = flush_slab_1


def flush_2(window, o, plane, row, rows):
    """Add the rows of a stencil to the window."""
    flush_slab(window, o, row, rows[0])
    flush_slab(window, o + plane, row, rows[1])


def flush_3(window, o, plane, row, rows):
    flush_slab(window, o, row, rows[0])
    flush_slab(window, o + plane, row, rows[1])
    flush_slab(window, o + 2 * plane, row, rows[2])


def flush_4(window, o, plane, row, rows):
    flush_3(window, o, plane, row, rows)
    flush_slab(window, o + 3 * plane, row, rows[3])


flush = flush_3


def store_column_2(table, at, A, axis):
    """Column `axis` of a matrix of lanes, as a quad."""
    zero = in_all_lanes(real(0.0))
    store_quads(table, at, A[axis], A[2 + axis], zero, zero)


def store_column_3(table, at, A, axis):
    store_quads(table, at, A[axis], A[3 + axis], A[6 + axis], in_all_lanes(real(0.0)))


def store_constant_2(table, at, p, mass):
    store_quads(table, at, p[0], p[1], in_all_lanes(real(0.0)), mass)


def store_constant_3(table, at, p, mass):
    store_quads(table, at, p[0], p[1], p[2], mass)


store_column, store_constant = store_column_2, store_constant_2


def cells_along(places, o, axis, base):
    """Position along an axis in cells."""
    return to_real(load(places, o + 16 * axis)) * UNIT + real(base)


def position_2(places, o, base, dx):
    """x of 16 particles in m, from the nodes where their places begin."""
    return (cells_along(places, o, 0, base[0]) * dx, cells_along(places, o, 1, base[1]) * dx)


def position_3(places, o, base, dx):
    return position_2(places, o, base, dx) + (cells_along(places, o, 2, base[2]) * dx,)


position_of = position_2


def along_first_2(value):
    """A vector along the first axis."""
    return (value, 0.0 * value)


def along_first_3(value):
    return (value, 0.0 * value, 0.0 * value)


along_first = along_first_2


def momentum_block(
    reals, o, table, mass, volume0, params, dt, dx, inv_dx, places, base, time, load_factor, count,
):  # fmt: skip
    """What the 16 particles of a block, of which the first `count` are there, give: quads of one vector per particle."""
    v = load_vector(reals, o + 16 * V_FIELD)
    if SHARED:
        share = load(reals, o + 16 * SHARE_FIELD)
        mass, volume0 = share * mass, share * volume0
    if IMPULSE:
        state = load_state(reals, o + 16 * STATE_FIELD)
        tau = law.kirchhoff_stress(state, params)
        if VISCOUS:
            tau = la.add_symmetric(tau, law.viscous_stress(state, load_matrix(reals, o + 16 * C_FIELD), params))
        before = v
        if FORCED:
            x, X = position_of(places, o, base, dx), load_vector(reals, o + 16 * REFERENCE_FIELD)
            b = body_force(x, X, time)
            v = la.add_scaled_vector(v, dt, b)
            store(table, FORCES, max(load(table, FORCES), where(lanes_below(count), la.dot(b, b), real(0.0))))
        if LOADED:
            v = la.add_scaled_vector(v, dt * load_factor, load_vector(reals, o + 16 * LOAD_FIELD))
        if DRIVEN:
            gain = 0.5 * mass * la.dot(la.add_scaled_vector(v, -1.0, before), la.add_scaled_vector(v, 1.0, before))
            store(table, WORKS, load(table, WORKS) + where(lanes_below(count), gain, real(0.0)))
    if DIVERGENCE:
        mass, v = volume0, along_first(load(reals, o + 16 * DIVERGENCE_FIELD))
    if VOLUMES:
        mass, v = volume0 * law.volume_ratio(load_state(reals, o + 16 * STATE_FIELD)), la.scale_vector(0.0, v)
    store_constant(table, QUAD_CONSTANT, la.scale_vector(mass, v), mass if SHARED or VOLUMES else in_all_lanes(mass))
    if AFFINE:
        M = transfer.affine_momentum(mass, load_matrix(reals, o + 16 * C_FIELD), dx)
        if MLS:
            M = la.add(M, transfer.stress_momentum(volume0 * dt, tau, inv_dx))
        store_column(table, QUAD_SLAB, M, SLAB)
        store_column(table, QUAD_ROW, M, ROW)
        if DIMENSIONS == 3:
            store_column(table, QUAD_MIDDLE, M, MIDDLE)
    if BY_GRADIENT:
        if VOLUMES:
            F = la.full(la.isotropic(mass))
        else:
            F = la.full(la.scale_plus_diagonal(-(volume0 * dt) * inv_dx, tau, 0.0))
        store_column(table, QUAD_F_SLAB, F, SLAB)
        store_column(table, QUAD_F_ROW, F, ROW)
        if DIMENSIONS == 3:
            store_column(table, QUAD_F_MIDDLE, F, MIDDLE)


def p2g(
    reals, places, segments, layer_start, first_layer, last_layer, table, windows, corner, folds, placed, placed_start, slots,
    nodes, unsummed, scratch, first_nodes, constants, dt, dx, inv_dx, layer_node, time, load_factor, works,
):  # fmt: skip
    """See loops.py for what the arguments are."""
    before = flush_denormals()
    values, where_from = reals.reshape(-1), places.reshape(-1)
    window_size = windows.shape[1] * windows.shape[2] * windows.shape[3] * 4
    row, plane = windows.shape[3] * 4, windows.shape[2] * windows.shape[3] * 4
    runs = 0
    for layer in range(first_layer, last_layer):
        number = (layer - first_layer) % windows.shape[0]
        window = windows.reshape(-1)[number * window_size : (number + 1) * window_size]
        rows, held = empty_stencil(), NOWHERE
        if DRIVEN:
            store(scratch, WORKS, in_all_lanes(real(0.0)))
        for s in range(layer_start[layer], layer_start[layer + 1]):
            block, left, body = segments[s, 0], segments[s, 1], segments[s, 2]
            mass, volume0, params = table[body, MASS_COLUMN], table[body, VOLUME_COLUMN], load_parameters(table, body)
            base = node_of_segment(layer_node + layer, segments[s, 3], segments[s, 4])
            while left > 0:
                o = block * (16 * FIELDS)
                place_block(
                    where_from, o, scratch, first_nodes, 0, segments[s, 3] - corner[0], segments[s, 4] - corner[1],
                    windows.shape[2] * windows.shape[3], windows.shape[3],
                )  # fmt: skip
                momentum_block(
                    values, o, scratch, mass, volume0, params, dt, dx, inv_dx, where_from, base, time, load_factor,
                    min(left, 16),
                )  # fmt: skip
                for lane in range(min(left, 16)):
                    for line in range(LINES):
                        prefetch(values, o + AHEAD * 16 * FIELDS + (lane * LINES + line) * LINE, False)
                    first = first_nodes[lane]
                    if first != held:
                        if held != NOWHERE:
                            flush(window, held, plane, row, rows)
                        rows, held = empty_stencil(), first
                        runs += 1
                    rows = scatter(rows, scratch, constants, lane)
                block += 1
                left -= 16
        if held != NOWHERE:
            flush(window, held, plane, row, rows)
        if DRIVEN:
            for lane in range(16):
                works[layer] += scratch[WORKS + lane]
        if folds:
            fold_layer(windows, number, layer, placed, placed_start, corner, slots, nodes, unsummed)
    restore_denormals(before)
    return runs


# ---- G2P -----------------------------------------------------------------------------------------------------------------


def gather_slab_1(nodes, o, row, table, lane):
    """(sum of w_m v_i, sum of w_m d_m v_i, sum of w'_m v_i) over the rows of a slab."""
    v = load(nodes, o)
    return v, v, v


def gather_slab_2(nodes, o, row, table, lane):
    at = MIDDLE_W + lane
    a, b = load(nodes, o), load(nodes, o + row)
    v = table[at] * a + table[at + 16] * b
    at += MIDDLE_E - MIDDLE_W
    e = table[at] * a + table[at + 16] * b
    if MLS:
        return v, e, v
    at += MIDDLE_D - MIDDLE_E
    return v, e, table[at] * a + table[at + 16] * b


def gather_slab_3(nodes, o, row, table, lane):
    at = MIDDLE_W + lane
    a, b, c = load(nodes, o), load(nodes, o + row), load(nodes, o + 2 * row)
    v = table[at] * a + table[at + 16] * b + table[at + 32] * c
    at += MIDDLE_E - MIDDLE_W
    e = table[at] * a + table[at + 16] * b + table[at + 32] * c
    if MLS:
        return v, e, v
    at += MIDDLE_D - MIDDLE_E
    return v, e, table[at] * a + table[at + 16] * b + table[at + 32] * c


def gather_slab_4(nodes, o, row, table, lane):
    v, e, f = gather_slab_3(nodes, o, row, table, lane)
    d, at = load(nodes, o + 3 * row), MIDDLE_W + 48 + lane
    v = v + table[at] * d
    e = e + table[at + (MIDDLE_E - MIDDLE_W)] * d
    if MLS:
        return v, e, v
    return v, e, f + table[at + (MIDDLE_D - MIDDLE_W)] * d


gather_slab = gather_slab_1


def gather_from(sums, nodes, o, row, table, lane, i):
    """Add slab i to (v, B along slab, B along middle, gradient along slab, gradient along middle), all but the row's part."""
    s, e, f = gather_slab(nodes, o, row, table, lane)
    w = table[SLAB_W + 16 * i + lane]
    v, B_slab, B_middle, L_slab, L_middle = sums
    v = v + w * s
    B_slab = B_slab + table[SLAB_E + 16 * i + lane] * s
    if DIMENSIONS == 3:
        B_middle = B_middle + w * e
    if not MLS:
        L_slab = L_slab + table[SLAB_D + 16 * i + lane] * s
        if DIMENSIONS == 3:
            L_middle = L_middle + w * f
    return v, B_slab, B_middle, L_slab, L_middle


def gather_slabs_2(sums, nodes, o, plane, row, table, lane):
    sums = gather_from(sums, nodes, o, row, table, lane, 0)
    return gather_from(sums, nodes, o + plane, row, table, lane, 1)


def gather_slabs_3(sums, nodes, o, plane, row, table, lane):
    sums = gather_from(sums, nodes, o, row, table, lane, 0)
    sums = gather_from(sums, nodes, o + plane, row, table, lane, 1)
    return gather_from(sums, nodes, o + 2 * plane, row, table, lane, 2)


def gather_slabs_4(sums, nodes, o, plane, row, table, lane):
    sums = gather_slabs_3(sums, nodes, o, plane, row, table, lane)
    return gather_from(sums, nodes, o + 3 * plane, row, table, lane, 3)


gather_slabs = gather_slabs_3


def gather(nodes, o, plane, row, table, constants, lane):
    """Sums over the stencil of one particle: (v | B along slab | middle | row), and the gradient likewise, into scratch.

    Without an affine field from sums, (v | gradient) alone.
    """
    g = in_all_lanes(table[ROW_G + lane])
    zero = in_all_lanes(real(0.0))
    v, B_slab, B_middle, L_slab, L_middle = gather_slabs(
        (zero, zero, zero, zero, zero), nodes, o, plane, row, table, lane
    )
    t = g - load(constants, ROW_ORIGIN)
    w = row_weights(constants, ROW_WEIGHT, t)
    if BY_INERTIA:
        B_row = w * v * (load(constants, ROW_DISTANCE) - g)
        if DIMENSIONS == 3:
            store(table, GATHERED + 16 * lane, sum_nodes(w * v, w * B_slab, w * B_middle, B_row))
        else:
            store(table, GATHERED + 16 * lane, sum_nodes(w * v, w * B_slab, zero, B_row))
    if not MLS:
        L_row, first = row_weights(constants, ROW_SLOPE, t) * v, zero if BY_INERTIA else w * v
        if DIMENSIONS == 3:
            store(table, GRADIENTS + 16 * lane, sum_nodes(first, w * L_slab, w * L_middle, L_row))
        else:
            store(table, GRADIENTS + 16 * lane, sum_nodes(first, w * L_slab, zero, L_row))


def gather_velocity(nodes, o, plane, row, table, constants, lane, column):
    """The sum of velocities alone, into a column of scratch."""
    zero = in_all_lanes(real(0.0))
    sums = gather_slabs((zero, zero, zero, zero, zero), nodes, o, plane, row, table, lane)
    w = row_weights(constants, ROW_WEIGHT, in_all_lanes(table[ROW_G + lane]) - load(constants, ROW_ORIGIN))
    store(table, column + 16 * lane, sum_nodes(w * sums[0], zero, zero, zero))


GROUP = (1, 3, 0)  # of a physical axis, the group of a gathered row: 1 slab, 2 middle, 3 row


def vector_2(columns):
    return (columns[0], columns[1])


def vector_3(columns):
    return (columns[0], columns[1], columns[2])


def matrix_2(columns):
    x, y = 4 * GROUP[0], 4 * GROUP[1]
    return (columns[x], columns[y], columns[x + 1], columns[y + 1])


def matrix_3(columns):
    x, y, z = 4 * GROUP[0], 4 * GROUP[1], 4 * GROUP[2]
    return (
        columns[x],
        columns[y],
        columns[z],
        columns[x + 1],
        columns[y + 1],
        columns[z + 1],
        columns[x + 2],
        columns[y + 2],
        columns[z + 2],
    )


vector_of, matrix_of = vector_2, matrix_2


def size_of(place):
    return where(place < 0, -place, place)


def largest_part_2(v):
    """The largest component of a vector, by size."""
    return max(abs(v[0]), abs(v[1]))


def largest_part_3(v):
    return max(max(abs(v[0]), abs(v[1])), abs(v[2]))


largest_part = largest_part_2


def g2p(
    reals, places, segments, layer_start, first_layer, last_layer, table, nodes, nodes_before, blend, nodes_divergence,
    spans, row_start, first_quads, corner, rings, layer_node, limits, ends, scratch, first_nodes, constants, dt, dx, inv_dx,
    failure,
):  # fmt: skip
    """See loops.py for what the arguments are and what is returned."""
    before = flush_denormals()
    values, where_from = reals.reshape(-1), places.reshape(-1)
    ring, ring_before, ring_divergence = rings[0], rings[BEFORE_RING], rings[DIVERGENCE_RING]
    grid, grid_before, grid_divergence = ring.reshape(-1), ring_before.reshape(-1), ring_divergence.reshape(-1)
    row, plane = ring.shape[2] * 4, ring.shape[1] * ring.shape[2] * 4
    unfolded = first_layer
    speeds = waves = strains = steps = in_all_lanes(real(0.0))
    drifts = in_all_lanes(integer(0))
    for layer in range(first_layer, last_layer):
        if layer_start[layer] == layer_start[layer + 1]:
            continue
        unfold(nodes, unfolded, layer, spans, row_start, first_quads, corner, ring)
        if BLENDS:
            unfold(nodes_before, unfolded, layer, spans, row_start, first_quads, corner, ring_before)
        if F_BAR:
            unfold(nodes_divergence, unfolded, layer, spans, row_start, first_quads, corner, ring_divergence)
        unfolded = layer + WINDOW
        low_slab = place_at(limits[SLAB, 0] - 64 * (layer_node + layer))
        high_slab = place_at(limits[SLAB, 1] - 64 * (layer_node + layer))
        for s in range(layer_start[layer], layer_start[layer + 1]):
            block, left, body = segments[s, 0], segments[s, 1], segments[s, 2]
            params, density = load_parameters(table, body), table[body, DENSITY_COLUMN]
            low_row, high_row = (
                place_at(limits[ROW, 0] - 64 * segments[s, 4]),
                place_at(limits[ROW, 1] - 64 * segments[s, 4]),
            )
            if DIMENSIONS == 3:
                low_middle = place_at(limits[MIDDLE, 0] - 64 * segments[s, 3])
                high_middle = place_at(limits[MIDDLE, 1] - 64 * segments[s, 3])
            while left > 0:
                o = block * (16 * FIELDS)
                count = min(left, 16)
                place_block(
                    where_from, o, scratch, first_nodes, layer % WINDOW, segments[s, 3] - corner[0],
                    segments[s, 4] - corner[1], ring.shape[1] * ring.shape[2], ring.shape[2],
                )  # fmt: skip
                for lane in range(count):
                    for line in range(LINES):
                        prefetch(values, o + AHEAD * 16 * FIELDS + (lane * LINES + line) * LINE, True)
                    first = first_nodes[lane]
                    gather(grid, first, plane, row, scratch, constants, lane)
                    if BLENDS:
                        gather_velocity(grid_before, first, plane, row, scratch, constants, lane, BEFORE)
                    if F_BAR:
                        gather_velocity(grid_divergence, first, plane, row, scratch, constants, lane, DIVERGENCES)
                nothing = in_all_lanes(real(0.0))
                for lane in range(count, 16):  # what fills up a block stays where it is, unchanged
                    if BY_INERTIA:
                        store(scratch, GATHERED + 16 * lane, nothing)
                    if not MLS:
                        store(scratch, GRADIENTS + 16 * lane, nothing)
                    if BLENDS:
                        store(scratch, BEFORE + 16 * lane, nothing)
                    if F_BAR:
                        store(scratch, DIVERGENCES + 16 * lane, nothing)
                live = lanes_below(count)
                if BY_INERTIA:
                    columns = load_transposed(scratch, GATHERED)
                    C = la.scale(INERTIA * inv_dx, matrix_of(columns))
                    if MLS:
                        G = la.scale(dt, C)
                    else:
                        G = la.scale(dt * inv_dx, matrix_of(load_transposed(scratch, GRADIENTS)))
                else:
                    columns = load_transposed(scratch, GRADIENTS)
                    C = la.scale(inv_dx, matrix_of(columns))
                    G = la.scale(dt * inv_dx, matrix_of(columns))
                v = vector_of(columns)
                if F_BAR:
                    G = transfer.with_divergence(G, dt * load_transposed(scratch, DIVERGENCES)[0])
                state = law.advance(load_state(values, o + 16 * STATE_FIELD), G, dt, params)
                step = la.scale_vector(dt * inv_dx, v)
                if BLENDS:
                    old = vector_of(load_transposed(scratch, BEFORE))
                    v = transfer.blend_velocity(v, load_vector(values, o + 16 * V_FIELD), old, blend)
                put(values, o + 16 * V_FIELD, v)
                if STORES_C:
                    put(values, o + 16 * C_FIELD, C)
                put(values, o + 16 * STATE_FIELD, state)

                steps = max(steps, where(live, largest_part(step), real(0.0)))
                steady = la.within(step, 1.0)
                slab = moved(where_from, o, SLAB, step)
                along_row = moved(where_from, o, ROW, step)
                far = size_of(slab - CENTRE)
                near = far <= place_at(FARTHEST)
                inside = (slab >= low_slab) & (slab <= high_slab) & (along_row >= low_row) & (along_row <= high_row)
                if ENDS_ROW:
                    far = max(far, beyond(along_row, place_at(ends[ROW, 0] - 64 * segments[s, 4]),
                                          place_at(ends[ROW, 1] - 64 * segments[s, 4])))  # fmt: skip
                if DIMENSIONS == 3:
                    middle = moved(where_from, o, MIDDLE, step)
                    inside = inside & (middle >= low_middle) & (middle <= high_middle)
                    if ENDS_MIDDLE:
                        far = max(far, beyond(middle, place_at(ends[MIDDLE, 0] - 64 * segments[s, 3]),
                                              place_at(ends[MIDDLE, 1] - 64 * segments[s, 3])))  # fmt: skip
                valid = law.valid(state)
                fine = steady & near & inside & valid
                if any_of(~fine & live):
                    cause = where(valid, real(0.0), real(CAUSE_STATE))
                    cause = where(inside, cause, real(CAUSE_LEFT))
                    cause = where(steady & near, cause, real(CAUSE_POSITION))
                    store(scratch, CAUSES, cause)
                    slab = where(fine, slab, load(where_from, o + 16 * SLAB))
                    along_row = where(fine, along_row, load(where_from, o + 16 * ROW))
                    if DIMENSIONS == 3:
                        middle = where(fine, middle, load(where_from, o + 16 * MIDDLE))
                    for lane in range(count):
                        if scratch[CAUSES + lane] != 0.0 and failure[0] == 0:
                            failure[0], failure[1], failure[2] = int(scratch[CAUSES + lane]), block, lane
                store(where_from, o + 16 * SLAB, slab)
                store(where_from, o + 16 * ROW, along_row)
                if DIMENSIONS == 3:
                    store(where_from, o + 16 * MIDDLE, middle)
                speeds = max(speeds, where(live, la.dot(v, v), real(0.0)))
                waves = max(
                    waves, where(live, stability.signal_speed_squared(state, params, density, inv_dx), real(0.0))
                )
                strains = max(strains, where(live, la.norm_squared(G), real(0.0)))
                drifts = max(drifts, where(live, far, 0))
                block += 1
                left -= 16
    restore_denormals(before)
    drift = real(largest_lane(drifts)) * UNIT
    return largest_lane(speeds), largest_lane(waves), drift, largest_lane(strains), largest_lane(steps)


def measure_divergence(
    reals, places, segments, layer_start, first_layer, last_layer, nodes, spans, row_start, first_quads, corner, rings,
    scratch, first_nodes, constants, inv_dx,
):  # fmt: skip
    """Let particles of some layers keep the divergence of the velocity."""
    before = flush_denormals()
    ring = rings[0]
    values, where_from, grid = reals.reshape(-1), places.reshape(-1), ring.reshape(-1)
    row, plane = ring.shape[2] * 4, ring.shape[1] * ring.shape[2] * 4
    unfolded = first_layer
    for layer in range(first_layer, last_layer):
        if layer_start[layer] == layer_start[layer + 1]:
            continue
        unfold(nodes, unfolded, layer, spans, row_start, first_quads, corner, ring)
        unfolded = layer + WINDOW
        for s in range(layer_start[layer], layer_start[layer + 1]):
            block, left = segments[s, 0], segments[s, 1]
            while left > 0:
                o = block * (16 * FIELDS)
                count = min(left, 16)
                place_block(
                    where_from, o, scratch, first_nodes, layer % WINDOW, segments[s, 3] - corner[0],
                    segments[s, 4] - corner[1], ring.shape[1] * ring.shape[2], ring.shape[2],
                )  # fmt: skip
                for lane in range(count):
                    gather(grid, first_nodes[lane], plane, row, scratch, constants, lane)
                for lane in range(count, 16):
                    store(scratch, GRADIENTS + 16 * lane, in_all_lanes(real(0.0)))
                L = matrix_of(load_transposed(scratch, GRADIENTS))
                store(values, o + 16 * DIVERGENCE_FIELD, la.trace(L) * inv_dx)
                block += 1
                left -= 16
    restore_denormals(before)


def moved(places, o, axis, step):
    """The place along an axis after a step in cells, rounded to the nearest."""
    whole = floor(step[axis] * ONE_CELL + 0.5)
    return load(places, o + 16 * axis) + to_integer(where(abs(whole) <= ONE_CELL, whole, 0.0))


def beyond(place, low, high):
    """How far a place is outside low .. high, plus the drift of a settled particle.

    Nothing is subtracted that is not outside: differences of places far apart do not fit into their integers.
    """
    outside = where(place < low, low - place, where(place > high, place - high, 0))
    return outside + place_at(SETTLED)
