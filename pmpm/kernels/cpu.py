"""Scalar loops of P2G, node update and G2P on the CPU: the readable reference.

A law's particles lie in `reals[block, field, lane]`, 16 lanes a block, fields x (offset from the home node, in cells), v, C,
state. A block holds particles of one layer and one row of `table`; `home[block, lane]` packs the home node's place in its
plane (middle << 16 | row in 3-D). The grid is `nodes[plane, middle, row, (p_x, p_y, p_z, mass)]`.
Array axes (slab, middle, row) are the physical axes SLAB, MIDDLE, ROW.
"""

from pmpm.physics import boundary, transfer
from pmpm.physics import tensors2 as la
from pmpm.physics.bspline import slopes_quadratic as slopes
from pmpm.physics.bspline import weights_quadratic as weights
from pmpm.physics.materials import neo_hookean as law
from pmpm.physics.words import floor

real = float
DIMENSIONS, SLAB, MIDDLE, ROW = 2, 0, -1, 1
NODES, MIDDLE_NODES, PADDING, ROUND, INERTIA = 3, 1, 1, 0.5, 4.0
OFFSETS = (-1.0, 0.0, 1.0)  # of the stencil's nodes from its centre node, in cells
MLS = False
V_FIELD, C_FIELD, STATE_FIELD = 2, 4, 8
MASS_COLUMN, VOLUME_COLUMN, DENSITY_COLUMN, PARAMETER_COLUMN = 0, 1, 2, 3
FARTHEST = 1.484375  # drift from the home node, in cells, that keeps a stencil inside its layer's padded planes
CAUSE_POSITION, CAUSE_STATE, CAUSE_LEFT = 1, 2, 3  # why a particle stops the run
wall, image, TWO_SIDED = boundary.wall_stick, boundary.image_reversed, True


# ---- flat tuples of reals, field by field -----------------------------------------------------------------------------


def load_1(a, b, f, lane):
    return (a[b, f, lane],)


def load_2(a, b, f, lane):
    return (a[b, f, lane], a[b, f + 1, lane])


def load_3(a, b, f, lane):
    return (a[b, f, lane], a[b, f + 1, lane], a[b, f + 2, lane])


def load_4(a, b, f, lane):
    return load_2(a, b, f, lane) + load_2(a, b, f + 2, lane)


def load_6(a, b, f, lane):
    return load_3(a, b, f, lane) + load_3(a, b, f + 3, lane)


def load_7(a, b, f, lane):
    return load_6(a, b, f, lane) + load_1(a, b, f + 6, lane)


def load_9(a, b, f, lane):
    return load_6(a, b, f, lane) + load_3(a, b, f + 6, lane)


LOADS = {1: load_1, 2: load_2, 3: load_3, 4: load_4, 6: load_6, 7: load_7, 9: load_9}
load_vector, load_matrix, load_state = load_2, load_4, load_4


def store(a, b, f, lane, values):
    for i in range(len(values)):
        a[b, f + i, lane] = values[i]


def row_1(table, row):
    return (table[row, PARAMETER_COLUMN],)


def row_2(table, row):
    return (table[row, PARAMETER_COLUMN], table[row, PARAMETER_COLUMN + 1])


def row_3(table, row):
    return row_2(table, row) + (table[row, PARAMETER_COLUMN + 2],)


def row_4(table, row):
    return row_3(table, row) + (table[row, PARAMETER_COLUMN + 3],)


ROWS = {1: row_1, 2: row_2, 3: row_3, 4: row_4}
load_parameters = row_2


# ---- where a particle stands in its stencil ----------------------------------------------------------------------------


def centres_2(x):
    return (floor(x[0] + ROUND), floor(x[1] + ROUND))


def centres_3(x):
    return (floor(x[0] + ROUND), floor(x[1] + ROUND), floor(x[2] + ROUND))


def along_axes_2(function, g):
    return (function(g[0]), function(g[1]))


def along_axes_3(function, g):
    return (function(g[0]), function(g[1]), function(g[2]))


def node_of_axis(axis, a, b, c):
    """Of the stencil node (a, b, c) along (slab, middle, row), its number along a physical axis."""
    return a if axis == SLAB else (b if axis == MIDDLE else c)


