"""Colliders as one rank's patch meets them: where they are now, which nodes lie inside of them, and what these have given them.

What a collider is given is counted in whole numbers of a small unit, node by node: sums of whole numbers are the same for any
order, hence for any ranks and threads. A node that two ranks have, the one with the earlier layers counts.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from pmpm import estimate
from pmpm.kernels.spans import QUADS
from pmpm.scene.colliders import SampledDistance, nearest_image, normals_of, rotation, spin_at
from pmpm.scene.forcing import velocity_at
from pmpm.scene.shapes import leaves_of

NORMAL_STEP = 1e-3  # cells: over which the distance is differenced
SAMPLES = 0.5  # cells between samples of a distance that takes long to find
ON_SURFACE = 1e-9  # cells: nodes no farther out than this are inside
UNITS = 58  # powers of two below the largest momentum that a scene may hold
LIMB = 1 << 40  # in which numbers of units are summed over ranks


@dataclass
class Contact:
    """Nodes of a patch inside of a collider, by plane (plane_start), with what its surface is there: normals, velocities (m/s),
    arms from the pivot (m). `counted`: 1.0 for nodes that this rank counts, else 0.0; `own`: whether a node is no image."""

    numbers: np.ndarray
    plane_start: np.ndarray
    normals: np.ndarray
    velocities: np.ndarray
    arms: np.ndarray
    own: np.ndarray
    counted: np.ndarray
    on_card: Any = None

    def between(self, first_plane, last_plane):
        """Which of the nodes lie on planes first_plane .. last_plane - 1: (first, last + 1)."""
        return int(self.plane_start[first_plane]), int(self.plane_start[last_plane])

    def disown(self, others):
        """Leave the nodes of these numbers to another rank."""
        counted = (self.own & ~np.isin(self.numbers, others)).astype(self.counted.dtype)
        if not np.array_equal(counted, self.counted):
            self.counted, self.on_card = counted, None


class Obstacle:
    """A collider of the scene. `start` takes the time of a step, `travel` its length."""

    def __init__(self, collider, scene, real, unit):
        self.collider, self.name, self.real, self.dim = collider, collider.name, real, scene.dim
        self.type, self.coefficient = collider.surface.type, real(collider.surface.coefficient)
        size = np.array(scene.domain.size)
        self.low, self.high = collider.bounds(self.dim)
        self.periods = collider.repeats(scene.domain.periods)
        near, far = collider.within(scene.domain.size, scene.domain.periods)
        self.pivot = collider.center(scene.domain.size, scene.domain.periods)
        self.sampled = sampled_distance(collider.shape, scene.domain.cell_size)
        self.reach = float(np.linalg.norm(np.maximum(np.abs(near - self.pivot), np.abs(far - self.pivot))))
        self.unit, self.length = unit, 2.0 ** math.ceil(math.log2(float(size.max())))
        self.per_unit, self.per_reach = real(1.0 / unit), real(1.0 / self.length)
        self.shift, self.turn = np.zeros(self.dim), np.eye(self.dim)
        self.velocity, self.spin = np.zeros(self.dim), np.zeros(1 if self.dim == 2 else 3)
        self.time = math.nan  # of the step to come
        self.parts = self.dim + len(self.spin)
        self.found: list[np.ndarray] = []  # of this step, whole numbers of units
        self.impulse = [0] * self.parts  # units given to it since the run began, as far as this rank has counted them
        self.told = (0.0, [0] * self.parts)  # when the mean force was last asked for, and all of the impulse then
        self.masks: dict[int, np.ndarray] = {}  # by plane, quads with a node inside, of one that rests
        self.mask: np.ndarray | None = None  # the same of the patch
        self.contact: Contact | None = None

    # ---- where it is ----

    def meet(self, geometry, patch):
        """Take note of a new patch."""
        self.geometry, self.patch, self.contact, self.mask = geometry, patch, None, None

    def lay_out(self):
        """Take note that the patch has other nodes."""
        self.contact = None

    def start(self, time):
        """Take the velocities of a step that begins at `time` (s): functions are asked once for each time."""
        if time == self.time:
            return
        collider, self.time = self.collider, time
        if collider.velocity is not None:
            self.velocity = np.array(velocity_at(collider.velocity, time))
        elif collider.path is not None:
            self.velocity = path_velocity(collider.path, time, self.dim)
        if collider.angular_velocity is not None:
            self.spin = spin_at(collider.angular_velocity, time, self.dim)

    def travel(self, dt):
        """Move through a step, and add up what it has been given."""
        for found in self.found:
            self.impulse = [a + int(b) for a, b in zip(self.impulse, found, strict=True)]
        self.found.clear()
        if self.collider.moves:
            self.shift = self.shifted(float(dt))
            self.turn = rotation(float(dt) * self.spin) @ self.turn
            self.contact = None

    def shifted(self, dt):
        """How far (m) it will have moved at the end of a step: along a path as told, so that kinks do not add up to a drift."""
        path = self.collider.path
        if path is None:
            return self.shift + dt * self.velocity
        return path.displacement(self.time + dt) - path.displacement(0.0)

    def speed(self, time):
        """Bound (m/s) of what any part of its surface does at a time."""
        self.start(time)
        return float(np.linalg.norm(self.velocity) + np.linalg.norm(self.spin) * self.reach)

    def at_start(self, points):
        """Where what is at points (n, dim) now was at the start."""
        return (points - self.pivot - self.shift) @ self.turn + self.pivot

    def distance(self, points):
        """How far (n,) m points (n, dim) m are from its surface, where it was at the start; negative inside."""
        return self.collider.signed_distance(points, self.time) if self.sampled is None else self.sampled(points)

    def normals(self, points):
        """Unit vectors (n, dim) out of it at such points."""
        own = getattr(self.collider.shape, "normals", None)
        return normals_of(self.distance, points, NORMAL_STEP * self.geometry.cell_size) if own is None else own(points)

    def box(self):
        """Corners (low, high), (dim,) each, of a box around it now."""
        if not (np.isfinite(self.low).all() and np.isfinite(self.high).all()):
            resting = not self.spin.any() and np.array_equal(self.turn, np.eye(self.dim))
            return (
                (self.low + self.shift, self.high + self.shift) if resting else (self.low - np.inf, self.high + np.inf)
            )
        corners = np.stack(np.meshgrid(*zip(self.low, self.high, strict=True), indexing="ij"), -1).reshape(-1, self.dim)
        corners = (corners - self.pivot) @ self.turn.T + self.pivot + self.shift
        return corners.min(axis=0), corners.max(axis=0)

    # ---- its nodes ----

    def nodes(self, others):
        """The Contact with the patch now. `others`: numbers of nodes that another rank counts."""
        if self.contact is None:
            self.contact = self.find_contact()
            self.contact.disown(others)
        return self.contact

    def find_contact(self):
        patch, dx = self.patch, self.geometry.cell_size
        plane, middle, node = self.candidates()
        x = self.places(plane, middle, node)
        before = self.at_start(x)
        inside = self.distance(before) <= ON_SURFACE * dx
        plane, middle, node, x, before = (values[inside] for values in (plane, middle, node, x, before))
        normals = self.normals(before) @ self.turn.T
        arms = x - self.pivot - self.shift
        own = np.ones(len(x), bool)
        for place, numbers in ((1, middle), (2, node)):
            axis = self.geometry.axes[place]
            if axis >= 0 and self.geometry.periodic[axis]:
                own &= numbers < self.geometry.cells[axis]
        return Contact(
            patch.find(plane, middle, node),
            np.searchsorted(plane, np.arange(patch.planes + 1)),
            normals.astype(self.real),
            (self.velocity + turning(self.spin, arms)).astype(self.real),
            arms.astype(self.real),
            own,
            own.astype(self.real),
        )

    def candidates(self):
        """(plane, middle, node) of nodes of the patch in quads that may have one inside, plane after plane."""
        bits = self.patch.marks & (self.box_mask() if self.collider.moves else self.resting_mask())
        plane, row, word = np.nonzero(bits)
        one, bit = np.nonzero((bits[plane, row, word, None] >> np.arange(QUADS, dtype=np.uint32)) & np.uint32(1))
        quad = QUADS * word[one] + bit
        return np.repeat(plane[one], 4), np.repeat(row[one], 4), (4 * quad[:, None] + np.arange(4)).reshape(-1)

    def coordinates(self, place, numbers):
        """m along the axis of an array axis, of planes, rows or nodes of rows of the patch: of the images nearest to it."""
        geometry, axis = self.geometry, self.geometry.axes[place]
        node = numbers + (self.patch.first_plane if place == 0 else -geometry.stencil.reach_low)
        if geometry.periodic[axis]:
            node = node % geometry.cells[axis]
        x = node * geometry.cell_size
        if not math.isfinite(self.periods[axis]):
            return x
        low, high = self.box()
        return nearest_image(x, low[axis], high[axis], self.periods[axis])

    def places(self, plane, middle, node):
        """(n, dim) coordinates of nodes."""
        points = np.empty((len(plane), self.dim))
        for place, numbers in enumerate((plane, middle, node)):
            axis = self.geometry.axes[place]
            if axis >= 0:
                points[:, axis] = self.coordinates(place, numbers)
        return points

    def within_box(self, place, numbers):
        """Whether planes, rows or nodes of rows of these numbers meet the box around it."""
        axis = self.geometry.axes[place]
        if axis < 0:
            return np.ones(len(numbers), bool)
        low, high = self.box()
        x, margin = self.coordinates(place, numbers), ON_SURFACE * self.geometry.cell_size
        return (x >= low[axis] - margin) & (x <= high[axis] + margin)

    def box_mask(self):
        """Marks of the quads of the patch that meet the box around it, see kernels.spans."""
        planes, rows, words = self.patch.marks.shape
        quads = self.within_box(2, np.arange(4 * QUADS * words)).reshape(-1, 4).any(axis=1)
        across = self.within_box(0, np.arange(planes))[:, None] & self.within_box(1, np.arange(rows))
        return np.where(across[:, :, None], packed(quads[None])[0], np.uint32(0))

    def resting_mask(self):
        """Marks of the quads of the patch with a node inside: found once for each plane, for it rests."""
        if self.mask is None:
            planes, rows, words = self.patch.marks.shape
            masks = [self.plane_mask(plane) for plane in range(planes)]
            self.mask = np.stack(masks) if masks else np.zeros((0, rows, words), np.uint32)
        return self.mask

    def plane_mask(self, plane):
        number, (_, rows, words) = self.patch.first_plane + plane, self.patch.marks.shape
        if number not in self.masks:
            within = np.zeros((rows, 4 * QUADS * words), bool)
            if self.within_box(0, np.array([plane]))[0]:
                middles = np.flatnonzero(self.within_box(1, np.arange(rows)))
                nodes = np.flatnonzero(self.within_box(2, np.arange(4 * QUADS * words)))
                i, j = np.repeat(middles, len(nodes)), np.tile(nodes, len(middles))
                x = self.places(np.full(len(i), plane), i, j)
                margin = ON_SURFACE * self.geometry.cell_size
                within[i, j] = self.distance(self.at_start(x)) <= margin
            self.masks[number] = packed(within.reshape(rows, -1, 4).any(axis=2))
        return self.masks[number]

    # ---- what it has been given ----

    def in_newtons(self, units):
        """(impulse (dim,) in N s, its moment about the pivot in N m s) of whole numbers of units."""
        linear = np.array([float(n) * self.unit for n in units[: self.dim]])
        return linear, np.array([float(n) * self.unit * self.length for n in units[self.dim :]])

    def total(self, comm):
        """Units of all ranks since the run began. Collective."""
        limbs = [divmod(n, LIMB) for n in self.impulse]
        summed = comm.sum(np.array(limbs, np.int64))
        return [int(high) * LIMB + int(low) for high, low in summed]

    def mean_force(self, comm, time):
        """Mean force (N) and torque (N m) since they were last asked for. Collective."""
        (before, units), now = self.told, self.total(comm)
        self.told = (time, now)
        linear, angular = self.in_newtons([a - b for a, b in zip(now, units, strict=True)])
        duration = time - before
        return (linear / duration, angular / duration) if duration > 0.0 else (0.0 * linear, 0.0 * angular)

    # ---- over a restart ----

    def state(self, comm):
        """What it takes to go on, as plain numbers. Collective."""
        return {
            "shift": self.shift.tolist(),
            "turn": self.turn.tolist(),
            "impulse": self.total(comm),
            "told_time": self.told[0],
            "told": self.told[1],
            "unit": self.unit,
        }

    def resume(self, state, rank):
        """Go on from what `state` gave."""
        self.shift, self.turn = np.array(state["shift"]), np.array(state["turn"])
        self.impulse = list(state["impulse"]) if rank == 0 else [0] * self.parts
        self.told = (state["told_time"], list(state["told"]))
        self.unit = state["unit"]
        self.per_unit, self.contact = self.real(1.0 / self.unit), None


def sampled_distance(shape, cell_size):
    """The SampledDistance of a shape made of meshes, whose own distance takes microseconds a point; None for others."""
    if shape is None or all(leaf.type != "mesh" for _, leaf in leaves_of(shape)):
        return None
    low, high = shape.bounds()
    return SampledDistance(shape, SAMPLES * cell_size) if np.isfinite([low, high]).all() else None


def unit_of_momentum(scene, needs, tables, real):
    """kg m/s, a power of two: far below what matters, far above what would overflow, and with an inverse in this precision."""
    density = max(material.parameters["density"] for material in scene.materials.values())
    by_waves = estimate.stable_bounds(scene, needs, tables)[0]
    fall = math.sqrt(float(np.linalg.norm(scene.domain.gravity)) * max(scene.domain.size))
    speed = max(scene.domain.cell_size / by_waves, fall) or 1.0
    most = density * math.prod(scene.domain.size) * speed
    return max(2.0 ** (math.floor(math.log2(most)) - UNITS), 4.0 * float(np.finfo(real).tiny))


def path_velocity(path, time, dim):
    """m/s along a path at a time; none before its first time and from its last one on."""
    place = int(np.searchsorted(path.times, time, side="right"))
    if place in (0, len(path.times)):
        return np.zeros(dim)
    way = np.subtract(path.displacements[place], path.displacements[place - 1])
    return way / (path.times[place] - path.times[place - 1])


def turning(spin, arms):
    """Velocity (n, dim), m/s, at arms (n, dim) of what turns at `spin`, rad/s."""
    if len(spin) == 1:
        return spin[0] * np.stack([-arms[:, 1], arms[:, 0]], axis=1)
    return np.cross(spin, arms)


def packed(quads):
    """(rows, words) uint32 of (rows, 32 words) bools."""
    bits = np.packbits(quads, axis=1, bitorder="little")
    return np.ascontiguousarray(bits).view("<u4").astype(np.uint32)
