"""Where points lie of a closed surface: winding numbers and distances. Called at seeding, never in a step.

A surface is a list of elements (n, dim, dim), triangles in 3-D and segments in 2-D, in the order of a binary tree: node m has
the children 2 m and 2 m + 1, node 1 is the root, and node m = 2^k + i covers the elements (i n) >> k .. ((i + 1) n) >> k. So a
tree is arrays, and it is gone through without a stack: after a node comes its right neighbour, or that of the first of its
ancestors that is a left child.

Winding number: Jacobson et al. 2013; of what is far away the dipole and its first moment: Barill et al. 2018.
What a point is told depends on the point and the surface alone, not on the points beside it.
"""

import math
from functools import cache

from pmpm.physics.tensors2 import dot as dot_2
from pmpm.physics.tensors3 import dot as dot_3
from pmpm.physics.tensors3 import moment as cross

DIM = 3
FAR = 2.0  # radii of a node from where its elements count as one: together wrong by less than 0.1 of a winding
EMPTY, CUT, OUT, IN = 0, 1, 2, 3  # boxes of the grid over a surface, see find_inside
NEAR = 1e-6  # of a box: how far round-off may carry


# ---- vectors ----------------------------------------------------------------------------------------------------------------


def minus_2(p, q):
    return (p[0] - q[0], p[1] - q[1])


def minus_3(p, q):
    return (p[0] - q[0], p[1] - q[1], p[2] - q[2])


def row_2(points, i):
    return (points[i, 0], points[i, 1])


def row_3(points, i):
    return (points[i, 0], points[i, 1], points[i, 2])


def corner_2(elements, e, i):
    return (elements[e, i, 0], elements[e, i, 1])


def corner_3(elements, e, i):
    return (elements[e, i, 0], elements[e, i, 1], elements[e, i, 2])


# ---- winding numbers --------------------------------------------------------------------------------------------------------


def turn_of_element_2(elements, e, x):
    """Part of a whole turn under which a segment is seen, > 0 counter-clockwise."""
    p, q = minus_2(corner_2(elements, e, 0), x), minus_2(corner_2(elements, e, 1), x)
    across = p[0] * q[1] - p[1] * q[0]
    if across == 0.0:  # end-on
        return 0.0
    return math.atan2(across, dot_2(p, q)) / (2.0 * math.pi)


def turn_of_element_3(elements, e, x):
    """Part of the whole sphere under which a triangle is seen (van Oosterom and Strackee 1983), > 0 from behind."""
    p, q, r = (
        minus_3(corner_3(elements, e, 0), x),
        minus_3(corner_3(elements, e, 1), x),
        minus_3(corner_3(elements, e, 2), x),
    )
    volume = dot_3(p, cross(q, r))
    if volume == 0.0:  # edge-on
        return 0.0
    a, b, c = math.sqrt(dot_3(p, p)), math.sqrt(dot_3(q, q)), math.sqrt(dot_3(r, r))
    return math.atan2(volume, a * b * c + dot_3(p, q) * c + dot_3(q, r) * a + dot_3(r, p) * b) / (2.0 * math.pi)


def turn_of_node_2(dipoles, m, r, square):
    """The same of all elements of a node from afar; r: from the point to the node's centre."""
    near = dipoles[m, 0] * r[0] + dipoles[m, 1] * r[1] + dipoles[m, 2] + dipoles[m, 5]
    bend = (dipoles[m, 2] * r[0] + (dipoles[m, 3] + dipoles[m, 4]) * r[1]) * r[0] + dipoles[m, 5] * r[1] * r[1]
    return (near - 2.0 * bend / square) / (2.0 * math.pi * square)


