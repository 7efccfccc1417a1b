"""Parts of one rank's layers: those beside cuts are summed first, so that the halo is on its way while the rest is; the rest is
shared among threads.

Layers are added to the nodes in their order whatever the parts are: where a part begins that does not wait for the one
before it, what its layers give to planes that earlier layers reach, too, is kept apart and added when both are done.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass

import numpy as np

from pmpm.parallel.balance import best_edges


@dataclass(frozen=True)
class Parts:
    """Ranges of layers (first, last + 1): `edges` have nodes that wait for the halo, `inner` ones do not. `apart`: (layer,
    plane of its window) pairs that are kept apart, in the order in which they are added when all is summed."""

    edges: tuple[tuple[int, int], ...]
    inner: tuple[tuple[int, int], ...]
    apart: tuple[tuple[int, int], ...]

    @property
    def low(self):
        """How many layers from the first on wait for the halo."""
        return self.edges[0][1] if self.edges and self.edges[0][0] == 0 else 0

    def high(self, layers):
        """How many layers up to the last wait for the halo."""
        return layers - self.edges[-1][0] if self.edges and self.edges[-1][1] == layers else 0


def parts_of(work, window, low_shared, high_shared, threads):
    """Parts of layers with this work (layers,), integers; a stencil with its padding reaches `window` planes."""
    layers, shared = len(work), window - 1
    low, high = shared * low_shared, shared * high_shared
    if not layers:
        return Parts((), (), ())
    if low + high >= layers:
        return Parts(((0, layers),), (), ())
    edges = [(0, low)] * bool(low) + [(layers - high, layers)] * bool(high)
    inside = work[low : layers - high]
    cuts = best_edges(inside + 1, min(threads, len(inside)), 1) if threads > 1 else (0, len(inside))
    inner = [(low + a, low + b) for a, b in zip(cuts[:-1], cuts[1:], strict=True) if a < b]
    begins = [first for first, _ in inner[1:]] + [layers - high] * bool(high)
    ends = [*begins[1:], layers][: len(begins)]
    apart = [
        (layer, k)
        for begin, end in zip(begins, ends, strict=True)
        for layer in range(begin, min(end, begin + shared))
        for k in range(shared - (layer - begin))
    ]
    return Parts(tuple(edges), tuple(inner), tuple(apart))


def pieces(first, last, threads, least):
    """Ranges that planes first .. last - 1 are cut into for threads, those at the ends of at least so many planes."""
    count = min(threads, (last - first) // max(least, 1))
    edges = np.linspace(first, last, max(count, 1) + 1).astype(int)
    return [(int(a), int(b)) for a, b in zip(edges[:-1], edges[1:], strict=True)]


class Crew:
    """Threads that share work, of one rank. One thread is this one. Raises ValueError for less than one."""

    def __init__(self, threads):
        if threads < 1:
            raise ValueError(f"threads = {threads}: must be at least 1")
        self.threads = threads
        self.pool = ThreadPoolExecutor(threads - 1) if threads > 1 else None

    def share(self, work: Callable, ranges):
        """Call work(range, thread) for each range, no two at a time with the same thread; returns the results in order."""
        if self.pool is None or len(ranges) < 2:
            return [work(part, 0) for part in ranges]
        found = []
        for begin in range(0, len(ranges), self.threads):
            mine, *others = ranges[begin : begin + self.threads]
            waiting = [self.pool.submit(work, part, thread) for thread, part in enumerate(others, 1)]
            try:
                found.append(work(mine, 0))
            finally:
                wait(waiting)
            found += [other.result() for other in waiting]
        return found
