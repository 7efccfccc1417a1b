"""Seconds that a message takes from one rank to another and half of the way back, by size.

    mpirun -n 2 python benchmarks/ping_pong.py

Prints [[bytes, seconds], ...] as JSON: medians over repeats of half of a round trip.
"""

import json
import statistics
import sys
import time

import numpy as np

SIZES = (8, 256, 4096, 65536, 1 << 20, 4 << 20)
REPEATS, WARM_UP = 200, 20


def half_round_trip(comm, size):
    """s, the median; rank 0 measures."""
    data, found = np.zeros(size, np.uint8), []
    for _ in range(REPEATS + WARM_UP):
        comm.Barrier()
        began = time.perf_counter()
        if comm.rank == 0:
            comm.Send(data, 1)
            comm.Recv(data, 1)
        else:
            comm.Recv(data, 0)
            comm.Send(data, 0)
        found.append((time.perf_counter() - began) / 2.0)
    return statistics.median(found[WARM_UP:])


def main():
    from mpi4py import MPI

    comm = MPI.COMM_WORLD
    if comm.size != 2:
        print(f"ping_pong: wants 2 ranks, not {comm.size}", file=sys.stderr)
        return 2
    found = [(size, half_round_trip(comm, size)) for size in SIZES]
    if comm.rank == 0:
        print(json.dumps(found))
    return 0


if __name__ == "__main__":
    sys.exit(main())
