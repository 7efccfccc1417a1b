"""What a rank does in a step, on a graphics card: the verbs of processors.cpu.

Particles and nodes stay on the card from step to step and over regroups. The simulation's populations follow when somebody on
the host asks for them (files, measurements). Kernels run one after another on one stream; the shared planes come and go on
another one, while the kernels of the other layers run. The host waits for the shared planes and, once, for what the step has
found.
"""

from typing import Any

import numpy as np
from numba import cuda

from pmpm.kernels import build, build_cuda
from pmpm.kernels.cuda_loops import CAUSES, FORCE, MAXIMA, NO_FAILURE, STEP
from pmpm.kernels.places import FORMATS
from pmpm.kernels.scalar_loops import FIELD_TUPLES
from pmpm.parallel.halo import node_numbers, zeros
from pmpm.parallel.parts import Crew
from pmpm.processors.on_card import OnCard
from pmpm.scene.errors import SceneError
from pmpm.state.derived import PARAMETERS
from pmpm.state.memory import Scratch
from pmpm.state.particles import LANES

FARTHEST_NUMBER = 1 << 31  # of nodes that 32 bits can count


class Cuda:
    """The graphics card of one rank of a simulation."""

    name, threads, ordered, queues = "cuda", 1, False, True
    slack = 1.0  # cells; the host lays nodes out, and on a card few more of them cost less than that

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
        self.kernels = build.build(simulation.needs, simulation.layouts, counts, "scalar")  # layouts, files
        self.on_card = build_cuda.build(simulation.needs, simulation.layouts, counts, self.tiled)
        self.stream, self.copies = self.card.stream(), self.card.stream()
        self.summed, self.arrived = self.card.event(), self.card.event()
        self.memory = Scratch(self.card.device_array)
        self.being_read: list = []  # arrays of the host that the card may not have copied yet
        self.host_rooms: list = []  # for messages, and how many of them the patch has got
        self.given = 0
        self.direct = simulation.comm.reaches_cards()
        laws = len(simulation.needs.laws)
        self.fields = [law.velocity_field for law in simulation.needs.laws]
        self.of_all_fields: dict[
            str, Any
        ] = {}  # arrays of nodes (fields, nodes, 4) by name; of each field a view is kept, too
        self.tables = [self.card.to_device(with_last_axis(table.astype(self.real))) for table in simulation.tables]
        self.limits, self.ends = self.card.to_device(simulation.limits), self.card.to_device(simulation.ends)
        self.maxima = self.card.device_array(MAXIMA, self.real)
        self.failure = self.card.device_array(laws, np.int64)
        self.found = self.card.pinned_array(MAXIMA, self.real)
        self.failures = self.card.pinned_array(laws, np.int64)
        self.particles: list[OnCard] = []
        self.holds_newest = False  # whether the card's particles are newer than the simulation's
        self.works = 0.0
        self.given_to: dict[str, Any] = {}  # by collider, on the card: what it has been given in this step

    @property
    def patch(self):
        return self.simulation.patch

    # ---- between host and card ----

    def launch(self, kernel, count, *arguments):
        """Run a kernel for so many threads."""
        if count > 0:
            threads = self.on_card.threads
            kernel[-(-count // threads), threads, self.stream](*arguments)

    def send(self, here, there):
        """Copy an array to the card. It is read some time before the host waits for the card the next time."""
        there.copy_to_device(here, stream=self.stream)
        self.being_read.append(here)

    def bring(self, there, here):
        """Copy an array from the card."""
        there.copy_to_host(here, stream=self.stream)
        self.wait()

    def wait(self):
        """Wait until all that has been asked for is done."""
        self.stream.synchronize()
        self.being_read.clear()

    def brought(self, there):
        """A copy of an array of the card."""
        here = np.zeros(there.shape, there.dtype)
        self.bring(there, here)
        return here

    def kept(self, name, values, dtype=None):
        """An array on the card with these values, under this name; larger ones take the place of smaller ones."""
        values = np.ascontiguousarray(values, dtype)
        there = self.memory.array(name, (max(len(values), 1), *values.shape[1:]), values.dtype)
        if values.size:
            self.send(values, there)
        return there

    def counter(self):
        """A number on the card that is zero."""
        return self.kept("counter", np.zeros(1, np.int32))

    def count_of(self, counter):
        return int(self.brought(counter)[0])

    def host_room(self, size):
        """So many bytes of the host, which the card reads and writes without a detour: those of an earlier patch if they are
        enough. Where messages go from card to card the host has little to send."""
        if self.direct:
            return zeros(size)
        if self.given == len(self.host_rooms):
            self.host_rooms.append(np.zeros(0, np.uint8))
        if len(self.host_rooms[self.given]) < size:
            self.host_rooms[self.given] = self.card.pinned_array(size + size // 8, np.uint8)
        self.given += 1
        return self.host_rooms[self.given - 1][:size]

    @property
    def nbytes(self):
        """Bytes that this rank holds on the card."""
        held = [*self.memory.kept.values(), *(array for p in self.particles for array in (p.reals, p.id, p.info))]
        return sum(array.nbytes for array in held)

    # ---- set-up ----

    def take_patch(self):
        """Take note that the halo has got its messages; nodes are taken when they are laid out."""
        self.given = 0

    def take_parts(self):
        """Nothing to do: nothing is kept apart."""

    def warm_up(self):
        """Nothing to do: kernels are compiled, or loaded, when they are first called."""

    def take_particles(self):
        """Take the particles of the simulation, unless nobody has seen them since the card has changed them."""
        populations = self.simulation.held_populations
        if len(self.particles) != len(populations):
            self.particles = [OnCard(self, law) for law in range(len(populations))]
        for here, population in zip(self.particles, populations, strict=True):
            if not (self.holds_newest and population is here.population):
                here.take(population)
                self.holds_newest = False
        self.wait()  # who called may go on writing to them

    def give_particles(self):
        """See to it that the simulation's populations are up to date."""
        if self.holds_newest:
            for here in self.particles:
                here.give()
            self.holds_newest = False

    # ---- a regroup ----

    def take_leaving(self, edges):
        """(Cloud, whether each comes before those of the layer that it goes to) of each law's particles that do not stay when
        cuts are at these edges. `settle_in` follows."""
        rank = self.simulation.comm.rank
        clouds = [here.take_leaving(edges[rank], edges[rank + 1]) for here in self.particles]
        self.gone = [here.gone for here in self.particles]
        return clouds, [np.ones(len(cloud), bool) for cloud in clouds]

    def settle_in(self, edges, arrived):
        """Order the particles of each law in the layers that `edges` give this rank: those who stay and those who arrive."""
        populations = [here.settle_in(of_law.cloud) for here, of_law in zip(self.particles, arrived, strict=True)]
        self.simulation.held_populations = populations
        self.holds_newest = True

    # ---- nodes that there are ----

    def mark(self, marks, slack):
        """Mark the nodes that the particles reach now or `slack` (cells) farther, see kernels.spans."""
        form, size = FORMATS[np.dtype(self.real)], max(marks.size, 1)
        there = self.memory.array("marks", (size,), np.uint32)
        self.launch(self.on_card.clear_words, size, there, size)
        for p in self.particles:
            self.launch(
                self.on_card.mark, p.lanes, p.places, p.info, 0, p.blocks, form.whole(self.simulation.geometry.stencil.round),
                form.fraction, form.whole(slack), there, marks.shape[1], marks.shape[2],
            )  # fmt: skip
        if marks.size:
            self.bring(there, marks.reshape(-1))

    def take_nodes(self):
        """Take note that the patch has other nodes."""
        patch, simulation = self.patch, self.simulation
        few = np.int32 if 4 * patch.quads < FARTHEST_NUMBER else np.int64
        self.row_start = self.kept("row start", patch.row_start, np.int32)
        self.span_ends = self.kept("span ends", patch.spans[:, 2], np.int32)
        self.span_offsets = self.kept("span offsets", 4 * (patch.first_quads[:-1] - patch.spans[:, 1]), few)
        self.nodes = self.room("nodes")
        self.before = self.room("before") if patch.blends else self.nodes
        self.divergences = self.room("divergences") if patch.f_bar else self.nodes
        self.velocities = self.room("velocities") if patch.f_bar else self.nodes
        self.volumes = self.room("volumes") if patch.fields > 1 else self.nodes
        self.met = [self.kept(("met", n), wall.met) for n, wall in enumerate(simulation.walls)]
        self.images = [
            (self.kept(("low", n), images.low), self.kept(("high", n), images.high))
            for n, images in enumerate(patch.images)
        ]
        self.take_messages()

    def room(self, name):
        """(nodes, 4) reals of each velocity field, kept under this name; larger ones take the place of smaller ones."""
        size, fields = max(4 * self.patch.quads, 4), self.patch.fields
        self.of_all_fields[name] = array = self.memory.array(name, (fields, size, 4), self.real)
        return [array[field] for field in range(fields)]

    # ---- shared planes ----

    def take_messages(self):
        """Take note of which nodes the halo sends, and where what comes will lie."""
        halo, patch = self.simulation.halo, self.patch
        self.outgoing: list[tuple[Any, Any]] = []  # (what the card sends, where in the host it goes)
        sent = []  # of each message what the card sends, by velocity field
        for number, (_, _, message, low) in enumerate(halo.sums):
            first, last = 4 * patch.plane_start[low], 4 * patch.plane_start[low + message.planes]
            sent.append([nodes[first:last] if first < last else nodes[:0] for nodes in self.nodes])
            rooms = [room for room, _ in halo.outgoing[number * patch.fields : (number + 1) * patch.fields]]
            if first < last or self.direct:
                self.outgoing += zip(sent[-1], rooms, strict=True)
        self.incoming = [
            Incoming(message, planes, [self.incoming_room(n, field, message) for field in range(patch.fields)])
            for n, (_, _, message, planes, _) in enumerate((*halo.as_earlier, *halo.as_later))
        ]
        if self.direct:
            halo.ready(
                [list(map(for_mpi, of_fields)) for of_fields in sent],
                [list(map(for_mpi, incoming.values)) for incoming in self.incoming],
            )

    def incoming_room(self, number, field, message):
        return self.memory.array(("incoming", number, field), (max(message.most, 1), 4), self.real)

    def give_shared(self):
        """Begin to bring the sums of the shared planes to the halo's messages, behind what has been asked for so far."""
        self.summed.record(self.stream)
        if not self.direct:
            self.summed.wait(self.copies)
            for there, here in self.outgoing:
                there.copy_to_host(here, stream=self.copies)

    def wait_shared(self):
        """See to it that they are there."""
        if self.outgoing:
            (self.summed if self.direct else self.copies).synchronize()

    def take_shared(self):
        """Complete the sums of the shared planes with what has come."""
        for number, incoming in enumerate(self.incoming):
            if incoming.is_new():
                incoming.numbers = self.kept(("numbers", number), incoming.numbers_in(self.patch), np.int64)
                incoming.copy = incoming.ends()
            if incoming.count and not self.direct:
                for here, there in incoming.copy:
                    there.copy_to_device(here, stream=self.copies)
        if not self.direct:
            self.arrived.record(self.copies)
            self.arrived.wait(self.stream)
        for incoming in self.incoming:
            for nodes, values in zip(self.nodes, incoming.values, strict=True):
                self.launch(
                    self.on_card.nodes["add_received"], incoming.count, nodes, values, incoming.numbers, incoming.count
                )

    # ---- a step ----

    def begin(self):
        """Forget the maxima and sums of the step before."""
        self.launch(self.on_card.forget, 1, self.maxima, self.failure, len(self.failures))
        if self.simulation.needs.driven:
            for p in self.particles:
                self.launch(self.on_card.clear_reals, p.blocks, p.works, p.blocks)

    def clear(self):
        """No impulse and no mass on any node."""
        last = 4 * self.patch.quads
        for nodes in self.nodes:
            self.launch(self.on_card.nodes["clear"], last, nodes, last)

    def p2g(self, parts, dt, phase):
        """Particles to nodes, by the kernels of a phase, see processors.cpu. Returns 0: runs are not counted."""
        simulation = self.simulation
        for layers in parts:
            of_laws = zip(getattr(self.on_card, phase), self.particles, self.tables, self.fields, strict=True)
            for kernel, p, table, field in of_laws:
                first, last = p.blocks_of(layers)
                self.launch(
                    kernel, LANES * (last - first), p.reals, p.places, p.info, first, last, table, self.row_start,
                    self.span_ends, self.span_offsets, self.patch.rows, self.nodes[field], self.maxima, p.works, self.real(dt),
                    simulation.dx, simulation.inv_dx, simulation.first_layer, self.real(simulation.time),
                    simulation.drive.factor,
                )  # fmt: skip
        return 0

    def add_apart(self):
        """Nothing is kept apart."""

    def update(self, first, last, dt):
        """Momentum to velocity on planes first .. last - 1 of the patch, with gravity, damping, walls and regions."""
        patch, drive = self.patch, self.simulation.drive
        here = 4 * int(patch.plane_start[first]), 4 * int(patch.plane_start[last])
        count = here[1] - here[0]
        for nodes in self.nodes:
            self.sum_images(nodes, first, last)
            if drive.has_gravity:
                gain = drive.gravity_gain(dt)[: self.simulation.dim]
                self.launch(self.on_card.nodes["add_gravity"], count, nodes, *here, tuple(gain))
            if drive.damping > 0.0:
                self.launch(self.on_card.nodes["damp"], count, nodes, *here, drive.kept(dt)[0])
        if patch.fields > 1:
            self.touch(here)
        for nodes in self.nodes:
            self.hold(nodes, first, last, here)

    def touch(self, here):
        """What bodies of different velocity fields do to each other on nodes here[0] .. here[1] - 1."""
        touching, arrays = self.simulation.drive.touching, self.of_all_fields
        pairs, frictions = self.kept("pairs", touching.pairs), self.kept("frictions", touching.frictions)
        self.launch(
            self.on_card.nodes["touch"], here[1] - here[0], arrays["nodes"], arrays["volumes"], touching.room, pairs, frictions,
            *here,
        )  # fmt: skip

    def hold(self, nodes, first, last, here):
        """Momentum to velocity of one field on planes first .. last - 1: what colliders, walls and regions make of it."""
        drive, count = self.simulation.drive, here[1] - here[0]
        for obstacle in drive.obstacles:
            self.collide(obstacle, nodes, *drive.contact(obstacle).between(first, last))
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
        for at, region in enumerate(drive.regions):
            plane, number = region.nodes()
            number = number[(plane >= first) & (plane < last)]
            if len(number):
                there, velocity = self.kept(("region", at, first), number), tuple(region.velocity.astype(self.real))
                kernel = self.on_card.nodes["impose"]
                self.launch(kernel, len(number), nodes, there, len(number), velocity, region.whole)

    def collide(self, obstacle, nodes, first, last):
        """What the surface of a collider does to the momenta of some of its nodes."""
        contact = obstacle.contact
        if contact.on_card is None:
            arrays = contact.numbers, contact.normals, contact.velocities, contact.arms, contact.counted
            contact.on_card = [self.kept((obstacle.name, n), array) for n, array in enumerate(arrays)]
        if obstacle.name not in self.given_to:
            self.given_to[obstacle.name] = self.card.to_device(np.zeros(obstacle.parts, np.int64))
        numbers, normals, velocities, arms, counted = contact.on_card
        self.launch(
            self.on_card.colliders[obstacle.type], last - first, nodes, numbers, first, last, normals, velocities, arms,
            counted, obstacle.coefficient, obstacle.per_unit, obstacle.per_reach, self.given_to[obstacle.name],
        )  # fmt: skip

    def sum_images(self, nodes, first, last):
        for (low, high), images in zip(self.images, self.patch.images, strict=True):
            begin, end = int(images.plane_start[first]), int(images.plane_start[last])
            self.launch(self.on_card.nodes["sum_images"], end - begin, nodes, low, high, begin, end)

    def g2p(self, parts, dt):
        """Nodes to particles."""
        simulation = self.simulation
        for law, (kernel, p, table) in enumerate(zip(self.on_card.g2p, self.particles, self.tables, strict=True)):
            field = self.fields[law]
            for layers in parts:
                first, last = p.blocks_of(layers)
                self.launch(
                    kernel, LANES * (last - first), p.reals, p.places, p.info, first, last, table, self.row_start,
                    self.span_ends, self.span_offsets, self.patch.rows, self.nodes[field], self.before[field],
                    simulation.blend, self.divergences[field], self.limits, self.ends, dt, simulation.inv_dx,
                    simulation.first_layer, self.maxima, self.failure, law,
                )  # fmt: skip
        self.holds_newest = True

    def collect(self):
        """Have `extremes`, `works` and `travelled` of this step ready. Returns (law, block, lane, cause) of each law's first
        failure."""
        self.maxima.copy_to_host(self.found, stream=self.stream)
        self.failure.copy_to_host(self.failures, stream=self.stream)
        if self.simulation.needs.driven:
            self.works = sum(p.by_layer(self.brought(p.works)) for p in self.particles)
        for obstacle in self.simulation.drive.obstacles:
            if obstacle.name in self.given_to:
                given = self.given_to[obstacle.name]
                obstacle.found.append(self.brought(given))
                self.send(np.zeros(obstacle.parts, np.int64), given)
        self.wait()
        failed = []
        for law, found in enumerate(map(int, self.failures)):
            if found != NO_FAILURE:
                place, cause = divmod(found, CAUSES)
                failed.append((law, *divmod(place, LANES), cause))
        return failed

    @property
    def extremes(self):
        """Maxima of the step: those of G2P, and |b|^2 of the body force."""
        return self.found[: FORCE + 1].astype(np.float64)

    @property
    def travelled(self):
        """Cells: the longest way along any axis that a particle has gone in this step."""
        return float(self.found[STEP])

    def measure_divergence(self, parts):
        """Of the velocities on the nodes, at the particles."""
        for layers in parts:
            for kernel, p, field in zip(self.on_card.measure_divergence, self.particles, self.fields, strict=True):
                first, last = p.blocks_of(layers)
                self.launch(
                    kernel, LANES * (last - first), p.reals, p.places, p.info, first, last, self.row_start, self.span_ends,
                    self.span_offsets, self.patch.rows, self.nodes[field], self.simulation.inv_dx,
                )  # fmt: skip

    def average(self, name):
        """Divide the sums on the nodes by their mass, or volume, and keep what comes out under this name."""
        last = 4 * self.patch.quads
        for nodes in self.nodes:
            self.sum_images(nodes, 0, self.patch.planes)
            self.launch(self.on_card.nodes["divide_by_mass"], last, nodes, 0, last)
        self.copy(self.nodes, getattr(self, name))

    def keep_volumes(self):
        """Keep the sums of volumes and their gradients on the nodes, with what walls mirror."""
        self.copy(self.nodes, self.volumes)
        for volumes in self.volumes:
            self.sum_images(volumes, 0, self.patch.planes)
            for wall, met in zip(self.simulation.walls, self.met, strict=True):
                count, normal = len(wall.met), tuple(wall.normal)
                self.launch(self.on_card.nodes["mirror_volumes"], count, volumes, met, 0, count, normal)

    def keep_nodes(self):
        """Put the velocities on the nodes aside."""
        self.copy(self.nodes, self.velocities)

    def restore_nodes(self):
        """Take them back."""
        self.copy(self.velocities, self.nodes)

    def copy(self, source, values):
        last = 4 * self.patch.quads
        for one, other in zip(source, values, strict=True):
            self.launch(self.on_card.nodes["copy"], last, one, other, last)

    def energies(self, layers):
        """(layers, 3) J kinetic, strain and potential energy of this rank's particles in so many of its layers."""
        simulation, found = self.simulation, np.zeros((layers, 3))
        gravity = tuple(simulation.drive.gravity.astype(self.real))
        for kernel, p, table in zip(self.on_card.sum_energies, self.particles, self.tables, strict=True):
            if not layers or not p.blocks:
                continue
            of_blocks = self.memory.array("energies", (p.blocks * 3,), self.real)
            self.launch(self.on_card.clear_reals, 3 * p.blocks, of_blocks, 3 * p.blocks)
            of_blocks = of_blocks.reshape(p.blocks, 3)
            self.launch(
                kernel, p.lanes, p.reals, p.places, p.info, p.blocks, table, simulation.dx, simulation.first_layer, gravity,
                of_blocks,
            )  # fmt: skip
            found += p.by_layer(self.brought(of_blocks))
        return found


class Incoming:
    """A message's nodes on their way into a patch: `numbers` of the patch's nodes that they belong to, -1 for none; `values`:
    room for them, of each velocity field; both on the card."""

    def __init__(self, message, planes, values):
        self.message, self.planes, self.values = message, planes, values
        self.head, self.count, self.numbers = b"", 0, None
        self.copy: Any = None  # see `ends`

    def is_new(self):
        """Whether the message has other nodes than the last one had."""
        head = self.message.head.tobytes()
        changed, self.head = head != self.head, head
        return changed

    def ends(self):
        """[(where the message has the sums, where they go on the card)], of each velocity field."""
        firsts = [self.message.told(field) for field in range(len(self.values))]
        here = [self.message.reals[first : first + 4 * self.count].reshape(-1, 4) for first in firsts]
        return [(reals, values[: self.count]) for reals, values in zip(here, self.values, strict=True)]

    def numbers_in(self, patch):
        """Numbers of the nodes in a patch."""
        found = node_numbers(self.message, self.planes, patch)
        self.count = len(found)
        return found


def for_mpi(array):
    """An array of the card as MPI takes it; where the card is simulated, that of the host behind it."""
    return getattr(array, "_ary", array)


def with_last_axis(table):
    return np.ascontiguousarray(table[:, :, None])
