"""Verbs of communication; the only file that imports mpi4py.

One process alone (`Alone`) and an MPI communicator (`World`) answer the same verbs, so that nothing above asks which one
it has. A message is addressed by peer and tag; a message to oneself is legal (a periodic axis on one rank).
"""

import ctypes
import os
import sys
from typing import ClassVar

import numpy as np

LAUNCHER_SIZE = ("PMI_SIZE", "OMPI_COMM_WORLD_SIZE", "PMIX_SIZE", "MV2_COMM_WORLD_SIZE", "SLURM_STEP_NUM_TASKS")
LAUNCHER_RANK = ("PMI_RANK", "OMPI_COMM_WORLD_RANK", "PMIX_RANK", "MV2_COMM_WORLD_RANK", "SLURM_PROCID")
ADVICE = (
    f"Use the mpirun that stands beside this Python ({os.path.join(os.path.dirname(sys.executable), 'mpirun')}), or build "
    "mpi4py against the launcher's MPI."
)
MESSAGE = 1 << 30  # bytes: MPI counts them in 32 bits


class LaunchError(Exception):
    """The launcher started a number of processes that MPI does not know of."""


class Alone:
    """One process that is the whole world: every reduction is the identity."""

    rank, size = 0, 1

    def reaches_cards(self):
        """Whether messages may lie in the memory of graphics cards. Collective."""
        return False

    def exchange(self, sends, receives):
        """Ready messages that are sent again and again: `sends` and `receives` are lists of (peer, tag, contiguous array of
        bytes); an array to receive into may be longer than what comes. The answer has `start` and `finish`."""
        return ToOneself(sends, receives)

    def finish(self, handle):
        """Wait for what `start_max` or `start_sum` posted."""
        return handle

    def start_max(self, values):
        """Begin an elementwise maximum over ranks of a float64 array; `finish` returns it."""
        return values.copy()

    def start_sum(self, values):
        """Begin an elementwise sum over ranks of an integer array; `finish` returns it."""
        return values.copy()

    def max(self, values):
        """Elementwise maximum over ranks."""
        return np.array(values)

    def sum(self, values):
        """Elementwise sum over ranks. Independent of the rank count only for integers or disjoint contributions."""
        return np.array(values)

    def deliver(self, sends, receives):
        """Exchange messages, lists of (peer, tag, contiguous array of bytes), both sides knowing how long each one is. What is
        longer than MESSAGE goes in pieces."""
        ToOneself(sends, receives).start()

    def exchange_counts(self, counts):
        """(ranks, n) integers that this rank tells each rank; returns what each rank tells this one."""
        return counts

    def offsets(self, count):
        """(where this rank's `count` rows begin in the one global order, how many there are over all ranks)."""
        return 0, int(count)

    def gather(self, value):
        """List of every rank's `value` (any picklable object), on every rank."""
        return [value]

    def broadcast(self, value):
        """Rank 0's `value` (any picklable object) on every rank."""
        return value

    def barrier(self):
        pass

    def abort(self, status):
        """End every rank at once."""
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)


class ToOneself:
    """Messages of one process to itself, across the seam of a periodic axis."""

    def __init__(self, sends, receives):
        into = {tag: array for _, tag, array in receives}
        self.copies = [(into[tag][: len(array)], array) for _, tag, array in sends]

    def start(self):
        for into, array in self.copies:
            into[:] = array

    def finish(self):
        pass


class Exchange:
    """The same few messages over MPI, with persistent requests: a step allocates nothing."""

    def __init__(self, world, sends, receives):
        self.mpi = world.mpi
        self.requests = [world.communicator.Recv_init(array, peer, tag) for peer, tag, array in receives]
        self.requests += [world.communicator.Send_init(array, peer, tag) for peer, tag, array in sends]

    def start(self):
        self.mpi.Prequest.Startall(self.requests)

    def finish(self):
        self.mpi.Request.Waitall(self.requests)

    def __del__(self):
        if not self.mpi.Is_finalized():
            for request in self.requests:
                request.Free()


