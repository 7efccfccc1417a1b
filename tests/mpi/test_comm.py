"""The verbs of communication mean the same on one process alone, on one rank of MPI, and on several ranks."""

import numpy as np
import pytest
from mpi4py import MPI

from pmpm.parallel import comm as communication
from pmpm.parallel.comm import Alone, World, adopt

pytestmark = pytest.mark.mpi(min_size=2)

EVERYWHERE = pytest.mark.parametrize(
    "comm", [Alone(), World(MPI.COMM_SELF), World(MPI.COMM_WORLD)], ids=["alone", "self", "world"]
)


def by_rank(comm, width=4):
    """(ranks, width) numbers that every rank can compute: row r is what rank r contributes."""
    return np.random.default_rng(5).standard_normal((comm.size, width))


@EVERYWHERE
def test_max_is_over_all_ranks(comm):
    values = by_rank(comm)
    assert comm.max(values[comm.rank]).tolist() == values.max(axis=0).tolist()


@EVERYWHERE
def test_a_maximum_that_was_started_earlier_is_over_all_ranks(comm):
    values = by_rank(comm)
    handle = comm.start_max(values[comm.rank])
    assert comm.finish(handle).tolist() == values.max(axis=0).tolist()


@EVERYWHERE
def test_maxima_on_their_way_at_once_do_not_mix(comm):
    values = by_rank(comm, 5)
    handles = [comm.start_max(values[comm.rank, n : n + 1]) for n in range(5)]
    found = [comm.finish(handle)[0] for handle in reversed(handles)]
    assert found == values.max(axis=0)[::-1].tolist()


@EVERYWHERE
def test_a_started_maximum_is_of_the_values_at_its_start(comm):
    values = by_rank(comm)[comm.rank].copy()
    handle = comm.start_max(values)
    values[:] = 1e9
    assert comm.finish(handle).max() < 1e9


@EVERYWHERE
def test_sum_of_integers_is_over_all_ranks(comm):
    assert comm.sum(np.array([comm.rank + 1, 1])).tolist() == [comm.size * (comm.size + 1) // 2, comm.size]


@EVERYWHERE
def test_sum_of_disjoint_contributions_keeps_every_bit(comm):
    values = by_rank(comm, 50)[0]
    own = np.where(np.arange(50) % comm.size == comm.rank, values, 0.0)
    assert comm.sum(own).tobytes() == values.tobytes()


@EVERYWHERE
def test_reductions_leave_what_they_were_given_alone(comm):
    values = np.full(3, float(comm.rank))
    comm.sum(values)[:] = 7.0
    comm.max(values)[:] = 7.0
    assert values.tolist() == [comm.rank] * 3


@EVERYWHERE
def test_offsets_number_the_rows_of_all_ranks(comm):
    counts = [3 + 2 * rank for rank in range(comm.size)]
    assert comm.offsets(counts[comm.rank]) == (sum(counts[: comm.rank]), sum(counts))


@EVERYWHERE
def test_gather_lists_by_rank(comm):
    assert comm.gather(("of", comm.rank)) == [("of", rank) for rank in range(comm.size)]


@EVERYWHERE
def test_broadcast_tells_what_rank_zero_says(comm):
    assert comm.broadcast({"rank": comm.rank}) == {"rank": 0}


@EVERYWHERE
def test_counts_reach_the_rank_they_are_for(comm):
    told = np.array([[10 * comm.rank + taker, 2**40 + taker] for taker in range(comm.size)])
    heard = comm.exchange_counts(told)
    assert heard.tolist() == [[10 * giver + comm.rank, 2**40 + comm.rank] for giver in range(comm.size)]


@pytest.mark.parametrize("longest", [1, 7, 1 << 30])
@EVERYWHERE
def test_messages_of_any_length_arrive_whole(comm, longest, monkeypatch):
    """Of 0, 3, 6, ... bytes, in pieces of `longest` bytes at most, two of them between the same ranks."""
    monkeypatch.setattr(communication, "MESSAGE", longest)

    def message(giver, taker, tag):
        return np.full(3 * (giver + taker), 16 * giver + taker + 100 * tag, np.uint8)

    others = [rank for rank in range(comm.size) if rank != comm.rank]
    sends = [(rank, tag, message(comm.rank, rank, tag)) for rank in others for tag in (0, 1)]
    taken = {(rank, tag): np.zeros(3 * (rank + comm.rank), np.uint8) for rank in others for tag in (0, 1)}
    comm.deliver(sends, [(rank, tag, array) for (rank, tag), array in taken.items()])
    wrong = [key for key, array in taken.items() if not np.array_equal(array, message(key[0], comm.rank, key[1]))]
    assert wrong == []


def test_a_message_beyond_what_mpi_counts_is_cut_without_a_gap():
    """5 GiB that nobody writes: pieces of at most 2^30 bytes, whose ends meet."""
    cut = communication.in_pieces([(1, 2, np.empty(5 * 2**30 + 3, np.uint8))])
    lengths = [len(array) for _, _, array in cut]
    assert lengths == [2**30] * 5 + [3]
    assert {(peer, tag) for peer, tag, _ in cut} == {(1, 2)}


@EVERYWHERE
def test_a_message_to_oneself_arrives(comm):
    given, taken = np.arange(4.0), np.zeros(4)
    messages = comm.exchange([(comm.rank, 3, given)], [(comm.rank, 3, taken)])
    for _ in range(2):  # the same messages again, with what is there then
        given += 1.0
        messages.start()
        messages.finish()
        assert taken.tolist() == given.tolist()


@EVERYWHERE
def test_messages_around_a_ring_are_told_apart_by_tag(comm):
    left, right = (comm.rank - 1) % comm.size, (comm.rank + 1) % comm.size
    to_right, to_left = np.full(2, 10.0 + comm.rank), np.full(2, 20.0 + comm.rank)
    from_left, from_right = np.zeros(2), np.zeros(2)
    sends, receives = [(right, 0, to_right), (left, 1, to_left)], [(right, 1, from_right), (left, 0, from_left)]
    messages = comm.exchange(sends, receives)
    messages.start()
    messages.finish()
    assert (from_left.tolist(), from_right.tolist()) == ([10.0 + left] * 2, [20.0 + right] * 2)


def test_a_users_communicator_becomes_a_world():
    comm = adopt(MPI.COMM_WORLD)
    assert (comm.rank, comm.size) == (MPI.COMM_WORLD.rank, MPI.COMM_WORLD.size)


def test_no_communicator_means_alone_on_every_rank():
    assert adopt(None).size == 1
