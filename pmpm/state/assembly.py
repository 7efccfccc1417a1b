"""Populations being made: of those that stay and those that arrive, one group of layers after another.

Only a group's particles are there twice: what has been moved is given back to the system behind the reader, and whatever is
noted of each particle (home nodes, order) is noted of one group at a time.

    old layers    ... | given back | near the group, homes known | not looked at yet ...
    new layers    ... | done       | group                       | to come ...
"""

from dataclasses import dataclass, field

import numpy as np

from pmpm.kernels.places import FORMATS, NEAR
from pmpm.kernels.sorting import SEGMENT_COLUMNS
from pmpm.state.memory import Source, moved, room
from pmpm.state.particles import LANES, Cloud, Population, layer_groups

SPARE = 1 / 16  # of the blocks, room for more of them than there were: only what is written takes memory
FEWEST = 64  # blocks


@dataclass
class Growing:
    """A Population of a rank's layers that is being made from its first layer on. `rest` (size,): what fills up blocks, as
    reals, places zero; `blocks`: about how many there will be."""

    first_layer: int
    layers: int
    rest: np.ndarray
    blocks: int
    used: int = 0
    segments: list = field(default_factory=list)

    def __post_init__(self):
        self.blocks = FEWEST + int((1.0 + SPARE) * self.blocks)
        self.reals = room(self.blocks, (len(self.rest), LANES), self.rest.dtype)
        self.id = room(self.blocks, (LANES,), np.int64)
        self.layer_start = np.zeros(self.layers + 1, np.int64)
        self.count = 0  # segments

    def take(self, segments, starts, first, blocks):
        """Note the segments (m, 5) of layers `first` (this rank's counting) and on, `starts` (layers + 1,) the first segment
        of each; blocks are counted from the first of these. Returns (reals, id) of so many new blocks, to be written."""
        segments[:, 0] += self.used
        self.layer_start[first : first + len(starts)] = self.count + starts
        self.segments.append(segments)
        self.count += len(segments)
        begin, self.used = self.used, self.used + blocks
        if self.used > self.blocks:
            self.blocks = FEWEST + int((1.0 + SPARE) * max(self.used, self.blocks))
            self.reals, self.id = moved(self.reals, begin, self.blocks), moved(self.id, begin, self.blocks)
        return self.reals[begin : self.used], self.id[begin : self.used]

    def whole(self):
        """The Population."""
        segments = np.concatenate([np.zeros((0, SEGMENT_COLUMNS), np.int64), *self.segments])
        return Population(self.reals[: self.used], self.id[: self.used], segments, self.layer_start, self.first_layer)


@dataclass
class Candidates:
    """What is known of those that may come into a group of layers, see kernels.sorting: homes (dim, n), bodies, source (n,)."""

    homes: np.ndarray
    bodies: np.ndarray
    source: np.ndarray

    @classmethod
    def room(cls, dim, count):
        return cls(np.empty((dim, count), np.int32), np.empty(count, np.int32), np.empty(count, np.int64))

    def put(self, place, others, index=slice(None)):
        """Write some others, and return the number behind them."""
        end = place + len(others.source[index])
        self.homes[:, place:end] = others.homes[:, index]
        self.bodies[place:end], self.source[place:end] = others.bodies[index], others.source[index]
        return end


def sort_in(growing, geometry, kernels, body_count, candidates, known, first, last, count, blocks, ids, arrived):
    """Add the layers first .. last - 1 to a growing population, of the first `known` candidates: `count` will come. They lie
    in `blocks` with `ids`, or are rows of a Cloud `arrived`."""
    form, axes = FORMATS[growing.rest.dtype], np.array(geometry.axes)
    homes, bodies, source = candidates.homes, candidates.bodies, candidates.source
    order, scratch = np.empty(count, np.int64), np.empty(count, np.int64)
    buckets = max((last - first) * body_count, count, *(geometry.extent(axis) for axis in range(geometry.dim))) + 2
    kernels.cell_order(
        homes, bodies, known, axes, first, last - first, body_count, np.empty(buckets, np.int64), scratch, order
    )
    segments, starts = np.empty((count, SEGMENT_COLUMNS), np.int64), np.zeros(last - first + 1, np.int64)
    used, new_blocks = kernels.cut_segments(homes, bodies, order, axes, first, segments, starts)
    segments = segments[:used].copy()
    counted_here = segments.copy()
    reals, new_ids = growing.take(segments, starts, first - growing.first_layer, new_blocks)
    kernels.permute(
        blocks.view(form.integer), arrived.places, ids, arrived.id, source, order, homes, axes, form.fraction,
        counted_here, used, reals.view(form.integer), new_ids, growing.rest.view(form.integer),
    )  # fmt: skip


@dataclass
class Leaving:
    """Who of a population goes where: `staying` (layers,) will be in each layer that this rank will own, near where they were;
    `others`, in order, go elsewhere or farther, and `layer` (n,) is where they were."""

    staying: np.ndarray
    others: Cloud
    layer: np.ndarray


def leaving(population, geometry, kernels, first, last):
    """The Leaving of a rank that will own the layers first .. last - 1; the population itself stays as it is."""
    real = population.reals.dtype
    form, slab = FORMATS[real], geometry.axes[0]
    now = len(population.layer_start) - 1
    staying, counts = np.zeros(last - first, np.int64), np.zeros(now, np.int64)
    nodes = np.array([geometry.homes(axis) for axis in range(geometry.dim)])
    half, periodic = form.whole(geometry.stencil.round), np.array(geometry.periodic)
    lying = population.places, population.segments, population.layer_start, population.first_layer
    kernels.count_moves(
        *lying, first, last, half, form.fraction, slab, int(nodes[slab]), bool(periodic[slab]), staying, counts
    )
    others = Cloud.room(int(counts.sum()), population.reals.shape[1], geometry.dim, real)
    kernels.take_leaving(
        population.places, population.id, *lying[1:], first, last, half, form.fraction, np.array(geometry.axes), nodes,
        periodic, counts, others.places, others.node, others.row, others.id,
    )  # fmt: skip
    return Leaving(staying, others, np.repeat(population.first_layer + np.arange(now), counts))


