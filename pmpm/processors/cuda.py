"""What a rank does in a step, on a graphics card: the verbs of processors.cpu.

Particles and nodes stay on the card from step to step. The simulation's populations follow when somebody on the host asks for
them (regroups, files, measurements); the shared planes are brought to the host and back for the halo.
"""

import numpy as np
from numba import cuda

from pmpm.kernels import build, build_cuda
from pmpm.kernels.cuda_loops import CAUSES, FORCE, MAXIMA, STEP, THREADS
from pmpm.kernels.places import FORMATS
from pmpm.kernels.scalar_loops import FIELD_TUPLES
from pmpm.parallel.parts import Crew
from pmpm.scene.errors import SceneError
from pmpm.state.derived import PARAMETERS
from pmpm.state.particles import LANES

NO_FAILURE = 1 << 62


class Cuda:
    """The graphics card of one rank of a simulation."""

    name, threads, ordered = "cuda", 1, False

    card = cuda  # what gives memory
    tiled = True  # whether P2G sums in shared memory first

    def __init__(self, simulation):
        self.simulation, self.crew, self.real = simulation, Crew(1), simulation.real
        counts = [table.shape[1] - PARAMETERS for table in simulation.tables]
        most = max(FIELD_TUPLES)
        if max(counts) > most:
            raise SceneError(
                f"scene: with backend cuda a law has at most {most} parameters, one here has {max(counts)}"
            )
        self.kernels = build.build(simulation.needs, simulation.layouts, counts, "scalar")  # regroups, files
        self.on_card = build_cuda.build(simulation.needs, simulation.layouts, counts, self.tiled)
        self.tables = [self.card.to_device(with_last_axis(table.astype(self.real))) for table in simulation.tables]
        self.limits, self.ends = self.card.to_device(simulation.limits), self.card.to_device(simulation.ends)
        self.maxima = self.card.to_device(np.zeros(MAXIMA, self.real))
        self.failure = self.card.to_device(np.zeros(1, np.int64))
        self.rooms: dict = {}
        self.holds_newest = False  # whether the card's particles are newer than the simulation's

    @property
    def patch(self):
        return self.simulation.patch

    # ---- set-up ----

    def take_patch(self):
        """Nothing to do: nodes are taken when they are laid out."""

    def take_parts(self):
        """Nothing to do: nothing is kept apart."""

    def warm_up(self):
        """Compile what is needed, or load it."""
        if self.simulation.slabs.cuts:
            self.simulation.halo.warm_up()

    def take_particles(self):
        """Take the particles of the simulation, which are the newest."""
        driven, populations = self.simulation.needs.driven, self.simulation.held_populations
        self.particles = [OnCard(population, self.card, driven) for population in populations]
        self.holds_newest = False

    def give_particles(self):
        """See to it that the simulation's populations are up to date."""
        if self.holds_newest:
            for here, population in zip(self.particles, self.simulation.held_populations, strict=True):
                if len(population.reals):
                    here.reals.copy_to_host(population.reals)
            self.holds_newest = False

    # ---- nodes that there are ----

    def mark(self, marks, slack):
        """Mark the nodes that the particles reach now or `slack` (cells) farther, see kernels.spans."""
        form = FORMATS[np.dtype(self.real)]
        on_card = self.card.to_device(marks)
        for p in self.particles:
            self.launch(
                self.on_card.mark, p.lanes, p.places, p.info, 0, p.blocks, form.whole(self.simulation.geometry.stencil.round),
                form.fraction, form.whole(slack), on_card,
            )  # fmt: skip
        marks[...] = on_card.copy_to_host()

    def take_nodes(self):
        """Take note that the patch has other nodes."""
        patch, simulation = self.patch, self.simulation
        self.row_start = self.card.to_device(patch.row_start)
        self.span_ends = self.card.to_device(np.append(patch.spans[:, 2], 0))
        self.span_offsets = self.card.to_device(np.append(4 * (patch.first_quads[:-1] - patch.spans[:, 1]), 0))
        self.nodes = self.room("nodes")
        self.before = self.room("before") if patch.blends else self.nodes
        self.divergences = self.room("divergences") if patch.f_bar else self.nodes
        self.velocities = self.room("velocities") if patch.f_bar else self.nodes
        self.met = [self.card.to_device(np.ascontiguousarray(wall.met)) for wall in simulation.walls]
        self.images = [(self.card.to_device(images.low), self.card.to_device(images.high)) for images in patch.images]

    def room(self, name):
        """(nodes, 4) reals, kept under this name; larger ones take the place of smaller ones."""
        size = max(4 * self.patch.quads, 4)
        if name not in self.rooms or len(self.rooms[name]) < size:
            self.rooms[name] = self.card.to_device(np.zeros((size + size // 8, 4), self.real))
        return self.rooms[name]

    # ---- a step ----

    def launch(self, kernel, count, *arguments):
        """Run a kernel for so many threads."""
        if count > 0:
            kernel[-(-count // THREADS), THREADS](*arguments)

    def begin(self):
        """Forget the maxima and sums of the step before."""
        self.found = np.zeros(MAXIMA, self.real)  # the maxima as last seen
        self.maxima.copy_to_device(self.found)
        self.failure.copy_to_device(np.full(1, NO_FAILURE))
        if self.simulation.needs.driven:
            for p in self.particles:
                p.works.copy_to_device(np.zeros(max(p.blocks, 1), self.real))

    def clear(self):
        """No impulse and no mass on any node."""
        last = 4 * self.patch.quads
        self.launch(self.on_card.nodes["fill"], last, self.nodes, 0, last, self.real(0))

    def p2g(self, parts, dt, phase):
        """Particles to nodes, by the kernels of a phase: p2g, p2g_before or p2g_divergence. Returns 0: runs are not counted."""
        simulation = self.simulation
        for layers in parts:
            for kernel, p, table in zip(getattr(self.on_card, phase), self.particles, self.tables, strict=True):
                first, last = p.blocks_of(layers)
                self.launch(
                    kernel, LANES * (last - first), p.reals, p.places, p.info, first, last, table, self.row_start,
                    self.span_ends, self.span_offsets, self.patch.rows, self.nodes, self.maxima, p.works, self.real(dt),
                    simulation.dx, simulation.inv_dx, simulation.first_layer, self.real(simulation.time),
                    simulation.drive.factor,
                )  # fmt: skip
        return 0

    def add_apart(self):
        """Nothing is kept apart."""

    @property
    def forces(self):
        """Max |b|^2 of the body force in this step's P2G."""
        return self.maxima.copy_to_host()[FORCE] if self.simulation.needs.body_force is not None else 0.0

    @property
    def works(self):
        """(layers,) J that P2G has put into each layer."""
        return sum(p.by_layer(p.works.copy_to_host()) for p in self.particles)

    @property
    def travelled(self):
        """Cells: the longest way along any axis that a particle has gone in this step."""
        return float(self.found[STEP])

    def shared(self):
        """(first node, last node + 1) of the planes that each message holds the sums of."""
        patch = self.patch
        for _, _, message, low in self.simulation.halo.sums:
            yield 4 * patch.plane_start[low], 4 * patch.plane_start[low + message.planes]

    def give_shared(self):
        """Bring the sums of the shared planes to the host, where the halo finds them."""
        for first, last in self.shared():
            if first < last:
                self.patch.nodes[first:last] = self.nodes[first:last].copy_to_host()

    def take_shared(self):
        """Take the sums that the halo has completed."""
        for first, last in self.shared():
            if first < last:
                self.nodes[first:last].copy_to_device(self.patch.nodes[first:last])

    def update(self, first, last, dt):
        """Momentum to velocity on planes first .. last - 1 of the patch, with gravity, damping, walls and regions."""
        patch, drive, nodes = self.patch, self.simulation.drive, self.nodes
        here = 4 * int(patch.plane_start[first]), 4 * int(patch.plane_start[last])
        count = here[1] - here[0]
        self.sum_images(first, last)
        if drive.has_gravity:
            gain = drive.gravity_gain(dt)[: self.simulation.dim]
            self.launch(self.on_card.nodes["add_gravity"], count, nodes, *here, tuple(gain))
        if drive.damping > 0.0:
            self.launch(self.on_card.nodes["damp"], count, nodes, *here, drive.kept(dt)[0])
        walls = [
            (wall, met, wall.between(first, last)) for wall, met in zip(self.simulation.walls, self.met, strict=True)
        ]
        for wall, met, (begin, end) in walls:
            kernel, velocity = self.on_card.walls[wall.type], tuple(wall.velocity)
            self.launch(kernel, end - begin, nodes, met, begin, end, tuple(wall.normal), wall.coefficient, velocity)
        self.launch(self.on_card.nodes["divide_by_mass"], count, nodes, *here)
        for wall, met, (begin, end) in walls:
            kernel, velocity = self.on_card.images[wall.type], tuple(wall.velocity)
            self.launch(kernel, end - begin, nodes, met, begin, end, tuple(wall.normal), velocity)
        for region in drive.regions:
            plane, number = region.nodes()
            number = np.ascontiguousarray(number[(plane >= first) & (plane < last)])
            velocity = tuple(region.velocity.astype(self.real))
            if len(number):
                self.launch(
                    self.on_card.nodes["impose"], len(number), nodes, self.card.to_device(number), len(number), velocity
                )

    def sum_images(self, first, last):
        for (low, high), images in zip(self.images, self.patch.images, strict=True):
            begin, end = int(images.plane_start[first]), int(images.plane_start[last])
            self.launch(self.on_card.nodes["sum_images"], end - begin, self.nodes, low, high, begin, end)

    def g2p(self, parts, dt):
        """Nodes to particles. Returns the maxima of what is reduced so far, and (law, block, lane, cause) of each law's first
        failure."""
        simulation, failed = self.simulation, []
        for number, (kernel, p, table) in enumerate(zip(self.on_card.g2p, self.particles, self.tables, strict=True)):
            for layers in parts:
                first, last = p.blocks_of(layers)
                self.launch(
                    kernel, LANES * (last - first), p.reals, p.places, p.info, first, last, table, self.row_start,
                    self.span_ends, self.span_offsets, self.patch.rows, self.nodes, self.before, simulation.blend,
                    self.divergences, self.limits, self.ends, dt, simulation.inv_dx, simulation.first_layer, self.maxima,
                    self.failure,
                )  # fmt: skip
            found = int(self.failure.copy_to_host()[0])
            if found != NO_FAILURE:
                place, cause = divmod(found, CAUSES)
                failed.append((number, *divmod(place, LANES), cause))
                self.failure.copy_to_device(np.full(1, NO_FAILURE))
        self.holds_newest = True
        self.found = self.maxima.copy_to_host()
        return self.found[:STEP].astype(np.float64), failed

    def measure_divergence(self, parts):
        """Of the velocities on the nodes, at the particles."""
        for layers in parts:
            for kernel, p in zip(self.on_card.measure_divergence, self.particles, strict=True):
                first, last = p.blocks_of(layers)
                self.launch(
                    kernel, LANES * (last - first), p.reals, p.places, p.info, first, last, self.row_start, self.span_ends,
                    self.span_offsets, self.patch.rows, self.nodes, self.simulation.inv_dx,
                )  # fmt: skip

    def average(self, name):
        """Divide the sums on the nodes by their mass, or volume, and keep what comes out under this name."""
        last = 4 * self.patch.quads
        self.sum_images(0, self.patch.planes)
        self.launch(self.on_card.nodes["divide_by_mass"], last, self.nodes, 0, last)
        self.copy(self.nodes, getattr(self, name))

    def keep_nodes(self):
        """Put the velocities on the nodes aside."""
        self.copy(self.nodes, self.velocities)

    def restore_nodes(self):
        """Take them back."""
        self.copy(self.velocities, self.nodes)

    def copy(self, source, values):
        last = 4 * self.patch.quads
        self.launch(self.on_card.nodes["copy"], last, source, values, last)

    def energies(self, layers):
        """(layers, 3) J kinetic, strain and potential energy of this rank's particles in so many of its layers."""
        simulation, found = self.simulation, np.zeros((layers, 3))
        gravity = tuple(simulation.drive.gravity.astype(self.real))
        for kernel, p, table in zip(self.on_card.sum_energies, self.particles, self.tables, strict=True):
            if not layers or not p.blocks:
                continue
            of_blocks = self.card.to_device(np.zeros((p.blocks, 3), self.real))
            self.launch(
                kernel, p.lanes, p.reals, p.places, p.info, p.blocks, table, simulation.dx, simulation.first_layer, gravity,
                of_blocks,
            )  # fmt: skip
            found += p.by_layer(of_blocks.copy_to_host())
        return found


class OnCard:
    """The particles of one law on the card: reals (blocks, size, 16), places, the same memory as integers, info (blocks, 5)."""

    def __init__(self, population, card, driven):
        self.blocks = len(population.reals)
        self.lanes = LANES * self.blocks
        segment = population.block_segment
        layer = population.segment_layer[segment] - population.first_layer
        info = np.column_stack([layer, population.segments[segment][:, 2:5], population.block_count]).astype(np.int64)
        self.block_layer, self.layers = layer, len(population.layer_start) - 1
        starts = np.append(population.segments[:, 0], self.blocks)
        self.layer_blocks = starts[population.layer_start]
        self.info = copied(np.ascontiguousarray(info), card)
        self.reals = copied(np.ascontiguousarray(population.reals), card)
        self.places = as_integers(self.reals)
        works = max(self.blocks, 1) if driven else 1  # J, by block
        self.works = card.to_device(np.zeros(works, population.reals.dtype))

    def blocks_of(self, layers):
        """(first, last + 1) blocks of a range of layers."""
        first, last = layers
        return int(self.layer_blocks[first]), int(self.layer_blocks[last])

    def by_layer(self, of_blocks):
        """(layers, ...) float64 sums of what each block has."""
        found = np.zeros((self.layers, *of_blocks.shape[1:]))
        if self.blocks:
            np.add.at(found, self.block_layer, of_blocks[: self.blocks])
        return found


def copied(array, card):
    """A copy on the card; of nothing, one row that nobody reads."""
    return card.to_device(array if len(array) else np.zeros((1, *array.shape[1:]), array.dtype))


def as_integers(reals):
    """The same memory as integers."""
    integer = FORMATS[reals.dtype].integer
    if hasattr(reals, "_ary"):  # simulated: a view would be an array of the host, which kernels are given copies of
        return type(reals)(reals._ary.view(integer))
    return reals.view(integer)


def with_last_axis(table):
    return np.ascontiguousarray(table[:, :, None])