def turn_of_node_3(dipoles, m, r, square):
    """The same of all elements of a node from afar; r: from the point to the node's centre."""
    near = dipoles[m, 0] * r[0] + dipoles[m, 1] * r[1] + dipoles[m, 2] * r[2]
    near += dipoles[m, 3] + dipoles[m, 7] + dipoles[m, 11]
    bend = dipoles[m, 3] * r[0] * r[0] + dipoles[m, 7] * r[1] * r[1] + dipoles[m, 11] * r[2] * r[2]
    bend += (dipoles[m, 4] + dipoles[m, 6]) * r[0] * r[1] + (dipoles[m, 5] + dipoles[m, 9]) * r[0] * r[2]
    bend += (dipoles[m, 8] + dipoles[m, 10]) * r[1] * r[2]
    return (near - 3.0 * bend / square) / (4.0 * math.pi * square * math.sqrt(square))


def following(m):
    """The node after m and all below it; 0 after the last."""
    while m & 1:
        m >>= 1
    return m + 1 if m > 0 else 0


def winding(x, elements, centers, radii, dipoles, leaves, depth):
    """How often the surface goes around a point."""
    found, m, count = 0.0, 1, elements.shape[0]
    while m > 0:
        r = minus(row(centers, m), x)
        square, reach = dot(r, r), FAR * radii[m]
        if square > reach * reach:
            found += turn_of_node(dipoles, m, r, square)
            m = following(m)
        elif m >= leaves:
            for e in range(((m - leaves) * count) >> depth, ((m - leaves + 1) * count) >> depth):
                found += turn_of_element(elements, e, x)
            m = following(m)
        else:
            m = 2 * m
    return found


def find_windings(points, elements, centers, radii, dipoles, leaves, depth, found):
    """Set found[i] to how often the surface goes around points[i]."""
    for i in range(points.shape[0]):
        found[i] = winding(row(points, i), elements, centers, radii, dipoles, leaves, depth)


# ---- distances --------------------------------------------------------------------------------------------------------------


def square_to_segment(p, q):
    """Square of the distance from the origin to a segment."""
    side = minus(q, p)
    length = dot(side, side)
    t = min(max(-dot(p, side) / length, 0.0), 1.0) if length > 0.0 else 0.0
    return square_at(p, side, t)


def square_at_2(p, side, t):
    a, b = p[0] + t * side[0], p[1] + t * side[1]
    return a * a + b * b


def square_at_3(p, side, t):
    a, b, c = p[0] + t * side[0], p[1] + t * side[1], p[2] + t * side[2]
    return a * a + b * b + c * c


def square_to_element_2(elements, e, x):
    """Square of the distance from a point to a segment."""
    return square_to_segment(minus_2(corner_2(elements, e, 0), x), minus_2(corner_2(elements, e, 1), x))


def square_to_element_3(elements, e, x):
    """Square of the distance from a point to a triangle."""
    p, q, r = (
        minus_3(corner_3(elements, e, 0), x),
        minus_3(corner_3(elements, e, 1), x),
        minus_3(corner_3(elements, e, 2), x),
    )
    normal = cross(minus_3(q, p), minus_3(r, p))
    size = dot_3(normal, normal)
    over_all = min(dot_3(normal, cross(p, q)), dot_3(normal, cross(q, r)), dot_3(normal, cross(r, p)))
    if size > 0.0 and over_all >= 0.0:
        height = dot_3(normal, p)
        return height * height / size
    return min(square_to_segment(p, q), square_to_segment(q, r), square_to_segment(r, p))


def off_box(boxes, m, x, axis):
    return max(boxes[m, 0, axis] - x[axis], x[axis] - boxes[m, 1, axis], 0.0)


def square_to_box_2(boxes, m, x):
    """Square of the distance from a point to the box around a node; zero inside."""
    a, b = off_box(boxes, m, x, 0), off_box(boxes, m, x, 1)
    return a * a + b * b


def square_to_box_3(boxes, m, x):
    """Square of the distance from a point to the box around a node; zero inside."""
    a, b, c = off_box(boxes, m, x, 0), off_box(boxes, m, x, 1), off_box(boxes, m, x, 2)
    return a * a + b * b + c * c


