"""P2G and G2P, particle after particle and node after node: the readable reference, and what runs where lanes do not pay.

Arguments and results are explained in loops.py.
"""

from pmpm.kernels import loops
from pmpm.kernels.lanes import flush_denormals, restore_denormals
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
    centre_of,
    fold_layer,
    load_normal,
    load_parameters,
    node_of_axis,
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
NODES, MIDDLE_NODES, WINDOW, INERTIA = 3, 1, 5, 4.0
BEFORE_RING = DIVERGENCE_RING = 0  # among the rings
CENTRE, UNIT, ONE_CELL = 0, 2.0**-52, 2.0**52
OFFSETS = (-1.0, 0.0, 1.0)  # of the stencil's nodes from its centre node, in cells
AFFINE, BY_INERTIA, MLS, BLENDS, IMPULSE, STORES_C = True, True, False, False, True, True  # see lane_loops
VOLUMES = DIVERGENCE = F_BAR = VISCOUS = FORCED = LOADED = DRIVEN = ENDS_MIDDLE = ENDS_ROW = SHARED = False
V_FIELD, C_FIELD, REFERENCE_FIELD, LOAD_FIELD, STATE_FIELD = 2, 4, 8, 8, 8
BY_GRADIENT, DIVERGENCE_FIELD, SHARE_FIELD = True, 8, 8
body_force, along_first = loops.no_force, None


# ---- flat tuples, field by field ----------------------------------------------------------------------------------------


def load_1(a, b, f, lane):
    return (a[b, f, lane],)


def load_2(a, b, f, lane):
    return (a[b, f, lane], a[b, f + 1, lane])


def load_3(a, b, f, lane):
    return (a[b, f, lane], a[b, f + 1, lane], a[b, f + 2, lane])


def load_4(a, b, f, lane):
    return load_2(a, b, f, lane) + load_2(a, b, f + 2, lane)


def load_5(a, b, f, lane):
    return load_4(a, b, f, lane) + load_1(a, b, f + 4, lane)


def load_6(a, b, f, lane):
    return load_4(a, b, f, lane) + load_2(a, b, f + 4, lane)


def load_7(a, b, f, lane):
    return load_4(a, b, f, lane) + load_3(a, b, f + 4, lane)


def load_8(a, b, f, lane):
    return load_4(a, b, f, lane) + load_4(a, b, f + 4, lane)


def load_9(a, b, f, lane):
    return load_8(a, b, f, lane) + load_1(a, b, f + 8, lane)


def load_10(a, b, f, lane):
    return load_8(a, b, f, lane) + load_2(a, b, f + 8, lane)


def load_11(a, b, f, lane):
    return load_8(a, b, f, lane) + load_3(a, b, f + 8, lane)


def load_12(a, b, f, lane):
    return load_8(a, b, f, lane) + load_4(a, b, f + 8, lane)


def load_13(a, b, f, lane):
    return load_12(a, b, f, lane) + load_1(a, b, f + 12, lane)


def load_14(a, b, f, lane):
    return load_12(a, b, f, lane) + load_2(a, b, f + 12, lane)


def load_15(a, b, f, lane):
    return load_12(a, b, f, lane) + load_3(a, b, f + 12, lane)


def load_16(a, b, f, lane):
    return load_12(a, b, f, lane) + load_4(a, b, f + 12, lane)


# By how many there are: a loop would have to make a tuple of unknown length.
FIELD_TUPLES = dict(enumerate((load_1, load_2, load_3, load_4, load_5, load_6, load_7, load_8, load_9, load_10, load_11,
                               load_12, load_13, load_14, load_15, load_16), 1))  # fmt: skip
load_vector, load_matrix, load_state = load_2, load_4, load_4


def store(a, b, f, lane, values):
    for i in range(len(values)):
        a[b, f + i, lane] = values[i]


def vector_at_2(ring, i, j, k):
    return (ring[i, j, k, 0], ring[i, j, k, 1])


