"""`pmpm` with one rank that ends itself by SIGKILL at a given moment:  kill_one_rank.py RANK MOMENT NUMBER SHARE -- ARGUMENTS

MOMENT step: before its step NUMBER; write: in its NUMBERth writing of rows to a file, after SHARE of the bytes; rename: between
the NUMBERth checkpoint file and its manifest; never: not at all, for kills from outside. Every rank leaves its process number,
and if it lives how many writings of rows there were.
"""

import os
import signal
import sys
from pathlib import Path

from pmpm import cli
from pmpm.output import checkpoints, datasets
from pmpm.parallel import comm as communication
from pmpm.simulation import Simulation


def die():
    os.kill(os.getpid(), signal.SIGKILL)


def before_call(number, action, function):
    """`function`, but `action` comes before its call of that number, or before each (None)."""
    calls = iter(range(1, 1 << 60))

    def counted(*arguments, **keywords):
        if next(calls) == number or number is None:
            action(*arguments)
        return function(*arguments, **keywords)

    return counted


def prepare(moment, number, share):
    def write_a_part(descriptor, rows, place):
        data = memoryview(rows.reshape(-1)).cast("B")
        os.pwrite(descriptor, data[: max(1, int(share * len(data)))], place)
        die()

    if moment == "step":
        Simulation.advance = before_call(number, lambda *_: die(), Simulation.advance)
    elif moment == "write":
        datasets.write_bytes = before_call(number, write_a_part, datasets.write_bytes)
    elif moment == "rename":
        checkpoints.write_manifest = before_call(number, lambda *_: die(), checkpoints.write_manifest)


if __name__ == "__main__":
    victim, moment, number, share = int(sys.argv[1]), sys.argv[2], int(sys.argv[3]), float(sys.argv[4])
    rank = communication.from_launcher().rank
    Path(f"pid.{rank}").write_text(str(os.getpid()))
    if rank == victim:
        prepare(moment, number, share)
    writes: list[object] = []
    datasets.write_bytes = before_call(None, lambda *_: writes.append(None), datasets.write_bytes)
    status = cli.main(sys.argv[6:])
    Path(f"writes.{rank}").write_text(str(len(writes)))
    sys.exit(status)