def square_to_surface(x, elements, boxes, leaves, depth, known):
    """Square of the distance from a point to the nearest element, which is less than `known`."""
    count, m = elements.shape[0], 1
    while m < leaves:  # to a leaf that is probably near
        m = 2 * m
        if square_to_box(boxes, m + 1, x) < square_to_box(boxes, m, x):
            m += 1
    near = known
    for e in range(((m - leaves) * count) >> depth, ((m - leaves + 1) * count) >> depth):
        near = min(near, square_to_element(elements, e, x))
    m = 1
    while m > 0:
        if square_to_box(boxes, m, x) >= near:
            m = following(m)
        elif m >= leaves:
            for e in range(((m - leaves) * count) >> depth, ((m - leaves + 1) * count) >> depth):
                near = min(near, square_to_element(elements, e, x))
            m = following(m)
        else:
            m = 2 * m
    return near


def find_distances(points, elements, boxes, leaves, depth, found):
    """Set found[i] to the distance from points[i] to the surface. From one point to the next it changes by no more than their
    distance: of points in a row little of the tree is looked at."""
    known = math.inf
    for i in range(points.shape[0]):
        x = row(points, i)
        if i > 0:
            step = minus(x, row(points, i - 1))
            most = (found[i - 1] + math.sqrt(dot(step, step))) * (1.0 + NEAR)
            known = most * most if most > 0.0 else math.inf
        found[i] = math.sqrt(square_to_surface(x, elements, boxes, leaves, depth, known))


# ---- a grid over the surface ------------------------------------------------------------------------------------------------


def place_in(x, start, inv_width, shape, axis):
    """Number along an axis of the box of the grid that a point lies in; of the outermost for what is beyond."""
    return min(max(int((x[axis] - start[axis]) * inv_width), 0), shape[axis] - 1)


def box_of_2(x, start, inv_width, shape):
    """Number of the box of the grid that a point lies in."""
    return place_in(x, start, inv_width, shape, 0) * shape[1] + place_in(x, start, inv_width, shape, 1)


def box_of_3(x, start, inv_width, shape):
    """Number of the box of the grid that a point lies in."""
    plane = place_in(x, start, inv_width, shape, 0) * shape[1] + place_in(x, start, inv_width, shape, 1)
    return plane * shape[2] + place_in(x, start, inv_width, shape, 2)


def middle_of_2(box, start, inv_width, shape):
    """The middle of a box of the grid."""
    i, j = box // shape[1], box % shape[1]
    return (start[0] + (i + 0.5) / inv_width, start[1] + (j + 0.5) / inv_width)


def middle_of_3(box, start, inv_width, shape):
    """The middle of a box of the grid."""
    ij, k = box // shape[2], box % shape[2]
    i, j = ij // shape[1], ij % shape[1]
    return (
        start[0] + (i + 0.5) / inv_width,
        start[1] + (j + 0.5) / inv_width,
        start[2] + (k + 0.5) / inv_width,
    )


def plane_of_2(elements, e):
    """(normal, height above the origin) of the line through a segment; the normal is not of length 1."""
    p, q = corner_2(elements, e, 0), corner_2(elements, e, 1)
    normal = (q[1] - p[1], p[0] - q[0])
    return normal, dot_2(normal, p)


def plane_of_3(elements, e):
    """(normal, height above the origin) of the plane of a triangle; the normal is not of length 1."""
    p, q, r = corner_3(elements, e, 0), corner_3(elements, e, 1), corner_3(elements, e, 2)
    normal = cross(minus_3(q, p), minus_3(r, p))
    return normal, dot_3(normal, p)


def reach_of_2(normal):
    return abs(normal[0]) + abs(normal[1])


def reach_of_3(normal):
    return abs(normal[0]) + abs(normal[1]) + abs(normal[2])


