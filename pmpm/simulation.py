"""Simulation: the one place where the order of a time step is written.

dt         from a reduction started some steps ago           timestep
regroup    when due: migration and sorting are one event     parallel.regroup
P2G        layer by layer, particles to nodes                kernels
halo       shared planes on their way                        parallel.halo
G2P        interior layers, meanwhile                        kernels
halo       sums completed, the same way on both sides
G2P        edge layers
observers  whoever watches
"""

import math
import time as clock
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from pmpm.kernels import build, cpu, targets
from pmpm.kernels.needs import law_needs
from pmpm.parallel import comm as communication
from pmpm.parallel.halo import Halo
from pmpm.parallel.regroup import migrate, settle
from pmpm.parallel.slabs import Slabs, cut_evenly, room
from pmpm.scene import seeding
from pmpm.scene.errors import SceneError
from pmpm.scene.needs import domain_limits, grid_geometry, law_table, patch_walls, scene_needs
from pmpm.state.derived import DENSITY, PARAMETERS, DerivedFields
from pmpm.state.fields import Layout
from pmpm.state.grid import Patch
from pmpm.state.particles import Cloud, Population
from pmpm.timestep import StepControl


class NumericalFailure(Exception):  # noqa: N818
    """The run stopped for a numerical cause; the text names step, time, rank, particle, position and material."""


@dataclass
class Observer:
    """Something that watches the run: called every `steps` steps, or at the first step not before count * seconds."""

    call: Callable
    steps: int | None
    seconds: float | None
    count: int = 1

    def due(self, simulation):
        if self.steps is not None:
            return simulation.step_count % self.steps == 0
        assert self.seconds is not None
        if simulation.time < self.count * self.seconds:
            return False
        self.count = math.floor(simulation.time / self.seconds) + 1
        return True


@dataclass
class Timers:
    """Wall seconds per phase on this rank."""

    seconds: dict = field(default_factory=dict)

    def add(self, phase, began):
        now = clock.perf_counter()
        self.seconds[phase] = self.seconds.get(phase, 0.0) + now - began
        return now


