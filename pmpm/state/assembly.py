"""Populations being made: of those that stay and those that arrive, one group of layers after another.

Only a batch of groups, one for each thread, has its particles there twice: what has been moved is given back to the system
behind the reader, and whatever is noted of each particle (home nodes, order) is noted of one batch at a time.

    old layers    ... | given back | near the batch, homes known | not looked at yet ...
    new layers    ... | done       | batch                       | to come ...
"""

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from pmpm.kernels.places import FORMATS, NEAR
from pmpm.kernels.sorting import SEGMENT_COLUMNS
from pmpm.state.memory import Scratch, Source, moved, room
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
        of each; blocks are counted from the first of these. Returns the number of the first of so many new blocks, which are
        to be written when all that are taken at a time have been."""
        segments[:, 0] += self.used
        self.layer_start[first : first + len(starts)] = self.count + starts
        self.segments.append(segments)
        self.count += len(segments)
        begin, self.used = self.used, self.used + blocks
        if self.used > self.blocks:
            self.blocks = FEWEST + int((1.0 + SPARE) * max(self.used, self.blocks))
            self.reals, self.id = moved(self.reals, begin, self.blocks), moved(self.id, begin, self.blocks)
        return begin

    @property
    def written(self):
        """(array, blocks of it that are in use) of both arrays."""
        return [(self.reals, self.used), (self.id, self.used)]

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
    def room(cls, dim, count, scratch):
        return cls(
            scratch.array("homes", (dim, count), np.int32), scratch.array("bodies", (count,), np.int32),
            scratch.array("source", (count,), np.int64),
        )  # fmt: skip

    def put(self, place, others, index=slice(None)):
        """Write some others, and return the number behind them."""
        end = place + len(others.source[index])
        self.homes[:, place:end] = others.homes[:, index]
        self.bodies[place:end], self.source[place:end] = others.bodies[index], others.source[index]
        return end


@dataclass(frozen=True)
class Group:
    """Layers first .. last - 1 that are sorted together: `count` candidates come into them, all among `ranges` (n, 2)."""

    first: int
    last: int
    count: int
    ranges: np.ndarray


def in_order(group, geometry, kernels, body_count, candidates, room):
    """(order, segments, first segment of each layer, blocks) of a group; blocks are counted from its first. `room(name, shape)`
    makes arrays of int64."""
    layers, count, axes = group.last - group.first, group.count, np.array(geometry.axes)
    order, segments = room("order", (count,)), room("segments", (count, SEGMENT_COLUMNS))
    buckets = max(layers * body_count, count, *(geometry.extent(axis) for axis in range(geometry.dim))) + 2
    come = kernels.cell_order(
        candidates.homes, candidates.bodies, group.ranges, axes, group.first, layers, body_count, room("count", (buckets,)),
        room("by layer", (count,)), order,
    )  # fmt: skip
    if come != count:
        raise RuntimeError(f"{come} particles come into the layers {group.first} .. {group.last - 1}, not {count}")
    starts = np.zeros(layers + 1, np.int64)
    used, blocks = kernels.cut_segments(candidates.homes, candidates.bodies, order, axes, group.first, segments, starts)
    return order, segments[:used].copy(), starts, blocks


def sort_in(growing, geometry, kernels, body_count, candidates, groups, blocks, ids, arrived, crew, scratch):
    """Add consecutive groups of layers, no more than threads, to a growing population. Candidates lie in `blocks` with `ids`,
    or are rows of a Cloud `arrived`."""
    form, axes = FORMATS[growing.rest.dtype], np.array(geometry.axes)

    def put_in_order(group, thread):
        def room(name, shape):
            return scratch.array((name, thread), shape, np.int64)

        return in_order(group, geometry, kernels, body_count, candidates, room)

    found = crew.share(put_in_order, groups)
    moves = []
    for group, (order, segments, starts, count) in zip(groups, found, strict=True):
        counted_here = segments.copy()
        begin = growing.take(segments, starts, group.first - growing.first_layer, count)
        moves.append((order, counted_here, begin, begin + count))

    def permute(move, _):
        order, segments, begin, end = move
        kernels.permute(
            blocks.view(form.integer), arrived.places, ids, arrived.id, candidates.source, order, candidates.homes, axes,
            form.fraction, segments, len(segments), growing.reals[begin:end].view(form.integer), growing.id[begin:end],
            growing.rest.view(form.integer),
        )  # fmt: skip

    crew.share(permute, moves)


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


def take_beyond(population, geometry, kernels, opened):
    """A Cloud of those who are beyond open faces, `opened` (dim, 2), taken out of a population that is to be ordered anew."""
    form = FORMATS[population.reals.dtype]
    lying = population.segments, population.layer_start, population.first_layer, form.fraction
    told = np.array(geometry.axes), np.array(geometry.cells), opened
    count = kernels.count_beyond(population.places, *lying, *told)
    gone = Cloud.room(int(count), population.reals.shape[1], geometry.dim, population.reals.dtype)
    if count:
        kernels.take_beyond(
            population.places, population.id, *lying, *told, gone.places, gone.node, gone.row, gone.id
        )  # fmt: skip
    return gone


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


class Assembly:
    """A rank's layers being filled with those of a Population that stay, see `leaving`, and with Arrivals; the old population
    is of no use afterwards. `rest`: see Growing."""

    def __init__(self, population, staying, arrivals, geometry, kernels, first_layer, layers, body_count, rest):
        self.population, self.arrivals, self.geometry, self.kernels = population, arrivals, geometry, kernels
        self.body_count, self.slab = body_count, geometry.axes[0]
        self.first_layer, self.last_layer = first_layer, first_layer + layers
        arriving, *self.sides = arrivals.by_layer(self.slab, first_layer, layers)
        self.counts = staying + arriving
        self.growing = Growing(first_layer, layers, rest, len(population.reals) + -(-int(arriving.sum()) // LANES))
        self.old_first = population.first_layer
        self.old_last = self.old_first + len(population.layer_start) - 1
        self.below = np.concatenate([[0], np.cumsum(population.segments[:, 1])])[population.layer_start]
        starts = np.concatenate([population.segments[:, 0], [len(population.reals)]])
        self.first_blocks = starts[population.layer_start]
        self.source = Source(population.reals, population.id)
        self.looked_at = min(max(self.old_first, first_layer - NEAR), self.old_last)
        self.scratch = Scratch()
        self.waiting = Candidates.room(geometry.dim, 0, self.scratch)

    def whole(self, crew):
        """The new Population, made by the threads of a crew."""
        groups = list(layer_groups(self.counts, self.first_layer))
        for number in range(0, len(groups), crew.threads):
            self.add(groups[number : number + crew.threads], crew)
        self.source.end(self.growing.written)
        return self.growing.whole()

    def add(self, batch, crew):
        """Add consecutive groups of layers, (first, last + 1) each.

        Candidates stand in the one global order: arrived from before, waiting since the last batch, of old layers that have
        not been looked at yet, arrived from behind.
        """
        first, last = batch[0][0], batch[-1][1]
        before, behind = (side_slice(side, self.slab, first, last) for side in self.sides)
        self.ahead = max(self.looked_at, min(self.old_last, last + NEAR))
        self.arrived = before.stop - before.start
        self.fresh = self.arrived + len(self.waiting.source)
        end = self.place(self.ahead)
        candidates = self.candidates = Candidates.room(
            self.geometry.dim, end + behind.stop - behind.start, self.scratch
        )
        candidates.put(candidates.put(0, self.sides[0], before), self.waiting)
        candidates.put(end, self.sides[1], behind)
        cuts = [self.looked_at, *(self.within(group_last + NEAR) for _, group_last in batch[:-1]), self.ahead]
        crew.share(self.loosen, list(pairwise(cuts)))
        shifts = -before.start, end - behind.start
        groups = [self.group(group_first, group_last, shifts) for group_first, group_last in batch]
        sort_in(
            self.growing, self.geometry, self.kernels, self.body_count, candidates, groups, self.population.reals,
            self.population.id, self.arrivals.cloud, crew, self.scratch,
        )  # fmt: skip
        coming = self.arrived + np.flatnonzero(candidates.homes[self.slab, self.arrived : end] >= last)
        self.waiting = Candidates(candidates.homes[:, coming], candidates.bodies[coming], candidates.source[coming])
        self.looked_at = self.ahead
        done = min(max(last - NEAR, self.old_first), self.ahead)
        self.source.done(int(self.first_blocks[done - self.old_first]), self.growing.written)

    def within(self, layer):
        """The nearest to a layer where this batch's fresh old layers begin or end."""
        return min(max(layer, self.looked_at), self.ahead)

    def place(self, layer):
        """The number of an old layer's first candidate among the fresh ones."""
        begin, end = self.below[self.looked_at - self.old_first], self.below[self.within(layer) - self.old_first]
        return self.fresh + int(end - begin)

    def loosen(self, old_layers, _):
        """Make candidates of fresh old layers."""
        geometry, p = self.geometry, self.population
        form = FORMATS[p.reals.dtype]
        self.kernels.loosen(
            p.places, p.segments, p.layer_start, p.first_layer, *old_layers, self.first_layer, self.last_layer,
            form.whole(geometry.stencil.round), form.fraction, np.array(geometry.axes),
            np.array([geometry.homes(axis) for axis in range(geometry.dim)]), np.array(geometry.periodic),
            self.place(old_layers[0]), self.candidates.homes, self.candidates.bodies, self.candidates.source,
        )  # fmt: skip

    def group(self, first, last, shifts):
        """The Group of some layers; `shifts`: from the numbers of those that arrived to their candidates."""
        low, high = (side_slice(side, self.slab, first, last) for side in self.sides)
        near = self.place(first - NEAR) if first - NEAR >= self.looked_at else self.arrived
        ranges = np.array([
            [low.start + shifts[0], low.stop + shifts[0]], [near, self.place(last + NEAR)],
            [high.start + shifts[1], high.stop + shifts[1]],
        ])  # fmt: skip
        return Group(first, last, int(self.counts[first - self.first_layer : last - self.first_layer].sum()), ranges)


