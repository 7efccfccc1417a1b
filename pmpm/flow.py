"""What leaves a simulation through open faces and what inflows bring into it; both happen at a regroup.

Beyond an open face there is grid for a cell and no more: a particle there drifts (kernels.loops), and a regroup is due before
it has used that up, which takes it out. An inflow is a region of space through which a lattice of particles moves as told: the
nodes that they reach move so too, and whenever the lattice has come a spacing farther, what has newly entered the region is
put in as particles. All is decided from time, steps and maxima over all ranks, and everybody knows all of it.

At any time particles inside + left = those at the start + emitted, in whole numbers, source by source.
"""

import math
from itertools import product

import numpy as np

from pmpm import estimate
from pmpm.drive import Region
from pmpm.failure import NumericalFailure
from pmpm.particle_access import nodes_and_places
from pmpm.populate import in_precision, state_at_rest
from pmpm.scene.forcing import velocity_at
from pmpm.scene.functions import Unfit
from pmpm.scene.needs import laws_of_sources, open_faces
from pmpm.scene.seeding import id_offsets, lattice_range
from pmpm.state.derived import MASS, VOLUME0
from pmpm.state.fields import SHARE_STEPS, in_steps
from pmpm.state.particles import Cloud, Ordered, Population
from pmpm.timestep import LAG

EARLY = 1e-9  # of a spacing: what has been travelled is rounded
TURNED = 1e-9  # less than 1 that the cosine of no angle may be
DROPS = 1e-9  # of a particle: a limit may be written with fewer digits


