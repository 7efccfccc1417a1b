"""What stands at a point, along a line and in a section, out of the particles around: the probes and gauges of a scene.

Particles count by the spline of the scene, as if a node of the grid lay at the place. Totals run over the particles of a layer
and then over layers; parts of a cell's volume are summed as whole numbers: the same bits on any number of ranks.
"""

import math

import numpy as np

from pmpm.kernels.places import PADDING
from pmpm.scene.needs import NOT_HELD
from pmpm.scene.watched import upright
from pmpm.state.particles import layer_groups

UNIT = 2.0**36  # of whole numbers per cell's volume: sums in float64 are exact up to 2^17 cells
REACH = 3  # cells: more than any spline does
SAMPLES = 4  # of a line per cell
SURFACE = 0.5  # part of the volume at a place that is filled where the surface is


def probe(position):
    """What measures at a point (m): see `at_point`."""
    return lambda simulation: at_point(simulation, np.array(position))


def gauge(table, scene):
    """What a Gauge of a scene measures: see `surface` and `section`."""
    axis = upright(scene.domain.gravity) if table.axis is None else "xyz".index(table.axis)
    position = np.array(table.position)
    measure = surface if table.type == "surface" else section
    return lambda simulation: measure(simulation, position, axis)


def at_point(simulation, position):
    """velocity (m/s, by mass), pressure (Pa, by volume), density (kg/m3, mass by volume) at a point (m), nan where no particle
    reaches it; and fill, the part of the volume there that is filled, 1 inside of material. Collective."""
    geometry, dim = simulation.geometry, simulation.dim
    where = position / geometry.cell_size
    names = ["mass", "volume", "fill", "pressure", *(f"velocity_{axis}" for axis in "xyz"[:dim])]
    sums = LayerSums(simulation, names)
    for derived in near(simulation, where, range(dim)):
        x = derived.x() / geometry.cell_size
        plain, whole = np.ones(len(x)), np.ones(len(x))
        for axis in range(dim):
            plain = plain * along(simulation, axis, x[:, axis], where[axis], mirrored=False)
            whole = whole * along(simulation, axis, x[:, axis], where[axis])
        here = np.flatnonzero(whole)
        if len(here):
            mass, volume = derived.mass()[here] * plain[here], derived.volume()[here] * plain[here]
            v = derived.velocity()[here].astype(np.float64)
            fill = (filled(derived)[here] * whole[here]) / geometry.cell_size**dim
            pressure = derived.pressure()[here] * volume
            sums.add(derived, here, [mass, volume, fill, pressure, *(mass * v[:, axis] for axis in range(dim))])
    found = sums.totals()
    mass, volume = found["mass"], found["volume"]
    told = {name: ratio(found[name], mass) for name in names[4:]}
    return told | {
        "pressure": ratio(found["pressure"], volume),
        "density": ratio(mass, volume),
        "fill": found["fill"],
    }


def surface(simulation, position, axis):
    """height and depth (m) on the line along `axis` through a point (m). Collective.

    height: the coordinate, along the axis, of the highest place at which half of the volume is filled, nan if there is none;
    up is against gravity. depth: the volume per area along the whole line.
    """
    geometry, dim = simulation.geometry, simulation.dim
    where, cells = position / geometry.cell_size, geometry.cells[axis]
    others = [other for other in range(dim) if other != axis]
    beyond, total = (REACH + 1) * SAMPLES, 0
    line = np.zeros(cells * SAMPLES + 1 + 2 * beyond, np.int64)
    for derived in near(simulation, where, others):
        x = derived.x() / geometry.cell_size
        weight = np.ones(len(x))
        for other in others:
            weight = weight * along(simulation, other, x[:, other], where[other])
        here = np.flatnonzero(weight)
        if not len(here):
            continue
        volume = UNIT * weight[here] * filled(derived)[here] / geometry.cell_size**dim
        total += int(np.rint(volume).sum())
        z = x[here, axis] * SAMPLES
        below = np.floor(z).astype(np.int64)
        for step in range(1 - REACH * SAMPLES, REACH * SAMPLES + 1):
            part = np.rint(volume * spline(geometry.stencil, (z - (below + step)) / SAMPLES))
            line += np.bincount(below + step + beyond, weights=part, minlength=len(line)).astype(np.int64)
    summed = simulation.comm.sum(np.append(line, total))
    fill = folded(simulation, summed[:-1], beyond, axis) / UNIT
    down = np.sign(simulation.scene.domain.gravity[axis])
    height = highest(fill[::-1] if down > 0.0 else fill) / SAMPLES
    height = cells - height if down > 0.0 else height
    return {"height": height * geometry.cell_size, "depth": int(summed[-1]) / UNIT * geometry.cell_size}