def settle(batches, others, counts, geometry, kernels, first_layer, layers, body_count, rests, crew):
    """Populations of each law of particles that lie in no order yet: `batches`, ((first, last + 1) layers, Clouds) of one
    group of layers after another, and `others`, Clouds of all layers or None. About `counts` of each law; `rests`: see
    Growing."""
    growing = [Growing(first_layer, layers, r, int(n) // LANES) for r, n in zip(rests, counts, strict=True)]
    slab, scratch = geometry.axes[0], Scratch()
    for (first, last), clouds in batches:
        for law, (made, cloud) in enumerate(zip(growing, clouds, strict=True)):
            if others is not None:
                layer = others[law].node[:, slab]
                cloud = Cloud.join([others[law].take(np.flatnonzero((layer >= first) & (layer < last))), cloud])
            count = len(cloud)
            candidates = Candidates(np.ascontiguousarray(cloud.node.T), cloud.row, -1 - np.arange(count))
            none = Population.empty(len(made.rest), 0, 0, made.rest.dtype)
            group = Group(first, last, count, np.array([[0, count]]))
            sort_in(made, geometry, kernels, body_count, candidates, [group], none.reals, none.id, cloud, crew, scratch)
    return [made.whole() for made in growing]


def side_slice(side, slab, first, last):
    """Those of candidates ordered by layer that come into the layers first .. last - 1."""
    begin, end = np.searchsorted(side.homes[slab], (first, last))
    return slice(int(begin), int(end))
