"""Loops for graphics cards: one thread per particle, node or pair, sums by atomics; what is done to each is in scalar_loops.

Particles lie in blocks of 16 lanes as everywhere, see loops.py; `info[block]` = (layer, row of the table, middle and row number
of the base node, particles in the block). The nodes of a row follow each other from its first span's on: `first_of_row`.
Sums come in any order, so that results agree with those of the CPU to rounding, not to the bit.
"""

import numpy as np
from numba import cuda

from pmpm.kernels import loops
from pmpm.kernels.loops import (
    BEYOND,
    MOMENTS,
    PADDING,
    apply_wall_at,
    centre_of,
    collide_at,
    fill_beyond_wall_at,
    mirror_volumes_at,
    momentum_at,
    node_of_segment,
    touch_on_node,
    vector_in,
    whole,
)
from pmpm.kernels.scalar_loops import (
    advance,
    along_axes,
    carried,
    cells_of,
    cells_to_metres,
    given_to_node,
    load_state,
    load_vector,
    offset_of,
    stencil_node,
)
from pmpm.kernels.spans import QUADS
from pmpm.physics import tensors2 as la
from pmpm.physics import transfer
from pmpm.physics.bspline import slopes_quadratic as slopes
from pmpm.physics.bspline import weights_quadratic as weights
from pmpm.physics.materials import neo_hookean as law

real = integer = word = float
DIMENSIONS, SLAB, MIDDLE, ROW = 2, 0, -1, 1
NODES, MIDDLE_NODES = 3, 1
THREADS = 128  # of a block of threads
TILED, TILE_REALS, FAR = True, 6000, 1 << 30  # reals of a box in shared memory; fewer in float64
int32, int64 = np.int32, np.int64
MLS = BLENDS = F_BAR = FORCED = DRIVEN = SHARED = VOLUMES = False
V_FIELD, DIVERGENCE_FIELD, SHARE_FIELD, STATE_FIELD = 2, 8, 8, 8
MASS_COLUMN, VOLUME_COLUMN, DENSITY_COLUMN = loops.MASS_COLUMN, loops.VOLUME_COLUMN, loops.DENSITY_COLUMN
PARAMETER_COLUMN = loops.PARAMETER_COLUMN
SPEED, WAVE, DRIFT, STRAIN, FORCE, STEP = range(6)  # of the maxima
MAXIMA, CAUSES, NO_FAILURE = 6, 4, 1 << 62
UNIT = 2.0**-52
load_row = load_vector  # parameters of a table with a third axis of one


# ---- where nodes are -----------------------------------------------------------------------------------------------------


def first_of_row(row_start, span_ends, span_offsets, row, node):
    """What to add to a node's number in its row: the row's spans lie one after another, `span_ends` in quads."""
    t = row_start[row]
    while span_ends[t] <= node >> 2:
        t += 1
    return span_offsets[t]


def base_node(info, block, layer_node):
    """The node that the places of a block count from, by physical axis."""
    return node_of_segment(int64(layer_node + info[block, 0]), int64(info[block, 2]), int64(info[block, 3]))


def reached_row(place, info, block):
    """(plane of the patch, row, node) where a particle's stencil begins."""
    plane = info[block, 0] + centre_of(place[SLAB]) + PADDING
    middle = info[block, 2] + centre_of(place[MIDDLE]) + PADDING if DIMENSIONS == 3 else 0
    return plane, middle, info[block, 3] + centre_of(place[ROW]) + PADDING


def mark(places, info, first_block, last_block, half, fraction, slack, marks, rows, words):
    """Mark what particles reach now or `slack` farther, see kernels.spans.mark_cells; marks are words of 32 quads, so many of
    them for each of so many rows of a layer."""
    p = cuda.grid(1)
    block, lane = first_block + (p >> 4), p & 15
    if block < last_block and lane < info[block, 4]:
        place = integer(places[block, ROW, lane] + half)
        low = info[block, 3] + PADDING + ((place - slack) >> fraction)
        high = info[block, 3] + PADDING + ((place + slack) >> fraction)
        low_middle = high_middle = 0
        if DIMENSIONS == 3:
            place = integer(places[block, MIDDLE, lane] + half)
            low_middle = info[block, 2] + PADDING + ((place - slack) >> fraction)
            high_middle = info[block, 2] + PADDING + ((place + slack) >> fraction)
        last_quad = min((high + 3) >> 2, QUADS * words - 1)
        for j in range(max(low_middle, 0), min(high_middle + 1, rows)):
            for q in range(max(low, 0) >> 2, last_quad + 1):
                cuda.atomic.or_(marks, (info[block, 0] * rows + j) * words + (q >> 5), word(1 << (q & 31)))


# ---- particles to nodes ----------------------------------------------------------------------------------------------------


