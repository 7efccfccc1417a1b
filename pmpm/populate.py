"""Fill a simulation with the particles of its scene: how many each layer gets, and their state at the start."""

from functools import partial

import numpy as np

from pmpm import estimate
from pmpm.kernels import targets
from pmpm.parallel.regroup import migrate
from pmpm.scene import geostatic, seeding, start
from pmpm.scene.errors import SceneError
from pmpm.scene.functions import Unfit
from pmpm.scene.messages import value_text
from pmpm.scene.needs import law_of_body
from pmpm.scene.schema import ROUNDING
from pmpm.state.derived import DENSITY, PARAMETERS
from pmpm.state.particles import Cloud, Loose


class Beginning:
    """Fills a simulation with what its scene begins with; restore.Continuation is the other way to begin."""

    def count_per_layer(self, simulation):
        return count_per_layer(simulation)

    def fill(self, simulation):
        """Give every rank the particles that start in its layers. Collective. Raises SceneError."""
        seeds = seeding.seed(simulation.scene, simulation.geometry, simulation.first_layer, simulation.last_layer)
        loads = load_accelerations(simulation, seeds)
        seeded = [Loose.of_rows(cloud(simulation, law, seeds, loads)) for law in range(len(simulation.needs.laws))]
        arrived, _ = migrate(
            seeded, simulation.geometry.axes[0], simulation.slabs, simulation.comm
        )  # of displaced bodies
        simulation.settle_in(seeded, arrived)
        simulation.note_loads()
        simulation.changed_by_hand()
        simulation.dt = simulation.control.choose(simulation.time, simulation.drive.acceleration(simulation.time))
        estimate.refuse_steps(simulation.scene.time, simulation.dt)


def count_per_layer(simulation):
    """(layers, laws) particles over all ranks; each rank counts an equal share of the layers. Collective.

    Raises SceneError where there are more than fit into memory, and where a body gets none.
    """
    estimate.refuse_memory(simulation.scene, simulation.needs, simulation.geometry, simulation.comm)
    layers = simulation.geometry.layers
    first, last = (layers * r // simulation.comm.size for r in (simulation.comm.rank, simulation.comm.rank + 1))
    counts = simulation.comm.sum(seeding.count_per_layer(simulation.scene, simulation.geometry, first, last))
    refuse_empty(counts.sum(axis=1))
    laws = [simulation.needs.laws.index(law_of_body(simulation.scene, body)) for body in simulation.scene.bodies]
    found = np.zeros((layers, len(simulation.needs.laws)), np.int64)
    np.add.at(found.T, laws, counts)
    return found


def refuse_empty(counts):
    """Raise SceneError if a body gets no particles; counts (bodies,)."""
    for number, found in enumerate(counts):
        if found == 0:
            raise SceneError(
                f"scene: bodies[{number}] holds no particle: it is smaller than the distance between particles, "
                "empty, or covered by later bodies"
            )


def rehearse(scene, geometry):
    """(bodies,) how many particles each body gets, counted a piece at a time and keeping nothing.

    Raises SceneError for what the start of a run would refuse of bodies, displacements and loads.
    """
    counts, loaded = np.zeros(len(scene.bodies), np.int64), np.zeros(len(scene.loads), bool)
    around = seeding.surroundings(scene)
    for number, body in enumerate(scene.bodies):
        for seeds in seeding.seed_planes(scene, geometry, number, 0, geometry.layers, around):
            if not len(seeds.id):
                continue
            counts[number] += len(seeds.id)
            places = (seeds.node + seeds.offset) * geometry.cell_size
            for tried in np.flatnonzero(~loaded):
                loaded[tried] = scene.loads[tried].shape.contains(places).any()
            if body.displacement is not None:
                try:
                    displaced(geometry, body, seeds)
                except Unfit as complaint:
                    raise SceneError(complaint_text(number, body, "displacement", complaint)) from None
    refuse_empty(counts)
    if not loaded.all():
        raise SceneError(load_on_nothing(int(np.argmin(loaded))))
    return counts


def load_on_nothing(number):
    return f"scene: loads[{number}].shape holds no particle at the start"


def load_accelerations(simulation, seeds):
    """[(n, dim) m/s2] by the loads, per body for its seeds. Collective. Raises SceneError for a load on nothing."""
    scene, geometry = simulation.scene, simulation.geometry
    found = [np.zeros((len(body_seeds.id), geometry.dim)) for body_seeds in seeds]
    volumes = [geometry.cell_size**geometry.dim / body.particles_per_cell for body in scene.bodies]
    for number, load in enumerate(scene.loads):
        inside = [load.shape.contains((s.node + s.offset) * geometry.cell_size) for s in seeds]
        counts = simulation.comm.sum(np.array([np.count_nonzero(here) for here in inside]))
        volume = float(counts @ np.array(volumes))
        if volume == 0.0:
            raise SceneError(load_on_nothing(number))
        for body, here, total in zip(scene.bodies, inside, found, strict=True):
            if load.force is None:
                total[here] += load.acceleration
            else:
                total[here] += np.array(load.force) / (volume * scene.materials[body.material].parameters["density"])
    return found


def cloud(simulation, law, seeds, loads):
    """The particles of one law at the start, as rows; displaced ones lie in layers of any rank. Collective.

    Raises SceneError, on all ranks, where a function of the scene fails or a particle starts outside the domain.
    """
    layout, parts, complaints = simulation.layouts[law], [], []
    for number, (body, body_seeds) in enumerate(zip(simulation.scene.bodies, seeds, strict=True)):
        if law_of_body(simulation.scene, body) != simulation.needs.laws[law]:
            continue
        order = by_layer(simulation, body_seeds)
        body_seeds = body_seeds.take(order)
        count = len(body_seeds.id)
        reals = np.zeros((count, layout.size), simulation.real)
        seeded = Cloud(reals, body_seeds.node, np.full(count, number, np.int32), body_seeds.id)
        if count:
            try:
                key = "velocity"
                reals[:, layout.where("v")] = vectors(simulation.geometry, body_seeds, body.velocity)
                key = "stress" if body.stress is not None else "deformation"
                reals[:, layout.state_first :] = first_states(simulation, law, number, body_seeds)
                key, offset = "displacement", body_seeds.offset
                if body.displacement is not None:
                    seeded.node, offset = displaced(simulation.geometry, body, body_seeds)
                seeded.places[:, : simulation.dim] = simulation.needs.places.from_cells(offset)
            except Unfit as complaint:
                complaints.append(complaint_text(number, body, key, complaint))
        if layout.where("load"):
            reals[:, layout.where("load")] = loads[number][order]
        if layout.where("X"):
            reals[:, layout.where("X")] = reference_positions(simulation.geometry, body_seeds)
        parts.append(seeded)
        # Lower ranks own lower layers, so that the first complaint is the same for any number of ranks.
        told = [complaint for rank in simulation.comm.gather(complaints) for complaint in rank]
        if told:
            raise SceneError(told[0])
    return Cloud.join([Cloud.empty(layout.size, simulation.dim, simulation.real), *parts])


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


def first_states(simulation, law, number, seeds):
    """(n, state) or (state,) of the particles of a body."""
    body = simulation.scene.bodies[number]
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