@dataclass
class Arrivals:
    """Particles that come into a rank's layers from elsewhere: the first `before` rows of `cloud` come from lower in the one
    global order than those that stay, the others from higher."""

    cloud: Cloud
    before: int

    def by_layer(self, slab, first_layer, layers):
        """(counts (layers,), candidates of those before, of those after), each ordered by layer."""
        found = []
        for number in (np.arange(self.before), np.arange(self.before, len(self.cloud))):
            number = number[np.argsort(self.cloud.node[number, slab], kind="stable")]
            homes = np.ascontiguousarray(self.cloud.node[number].T)
            found.append(Candidates(homes, self.cloud.row[number], -1 - number))
        slabs = self.cloud.node[:, slab]
        if len(slabs) and not first_layer <= slabs.min() <= slabs.max() < first_layer + layers:
            raise RuntimeError(
                f"particles of layers {slabs.min()} .. {slabs.max()} came to a rank of {layers} from {first_layer} on"
            )
        return np.bincount(slabs - first_layer, minlength=layers), *found


def assemble(population, staying, arrivals, geometry, kernels, first_layer, layers, body_count, rest):
    """The Population of those that stay, see `leaving`, and those that arrive, in layers of this rank; the old one is of no
    use afterwards."""
    form, axes, slab = FORMATS[rest.dtype], np.array(geometry.axes), geometry.axes[0]
    half, periodic = form.whole(geometry.stencil.round), np.array(geometry.periodic)
    nodes = np.array([geometry.homes(axis) for axis in range(geometry.dim)])
    last_layer = first_layer + layers
    arriving, *sides = arrivals.by_layer(slab, first_layer, layers)
    counts = staying + arriving
    growing = Growing(first_layer, layers, rest, len(population.reals) + -(-int(arriving.sum()) // LANES))
    old_first, old_last = population.first_layer, population.first_layer + len(population.layer_start) - 1
    below = np.concatenate([[0], np.cumsum(population.segments[:, 1])])[population.layer_start]
    first_blocks = np.concatenate([population.segments[:, 0], [len(population.reals)]])[population.layer_start]
    source = Source(population.reals, population.id)
    looked_at = min(max(old_first, first_layer - NEAR), old_last)
    waiting = Candidates.room(geometry.dim, 0)
    for first, last in layer_groups(counts, first_layer):
        ahead = max(looked_at, min(old_last, last + NEAR))
        fresh = int(below[ahead - old_first] - below[looked_at - old_first])
        before, after = (side_slice(side, slab, first, last) for side in sides)
        parts = [(sides[0], before), (sides[1], after)]
        room_for = sum(index.stop - index.start for _, index in parts) + len(waiting.source) + fresh
        candidates = Candidates.room(geometry.dim, room_for)
        begin = candidates.put(0, *parts[0])
        known = kernels.loosen(
            population.places, population.segments, population.layer_start, old_first, looked_at, ahead, first_layer,
            last_layer, half, form.fraction, axes, nodes, periodic, candidates.put(begin, waiting), candidates.homes,
            candidates.bodies, candidates.source,
        )  # fmt: skip
        waiting_next = begin + np.flatnonzero(candidates.homes[slab, begin:known] >= last)
        waiting = Candidates(
            candidates.homes[:, waiting_next], candidates.bodies[waiting_next], candidates.source[waiting_next]
        )
        known = candidates.put(known, *parts[1])
        sort_in(
            growing, geometry, kernels, body_count, candidates, known, first, last,
            int(counts[first - first_layer : last - first_layer].sum()), population.reals, population.id, arrivals.cloud,
        )  # fmt: skip
        looked_at = ahead
        done = min(max(last - NEAR, old_first), ahead)
        source.done(int(first_blocks[done - old_first]))
    return growing.whole()


def settle(batches, others, counts, geometry, kernels, first_layer, layers, body_count, rests):
    """Populations of each law of particles that lie in no order yet: `batches`, ((first, last + 1) layers, Clouds) of one
    group of layers after another, and `others`, Clouds of all layers or None. About `counts` of each law; `rests`: see
    Growing."""
    growing = [Growing(first_layer, layers, r, int(n) // LANES) for r, n in zip(rests, counts, strict=True)]
    slab = geometry.axes[0]
    for (first, last), clouds in batches:
        for law, (made, cloud) in enumerate(zip(growing, clouds, strict=True)):
            if others is not None:
                layer = others[law].node[:, slab]
                cloud = Cloud.join([others[law].take(np.flatnonzero((layer >= first) & (layer < last))), cloud])
            count = len(cloud)
            candidates = Candidates(np.ascontiguousarray(cloud.node.T), cloud.row, -1 - np.arange(count))
            none = Population.empty(len(made.rest), 0, 0, made.rest.dtype)
            sort_in(
                made, geometry, kernels, body_count, candidates, count, first, last, count, none.reals, none.id, cloud
            )
    return [made.whole() for made in growing]


def side_slice(side, slab, first, last):
    """Those of candidates ordered by layer that come into the layers first .. last - 1."""
    begin, end = np.searchsorted(side.homes[slab], (first, last))
    return slice(int(begin), int(end))