def stencil_node_2(w, dw, g, a, b, c):
    """(weight, distance, slope) of one node of a 2-D stencil; the slope is a dead value where no transfer asks for it."""
    i, j = node_of_axis(0, a, b, c), node_of_axis(1, a, b, c)
    return w[0][i] * w[1][j], (OFFSETS[i] - g[0], OFFSETS[j] - g[1]), (dw[0][i] * w[1][j], w[0][i] * dw[1][j])


def stencil_node_3(w, dw, g, a, b, c):
    """(weight, distance, slope) of one node of a 3-D stencil."""
    i, j, k = node_of_axis(0, a, b, c), node_of_axis(1, a, b, c), node_of_axis(2, a, b, c)
    wij = w[0][i] * w[1][j]
    slope = (dw[0][i] * w[1][j] * w[2][k], w[0][i] * dw[1][j] * w[2][k], wij * dw[2][k])
    return wij * w[2][k], (OFFSETS[i] - g[0], OFFSETS[j] - g[1], OFFSETS[k] - g[2]), slope


def momentum_2(nodes, i, j, k):
    return (nodes[i, j, k, 0], nodes[i, j, k, 1])


def momentum_3(nodes, i, j, k):
    return (nodes[i, j, k, 0], nodes[i, j, k, 1], nodes[i, j, k, 2])


centres, along_axes, stencil_node, momentum_at = centres_2, along_axes_2, stencil_node_2, momentum_2


def home_row(packed):
    return packed & 0xFFFF if DIMENSIONS == 3 else packed


def home_middle(packed):
    return packed >> 16 if DIMENSIONS == 3 else 0


def zero_vector(x):
    return la.scale_vector(0.0, x)


# ---- P2G ---------------------------------------------------------------------------------------------------------------


def p2g(reals, home, block_row, block_count, layer_start, first_layer, last_layer, table, windows, dt, dx, inv_dx):
    """Add the particles of layers first_layer .. last_layer - 1 (counted from this rank's first), one after another, to
    the planes each layer can touch: windows[layer - first_layer]."""
    for layer in range(first_layer, last_layer):
        window = windows[layer - first_layer]
        for block in range(layer_start[layer], layer_start[layer + 1]):
            row = block_row[block]
            mass, volume0, params = table[row, MASS_COLUMN], table[row, VOLUME_COLUMN], load_parameters(table, row)
            minus_impulse = -(volume0 * dt) * inv_dx
            for lane in range(block_count[block]):
                x = load_vector(reals, block, 0, lane)
                centre = centres(x)
                g = la.add_scaled_vector(x, -1.0, centre)
                w, dw = along_axes(weights, g), along_axes(slopes, g)
                tau = law.kirchhoff_stress(load_state(reals, block, STATE_FIELD, lane), params)
                C = load_matrix(reals, block, C_FIELD, lane)
                A, S = transfer.momentum_matrix(mass, C, volume0 * dt, tau, dx, inv_dx)
                momentum = la.scale_vector(mass, load_vector(reals, block, V_FIELD, lane))
                packed = home[block, lane]
                i0 = int(centre[SLAB]) + PADDING
                j0 = home_middle(packed) + (int(centre[MIDDLE]) + PADDING if DIMENSIONS == 3 else 0)
                k0 = home_row(packed) + int(centre[ROW]) + PADDING
                for a in range(NODES):
                    for b in range(MIDDLE_NODES):
                        for c in range(NODES):
                            weight, d, slope = stencil_node(w, dw, g, a, b, c)
                            given = transfer.node_momentum(weight, d, slope, momentum, A, S, minus_impulse)
                            for q in range(DIMENSIONS):
                                window[i0 + a, j0 + b, k0 + c, q] += given[q]
                            window[i0 + a, j0 + b, k0 + c, 3] += weight * mass


def fold_windows(windows, first_layer, last_layer, targets, nodes, unsummed):
    """Add each layer's planes, layer after layer, to the nodes; clear them for the next use.

    targets[layer, k] >= 0 is the plane of `nodes`; below zero, -1 - slot is a plane kept unsummed for the rank that sums
    before this one at a cut.
    """
    for layer in range(first_layer, last_layer):
        window = windows[layer - first_layer]
        for k in range(window.shape[0]):
            plane = targets[layer, k]
            to = nodes[plane] if plane >= 0 else unsummed[-1 - plane]
            for i in range(window.shape[1]):
                for j in range(window.shape[2]):
                    for q in range(4):
                        to[i, j, q] += window[k, i, j, q]
                        window[k, i, j, q] = 0.0


