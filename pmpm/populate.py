"""Fill a simulation with the particles of its scene: how many each layer gets, and their state at the start."""

import numpy as np

from pmpm.kernels import targets
from pmpm.kernels.needs import law_needs
from pmpm.scene import seeding
from pmpm.scene.errors import SceneError
from pmpm.state.derived import DENSITY, PARAMETERS
from pmpm.state.particles import Cloud


def count_per_layer(simulation):
    """(layers,) particles per layer over all ranks; each rank counts an equal share of the layers."""
    layers = simulation.geometry.layers
    first, last = (layers * r // simulation.comm.size for r in (simulation.comm.rank, simulation.comm.rank + 1))
    counts = simulation.comm.sum(seeding.count_per_layer(simulation.scene, simulation.geometry, first, last))
    for number, found in enumerate(counts.sum(axis=1)):
        if found == 0:
            raise SceneError(
                f"scene: bodies[{number}] holds no particle: it is smaller than the distance between particles, "
                "empty, or covered by later bodies"
            )
    return counts.sum(axis=0)


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
            raise SceneError(f"scene: loads[{number}].shape holds no particle at the start")
        for body, here, total in zip(scene.bodies, inside, found, strict=True):
            if load.force is None:
                total[here] += load.acceleration
            else:
                total[here] += np.array(load.force) / (volume * scene.materials[body.material].parameters["density"])
    return found


def cloud(simulation, law, seeds, loads):
    """The particles of one law, at rest state or in hydrostatic equilibrium, as rows."""
    layout, parts = simulation.layouts[law], []
    for number, (body, body_seeds) in enumerate(zip(simulation.scene.bodies, seeds, strict=True)):
        material = simulation.scene.materials[body.material]
        if law_needs(material.model, material.parameters) != simulation.needs.laws[law]:
            continue
        count = len(body_seeds.id)
        reals = np.zeros((count, layout.size), simulation.real)
        reals[:, layout.where("v")] = body.velocity
        reals[:, layout.state_first :] = state_at_rest(simulation, law, number)
        if body.pressure == "hydrostatic":
            reals[:, layout.state_first :] = hydrostatic_state(simulation, law, number, body_seeds)
        seeded = Cloud(reals, body_seeds.node, np.full(count, number, np.int32), body_seeds.id)
        seeded.places[:, : simulation.dim] = simulation.needs.places.from_cells(body_seeds.offset)
        if layout.where("load"):
            reals[:, layout.where("load")] = loads[number]
        if layout.where("X"):
            reals[:, layout.where("X")] = (body_seeds.node + body_seeds.offset) * simulation.geometry.cell_size
        parts.append(seeded)
    return Cloud.join([Cloud.empty(layout.size, simulation.dim, simulation.real), *parts])


def state_at_rest(simulation, law, number):
    """(state,) of an undeformed particle of a body."""
    needs, identity = simulation.needs, tuple(map(float, np.eye(simulation.dim).ravel()))
    target = targets.plain(la=needs.tensors, **dict(needs.laws[law].choices))
    return target.compile(needs.laws[law].module.state_at)(identity, tuple(simulation.tables[law][number][PARAMETERS:]))


def hydrostatic_state(simulation, law, number, seeds):
    """(n, state) of a fluid at rest under gravity beneath the top of its body."""
    strength = float(np.linalg.norm(simulation.gravity))
    up = -simulation.gravity / strength
    low, high = simulation.scene.bodies[number].shape.bounds()
    top = float(np.where(up > 0, high, low) @ up)
    depth = top - (seeds.node + seeds.offset) * simulation.geometry.cell_size @ up
    row = simulation.tables[law][number]
    function = targets.arrays(np.float64).compile(simulation.needs.laws[law].module.hydrostatic_state)
    return np.stack(function(depth, strength, tuple(row[PARAMETERS:]), row[DENSITY]), axis=-1)
