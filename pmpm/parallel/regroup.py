"""Regroup: every particle joins the layer it lies in and moves to that layer's rank; migration and sorting are one event."""

import numpy as np

from pmpm.state.particles import Cloud


def settle(cloud, geometry):
    """Make the node each particle is nearest to its home; wrap periodic axes. Exact: the offset changes by whole cells."""
    dim = geometry.dim
    steps = np.floor(cloud.reals[:, :dim] + cloud.reals.dtype.type(geometry.stencil.round))
    cloud.reals[:, :dim] -= steps
    cloud.node += steps.astype(np.int32)
    for axis in range(dim):
        if geometry.periodic[axis]:
            cloud.node[:, axis] %= geometry.cells[axis]
    return cloud


def migrate(clouds, slab_axis, slabs, comm):
    """Give every particle to the rank of its layer. Returns (clouds, particles this rank sent to each rank).

    Pieces are joined in the order of the ranks they come from, which is the one global order they had before.
    """
    sent = np.zeros(comm.size, np.int64)
    if comm.size == 1:
        return clouds, sent
    pieces: list[list[bytes]] = [[] for _ in range(comm.size)]
    for cloud in clouds:
        owner = slabs.owner(cloud.node[:, slab_axis])
        for rank in range(comm.size):
            leaving = np.flatnonzero(owner == rank)
            pieces[rank] += [np.int64(len(leaving)).tobytes(), cloud.take(leaving).to_bytes()]
            sent[rank] += len(leaving)
    sent[comm.rank] = 0
    received = comm.exchange_pieces([b"".join(piece) for piece in pieces])

    arrived: list[list[Cloud]] = [[] for _ in clouds]
    for data in received:
        for number, cloud in enumerate(clouds):
            size, dim, real = cloud.reals.shape[1], cloud.node.shape[1], cloud.reals.dtype
            count = int(data[:8].view(np.int64)[0])
            length = 8 + count * (size * real.itemsize + 4 * dim + 4 + 8)
            arrived[number].append(Cloud.from_bytes(data[8:length], count, size, dim, real))
            data = data[length:]
    return [Cloud.join(parts) for parts in arrived], sent