# ---- nodes -------------------------------------------------------------------------------------------------------------


def add_gravity(nodes, first_plane, last_plane, velocity_gain):
    """Momentum gains mass times dt times gravity, on planes first_plane .. last_plane - 1."""
    for i in range(first_plane, last_plane):
        for j in range(nodes.shape[1]):
            for k in range(nodes.shape[2]):
                for q in range(DIMENSIONS):
                    nodes[i, j, k, q] += nodes[i, j, k, 3] * velocity_gain[q]


def divide_by_mass(nodes, first_plane, last_plane):
    """Momentum -> velocity; nodes without mass are at rest."""
    for i in range(first_plane, last_plane):
        for j in range(nodes.shape[1]):
            for k in range(nodes.shape[2]):
                mass = nodes[i, j, k, 3]
                inverse = real(1.0) / mass if mass > 0.0 else real(0.0)
                for q in range(DIMENSIONS):
                    nodes[i, j, k, q] *= inverse


def put_vector(nodes, i, j, k, v):
    for q in range(DIMENSIONS):
        nodes[i, j, k, q] = v[q]


def apply_wall(nodes, i0, i1, j0, j1, k0, k1, di, dj, dk, normal, coefficient):
    """One face, on momenta: nodes i0 .. i1 - 1, ... are those beyond it, one step (di, dj, dk) leads to the node on it.

    A wall that may be left mirrors only where material presses on it and the wall as a whole pushes; elsewhere the rule
    acts on the nodes on and beyond it. A mirrored node beyond is left without mass.
    """
    n = load_normal(normal)
    none = real(0.0)
    for i in range(i0, i1):
        for j in range(j0, j1):
            for k in range(k0, k1):
                on = momentum_at(nodes, i + di, j + dj, k + dk)
                mass_beyond = nodes[i, j, k, 3]
                pressed = none
                if mass_beyond > 0.0:
                    beyond = momentum_at(nodes, i, j, k)
                    i2, j2, k2 = i + 2 * di, j + 2 * dj, k + 2 * dk
                    inner, mass_inner = momentum_at(nodes, i2, j2, k2), nodes[i2, j2, k2, 3]
                    impulse = boundary.mirror_impulse(beyond, mass_beyond, inner, mass_inner, n)
                    normal_on = la.dot(on, n)
                    if TWO_SIDED or (normal_on < 0.0 and normal_on + impulse <= 0.0):
                        put_vector(nodes, i2, j2, k2, la.add_scaled_vector(inner, 1.0, image(beyond, n)))
                        nodes[i2, j2, k2, 3] = mass_inner + mass_beyond
                        put_vector(nodes, i, j, k, la.scale_vector(none, beyond))
                        nodes[i, j, k, 3] = none
                        pressed = -impulse
                    else:
                        put_vector(nodes, i, j, k, wall(beyond, n, coefficient, none))
                put_vector(nodes, i + di, j + dj, k + dk, wall(on, n, coefficient, pressed))


def fill_beyond_wall(nodes, i0, i1, j0, j1, k0, k1, di, dj, dk, normal):
    """Nodes beyond one face that were mirrored move as the image of the inner ones."""
    n = load_normal(normal)
    for i in range(i0, i1):
        for j in range(j0, j1):
            for k in range(k0, k1):
                if nodes[i, j, k, 3] == 0.0:
                    v = momentum_at(nodes, i + 2 * di, j + 2 * dj, k + 2 * dk)
                    put_vector(nodes, i, j, k, image(v, n))


def normal_2(normal):
    return (normal[0], normal[1])


def normal_3(normal):
    return (normal[0], normal[1], normal[2])


load_normal = normal_2


# ---- G2P ---------------------------------------------------------------------------------------------------------------


