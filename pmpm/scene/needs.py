"""From a scene to what the floors below take: plain constants, tables and boxes of nodes."""

import math
from dataclasses import dataclass

import numpy as np

from pmpm.kernels.loops import FARTHEST, SETTLED
from pmpm.kernels.needs import Needs, law_needs
from pmpm.scene import forcing, seeding
from pmpm.scene.errors import SceneError
from pmpm.state.grid import Geometry

FACES = ("min", "max")
NOT_HELD = ("free", "open")  # walls of these types do nothing to the grid
NEVER = 1 << 40  # 64ths of a cell: an end that no particle is beyond
MOST_IDS = 2**63  # ids are 64-bit integers
MOST_NODES = 59_000_000  # of a plane: 9 planes of 4 reals (a ring, cubic) are counted in 32 bits


def laws_of_sources(scene):
    """The LawNeeds of each body and each inflow, by its material."""
    fields = velocity_fields(scene)
    found = {
        name: law_needs(scene.materials[name].model, scene.materials[name].parameters, fields[name]) for name in fields
    }
    return [found[source.material] for source in scene.sources]


def velocity_fields(scene):
    """{material of a body or an inflow: the number of its velocity field}: one for all unless they are in contact."""
    materials = tuple(dict.fromkeys(source.material for source in scene.sources))
    return dict.fromkeys(materials, 0) if scene.contact is None else scene.contact.velocity_fields(materials)


def scene_needs(scene):
    """What a scene asks of the kernels."""
    laws = dict.fromkeys(laws_of_sources(scene))
    walls = tuple(sorted({wall.type for wall in scene.domain.walls.values()} - set(NOT_HELD)))
    method = scene.method
    asked = scene.parallel.slab_axis
    slab_axis = int(np.argmax(scene.cells)) if asked is None else "xyz".index(asked)
    periodic = tuple("xyz"[axis] in scene.domain.periodic for axis in range(scene.dim))
    force = scene.body_force
    return Needs(
        scene.dim,
        method.precision,
        method.transfer,
        method.shape_function,
        slab_axis,
        periodic,
        tuple(sorted(laws, key=lambda law: law.velocity_field)),
        walls,
        collider_types=tuple(sorted({collider.surface.type for collider in scene.colliders})),
        f_bar=method.f_bar,
        body_force=force,
        uses_reference=scene.exact is not None or forcing.reads_reference(force),
        loaded=bool(scene.loads),
        open_axes=tuple(opened) if (opened := open_faces(scene).any(axis=1)).any() else (),
        shared=any(seeding.gives_shares(body) for body in scene.bodies),
    )


def open_faces(scene):
    """(dim, 2) bool: which faces particles leave through, by axis and end."""
    walls = scene.domain.walls
    faces = [[f"{axis}_{end}" for end in FACES] for axis in "xyz"[: scene.dim]]
    return np.array([[face in walls and walls[face].type == "open" for face in pair] for pair in faces])


def grid_geometry(scene, needs):
    """The grid of a scene. Raises SceneError where it cannot hold the scene."""
    geometry = Geometry(scene.cells, needs.periodic, scene.domain.cell_size, needs.axes, needs.stencil)
    check_axes(geometry)
    check_ids(scene)
    for number, motion in enumerate(scene.motions):
        if motion.moves and forcing.reaches_out(motion.shape, scene.domain.size):
            continue  # it may come in later
        if not forcing.holds_node(motion.shape, geometry):
            raise SceneError(f"scene: motions[{number}].shape holds no node of the grid: it moves nothing")
    return geometry


def check_ids(scene):
    """Raise SceneError where there are more places for particles than numbers for them."""
    places = sum(seeding.place_counts(scene)) + math.prod(scene.cells) * sum(
        i.particles_per_cell for i in scene.inflows
    )
    if places >= MOST_IDS:
        text = f"{float(places):.3g} places for particles in the domain, at most {float(MOST_IDS):.3g} can be numbered"
        raise SceneError(f"scene: domain.cell_size: {text}")


def check_axes(geometry):
    """Raise SceneError where the grid cannot hold the scene: too few cells on a periodic axis, too many in a plane."""
    for axis in range(geometry.dim):
        name, cells, window = "xyz"[axis], geometry.cells[axis], geometry.stencil.window
        if geometry.periodic[axis] and cells < window:
            raise SceneError(f"scene: domain.periodic: axis {name} has {cells} cells, a periodic axis needs {window}")
    rows, row = geometry.plane_shape
    nodes = rows * (row + 3)  # in whole quads
    if nodes > MOST_NODES:
        raise SceneError(f"scene: domain.cell_size: a plane of the grid has {nodes} nodes; at most {MOST_NODES}")


