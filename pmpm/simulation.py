"""Simulation: the one place where the order of a time step is written.

dt         from a reduction started some steps ago           timestep
regroup    when due: migration and sorting are one event     parallel.regroup
nodes      laid out anew when particles may leave them       state.grid
P2G        edge layers, particles to nodes                   kernels, parallel.parts
halo       shared planes on their way                        parallel.halo
P2G, G2P   interior layers, meanwhile
halo       sums completed, the same way on both sides
G2P        edge layers
observers  whoever watches
"""

import math
import time as clock
from itertools import chain

import numpy as np

from pmpm import estimate, failure, guard, populate, readout, restart, restore
from pmpm.drive import Drive
from pmpm.failure import NumericalFailure
from pmpm.kernels import build, targets
from pmpm.kernels.loops import FARTHEST, SETTLED
from pmpm.kernels.places import TRAVEL
from pmpm.parallel import comm as communication
from pmpm.parallel.balance import Balance, best_edges, edges_between, layer_work
from pmpm.parallel.halo import Halo
from pmpm.parallel.parts import parts_of
from pmpm.parallel.regroup import migrate, partners
from pmpm.parallel.slabs import Slabs, room
from pmpm.particle_access import Particles
from pmpm.processors import processor
from pmpm.scene.errors import SceneError
from pmpm.scene.needs import domain_limits, grid_geometry, law_table, patch_walls, scene_needs
from pmpm.scene.shapes import shapes_in
from pmpm.state.assembly import Arrivals, settle
from pmpm.state.derived import DerivedFields
from pmpm.state.fields import Layout
from pmpm.state.grid import Patch
from pmpm.state.particles import Cloud, Population, layer_groups
from pmpm.timestep import FAILED, FORCE, GRADIENT, LAG, REQUEST, SPEED, WAVE, StepControl
from pmpm.watching import STOP, Observer, Timers, next_count, spread


