"""Closed surfaces of triangles, in 2-D of segments: small defects mended, then which points they hold and how far they are.

Mending, in this order: corners that lie together become one; elements without extent and repeated ones go; neighbours are
turned to agree, the fewer by the more, and each piece to the outside unless it is a cavity of another; what is still open is
closed by fans around the middle of each hole, if that is little. After that every edge is met as often from one side as from
the other, so that the winding number is a whole number everywhere, and volume and inside mean the same.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pmpm.scene.functions import Unfit

TOGETHER = 1e-6  # corners so near, as part of the largest extent, are one: float32 in a file has such gaps
MOST_OPEN = 0.01  # of the area (in 2-D of the length) that may be missing and is closed
LEAST_SOLID = 1e-9  # volume as part of that of the surrounding box: less is no body
LARGEST = 1e60  # m, and the smallest is as small: squares and cubes must stay numbers
LEAF = 8  # elements of a leaf of the tree
FINEST, BOXES_PER_ELEMENT = 1 << 21, 32  # boxes of the grid over a surface
MOST_TURNED = 1000  # pieces that are turned inside out one by one


@dataclass(frozen=True)
class Mended:
    """What was wrong with a surface and has been put right."""

    empty: int = 0  # elements without extent
    repeated: int = 0
    turned: int = 0  # elements that looked the other way than their neighbours
    turned_pieces: int = 0
    holes: int = 0
    open_part: float = 0.0  # of the area (in 2-D of the length)
    largest_hole: float = 0.0  # across, m


@dataclass(frozen=True, eq=False)
class Surface:
    """A closed surface: elements (n, dim, dim) m, seen from outside counter-clockwise (in 2-D: the inside to the left)."""

    elements: np.ndarray
    mended: Mended

    @property
    def dim(self) -> int:
        return self.elements.shape[1]

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the corners (low, high) of the surrounding box, (dim,) each, m."""
        return self.elements.min(axis=(0, 1)), self.elements.max(axis=(0, 1))

    @cached_property
    def area(self) -> float:
        """m2; in 2-D the length in m."""
        return float(np.linalg.norm(normals(self.elements), axis=1).sum())

    @cached_property
    def volume(self) -> float:
        """Volume inside in m3, in 2-D area in m2; where pieces overlap it counts as often as they do."""
        return volume_of(self.elements)

    @cached_property
    def centroid(self) -> np.ndarray:
        """(dim,) m."""
        origin, signed = cones(self.elements)
        middles = (self.elements - origin).sum(axis=1) / (self.dim + 1)
        return origin + signed @ middles / signed.sum()

    @cached_property
    def second_moment(self) -> np.ndarray:
        """(dim, dim) integral of (x - c) (x - c)^T over the inside, c the centroid, m^(dim + 2)."""
        _, signed = cones(self.elements, self.centroid)
        corners, dim = self.elements - self.centroid, self.dim
        total = corners.sum(axis=1)
        squares = np.einsum("nci,ncj->nij", corners, corners) + total[:, :, None] * total[:, None, :]
        return np.einsum("n,nij->ij", signed, squares) / ((dim + 1) * (dim + 2))

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Say which of the points (n, dim), m, lie inside: bool (n,)."""
        inside = np.zeros(len(points), bool)
        if len(points):
            tree, grid = self.tree, self.grid
            self.kernels["find_inside"](
                rows_of(points), tree.elements, tree.boxes, tree.centers, tree.radii, tree.dipoles, tree.leaves, tree.depth,
                grid.start, grid.inv_width, grid.shape, grid.kinds, inside,
            )  # fmt: skip
        return inside

    def winding_numbers(self, points: np.ndarray) -> np.ndarray:
        """Return how often the surface goes around points (n, dim), m: (n,), up to 0.1."""
        found, tree = np.zeros(len(points)), self.tree
        self.kernels["find_windings"](
            rows_of(points), tree.elements, tree.centers, tree.radii, tree.dipoles, tree.leaves, tree.depth, found
        )
        return found

    def near(self, points: np.ndarray, reach: float) -> np.ndarray:
        """Say to which of the points (n, dim), m, the surface comes nearer than `reach` (m): bool (n,)."""
        near, tree, grid = np.zeros(len(points), bool), self.tree, self.grid
        self.kernels["find_near"](
            rows_of(points), reach, tree.elements, tree.boxes, tree.leaves, tree.depth, grid.start, grid.inv_width, grid.shape,
            grid.kinds, near,
        )  # fmt: skip
        return near

    def signed_distance(self, points: np.ndarray) -> np.ndarray:
        """Return the distance (n,) in m of points (n, dim), m, to the surface, negative inside."""
        found, tree = np.zeros(len(points)), self.tree
        self.kernels["find_distances"](rows_of(points), tree.elements, tree.boxes, tree.leaves, tree.depth, found)
        return np.where(self.contains(points), -found, found)

    @property
    def kernels(self):
        from pmpm.kernels.surfaces import entries

        return entries(self.dim)

    @cached_property
    def tree(self) -> "Tree":
        return tree_of(self.elements)

    @cached_property
    def grid(self) -> "Grid":
        return grid_of(self, self.kernels["mark_cut"])


# ---- making one -------------------------------------------------------------------------------------------------------------


def closed_surface(points: np.ndarray, corners: np.ndarray) -> Surface:
    """Return the Surface of elements `corners` (n, dim), rows of `points` (m, dim) in m. Raises Unfit if it is open or holds
    nothing."""
    dim = points.shape[1]
    kind = "triangle" if dim == 3 else "segment"
    if not len(corners):
        raise Unfit(f"holds no {kind}")
    used = points[np.unique(corners)]
    if not np.abs(used).max() < LARGEST:
        raise Unfit(f"reaches {np.abs(used).max():.3g} m: beyond what can be computed")
    extent = used.max(axis=0) - used.min(axis=0)
    if not np.all(extent > 1.0 / LARGEST):
        raise Unfit(f"is flat: it is {measures(extent)} m large")
    points, corners = welded(points, corners, TOGETHER * float(extent.max()))
    corners, empty = without_empty(corners)
    corners, repeated = without_repeated(corners) if len(corners) else (corners, 0)
    if not len(corners):
        raise Unfit(f"holds no {kind} that has an extent and is there once")
    corners, piece, turned = agreeing(points, corners)
    corners, turned_pieces = outward(points, corners, piece)
    fans, holes, missing, largest = closing(points, corners)
    elements = points[corners]
    area = float(np.linalg.norm(normals(elements), axis=1).sum())
    part = missing / area if area > 0.0 else math.inf
    if part > MOST_OPEN:
        raise Unfit(open_text(dim, holes, part, largest))
    whole = np.concatenate([elements, fans])
    if volume_of(whole) < LEAST_SOLID * float(np.prod(extent)):
        raise Unfit(
            f"encloses next to nothing: {volume_of(whole):.3g} {'m3' if dim == 3 else 'm2'} of {measures(extent)} m"
        )
    return Surface(
        np.ascontiguousarray(whole), Mended(empty, repeated, turned, turned_pieces, len(holes), part, largest)
    )


def open_text(dim: int, holes: np.ndarray, part: float, largest: float) -> str:
    if dim == 2:
        return (
            f"is open: {len(holes)} gap{'s' if len(holes) > 1 else ''} in its lines, the largest {largest:.3g} m wide; "
            f"{part:.1%} of the length is missing, at most {MOST_OPEN:.0%} is closed for you"
        )
    return (
        f"is open: {int(holes.sum())} edges with a triangle on one side only, around {len(holes)} hole"
        f"{'s' if len(holes) > 1 else ''}, the largest {largest:.3g} m across; {part:.1%} of the area is missing, at most "
        f"{MOST_OPEN:.0%} is closed for you"
    )


def measures(extent: np.ndarray) -> str:
    return " x ".join(f"{length:.4g}" for length in extent)


def connected(count: int, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the smallest number (count,) that each of `count` things is linked to; links join first[i] and second[i]."""
    root = np.arange(count)
    while True:
        before = root.copy()
        low = np.minimum(before[first], before[second])
        np.minimum.at(root, before[first], low)
        np.minimum.at(root, before[second], low)
        while not np.array_equal(root, root[root]):
            root = root[root]
        if np.array_equal(root, before):
            return root


