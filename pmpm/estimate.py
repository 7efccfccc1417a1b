"""What a run will take, told before anything is counted or allocated: particles, memory, time steps; and what is too much."""

import contextlib
import math
import os
import resource
import socket
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pmpm import timestep
from pmpm.physics import stability
from pmpm.physics.materials import law_of
from pmpm.scene import start
from pmpm.scene.errors import SceneError
from pmpm.scene.forcing import velocity_at
from pmpm.scene.functions import Unfit
from pmpm.scene.seeding import hole_of, lies_in, meeting_later_bodies, spread_places, surroundings
from pmpm.state.derived import PARAMETERS
from pmpm.state.fields import OUTPUT, Field, Layout
from pmpm.state.grid import SLACK

SAMPLES, FEWEST_SAMPLES, ALL_SAMPLES = 4096, 32, 1 << 19  # places tried in a body, and in all of them together
CAUGHT = 0.03  # of a body: more inside of a collider is no touch
MOST_COUNTED = 20_000_000  # places that are gone through one by one; more are estimated
MOST_STEPS = 1e11  # years of a laptop on a hundred particles
ID_BYTES = 8
# Of each particle while a simulation is being filled, measured: its fields this many times. In place it is one of a group of
# layers, of which more is known; where a body is displaced all its particles are rows first, that go to any rank.
FILLING, FILLING_DISPLACED = 1.25, 6.0
LAYER_BYTES, ROW_BYTES = 160, 40  # of a layer and of a row of the grid besides its nodes: counts, starts, marks
# On a card: of blocks; bytes of each particle's keys and numbers in a regroup, and fields of it that are moved at a time, both
# with an eighth to spare.
CARD_SPARE, KEYS_ON_CARD, FIELDS_ON_CARD = 17 / 16, 29, 4.5
SPREAD = 2.0  # as many nodes as a compact block reaches: material spreads, and has more surface
OUTPUT_SIZE = {"scalar": 1, "vector": 3, "symmetric": 6, "tensor": 9}  # of fields in files, whatever the dimension
MEMORY_LIMIT = "PMPM_MEMORY_LIMIT"
CGROUPS = (  # limit and use of the memory of a container or a batch job
    ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory.current"),
    ("/sys/fs/cgroup/memory/memory.limit_in_bytes", "/sys/fs/cgroup/memory/memory.usage_in_bytes"),
)


# ---- particles ---------------------------------------------------------------------------------------------------------------


def places_to_try(scene):
    """How many places are gone through one by one to count the particles of a scene: a float, for it may be astronomical."""
    around = surroundings(scene)
    cells = np.prod(np.maximum(around.last - around.first, 0), axis=1, dtype=float)
    layers = len(scene.bodies) * float(max(scene.cells))
    return layers + float(cells @ [float(body.particles_per_cell) for body in scene.bodies])