class Simulation:
    """A scene being run. `comm`: an mpi4py communicator, or None for this process alone. Collective in all it does.

    `source` fills it with particles: the scene's own bodies, or what a checkpoint holds (see `restart`). `threads`: of this
    rank; results are the same bits for any number. `backend`: cpu, or cuda for a graphics card, whose sums come in any order.
    Raises SceneError if the scene holds no particles or a fixed time step is beyond the stable one.
    """

    def __init__(self, scene, comm=None, tell=None, source=None, threads=1, backend="cpu"):
        self.comm = communication.adopt(comm)
        self.scene, self.tell = scene, tell or (lambda message: None)
        self.dim, self.real = scene.dim, np.dtype(scene.method.precision).type
        self.needs = scene_needs(scene)
        self.geometry = grid_geometry(scene, self.needs)
        self.material_names = list(scene.materials)
        self.layouts = [Layout.of(law, self.dim, self.needs.carried(law)) for law in self.needs.laws]
        self.tables = [law_table(scene, law) for law in self.needs.laws]
        self.blend = self.real(scene.method.flip_blend or 0.0)
        self.dx, self.inv_dx = self.real(scene.domain.cell_size), self.real(1.0 / scene.domain.cell_size)
        self.limits, self.ends = domain_limits(scene, self.geometry)
        self.time, self.step_count = 0.0, 0
        self.request = 0  # what this rank is asked for, until all ranks have been told
        self.observers: list[Observer] = []
        self.counts: dict = {}  # of observers with a name, from a checkpoint: (seconds, count)
        self.outputs: dict = {}  # how much there is of each output, from a checkpoint
        self.dt = 0.0  # of the step just taken; before the first, of the one to come
        self.failure: dict | None = None
        self.energies_ready = False  # their kernels are compiled, or loaded, when the guard first asks for them
        self.halo_sent = np.zeros(2, np.int64)  # messages and bytes
        self.regroups, self.sent, self.sent_bytes = 0, np.zeros(self.comm.size, np.int64), 0
        self.timers = Timers()
        self.stretch = [0, 0.0]  # steps since this process began, and seconds spent on them without those who watch
        loops = build.chosen_loops()
        if loops not in build.LOOPS:
            raise SceneError(
                f"environment: PMPM_LOOPS = {loops!r} is not a kind of loops; known are {', '.join(build.LOOPS)}"
            )
        self.processor = processor(self, backend, threads)
        self.control = StepControl(
            self.comm, scene.time, scene.domain.cell_size, self.dim, FARTHEST / 64, SETTLED / 64, TRAVEL
        )
        self.flow = self.flow_of(scene)
        self.drive = Drive(scene, self.needs, self.tables, self.real, self.flow.mouths if self.flow else ())
        self.populations = []
        self.smallest_step = guard.smallest_step(scene, self.needs, self.tables)
        self.first_energy = 0.0
        self.energy_watch = guard.EnergyWatch(self) if guard.watches_energy(scene) else None
        source = source or populate.Beginning()
        works, window = tuple(law.module.WORK for law in self.needs.laws), self.needs.stencil.window
        self.balance = Balance(works, window, scene.parallel.balance)
        self.cut(best_edges(source.count_per_layer(self) @ np.array(works), self.comm.size, window))
        self.in_turn(self.warm_up_regroup)
        source.fill(self)
        self.check_fixed_step(SceneError)
        self.tell("preparing kernels (compiled once, then kept on disk)")
        self.in_turn(self.warm_up)

    @classmethod
    def restart(cls, path, scene=None, comm=None, threads=1, backend="cpu"):
        """Go on from a checkpoint file, or the newest good one of a run directory, on any number of ranks.

        `scene`: as it was, with changes that a run may take (see docs/reliability.md), or None to take the checkpoint's own; a
        scene with Python functions must be given. Raises SceneError or OutputError.
        """
        comm = communication.adopt(comm)
        return cls.go_on(restart.find(path, comm), scene, comm, threads=threads, backend=backend)

    @classmethod
    def go_on(cls, origin, scene=None, comm=None, tell=None, threads=1, backend="cpu"):
        """`restart` from a restart.Origin, which has been found before."""
        scene, comm = scene or restart.scene_of(origin, {}), communication.adopt(comm)
        with restart.opened(origin, scene, comm) as continuation:
            return cls(scene, comm, tell, continuation, threads, backend)

    # ---- set-up ----

    def flow_of(self, scene):
        """What comes in and leaves, None where nothing does."""
        if not scene.inflows and not self.needs.open:
            return None
        from pmpm.flow import Flow

        return Flow(self)

    def cut(self, edges):
        """Take these layers per rank: a new patch of nodes and new halo buffers; particles follow with `settle_in`."""
        stencil = self.needs.stencil
        slab_axis = self.geometry.axes[0]
        self.slabs = Slabs(
            self.geometry.layers, self.geometry.periodic[slab_axis], stencil.reach_low, stencil.reach_high, edges
        )
        self.first_layer, self.last_layer = self.slabs.owned(self.comm.rank)
        self.patch = Patch(
            self.geometry, self.first_layer, self.last_layer, len(self.needs.laws), self.real, self.needs.scheme.blends,
            self.needs.f_bar, self.processor.threads, self.needs.velocity_fields,
        )  # fmt: skip
        self.halo = Halo(
            self.comm, self.slabs, self.patch, self.kernels, self.halo_sent, self.processor.ordered, self.processor.host_room
        )  # fmt: skip
        self.processor.take_patch()
        self.walls = patch_walls(self.scene, self.geometry, self.patch, self.real)
        self.drive.meet(self.geometry, self.patch, self.walls)

    def share_layers(self):
        """Say which layers are summed first, and which thread does what; nodes are laid out anew before the next step."""
        work = layer_work(self.held_populations, self.balance.works, self.patch.layer_quads)
        self.parts = parts_of(
            work, self.needs.stencil.window, self.halo.low_shared, self.halo.high_shared, self.processor.threads
        )
        self.processor.take_parts()
        self.patch.stale = True

    def lay_out(self):
        """Take the nodes that the particles reach now."""
        mirrors = [(wall.place, wall.on) for wall in self.walls]
        self.patch.lay_out(self.processor.mark, self.kernels, mirrors, self.processor.slack)
        for wall in self.walls:
            wall.lay_out(self.patch)
        self.drive.lay_out()
        self.halo.lay_out()
        self.processor.take_nodes()

    @property
    def populations(self):
        """This rank's particles of each law, a list of state.particles.Population. Whoever writes to them tells by
        `changed_by_hand`."""
        self.processor.give_particles()
        return self.held_populations

    @populations.setter
    def populations(self, populations):
        self.held_populations = populations
        self.processor.take_particles()

    @property
    def kernels(self):
        """Compiled for this scene."""
        return self.processor.kernels

    def no_particles(self):
        """Empty populations of this rank's layers."""
        layers = self.last_layer - self.first_layer
        return [Population.empty(layout.size, layers, self.first_layer, self.real) for layout in self.layouts]

    def pad_values(self, layout):
        values = np.zeros(layout.size, self.real)
        values[layout.state_first :] = layout.rest_state()
        return values

    def in_turn(self, warm_up):
        """Compile or load kernels by calling them on nothing: rank 0 first, so that the others find its cache."""
        began = clock.perf_counter()
        for turn in (self.comm.rank == 0, self.comm.rank != 0):
            if turn:
                warm_up()
            self.comm.barrier()
        self.timers.add("compile", began)

    def warm_up_regroup(self):
        self.populations = self.no_particles()
        nobody, _ = self.processor.take_leaving(self.slabs.edges)
        self.processor.settle_in(self.slabs.edges, [Arrivals(cloud, 0) for cloud in nobody])
        self.held = self.rows()
        self.share_layers()

    def warm_up(self):
        self.lay_out()
        self.processor.warm_up()

    def fastest(self):
        """Maxima over this rank's particles in the order of what is reduced: |v|^2, c^2, |C|^2 where particles have it, and
        |b|^2 of the body force; drift is zero. A particle that is not a number stops the run, not this."""
        found = np.zeros(FAILED)
        for derived in chain.from_iterable(self.derived_groups(self.real)):
            values = {SPEED: derived.speed() ** 2, WAVE: derived.wave_speed_squared()}
            C = derived.field("C")
            if C is not None:
                values[GRADIENT] = np.square(C.astype(np.float64)).sum(axis=1)
            if self.needs.body_force is not None:
                values[FORCE] = derived.body_force_squared(self.needs.body_force, self.time)
            for kind, of_particles in values.items():
                finite = of_particles[np.isfinite(of_particles)]
                found[kind] = max(found[kind], float(finite.max(initial=0.0)))
        return found

    def state(self, outputs=None):
        """All that it takes to go on from here, for a checkpoint. Collective. NumericalFailure as `check`."""
        return restore.state(self, outputs)

    def save(self, path):
        """Write a checkpoint file, and its manifest beside it, from which `restart` goes on. Collective.

        Raises OutputError where it cannot be written, NumericalFailure as `check`.
        """
        from pmpm.output import checkpoints

        checkpoints.save(self, path)

    def datasets(self, state):
        """({dataset: this rank's rows}, {group: attributes}) of a checkpoint that holds a state of this simulation."""
        return restore.datasets(self, state)

    def changed_by_hand(self, moved=None):
        """Take note that someone has written to the particles, or changed what drives them; `moved`: all of them, per law, at
        new places. Collective."""
        if moved is not None:
            self.regroup(clouds=moved)
        self.processor.take_particles()
        self.control.begin(self.step_count, self.fastest())
        self.take_energy()

    def take_energy(self):
        """Count dissipation from here."""
        measured = self.measure()
        self.first_energy = readout.total_energy(measured) - (self.flow.net_energy if self.flow else 0.0)
        if self.energy_watch is not None:
            self.energy_watch.begin(measured)

    def note_loads(self):
        """Find the largest acceleration by loads. Collective."""
        if self.needs.loaded:
            derived = chain.from_iterable(self.derived_groups(np.float64))
            found = [np.square(d.field("load")).sum(axis=1).max(initial=0.0) for d in derived]
            self.drive.largest_load = float(np.sqrt(self.comm.max(np.array([max(found)]))[0]))

    def check_fixed_step(self, error):
        """Raise for a fixed step beyond the stable one, unless the scene forces it."""
        bound = self.control.exceeds(self.drive.acceleration(self.time))
        if bound is not None and not self.control.forced:
            raise error(f"{self.beyond_text(bound)}: give a shorter step, cfl instead, or time.force_step = true")

    def beyond_text(self, bound):
        return (
            f"time.step = {self.control.fixed_step} s is longer than the stable step of {bound:.6g} s at "
            f"t = {self.time:.6g} s"
        )

    def choose_step(self):
        """dt of the next step in s. Raises NumericalFailure if it has fallen below what the scene allows."""
        driven = self.drive.acceleration(self.time)
        dt = self.control.choose(self.time, driven)
        crawls = self.control.fixed_step is None and self.control.stable < self.smallest_step
        if crawls and self.step_count >= self.control.begun + LAG:  # G2P first, which tells a state that is not valid
            guard.stop_crawling(self, driven)
        return dt

    # ---- one time step ----

    def step(self):
        """Advance by one time step. Raises NumericalFailure, on all ranks, if a particle has failed."""
        began = clock.perf_counter()
        failed = self.control.collect()
        if failed is not None:
            self.stop(failed)
        if self.flow is not None:
            self.flow.start(self.time)
        self.control.floor = self.least()
        self.check_fixed_step(NumericalFailure)
        dt = self.choose_step()
        if self.control.regroup_due(self.step_count + 1, dt) or (self.flow is not None and self.flow.due()):
            self.regroup()
        self.advance(self.real(dt))
        self.step_count += 1
        end = self.scene.time.end
        self.dt, self.time = dt, end if dt == end - self.time else self.time + dt
        if self.energy_watch is not None:
            began += self.look_at_energy(self.energy_watch)
        self.stretch[0] += 1
        self.stretch[1] += clock.perf_counter() - began
        if self.finished and self.energy_watch is not None:
            self.energy_watch.last_look(self)
        self.call_observers()

    def least(self):
        """What the maxima of the step to come are at least, in the order of LEARNT: by what comes in and by colliders."""
        speed, wave = self.flow.floor if self.flow is not None else (0.0, 0.0)
        return max(speed, self.drive.fastest(self.time)), wave, 0.0, 0.0

    def advance(self, dt):
        now, processor = clock.perf_counter(), self.processor
        if self.patch.stale or self.patch.travelled > processor.slack:
            self.lay_out()
            now = self.timers.add("layout", now)
        processor.begin()
        layers, planes = self.last_layer - self.first_layer, self.patch.planes
        self.drive.start(self.time)
        if self.needs.scheme.blends:
            self.keep_velocities(dt)
            now = self.timers.add("p2g before", now)
        if self.needs.contact:
            self.keep_volumes(dt)
            now = self.timers.add("p2g volumes", now)
        runs = self.scatter(dt, "p2g")
        self.control.disorder.start(self.step_count + 1, runs, self.held)
        now = clock.perf_counter()
        if self.needs.f_bar:  # averages come first: there is nothing to do meanwhile
            self.finish_halo()
            processor.update(0, planes, dt)
            self.average_divergence(dt)
            processor.g2p([*self.parts.edges, *self.parts.inner], dt)
            self.end_step(dt, now)
            return
        low, high = self.parts.low, self.parts.high(layers)
        if self.parts.inner:
            processor.update(low, planes - high, dt)
            processor.g2p(self.parts.inner, dt)
            now = self.timers.add("g2p", now)
        if self.slabs.cuts:
            now = self.finish_halo()
        if self.parts.edges:
            waiting = [(0, low), (planes - high, planes)] if self.parts.inner else [(0, planes)]
            for first, last in waiting:
                processor.update(first, last, dt)
            processor.g2p(self.parts.edges, dt)
        self.end_step(dt, now)

    def finish_halo(self):
        """Wait for the shared planes and complete their sums; returns the time."""
        began = clock.perf_counter()
        self.halo.wait()
        began = self.timers.add("halo wait", began)
        self.processor.take_shared()
        self.drive.note_shared(self.halo)
        return self.timers.add("halo", began)

    def scatter(self, dt, phase):
        """Sum what particles give to the nodes, by the kernels of a phase, and send what others need of it on its way.

        Returns the number of runs of particles with the same stencil.
        """
        began, processor, parts = clock.perf_counter(), self.processor, self.parts
        # What is asked of a card is done later: it is told all of it before anybody waits for its shared planes.
        before, after = (parts.inner, ()) if processor.queues else ((), parts.inner)
        processor.clear()
        runs = processor.p2g(parts.edges, dt, phase)
        began = self.timers.add("p2g", began)
        processor.give_shared()
        began = self.timers.add("halo", began)
        runs += processor.p2g(before, dt, phase)
        began = self.timers.add("p2g", began)
        processor.wait_shared()
        self.halo.start()
        began = self.timers.add("halo", began)
        runs += processor.p2g(after, dt, phase)
        processor.add_apart()
        self.timers.add("p2g", began)
        return runs

    def keep_velocities(self, dt):
        """Fill the grid without impulses and keep its velocities: what a blend takes from those after the step.

        Nothing has acted on them: what walls do is part of the change, so that it reaches the particles whole.
        """
        self.scatter(dt, "p2g_before")
        self.finish_halo()
        self.processor.average("before")

    def keep_volumes(self, dt):
        """Fill the grid with the volumes of each velocity field, which tell where bodies touch and which way they face."""
        self.scatter(dt, "p2g_volumes")
        self.finish_halo()
        self.processor.keep_volumes()

    def average_divergence(self, dt):
        """Average the divergence of the velocities on the nodes, which stay there, for F-bar.

        Nodes near walls need no images: what they hold is divided by the volume that they hold it of.
        """
        self.processor.measure_divergence([*self.parts.edges, *self.parts.inner])
        self.processor.keep_nodes()
        self.scatter(dt, "p2g_divergence")
        self.finish_halo()
        self.processor.average("divergences")
        self.processor.restore_nodes()

    def end_step(self, dt, began):
        """Let the next steps know what this one has found."""
        extremes, failed = np.zeros(REQUEST + 1), self.processor.collect()
        extremes[:FAILED], extremes[FAILED] = self.processor.extremes, -math.inf
        if self.energy_watch is not None and self.needs.driven:
            self.energy_watch.note_work(self.processor.works)
        if failed and self.failure is None:
            self.failure = failure.describe(self, *min(failed))
        if self.failure is not None:
            extremes[FAILED] = -self.failure["step"]
        extremes[REQUEST], self.request = self.request, 0
        extremes[GRADIENT] /= float(dt) ** 2
        self.patch.travelled += self.processor.travelled + self.needs.places.unit  # to which places are rounded
        self.drive.finish(dt)
        self.control.start(self.step_count + 1, float(dt), extremes)
        self.timers.add("g2p", began)

    def look_at_energy(self, watch):
        """Let the guard see the energy when it is due; returns the seconds that its kernels took to compile."""
        compiling = 0.0
        if watch.due(self) and not self.energies_ready:
            began = clock.perf_counter()
            self.in_turn(lambda: self.energies(0))
            self.energies_ready, compiling = True, clock.perf_counter() - began
        watch.after(self)
        return compiling

    def energies(self, layers=None):
        """(layers, 3) J kinetic, strain and potential energy of this rank's particles in each of its layers."""
        return self.processor.energies(self.last_layer - self.first_layer if layers is None else layers)

    def regroup(self, edges=None, clouds=None):
        """Migration, sorting and new cuts (if `edges` are given) in one event: every particle joins the layer it lies in.

        `clouds`: take these particles, of each law, instead of those at hand. Results do not depend on the cuts. Raises
        ValueError, and changes nothing, for edges that are no slabs of all ranks.
        """
        began, moves = clock.perf_counter(), False
        if edges is not None and len(edges) != self.comm.size + 1:
            raise ValueError(f"edges {edges}: {self.comm.size} ranks need {self.comm.size + 1} of them")
        if edges is None and self.comm.size > 1 and clouds is None:
            edges = self.look_at_balance()
            moves = edges is not None
        before, sent = self.slabs.edges, (int(self.sent.sum()), self.sent_bytes)
        if edges is not None:
            self.cut(tuple(map(int, edges)))
        if clouds is not None:
            self.take_in(clouds)
        else:
            *ways, last = self.ways(before, self.slabs.edges)
            for after in ways:
                self.move(before, after)
                before = after
            self.move(before, last, None if self.flow is None else self.flow.emit(self))
        self.share_layers()
        self.control.regrouped(self.step_count)
        self.regroups += 1
        if moves:
            self.balance.note(self.step_count, int(self.sent.sum()) - sent[0], self.sent_bytes - sent[1])
        self.timers.add("regroup", began)

    def ways(self, before, after):
        """The edges to go through from those before to those after, so that no rank has much more than it had or will have."""
        if before == after:
            return [after]
        counts = np.zeros(self.geometry.layers, np.int64)
        first, last = before[self.comm.rank], before[self.comm.rank + 1]
        counts[first:last] = sum(population.layer_counts for population in self.held_populations)
        return edges_between(self.comm.sum(counts), before, after)

    def move(self, before, after, coming=None):
        """Let every particle join the layer it lies in, when the cuts were at edges `before` and are to be at `after`. Those
        beyond open faces are taken out; `coming`, a Cloud per law, goes to layers of this rank, behind all others of each."""
        slab = self.geometry.axes[0]
        near = partners(before, after, self.comm.rank, self.geometry.periodic[slab])
        clouds, upwards = self.processor.take_leaving(after)
        if self.flow is not None and self.needs.open:
            self.flow.take_out(self, self.processor.gone)
        arrived, sent = migrate(clouds, upwards, slab, after, self.comm, *near)
        del clouds, upwards
        for of_law, cloud in zip(arrived, coming or (), strict=False):
            of_law.cloud = Cloud.join([of_law.cloud, cloud])
        self.processor.settle_in(after, arrived)
        self.held = self.rows()
        self.note_sent(sent)

    def note_sent(self, sent):
        """Count what has been sent, (ranks, laws) particles."""
        self.sent += sent.sum(axis=1)
        rows = [Cloud.row_bytes(layout.size, self.dim, self.real) for layout in self.layouts]
        self.sent_bytes += int(sent.sum(axis=0) @ np.array(rows))

    def take_in(self, clouds):
        """Hold these particles of each law, which lie in layers of any rank and in no order yet, and no others."""
        if self.flow is not None and self.needs.open:
            clouds = self.flow.without_gone(self, clouds)
        arrived, sent = self.deliver(clouds)
        self.populations = self.no_particles()
        self.processor.take_leaving(self.slabs.edges)
        self.processor.settle_in(self.slabs.edges, arrived)
        self.held = self.rows()
        self.note_sent(sent)

    def deliver(self, clouds):
        """(Arrivals of each law, (ranks, laws) particles sent) where everyone in these Clouds goes to the rank of its layer."""
        everyone = [np.ones(len(cloud), bool) for cloud in clouds]
        return migrate(clouds, everyone, self.geometry.axes[0], self.slabs.edges, self.comm)

    def hold(self, batches, displaced, counts):
        """Hold the seeds of one group of this rank's layers after another, see state.assembly.settle, and `displaced` ones of
        each law that lie in layers of any rank, or None. Collective."""
        others = None if displaced is None else [arrivals.cloud for arrivals in self.deliver(displaced)[0]]
        self.populations = settle(
            batches, others, counts, self.geometry, self.kernels, self.first_layer, self.last_layer - self.first_layer,
            len(self.scene.sources), [self.pad_values(layout) for layout in self.layouts], self.processor.crew,
        )  # fmt: skip
        self.held = self.rows()
        self.share_layers()

    def look_at_balance(self):
        """New edges if they are worth it, else None. Collective."""
        return self.balance.look(self.counted_work(), self.slabs.edges, self.step_count - self.control.regroup_step)

    def counted_work(self):
        """(layers,) work of all layers of the domain in the last step, see `balance`. Collective."""
        work = np.zeros(self.geometry.layers, np.int64)
        work[self.first_layer : self.last_layer] = layer_work(
            self.held_populations, self.balance.works, self.patch.layer_quads
        )
        return self.comm.sum(work)

    # ---- running ----

    def run(self, until=None, steps=None):
        """Step until the scene's end, or stop early: at the first step not before `until` (s), after `steps`, or when asked."""
        stop_time = self.scene.time.end if until is None else min(until, self.scene.time.end)
        stop_step = math.inf if steps is None else self.step_count + steps
        while self.time < stop_time and self.step_count < stop_step and self.asked < STOP:
            self.step()
        self.check()

    @property
    def finished(self):
        return self.time >= self.scene.time.end

    def every(self, call, steps=None, seconds=None, at_start=False, name=None):
        """Call `call(simulation)` on all ranks every `steps` steps or every `seconds` of simulated time.

        With a `name` a restart goes on counting where the run stopped.
        """
        if (steps is None) == (seconds is None):
            raise ValueError("give either steps or seconds")
        if at_start:
            call(self)
        counted_for, count = self.counts.get(name, (None, 0))
        if seconds is not None and counted_for != seconds:
            count = next_count(self.time, seconds)
        self.observers.append(Observer(call, steps, seconds, count, name))

    def ask(self, request):
        """Ask all ranks for something, from one of them: they agree on it a few steps later, see `asked`."""
        self.request = max(self.request, request)

    @property
    def asked(self):
        """What all ranks have been asked for, the most urgent of it; 0 for nothing."""
        return self.control.asked

    def answered(self):
        """Take note that what was asked for has been done."""
        self.control.asked = 0

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

    def derived_of(self, law, real, population=None):
        population = self.populations[law] if population is None else population
        return DerivedFields(
            population, self.needs.laws[law], self.layouts[law], self.needs, self.geometry,
            self.tables[law], real,
        )  # fmt: skip

    def derived(self, real):
        return [self.derived_of(law, real) for law in range(len(self.needs.laws))]

    def derived_groups(self, real):
        """Yield the same of one group of layers after another, in little memory."""
        counts = sum(population.layer_counts for population in self.populations)
        for layers in layer_groups(counts, self.first_layer):
            yield [self.derived_of(law, real, p.part(*layers)) for law, p in enumerate(self.populations)]

    def no_derived(self, real):
        """The same of no particles."""
        nowhere = self.first_layer, self.first_layer
        return [self.derived_of(law, real, p.part(*nowhere)) for law, p in enumerate(self.populations)]

    @property
    def particles(self):
        """This rank's particles: arrays by name (x, v, F, C, J, mass, volume, volume0, material, id, state variables)."""
        return Particles(self)

    def rows(self):
        """How many particles this rank holds."""
        return sum(map(len, self.held_populations))

    @property
    def nbytes(self):
        """Bytes of this rank's particles."""
        return sum(population.nbytes for population in self.held_populations)

    def fields(self, names):
        """dict of this rank's rows of each named field, in the one global order: see state.fields.OUTPUT, `x` and `id`."""
        return readout.fields(self, names)

    def fields_later(self, names):
        """The same, made when they are written."""
        return readout.fields_later(self, names)

    def law_fields_later(self, names):
        """dict of law -> dict of the named state variables it keeps, over its own particles in order, made when written."""
        return readout.law_fields_later(self, names)

    def impulses(self):
        """{name of a collider: (momentum (dim,) in N s, its moment about the pivot in N m s)} that it has been given since the
        run began; of a metre of depth in 2-D. Collective."""
        return {o.name: o.in_newtons(o.total(self.comm)) for o in self.drive.obstacles}

    def mean_forces(self):
        """{name of a collider: (force (dim,) in N, torque in N m)}, the mean since this was last asked for. Collective."""
        return {o.name: o.mean_force(self.comm, self.time) for o in self.drive.obstacles}

    def collider_places(self):
        """{name of a collider: (rotation (dim, dim), shift (dim,) m)} since the start: where it is now."""
        return {o.name: (o.turn.copy(), o.shift.copy()) for o in self.drive.obstacles}

    def measure(self):
        """Totals over all ranks, the same for any rank count: particles, mass, momentum, angular momentum, energies, ..."""
        return readout.measure(self)

    @property
    def notes(self):
        """What a user should know about this run before it begins, one line each."""
        space, found = room(self.geometry.layers, self.needs.stencil.window), []
        idle = self.comm.size - space
        if idle > 0:
            found.append(
                f"warning: {idle} of {self.comm.size} ranks stay idle: {self.geometry.layers} layers along "
                f"{'xyz'[self.geometry.axes[0]]} have room for {space} ranks of at least {self.needs.stencil.window} layers"
            )
        bound = self.control.exceeds(self.drive.acceleration(self.time))
        if bound is not None:
            found.append(f"warning: {self.beyond_text(bound)}, and forced")
        for key, shape in shapes_in(self.scene):
            flaws = shape.flaws() if hasattr(shape, "flaws") else []
            found += [f"warning: {key}: {shape.file} was mended: {'; '.join(flaws)}"] if flaws else []
        found += [f"warning: {line}" for line in estimate.caught(self.scene)] if self.step_count == 0 else []
        return found

    @property
    def closing_notes(self):
        """What a user should know about the state that has been reached, one line each. Collective."""
        return [
            f"warning: {count} particles of {material} are crushed below {readout.CRUSHED:.0%} of their volume, down to J = "
            f"{smallest:.2g}: more than the law can carry"
            for material, (count, smallest) in readout.crushed(self).items()
        ]

    def report(self):
        """What run.json says about the run; collective."""
        compiled, loaded = targets.count_cache(self.kernels.entries.values())
        return {
            "steps": self.step_count,
            "time": self.time,
            "stretch": {"steps": self.stretch[0], "seconds": float(self.comm.max(np.array([self.stretch[1]]))[0])},
            "particles": int(self.comm.sum(np.array([self.rows()]))[0]),
            "ranks": self.comm.size,
            "backend": self.processor.name,
            "halo_from": "card" if self.processor.direct else "host",
            "threads": self.processor.threads,
            "edges": list(self.slabs.edges),
            "halo": [
                dict(zip(("messages", "bytes"), map(int, sent), strict=True))
                for sent in self.comm.gather(self.halo_sent)
            ],
            "sent": [list(map(int, sent)) for sent in self.comm.gather(self.sent)],
            "sent_bytes": self.comm.gather(self.sent_bytes),
            "regroups": self.regroups,
            "balance": self.balance.report(self.comm),
            **({"flow": self.flow.report()} if self.flow else {}),
            "kernels_compiled": compiled,
            "kernels_loaded": loaded,
            "seconds_per_phase": spread(self.comm.gather(self.timers.seconds)),
        }
