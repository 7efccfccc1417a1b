"""What drives a simulation from outside at a given time: gravity, loads, walls, regions and colliders in motion; and how its
bodies touch each other."""

import numpy as np

from pmpm.kernels.lanes import WIDTH
from pmpm.scene.forcing import velocity_at
from pmpm.scene.needs import velocity_fields

ROUNDING = 64.0  # eps of the volume around a node that may be missing where bodies fill it


class Drive:
    """The outside of a scene as one rank's patch meets it. `start` takes the time of a step, the rest follows from it.

    `mouths`: of the inflows (flow.Mouth), the last regions."""

    def __init__(self, scene, needs, tables, real, mouths=()):
        self.scene, self.real, self.dim = scene, real, scene.dim
        self.gravity = np.array(scene.domain.gravity)
        self.has_gravity = bool(self.gravity.any())
        self.gravity_row = np.tile(np.append(self.gravity, np.zeros(4 - self.dim)), WIDTH // 4).astype(real)
        self.damping = scene.method.damping
        self.regions = [*(Region(motion, self.dim) for motion in scene.motions), *mouths]
        self.obstacles = obstacles_of(scene, needs, tables, real)
        self.touching = Touching(scene, needs, real) if needs.contact else None
        self.others = np.zeros(0, np.int64)  # nodes on which another rank counts what colliders are given
        self.heads = b""
        self.time, self.factor = 0.0, real(1.0)
        self.largest_load = 0.0  # m/s2, of any particle; whoever fills the simulation tells
        self.pull = float(np.linalg.norm(self.gravity))

    def meet(self, geometry, patch, walls):
        """Take note of a new patch and its walls."""
        self.walls = [wall for wall in walls if self.scene.domain.wall(wall.face).velocity is not None]
        for moving in (*self.regions, *self.obstacles):
            moving.meet(geometry, patch)
        self.leave_none()
        self.start(self.time)

    def lay_out(self):
        """Take note that the patch has other nodes."""
        for moving in (*self.regions, *self.obstacles):
            moving.lay_out()
        self.leave_none()

    def contact(self, obstacle):
        """The nodes of a collider now."""
        return obstacle.nodes(self.others)

    def leave_none(self):
        """Take no node for one of others until `note_shared` tells."""
        self.others, self.heads = np.zeros(0, np.int64), b""

    def note_shared(self, halo):
        """Leave what colliders are given on nodes that a rank with earlier layers has to that rank: its messages have come."""
        heads = halo.heads() if self.obstacles else b""
        if heads != self.heads:
            self.heads, self.others = heads, halo.earlier_nodes()
            for obstacle in self.obstacles:
                if obstacle.contact is not None:
                    obstacle.contact.disown(self.others)

    def fastest(self, time):
        """Bound in m/s of what the surface of a collider does."""
        return max((obstacle.speed(time) for obstacle in self.obstacles), default=0.0)

    def start(self, time):
        """Set what acts in a step that begins at `time` (s)."""
        self.time, self.factor = time, self.real(self.grown(time))
        for wall in self.walls:
            wall.velocity[:] = velocity_at(self.scene.domain.wall(wall.face).velocity, time)
        for moving in (*self.regions, *self.obstacles):
            moving.start(time)

    def grown(self, time):
        """The part of gravity and loads that acts at a time."""
        ramp = self.scene.time.ramp
        return min(time / ramp, 1.0) if ramp > 0.0 else 1.0

    def acceleration(self, time):
        """Bound in m/s2 of what gravity and loads give a particle."""
        return self.grown(time) * (self.pull + self.largest_load)

    def finish(self, dt):
        """Let regions and colliders travel through a step."""
        for moving in (*self.regions, *self.obstacles):
            moving.travel(dt)

    def gravity_gain(self, dt):
        """Velocity that gravity gives to a row of four nodes."""
        return self.gravity_row * (self.factor * self.real(dt))

    def kept(self, dt):
        """What damping leaves of a row of four nodes' momenta and masses."""
        row = np.full(WIDTH, np.exp(-self.damping * dt), self.real)
        row[3::4] = 1.0
        return row


def obstacles_of(scene, needs, tables, real):
    """The colliders of a scene."""
    if not scene.colliders:
        return []
    from pmpm.collision import Obstacle, unit_of_momentum

    unit = unit_of_momentum(scene, needs, tables, real)
    return [Obstacle(collider, scene, real, unit) for collider in scene.colliders]


class Touching:
    """How bodies of different velocity fields act on each other: pairs (n, 2) of fields, each with its coefficient of friction,
    and the volume (m3) around a node that they fill together where they touch."""

    def __init__(self, scene, needs, real):
        frictions = scene.contact.frictions(velocity_fields(scene))
        self.pairs = np.array(list(frictions), np.int64)
        self.frictions = np.array(list(frictions.values()), real)
        self.room = real((1.0 - ROUNDING * np.finfo(real).eps) * scene.domain.cell_size**needs.dim)


class Region:
    """Nodes of a patch that move as told. `whole`: also those that hold no material."""

    whole = False

    def __init__(self, motion, dim):
        self.motion, self.travelled = motion, np.zeros(dim)
        self.velocity = np.zeros(dim)

    def meet(self, geometry, patch):
        self.geometry, self.patch, self.found = geometry, patch, None

    def lay_out(self):
        """Take note that the patch has other nodes."""
        self.found = None

    def start(self, time):
        self.velocity = np.array(velocity_at(self.motion.velocity, time))

    def travel(self, dt):
        if self.motion.moves and self.velocity.any():
            self.travelled += float(dt) * self.velocity
            self.found = None

    def nodes(self):
        """(planes, numbers) of the nodes of the patch that lie in the region now."""
        return self.found_in(self.motion.shape, self.travelled)

    def found_in(self, shape, shift):
        if self.found is None:
            self.found = nodes_inside(shape, shift, self.geometry, self.patch)
        return self.found

    def impose(self, nodes, first, last):
        """Give its velocity to nodes on planes first .. last - 1 that hold material."""
        plane, number = self.nodes()
        number = number[(plane >= first) & (plane < last)]
        held = number if self.whole else number[nodes[number, 3] > 0.0]
        nodes[held, : len(self.velocity)] = self.velocity


def nodes_inside(shape, shift, geometry, patch):
    """(planes, numbers) of a patch's nodes inside a shape that has moved by `shift` (m)."""
    low, high = shape.bounds()

    def along(place, number):
        """Coordinates (m) before the shape moved, and whether its bounds hold them."""
        axis = geometry.axes[place]
        if axis < 0:
            return None, True
        node = number + (patch.first_plane if place == 0 else -geometry.stencil.reach_low)
        if geometry.periodic[axis]:
            node = node % geometry.cells[axis]
        x = node * geometry.cell_size - shift[axis]
        return x, (x >= low[axis]) & (x <= high[axis])

    rows = patch.spans[:, 0]
    near = along(0, rows // patch.rows)[1] & along(1, rows % patch.rows)[1]
    node_of = patch.nodes_of(near)
    inside = along(2, node_of[2])[1]
    node_of = [numbers[inside] for numbers in node_of]
    points = np.empty((len(node_of[0]), geometry.dim))
    for place, axis in enumerate(geometry.axes):
        if axis >= 0:
            points[:, axis] = along(place, node_of[place])[0]
    inside = shape.contains(points)
    return node_of[0][inside], patch.find(*node_of)[inside]