def vector_at_3(ring, i, j, k):
    return (ring[i, j, k, 0], ring[i, j, k, 1], ring[i, j, k, 2])


vector_at = vector_at_2


# ---- where a particle stands in its stencil ----------------------------------------------------------------------------


def offset_of(place):
    """Distance from the centre node in cells."""
    return real(place - (centre_of(place) << FRACTION)) * UNIT


def cells_of(place):
    """Distance from the base node in cells."""
    return real(place) * UNIT


def cells_to_metres_2(cells, base, dx):
    return ((cells[0] + real(base[0])) * dx, (cells[1] + real(base[1])) * dx)


def cells_to_metres_3(cells, base, dx):
    return ((cells[0] + real(base[0])) * dx, (cells[1] + real(base[1])) * dx, (cells[2] + real(base[2])) * dx)


cells_to_metres = cells_to_metres_2


def along_axes_2(function, u):
    return (function(u[0]), function(u[1]))


def along_axes_3(function, u):
    return (function(u[0]), function(u[1]), function(u[2]))


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


along_axes, stencil_node = along_axes_2, stencil_node_2


# ---- P2G ----------------------------------------------------------------------------------------------------------------


def carried(reals, block, lane, place, mass, volume0, params, base, dt, dx, inv_dx, time, load_factor):
    """What a particle brings to the nodes: (mass or what else is counted, momentum, affine momentum, stress, |b|^2 of the body
    force, work of what drives it in J). What a scene does not ask for is a dead value."""
    v = load_vector(reals, block, V_FIELD, lane)
    if SHARED:
        share = reals[block, SHARE_FIELD, lane]
        mass, volume0 = share * mass, share * volume0
    counted, force, work = mass, real(0.0), real(0.0)
    if IMPULSE:
        state = load_state(reals, block, STATE_FIELD, lane)
        tau = law.kirchhoff_stress(state, params)
        if VISCOUS:
            tau = la.add_symmetric(tau, law.viscous_stress(state, load_matrix(reals, block, C_FIELD, lane), params))
        before_forces = v
        if FORCED:
            x = cells_to_metres(along_axes(cells_of, place), base, dx)
            b = body_force(x, load_vector(reals, block, REFERENCE_FIELD, lane), time)
            v = la.add_scaled_vector(v, dt, b)
            force = la.dot(b, b)
        if LOADED:
            v = la.add_scaled_vector(v, dt * load_factor, load_vector(reals, block, LOAD_FIELD, lane))
        if DRIVEN:
            gained = la.add_scaled_vector(v, -1.0, before_forces)
            work = 0.5 * mass * la.dot(gained, la.add_scaled_vector(v, 1.0, before_forces))
    else:
        tau = v
    if DIVERGENCE:
        counted, v = volume0, along_first(reals[block, DIVERGENCE_FIELD, lane])
    if VOLUMES:
        counted = volume0 * law.volume_ratio(load_state(reals, block, STATE_FIELD, lane))
        v, tau = la.scale_vector(0.0, v), la.isotropic(real(1.0))
    momentum = la.scale_vector(counted, v)
    if AFFINE:
        M = transfer.affine_momentum(counted, load_matrix(reals, block, C_FIELD, lane), dx)
        if MLS:
            M = la.add(M, transfer.stress_momentum(volume0 * dt, tau, inv_dx))
    else:
        M = v
    return counted, momentum, M, tau, force, work


def given_to_node(weight, d, slope, momentum, M, tau, minus_impulse):
    """Momentum that a node gets."""
    if AFFINE:
        given = transfer.node_momentum(weight, d, momentum, M)
    else:
        given = la.scale_vector(weight, momentum)
    if BY_GRADIENT:
        given = transfer.node_impulse(given, slope, tau, minus_impulse)
    return given


