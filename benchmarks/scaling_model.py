"""A model of a time step on many ranks: what is computed, what is sent, what is waited for.

    python benchmarks/scaling_model.py [--fit [--quick]] [--docs docs]

Prints predicted strong and weak scaling on published machines (scaling_machines.py). --fit measures the constants on this
machine first (four minutes; with --quick half a minute, for work on this file) and keeps them in scaling_constants.json. --docs
writes scaling.md and pictures/scaling_model.png there (scaling_page.py).

Counts of messages and bytes are exact for planes whose every node is occupied. Times are latency plus bytes over bandwidth
(the postal model), of the rank that has most to do, in the order of a step; units of a machine are its cores, or its GPUs.
"""

import argparse
import json
import math
import sys
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np

from pmpm.parallel.balance import NODE_WORK
from pmpm.parallel.slabs import Slabs
from pmpm.timestep import EVERY, LAG

NODE_REALS = 4  # momentum and mass
QUAD = 4  # nodes of a row that travel together
PER_PLANE, PER_ROW, HEAD = (
    8,
    12,
    64,
)  # bytes a message tells each plane and each full row in, and a multiple that they fill
NODE_COST = NODE_WORK / 100  # of one node that a rank updates beside its neighbour, in particle-steps
REDUCED = 2 * 8 * 7  # bytes of a step's reduction, there and back: seven float64
CONSTANTS = Path(__file__).with_name("scaling_constants.json")
QUADRATIC = (2, 2)  # planes a layer's particles reach below and above its own, with one cell of padding
CUT_COPIES = 2  # a byte that is packed or unpacked is read once and written once


# ---- counts ----------------------------------------------------------------------------------------------------------------