def section(simulation, position, axis):
    """discharge (m3/s), mass_flux (kg/s) and area (m2) through the plane across `axis` at a point (m), positive along the axis;
    in 2-D per metre of thickness. Collective."""
    geometry = simulation.geometry
    where = position / geometry.cell_size
    names = ["discharge", "mass_flux", "area"]
    sums = LayerSums(simulation, names)
    for derived in near(simulation, where, [axis]):
        x = derived.x()[:, axis] / geometry.cell_size
        weight = along(simulation, axis, x, where[axis], mirrored=False) / geometry.cell_size
        here = np.flatnonzero(weight)
        if len(here):
            volume, mass = filled(derived)[here] * weight[here], derived.mass()[here] * weight[here]
            v = derived.velocity()[here, axis].astype(np.float64)
            sums.add(derived, here, [volume * v, mass * v, volume])
    return sums.totals()


class LayerSums:
    """Named sums over particles of a layer, and then over all layers of all ranks."""

    def __init__(self, simulation, names):
        self.simulation, self.names = simulation, names
        self.layers = np.zeros((len(names), simulation.geometry.layers))

    def add(self, derived, here, values):
        """Add contributions, one array for each name, of the particles `here` of a law in whole layers."""
        population = derived.population
        layer = population.per_particle(population.block_layer)[here]
        for row, value in zip(self.layers, values, strict=True):
            row += np.bincount(layer, weights=value, minlength=len(row))

    def totals(self):
        """{name: total}. Collective."""
        summed = self.simulation.comm.sum(self.layers)
        return {name: math.fsum(row) for name, row in zip(self.names, summed, strict=True)}


def near(simulation, where, axes):
    """Yield the DerivedFields of each law, one group of layers after another: of layers that may hold particles within REACH
    cells of a place (in cells) along the slab axis, if that is one of `axes`, else of all."""
    geometry = simulation.geometry
    slab, first, last = geometry.axes[0], simulation.first_layer, simulation.last_layer
    if slab in axes and not geometry.periodic[slab]:
        home = math.floor(where[slab] + geometry.stencil.round)
        first, last = max(first, home - REACH - PADDING - 1), min(last, home + REACH + PADDING + 2)
    if first >= last:
        return
    populations = [population.part(first, last) for population in simulation.populations]
    for layers in layer_groups(sum(population.layer_counts for population in populations), first):
        for law, population in enumerate(populations):
            part = population.part(*layers)
            if len(part):
                yield simulation.derived_of(law, np.float64, part)


def filled(derived):
    """(n,) m3 that particles fill: their volume, but at most that at rest, for what has come apart fills no more than that."""
    return derived.volume0() * np.fmax(np.fmin(derived.J(), 1.0), 0.0)


def along(simulation, axis, x, place, mirrored=True):
    """(n,) weights of a place among particles at x (n,), in cells along one axis; with the images of the particles where the
    domain repeats, and in the walls, which are mirrors of the material."""
    geometry = simulation.geometry
    stencil, cells = geometry.stencil, geometry.cells[axis]
    found = spline(stencil, x - place)
    if geometry.periodic[axis]:
        return found + spline(stencil, x - place - cells) + spline(stencil, x - place + cells)
    for end, face in ((0, "min"), (cells, "max")):
        if mirrored and abs(place - end) < REACH and has_mirror(simulation, axis, face):
            found = found + spline(stencil, 2.0 * end - x - place)
    return found


def has_mirror(simulation, axis, face):
    """Whether a face is a wall that holds material: a mirror of it."""
    return simulation.scene.domain.wall(f"{'xyz'[axis]}_{face}").type not in NOT_HELD


def spline(stencil, distance):
    """(n,) weight of a node for particles this far from it, in cells: the scene's own shape function."""
    centre = np.floor(distance + stencil.round)
    weights = np.stack(np.broadcast_arrays(*stencil.weights(distance - centre)))
    node = stencil.low - centre.astype(np.int64)
    reached = (node >= 0) & (node < stencil.nodes)
    return np.where(reached, weights[np.clip(node, 0, stencil.nodes - 1), np.arange(len(node))], 0.0)


def folded(simulation, line, beyond, axis):
    """The samples of a line within the domain, with those beyond its walls as their images."""
    inside = line[beyond : len(line) - beyond].copy()
    count = min(beyond + 1, len(inside))
    if has_mirror(simulation, axis, "min"):
        inside[:count] += line[beyond::-1][:count]
    if has_mirror(simulation, axis, "max"):
        inside[len(inside) - count :] += line[len(line) - beyond - 1 :][:count][::-1]
    return inside


def highest(fill):
    """Number, and part of the way to the next, of the last sample that is filled by SURFACE; nan if there is none."""
    over = np.flatnonzero(fill >= SURFACE)
    if not len(over):
        return math.nan
    last = int(over[-1])
    if last == len(fill) - 1:
        return float(last)
    return last + (fill[last] - SURFACE) / (fill[last] - fill[last + 1])


def ratio(sum_of_products, weight):
    return sum_of_products / weight if weight > 0.0 else math.nan