def welded(points: np.ndarray, corners: np.ndarray, distance: float) -> tuple[np.ndarray, np.ndarray]:
    """Make one of points that lie together, and leave out those that no element has.

    Two grids of cells of this width, one shifted by half a cell: what shares a cell of either is one.
    """
    used, corners = np.unique(corners, return_inverse=True)
    points, corners = points[used], corners.reshape(-1, points.shape[1])
    steps = (points - points.min(axis=0)) / distance
    same = []
    for shift in (0.0, 0.5):
        cells = np.floor(steps + shift).astype(np.int64)
        order = np.lexsort(cells.T)
        new = np.concatenate([[True], np.any(np.diff(cells[order], axis=0), axis=1)])
        leader = order[np.flatnonzero(new)][np.cumsum(new) - 1]
        same.append((order, leader))
    root = connected(len(points), *(np.concatenate(ends) for ends in zip(*same, strict=True)))
    return points, root[corners]


def without_empty(corners: np.ndarray) -> tuple[np.ndarray, int]:
    """Leave out elements with a corner twice; also return how many."""
    dim = corners.shape[1]
    empty = np.zeros(len(corners), bool)
    for i in range(dim):
        empty |= corners[:, i] == corners[:, (i + 1) % dim]
    return corners[~empty], int(empty.sum())


