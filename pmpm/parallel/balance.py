"""Balance: cuts between slabs follow the work that is counted; a clock never decides.

Work is counted in hundredths of what one particle-step of a neo-Hookean solid costs: a particle costs the WORK of its law, a
node that a layer's particles reach NODE_WORK. Where a slab must be at least a stencil wide, no cuts may be even; then those
are taken whose busiest rank has the least to do.
"""

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from pmpm.parallel.slabs import room

NODE_WORK = 50  # measured: 0.45 (3-D, float32), 0.52 (3-D, float64), 0.71 (2-D) particle-steps
MOVE_WORK = 1000  # of a particle that changes ranks, packing, sending and its share of new patches: an estimate
MOST_MOVES = 100  # that are remembered for run.json
SHARE = 1 / 16  # of a rank's particles that may arrive at a time: they are there twice until they are sorted in
FEW = 1 << 18  # particles that may arrive however few there are
WORTH = 0.02  # of the busiest rank's work that new cuts must save at least


def layer_work(populations, works, layer_quads):
    """(layers,) int64 work of this rank's layers: populations by law with their works, quads of nodes that each reaches."""
    total = NODE_WORK * 4 * layer_quads
    for population, work in zip(populations, works, strict=True):
        total += work * np.diff(sums_below(population.segments[:, 1])[population.layer_start])
    return total


def sums_below(work):
    """(n + 1,) what all before the first, the second, ... of `work` (n,) add up to."""
    return np.concatenate([[0], np.cumsum(work)])


def best_edges(work, ranks, window):
    """(ranks + 1,) edges of slabs of at least `window` layers whose largest work is as small as it can be, to a thousandth.

    work: (layers,) integers. Not more than `ranks` slabs; fewer where that is better, or where there is no room for more.
    """
    below, layers = sums_below(work), len(work)
    most = min(ranks, room(layers, window))
    low = smallest(least_possible(work, ranks, window), lambda bound: greedy_edges(below, bound, most)[-1] == layers)
    edges = greedy_edges(below, low, most)
    if np.diff(edges).min() < window:  # the width binds somewhere, and greed fails
        high = smallest(low, lambda bound: beginnings(below, bound, most, window)[-1][layers] >= 0)
        edges = [layers]
        for begins in reversed(beginnings(below, high, most, window)):
            edges.append(int(begins[edges[-1]]))
        edges.reverse()
    return (*edges, *[layers] * (ranks + 1 - len(edges)))


