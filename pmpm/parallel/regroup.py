"""Regroup: every particle joins the layer it lies in and moves to that layer's rank; migration and sorting are one event."""

import numpy as np

from pmpm.kernels.places import NEAR
from pmpm.state.assembly import Arrivals
from pmpm.state.particles import Cloud


def partners(before, after, rank, periodic):
    """(ranks that this one may send to, ranks that may send to it), when layers are cut at edges `after` and were at `before`:
    nobody goes farther than to a near layer."""
    before, after = np.array(before), np.array(after)

    def meet(first, last, firsts, lasts):
        near = np.zeros(len(before) - 1, bool)
        for around in (-before[-1], 0, before[-1]) if periodic else (0,):
            near |= (first - NEAR + around < lasts) & (firsts < last + NEAR + around)
        return np.flatnonzero(near & (first < last) & (firsts < lasts))

    to = meet(before[rank], before[rank + 1], after[:-1], after[1:])
    coming = meet(after[rank], after[rank + 1], before[:-1], before[1:])
    return [int(r) for r in to if r != rank], [int(r) for r in coming if r != rank]


def migrate(clouds, upwards, slab_axis, edges, comm, to=None, coming=None):
    """Give every particle of a Cloud of each law, in the one global order, to the rank of its layer, as `edges` cut them.

    `upwards`, of each law and particle: whether who goes to this rank itself comes before those that it already holds. `to`,
    `coming`: ranks that may be sent to and may send, None for all. Returns the Arrivals of each law and how many particles
    this rank sent to each rank, (ranks, laws). Joined in the order of the ranks, that is the one global order they had.
    """
    sent, rank = np.zeros((comm.size, len(clouds)), np.int64), comm.rank
    leaving, own = [], []
    for law, (cloud, up) in enumerate(zip(clouds, upwards, strict=True)):
        owner = np.searchsorted(edges[1:], cloud.node[:, slab_axis], side="right")
        own.append([cloud.take(np.flatnonzero((owner == rank) & side)) for side in (up, ~up)])
        if len(owner) and np.any(np.diff(owner) < 0):
            order = np.argsort(owner, kind="stable")
            cloud, owner = cloud.take(order), owner[order]
        ranks, counts = np.unique(owner, return_counts=True)
        starts = np.cumsum(counts) - counts
        pieces = {
            int(to_rank): cloud.rows(first, first + count)
            for to_rank, first, count in zip(ranks, starts, counts, strict=True)
            if to_rank != rank
        }
        leaving.append(pieces)
        for other, piece in pieces.items():
            sent[other, law] = len(piece)
    strangers = np.flatnonzero(sent.sum(axis=1)) if to is None else np.setdiff1d(np.flatnonzero(sent.sum(axis=1)), to)
    if to is not None and len(strangers):
        raise RuntimeError(f"particles of rank {rank} belong to the ranks {strangers}, too far from where they were")
    counts = comm.exchange_counts(sent) if to is None else exchange_counts(sent, comm, to, coming)

    arrived, sends, receives = [], [], []
    for law, (cloud, (low, high)) in enumerate(zip(clouds, own, strict=True)):
        below, above = int(counts[:rank, law].sum()), int(counts[rank + 1 :, law].sum())
        before, after = below + len(low), len(high) + above
        size, dim, real = cloud.reals.shape[1], cloud.node.shape[1], cloud.reals.dtype
        joined = Cloud.room(before + after, size, dim, real)
        place = 0
        for r in np.flatnonzero(counts[:, law] | (np.arange(comm.size) == rank)):
            if r == rank:
                for mine in (low, high):
                    for part, values in zip(joined.rows(place, place + len(mine)).parts, mine.parts, strict=True):
                        part[:] = values
                    place += len(mine)
            else:
                here = joined.rows(place, place + int(counts[r, law]))
                receives += [(int(r), 4 * law + k, as_bytes(part)) for k, part in enumerate(here.parts)]
                place += len(here)
        sends += [
            (r, 4 * law + k, as_bytes(part)) for r, piece in leaving[law].items() for k, part in enumerate(piece.parts)
        ]
        arrived.append(Arrivals(joined, before))
    comm.deliver(sends, receives)
    return arrived, sent


def as_bytes(array):
    return array.reshape(-1).view(np.uint8)


def exchange_counts(sent, comm, to, coming):
    """(ranks, laws) what each rank sends to this one: only ranks that may send are heard."""
    found = np.zeros_like(sent)
    sends = [(r, 0, as_bytes(np.ascontiguousarray(sent[r]))) for r in to]
    comm.deliver(sends, [(r, 0, as_bytes(found[r])) for r in coming])
    return found
