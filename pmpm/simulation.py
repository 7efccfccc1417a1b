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

import numpy as np

from pmpm import failure, populate, readout
from pmpm.failure import NumericalFailure
from pmpm.kernels import build, cpu, targets
from pmpm.parallel import comm as communication
from pmpm.parallel.halo import Halo
from pmpm.parallel.regroup import migrate, settle
from pmpm.parallel.slabs import Slabs, cut_evenly, room
from pmpm.particle_access import Particles
from pmpm.scene import seeding
from pmpm.scene.errors import SceneError
from pmpm.scene.needs import domain_limits, grid_geometry, law_table, patch_walls, scene_needs
from pmpm.state.derived import PARAMETERS, DerivedFields
from pmpm.state.fields import Layout
from pmpm.state.grid import Patch
from pmpm.state.particles import Population
from pmpm.timestep import StepControl
from pmpm.watching import Observer, Timers, spread


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

        self.cut(cut_evenly(populate.count_per_layer(self), self.comm.size, self.needs.stencil.window))
        seeds = seeding.seed(self.scene, self.geometry, self.first_layer, self.last_layer)
        self.settle_in([populate.cloud(self, law, seeds) for law in range(len(self.needs.laws))])
        settled_drift = max(self.needs.stencil.round, 1.0 - self.needs.stencil.round)
        self.control = StepControl(self.comm, scene.time, scene.domain.cell_size, self.dim, cpu.FARTHEST, settled_drift)
        self.control.begin(self.step_count, *self.fastest())
        self.check_fixed_step(SceneError)
        self.dt = self.control.choose(self.time)  # of the step just taken; before the first, of the one to come
        self.warm_up()
        self.first_energy = 0.0
        self.take_energy()

    # ---- set-up ----

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
        """(max |v|^2, max c^2) of this rank's particles; a particle that is not a number stops the run, not this."""
        speed = wave = 0.0
        for derived in self.derived(self.real):
            speeds, waves = derived.speed() ** 2, derived.wave_speed_squared()
            speed = max(speed, float(speeds[np.isfinite(speeds)].max(initial=0.0)))
            wave = max(wave, float(waves[np.isfinite(waves)].max(initial=0.0)))
        return speed, wave

    def changed_by_hand(self, moved):
        """Take note that someone has written to the particles; `moved`: to their positions. Collective."""
        if moved:
            self.regroup()
        self.control.begin(self.step_count, *self.fastest())
        self.take_energy()

    def take_energy(self):
        """Count dissipation from here."""
        self.first_energy = readout.total_energy(self.measure())

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
            self.failure = failure.describe(self, *min(self.failed))
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

    def stop(self, failed_step):
        """Raise NumericalFailure on all ranks, naming the particle that is first by law and then in the one global order.

        Ranks hold consecutive pieces of that order and `min` takes the first of equals: any rank count names the same.
        """
        records = [r for r in self.comm.gather(self.failure) if r is not None and r["step"] == failed_step]
        raise NumericalFailure(failure.message(min(records, key=lambda record: record["law"])))

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

    def fields(self, names):
        """dict of this rank's rows of each named field, in the one global order: see state.fields.OUTPUT, `x` and `id`."""
        return readout.fields(self, names)

    def law_fields(self, names):
        """dict of law -> dict of the named state variables it keeps, over its own particles in order."""
        return readout.law_fields(self, names)

    def measure(self):
        """Totals over all ranks, the same for any rank count: particles, mass, momentum, angular momentum, energies, ..."""
        return readout.measure(self)

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
