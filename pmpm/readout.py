"""What a simulation tells about its state: fields of its particles in the one global order, and totals over all ranks."""

import math
from functools import partial
from itertools import chain

import numpy as np

from pmpm.kernels.needs import labels
from pmpm.output.datasets import Later
from pmpm.physics.materials import law_of
from pmpm.state.derived import MASS
from pmpm.state.fields import OPTIONAL, SHARE_STEPS, Field, in_steps

CRUSHED = 0.01  # of the volume: no solid or liquid there is


def order(simulation):
    """Permutation that puts the laws' particles, one law after another, into the one global order."""
    return order_of(simulation.populations)


def order_of(populations):
    return np.argsort(np.concatenate([p.per_particle(p.block_layer) for p in populations]), kind="stable")


def fields(simulation, names):
    """dict of this rank's rows of each named field, in the one global order: see state.fields.OUTPUT, `x` and `id`."""
    groups = [fields_of(simulation, derived, names) for derived in simulation.derived_groups(simulation.real)]
    return {name: np.concatenate([group[name] for group in groups]) for name in names}


def fields_of(simulation, derived, names):
    """The same of a group of layers; `derived`: of each law."""
    rows = order_of([of_law.population for of_law in derived])
    return {name: np.concatenate([field(simulation, of_law, name) for of_law in derived])[rows] for name in names}


def fields_later(simulation, names):
    """dict of each named field as rows that are made when they are written: they may take more than the particles do."""
    kinds, rows = fields_of(simulation, simulation.no_derived(simulation.real), names), simulation.rows()

    def make(name):
        return (fields_of(simulation, group, [name])[name] for group in simulation.derived_groups(simulation.real))

    return {name: Later((rows, *k.shape[1:]), k.dtype, partial(make, name)) for name, k in kinds.items()}


def field(simulation, derived, name):
    population = derived.population
    if name == "id":
        return population.id[population.lanes]
    if name == "material":
        materials = np.array([simulation.material_names.index(b.material) for b in simulation.scene.sources], np.int32)
        return materials[population.per_particle(population.block_row)]
    if hasattr(derived, name):
        return np.asarray(getattr(derived, name)())
    return stored_field(simulation, derived, name)


def stored_field(simulation, derived, name):
    """Rows of a stored field, nan where this law, or any law of the bodies, keeps no such field."""
    values = derived.field(name)
    if values is None:
        laws = [(law_of(material.model), material.parameters) for material in simulation.scene.materials.values()]
        states = [Field.of(f) for law, keys in laws for f in (*law.STATE, *law.state_fields(keys))]
        size = max(f.size(simulation.dim) for f in (*states, *OPTIONAL) if f.name == name)
        values = np.full((len(derived.population), size), np.nan, simulation.real)
    return values[:, 0] if values.shape[1] == 1 else values


def law_fields_later(simulation, names):
    """dict of law -> dict of the named state variables it keeps, over its own particles in order, as in `fields_later`.

    Laws of one model that were compiled with different choices are told apart by a number: drucker_prager, drucker_prager_2.
    """
    found: dict[str, dict] = {}
    laws = simulation.needs.laws
    for law, (label, kind) in enumerate(zip(labels(laws), laws, strict=True)):
        own = {f.name for f in kind.fields}
        values = {name: law_field_later(simulation, law, name) for name in names if name in own}
        if values:
            found[label] = values
    return found


def law_field_later(simulation, law, name):
    def make():
        return (group[law].field(name) for group in simulation.derived_groups(simulation.real))

    size = simulation.no_derived(simulation.real)[law].field(name).shape[1]
    rows = Later((len(simulation.populations[law]), size), np.dtype(simulation.real), make)
    return rows.through(lambda values: values[:, 0]) if size == 1 else rows


def measure(simulation):
    """Totals over all ranks: particles, mass, momentum, angular momentum, energies, max_speed; where faces are open or material
    flows in, what has `left` and was `emitted`.

    Sums run over particles within a layer and then over layers, so that they do not depend on the rank count.
    """
    per_layer: dict[str, np.ndarray] = {}
    top, layers = 0.0, simulation.geometry.layers
    for derived in chain.from_iterable(simulation.derived_groups(np.float64)):
        layer = derived.population.per_particle(derived.population.block_layer)
        for name, values in derived.totals(simulation.drive.gravity).items():
            added = np.bincount(layer, weights=values, minlength=layers)
            per_layer[name] = per_layer.get(name, 0.0) + added
        top = max(top, float(derived.speed().max(initial=0.0)))
    names = list(per_layer)
    summed = simulation.comm.sum(np.stack([per_layer[name] for name in names]))
    found: dict[str, float] = {"particles": int(simulation.comm.sum(np.array([simulation.rows()]))[0])}
    found["mass"] = total_mass(simulation)
    found |= {name: math.fsum(row) for name, row in zip(names, summed, strict=True)}
    flow = simulation.flow
    found["dissipated"] = simulation.first_energy + (flow.net_energy if flow else 0.0) - total_energy(found)
    found["max_speed"] = float(simulation.comm.max(np.array([top]))[0])
    return found | (flow.measured() if flow else {})


def total_mass(simulation):
    """Of all particles over all ranks, counted: no particle that moves on changes a bit of it. Collective."""
    found = []
    shares = share_steps(simulation) if simulation.needs.shared else None
    for law, (population, table) in enumerate(zip(simulation.populations, simulation.tables, strict=True)):
        counts = np.zeros(len(table), np.int64)
        np.add.at(counts, population.segments[:, 2], population.segments[:, 1])
        whole = simulation.comm.sum(counts) if shares is None else simulation.comm.sum(shares[law]) / SHARE_STEPS
        found.append(whole * table[:, MASS])
    return math.fsum(np.concatenate(found))


def share_steps(simulation):
    """Of each law (bodies,) the sum of this rank's shares, in SHARE_STEPS: whole numbers, the same in any order."""
    found = [np.zeros(len(table), np.int64) for table in simulation.tables]
    for group in simulation.derived_groups(np.float64):
        for sums, derived in zip(found, group, strict=True):
            row = derived.population.per_particle(derived.population.block_row)
            np.add.at(sums, row, in_steps(derived.field("share")))
    return found


def crushed(simulation):
    """{material: (particles that hold less than CRUSHED of their volume, smallest J)} of materials with such. Collective."""
    names = simulation.material_names
    counts, smallest = np.zeros(len(names), np.int64), np.full(len(names), np.inf)
    of_body = np.array([names.index(body.material) for body in simulation.scene.sources])
    for derived in chain.from_iterable(simulation.derived_groups(np.float64)):
        J, population = np.abs(derived.J()), derived.population
        material = of_body[population.per_particle(population.block_row)]
        counts += np.bincount(material[J < CRUSHED], minlength=len(names))
        np.minimum.at(smallest, material, J)
    counts, smallest = simulation.comm.sum(counts), -simulation.comm.max(-smallest)
    return {name: (int(counts[n]), float(smallest[n])) for n, name in enumerate(names) if counts[n]}


def total_energy(measured):
    return measured["kinetic"] + measured["strain"] + measured["potential"]