def smallest(low, fits):
    """The smallest integer from `low` on that fits, to a thousandth; what is larger than one that fits does so, too."""
    high, gap = low, max(low // 128, 1)
    while not fits(high):
        low, high, gap = high + 1, high + gap, 2 * gap
    while high - low > low // 1000:
        middle = (low + high) // 2
        low, high = (low, middle) if fits(middle) else (middle + 1, high)
    return high


def greedy_edges(below, bound, ranks):
    """Edges of at most `ranks` slabs of any width, each as wide as `bound` allows, from the first layer on."""
    edges = [0]
    while edges[-1] < len(below) - 1 and len(edges) <= ranks:
        edges.append(int(np.searchsorted(below, below[edges[-1]] + bound, side="right")) - 1)
    return edges


def least_possible(work, ranks, window):
    """A bound that no cuts can beat: an equal share, and what is in the slab, a window wide at least, of any one layer."""
    layers = len(work)
    if layers < window:
        return int(work.sum())
    ranks = min(ranks, room(layers, window))
    windows = np.convolve(work, np.ones(window, np.int64), "valid")
    padded = np.pad(windows, window - 1, constant_values=np.iinfo(np.int64).max)
    around = np.lib.stride_tricks.sliding_window_view(padded, window)[:layers].min(axis=1)
    return max(-(-int(work.sum()) // ranks), int(around.max()))


def beginnings(below, bound, ranks, window):
    """For 1, 2, ... slabs of at most `bound` each, until all layers are covered or ranks used up: (layers + 1,) where the last
    of them begins if it ends at that edge, -1 where it cannot end there."""
    edges = np.arange(len(below))
    reached = np.where(edges == 0, 0, -1)
    found: list[np.ndarray] = []
    for _ in range(ranks):
        latest = np.maximum.accumulate(np.where(reached >= 0, edges, -1))
        begins = np.full(len(below), -1)
        begins[window:] = latest[:-window]
        if not found and len(below) <= window:  # fewer layers than a window belong to one rank
            begins[-1] = 0
        begins[(begins < 0) | (below - below[begins] > bound)] = -1
        found.append(begins)
        if begins[-1] >= 0:
            break
        reached = begins
    return found


def edges_between(counts, before, after):
    """The edges, `after` the last of them, to go through from those `before`, so that on each way no rank gets more than SHARE
    of the particles that it has in the end or had in the beginning; `counts`: (layers,) of all ranks.

    Edges on the way need not be a stencil apart: there are no time steps between.
    """
    below = sums_below(counts)
    begin, end = below[list(before)], below[list(after)]
    most = np.maximum(np.diff(begin), np.diff(end))
    arriving = np.maximum(begin - end, 0)[:-1] + np.maximum(end - begin, 0)[1:]
    ways = int(np.max(np.ceil(arriving / np.maximum(SHARE * most, FEW))))
    found = [
        tuple(int(edge) for edge in np.searchsorted(below, begin + (end - begin) * way // ways))
        for way in range(1, ways)
    ]
    return [*[(0, *edges[1:-1], len(counts)) for edges in found], tuple(after)]


def slab_works(work, edges):
    """(ranks,) work of each slab."""
    return np.diff(sums_below(work)[list(edges)])


def imbalance(works):
    """Largest over mean work of the ranks that may have any: 1 is even. `works`: (ranks,)."""
    return float(works.max() * len(works) / max(int(works.sum()), 1))


@dataclass
class Move:
    """New cuts: the step before which they were taken, the imbalance before and after, the best there is, and what this rank
    sent for them: particles and their bytes, those included that had left their slab anyway."""

    step: int
    before: float
    after: float
    best: float
    particles: int
    nbytes: int


@dataclass
class Balance:
    """Decides on new cuts, and counts what they did. `works`: of a particle of each law; `wanted`: whether cuts may move."""

    works: tuple[int, ...]
    window: int
    wanted: bool = True
    changes: int = 0
    lost: int = 0  # work of the busiest rank that better cuts would have saved since cuts moved last
    before: float = 1.0  # imbalance when cuts were looked at last, with those cuts
    after: float = 1.0  # and with the cuts that were taken
    best: float = 1.0  # and the best that slabs can do
    sent: np.ndarray = field(default_factory=lambda: np.zeros(2, np.int64))  # particles and bytes, when cuts moved
    moves: deque[Move] = field(default_factory=lambda: deque(maxlen=MOST_MOVES))  # the last ones

    def report(self, comm):
        """What run.json says of it, with particles and bytes of all ranks. Collective."""
        here = [self.sent, *([move.particles, move.nbytes] for move in self.moves)]
        (particles, nbytes), *sent = comm.sum(np.array(here, np.int64)).tolist()
        return {
            "cuts_moved": self.changes, "imbalance": self.after, "imbalance_before": self.before, "best": self.best,
            "particles_sent": particles, "bytes_sent": nbytes,
            "last_moves": [
                {"step": move.step, "imbalance_before": move.before, "imbalance": move.after, "best": move.best,
                 "particles_sent": of_move[0], "bytes_sent": of_move[1]}
                for move, of_move in zip(self.moves, sent, strict=True)
            ],
        }  # fmt: skip

    def note(self, step, particles, nbytes):
        """Take note of what this rank sent when cuts moved before step number `step`."""
        self.sent += particles, nbytes
        self.moves.append(Move(step, self.before, self.after, self.best, particles, nbytes))

    def look(self, work, edges, steps):
        """New edges, or None while they are not worth it: cuts move when the busiest rank has lost more to the old ones, since
        they moved last, than the moving costs. `work`: (layers,) of all ranks; `steps`: since it was last asked."""
        ranks = len(edges) - 1
        now = slab_works(work, edges)
        self.before = self.after = imbalance(now)
        low = least_possible(work, ranks, self.window)
        self.best = low * ranks / max(int(work.sum()), 1)
        if not self.wanted or now.max() <= (1.0 + WORTH) * low:
            return None
        edges_then = best_edges(work, ranks, self.window)
        then = slab_works(work, edges_then)
        self.best = imbalance(then)
        saved = int(now.max() - then.max())
        if saved <= WORTH * then.max():
            return None
        self.lost += saved * steps
        if self.lost <= MOVE_WORK * moved(work, edges, edges_then):
            return None
        self.changes, self.lost = self.changes + 1, 0
        self.after = self.best
        return edges_then


def moved(work, edges, edges_then):
    """About how many particles the rank sends that sends most, if each works like a neo-Hookean one."""
    below = sums_below(work)
    now, then = np.array(edges), np.array(edges_then)
    first, last = np.maximum(now[:-1], then[:-1]), np.minimum(now[1:], then[1:])
    kept = below[np.maximum(last, first)] - below[first]
    return int((slab_works(work, edges) - kept).max()) // 100
