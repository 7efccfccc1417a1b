"""What a rank does in a step, on threads of its processor: particles to nodes, nodes, nodes to particles.

A processor knows no order of a step; `Simulation` does. The same verbs for graphics cards: processors.cuda.
"""

import numpy as np

from pmpm.kernels import build
from pmpm.kernels.loops import FORCES, WORKS
from pmpm.kernels.places import FORMATS
from pmpm.parallel.halo import zeros
from pmpm.parallel.parts import Crew, pieces
from pmpm.scene.needs import open_faces
from pmpm.state.assembly import Assembly, leaving, take_beyond
from pmpm.state.derived import PARAMETERS
from pmpm.state.grid import SLACK

FORCE = 4  # of the maxima: after those that G2P returns, speed^2, wave speed^2, drift, |dt grad v|^2
WORTH_SHARING = 1 << 15  # nodes: to clear fewer takes no longer than to wake a thread


class Cpu:
    """The processor of one rank of a simulation. P2G and G2P go through `parts`, ranges (first, last + 1) of its layers."""

    name = "cpu"
    ordered = True  # whether sums are those of all layers in their order
    queues = False  # whether what is asked for is done later
    direct = False  # whether messages lie in the memory of graphics cards
    slack = SLACK
    host_room = staticmethod(zeros)  # for messages

    def __init__(self, simulation, threads):
        self.simulation, self.crew = simulation, Crew(threads)
        self.real, self.tables = simulation.real, [table.astype(simulation.real) for table in simulation.tables]
        counts = [table.shape[1] - PARAMETERS for table in self.tables]
        fields = [law.velocity_field for law in simulation.needs.laws]
        # Of each law its velocity field, and whether it is the last one there, which folds.
        self.fields = [(field, field != after) for field, after in zip(fields, [*fields[1:], -1], strict=True)]
        self.kernels = build.build(simulation.needs, simulation.layouts, counts, build.chosen_loops(), threads)
        self.extremes = np.zeros(FORCE + 1)  # maxima of the step: those of G2P, and |b|^2 of the body force
        self.gone: list = []
        self.failed: list[tuple[int, int, int, int]] = []  # (law, block, lane, cause) in this step, first of each range

    @property
    def threads(self):
        return self.crew.threads

    @property
    def patch(self):
        return self.simulation.patch

    @property
    def populations(self):
        return self.simulation.populations

    # ---- set-up ----

    def take_patch(self):
        """Take note that the simulation has a new patch and halo."""
        self.kept_by_halo = len(self.patch.apart)
        self.works = np.zeros(self.patch.layers)  # J that P2G has put into each layer
        self.steps = np.zeros(self.threads)  # the largest in cells that each thread has seen

    def take_parts(self):
        """Take note of the parts that the layers are done in: what threads have to keep apart."""
        del self.patch.apart[self.kept_by_halo :]
        self.apart = self.patch.keep_apart(list(self.simulation.parts.apart))

    def warm_up(self):
        """Compile all kernels, or load them, by calling them on nothing. The nodes have been laid out."""
        needs, kernels, nothing = self.simulation.needs, self.kernels, [(0, 0)]
        if needs.scheme.blends:
            self.p2g(nothing, 0.0, "p2g_before")
        if needs.contact:
            self.p2g(nothing, 0.0, "p2g_volumes")
        if needs.f_bar:
            self.p2g(nothing, 0.0, "p2g_divergence")
            self.measure_divergence(nothing)
        self.p2g(nothing, 0.0, "p2g")
        self.update_planes((0, 0), 0.0)
        self.g2p(nothing, self.real(0))
        self.begin()
        if self.simulation.slabs.cuts or len(self.apart):
            self.simulation.halo.warm_up()
        for obstacle in self.simulation.drive.obstacles:
            self.simulation.drive.contact(obstacle)
            self.collide(obstacle, self.patch.nodes[0], 0, 0)
        none, normal, met = self.real(0), np.zeros(needs.dim, self.real), np.zeros((0, 5), np.int64)
        for wall, image in zip(kernels.walls.values(), kernels.images.values(), strict=True):
            wall(self.patch.nodes[0], met, 0, 0, normal, none, normal)
            image(self.patch.nodes[0], met, 0, 0, normal, normal)
        if "mirror_volumes" in build.contact_entries(needs):
            kernels.mirror_volumes(self.patch.nodes[0], met, 0, 0, normal)

    def take_particles(self):
        """Take note that the simulation holds other particles, or has ordered them anew."""

    def give_particles(self):
        """See to it that the simulation's populations are up to date."""

    # ---- a regroup ----

    def take_leaving(self, edges):
        """(Cloud, whether each comes before those of the layer that it goes to) of each law's particles that do not stay when
        cuts are at these edges. `settle_in` follows. Where faces are open, `gone` has a Cloud of those who have left."""
        simulation = self.simulation
        if simulation.needs.open:
            opened = open_faces(simulation.scene)
            self.gone = [take_beyond(p, simulation.geometry, self.kernels, opened) for p in simulation.held_populations]
        first, last = edges[simulation.comm.rank], edges[simulation.comm.rank + 1]
        found = [leaving(p, simulation.geometry, self.kernels, first, last) for p in simulation.held_populations]
        self.staying = [of_law.staying for of_law in found]
        slab = simulation.geometry.axes[0]
        return [of_law.others for of_law in found], [of_law.layer < of_law.others.node[:, slab] for of_law in found]

    def settle_in(self, edges, arrived):
        """Order the particles of each law in the layers that `edges` give this rank: those who stay and those who arrive."""
        simulation, populations = self.simulation, self.simulation.held_populations
        first, last = edges[simulation.comm.rank], edges[simulation.comm.rank + 1]
        for law, layout in enumerate(simulation.layouts):
            populations[law] = Assembly(
                populations[law], self.staying[law], arrived[law], simulation.geometry, self.kernels, first, last - first,
                len(simulation.scene.sources), simulation.pad_values(layout),
            ).whole(self.crew)  # fmt: skip
            arrived[law] = None

    # ---- nodes that there are ----

    def mark(self, marks, slack):
        """Mark the nodes that the particles reach now or `slack` (cells) farther, see kernels.spans."""
        geometry, form = self.simulation.geometry, FORMATS[np.dtype(self.real)]

        def mark_layers(layers, _):
            for p in self.populations:
                self.kernels.mark_cells(
                    p.places, p.segments, p.layer_start, *layers, geometry.axes[1], geometry.axes[2],
                    form.whole(geometry.stencil.round), form.fraction, form.whole(slack), marks,
                )  # fmt: skip

        parts = self.simulation.parts
        self.crew.share(mark_layers, [*parts.edges, *parts.inner])

    def take_nodes(self):
        """Take note that the patch has other nodes."""

    # ---- a step ----

    def begin(self):
        """Forget the maxima and sums of the step before."""
        self.kernels.scratch[:, FORCES:WORKS] = 0.0
        self.works[:] = 0.0
        self.steps[:] = 0.0
        self.extremes[:] = 0.0
        self.failed.clear()

    def clear(self):
        """No impulse and no mass on any node."""
        nodes = self.patch.nodes.reshape(-1, 4)
        self.crew.share(
            lambda part, _: nodes[slice(*part)].fill(0.0), pieces(0, len(nodes), self.threads, WORTH_SHARING)
        )

    def p2g(self, parts, dt, phase):
        """Particles to nodes, by the kernels of a phase: p2g, p2g_before, p2g_volumes or p2g_divergence. Returns the number of
        runs of particles with the same stencil."""
        kernels = getattr(self.kernels, phase)
        return sum(self.crew.share(lambda part, thread: self.p2g_layers(part, thread, dt, kernels), parts))

    def p2g_layers(self, layers, thread, dt, p2g):
        runs, patch, kernels, simulation = 0, self.patch, self.kernels, self.simulation
        first, last = layers
        for begin in range(first, max(last, first + 1), patch.chunk):
            end = min(begin + patch.chunk, last)
            for number, (kernel, p) in enumerate(zip(p2g, self.populations, strict=True)):
                field, folds = self.fields[number]
                runs += kernel(
                    p.reals, p.places, p.segments, p.layer_start, begin, end, self.tables[number],
                    patch.windows[thread], patch.corner, folds, patch.placed, patch.placed_start, patch.slots,
                    patch.nodes[field], patch.unsummed[field], kernels.scratch[thread], kernels.first_nodes[thread],
                    kernels.constants, self.real(dt), simulation.dx, simulation.inv_dx, simulation.first_layer,
                    self.real(simulation.time), simulation.drive.factor, self.works,
                )  # fmt: skip
        return runs

    def add_apart(self):
        """Add what threads have kept apart for those before them."""
        if len(self.apart):
            self.patch.add_apart(self.kernels, self.apart)

    @property
    def travelled(self):
        """Cells: the longest way along any axis that a particle has gone in this step."""
        return self.steps.max()

    def give_shared(self):
        """Begin to write the sums of the shared planes into the halo's messages."""
        self.simulation.halo.pack()

    def wait_shared(self):
        """See to it that they are written."""

    def take_shared(self):
        """Complete the sums of the shared planes with what has come."""
        self.simulation.halo.finish()

    def update(self, first, last, dt):
        """`update_planes` by all threads: walls couple nodes of a few planes, which one thread does."""
        drive = self.simulation.drive
        for region in drive.regions:
            region.nodes()  # once, before threads ask
        for obstacle in drive.obstacles:
            drive.contact(obstacle)
        ranges = pieces(first, last, self.threads, self.simulation.needs.stencil.window)
        self.crew.share(lambda planes, thread: self.update_planes(planes, dt), ranges)

    def update_planes(self, planes, dt):
        """Momentum to velocity on a range of planes of the patch, with gravity, damping, colliders, walls and regions."""
        patch, drive, (first, last) = self.patch, self.simulation.drive, planes
        quads = patch.plane_start[first], patch.plane_start[last]
        for nodes in patch.nodes:
            for images in patch.images:
                images.sum(nodes, first, last)
            if drive.has_gravity:
                self.kernels.add_gravity(nodes, *quads, drive.gravity_gain(dt))
            if drive.damping > 0.0:
                self.kernels.damp(nodes, *quads, drive.kept(dt))
        if patch.fields > 1:
            self.touch(*quads)
        for nodes in patch.nodes:
            self.hold(nodes, planes, quads)

    def hold(self, nodes, planes, quads):
        """Momentum to velocity of one field: what colliders, walls and regions make of it."""
        drive = self.simulation.drive
        for obstacle in drive.obstacles:
            self.collide(obstacle, nodes, *drive.contact(obstacle).between(*planes))
        here = [(wall, wall.between(*planes)) for wall in self.simulation.walls]
        for wall, part in here:
            self.kernels.walls[wall.type](nodes, wall.met, *part, wall.normal, wall.coefficient, wall.velocity)
        self.kernels.divide_by_mass(nodes, *quads)
        for wall, part in here:
            self.kernels.images[wall.type](nodes, wall.met, *part, wall.normal, wall.velocity)
        for region in drive.regions:
            region.impose(nodes, *planes)

    def touch(self, first, last):
        """What bodies of different velocity fields do to each other on some quads."""
        patch, contact = self.patch, self.simulation.drive.touching
        self.kernels.touch(
            patch.nodes, patch.volumes, contact.room, contact.pairs, contact.frictions, 4 * first, 4 * last
        )

    def collide(self, obstacle, nodes, first, last):
        """What the surface of a collider does to the momenta of some of its nodes."""
        contact, given = obstacle.contact, np.zeros(obstacle.parts, np.int64)
        self.kernels.colliders[obstacle.type](
            nodes, contact.numbers, first, last, contact.normals, contact.velocities, contact.arms,
            contact.counted, obstacle.coefficient, obstacle.per_unit, obstacle.per_reach, given,
        )  # fmt: skip
        obstacle.found.append(given)

    def g2p(self, parts, dt):
        """Nodes to particles."""
        for found, failures in self.crew.share(lambda part, thread: self.g2p_layers(part, thread, dt), parts):
            np.maximum(self.extremes[:FORCE], found, out=self.extremes[:FORCE])
            self.failed += failures

    def collect(self):
        """Have `extremes`, `works` and `travelled` of this step ready. Returns, of each failure, (law, block, lane, cause)."""
        self.extremes[FORCE] = self.kernels.scratch[:, FORCES:WORKS].max()
        return self.failed

    def g2p_layers(self, layers, thread, dt):
        patch, kernels, simulation = self.patch, self.kernels, self.simulation
        extremes, failed = np.zeros(FORCE), []
        for number, (kernel, p) in enumerate(zip(kernels.g2p, self.populations, strict=True)):
            failure, (field, _) = np.zeros(3, np.int64), self.fields[number]
            *found, step = kernel(
                p.reals, p.places, p.segments, p.layer_start, *layers, self.tables[number], patch.nodes[field],
                patch.before[field], simulation.blend, patch.divergences[field], patch.spans, patch.row_start,
                patch.first_quads, patch.corner, patch.rings[thread], simulation.first_layer, simulation.limits,
                simulation.ends, kernels.scratch[thread], kernels.first_nodes[thread], kernels.constants, dt, simulation.dx,
                simulation.inv_dx, failure,
            )  # fmt: skip
            np.maximum(extremes, found, out=extremes)
            self.steps[thread] = max(self.steps[thread], step)
            if failure[0]:
                cause, block, lane = map(int, failure)
                failed.append((number, block, lane, cause))
        return extremes, failed

    def measure_divergence(self, parts):
        """Of the velocities on the nodes, at the particles."""
        self.crew.share(self.measure_layers, parts)

    def measure_layers(self, layers, thread):
        kernels, patch = self.kernels, self.patch
        for (field, _), kernel, p in zip(self.fields, kernels.measure_divergence, self.populations, strict=True):
            kernel(
                p.reals, p.places, p.segments, p.layer_start, *layers, patch.nodes[field], patch.spans, patch.row_start,
                patch.first_quads, patch.corner, patch.rings[thread], kernels.scratch[thread],
                kernels.first_nodes[thread], kernels.constants, self.simulation.inv_dx,
            )  # fmt: skip

    def average(self, name):
        """Divide the sums on the nodes by their mass, or volume, and keep what comes out as the patch's `name`."""
        patch = self.patch
        for nodes in patch.nodes:
            for images in patch.images:
                images.sum(nodes, 0, patch.planes)
            self.kernels.divide_by_mass(nodes, 0, patch.quads)
        getattr(patch, name)[:] = patch.nodes

    def keep_volumes(self):
        """Keep the sums of volumes and their gradients on the nodes, with what walls mirror, as the patch's `volumes`."""
        patch = self.patch
        patch.volumes[:] = patch.nodes
        for volumes in patch.volumes:
            for images in patch.images:
                images.sum(volumes, 0, patch.planes)
            for wall in self.simulation.walls:
                self.kernels.mirror_volumes(volumes, wall.met, 0, len(wall.met), wall.normal)

    def keep_nodes(self):
        """Put the velocities on the nodes aside."""
        self.patch.velocities[:] = self.patch.nodes

    def restore_nodes(self):
        """Take them back."""
        self.patch.nodes[:] = self.patch.velocities

    def energies(self, layers):
        """(layers, 3) J kinetic, strain and potential energy of this rank's particles in so many of its layers."""
        simulation = self.simulation
        found, gravity = np.zeros((layers, 3)), simulation.drive.gravity.astype(self.real)
        for kernel, p, table in zip(self.kernels.sum_energies, self.populations, self.tables, strict=True):
            kernel(
                p.reals, p.places, p.segments, p.layer_start, layers, table, simulation.dx, simulation.first_layer, gravity,
                found,
            )  # fmt: skip
        return found