def p2g(
    reals, places, info, first_block, last_block, table, row_start, span_ends, span_offsets, rows, nodes, maxima, works,
    dt, dx, inv_dx, layer_node, time, load_factor,
):  # fmt: skip
    """Particles to nodes. TILED: a block of threads sums in shared memory first, in a box around the nodes that its particles
    reach, and adds to the nodes once; where the box is too large each particle adds to the nodes itself."""
    p, thread = cuda.grid(1), cuda.threadIdx.x
    block, lane = first_block + (p >> 4), p & 15
    active = block < last_block and lane < info[min(block, last_block - 1), 4]
    plane = middle = node = low_plane = low_middle = low_node = middles = nodes_of_row = size = 0
    if TILED:
        box = cuda.shared.array(6, int32)
        tile = cuda.shared.array(TILE_REALS, real)
        if thread < 6:
            box[thread] = FAR if thread < 3 else -FAR
        cuda.syncthreads()
        if active:
            plane, middle, node = reached_row(load_vector(places, block, 0, lane), info, block)
            cuda.atomic.min(box, 0, plane)
            cuda.atomic.min(box, 1, middle)
            cuda.atomic.min(box, 2, node)
            cuda.atomic.max(box, 3, plane)
            cuda.atomic.max(box, 4, middle)
            cuda.atomic.max(box, 5, node)
        cuda.syncthreads()
        low_plane, low_middle, low_node = box[0], box[1], box[2]
        middles, nodes_of_row = box[4] - low_middle + MIDDLE_NODES, box[5] - low_node + NODES
        size = (box[3] - low_plane + NODES) * middles * nodes_of_row
        if 4 * size <= TILE_REALS:
            for n in range(thread, 4 * size, THREADS):
                tile[n] = real(0.0)
        cuda.syncthreads()
    if active:
        row = info[block, 1]
        mass, volume0 = table[row, MASS_COLUMN, 0], table[row, VOLUME_COLUMN, 0]
        params = load_row(table, row, PARAMETER_COLUMN, 0)
        place = load_vector(places, block, 0, lane)
        g = along_axes(offset_of, place)
        w, dw = along_axes(weights, g), along_axes(slopes, g)
        base = base_node(info, block, layer_node)
        counted, momentum, M, tau, force, work = carried(
            reals, block, lane, place, mass, volume0, params, base, dt, dx, inv_dx, time, load_factor
        )
        if FORCED:
            cuda.atomic.max(maxima, FORCE, force)
        if DRIVEN:
            cuda.atomic.add(works, block, work)
        minus_impulse = -(volume0 * dt) * inv_dx
        if VOLUMES:
            minus_impulse = counted
        elif SHARED:
            minus_impulse = -(reals[block, SHARE_FIELD, lane] * volume0 * dt) * inv_dx
        plane, middle, node = reached_row(place, info, block)
        if TILED and 4 * size <= TILE_REALS:
            for a in range(NODES):
                for b in range(MIDDLE_NODES):
                    first = (
                        ((plane - low_plane + a) * middles + middle - low_middle + b) * nodes_of_row + node - low_node
                    )
                    for c in range(NODES):
                        weight, d, slope = stencil_node(w, dw, g, a, b, c)
                        given = given_to_node(weight, d, slope, momentum, M, tau, minus_impulse)
                        for q in range(DIMENSIONS):
                            cuda.atomic.add(tile, q * size + first + c, given[q])
                        cuda.atomic.add(tile, 3 * size + first + c, weight * counted)
        else:
            for a in range(NODES):
                for b in range(MIDDLE_NODES):
                    first = node + first_of_row(
                        row_start, span_ends, span_offsets, (plane + a) * rows + middle + b, node
                    )
                    for c in range(NODES):
                        weight, d, slope = stencil_node(w, dw, g, a, b, c)
                        given = given_to_node(weight, d, slope, momentum, M, tau, minus_impulse)
                        for q in range(DIMENSIONS):
                            cuda.atomic.add(nodes, (first + c, q), given[q])
                        cuda.atomic.add(nodes, (first + c, 3), weight * counted)
    if TILED:
        cuda.syncthreads()
        if 4 * size <= TILE_REALS:
            for n in range(thread, size, THREADS):
                if given_anything(tile, size, n):
                    of_plane, k = n // nodes_of_row, low_node + n % nodes_of_row
                    a, b = of_plane // middles, of_plane % middles
                    row = (low_plane + a) * rows + low_middle + b
                    first = first_of_row(row_start, span_ends, span_offsets, row, k)
                    for q in range(DIMENSIONS):
                        cuda.atomic.add(nodes, (first + k, q), tile[q * size + n])
                    cuda.atomic.add(nodes, (first + k, 3), tile[3 * size + n])


