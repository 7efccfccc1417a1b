"""Fill a simulation with the particles of its scene: how many each layer gets, and their state at the start."""

from functools import partial

import numpy as np

from pmpm import estimate
from pmpm.kernels import targets
from pmpm.scene import geostatic, seeding, start
from pmpm.scene.errors import SceneError
from pmpm.scene.functions import Unfit
from pmpm.scene.messages import value_text
from pmpm.scene.needs import laws_of_sources
from pmpm.scene.schema import ROUNDING
from pmpm.state.derived import DENSITY, PARAMETERS
from pmpm.state.particles import Cloud, layer_groups

KEYS = (
    "velocity",
    "stress",
    "deformation",
    "displacement",
)  # functions of a body, in the order in which they are called


class Beginning:
    """Fills a simulation with what its scene begins with; restore.Continuation is the other way to begin."""

    def count_per_layer(self, simulation):
        """(layers, laws) particles over all ranks; each rank counts an equal share of the layers. Collective.

        Raises SceneError where there are more than fit into memory, where a body gets none, and for a load on nothing.
        """
        scene, comm, geometry = simulation.scene, simulation.comm, simulation.geometry
        estimate.refuse_memory(scene, simulation.needs, geometry, comm)
        first, last = (geometry.layers * r // comm.size for r in (comm.rank, comm.rank + 1))
        counts, loaded = map(comm.sum, counted(scene, geometry, first, last))
        refuse_empty(counts.sum(axis=1), scene)
        self.loads = load_accelerations(scene, loaded)
        laws = np.array(list(map(simulation.needs.laws.index, laws_of_sources(scene)[: len(scene.bodies)])), int)
        self.counts = np.zeros((geometry.layers, len(simulation.needs.laws)), np.int64)
        np.add.at(self.counts.T, laws, counts)
        return self.counts

    def fill(self, simulation):
        """Give every rank the particles that start in its layers, one group of layers after another. Collective. Raises
        SceneError, on all ranks, where a function of the scene fails or a particle starts outside the domain."""
        scene, counts = simulation.scene, self.counts[simulation.first_layer : simulation.last_layer]
        groups = list(layer_groups(counts.sum(axis=1), simulation.first_layer))
        complaints: dict[tuple[int, int], str] = {}
        displaced = np.array([body.displacement is not None for body in scene.bodies], bool)
        moved = self.seeded(simulation, [groups], displaced, complaints) if displaced.any() else None
        in_place = self.seeded(simulation, [[group] for group in groups], ~displaced, complaints)
        simulation.hold(zip(groups, in_place, strict=True), moved and next(moved), counts.sum(axis=0))
        told = {key: text for rank in reversed(simulation.comm.gather(complaints)) for key, text in rank.items()}
        if told:  # lower ranks own lower layers, so that the first complaint is the same for any number of ranks
            raise SceneError(told[min(told)])
        simulation.note_loads()
        if simulation.flow is not None:
            simulation.flow.start(simulation.time)
            simulation.regroup(simulation.slabs.edges)  # with what flows in from the beginning
        simulation.changed_by_hand()
        simulation.dt = simulation.control.choose(simulation.time, simulation.drive.acceleration(simulation.time))
        estimate.refuse_steps(simulation.scene.time, simulation.dt)

    def seeded(self, simulation, batches, wanted, complaints):
        """Yield the particles of each law of one batch of groups of layers after another, as Clouds; of the bodies that are
        `wanted`. Complaints are kept by (number of the law, body, key)."""
        scene, geometry = simulation.scene, simulation.geometry
        around, laws = seeding.surroundings(scene), laws_of_sources(scene)
        groups = [group for batch in batches for group in batch]
        bodies = {n: seeding.seed(scene, geometry, n, groups, around) for n in np.flatnonzero(wanted)}
        for batch in batches:
            found = [[Cloud.room(0, layout.size, geometry.dim, simulation.real)] for layout in simulation.layouts]
            for number, seeds in bodies.items():
                law = simulation.needs.laws.index(laws[number])
                found[law] += [self.cloud(simulation, law, number, next(seeds), complaints) for _ in batch]
            yield [Cloud.join(clouds) for clouds in found]

    def cloud(self, simulation, law, number, seeds, complaints):
        """Seeds of a body as rows; displaced ones lie in layers of any rank."""
        layout, geometry, body = simulation.layouts[law], simulation.geometry, simulation.scene.bodies[number]
        seeds = seeds.take(by_layer(simulation, seeds))
        count = len(seeds.id)
        reals = np.zeros((count, layout.size), simulation.real)
        seeded = Cloud(reals, seeds.node, np.full(count, number, np.int32), seeds.id)
        key, offset = "", seeds.offset
        if count:
            try:
                key = "velocity"
                velocity = vectors(geometry, seeds, body.velocity) + of_file(simulation, number, seeds, "velocity", 0.0)
                reals[:, layout.where("v")] = in_precision(velocity, simulation.real)
                key = "stress" if body.stress is not None else "deformation"
                reals[:, layout.state_first :] = first_states(simulation, law, number, seeds)
                if body.displacement is not None:
                    key = "displacement"
                    seeded.node, offset = displaced(geometry, body, seeds)
                seeded.places[:, : simulation.dim] = simulation.needs.places.from_cells(offset)
            except Unfit as complaint:
                complaints.setdefault((law, number, KEYS.index(key)), complaint_text(number, body, key, complaint))
        if layout.where("load"):
            with np.errstate(over="ignore"):  # an endless load has no time step
                reals[:, layout.where("load")] = loads_on(simulation.scene, geometry, self.loads[:, number], seeds)
        if layout.where("share"):
            reals[:, layout.where("share")] = 1.0 if seeds.share is None else seeds.share[:, None]
        if layout.where("X"):
            reals[:, layout.where("X")] = reference_positions(geometry, seeds)
        return seeded


def counted(scene, geometry, first, last):
    """((bodies, layers), (loads, bodies)): how many particles there will be in each of the layers first .. last - 1, zero in
    others, and how many whole ones of them each load acts on."""
    counts = np.zeros((len(scene.bodies), geometry.layers), np.int64)
    loaded, around = np.zeros((len(scene.loads), len(scene.bodies))), seeding.surroundings(scene)
    for number in range(len(scene.bodies)):
        for _, seeds in seeding.seed_planes(scene, geometry, number, first, last, around):
            seeding.add_counts(counts[number], seeds.node[:, geometry.axes[0]])
            for which, load in enumerate(scene.loads):
                loaded[which, number] += seeds.take(load_acts(load, geometry, seeds)).whole
    return counts, loaded


def refuse_empty(counts, scene):
    """Raise SceneError if a body gets no particles; counts (bodies,)."""
    for number, found in enumerate(counts):
        if found == 0:
            low, high = scene.bodies[number].shape.bounds()
            size = " x ".join(f"{length:.3g}" for length in high - low)
            cut = ", or inside of a collider, which cuts bodies" if any(c.cut for c in scene.colliders) else ""
            raise SceneError(
                f"scene: bodies[{number}] holds no particle: it is smaller than the distance between particles, "
                f"empty, covered by later bodies{cut}. It is {size} m, a cell {scene.domain.cell_size:g} m"
            )


def rehearse(scene, geometry):
    """(bodies,) how many particles each body gets, counted a piece at a time and keeping nothing.

    Raises SceneError for what the start of a run would refuse of bodies, displacements and loads.
    """
    counts, loaded = np.zeros(len(scene.bodies), np.int64), np.zeros(len(scene.loads), bool)
    around = seeding.surroundings(scene)
    for number, body in enumerate(scene.bodies):
        for _, seeds in seeding.seed_planes(scene, geometry, number, 0, geometry.layers, around):
            if not len(seeds.id):
                continue
            counts[number] += len(seeds.id)
            for tried in np.flatnonzero(~loaded):
                loaded[tried] = load_acts(scene.loads[tried], geometry, seeds).any()
            if body.displacement is not None:
                try:
                    displaced(geometry, body, seeds)
                except Unfit as complaint:
                    raise SceneError(complaint_text(number, body, "displacement", complaint)) from None
    refuse_empty(counts, scene)
    if not loaded.all():
        raise SceneError(load_on_nothing(int(np.argmin(loaded))))
    return counts


def load_on_nothing(number):
    return f"scene: loads[{number}].shape holds no particle at the start"


def load_acts(load, geometry, seeds):
    """(n,) whether a load acts on seeds."""
    return load.shape.contains(reference_positions(geometry, seeds))


def load_accelerations(scene, counts):
    """(loads, bodies, dim) m/s2 of each load on the particles of each body that it acts on, `counts` (loads, bodies) of
    whole ones. Raises SceneError for a load on nothing."""
    found = np.zeros((len(scene.loads), len(scene.bodies), scene.dim))
    volumes = np.array([seeding.whole_volume(scene, body) for body in scene.bodies])
    densities = np.array([scene.materials[body.material].parameters["density"] for body in scene.bodies])
    for number, load in enumerate(scene.loads):
        volume = float(counts[number] @ volumes)
        if volume == 0.0:
            raise SceneError(load_on_nothing(number))
        found[number] = (
            load.acceleration if load.force is None else np.array(load.force) / (volume * densities)[:, None]
        )
    return found


def loads_on(scene, geometry, accelerations, seeds):
    """(n, dim) m/s2 of all loads, `accelerations` (loads, dim) of each, on seeds of one body."""
    found = np.zeros((len(seeds.id), geometry.dim))
    for load, acceleration in zip(scene.loads, accelerations, strict=True):
        found[load_acts(load, geometry, seeds)] += acceleration
    return found


def complaint_text(number, body, key, complaint):
    """A complaint about a function of a body, or about a constant in its place."""
    value = getattr(body, key)
    return f"scene: bodies[{number}].{key}{f' = {value_text(value)}' if callable(value) else ''} {complaint}"


def by_layer(simulation, seeds):
    """Permutation of the seeds of one body, layer after layer: an order in which no rank count shows."""
    return np.argsort(seeds.node[:, simulation.geometry.axes[0]], kind="stable")


def reference_positions(geometry, seeds):
    """(n, dim) float64 X in m, within the domain also where it repeats."""
    X = (seeds.node + seeds.offset) * geometry.cell_size
    for axis in range(geometry.dim):
        if geometry.periodic[axis]:
            X[:, axis] += np.where(X[:, axis] < 0.0, geometry.cells[axis] * geometry.cell_size, 0.0)
    return X


def in_layers(geometry, seeds, compute):
    """(n, ...) what `compute` makes of the reference positions X (n, dim) of at least one seed, called layer by layer."""
    layer = seeds.node[:, geometry.axes[0]]
    pieces = np.split(reference_positions(geometry, seeds), np.flatnonzero(np.diff(layer)) + 1)
    return np.concatenate([compute(X) for X in pieces])


def vectors(geometry, seeds, field):
    """(n, dim) a constant or a function of position."""
    return in_layers(geometry, seeds, partial(start.evaluate, field, shape=(geometry.dim,)))


def in_precision(values, real):
    """Reals of the scene's precision. Raises Unfit where one is too large for it."""
    with np.errstate(over="ignore"):
        found = values.astype(real)
    if not np.isfinite(found).all():
        raise Unfit(f"is too large for {np.dtype(real).name}")
    return found


def displaced(geometry, body, seeds):
    """(node (n, dim), offset (n, dim) in cells) of particles at X + u. Raises Unfit outside the domain."""
    cells = seeds.node + seeds.offset + vectors(geometry, seeds, body.displacement) / geometry.cell_size
    outside = np.zeros(len(cells), bool)
    for axis in range(geometry.dim):
        if not geometry.periodic[axis]:
            beyond = ROUNDING * geometry.cells[axis]
            outside |= (cells[:, axis] < -beyond) | (cells[:, axis] > geometry.cells[axis] + beyond)
    if outside.any():
        first = np.flatnonzero(outside)[0]
        X, x = reference_positions(geometry, seeds)[first], cells[first] * geometry.cell_size
        there = ", ".join(f"{coordinate:.6g}" for coordinate in x)
        raise Unfit(f"takes particle {seeds.id[first]} from {start.place(X)} out of the domain, to ({there}) m")
    node = np.floor(cells + geometry.stencil.round)
    offset = cells - node
    for axis in range(geometry.dim):
        if geometry.periodic[axis]:
            node[:, axis] %= geometry.cells[axis]
    return node.astype(np.int32), offset


def of_file(simulation, number, seeds, name, otherwise):
    """(n, k) of a field in the file that the particles of a body come from, or what it is otherwise."""
    shape = simulation.scene.bodies[number].shape
    values = shape.field(name) if shape.type == "particles" else None
    return otherwise if values is None else values[seeds.id - seeding.id_offsets(simulation.scene)[number]]


def first_states(simulation, law, number, seeds):
    """(n, state) or (state,) of the particles of a body."""
    body = simulation.scene.bodies[number]
    if body.shape.type == "particles" and start.fields_of_file(body.shape, simulation.needs.laws[law]):
        whole = start.ArrayLaw(simulation.scene.materials[body.material], simulation.dim)
        rows = seeds.id - seeding.id_offsets(simulation.scene)[number]
        return start.states_of_file(whole, body.shape, rows)
    if body.deformation is None and body.stress is None and body.pressure == "zero":
        return state_at_rest(simulation, law, number)
    if body.pressure == "hydrostatic":
        return hydrostatic_state(simulation, law, number, seeds)
    whole = start.ArrayLaw(simulation.scene.materials[body.material], simulation.dim)
    if body.deformation is not None:
        return in_layers(simulation.geometry, seeds, partial(start.deformed_states, whole, body.deformation))
    axis, up = geostatic.vertical(simulation.drive.gravity)
    depth = (body.stress.depth_from - reference_positions(simulation.geometry, seeds)[:, axis]) * up
    density = simulation.tables[law][number][DENSITY]
    return geostatic.states(whole, body.stress, density, simulation.drive.gravity, depth)


def state_at_rest(simulation, law, number):
    """(state,) of an undeformed particle of a body."""
    needs, identity = simulation.needs, tuple(map(float, np.eye(simulation.dim).ravel()))
    target = targets.plain(la=needs.tensors, **dict(needs.laws[law].choices))
    return target.compile(needs.laws[law].module.state_at)(identity, tuple(simulation.tables[law][number][PARAMETERS:]))


def hydrostatic_state(simulation, law, number, seeds):
    """(n, state) of a fluid at rest under gravity beneath the top of its body."""
    strength = float(np.linalg.norm(simulation.drive.gravity))
    up = -simulation.drive.gravity / strength
    low, high = simulation.scene.bodies[number].shape.bounds()
    top = float(np.where(up > 0, high, low) @ up)
    depth = top - (seeds.node + seeds.offset) * simulation.geometry.cell_size @ up
    row = simulation.tables[law][number]
    function = targets.arrays(np.float64).compile(simulation.needs.laws[law].module.hydrostatic_state)
    return np.stack(function(depth, strength, tuple(row[PARAMETERS:]), row[DENSITY]), axis=-1)
