"""Regroup: every particle joins the layer it lies in and moves to that layer's rank; migration and sorting are one event."""

import numpy as np

from pmpm.state.particles import Cloud


def migrate(loose, slab_axis, slabs, comm):
    """Give every particle to the rank of its layer.

    `loose`: of each law; what leaves is taken out. Returns (what arrived from lower ranks, from higher ranks) of each law and
    how many particles this rank sent to each rank. Joined in the order of the ranks, that is the one global order they had.
    """
    sent = np.zeros(comm.size, np.int64)
    nothing = [loose_of_law.take(np.zeros(0, np.int64)) for loose_of_law in loose]
    if comm.size == 1:
        return [(cloud, cloud) for cloud in nothing], sent
    pieces: list[list[bytes]] = [[] for _ in range(comm.size)]
    for particles in loose:
        owner = slabs.owner(particles.homes[slab_axis])
        stays = owner == comm.rank
        leaving = np.flatnonzero(~stays)
        goes_to = owner[leaving]  # few, so that a look for each rank costs little
        for rank in range(comm.size):
            rows = leaving[goes_to == rank]
            pieces[rank] += [np.int64(len(rows)).tobytes(), particles.take(rows).to_bytes()]
            sent[rank] += len(rows)
        particles.keep(stays)
    received = comm.exchange_pieces([b"".join(piece) for piece in pieces])

    arrived: list[tuple[list[Cloud], list[Cloud]]] = [([cloud], [cloud]) for cloud in nothing]
    for rank, data in enumerate(received):
        for number, cloud in enumerate(nothing):
            size, dim, real = cloud.reals.shape[1], cloud.node.shape[1], cloud.reals.dtype
            count = int(data[:8].view(np.int64)[0])
            length = 8 + count * (size * real.itemsize + 4 * dim + 4 + 8)
            side = 0 if rank < comm.rank else 1
            arrived[number][side].append(Cloud.from_bytes(data[8:length], count, size, dim, real))
            data = data[length:]
    return [(Cloud.join(lower), Cloud.join(higher)) for lower, higher in arrived], sent