def given_anything(tile, size, n):
    """Whether a node of a tile has got anything: a stencil's end may give an impulse where it gives no mass."""
    found = tile[3 * size + n] != 0.0
    for q in range(DIMENSIONS):
        found |= tile[q * size + n] != 0.0
    return found


# ---- nodes to particles ----------------------------------------------------------------------------------------------------


def g2p(
    reals, places, info, first_block, last_block, table, row_start, span_ends, span_offsets, rows, nodes, nodes_before, blend,
    nodes_divergence, limits, ends, dt, inv_dx, layer_node, maxima, failure, number,
):  # fmt: skip
    """Nodes to particles; `number`: of the law, whose first failure is kept."""
    p = cuda.grid(1)
    block, lane = first_block + (p >> 4), p & 15
    largest = cuda.shared.array(MAXIMA, real)
    if cuda.threadIdx.x < MAXIMA:
        largest[cuda.threadIdx.x] = real(0.0)
    cuda.syncthreads()
    if block < last_block and lane < info[block, 4]:
        row = info[block, 1]
        density, params = table[row, DENSITY_COLUMN, 0], load_row(table, row, PARAMETER_COLUMN, 0)
        base = base_node(info, block, layer_node)
        place = load_vector(places, block, 0, lane)
        g = along_axes(offset_of, place)
        w, dw = along_axes(weights, g), along_axes(slopes, g)
        v = la.scale_vector(0.0, g)
        L = B = la.outer(v, v)
        v_before, divergence = v, real(0.0)
        plane, middle, node = reached_row(place, info, block)
        for a in range(NODES):
            for b in range(MIDDLE_NODES):
                first = node + first_of_row(row_start, span_ends, span_offsets, (plane + a) * rows + middle + b, node)
                for c in range(NODES):
                    weight, d, slope = stencil_node(w, dw, g, a, b, c)
                    v_node = momentum_at(nodes, first + c)
                    v = transfer.gather_velocity(v, weight, v_node)
                    B = transfer.gather_affine(B, weight, v_node, d)
                    if not MLS:
                        L = transfer.gather_gradient(L, v_node, slope)
                    if F_BAR:
                        divergence += weight * nodes_divergence[first + c, 0]
                    if BLENDS:
                        v_before = transfer.gather_velocity(v_before, weight, momentum_at(nodes_before, first + c))
        cause, speed, wave, strain, far, step = advance(
            reals, places, block, lane, place, v, L, B, v_before, divergence, blend, params, density, base, limits, ends,
            dt, inv_dx,
        )  # fmt: skip
        if cause != 0:
            cuda.atomic.min(failure, number, CAUSES * (16 * block + lane) + cause)
        cuda.atomic.max(largest, SPEED, speed)
        cuda.atomic.max(largest, WAVE, wave)
        cuda.atomic.max(largest, DRIFT, real(far) * UNIT)
        cuda.atomic.max(largest, STRAIN, strain)
        cuda.atomic.max(largest, STEP, step)
    cuda.syncthreads()
    if cuda.threadIdx.x < MAXIMA:
        cuda.atomic.max(maxima, cuda.threadIdx.x, largest[cuda.threadIdx.x])


def measure_divergence(
    reals, places, info, first_block, last_block, row_start, span_ends, span_offsets, rows, nodes, inv_dx
):  # fmt: skip
    p = cuda.grid(1)
    block, lane = first_block + (p >> 4), p & 15
    if block < last_block and lane < info[block, 4]:
        place = load_vector(places, block, 0, lane)
        g = along_axes(offset_of, place)
        w, dw = along_axes(weights, g), along_axes(slopes, g)
        plane, middle, node = reached_row(place, info, block)
        divergence = real(0.0)
        for a in range(NODES):
            for b in range(MIDDLE_NODES):
                first = node + first_of_row(row_start, span_ends, span_offsets, (plane + a) * rows + middle + b, node)
                for c in range(NODES):
                    _, _, slope = stencil_node(w, dw, g, a, b, c)
                    divergence += la.dot(momentum_at(nodes, first + c), slope)
        reals[block, DIVERGENCE_FIELD, lane] = divergence * inv_dx


def sum_energies(reals, places, info, last_block, table, dx, layer_node, gravity, energies):
    """Add kinetic, strain and potential energy of the particles of each block to its row of `energies`."""
    p = cuda.grid(1)
    block, lane = p >> 4, p & 15
    if block < last_block and lane < info[block, 4]:
        row = info[block, 1]
        mass, volume0 = table[row, MASS_COLUMN, 0], table[row, VOLUME_COLUMN, 0]
        params = load_row(table, row, PARAMETER_COLUMN, 0)
        base = base_node(info, block, layer_node)
        v = load_vector(reals, block, V_FIELD, lane)
        if SHARED:
            share = reals[block, SHARE_FIELD, lane]
            mass, volume0 = share * mass, share * volume0
        x = cells_to_metres(along_axes(cells_of, load_vector(places, block, 0, lane)), base, dx)
        cuda.atomic.add(energies, (block, 0), 0.5 * mass * la.dot(v, v))
        cuda.atomic.add(energies, (block, 1), volume0 * law.energy(load_state(reals, block, STATE_FIELD, lane), params))
        cuda.atomic.add(energies, (block, 2), -mass * la.dot(x, gravity))