def p2g(
    reals, places, segments, layer_start, first_layer, last_layer, table, windows, corner, folds, placed, placed_start, slots,
    nodes, unsummed, scratch, first_nodes, constants, dt, dx, inv_dx, layer_node, time, load_factor, works,
):  # fmt: skip
    before = flush_denormals()
    runs = 0
    for layer in range(first_layer, last_layer):
        number = (layer - first_layer) % windows.shape[0]
        window = windows[number]
        held = (NOWHERE, NOWHERE, NOWHERE)
        for s in range(layer_start[layer], layer_start[layer + 1]):
            row = segments[s, 2]
            mass, volume0, params = table[row, MASS_COLUMN], table[row, VOLUME_COLUMN], load_parameters(table, row)
            minus_impulse = -(volume0 * dt) * inv_dx
            for n in range(segments[s, 1]):
                block, lane = segments[s, 0] + (n >> 4), n & 15
                place = load_vector(places, block, 0, lane)
                g = along_axes(offset_of, place)
                w, dw = along_axes(weights, g), along_axes(slopes, g)
                base = node_of_segment(layer_node + layer, segments[s, 3], segments[s, 4])
                counted, momentum, M, tau, force, work = carried(
                    reals, block, lane, place, mass, volume0, params, base, dt, dx, inv_dx, time, load_factor
                )
                if FORCED:
                    scratch[FORCES] = max(scratch[FORCES], force)
                if DRIVEN:
                    works[layer] += work
                if VOLUMES:
                    minus_impulse = counted
                elif SHARED:
                    minus_impulse = -(reals[block, SHARE_FIELD, lane] * volume0 * dt) * inv_dx
                i0 = centre_of(place[SLAB]) + PADDING
                j0 = segments[s, 3] - corner[0] + centre_of(place[MIDDLE]) + PADDING if DIMENSIONS == 3 else 0
                k0 = segments[s, 4] - corner[1] + centre_of(place[ROW]) + PADDING
                if held != (i0, j0, k0):
                    held = (i0, j0, k0)
                    runs += 1
                for a in range(NODES):
                    for b in range(MIDDLE_NODES):
                        for c in range(NODES):
                            weight, d, slope = stencil_node(w, dw, g, a, b, c)
                            given = given_to_node(weight, d, slope, momentum, M, tau, minus_impulse)
                            for q in range(DIMENSIONS):
                                window[i0 + a, j0 + b, k0 + c, q] += given[q]
                            window[i0 + a, j0 + b, k0 + c, 3] += weight * counted
        if folds:
            fold_layer(windows, number, layer, placed, placed_start, corner, slots, nodes, unsummed)
    restore_denormals(before)
    return runs


# ---- G2P ----------------------------------------------------------------------------------------------------------------


def moved(place, step):
    """The place after a step in cells, rounded to the nearest."""
    return place + integer(floor(step * ONE_CELL + 0.5))