def leaves(centre, g, low, high, low_edge, high_edge):
    """Whether a particle at `g` from node `centre` of an axis is beyond its first or last node by more than the edges."""
    return (centre < low) | (centre > high) | ((centre == low) & (g < low_edge)) | ((centre == high) & (g > high_edge))


def g2p(
    reals, home, block_row, block_count, layer_start, first_layer, last_layer, table, nodes,
    layer_node, limits, edges, dt, dx, inv_dx, failure,
):  # fmt: skip
    """Gather velocity and its gradient, advance state and position of layers first_layer .. last_layer - 1.

    `layer_node` is the global number of this rank's first layer; `limits[axis]` first and last allowed centre node,
    `edges[axis]` how far beyond them. The first particle that fails is written to `failure` (cause, block, lane) and keeps
    its position. Returns the maxima (speed^2, wave speed^2, drift in cells).
    """
    speed_squared, wave_squared, drift = real(0.0), real(0.0), real(0.0)
    for layer in range(first_layer, last_layer):
        for block in range(layer_start[layer], layer_start[layer + 1]):
            row = block_row[block]
            params, density = load_parameters(table, row), table[row, DENSITY_COLUMN]
            for lane in range(block_count[block]):
                x = load_vector(reals, block, 0, lane)
                centre = centres(x)
                g = la.add_scaled_vector(x, -1.0, centre)
                w, dw = along_axes(weights, g), along_axes(slopes, g)
                packed = home[block, lane]
                i0 = layer + int(centre[SLAB]) + PADDING
                j0 = home_middle(packed) + (int(centre[MIDDLE]) + PADDING if DIMENSIONS == 3 else 0)
                k0 = home_row(packed) + int(centre[ROW]) + PADDING
                v = zero_vector(x)
                B = la.scale(0.0, load_matrix(reals, block, C_FIELD, lane))
                L = B
                for a in range(NODES):
                    for b in range(MIDDLE_NODES):
                        for c in range(NODES):
                            weight, d, slope = stencil_node(w, dw, g, a, b, c)
                            v_node = momentum_at(nodes, i0 + a, j0 + b, k0 + c)
                            v = transfer.gather_velocity(v, weight, v_node)
                            B = transfer.gather_affine(B, weight, v_node, d)
                            if not MLS:
                                L = transfer.gather_gradient(L, v_node, slope)
                C = la.scale(INERTIA * inv_dx, B)
                G = la.scale(dt, C) if MLS else la.scale(dt * inv_dx, L)
                state = law.advance(load_state(reals, block, STATE_FIELD, lane), G, params)
                x_new = la.add_scaled_vector(x, dt * inv_dx, v)

                farthest = la.largest_entry(x_new)
                cause = 0
                if not law.valid(state):
                    cause = CAUSE_STATE
                if la.within(x_new, FARTHEST):
                    centre = centres(x_new)
                    g = la.add_scaled_vector(x_new, -1.0, centre)
                    left = leaves(layer_node + layer + int(centre[SLAB]), g[SLAB], limits[SLAB, 0], limits[SLAB, 1],
                                  edges[SLAB, 0], edges[SLAB, 1])  # fmt: skip
                    left |= leaves(home_row(packed) + int(centre[ROW]), g[ROW], limits[ROW, 0], limits[ROW, 1],
                                   edges[ROW, 0], edges[ROW, 1])  # fmt: skip
                    if DIMENSIONS == 3:
                        left |= leaves(home_middle(packed) + int(centre[MIDDLE]), g[MIDDLE], limits[MIDDLE, 0],
                                       limits[MIDDLE, 1], edges[MIDDLE, 0], edges[MIDDLE, 1])  # fmt: skip
                    if left:
                        cause = CAUSE_LEFT
                else:
                    cause = CAUSE_POSITION
                if cause != 0:
                    x_new = x
                    if failure[0] == 0:
                        failure[0], failure[1], failure[2] = cause, block, lane

                store(reals, block, 0, lane, x_new)
                store(reals, block, V_FIELD, lane, v)
                store(reals, block, C_FIELD, lane, C)
                store(reals, block, STATE_FIELD, lane, state)
                speed_squared = max(speed_squared, la.dot(v, v))
                wave_squared = max(wave_squared, law.wave_speed_squared(state, params, density))
                drift = max(drift, farthest)
    return speed_squared, wave_squared, drift