class World:
    """The same verbs over an mpi4py communicator."""

    on_the_way: ClassVar[list] = []

    def __init__(self, communicator):
        from mpi4py import MPI

        self.mpi, self.communicator = MPI, communicator
        self.rank, self.size = communicator.rank, communicator.size

    def reaches_cards(self):
        """PMPM_HALO = card or host says so, else the MPI."""
        said = os.environ.get("PMPM_HALO")
        mine = said == "card" if said else asked_for_cards(self.mpi)
        return all(self.gather(mine))

    def exchange(self, sends, receives):
        return Exchange(self, sends, receives)

    def finish(self, handle):
        requests, result = handle
        self.mpi.Request.Waitall(requests)
        return result

    def start_max(self, values):
        return self.start_reduction(values, self.mpi.MAX)

    def start_sum(self, values):
        return self.start_reduction(values, self.mpi.SUM)

    def start_reduction(self, values, operation):
        values, result = values.copy(), np.empty_like(values)
        request = self.communicator.Iallreduce(values, result, operation)
        # A simulation that is dropped leaves reductions behind: MPI may still write to their buffers.
        World.on_the_way = [entry for entry in World.on_the_way if not entry[0].Test()]
        World.on_the_way.append((request, values, result))
        return [request], result

    def max(self, values):
        return self.allreduce(values, self.mpi.MAX)

    def sum(self, values):
        return self.allreduce(values, self.mpi.SUM)

    def allreduce(self, values, operation):
        values = np.ascontiguousarray(values)
        result = np.empty_like(values)
        self.communicator.Allreduce(values, result, operation)
        return result

    def deliver(self, sends, receives):
        requests = [self.communicator.Irecv(array, peer, tag) for peer, tag, array in in_pieces(receives)]
        requests += [self.communicator.Isend(array, peer, tag) for peer, tag, array in in_pieces(sends)]
        self.mpi.Request.Waitall(requests)

    def exchange_counts(self, counts):
        counts = np.ascontiguousarray(counts)
        incoming = np.empty_like(counts)
        self.communicator.Alltoall(counts, incoming)
        return incoming

    def offsets(self, count):
        counts = self.communicator.allgather(int(count))
        return sum(counts[: self.rank]), sum(counts)

    def gather(self, value):
        return self.communicator.allgather(value)

    def broadcast(self, value):
        return self.communicator.bcast(value)

    def barrier(self):
        self.communicator.Barrier()

    def abort(self, status):
        sys.stdout.flush()
        sys.stderr.flush()
        self.communicator.Abort(status)


def asked_for_cards(mpi):
    """What the MPI library answers to MPIX_Query_cuda_support (Open MPI, MPICH); False where it knows no such question."""
    query = getattr(ctypes.CDLL(mpi.__file__), "MPIX_Query_cuda_support", None)
    return bool(query is not None and query())


def in_pieces(messages):
    """The same messages, none longer than MESSAGE: between two ranks those of one tag arrive in their order."""
    return [
        (peer, tag, array[first : first + MESSAGE])
        for peer, tag, array in messages
        for first in range(0, max(len(array), 1), MESSAGE)
    ]


def launched(names):
    """The integer the process launcher left in the environment under one of `names`, or None."""
    return next((int(os.environ[name]) for name in names if os.environ.get(name, "").isdigit()), None)


def begun_mpi(size):
    """mpi4py's MPI. An MPICH without PMIx that Open MPI's launcher has started would end the process in MPI_Init with an abort
    of its own: LaunchError before."""
    import mpi4py

    by_open_mpi = "OMPI_COMM_WORLD_SIZE" in os.environ and "PMI_SIZE" not in os.environ
    if not by_open_mpi or "mpi4py.MPI" in sys.modules:
        from mpi4py import MPI

        return MPI
    mpi4py.rc.initialize, mpi4py.rc.finalize = False, True
    from mpi4py import MPI

    library = MPI.Get_library_version()
    if "mpich" in library.lower() and "pmix" not in library.lower():
        raise LaunchError(
            f"the launcher that started {size} processes is Open MPI's, but mpi4py belongs to {MPI.get_vendor()[0]}. {ADVICE}"
        )
    MPI.Init_thread()
    return MPI


def from_launcher():
    """The world this process was launched into: `Alone` without a launcher (mpi4py is not imported), else `World`.

    Raises LaunchError if MPI is missing, or cannot be that of the launcher, or reports another number of processes than were
    launched.
    """
    size = launched(LAUNCHER_SIZE)
    if size is None or size <= 1:
        return Alone()
    try:
        MPI = begun_mpi(size)  # noqa: N806
    except ImportError as error:
        raise LaunchError(
            f"{size} processes were launched but mpi4py cannot be loaded ({error}). Install it into this environment: "
            "pip install 'pmpm[mpi]', or on a cluster pip install mpi4py against the MPI there."
        ) from error
    if MPI.COMM_WORLD.size != size:
        raise LaunchError(
            f"the launcher started {size} processes but MPI reports a world of {MPI.COMM_WORLD.size}: mpirun and mpi4py "
            f"belong to different MPI libraries. {ADVICE}"
        )
    return World(MPI.COMM_WORLD)


def adopt(communicator):
    """Verbs for what a user passed as `comm`: None, an mpi4py communicator, or verbs already."""
    if communicator is None:
        return Alone()
    if isinstance(communicator, Alone | World):
        return communicator
    return World(communicator)