def parity(corners: np.ndarray) -> np.ndarray:
    """Return +1 where the corners (n, dim) are an even permutation of their increasing order, -1 elsewhere."""
    if corners.shape[1] == 2:
        return np.where(corners[:, 0] < corners[:, 1], 1, -1)
    a, b, c = corners.T
    return np.where((a < b).astype(int) + (b < c) + (c < a) == 2, 1, -1)


def grouped(keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (order, number (n,) of the group of each of them in that order) of equal rows of keys (n, k)."""
    order = np.lexsort(keys.T)
    new = np.any(np.diff(keys[order], axis=0), axis=1)
    return order, np.concatenate([[0], np.cumsum(new)])


def without_repeated(corners: np.ndarray) -> tuple[np.ndarray, int]:
    """Leave one of elements with the same corners, none where as many look one way as the other, which is a wall without a
    thickness inside the body; unless all elements are there both ways, which is a surface drawn on both sides."""
    order, group = grouped(np.sort(corners, axis=1))
    first = order[np.concatenate([[True], np.diff(group) > 0])]
    if len(first) == len(corners):
        return corners, 0
    sign = parity(corners)
    net = np.bincount(group, sign[order])
    kept = net != 0.0
    if 2 * kept.sum() < len(kept):
        return corners[first], len(corners) - len(first)
    found = corners[first[kept]]
    other = sign[first[kept]] * net[kept] < 0.0
    found[other] = found[other][:, ::-1]
    return found, len(corners) - len(found)


def sides(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the sides of elements, ((m, dim - 1) points in increasing order, m = dim n; +1 or -1: the way the element goes
    around it, (m,); number of the element (m,)): edges of triangles, ends of segments."""
    count = len(corners)
    if corners.shape[1] == 2:
        ends = np.concatenate([corners[:, 1:], corners[:, :1]])
        return ends, np.repeat([1, -1], count), np.tile(np.arange(count), 2)
    edges = np.concatenate([corners[:, [i, (i + 1) % 3]] for i in range(3)])
    return np.sort(edges, axis=1), np.where(edges[:, 0] < edges[:, 1], 1, -1), np.tile(np.arange(count), 3)


def agreeing(points: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """Turn elements until those that share a side with one other agree, in each piece the fewer by area; return the elements,
    the piece (n,) that each belongs to, and how many were turned."""
    side, sign, element = sides(corners)
    order, group = grouped(side)
    alone = np.bincount(group)[group] == 2
    pairs = order[alone].reshape(-1, 2)
    a, b = element[pairs].T
    agree = sign[pairs[:, 0]] != sign[pairs[:, 1]]
    count = len(corners)
    if agree.all():
        return corners, connected(count, a, b), 0
    # Each element twice, as it is and turned: n and n + count. Links join what agrees.
    first, second = (
        np.concatenate([a, a + count]),
        np.concatenate([np.where(agree, b, b + count), np.where(agree, b + count, b)]),
    )
    root = connected(2 * count, first, second)
    other = root[:count] > root[count:]  # agrees with the first of its piece once it is turned
    piece = np.minimum(root[:count], root[count:]) % count
    area = np.linalg.norm(normals(points[corners]), axis=1)
    in_piece = np.bincount(piece, area, count), np.bincount(piece, area * other, count)
    wrong = other ^ (in_piece[1] > 0.5 * in_piece[0])[piece]
    wrong &= root[:count] != root[count:]  # one-sided, as a Moebius strip: no way to agree
    corners = corners.copy()
    corners[wrong] = corners[wrong][:, ::-1]
    return corners, piece, int(wrong.sum())


def outward(points: np.ndarray, corners: np.ndarray, piece: np.ndarray) -> tuple[np.ndarray, int]:
    """Turn pieces that look inward, unless they bound a cavity of another piece; also return how many were turned."""
    elements = points[corners]
    _, number = np.unique(piece, return_inverse=True)
    if number.max() == 0:
        return (corners[:, ::-1], 1) if volume_of(elements) < 0.0 else (corners, 0)
    sums = np.stack([np.bincount(number, axis) for axis in elements.mean(axis=1).T], -1)
    middle = sums / np.bincount(number)[:, None]
    volumes = np.bincount(number, simplices(elements - middle[number][:, None, :]))
    inward = np.flatnonzero(volumes < 0.0)
    if not len(inward):
        return corners, 0
    right = elements[volumes[number] >= 0.0]
    corners, turned = corners.copy(), 0
    for one in inward[:MOST_TURNED]:
        mine = number == one
        if not len(right) or abs(winding_of(right, elements[mine][0].mean(axis=0))) < 0.5:
            corners[mine] = corners[mine][:, ::-1]
            turned += 1
    return corners, turned


def closing(points: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Return (elements (k, dim, dim) that close the surface: a fan around the middle of each hole; how many sides each hole
    has; their area; how far the largest is across). In 2-D a loose end is joined to the middle of those near it."""
    dim = points.shape[1]
    side, sign, _ = sides(corners)
    order, group = grouped(side)
    net = np.bincount(group, sign[order]).astype(int)
    loose = np.flatnonzero(net)
    if not len(loose):
        return np.zeros((0, dim, dim)), np.zeros(0, int), 0.0, 0.0
    ends = side[order][np.concatenate([[True], np.diff(group) > 0])][loose]
    times = np.abs(net[loose])
    ends = np.repeat(np.where(net[loose, None] > 0, ends, ends[:, ::-1]), times, axis=0)
    hole = (
        holes_of(points, ends, np.repeat(np.sign(net[loose]), times))
        if dim == 2
        else connected(len(points), *ends.T)[ends[:, 0]]
    )
    _, hole, sizes = np.unique(hole, return_inverse=True, return_counts=True)
    places = points[ends]  # (k, dim - 1, dim)
    middle = np.stack([np.bincount(hole, axis) for axis in places.mean(axis=1).T], -1) / sizes[:, None]
    across = np.zeros(len(sizes))
    np.maximum.at(across, hole, 2.0 * np.linalg.norm(places.mean(axis=1) - middle[hole], axis=1))
    if dim == 2:
        forward = np.repeat(net[loose] > 0, times)
        pair = np.where(
            forward[:, None, None], np.stack([places[:, 0], middle[hole]], 1), np.stack([middle[hole], places[:, 0]], 1)
        )
        return pair, sizes, float(np.linalg.norm(normals(pair), axis=1).sum()), float(across.max())
    fans = np.stack([places[:, 1], places[:, 0], middle[hole]], axis=1)
    vector = np.stack([np.bincount(hole, axis) for axis in normals(fans).T], -1)
    return fans, sizes, float(np.linalg.norm(vector, axis=1).sum()), float(across.max())


def holes_of(points: np.ndarray, ends: np.ndarray, sign: np.ndarray) -> np.ndarray:
    """Return which loose ends (k, 1) of segments belong together (k,): where a line stops, the nearest that begins."""
    hole = np.arange(len(ends))
    begins = np.flatnonzero(sign < 0)
    for stop in np.flatnonzero(sign > 0):
        far = np.linalg.norm(points[ends[begins, 0]] - points[ends[stop, 0]], axis=1)
        nearest = int(np.argmin(far))
        hole[begins[nearest]] = stop
        begins = np.delete(begins, nearest)
    return hole


# ---- formulas ---------------------------------------------------------------------------------------------------------------


def normals(elements: np.ndarray) -> np.ndarray:
    """Return (n, dim) outward normals as long as the area (in 2-D the length) of each element."""
    if elements.shape[1] == 2:
        along = elements[:, 1] - elements[:, 0]
        return np.stack([along[:, 1], -along[:, 0]], axis=-1)
    return 0.5 * np.cross(elements[:, 1] - elements[:, 0], elements[:, 2] - elements[:, 0])


def simplices(elements: np.ndarray) -> np.ndarray:
    """Return (n,) signed volumes between the origin and each element."""
    dim = elements.shape[1]
    return np.einsum("ni,ni->n", elements[:, 0], normals(elements)) / dim


def cones(elements: np.ndarray, origin: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return an origin in the middle and the signed volumes (n,) between it and each element."""
    if origin is None:
        origin = 0.5 * (elements.min(axis=(0, 1)) + elements.max(axis=(0, 1)))
    return origin, simplices(elements - origin)


def volume_of(elements: np.ndarray) -> float:
    return math.fsum(cones(elements)[1])


def winding_of(elements: np.ndarray, point: np.ndarray) -> float:
    """How often elements go around one point, without a tree."""
    if elements.shape[1] == 2:
        (p, q) = np.moveaxis(elements - point, 1, 0)
        return float(np.arctan2(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0], (p * q).sum(axis=1)).sum() / (2.0 * np.pi))
    p, q, r = np.moveaxis(elements - point, 1, 0)
    a, b, c = (np.linalg.norm(side, axis=1) for side in (p, q, r))
    across = (p * np.cross(q, r)).sum(axis=1)
    along = a * b * c + (p * q).sum(axis=1) * c + (q * r).sum(axis=1) * a + (r * p).sum(axis=1) * b
    return float(np.arctan2(across, along).sum() / (2.0 * np.pi))


# ---- what makes it fast -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Tree:
    """Elements in the order of a tree, see kernels.surfaces; of each node (number 0 is none) the box around it (low, high), the
    middle of its area, its radius, and its dipole: (dim,) sum of normals, (dim, dim) of offsets times normals."""

    elements: np.ndarray
    boxes: np.ndarray
    centers: np.ndarray
    radii: np.ndarray
    dipoles: np.ndarray
    leaves: int
    depth: int


def tree_of(elements: np.ndarray) -> Tree:
    """Build the tree: at each depth the elements of a node are split in halves along the longest side of their middles."""
    count, dim = len(elements), elements.shape[1]
    depth = max(0, math.ceil(math.log2(count / LEAF)))
    middles = elements.mean(axis=1)
    order = np.arange(count)
    for level in range(depth):
        first = (np.arange(1 << level) * count) >> level
        here = middles[order]
        wide = np.maximum.reduceat(here, first) - np.minimum.reduceat(here, first)
        node = np.repeat(np.arange(1 << level), np.diff(np.append(first, count)))
        along = here[np.arange(count), np.argmax(wide, axis=1)[node]]
        order = order[np.lexsort((along, node))]
    elements = np.ascontiguousarray(elements[order])
    normal, middles = normals(elements), middles[order]
    area = np.linalg.norm(normal, axis=1)
    nodes = 2 << depth
    boxes, centers = np.zeros((nodes, 2, dim)), np.zeros((nodes, dim))
    radii, dipoles = np.zeros(nodes), np.zeros((nodes, dim + dim * dim))
    for level in range(depth + 1):
        first = (np.arange(1 << level) * count) >> level
        here = slice(1 << level, 2 << level)
        boxes[here, 0] = np.minimum.reduceat(elements.min(axis=1), first)
        boxes[here, 1] = np.maximum.reduceat(elements.max(axis=1), first)
        total = np.add.reduceat(area, first)[:, None]
        plain = 0.5 * (boxes[here, 0] + boxes[here, 1])
        with np.errstate(all="ignore"):
            weighted = np.add.reduceat(area[:, None] * middles, first) / total
        centers[here] = np.where(total > 0.0, weighted, plain)
        node = np.repeat(np.arange(1 << level), np.diff(np.append(first, count)))
        off = centers[here][node]
        radii[here] = np.maximum.reduceat(np.linalg.norm(elements - off[:, None, :], axis=2).max(axis=1), first)
        dipoles[here, :dim] = np.add.reduceat(normal, first)
        tilt = ((middles - off)[:, :, None] * normal[:, None, :]).reshape(count, -1)
        dipoles[here, dim:] = np.add.reduceat(tilt, first)
    return Tree(elements, boxes, centers, radii, dipoles, 1 << depth, depth)


@dataclass(frozen=True)
class Grid:
    """A grid of cubes over a surface: corner, 1 over the width, how many along each axis, and what is known of each."""

    start: np.ndarray
    inv_width: float
    shape: np.ndarray
    kinds: np.ndarray


def grid_of(surface: Surface, mark_cut) -> Grid:
    low, high = surface.bounds()
    wanted = min(FINEST, BOXES_PER_ELEMENT * len(surface.elements))
    width = float(np.prod(high - low) / wanted) ** (1.0 / surface.dim)
    width = max(width, float((high - low).max()) / FINEST)  # of a needle
    shape = np.maximum(np.ceil((high - low) / width), 1.0).astype(np.int64)
    shape = np.append(shape, np.ones(3 - surface.dim, np.int64))
    kinds = np.zeros(int(np.prod(shape)), np.int8)
    start = np.append(low, np.zeros(3 - surface.dim))
    mark_cut(surface.tree.elements, start, 1.0 / width, shape, kinds)
    return Grid(start, 1.0 / width, shape, kinds)


def rows_of(points: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(points, float)