def advance(
    reals, places, block, lane, place, v, L, B, v_before, divergence, blend, params, density, base, limits, ends, dt, inv_dx
):  # fmt: skip
    """Advance a particle that has gathered velocity v, its gradient L in cells and B, and write it. Returns why it stops the
    run, or 0, and of what is reduced: speed^2, wave speed^2, |dt grad v|^2, drift as a place, the step in cells."""
    C = la.scale(INERTIA * inv_dx, B) if BY_INERTIA else la.scale(inv_dx, L)
    G = la.scale(dt, C) if MLS else la.scale(dt * inv_dx, L)
    if F_BAR:
        G = transfer.with_divergence(G, dt * divergence)
    state = law.advance(load_state(reals, block, STATE_FIELD, lane), G, dt, params)

    step = la.scale_vector(dt * inv_dx, v)
    largest_step = real(0.0)
    for axis in range(DIMENSIONS):
        largest_step = max(largest_step, abs(step[axis]))
    cause = 0
    if not law.valid(state):
        cause = CAUSE_STATE
    far = integer(0)
    if la.within(step, 1.0):
        for axis in range(DIMENSIONS):
            reached = moved(place[axis], step[axis])
            if reached < place_at(limits[axis, 0] - 64 * base[axis]) or reached > place_at(
                limits[axis, 1] - 64 * base[axis]
            ):
                cause = CAUSE_LEFT
            if axis == SLAB:
                far = max(far, abs(reached - CENTRE))
            elif (axis == MIDDLE and ENDS_MIDDLE) or (axis == ROW and ENDS_ROW):
                low, high = place_at(ends[axis, 0] - 64 * base[axis]), place_at(ends[axis, 1] - 64 * base[axis])
                far = max(far, max(low - reached, reached - high) + place_at(SETTLED))
        if abs(moved(place[SLAB], step[SLAB]) - CENTRE) > place_at(FARTHEST):
            cause = CAUSE_POSITION
    else:
        cause = CAUSE_POSITION
    if cause == 0:
        for axis in range(DIMENSIONS):
            places[block, axis, lane] = moved(place[axis], step[axis])

    if BLENDS:
        v = transfer.blend_velocity(v, load_vector(reals, block, V_FIELD, lane), v_before, blend)
    store(reals, block, V_FIELD, lane, v)
    if STORES_C:
        store(reals, block, C_FIELD, lane, C)
    store(reals, block, STATE_FIELD, lane, state)
    wave_squared = stability.signal_speed_squared(state, params, density, inv_dx)
    return cause, la.dot(v, v), wave_squared, la.norm_squared(G), far, largest_step


def g2p(
    reals, places, segments, layer_start, first_layer, last_layer, table, nodes, nodes_before, blend, nodes_divergence,
    spans, row_start, first_quads, corner, rings, layer_node, limits, ends, scratch, first_nodes, constants, dt, dx, inv_dx,
    failure,
):  # fmt: skip
    before = flush_denormals()
    ring, ring_before, ring_divergence = rings[0], rings[BEFORE_RING], rings[DIVERGENCE_RING]
    unfolded = first_layer
    speed_squared = wave_squared = strain_squared = largest_step = real(0.0)
    drift = integer(0)
    for layer in range(first_layer, last_layer):
        if layer_start[layer] == layer_start[layer + 1]:
            continue
        unfold(nodes, unfolded, layer, spans, row_start, first_quads, corner, ring)
        if BLENDS:
            unfold(nodes_before, unfolded, layer, spans, row_start, first_quads, corner, ring_before)
        if F_BAR:
            unfold(nodes_divergence, unfolded, layer, spans, row_start, first_quads, corner, ring_divergence)
        unfolded = layer + WINDOW
        for s in range(layer_start[layer], layer_start[layer + 1]):
            row = segments[s, 2]
            params, density = load_parameters(table, row), table[row, DENSITY_COLUMN]
            base = node_of_segment(layer_node + layer, segments[s, 3], segments[s, 4])
            for n in range(segments[s, 1]):
                block, lane = segments[s, 0] + (n >> 4), n & 15
                place = load_vector(places, block, 0, lane)
                g = along_axes(offset_of, place)
                w, dw = along_axes(weights, g), along_axes(slopes, g)
                i0 = (layer + centre_of(place[SLAB]) + PADDING) % WINDOW
                j0 = segments[s, 3] - corner[0] + centre_of(place[MIDDLE]) + PADDING if DIMENSIONS == 3 else 0
                k0 = segments[s, 4] - corner[1] + centre_of(place[ROW]) + PADDING
                v = la.scale_vector(0.0, g)
                L = B = la.outer(v, v)
                v_before, divergence = v, real(0.0)
                for a in range(NODES):
                    for b in range(MIDDLE_NODES):
                        for c in range(NODES):
                            weight, d, slope = stencil_node(w, dw, g, a, b, c)
                            v_node = vector_at(ring, i0 + a, j0 + b, k0 + c)
                            v = transfer.gather_velocity(v, weight, v_node)
                            B = transfer.gather_affine(B, weight, v_node, d)
                            if not MLS:
                                L = transfer.gather_gradient(L, v_node, slope)
                            if F_BAR:
                                divergence += weight * ring_divergence[i0 + a, j0 + b, k0 + c, 0]
                            if BLENDS:
                                old = vector_at(ring_before, i0 + a, j0 + b, k0 + c)
                                v_before = transfer.gather_velocity(v_before, weight, old)
                cause, speed, wave, strain, far, step = advance(
                    reals, places, block, lane, place, v, L, B, v_before, divergence, blend, params, density, base, limits,
                    ends, dt, inv_dx,
                )  # fmt: skip
                if cause != 0 and failure[0] == 0:
                    failure[0], failure[1], failure[2] = cause, block, lane
                largest_step = max(largest_step, step)
                speed_squared, wave_squared = max(speed_squared, speed), max(wave_squared, wave)
                strain_squared, drift = max(strain_squared, strain), max(drift, far)
    restore_denormals(before)
    return speed_squared, wave_squared, real(drift) * UNIT, strain_squared, largest_step


