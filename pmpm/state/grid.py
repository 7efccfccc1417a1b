"""The background grid: its extent over the whole domain, and one rank's ghost-padded patch: the nodes near material."""

from dataclasses import dataclass

import numpy as np

from pmpm.kernels.alignment import aligned
from pmpm.kernels.needs import Stencil
from pmpm.kernels.spans import QUADS

SLACK = 0.5  # cells that particles may travel along an axis before nodes are laid out anew, on processors
ROUNDING = 2.0**-10  # cells: of what they travel in steps
WINDOW_BYTES = 1 << 20  # of scratch planes that P2G keeps at a time: about what a core's own cache holds


@dataclass(frozen=True)
class Geometry:
    """The grid of the whole domain. Per physical axis: cells, whether it is periodic; `axes` as in kernels.needs."""

    cells: tuple[int, ...]
    periodic: tuple[bool, ...]
    cell_size: float
    axes: tuple[int, int, int]
    stencil: Stencil

    @property
    def dim(self):
        return len(self.cells)

    def homes(self, axis):
        """How many nodes of an axis can be a particle's centre node: 0 .. homes - 1."""
        on_last_node = 0 if self.periodic[axis] or self.stencil.round == 0.0 else 1
        return self.cells[axis] + on_last_node

    @property
    def layers(self):
        return self.homes(self.axes[0])

    def extent(self, axis):
        """Nodes of an axis including the ghosts a padded stencil reaches."""
        return self.homes(axis) + self.stencil.reach_low + self.stencil.reach_high

    @property
    def row_padding(self):
        """Nodes at the end of a row: for what a row of four has beyond the stencil, and boxes taken in rows of four."""
        return 4 - self.stencil.nodes + 3

    @property
    def plane_shape(self):
        """Nodes of a plane along middle and row; rows are padded so that no row of four nodes leaves its own."""
        _, middle, row = self.axes
        return (1 if middle < 0 else self.extent(middle), self.extent(row) + self.row_padding)


@dataclass
class Images:
    """Pairs of nodes of one periodic axis that are the same node, (n,) numbers each, by plane; plane_start (planes + 1,)."""

    low: np.ndarray
    high: np.ndarray
    plane_start: np.ndarray

    def sum(self, values, first, last):
        """Both images on planes first .. last - 1 get the total."""
        here = slice(self.plane_start[first], self.plane_start[last])
        low, high = self.low[here], self.high[here]
        total = values[low] + values[high]
        values[low], values[high] = total, total


