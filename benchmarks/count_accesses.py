"""Counts what P2G and G2P on a graphics card read, write and add, in the simulator.

    python benchmarks/count_accesses.py W1 tiled|direct

Started by gpu.py with NUMBA_ENABLE_CUDASIM=1, which has to be set before numba is imported. Every access of a kernel to an
array of the card is counted, element by element, with the bytes of the element; prints a line of JSON.
"""

import json
import sys
import threading
from collections import Counter

from gpu import small_block
from numba.cuda.simulator.cudadrv import devicearray
from numba.cuda.simulator.kernelapi import FakeCUDAAtomic

import pmpm
from pmpm.processors.cuda import Cuda

COUNTS: Counter = Counter()
PHASE = ["none"]
ONE_AT_A_TIME = threading.Lock()  # the simulator's threads are threads
# Whether this thread is inside an atomic, which reads and writes the element that it adds to.
WITHIN = threading.local()


def counted(kind, original, element):
    def access(self, *arguments):
        if getattr(WITHIN, "atomic", False):
            return original(self, *arguments)
        with ONE_AT_A_TIME:
            COUNTS[PHASE[0], kind] += element(self, arguments)
        WITHIN.atomic = kind.startswith("atomic")
        try:
            return original(self, *arguments)
        finally:
            WITHIN.atomic = False

    return access


def itemsize(array):
    return getattr(array, "_item", array).dtype.itemsize


def in_memory(array):
    """Whether an array lies in the card's memory: those that a block of threads shares are bare."""
    return isinstance(array, devicearray.FakeWithinKernelCUDAArray)


def watch():
    """Count from now on."""
    within = devicearray.FakeWithinKernelCUDAArray
    within.__getitem__ = counted("bytes read", within.__getitem__, lambda array, _: itemsize(array))
    within.__setitem__ = counted("bytes written", within.__setitem__, lambda array, _: itemsize(array))
    for name in ("add", "max", "min", "or_"):
        original = getattr(FakeCUDAAtomic, name)
        setattr(FakeCUDAAtomic, name, counted(f"atomic {name}", original, lambda _, arguments: in_memory(arguments[0])))


def main():
    Cuda.tiled = sys.argv[2] == "tiled"
    simulation = pmpm.Simulation(small_block(sys.argv[1]), backend="cuda")
    simulation.step()
    watch()
    processor, particles = simulation.processor, simulation.rows()
    for phase in ("p2g", "g2p"):
        original = getattr(processor, phase)

        def in_phase(*arguments, phase=phase, original=original):
            PHASE[0] = phase
            found = original(*arguments)
            PHASE[0] = "rest"
            return found

        setattr(processor, phase, in_phase)
    simulation.step()
    found = {f"{phase} {kind}": count / particles for (phase, kind), count in sorted(COUNTS.items())}
    print(json.dumps({"particles": particles, **found}))


if __name__ == "__main__":
    main()