def measure_divergence(
    reals, places, segments, layer_start, first_layer, last_layer, nodes, spans, row_start, first_quads, corner, rings,
    scratch, first_nodes, constants, inv_dx,
):  # fmt: skip
    before = flush_denormals()
    ring = rings[0]
    unfolded = first_layer
    for layer in range(first_layer, last_layer):
        if layer_start[layer] == layer_start[layer + 1]:
            continue
        unfold(nodes, unfolded, layer, spans, row_start, first_quads, corner, ring)
        unfolded = layer + WINDOW
        for s in range(layer_start[layer], layer_start[layer + 1]):
            for n in range(segments[s, 1]):
                block, lane = segments[s, 0] + (n >> 4), n & 15
                place = load_vector(places, block, 0, lane)
                g = along_axes(offset_of, place)
                w, dw = along_axes(weights, g), along_axes(slopes, g)
                i0 = (layer + centre_of(place[SLAB]) + PADDING) % WINDOW
                j0 = segments[s, 3] - corner[0] + centre_of(place[MIDDLE]) + PADDING if DIMENSIONS == 3 else 0
                k0 = segments[s, 4] - corner[1] + centre_of(place[ROW]) + PADDING
                divergence = real(0.0)
                for a in range(NODES):
                    for b in range(MIDDLE_NODES):
                        for c in range(NODES):
                            weight, d, slope = stencil_node(w, dw, g, a, b, c)
                            divergence += la.dot(vector_at(ring, i0 + a, j0 + b, k0 + c), slope)
                reals[block, DIVERGENCE_FIELD, lane] = divergence * inv_dx
    restore_denormals(before)


def sum_energies(
    reals, places, segments, layer_start, layers, table, dx, layer_node, gravity, energies,
):  # fmt: skip
    """Add kinetic, strain and potential energy of the particles of each layer to its row of `energies`, which is float64."""
    before = flush_denormals()
    for layer in range(layers):
        for s in range(layer_start[layer], layer_start[layer + 1]):
            row = segments[s, 2]
            mass, volume0, params = table[row, MASS_COLUMN], table[row, VOLUME_COLUMN], load_parameters(table, row)
            base = node_of_segment(layer_node + layer, segments[s, 3], segments[s, 4])
            for n in range(segments[s, 1]):
                block, lane = segments[s, 0] + (n >> 4), n & 15
                v = load_vector(reals, block, V_FIELD, lane)
                if SHARED:
                    share = reals[block, SHARE_FIELD, lane]
                    mass, volume0 = share * table[row, MASS_COLUMN], share * table[row, VOLUME_COLUMN]
                energies[layer, 0] += 0.5 * mass * la.dot(v, v)
                energies[layer, 1] += volume0 * law.energy(load_state(reals, block, STATE_FIELD, lane), params)
                x = cells_to_metres(along_axes(cells_of, load_vector(places, block, 0, lane)), base, dx)
                energies[layer, 2] -= mass * la.dot(x, load_normal(gravity))
    restore_denormals(before)