class Patch:
    """This rank's nodes: those that its particles reach on planes first_plane .. first_plane + planes - 1; and scratch.

    nodes (fields, n, 4), of each velocity field: momentum or velocity (3), mass; in quads, plane after plane, row after row.
    `before`: velocities before the step, for schemes that blend; `divergences`, and `velocities` to keep meanwhile, for F-bar;
    `volumes`: gradient and volume of what lies around, for contact; otherwise the nodes themselves.
    spans (m, 3), row_start and first_quads (m + 1,), placed and placed_start: which nodes there are, see kernels.spans.
    windows and rings: what P2G and G2P work in, one per thread, from `corner` (middle, row, rows of a plane) on. One law needs
    one window; several need some, so that each does a few layers at a time. `slots` (layers, window): where in `unsummed`, in
    quads, a layer's plane is kept apart, or -1.
    """

    def __init__(self, geometry, first_layer, last_layer, laws, real, blends=False, f_bar=False, threads=1, fields=1):
        stencil, layers = geometry.stencil, last_layer - first_layer
        self.geometry, self.real, self.laws, self.threads = geometry, real, laws, threads
        self.blends, self.f_bar, self.fields = blends, f_bar, fields
        self.layers, self.first_layer, self.first_plane = layers, first_layer, first_layer - stencil.reach_low
        self.planes = layers + stencil.window - 1 if layers else 0
        self.rows, row = geometry.plane_shape
        self.row_quads = -(-row // 4)
        self.words = -(-self.row_quads // QUADS)
        self.apart: list[tuple[int, int]] = []
        self.rooms: dict[str, np.ndarray] = {}
        self.images: list[Images] = []
        self.travelled = 0.0  # cells that a particle may have come along any axis since the nodes were laid out
        self.stale = False  # whether particles have been ordered anew since then
        self.take_marks(np.zeros((self.planes, self.rows, self.words), np.uint32))
        self.place_layers(np.zeros((0, 3), np.int64), None)

    def keep_apart(self, pairs):
        """Let P2G keep planes of layers, (layer, plane of its window) each, apart. Returns them as an array."""
        self.apart += pairs
        return np.array(pairs, np.int64).reshape(-1, 2)

    def lay_out(self, mark, kernels, mirrors, slack=SLACK):
        """Take the nodes that the particles reach, now and until any has travelled `slack` cells along an axis.

        `mark(marks, slack)` marks what they reach, see kernels.spans; mirrors: (array axis, number of the plane, row or node on
        it) of the walls. What one of a pair of images reaches the other has, too: whatever is added to either can be told to
        both.
        """
        geometry = self.geometry
        marks = np.zeros((self.layers, self.rows, self.words), np.uint32)
        mark(marks, slack + ROUNDING)
        if geometry.axes[1] >= 0:
            marks = widened(marks, geometry.stencil.nodes - 1)
        planes = np.zeros((self.planes, self.rows, self.words), np.uint32)
        for k in range(geometry.stencil.window if self.layers else 0):
            planes[k : k + self.layers] |= marks
        for place, on in mirrors:
            reach = geometry.stencil.beyond
            share(planes, place, [range(on - reach, on + reach + 1)])
        for place, cells in self.repeats():
            shared = range(geometry.stencil.window - 1)
            share(planes, place, [shared, range(cells, cells + len(shared))], pairwise=True)
        self.take_marks(planes, kernels)
        self.place_layers(spans_of(marks, kernels), kernels)
        self.images = [self.images_of(place, cells) for place, cells in self.repeats()]
        self.travelled, self.stale = 0.0, False

    def repeats(self):
        """(array axis, cells) of the periodic axes other than the slab axis."""
        axes, geometry = self.geometry.axes, self.geometry
        return [
            (place, geometry.cells[axes[place]])
            for place in (1, 2)
            if axes[place] >= 0 and geometry.periodic[axes[place]]
        ]

    def take_marks(self, planes, kernels=None):
        """Make nodes of the quads that are marked on planes."""
        self.marks = planes
        self.spans = spans_of(planes, kernels) if kernels else np.zeros((0, 3), np.int64)
        sizes = self.spans[:, 2] - self.spans[:, 1]
        self.first_quads = np.concatenate([[0], np.cumsum(sizes)])
        self.row_start = np.searchsorted(self.spans[:, 0], np.arange(self.planes * self.rows + 1))
        self.plane_start = self.first_quads[self.row_start[:: max(self.rows, 1)]]
        self.quads = int(self.first_quads[-1])
        self.nodes = self.of_fields("nodes", self.quads)
        self.before = self.of_fields("before", self.quads) if self.blends else self.nodes
        self.divergences = self.of_fields("divergences", self.quads) if self.f_bar else self.nodes
        self.velocities = self.of_fields("velocities", self.quads) if self.f_bar else self.nodes
        self.volumes = self.of_fields("volumes", self.quads) if self.fields > 1 else self.nodes
        rows = self.spans[:, 0] % max(self.rows, 1)
        low, high = (rows.min(), rows.max() + 1) if len(rows) else (0, 1)
        first, last = (self.spans[:, 1].min(), self.spans[:, 2].max()) if len(rows) else (0, 1)
        self.corner = np.array([low, 4 * first, self.rows])
        self.make_windows(int(high - low), int(last - first))

    def make_windows(self, middles, quads):
        """Windows and rings of so many rows and quads per thread; what is kept apart and added has left windows zero."""
        stencil = self.geometry.stencil
        window = stencil.window * middles * quads
        count = 1
        if self.laws > 1:
            count = max(1, min(self.layers, WINDOW_BYTES // (16 * window * np.dtype(self.real).itemsize)))
        self.chunk = max(self.layers, 1) if self.laws == 1 else count  # layers that all laws do before the next
        shape = (middles, 4 * quads, 4)
        windows = self.room("windows", self.threads * count * window)
        self.windows = windows.reshape(self.threads, count, stencil.window, *shape)
        rings, planes = 1 + self.blends + self.f_bar, stencil.window + stencil.nodes - 1
        room = self.room("rings", self.threads * rings * planes * middles * quads)
        self.rings = room.reshape(self.threads, rings, planes, *shape)

    def place_layers(self, layer_spans, kernels):
        """Find where the nodes of each layer lie, and room for what is kept apart."""
        self.placed = np.zeros((len(layer_spans), 3 + self.geometry.stencil.window), np.int64)
        if kernels:
            kernels.place_spans(layer_spans, self.rows, self.spans, self.row_start, self.first_quads, self.placed)
        starts = np.arange(self.layers + 1) * self.rows
        self.placed_start = np.searchsorted(layer_spans[:, 0], starts)
        ends = np.concatenate([[0], np.cumsum(layer_spans[:, 2] - layer_spans[:, 1])])
        self.layer_quads = np.diff(ends[self.placed_start])
        self.slots = np.full((self.layers, self.geometry.stencil.window), -1)
        sizes = [self.layer_quads[layer] for layer, _ in self.apart]
        self.slot_start = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
        for (layer, k), start in zip(self.apart, self.slot_start, strict=False):
            self.slots[layer, k] = start
        self.unsummed = self.of_fields("unsummed", int(self.slot_start[-1]))

    def add_apart(self, kernels, pairs):
        """Add what P2G has kept apart of (layer, plane of its window) pairs, one after another."""
        for nodes, unsummed in zip(self.nodes, self.unsummed, strict=True):
            kernels.add_slots(nodes, unsummed, self.placed, self.placed_start, self.slots, pairs)

    def of_fields(self, name, quads):
        """(fields, 4 quads, 4) of `room`."""
        return self.room(name, self.fields * quads).reshape(self.fields, -1, 4)

    def room(self, name, quads):
        """(4 quads, 4) reals that are zero at first, kept under this name; larger ones take the place of smaller ones."""
        size = 16 * quads
        if name not in self.rooms or len(self.rooms[name]) < size:
            self.rooms[name] = aligned(size + size // 8, self.real)
        return self.rooms[name][:size].reshape(-1, 4)

    def find(self, plane, middle, node):
        """Numbers of nodes by their plane, row and number in the row, arrays; -1 where there is none."""
        plane, middle, node = np.broadcast_arrays(plane, middle, node)
        width = QUADS * self.words
        inside = (plane >= 0) & (plane < self.planes) & (middle >= 0) & (middle < self.rows) & (node >= 0)
        row, quad = plane * self.rows + middle, node >> 2
        begins = self.spans[:, 0] * width + self.spans[:, 1]
        span = np.searchsorted(begins, row * width + quad, side="right") - 1
        if not len(begins):
            return np.full(row.shape, -1)
        there = inside & (span >= 0) & (self.spans[span, 0] == row) & (quad < self.spans[span, 2])
        return np.where(there, 4 * (self.first_quads[span] + quad - self.spans[span, 1]) + (node & 3), -1)

    def nodes_of(self, spans):
        """(plane, middle, node) of all nodes of some spans (a mask or numbers), arrays."""
        rows, first, last = self.spans[spans].T
        sizes = 4 * (last - first)
        of_span = np.repeat(np.arange(len(sizes)), sizes)
        within = np.arange(len(of_span)) - (np.cumsum(sizes) - sizes)[of_span]
        return rows[of_span] // self.rows, rows[of_span] % self.rows, 4 * first[of_span] + within

    def nodes_on(self, place, number):
        """(plane, middle, node) of all nodes on one plane (place 0), on one row of each (1), at one place of each row (2)."""
        rows, first, last = self.spans.T
        if place == 2:
            held = (4 * first <= number) & (number < 4 * last)
            row = rows[held]
            return row // self.rows, row % self.rows, np.full(len(row), number)
        return self.nodes_of(rows // self.rows == number if place == 0 else rows % self.rows == number)

    def images_of(self, place, cells):
        """The images of a periodic axis on all planes."""
        found = [self.nodes_on(place, number) for number in range(self.geometry.stencil.window - 1)]
        low = [np.concatenate(column) for column in zip(*found, strict=True)]
        order = np.argsort(low[0], kind="stable")
        low = [column[order] for column in low]
        high = [column + cells * (axis == place) for axis, column in enumerate(low)]
        low_numbers, high_numbers = self.find(*low), self.find(*high)
        both = (low_numbers >= 0) & (high_numbers >= 0)
        start = np.searchsorted(low[0][both], np.arange(self.planes + 1))
        return Images(low_numbers[both], high_numbers[both], start)


def widened(marks, behind):
    """Marks of rows, and of so many rows behind each."""
    found = marks.copy()
    for shift in range(1, behind + 1):
        found[:, shift:] |= marks[:, :-shift]
    return found


def share(planes, place, groups, pairwise=False):
    """Let planes, rows or nodes (by place) have the marks of each other: all of the groups, or the n-th of each.

    Sharing along one axis leaves what is shared along another one as it is, so that once each is enough.
    """
    if place == 2:  # in quads, all with all: a few nodes more than needed
        quads = sorted({node >> 2 for group in groups for node in group if node >= 0})
        bits = [(quad // QUADS, np.uint32(1 << (quad % QUADS))) for quad in quads]
        held = np.zeros(planes.shape[:2], bool)
        for word, bit in bits:
            held |= planes[:, :, word] & bit != 0
        for word, bit in bits:
            planes[:, :, word] |= np.where(held, bit, np.uint32(0))
        return
    sets = zip(*groups, strict=True) if pairwise else groups
    for numbers in sets:
        here = [number for number in numbers if 0 <= number < planes.shape[place]]
        views = [planes[number] if place == 0 else planes[:, number] for number in here]
        if views:
            union = np.bitwise_or.reduce(views)
            for view in views:
                view[...] = union


def spans_of(marks, kernels):
    """(n, 3) int64 spans of marks (planes or layers, rows, words), with rows counted through."""
    flat = marks.reshape(-1, marks.shape[2])
    spans = np.zeros((kernels.find_spans(flat, np.zeros((0, 3), np.int64)), 3), np.int64)
    kernels.find_spans(flat, spans)
    return spans