# ---- nodes -----------------------------------------------------------------------------------------------------------------


def clear(nodes, last):
    """No impulse and no mass on nodes 0 .. last - 1."""
    n = cuda.grid(1)
    if n < last:
        for q in range(4):
            nodes[n, q] = real(0.0)


def add_received(nodes, received, numbers, last):
    """Add what others have summed on nodes of these numbers; -1 is none of this patch's."""
    i = cuda.grid(1)
    if i < last and numbers[i] >= 0:
        for q in range(4):
            nodes[numbers[i], q] += received[i, q]


def copy(source, values, last):
    n = cuda.grid(1)
    if n < last:
        for q in range(4):
            values[n, q] = source[n, q]


def sum_images(nodes, low, high, first, last):
    """Both nodes of each pair first .. last - 1 get the total."""
    n = first + cuda.grid(1)
    if n < last:
        for q in range(4):
            total = nodes[low[n], q] + nodes[high[n], q]
            nodes[low[n], q] = total
            nodes[high[n], q] = total


def add_gravity(nodes, first, last, gain):
    """Momentum gains mass times dt times gravity."""
    n = first + cuda.grid(1)
    if n < last:
        for q in range(DIMENSIONS):
            nodes[n, q] += nodes[n, 3] * gain[q]


def damp(nodes, first, last, kept):
    """Momentum loses all but the part `kept`."""
    n = first + cuda.grid(1)
    if n < last:
        for q in range(3):
            nodes[n, q] *= kept


def divide_by_mass(nodes, first, last):
    """Momentum -> velocity; nodes without mass are at rest."""
    n = first + cuda.grid(1)
    if n < last:
        mass = nodes[n, 3]
        for q in range(3):
            nodes[n, q] = nodes[n, q] / mass if mass > 0.0 else real(0.0)


def apply_wall(nodes, met, first, last, normal, coefficient, velocity):
    """See loops.apply_wall."""
    i = first + cuda.grid(1)
    if i < last:
        apply_wall_at(nodes, met, i, normal, coefficient, velocity)


def mirror_volumes(volumes, met, first, last, normal):
    """See loops.mirror_volumes."""
    i = first + cuda.grid(1)
    if i < last:
        mirror_volumes_at(volumes, met, i, normal)


def touch(nodes, volumes, room, pairs, frictions, first, last):
    """See loops.touch."""
    i = first + cuda.grid(1)
    if i < last:
        touch_on_node(nodes, volumes, room, pairs, frictions, i)


def fill_beyond_wall(nodes, met, first, last, normal, velocity):
    """See loops.fill_beyond_wall."""
    i = first + cuda.grid(1)
    if i < last:
        for far in range(BEYOND):
            fill_beyond_wall_at(nodes, met, i, far, normal, velocity)


def collide(nodes, numbers, first, last, normals, velocities, arms, counted, coefficient, per_unit, per_reach, found):
    """See loops.collide."""
    i = first + cuda.grid(1)
    if i < last:
        given = collide_at(
            nodes, numbers[i], vector_in(normals, i), vector_in(velocities, i), coefficient, counted[i] * per_unit
        )
        torque = la.moment(vector_in(arms, i), given)
        for q in range(DIMENSIONS):
            cuda.atomic.add(found, q, whole(given[q]))
        for q in range(MOMENTS):
            cuda.atomic.add(found, DIMENSIONS + q, whole(torque[q] * per_reach))


def impose(nodes, numbers, last, velocity, everywhere):
    """Give its velocity to those nodes of a region that hold material, or to all of them."""
    i = cuda.grid(1)
    if i < last and (everywhere or nodes[numbers[i], 3] > 0.0):
        for q in range(DIMENSIONS):
            nodes[numbers[i], q] = velocity[q]


# ---- numbers ---------------------------------------------------------------------------------------------------------------


def forget(maxima, failure, laws):
    """No maxima and no failure yet."""
    if cuda.grid(1) == 0:
        for kind in range(MAXIMA):
            maxima[kind] = real(0.0)
        for number in range(laws):
            failure[number] = NO_FAILURE


def clear_reals(values, last):
    """Zeros, from the first value on."""
    n = cuda.grid(1)
    if n < last:
        values[n] = real(0.0)


def clear_words(values, last):
    """The same of words."""
    n = cuda.grid(1)
    if n < last:
        values[n] = word(0)
