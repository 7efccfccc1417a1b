"""Who is sent where at a regroup, as one rank of three sees it."""

import numpy as np

from pmpm.parallel.regroup import migrate
from pmpm.parallel.slabs import Slabs
from pmpm.state.particles import Cloud, Loose

SLABS = Slabs(30, False, 2, 2, (0, 10, 20, 30))


class Middle:
    """Rank 1 of 3, to which the others send nothing; `pieces`: what it gave to each."""

    rank, size = 1, 3

    def exchange_pieces(self, pieces):
        self.pieces = pieces
        return [np.zeros(8, np.uint8) for _ in pieces]


def ids_of(piece, count):
    """Of the particles in a piece, which begins with their number."""
    assert np.frombuffer(piece[:8], np.int64) == [count]
    return Cloud.from_bytes(np.frombuffer(piece[8:], np.uint8), count, 3, 2, np.dtype(np.float64)).id


def test_every_particle_goes_to_the_rank_of_its_layer_in_order():
    layers = np.array([12, 9, 25, 10, 0, 19, 20, 9])
    ids = np.arange(len(layers))
    node = np.stack([layers, layers], axis=1).astype(np.int32)
    loose = Loose.of_rows(Cloud(np.zeros((len(layers), 3)), node, np.zeros(len(layers), np.int32), ids))
    comm = Middle()
    _, sent = migrate([loose], 0, SLABS, comm)
    lower, higher = (ids_of(comm.pieces[rank], count) for rank, count in ((0, 3), (2, 2)))
    assert (list(lower), list(higher), list(ids[loose.source])) == ([1, 4, 7], [2, 6], [0, 3, 5])
    assert list(sent) == [3, 0, 2]
    assert len(comm.pieces[1]) == 8
