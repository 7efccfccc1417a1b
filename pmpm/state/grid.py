"""The background grid: its extent over the whole domain, and one rank's ghost-padded patch of nodes."""

from dataclasses import dataclass

import numpy as np

from pmpm.kernels.loops import EMPTY_BOX
from pmpm.kernels.needs import Stencil

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


class Patch:
    """This rank's nodes: planes first_plane .. first_plane + planes - 1, and the scratch windows of P2G.

    nodes (planes, middle, row, 4): momentum or velocity (3), mass. boxes (planes, 4) and layer_boxes (layers, 4): where along
    middle and row a plane, and what a layer has given, is not zero. One law needs one window; several need some, so that each
    does a few layers at a time. `before`: velocities before the step, for schemes that blend; `divergences`, and
    `velocities` to keep meanwhile, for F-bar; otherwise the nodes themselves.
    """

    def __init__(self, geometry, first_layer, last_layer, laws, real, blends=False, f_bar=False):
        stencil, shape = geometry.stencil, geometry.plane_shape
        layers = last_layer - first_layer
        self.first_plane = first_layer - stencil.reach_low
        self.planes = layers + stencil.reach_low + stencil.reach_high if layers else 0
        self.nodes = np.zeros((self.planes, *shape, 4), real)
        self.before = np.zeros_like(self.nodes) if blends else self.nodes
        self.divergences = np.zeros_like(self.nodes) if f_bar else self.nodes
        self.velocities = np.zeros_like(self.nodes) if f_bar else self.nodes
        self.boxes = np.tile(np.array(EMPTY_BOX), (self.planes, 1))
        self.layer_boxes = np.tile(np.array(EMPTY_BOX), (layers, 1))
        window_bytes = stencil.window * shape[0] * shape[1] * 4 * np.dtype(real).itemsize
        windows = 1 if laws == 1 else max(1, min(layers, WINDOW_BYTES // window_bytes))
        self.windows = np.zeros((windows, stencil.window, *shape, 4), real)
        self.chunk = max(layers, 1) if laws == 1 else windows  # layers that all laws do before the next