class Simulation:
    """A scene being run. `comm`: an mpi4py communicator, or None for this process alone. Collective in all it does.

    Raises SceneError if the scene holds no particles or a fixed time step is beyond the stable one.
    """

    def __init__(self, scene, comm=None, tell=None):
        self.comm = communication.adopt(comm)
        self.scene, self.tell = scene, tell or (lambda message: None)
        self.dim, self.real = scene.dim, np.dtype(scene.method.precision).type
        self.needs = scene_needs(scene)
        self.geometry = grid_geometry(scene, self.needs)
        self.material_names = list(scene.materials)
        self.layouts = [Layout.of(law, self.dim) for law in self.needs.laws]
        self.tables = [law_table(scene, law) for law in self.needs.laws]
        self.kernel_tables = [table.astype(self.real) for table in self.tables]
        self.gravity = np.array(scene.domain.gravity)
        self.limits, self.edges = domain_limits(scene, self.geometry, self.real)
        self.time, self.step_count = 0.0, 0
        self.observers: list[Observer] = []
        self.failed: list[tuple[int, int, int, int]] = []  # (law, block, lane, cause) in this step, first of each range
        self.failure: dict | None = None
        self.regroups, self.sent = 0, np.zeros(self.comm.size, np.int64)
        self.timers = Timers()
        self.kernels = build.build(self.needs, self.layouts, [t.shape[1] - PARAMETERS for t in self.tables])

        self.cut(cut_evenly(self.count_seeds(), self.comm.size, self.needs.stencil.window))
        seeds = seeding.seed(self.scene, self.geometry, self.first_layer, self.last_layer)
        self.settle_in([self.cloud(law, seeds) for law in range(len(self.needs.laws))])
        settled_drift = max(self.needs.stencil.round, 1.0 - self.needs.stencil.round)
        self.control = StepControl(self.comm, scene.time, scene.domain.cell_size, self.dim, cpu.FARTHEST, settled_drift)
        self.control.begin(*self.fastest())
        self.check_fixed_step(SceneError)
        self.dt = self.control.choose(self.time)  # of the step just taken; before the first, of the one to come
        self.warm_up()
        self.first_energy = None
        self.first_energy = self.total_energy(self.measure())

    # ---- set-up ----

    def count_seeds(self):
        """(layers,) particles per layer over all ranks; each rank counts an equal share of the layers."""
        layers = self.geometry.layers
        first, last = (layers * r // self.comm.size for r in (self.comm.rank, self.comm.rank + 1))
        counts = self.comm.sum(seeding.count_per_layer(self.scene, self.geometry, first, last))
        for number, count in enumerate(counts.sum(axis=1)):
            if count == 0:
                raise SceneError(
                    f"scene: bodies[{number}] holds no particle: it is smaller than the distance between particles, "
                    "empty, or covered by later bodies"
                )
        return counts.sum(axis=0)

    def cloud(self, law, seeds):
        """The particles of one law, at rest state or in hydrostatic equilibrium, as rows."""
        layout, parts = self.layouts[law], []
        for number, (body, body_seeds) in enumerate(zip(self.scene.bodies, seeds, strict=True)):
            material = self.scene.materials[body.material]
            if law_needs(material.model, material.parameters) != self.needs.laws[law]:
                continue
            count = len(body_seeds.id)
            reals = np.zeros((count, layout.size), self.real)
            reals[:, : self.dim] = body_seeds.offset
            reals[:, layout.where("v")] = body.velocity
            reals[:, layout.state_first :] = layout.rest_state()
            if body.pressure == "hydrostatic":
                reals[:, layout.state_first :] = self.hydrostatic_state(law, number, body_seeds)
            parts.append(Cloud(reals, body_seeds.node, np.full(count, number, np.int32), body_seeds.id))
        return Cloud.join([Cloud.empty(layout.size, self.dim, self.real), *parts])

    def hydrostatic_state(self, law, number, seeds):
        """(n, state) of a fluid at rest under gravity beneath the top of its body."""
        strength = float(np.linalg.norm(self.gravity))
        up = -self.gravity / strength
        low, high = self.scene.bodies[number].shape.bounds()
        top = float(np.where(up > 0, high, low) @ up)
        depth = top - (seeds.node + seeds.offset) * self.geometry.cell_size @ up
        row = self.tables[law][number]
        function = targets.arrays(np.float64).compile(self.needs.laws[law].module.hydrostatic_state)
        return np.stack(function(depth, strength, tuple(row[PARAMETERS:]), row[DENSITY]), axis=-1)

    def cut(self, edges):
        """Take these layers per rank: a new patch of nodes and new halo buffers; particles follow with `settle_in`."""
        stencil = self.needs.stencil
        slab_axis = self.geometry.axes[0]
        self.slabs = Slabs(
            self.geometry.layers, self.geometry.periodic[slab_axis], stencil.reach_low, stencil.reach_high, edges
        )
        self.first_layer, self.last_layer = self.slabs.owned(self.comm.rank)
        self.patch = Patch(self.geometry, self.first_layer, self.last_layer, self.real)
        self.halo = Halo(self.comm, self.slabs, self.patch, stencil.window)
        self.walls = patch_walls(self.scene, self.geometry, self.patch, self.real)

    def settle_in(self, clouds):
        """Order particles that lie in this rank's layers."""
        layers = self.last_layer - self.first_layer
        self.populations = [
            Population.pack(cloud, self.geometry.axes, self.first_layer, layers, self.pad_values(layout))
            for cloud, layout in zip(clouds, self.layouts, strict=True)
        ]

    def pad_values(self, layout):
        values = np.zeros(layout.size, self.real)
        values[layout.state_first :] = layout.rest_state()
        return values

    def warm_up(self):
        """Compile or load every kernel by calling it on nothing: rank 0 first, so that the others find its cache."""
        began = clock.perf_counter()
        self.tell("preparing kernels (compiled once, then kept on disk)")
        for turn in (self.comm.rank == 0, self.comm.rank != 0):
            if turn:
                self.p2g(0, 0)
                self.kernels.fold_windows(
                    self.patch.windows, 0, 0, self.halo.targets, self.patch.nodes, self.halo.unsummed
                )
                self.update_planes(0, 0)
                self.g2p(0, 0, self.real(0), np.zeros(4))
                nothing, normal, none = (0,) * 9, np.zeros(self.dim, self.real), self.real(0)
                for wall, image in zip(self.kernels.walls.values(), self.kernels.images.values(), strict=True):
                    wall(self.patch.nodes, *nothing, normal, none)
                    image(self.patch.nodes, *nothing, normal)
            self.comm.barrier()
        self.timers.add("compile", began)

    def fastest(self):
        """(max |v|^2, max c^2) of this rank's particles."""
        speed = wave = 0.0
        for derived in self.derived(self.real):
            if len(derived.population):
                speed = max(speed, float((derived.speed() ** 2).max()))
                wave = max(wave, float(derived.wave_speed_squared().max()))
        return speed, wave

    def check_fixed_step(self, error):
        bound = self.control.exceeds()
        if bound is not None:
            raise error(
                f"time.step = {self.control.fixed_step} s is longer than the stable step of {bound:.6g} s at "
                f"t = {self.time:.6g} s: give a shorter step, or cfl instead"
            )

    # ---- one time step ----

    def step(self):
        """Advance by one time step. Raises NumericalFailure, on all ranks, if a particle has failed."""
        failed = self.control.collect()
        if failed is not None:
            self.stop(failed)
        self.check_fixed_step(NumericalFailure)
        dt = self.control.choose(self.time)
        if self.control.regroup_due(dt):
            self.regroup()
        self.advance(self.real(dt))
        self.step_count += 1
        end = self.scene.time.end
        self.dt, self.time = dt, end if dt == end - self.time else self.time + dt
        self.call_observers()

    def advance(self, dt):
        now = clock.perf_counter()
        extremes = np.zeros(4)
        extremes[3] = -math.inf
        self.failed.clear()
        self.patch.nodes[:] = 0
        self.halo.clear()
        layers, planes = self.last_layer - self.first_layer, self.patch.planes
        chunk = len(self.patch.windows)
        for first in range(0, layers, chunk):
            last = min(first + chunk, layers)
            self.p2g(first, last, dt)
            self.kernels.fold_windows(
                self.patch.windows, first, last, self.halo.targets, self.patch.nodes, self.halo.unsummed
            )
        now = self.timers.add("p2g", now)
        posted = self.halo.start()
        now = self.timers.add("halo", now)

        shared = self.needs.stencil.window - 1
        low, high = shared * self.halo.low_shared, shared * self.halo.high_shared
        inner = (low, max(low, layers - high))
        self.update_planes(low, planes - high, dt)
        self.g2p(*inner, dt, extremes)
        now = self.timers.add("g2p", now)
        self.halo.finish(posted)
        now = self.timers.add("halo", now)
        self.update_planes(0, min(low, planes), dt)
        self.update_planes(max(planes - high, 0), planes, dt)
        self.g2p(0, min(inner[0], layers), dt, extremes)
        self.g2p(inner[1], layers, dt, extremes)
        if self.failed and self.failure is None:
            self.failure = self.describe_failure(*min(self.failed))
        if self.failure is not None:
            extremes[3] = -self.failure["step"]
        self.control.start(self.step_count + 1, float(dt), extremes)
        self.timers.add("g2p", now)

    def p2g(self, first, last, dt=0.0):
        dx, inv_dx = self.real(self.geometry.cell_size), self.real(1.0 / self.geometry.cell_size)
        for kernel, p, table in zip(self.kernels.p2g, self.populations, self.kernel_tables, strict=True):
            kernel(
                p.reals, p.home, p.block_row, p.block_count, p.layer_start, first, last, table,
                self.patch.windows, self.real(dt), dx, inv_dx,
            )  # fmt: skip

    def update_planes(self, first, last, dt=0.0):
        """Momentum to velocity, gravity and walls on planes first .. last - 1 of the patch."""
        nodes = self.patch.nodes
        if first < last:
            self.wrap_planes(nodes[first:last])
        if self.gravity.any():
            self.kernels.add_gravity(nodes, first, last, (self.gravity * float(dt)).astype(self.real))
        here = [(wall, wall.clipped(first, last)) for wall in self.walls]
        for wall, box in here:
            self.kernels.walls[wall.type](nodes, *box, *wall.step, wall.normal, wall.coefficient)
        self.kernels.divide_by_mass(nodes, first, last)
        for wall, box in here:
            self.kernels.images[wall.type](nodes, *box, *wall.step, wall.normal)

    def wrap_planes(self, planes):
        """Sum the images of a periodic axis other than the slab axis; both images then hold the total."""
        stencil, (_, middle, row) = self.geometry.stencil, self.geometry.axes
        shared = stencil.reach_low + stencil.reach_high
        for array_axis, axis in ((1, middle), (2, row)):
            if axis >= 0 and self.geometry.periodic[axis]:
                cells = self.geometry.cells[axis]
                low, high = (np.moveaxis(planes, array_axis, 0)[s : s + shared] for s in (0, cells))
                total = low + high
                low[:], high[:] = total, total

    def g2p(self, first, last, dt, extremes):
        """Nodes to particles of layers first .. last - 1 (this rank's counting); maxima go into `extremes`."""
        dx, inv_dx = self.real(self.geometry.cell_size), self.real(1.0 / self.geometry.cell_size)
        failure = np.zeros(3, np.int64)
        for number, (kernel, p) in enumerate(zip(self.kernels.g2p, self.populations, strict=True)):
            found = kernel(
                p.reals, p.home, p.block_row, p.block_count, p.layer_start, first, last, self.kernel_tables[number],
                self.patch.nodes, self.first_layer, self.limits, self.edges, dt, dx, inv_dx, failure,
            )  # fmt: skip
            np.maximum(extremes[:3], found, out=extremes[:3])
            if failure[0]:
                cause, block, lane = map(int, failure)
                self.failed.append((number, block, lane, cause))

    def regroup(self, edges=None):
        """Migration, sorting and new cuts (if `edges` are given) in one event: every particle joins the layer it lies in.

        Results do not depend on the cuts. Raises ValueError, and changes nothing, for edges that are no slabs of all ranks.
        """
        began = clock.perf_counter()
        if edges is not None and len(edges) != self.comm.size + 1:
            raise ValueError(f"edges {edges}: {self.comm.size} ranks need {self.comm.size + 1} of them")
        clouds = [settle(population.unpack(self.geometry.axes), self.geometry) for population in self.populations]
        if edges is not None:
            self.cut(tuple(map(int, edges)))
        clouds, sent = migrate(clouds, self.geometry.axes[0], self.slabs, self.comm)
        self.settle_in(clouds)
        self.control.regrouped(self.step_count)
        self.regroups += 1
        self.sent += sent
        self.timers.add("regroup", began)

    # ---- running ----

    def run(self, until=None, steps=None):
        """Step until the scene's end, or stop early at the first step not before `until` (s) or after `steps` steps."""
        stop_time = self.scene.time.end if until is None else min(until, self.scene.time.end)
        stop_step = math.inf if steps is None else self.step_count + steps
        while self.time < stop_time and self.step_count < stop_step:
            self.step()
        self.check()

    @property
    def finished(self):
        return self.time >= self.scene.time.end

    def every(self, call, steps=None, seconds=None, at_start=False):
        """Call `call(simulation)` on all ranks every `steps` steps or every `seconds` of simulated time."""
        if (steps is None) == (seconds is None):
            raise ValueError("give either steps or seconds")
        if at_start:
            call(self)
        self.observers.append(Observer(call, steps, seconds))

    def call_observers(self):
        due = [observer for observer in self.observers if observer.due(self)]
        if any(observer.steps != 1 for observer in due):
            self.check()  # nothing is written of a state that has already failed
        for observer in due:
            observer.call(self)

    # ---- when it goes wrong ----

    def check(self):
        """Raise NumericalFailure on all ranks if any particle has failed so far; changes nothing else."""
        failed = self.control.known_failure()
        if failed is not None:
            self.stop(failed)

    def describe_failure(self, law, block, lane, cause):
        """What there is to say about the first particle that failed here, first in the one global order of its law."""
        population, layout = self.populations[law], self.layouts[law]
        index = int(np.flatnonzero(population.lanes.ravel()).searchsorted(block * population.lanes.shape[1] + lane))
        x = self.derived_of(law, np.float64).x()[index]
        state = {
            f.name: population.reals[block, layout.where(f.name), lane] for f in layout.fields[layout_own(layout) :]
        }
        body = int(population.block_row[block])
        return {
            "step": self.step_count + 1,
            "time": self.time,
            "rank": self.comm.rank,
            "law": law,
            "id": int(population.id[block, lane]),
            "position": [float(value) for value in x],
            "material": self.scene.bodies[body].material,
            "velocity": [float(value) for value in population.reals[block, layout.where("v"), lane]],
            "cause": cause,
            "state": ", ".join(f"{name} = {np.array2string(value, precision=4)}" for name, value in state.items()),
        }

    def stop(self, failed_step):
        """Raise NumericalFailure on all ranks, naming the particle that is first by law and then in the one global order.

        Ranks hold consecutive pieces of that order and `min` takes the first of equals: any rank count names the same.
        """
        records = [r for r in self.comm.gather(self.failure) if r is not None and r["step"] == failed_step]
        raise NumericalFailure(failure_message(min(records, key=lambda record: record["law"])))

    # ---- what users see ----

    def derived_of(self, law, real):
        return DerivedFields(
            self.populations[law], self.needs.laws[law], self.layouts[law], self.needs.tensors, self.geometry,
            self.tables[law], real,
        )  # fmt: skip

    def derived(self, real):
        return [self.derived_of(law, real) for law in range(len(self.needs.laws))]

    @property
    def particles(self):
        """This rank's particles: arrays by name (x, v, F, C, J, mass, volume, volume0, material, id, state variables)."""
        return Particles(self)

    def rows(self):
        """How many particles this rank holds."""
        return sum(len(population) for population in self.populations)

    def order(self):
        """Permutation that puts the laws' particles, one law after another, into the one global order."""
        return np.argsort(np.concatenate([p.per_particle(p.block_layer) for p in self.populations]), kind="stable")

    def fields(self, names):
        """dict of this rank's rows of each named field, in the one global order: see state.fields.OUTPUT, `x` and `id`."""
        order, derived = self.order(), self.derived(self.real)
        return {name: np.concatenate([self.field(d, name) for d in derived])[order] for name in names}

    def field(self, derived, name):
        population = derived.population
        if name == "id":
            return population.id[population.lanes]
        if name == "material":
            materials = np.array([self.material_names.index(b.material) for b in self.scene.bodies], np.int32)
            return materials[population.per_particle(population.block_row)]
        if hasattr(derived, name):
            return np.asarray(getattr(derived, name)())
        return self.stored_field(derived, name)

    def stored_field(self, derived, name):
        """Rows of a stored field, nan where this law keeps no such field."""
        values = derived.field(name)
        if values is None:
            size = max(f.size(self.dim) for layout in self.layouts for f in layout.fields if f.name == name)
            values = np.full((len(derived.population), size), np.nan, self.real)
        return values[:, 0] if values.shape[1] == 1 else values

    def law_fields(self, names):
        """dict of law -> dict of the named state variables it keeps, over its own particles in order."""
        found: dict[str, dict] = {}
        for law, derived in zip(self.needs.laws, self.derived(self.real), strict=True):
            own = {f.name for f in law.fields}
            values = {name: derived.field(name) for name in names if name in own}
            if values:
                found[law.model] = {k: v[:, 0] if v.shape[1] == 1 else v for k, v in values.items()}
        return found

    def measure(self):
        """Totals over all ranks: particles, mass, momentum, angular momentum, energies, max_speed.

        Sums run over particles within a layer and then over layers, so that they do not depend on the rank count.
        """
        per_layer: dict[str, np.ndarray] = {}
        top, layers = 0.0, self.geometry.layers
        for derived in self.derived(np.float64):
            layer = derived.population.per_particle(derived.population.block_layer)
            for name, values in derived.totals(self.gravity).items():
                added = np.bincount(layer, weights=values, minlength=layers)
                per_layer[name] = per_layer.get(name, 0.0) + added
            top = max(top, float(derived.speed().max(initial=0.0)))
        names = list(per_layer)
        summed = self.comm.sum(np.stack([per_layer[name] for name in names]))
        found: dict[str, float] = {"particles": int(self.comm.sum(np.array([self.rows()]))[0])}
        found |= {name: math.fsum(row) for name, row in zip(names, summed, strict=True)}
        if self.first_energy is not None:
            found["dissipated"] = self.first_energy - self.total_energy(found)
        else:
            found["dissipated"] = 0.0
        found["max_speed"] = float(self.comm.max(np.array([top]))[0])
        return found

    @staticmethod
    def total_energy(measured):
        return measured["kinetic"] + measured["strain"] + measured["potential"]

    @property
    def notes(self):
        """What a user should know about this run before it begins, one line each."""
        space = room(self.geometry.layers, self.needs.stencil.window)
        idle = self.comm.size - space
        if idle <= 0:
            return []
        return [
            f"warning: {idle} of {self.comm.size} ranks stay idle: {self.geometry.layers} layers along "
            f"{'xyz'[self.geometry.axes[0]]} have room for {space} ranks of at least {self.needs.stencil.window} layers"
        ]

    def report(self):
        """What run.json says about the run; collective."""
        compiled, loaded = targets.count_cache(self.kernels.entries.values())
        return {
            "steps": self.step_count,
            "time": self.time,
            "particles": int(self.comm.sum(np.array([self.rows()]))[0]),
            "ranks": self.comm.size,
            "edges": list(self.slabs.edges),
            "sent": [list(map(int, sent)) for sent in self.comm.gather(self.sent)],
            "regroups": self.regroups,
            "kernels_compiled": compiled,
            "kernels_loaded": loaded,
            "seconds_per_phase": spread(self.comm.gather(self.timers.seconds)),
        }


class Particles:
    """This rank's particles as arrays: reading gives a copy, assigning writes back. Rows may change order at any step."""

    READ_ONLY = ("id", "material", "mass", "volume0", "volume", "J")

    def __init__(self, simulation):
        object.__setattr__(self, "simulation", simulation)

    def __getattr__(self, name):
        simulation = self.simulation
        if name == "volume":
            return self.volume0 * self.J
        if name not in simulation_fields(simulation):
            raise AttributeError(f"particles have no {name!r}; known: {', '.join(simulation_fields(simulation))}")
        values = simulation.fields([name])[name]
        if name in ("F", "C"):
            return values.reshape(-1, simulation.dim, simulation.dim)
        return values

    def __setattr__(self, name, values):
        """Write (n, ...) values back. Assigning `x` is collective: it regroups all particles."""
        simulation = self.simulation
        if name not in simulation_fields(simulation) or (name in self.READ_ONLY and not writable(simulation, name)):
            raise AttributeError(f"particles.{name} cannot be assigned")
        values = np.asarray(values).reshape(simulation.rows(), -1)
        if name == "x":
            self.check_inside(values)
        in_order = np.empty_like(values)
        in_order[simulation.order()] = values
        first = 0
        for population, layout in zip(simulation.populations, simulation.layouts, strict=True):
            rows = in_order[first : first + len(population)]
            first += len(population)
            if name == "x":
                node = population.unpack(simulation.geometry.axes).node
                population.set_rows(layout.where("x"), rows / simulation.geometry.cell_size - node)
            elif layout.where(name) is not None:
                population.set_rows(layout.where(name), rows)
        if name == "x":
            simulation.regroup()

    def check_inside(self, x):
        """Raise ValueError, on all ranks, if any rank's positions (n, dim) in m are not numbers or beyond the walls."""
        comm, geometry = self.simulation.comm, self.simulation.geometry
        nearest = np.floor(x / geometry.cell_size + geometry.stencil.round)
        inside = np.isfinite(x)
        for axis in range(geometry.dim):
            if not geometry.periodic[axis]:
                inside[:, axis] &= (nearest[:, axis] >= 0) & (nearest[:, axis] < geometry.homes(axis))
        outside = int(comm.sum(np.array([np.count_nonzero(~inside.all(axis=1))]))[0])
        if outside:
            raise ValueError(f"particles.x: {outside} of the new positions are not inside the domain")


def writable(simulation, name):
    """Whether a derived quantity is a stored state variable of some law here."""
    return any(layout.where(name) is not None for layout in simulation.layouts)


def simulation_fields(simulation):
    """Names that `particles` answers to."""
    stored = [f.name for layout in simulation.layouts for f in layout.fields]
    return list(dict.fromkeys(["x", "v", "C", *stored, "J", "mass", "volume0", "material", "id", "density", "stress"]))


def layout_own(layout):
    """Number of fields every law has."""
    return len(layout.fields) - sum(1 for f in layout.fields if layout.where(f.name).start >= layout.state_first)


def failure_message(record):
    """One line a user can act on."""
    finite = all(math.isfinite(value) for value in record["velocity"])
    causes = {
        cpu.CAUSE_POSITION: "it moved further in a few steps than the padding of its slab allows: the time step is too "
        "long" if finite else "its velocity is not a number",
        cpu.CAUSE_STATE: f"its state is no longer valid: {record['state']}",
        cpu.CAUSE_LEFT: "it left the domain",
    }  # fmt: skip
    position = ", ".join(f"{value:.6g}" for value in record["position"])
    return (
        f"step {record['step']}, t = {record['time']:.6g} s, rank {record['rank']}: particle {record['id']} of material "
        f"{record['material']} at ({position}) m: {causes[record['cause']]} (velocity {record['velocity']} m/s)"
    )


def spread(per_rank):
    """min, mean and max over ranks of each phase's seconds."""
    names = sorted({name for seconds in per_rank for name in seconds})
    values = {name: [seconds.get(name, 0.0) for seconds in per_rank] for name in names}
    return {
        name: {"min": min(v), "mean": math.fsum(v) / len(v), "max": max(v)} for name, v in values.items()
    }  # fmt: skip