class Flow:
    """What has come into one simulation, and what has left it.

    left: (sources,) particles, left_steps: their shares in SHARE_STEPS; taken, brought: {name: sum} of momentum (N s,
    `momentum_x` ...) and energy (J) with them.
    """

    def __init__(self, simulation):
        scene = simulation.scene
        self.scene, self.opened = scene, simulation.needs.open
        self.floor = (0.0, 0.0)  # m/s: speed and speed of waves of what is about to come in
        self.left, self.left_steps = np.zeros((2, len(scene.sources)), np.int64)
        names = [*(f"momentum_{axis}" for axis in "xyz"[: scene.dim]), "energy"]
        self.taken, self.brought = dict.fromkeys(names, 0.0), dict.fromkeys(names, 0.0)
        self.first_id = int(id_offsets(scene)[-1])
        self.masses, self.volumes = (
            np.array([max(table[row, column] for table in simulation.tables) for row in range(len(scene.sources))])
            for column in (MASS, VOLUME0)
        )
        waves = estimate.waves_at_rest(scene, simulation.needs, simulation.tables)
        self.mouths = []
        laws = laws_of_sources(scene)
        for number, inflow in enumerate(scene.inflows):
            row = len(scene.bodies) + number
            law = simulation.needs.laws.index(laws[row])
            self.mouths.append(
                Mouth(inflow, number, row, law, scene, simulation.geometry, waves[law], self.volumes[row])
            )

    @property
    def emitted(self):
        """(sources,) particles that inflows have put in; none for bodies."""
        return np.array([*([0] * len(self.scene.bodies)), *(mouth.count for mouth in self.mouths)], np.int64)

    # ---- in ----

    def start(self, time):
        """Take the time (s) of the step to come: what comes in during it bounds it. NumericalFailure, on all ranks, where the
        velocity of an inflow turns round or is none."""
        for mouth in self.mouths:
            mouth.begin(time)
        to_come = [mouth for mouth in self.mouths if not mouth.over(time)]
        unknown = [mouth for mouth in self.mouths if mouth.unknown]
        self.floor = (
            max([mouth.speed_at(time) for mouth in to_come] + [mouth.put_in for mouth in unknown], default=0.0),
            max((mouth.wave for mouth in to_come + unknown), default=0.0),
        )

    def due(self):
        """Whether something comes in before the step that `start` was told of."""
        return any(mouth.due for mouth in self.mouths)

    def emit(self, simulation):
        """A Cloud per law of what comes into this rank's layers now, or None. All ranks count all of it."""
        if not self.due():
            return None
        slab = simulation.geometry.axes[0]
        found: list[list[Cloud]] = [[] for _ in simulation.layouts]
        for mouth in self.mouths:
            if mouth.due:
                first_id = self.first_id + sum(other.count for other in self.mouths)
                cloud = self.cloud(simulation, mouth, mouth.sheet(), first_id)
                add(self.brought, totals(simulation, mouth.law, cloud))
                layer = cloud.node[:, slab]
                here = (simulation.first_layer <= layer) & (layer < simulation.last_layer)
                found[mouth.law].append(cloud.take(np.flatnonzero(here)))
        return [
            Cloud.join([Cloud.room(0, layout.size, simulation.dim, simulation.real), *clouds])
            for layout, clouds in zip(simulation.layouts, found, strict=True)
        ]

    def cloud(self, simulation, mouth, x, first_id):
        """Particles at rest, but for the velocity of a mouth, at x (n, dim) m."""
        layout, count = simulation.layouts[mouth.law], len(x)
        node, place = nodes_and_places(simulation, x)
        reals = np.zeros((count, layout.size), simulation.real)
        reals[:, layout.where("v")] = mouth.velocity
        reals[:, layout.state_first :] = state_at_rest(simulation, mouth.law, mouth.row)
        if layout.where("X"):
            reals[:, layout.where("X")] = x
        if layout.where("share"):
            reals[:, layout.where("share")] = 1.0
        made = Cloud(reals, node, np.full(count, mouth.row, np.int32), first_id + np.arange(count))
        made.places[:, : simulation.dim] = place
        return made

    # ---- out ----

    def take_out(self, simulation, gone):
        """Count the particles of a Cloud of each law that have left this rank. Collective."""
        here = np.bincount(np.concatenate([cloud.row for cloud in gone]), minlength=len(self.left))
        steps = sum(share_steps(simulation, law, cloud, len(self.left)) for law, cloud in enumerate(gone))
        counts, steps = simulation.comm.sum(np.stack([here.astype(np.int64), steps]))
        if not counts.any():
            return
        self.left += counts
        self.left_steps += steps
        for law, cloud in enumerate(gone):
            everyone = Cloud.join([Cloud(*parts) for parts in simulation.comm.gather(cloud.parts)])
            add(self.taken, totals(simulation, law, everyone))

    def without_gone(self, simulation, clouds):
        """Clouds of each law without those beyond open faces, which are taken out. Collective."""
        geometry, places, opened = simulation.geometry, simulation.needs.places, open_faces(self.scene)
        gone = []
        for cloud in clouds:
            cell = cloud.node + (cloud.places[:, : geometry.dim] >> places.fraction)
            gone.append((((cell < 0) & opened[:, 0]) | ((cell >= np.array(geometry.cells)) & opened[:, 1])).any(axis=1))
        self.take_out(simulation, [cloud.take(np.flatnonzero(out)) for cloud, out in zip(clouds, gone, strict=True)])
        return [cloud.take(np.flatnonzero(~out)) for cloud, out in zip(clouds, gone, strict=True)]

    # ---- what is told ----

    @property
    def net_energy(self):
        """J that have come in, less what has left."""
        return self.brought["energy"] - self.taken["energy"]

    def measured(self):
        """What `Simulation.measure` tells besides: particles, mass, momentum and energy, as far as the scene has such flows."""
        found: dict[str, float] = {}
        out = "left", self.opened, self.left, self.left_steps / SHARE_STEPS, self.taken
        for name, there, counts, whole, carried in (
            out,
            ("emitted", self.mouths, self.emitted, self.emitted, self.brought),
        ):
            if there:
                found[name] = int(counts.sum())
                found[f"{name}_mass"] = math.fsum(whole * self.masses)
                found |= {f"{name}_{what}": value for what, value in carried.items()}
        return found

    def report(self):
        """What run.json says: particles of each body, then of each inflow."""
        return {"left": self.left.tolist(), "emitted": self.emitted.tolist()}

    # ---- the record ----

    def state(self):
        """What it takes to go on, as plain numbers; how far regions have travelled is told with all others."""
        last = [None if mouth.last is None else mouth.last.tolist() for mouth in self.mouths]
        return self.report() | {
            "left_steps": self.left_steps.tolist(),
            "last": last,
            "unknown": [(mouth.unknown, mouth.put_in) for mouth in self.mouths],
            "taken": self.taken,
            "brought": self.brought,
        }

    def resume(self, state):
        """Go on from what `state` gave. Raises ValueError where it is that of another scene."""
        names, sources, inflows = set(self.taken), len(self.left), len(self.mouths)
        fits = set(state["taken"]) == set(state["brought"]) == names
        fits = fits and len(state["last"]) == len(state["unknown"]) == inflows
        fits = fits and len(state["left"]) == len(state["left_steps"]) == len(state["emitted"]) == sources
        fits = fits and not any(state["emitted"][: len(self.scene.bodies)])
        if not fits or any(last is not None and len(last) != self.scene.dim for last in state["last"]):
            raise ValueError("what has come in and left is that of another scene")
        self.left[:], self.left_steps[:] = state["left"], state["left_steps"]
        self.taken, self.brought = dict(state["taken"]), dict(state["brought"])
        for mouth, last, unknown in zip(self.mouths, state["last"], state["unknown"], strict=True):
            mouth.last = None if last is None else np.array(last)
            mouth.count = state["emitted"][mouth.row]
            mouth.unknown, mouth.put_in = unknown