def mark_cut(elements, start, inv_width, shape, kinds):
    """Mark as CUT the boxes of a grid that an element may meet: in its bounds and, within them, on its line or plane."""
    low, high = [0] * 3, [0] * 3
    for e in range(elements.shape[0]):
        normal, height = plane_of(elements, e)
        reach = reach_of(normal) * (0.5 + NEAR) / inv_width
        for axis in range(DIM):
            least = most = elements[e, 0, axis]
            for i in range(1, DIM):
                least, most = min(least, elements[e, i, axis]), max(most, elements[e, i, axis])
            low[axis] = max(int((least - start[axis]) * inv_width - NEAR), 0)
            high[axis] = min(int((most - start[axis]) * inv_width + NEAR), shape[axis] - 1)
        for i in range(low[0], high[0] + 1):
            for j in range(low[1], high[1] + 1):
                for k in range(low[2], high[2] + 1):
                    box = i * shape[1] + j if DIM == 2 else (i * shape[1] + j) * shape[2] + k
                    if abs(dot(normal, middle_of(box, start, inv_width, shape)) - height) <= reach:
                        kinds[box] = CUT


def find_inside(
    points, elements, boxes, centers, radii, dipoles, leaves, depth, start, inv_width, shape, kinds, inside
):
    """Set inside[i] where the surface goes around points[i]. `kinds` of the boxes of a grid over the surface: those it does not
    meet are EMPTY until a point asks, then IN or OUT as their middles are; in those CUT each point is looked at."""
    for i in range(points.shape[0]):
        x = row(points, i)
        inside[i] = False
        if square_to_box(boxes, 1, x) == 0.0:
            box = box_of(x, start, inv_width, shape)
            if kinds[box] == EMPTY:
                middle = middle_of(box, start, inv_width, shape)
                held = winding(middle, elements, centers, radii, dipoles, leaves, depth) > 0.5
                kinds[box] = IN if held else OUT
            if kinds[box] == CUT:
                inside[i] = winding(x, elements, centers, radii, dipoles, leaves, depth) > 0.5 - NEAR
            else:
                inside[i] = kinds[box] == IN


def reached(x, axis, by, start, inv_width, shape):
    """Number along an axis of the box of the grid that lies `by` from a point."""
    return min(max(int(math.floor((x[axis] + by - start[axis]) * inv_width)), 0), shape[axis] - 1)


def find_near(points, reach, elements, boxes, leaves, depth, start, inv_width, shape, kinds, near):
    """Set near[i] where the surface comes nearer to points[i] than `reach`."""
    square = reach * reach
    low, high = [0] * 3, [0] * 3
    for i in range(points.shape[0]):
        x = row(points, i)
        near[i] = False
        if square_to_box(boxes, 1, x) < square:
            for axis in range(DIM):
                low[axis] = reached(x, axis, -reach, start, inv_width, shape)
                high[axis] = reached(x, axis, reach, start, inv_width, shape)
            any_cut = False
            for a in range(low[0], high[0] + 1):
                for b in range(low[1], high[1] + 1):
                    for c in range(low[2], high[2] + 1):
                        box = a * shape[1] + b if DIM == 2 else (a * shape[1] + b) * shape[2] + c
                        any_cut |= kinds[box] == CUT
            near[i] = any_cut and square_to_surface(x, elements, boxes, leaves, depth, square) < square


# ---- to be called from Python -----------------------------------------------------------------------------------------------

dot, minus, row, square_at, square_to_box, square_to_element = (
    dot_3,
    minus_3,
    row_3,
    square_at_3,
    square_to_box_3,
    square_to_element_3,
)
turn_of_element, turn_of_node, box_of, middle_of, plane_of, reach_of = (
    turn_of_element_3,
    turn_of_node_3,
    box_of_3,
    middle_of_3,
    plane_of_3,
    reach_of_3,
)
OF_DIM = (
    *("dot", "minus", "row", "square_at", "square_to_box", "square_to_element", "turn_of_element", "turn_of_node"),
    *("box_of", "middle_of", "plane_of", "reach_of"),
)
LOOPS = (find_windings, find_distances, mark_cut, find_inside, find_near)


@cache
def entries(dim):
    """{name: kernel} of the loops for a number of dimensions: compiled at the first call, and kept on disk."""
    import numpy as np

    from pmpm.kernels import targets

    targets.use_cache_folder()
    target = targets.scalar(np.float64, DIM=dim, **{name: globals()[f"{name}_{dim}"] for name in OF_DIM})
    return {loop.__name__: target.entry(loop) for loop in LOOPS}