def particles(scene):
    """(bodies,) about how many particles each body gets: from the share of a few places in its bounds that lie in it."""
    count = max(FEWEST_SAMPLES, min(SAMPLES, ALL_SAMPLES // max(len(scene.bodies), 1)))
    around = surroundings(scene)
    return np.array([particles_of(scene, number, count, around) for number in range(len(scene.bodies))])


def particles_of(scene, number, samples, around):
    body, dx = scene.bodies[number], scene.domain.cell_size
    if body.shape.type == "particles":
        return float(len(body.shape.x))
    places, extent = places_in(scene, number, samples, around)
    return float(np.prod(extent / dx)) * body.particles_per_cell * len(places) / samples


def places_in(scene, number, samples, around):
    """((n, dim) m of places tried in the bounds of a body those at which it has particles, (dim,) m of these bounds)."""
    body = scene.bodies[number]
    low, high = body.shape.bounds()
    low, high = np.maximum(low, 0.0), np.minimum(high, scene.domain.size)
    if not np.all(low < high):
        return np.zeros((0, scene.dim)), np.zeros(scene.dim)
    places = low + (high - low) * spread_places(samples, scene.dim)
    inside = lies_in([body, *meeting_later_bodies(scene, number, around)], hole_of(scene), places)
    return places[inside], high - low


def caught(scene):
    """Lines on bodies of which more than CAUGHT lies inside of a collider at the start, from a few places in each."""
    found: list[str] = []
    if not scene.colliders:
        return found
    samples = max(FEWEST_SAMPLES, min(SAMPLES, ALL_SAMPLES // len(scene.bodies))) if scene.bodies else 0
    around = surroundings(scene)
    for number, body in enumerate(scene.bodies):
        from_file = body.shape.type == "particles"
        # Of other bodies nothing is left where colliders cut.
        near = [c for c in scene.colliders if not c.cut or from_file or body.displacement is not None]
        if not near:
            continue
        x = (
            body.shape.x[:: -(-len(body.shape.x) // samples)]
            if from_file
            else places_in(scene, number, samples, around)[0]
        )
        if len(x) and body.displacement is not None:
            with contextlib.suppress(Unfit):  # which whoever fills a simulation tells
                x = x + start.evaluate(body.displacement, x, (scene.dim,))
        for collider in near if len(x) else ():
            inside = collider.signed_distance(collider.nearest(x, scene.domain.periods), 0.0) < 0.0
            share = np.count_nonzero(inside) / len(x)
            if share > CAUGHT:
                part = f"bodies[{number}]: about {share:.2g} of it lies inside of the collider {collider.name}"
                advice = "; cut = true would cut it out" if not (collider.cut or from_file) else ""
                found.append(f"{part} at the start, which holds it there{advice}")
    return found


@dataclass(frozen=True)
class Stream:
    """What an inflow brings: particles at first, per second after that, and in all by its end, if nothing changes its speed."""

    first: float
    rate: float
    total: float


def stream(scene, inflow):
    """The Stream of an inflow, from a few places in it: how many it holds, and how many have come in on the way of a cell."""
    size, velocity = scene.domain.cell_size, np.array(velocity_at(inflow.velocity, inflow.start))
    low, high = inflow.shape.bounds()
    places, speed = low + (high - low) * spread_places(SAMPLES, scene.dim), math.hypot(*velocity)
    inside = inflow.shape.contains(places)
    each = float(np.prod((high - low) / size)) * inflow.particles_per_cell / SAMPLES
    came = places - velocity * (size / speed if speed > 0.0 else 0.0)
    enter = inside & ~inflow.shape.contains(came)
    first, rate = each * np.count_nonzero(inside), each * np.count_nonzero(enter) * speed / size
    most = math.inf if inflow.limit is None else inflow.limit / size**scene.dim * inflow.particles_per_cell
    total = min(first + rate * max(min(inflow.until, scene.time.end) - inflow.start, 0.0), most)
    return Stream(min(first, most), rate, total)


def bytes_per_particle(needs):
    """Of each law {field: bytes that a particle holds of it}, the id included: there is nothing else per particle."""
    layouts = [Layout.of(law, needs.dim, needs.carried(law)) for law in needs.laws]
    real = np.dtype(needs.precision).itemsize
    return [{f.name: f.size(needs.dim) * real for f in layout.fields} | {"id": ID_BYTES} for layout in layouts]


# ---- memory ------------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Memory:
    """Bytes over all ranks: of the particles while they move, the same while they are being made, of the grid, of the copy that
    is kept for the case that the run goes wrong, and of fields on nodes while they are written."""

    particles: float
    filling: float
    grid: float
    copy: float
    fields: float = 0.0

    @property
    def most(self):
        """What there is at once: at the start, or later."""
        return max(self.filling, self.particles + self.copy + self.fields) + self.grid


def memory(scene, needs, geometry, counts):
    """What the particles, `counts` per body, and the grid of a scene take; of inflows what they bring at first counts."""
    from pmpm.scene.needs import laws_of_sources

    sizes = [sum(fields.values()) for fields in bytes_per_particle(needs)]
    of_source = np.array([sizes[needs.laws.index(law)] for law in laws_of_sources(scene)], float)
    ways = [FILLING if body.displacement is None else FILLING_DISPLACED for body in scene.bodies]
    filling = of_source * [*ways, *(FILLING_DISPLACED for _ in scene.inflows)]
    counts = np.append(counts, [stream(scene, inflow).first for inflow in scene.inflows])
    held = float(counts @ of_source)
    cells = sum(count / source.particles_per_cell for count, source in zip(counts, scene.sources, strict=True))
    grid = grid_bytes(needs, geometry, float(cells))
    copy = held if scene.guard.keep_copy else 0.0
    return Memory(held, float(counts @ filling), grid, copy, grid_fields(scene).memory)


@dataclass(frozen=True)
class GridFields:
    """Fields on nodes: how many nodes each axis has, bytes of a file of them, and of memory on all ranks together."""

    nodes: tuple[int, ...]
    file: float
    memory: float


def grid_fields(scene):
    """What the fields on nodes of a scene take: sums in float64, of each field and of the mass that has it, and twice what goes
    into the file, for the order of its rows."""
    nodes = scene.domain.nodes
    sizes = {field.name: OUTPUT_SIZE[field.kind] for field in OUTPUT}
    for material in scene.materials.values():
        own = law_of(material.model).state_fields(material.parameters)
        sizes |= {field.name: Field.of(field).size(scene.dim) for field in own if field.name not in sizes}
    held = [sizes.get(name, 1) for name in scene.output.grid_fields]
    file = math.prod(nodes) * np.dtype(scene.method.precision).itemsize * float(sum(held))
    sums = math.prod(nodes) * 8.0 * (1 + sum(held) + len(held)) if held else 0.0
    return GridFields(nodes, file, sums + 2.0 * file)


def on_cards(needs, taken, particles):
    """Bytes on all graphics cards together, of what `memory` says: blocks with their spare, what a regroup notes of each
    particle (see processors.on_card), and the nodes."""
    of_regroup = KEYS_ON_CARD + FIELDS_ON_CARD * np.dtype(needs.precision).itemsize
    return CARD_SPARE * taken.particles + particles * of_regroup + taken.grid


def grid_bytes(needs, geometry, cells):
    """Bytes of the nodes when so many cells hold material, of what FLIP, F-bar and contact keep besides, of the planes that P2G
    and G2P work in, and of tables per row and layer."""
    stencil, plane = needs.stencil, float(math.prod(geometry.plane_shape))
    planes = float(geometry.extent(geometry.axes[0]))
    side = cells ** (1.0 / needs.dim) + stencil.window - 1 + 2 * SLACK
    nodes = min(planes * plane, SPREAD * side**needs.dim)
    grids = 1 + needs.scheme.blends + 2 * needs.f_bar
    kept = needs.velocity_fields * (grids + needs.contact)
    scratch = plane * (stencil.window + (stencil.window + stencil.nodes - 1) * grids)
    tables = planes * geometry.plane_shape[0] * ROW_BYTES + geometry.layers * LAYER_BYTES
    return (nodes * kept + scratch) * 4 * np.dtype(needs.precision).itemsize + tables


def available_memory():
    """Bytes that this machine has left for us, infinite where nothing tells. Raises SceneError for a wrong PMPM_MEMORY_LIMIT.

    The smallest of what the system, the container or batch job and the shell allow; PMPM_MEMORY_LIMIT overrides them all.
    """
    told = os.environ.get(MEMORY_LIMIT)
    if told:
        if not (told.isdecimal() and int(told) > 0):
            raise SceneError(f"environment: {MEMORY_LIMIT} = {told!r} must be a whole number of bytes > 0")
        return float(told)
    return min(system_memory(), shell_memory(), *(group_memory(*files) for files in CGROUPS))


def system_memory():
    lines = read(Path("/proc/meminfo")).splitlines()
    kilobytes = [line.split()[1] for line in lines if line.startswith("MemAvailable:")]
    return 1024.0 * int(kilobytes[0]) if kilobytes else math.inf


def shell_memory():
    limit, used = resource.getrlimit(resource.RLIMIT_AS)[0], read(Path("/proc/self/statm")).split()
    if limit == resource.RLIM_INFINITY or not used:
        return math.inf
    return max(float(limit) - float(used[0]) * resource.getpagesize(), 0.0)


def group_memory(limit_file, use_file):
    limit, use = read(Path(limit_file)).strip(), read(Path(use_file)).strip()
    return max(float(limit) - float(use), 0.0) if limit.isdecimal() and use.isdecimal() else math.inf


def read(path):
    try:
        return path.read_text(encoding="ascii", errors="replace")
    except OSError:
        return ""


def refuse_memory(scene, needs, geometry, comm):
    """Raise SceneError, on all ranks, where a run would not fit into the machines that it is on. Collective."""
    counts = particles(scene)
    taken = memory(scene, needs, geometry, counts)
    per_rank = taken.most / comm.size
    told = comm.gather((socket.gethostname(), memory_here()))
    for _, available in told:
        if isinstance(available, str):
            raise SceneError(available)
    hosts = [host for host, _ in told]
    short = [(available, host) for host, available in told if per_rank * hosts.count(host) > available]
    if short:
        available, host = min(short)
        raise SceneError(too_much_text(counts, taken, comm.size, hosts.count(host), available))


def memory_here() -> float | str:
    """What this machine has available, or the complaint about it: other ranks must hear of it before anyone raises it."""
    try:
        return available_memory()
    except SceneError as complaint:
        return str(complaint)


def too_much_text(counts, taken, ranks, ranks_here, available):
    shared = f" for its {ranks_here} ranks" if ranks_here > 1 else ""
    return (
        f"scene: does not fit into memory: about {float(counts.sum()):.3g} particles take {amount(taken.filling / ranks)} "
        f"and the grid {amount(taken.grid / ranks)} per rank on {ranks} ranks at the start; this machine has "
        f"{amount(available)} available{shared}: give a larger domain.cell_size, fewer particles_per_cell, or more machines "
        f"({MEMORY_LIMIT}, in bytes, says otherwise)"
    )


def amount(size):
    """Bytes as a person says them."""
    for unit, name in ((1e12, "TB"), (1e9, "GB")):
        if size >= unit:
            return f"{size / unit:.3g} {name}"
    return f"{size / 1e6:.1f} MB"


# ---- time steps --------------------------------------------------------------------------------------------------------------


def stable_bounds(scene, needs, tables):
    """The longest step in s of undeformed particles by each of timestep.BOUNDS; of what drives them gravity alone counts."""
    dx, wave = scene.domain.cell_size, max(waves_at_rest(scene, needs, tables))
    speed = max((start.largest_speed(body, scene.dim) for body in scene.bodies), default=0.0)
    for inflow in scene.inflows:
        speed = max(speed, math.hypot(*velocity_at(inflow.velocity, inflow.start)))
    pull = 0.0 if scene.time.ramp > 0.0 else math.hypot(*scene.domain.gravity)
    return timestep.stable_bounds(dx, scene.dim, wave, speed, pull)


def waves_at_rest(scene, needs, tables):
    """Of each law, the speed in m/s of the fastest wave in any of its undeformed materials."""
    from pmpm.kernels import targets

    identity, found = tuple(map(float, np.eye(scene.dim).ravel())), []
    for law, table in zip(needs.laws, tables, strict=True):
        target, wave = targets.plain(la=needs.tensors, law=law.module, **dict(law.choices)), 0.0
        for row in np.unique(table[table[:, 0] > 0], axis=0):
            params = tuple(row[PARAMETERS:])
            rest = target.compile(law.module.state_at)(identity, params)
            inv_dx = 1.0 / scene.domain.cell_size
            wave = max(wave, target.compile(stability.signal_speed_squared)(rest, params, row[2], inv_dx))
        found.append(math.sqrt(wave))
    return found


def first_step(scene, needs, tables):
    """The first time step in s, from the undeformed wave speeds."""
    if scene.time.step is not None:
        return scene.time.step
    waves, *others = stable_bounds(scene, needs, tables)
    return min(scene.time.cfl * waves, *others)


def refuse_steps(time, dt):
    """Raise SceneError if `dt`, the first step (s), is so short that the end is never reached; time: that of the scene."""
    if dt * MOST_STEPS >= time.end:
        return
    count = f"{time.end / dt:.2g}" if dt * 1e300 > time.end else "endlessly many"
    if time.step is not None:
        raise SceneError(
            f"scene: time.step = {time.step} s is too short: {count} steps to time.end = {time.end} s, at most {MOST_STEPS:g}"
        )
    raise SceneError(
        f"scene: time.end = {time.end} s is too far: {count} steps of {dt:.3g} s, at most {MOST_STEPS:g}; waves and particles "
        "cross a cell in such a step: give a larger domain.cell_size, softer materials or slower bodies"
    )