def share_steps(simulation, law, cloud, sources):
    """(sources,) sums of the shares of a Cloud of a law, in SHARE_STEPS."""
    where, found = simulation.layouts[law].where("share"), np.zeros(sources, np.int64)
    np.add.at(found, cloud.row, SHARE_STEPS if where is None else in_steps(cloud.reals[:, where]))
    return found


class Mouth(Region):
    """The region of an inflow: nodes that its particles reach, and the lattice that moves through it.

    travelled: (dim,) m of the lattice since the start, `last` the same when particles were put in last, or None; `put_in` their
    speed (m/s), `unknown` for how many steps the maxima over all particles do not tell it yet.
    """

    whole = True

    def __init__(self, inflow, number, row, law, scene, geometry, wave, volume):
        super().__init__(inflow, scene.dim)
        self.number, self.row, self.law, self.wave = number, row, law, wave
        self.real = np.dtype(scene.method.precision).type
        self.count, self.last, self.on, self.told = 0, None, False, False
        self.unknown, self.put_in = 0, 0.0
        self.spacing = scene.domain.cell_size / round(inflow.particles_per_cell ** (1 / scene.dim))
        self.most = math.inf if inflow.limit is None else math.floor(inflow.limit / volume + DROPS)
        self.reached = Widened(inflow.shape, 0.5 * geometry.stencil.nodes * geometry.cell_size)

    def over(self, time):
        """Whether nothing comes in any more."""
        return time >= self.motion.until or self.count >= self.most

    def begin(self, time):
        """Take the time of the step to come: before it particles are put in, and they have its velocity."""
        was, self.on = self.on, self.motion.start <= time and not self.over(time)
        if was != self.on:
            self.found = None
        self.velocity = self.velocity_at(time) if self.on else np.zeros(len(self.travelled))
        self.told = True

    def start(self, time):
        """Nothing: new cuts, which start all regions once more, come between `begin` and the step."""

    def velocity_at(self, time):
        """(dim,) m/s, in the precision of the run."""
        told = f"inflows[{self.number}].velocity at t = {time:.6g} s"
        try:
            found = in_precision(np.array(velocity_at(self.motion.velocity, time)), self.real).astype(np.float64)
        except (Unfit, TypeError, ValueError) as complaint:
            raise NumericalFailure(f"{told}: {complaint}") from None
        if found.shape != self.travelled.shape:
            raise NumericalFailure(f"{told}: must return {len(self.travelled)} numbers (m/s), not {found}")
        along, sizes = found @ self.travelled, np.linalg.norm(found) * np.linalg.norm(self.travelled)
        if along < (1.0 - TURNED) * sizes:
            raise NumericalFailure(f"{told}: has turned to {found} m/s: it may change its size, not its direction")
        return found

    def speed_at(self, time):
        return float(np.linalg.norm(self.velocity_at(max(time, self.motion.start))))

    def travel(self, dt):
        self.told, self.unknown = False, max(self.unknown - 1, 0)
        if self.on:
            self.travelled += float(dt) * self.velocity

    def nodes(self):
        if not self.on:
            return np.zeros(0, np.int64), np.zeros(0, np.int64)
        return self.found_in(self.reached, np.zeros(len(self.travelled)))

    @property
    def due(self):
        """Whether particles are to be put in before the step that `begin` was told of."""
        if not (self.told and self.on) or self.last is None:
            return self.told and self.on
        return bool(np.linalg.norm(self.travelled - self.last) >= (1.0 - EARLY) * self.spacing)

    def sheet(self):
        """(n, dim) m: places of the lattice that have entered the region since the last time, no more than may still come."""
        shape, last = self.motion.shape, self.last
        number = lattice_range(shape.bounds(), self.spacing, self.travelled)
        x = self.at(number, self.travelled)
        enters = shape.contains(x)
        if last is not None:
            enters &= ~shape.contains(self.at(number, last))
        x = x[enters][: int(min(self.most - self.count, len(x)))]
        self.count, self.last = self.count + len(x), self.travelled.copy()
        self.unknown, self.put_in = LAG, float(np.linalg.norm(self.velocity))
        return x

    def at(self, number, travelled):
        """Where places of the lattice are: always the same numbers for the same place and way."""
        return (number + 0.5) * self.spacing + travelled