def law_table(scene, law):
    """(sources, 3 + parameters) float64: mass, volume0, density and the law's parameters of each source of this law.

    Raises SceneError where they are beyond the range of the scene's precision.
    """
    dim = scene.dim
    rows: list[list[float] | None] = []
    for source, of_source in zip(scene.sources, laws_of_sources(scene), strict=True):
        if of_source == law:
            keys = scene.materials[source.material].parameters
            volume0 = seeding.whole_volume(scene, source)
            rows.append([keys["density"] * volume0, volume0, keys["density"], *law.module.parameters(keys, dim)])
        else:
            rows.append(None)
    width = max(len(row) for row in rows if row is not None)
    table = np.array([row if row is not None else [0.0] * width for row in rows])
    with np.errstate(over="ignore", under="ignore"):
        rounded = table.astype(scene.method.precision)
    # Kernels take denormal numbers as zero.
    tiny = np.abs(rounded[:, :3]) < np.finfo(rounded.dtype).tiny
    fits = np.isfinite(rounded).all(axis=1) & ~(tiny & (table[:, :1] > 0.0)).any(axis=1)
    if not fits.all():
        name = scene.sources[int(np.argmin(fits))].material
        text = f"mass, volume or a modulus of a particle is beyond the range of {scene.method.precision}"
        raise SceneError(f"scene: materials.{name}: {text}")
    return table


def domain_limits(scene, geometry):
    """(limits, ends) in 64ths of a cell, (dim, 2) int64: where a particle may be, and where a periodic axis repeats.

    Walls hold the material back; what has passed one by more than half a cell has left. Through a free face nothing holds
    it: it may not pass at all. On periodic axes, and through open faces, particles may drift as far beyond the end as from the
    middle of a layer: a regroup is due before. Of the slab axis layers tell how far they have drifted.
    """
    limits = np.zeros((geometry.dim, 2), np.int64)
    ends = np.zeros((geometry.dim, 2), np.int64)
    for axis in range(geometry.dim):
        cells = geometry.cells[axis]
        if geometry.periodic[axis]:
            first = -int(64 * geometry.stencil.round)
            ends[axis] = first, first + 64 * cells
            limits[axis] = ends[axis] + (FARTHEST - SETTLED) * np.array([-1, 1])
            continue
        for side, (place, out) in enumerate(((0, -1), (64 * cells, 1))):
            kind = scene.domain.wall(f"{'xyz'[axis]}_{FACES[side]}").type
            beyond = {"free": 0, "open": FARTHEST - (0 if axis == geometry.axes[0] else SETTLED)}.get(kind, 32)
            limits[axis, side] = place + out * beyond
            ends[axis, side] = place if kind == "open" else out * NEVER
    return limits, ends


@dataclass
class PatchWall:
    """One face in a rank's patch: the array axis and number of the plane, row or nodes on it, which way is inward, normal into
    the material, velocity at present. `met`: numbers of nodes, see kernels.loops.apply_wall, plane after plane."""

    type: str
    place: int
    on: int
    inward: int
    normal: np.ndarray
    coefficient: float
    face: str
    velocity: np.ndarray
    met: np.ndarray
    plane_start: np.ndarray

    def lay_out(self, patch):
        """Find the nodes that the patch has on, beyond and inside of the face."""
        on = patch.nodes_on(self.place, self.on)
        columns = [patch.find(*on)]
        for far in range(1, patch.geometry.stencil.beyond + 1):
            for side in (-far, far):
                columns.append(
                    patch.find(*(c + self.inward * side * (axis == self.place) for axis, c in enumerate(on)))
                )
        self.met = np.stack(columns, axis=1)
        self.plane_start = np.searchsorted(on[0], np.arange(patch.planes + 1))

    def between(self, first_plane, last_plane):
        """Which of what is met lies on planes first_plane .. last_plane - 1: (first, last + 1)."""
        return int(self.plane_start[first_plane]), int(self.plane_start[last_plane])


def patch_walls(scene, geometry, patch, real):
    """The walls of the domain that this patch meets, in its own counting."""
    walls = []
    array_axis = {axis: number for number, axis in enumerate(geometry.axes) if axis >= 0}
    for face, wall in scene.domain.walls.items():
        if wall.type in NOT_HELD:
            continue
        axis, at_max = "xyz".index(face[0]), face.endswith("max")
        place = array_axis[axis]
        origin = patch.first_plane if place == 0 else -geometry.stencil.reach_low
        on, inward = (geometry.cells[axis] if at_max else 0) - origin, -1 if at_max else 1
        if place == 0 and not 0 <= on - inward < patch.planes:
            continue
        normal = np.zeros(geometry.dim, real)
        normal[axis] = inward
        still = np.zeros(geometry.dim, real)
        nothing = np.zeros((0, 1 + 2 * geometry.stencil.beyond), np.int64)
        walls.append(
            PatchWall(
                wall.type, place, on, inward, normal, real(wall.coefficient), face, still, nothing,
                np.zeros(patch.planes + 1, np.int64),
            )
        )  # fmt: skip
    return walls