def message_bytes(planes, plane, real_bytes):
    """Bytes of one message of so many planes of (rows, nodes of a row), all of them occupied."""
    rows, nodes = plane
    head = -(-planes * (PER_PLANE + PER_ROW * rows) // HEAD) * HEAD
    return head + planes * rows * -(-nodes // QUAD) * QUAD * NODE_REALS * real_bytes


def between_ranks(slabs):
    """The cuts that a message crosses: what goes round a periodic axis to the same rank is none."""
    return [cut for cut in slabs.cuts if cut.earlier != cut.later]


def halo_messages(slabs, exchanges=1):
    """(ranks,) messages that each rank of `slabs` sends per step; `exchanges` per step: see `halo_exchanges`."""
    sent = np.zeros(len(slabs.edges) - 1, np.int64)
    for cut in between_ranks(slabs):
        sent[cut.earlier] += exchanges
        sent[cut.later] += exchanges
    return sent


def halo_bytes(slabs, plane, real_bytes, exchanges=1):
    """(ranks,) bytes that each rank sends per step if every node of the shared planes is occupied.

    plane: (M, K), rows of a plane and nodes of a row; real_bytes: 4 or 8.
    """
    sent = np.zeros(len(slabs.edges) - 1, np.int64)
    for cut in between_ranks(slabs):
        sent[cut.earlier] += exchanges * message_bytes(cut.planes, plane, real_bytes)
        sent[cut.later] += exchanges * message_bytes(len(cut.unsummed), plane, real_bytes)
    return sent


def halo_exchanges(blends, f_bar):
    """Exchanges per step: one of momentum, one more for schemes that blend (FLIP), one more for F-bar."""
    return 1 + bool(blends) + bool(f_bar)


def planes_of_cut(reach=QUADRATIC):
    """(summed planes that go one way, unsummed ones that go the other) at a cut."""
    window = sum(reach) + 1
    (cut,) = Slabs(2 * window, False, *reach, (0, window, 2 * window)).cuts
    return cut.planes, len(cut.unsummed)


# ---- what is modelled ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class LawCost:
    """`particle`: s per particle-step of one core, sorting left out; `regroup`: s per particle and regroup; `held`, `moved`:
    bytes a particle holds in memory, and moves to and from it in a step."""

    particle: float
    regroup: float
    held: int
    moved: int


@dataclass(frozen=True)
class Link:
    """Latency in s and bandwidth in bytes/s of one message between two ranks."""

    latency: float
    bandwidth: float

    def seconds(self, messages, size):
        return messages * self.latency + size / self.bandwidth


@dataclass(frozen=True)
class Constants:
    """What was measured on one machine: `laws` by workload; `step`: s of a step beside all particles (Python, posting);
    `every`: steps between two regroups; `copy`: bytes/s of one core; `local`: between two ranks of a node; `file_bytes` of a
    particle in a checkpoint; `source` of the figures."""

    laws: dict
    step: float
    every: float
    copy: float
    local: Link
    file_bytes: float
    source: str


@dataclass(frozen=True)
class Machine:
    """A cluster. `units` (cores or GPUs) per node, `memory`: bytes/s of a node, `links` to the network per node, `link`: one
    of them. `share`: of `memory` that the kernels of a GPU get, an assumption; None: units are cores like the measured one."""

    name: str
    units: int
    memory: float
    links: int
    link: Link
    sources: tuple[str, ...]
    share: float | None = None

    @property
    def is_predicted(self):
        """Whether the speed of a unit is itself an assumption."""
        return self.share is not None


@dataclass(frozen=True)
class Block:
    """A full block of material: cells along the slab axis, middle and row."""

    cells: tuple[int, int, int]
    per_cell: int = 8
    real_bytes: int = 4

    @property
    def particles(self):
        return math.prod(self.cells) * self.per_cell


@dataclass(frozen=True)
class Split:
    """How a block is cut: `parts` along each axis, `threads` (units) per rank. Slabs are cut along the first axis only."""

    parts: tuple[int, int, int]
    threads: int = 1

    @property
    def ranks(self):
        return math.prod(self.parts)

    @property
    def units(self):
        return self.ranks * self.threads

    @property
    def is_slabs(self):
        return self.parts[1:] == (1, 1)


def fits(block, split, reach=QUADRATIC):
    """Whether every part is as wide as a stencil reaches."""
    window = sum(reach) + 1
    return all(parts == 1 or cells // parts >= window for cells, parts in zip(block.cells, split.parts, strict=True))


def unit_seconds(law, machine, busy):
    """s per particle-step of one unit when `busy` units of its node compute: instructions or memory, whichever is slower."""
    if machine.is_predicted:
        return law.moved * machine.units / (machine.memory * machine.share)
    return max(law.particle, law.moved * busy / machine.memory)


@dataclass(frozen=True)
class Surface:
    """Of the rank with most neighbours: nodes it updates beside them, bytes it sends and receives, messages it sends."""

    nodes: int = 0
    sent: int = 0
    received: int = 0
    messages: int = 0


def surface(block, split, exchanges=1, reach=QUADRATIC):
    """What cuts cost the rank in the middle, or the one of two that sends more. Bricks: the same at each of their cuts."""
    local = largest_part(block, split)
    summed, unsummed = planes_of_cut(reach)
    nodes = sent = received = messages = 0
    for axis, parts in enumerate(split.parts):
        if parts == 1:
            continue
        plane = tuple(size + sum(reach) for other, size in enumerate(local) if other != axis)
        out, back = ((summed, unsummed),) * 2 if parts > 2 else ((unsummed,), (summed,))
        cuts = min(parts - 1, 2)
        nodes += cuts * summed * math.prod(plane)
        sent += exchanges * sum(message_bytes(planes, plane, block.real_bytes) for planes in out)
        received += exchanges * sum(message_bytes(planes, plane, block.real_bytes) for planes in back)
        messages += exchanges * cuts
    return Surface(nodes, sent, received, messages)


def largest_part(block, split):
    """Cells of the largest part: parts are whole layers, so that one may have a layer more than another."""
    return tuple(-(-cells // parts) for cells, parts in zip(block.cells, split.parts, strict=True))


def step_seconds(block, split, machine, law, constants, overlap=0.0, exchanges=1):
    """dict of s per step of the rank with most to do, by part of the step.

    overlap: 0: a message is on its way only while ranks wait for it; 1: also while the interior is computed. ValueError for
    parts that are too thin.
    """
    if not fits(block, split):
        raise ValueError(
            f"{block.cells} cells in {split.parts} parts: a part is at least {sum(QUADRATIC) + 1} cells wide"
        )
    local, edge = largest_part(block, split), surface(block, split, exchanges)
    particles, ranks = math.prod(local) * block.per_cell, split.ranks
    one = unit_seconds(law, machine, min(split.units, machine.units))
    slower = one / law.particle
    copy = constants.copy if not machine.is_predicted else machine.memory * machine.share / machine.units
    spans_nodes = split.units > machine.units
    between = machine.link if spans_nodes or machine.is_predicted else constants.local
    computed = particles * one / split.threads
    sending = exchange_seconds(edge, split, machine, between, spans_nodes)
    inside = math.prod(
        max(0.0, 1.0 - 2.0 * sum(QUADRATIC) * (p > 1) / n) for n, p in zip(local, split.parts, strict=True)
    )
    levels = math.ceil(math.log2(ranks)) if ranks > 1 else 0
    regrouped = particles * law.regroup * slower / split.threads
    regrouped += levels * (3.0 * between.latency + 4.0 * ranks / between.bandwidth) if ranks > 1 else 0.0
    regrouped += migrated_bytes(local, split, block, law) / between.bandwidth
    found = {
        "compute": computed,
        "ghost nodes": edge.nodes * NODE_COST * one / split.threads,
        "packing": CUT_COPIES * (edge.sent + edge.received) / copy / split.threads,
        "messages": max(0.0, sending - overlap * inside * computed / 2.0),
        "regroup": regrouped / constants.every,
        "fixed": constants.step,
    }
    reduced = 2 * levels * (between.latency + REDUCED / between.bandwidth) * (1.0 + 1.0 / EVERY)
    return found | {"reductions": max(0.0, reduced - LAG * sum(found.values()))}


def exchange_seconds(edge, split, machine, between, spans_nodes):
    """s of the halo of one step. Ranks of a node that hold neighbouring slabs cross the network at one cut only; bricks are
    taken to do so at all of theirs, and to share the links of their node."""
    per_node = max(1, machine.units // split.threads)
    if not spans_nodes or per_node == 1:
        return between.seconds(edge.messages, edge.sent)
    if split.is_slabs:
        summed, unsummed = planes_of_cut()
        return between.seconds(edge.messages, edge.sent * unsummed / (summed + unsummed))
    shared = min(1.0, machine.links / per_node)
    return between.seconds(edge.messages, edge.sent / shared)


def migrated_bytes(local, split, block, law):
    """Bytes that leave a rank at a regroup, if half of the particles of a cell next to each cut have crossed it."""
    faces = sum(
        min(parts - 1, 2) * math.prod(local) / local[axis] for axis, parts in enumerate(split.parts) if parts > 1
    )
    return 0.5 * faces * block.per_cell * law.held


def efficiency(block, split, machine, law, constants, **choices):
    """Particle-steps per second and unit, over those of a unit of a full node that has no cuts."""
    one = unit_seconds(law, machine, min(machine.units, split.units))
    alone = block.particles * (one + law.regroup * one / law.particle / constants.every)
    total = sum(step_seconds(block, split, machine, law, constants, **choices).values())
    return alone / split.units / total


def within_node(machine, law):
    """Speed of a unit when all units of its node compute, over that of one alone."""
    return 1.0 if machine.is_predicted else law.particle / unit_seconds(law, machine, machine.units)


def most_slabs(block, reach=QUADRATIC):
    """How many ranks slabs of a block can feed."""
    return max(1, block.cells[0] // (sum(reach) + 1))


def best_bricks(block, ranks, threads, axes=3):
    """The Split into bricks along so many axes with the smallest surface; None where none is wide enough."""
    choices = [
        Split((a, b, ranks // a // b), threads)
        for a, b in product(divisors(ranks), repeat=2)
        if ranks % (a * b) == 0 and (axes == 3 or ranks == a * b)
    ]
    choices = [split for split in choices if fits(block, split)]
    return min(choices, key=lambda split: surface(block, split).sent, default=None)


def divisors(number):
    return [n for n in range(1, number + 1) if number % n == 0]


def checkpoint_seconds(particles, constants, bandwidth):
    """s to write a checkpoint at so many bytes/s of a file system."""
    return particles * constants.file_bytes / bandwidth


# ---- constants -------------------------------------------------------------------------------------------------------------


def read_constants(path=CONSTANTS):
    """The Constants in a file that `write_constants` wrote."""
    record = json.loads(Path(path).read_text(encoding="utf-8"))
    laws = {name: LawCost(**law) for name, law in record.pop("laws").items()}
    return Constants(laws=laws, local=Link(**record.pop("local")), **record)


def write_constants(constants, path=CONSTANTS):
    record = {**vars(constants), "local": vars(constants.local)}
    record["laws"] = {name: vars(law) for name, law in constants.laws.items()}
    Path(path).write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")


def main(arguments=None):
    import scaling_page

    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--fit", action="store_true", help="measure the constants on this machine first")
    options.add_argument("--quick", action="store_true", help="with --fit: few particles, few steps; keeps nothing")
    options.add_argument("--docs", type=Path, help="write page and picture here")
    given = options.parse_args(arguments)
    if given.docs and given.quick:
        options.error("--docs wants full measurements, not --quick")
    constants = read_constants()
    if given.fit:
        import scaling_fit

        constants = scaling_fit.fit(given.quick)
        if not given.quick:
            write_constants(constants)
    print(scaling_page.tables(constants))
    if given.docs:
        scaling_page.write(constants, given.docs)
    return 0


if __name__ == "__main__":
    sys.exit(main())