class Widened:
    """A shape and what is nearer to it along all axes than `reach` (m), found by trying around each point."""

    def __init__(self, shape, reach):
        self.shape, self.reach = shape, reach

    def bounds(self):
        low, high = self.shape.bounds()
        return low - self.reach, high + self.reach

    def contains(self, points):
        found = np.zeros(len(points), bool)
        for offset in product((0.0, -1.0, 1.0, -0.5, 0.5), repeat=points.shape[1]):
            found[~found] = self.shape.contains(points[~found] + self.reach * np.array(offset))
        return found


def add(sums, more):
    for name, value in more.items():
        sums[name] += value


def totals(simulation, law, cloud):
    """{name: sum} of momentum and energy of the particles of a law, correctly rounded: in any order the same."""
    derived = simulation.derived_of(law, np.float64, population_of(simulation, law, cloud))
    found = derived.totals(simulation.drive.gravity)
    sums = {name: math.fsum(values) for name, values in found.items() if name.startswith("momentum")}
    return sums | {"energy": math.fsum(v for name in ("kinetic", "strain", "potential") for v in found[name])}


def population_of(simulation, law, cloud):
    """The particles of a Cloud by layer and id, each in a block of its own."""
    slab, middle, row = simulation.geometry.axes
    cloud = cloud.take(np.lexsort((cloud.id, cloud.node[:, slab])))
    layer = cloud.node[:, slab].astype(np.int64)
    bases = [cloud.node[:, axis] if axis >= 0 else 0 * layer for axis in (middle, row)]
    segments = np.stack([layer, np.ones_like(layer), cloud.row, *bases], axis=1).astype(np.int64)
    first, last = (int(layer[0]), int(layer[-1]) + 1) if len(layer) else (0, 0)
    rest = simulation.pad_values(simulation.layouts[law])
    return Population.of_ordered(Ordered(cloud.reals, cloud.id, segments), first, last - first, rest, simulation.dim)
