"""What a checkpoint costs beside a plain sequential write of as many bytes to the same disk, by turns in one process.

python benchmarks/checkpoints.py [--cells 128] [--every 100] [--rounds 9] [--folder .]
mpirun -n 2 python benchmarks/checkpoints.py ...

Workload W1 of docs/results/kernels.md: a million particles of jelly in 3-D. A checkpoint counts from the call to its return:
gathering, checksums, writing, waiting for the disk, the manifest. The plain write is of one array in memory, by one process, to
one file, waiting for the disk. Older files are deleted before, and the disk is idle when either begins. Reports medians.
"""

import argparse
import statistics
import sys
import tempfile
import time
from pathlib import Path
from types import SimpleNamespace

sys.path.insert(0, str(Path(__file__).parent / "peers"))
sys.path.insert(0, str(Path(__file__).parent))

import os  # noqa: E402

import numpy as np  # noqa: E402
from laws import machine  # noqa: E402
from pmpm_mpm import PmpmSteps  # noqa: E402
from stages import Progress  # noqa: E402
from workloads import Workload  # noqa: E402

from pmpm.output.checkpoints import CheckpointWriter  # noqa: E402
from pmpm.parallel import comm as communication  # noqa: E402


def plain_write(path, data):
    """Seconds to write bytes one after another, until they are on the disk."""
    began = time.perf_counter()
    with open(path, "wb", buffering=0) as file:
        waiting = memoryview(data)
        while len(waiting):
            waiting = waiting[file.write(waiting) :]
        os.fsync(file.fileno())
    return time.perf_counter() - began


def clear(folder, comm):
    """Delete what there is and wait until the disk has nothing left to do."""
    if comm.rank == 0:
        for path in [path for path in folder.rglob("*") if path.is_file()]:
            path.unlink()
        os.sync()
    comm.barrier()


def measure(precision, given, comm, folder, progress):
    """(bytes, s per checkpoint, s per plain write, s per step), medians over rounds."""
    steps = PmpmSteps(
        Workload("W1", given.cells), precision, "quadratic", False, False, getattr(comm, "communicator", None)
    )
    steps.start(fast=False)
    simulation = steps.simulation
    writer = CheckpointWriter(SimpleNamespace(path=folder, comm=comm), keep=2)
    checkpoints, plain, stepping, data = [], [], [], None
    for number in range(given.rounds + 1):  # the first one compiles
        began = time.perf_counter()
        for _ in range(given.every):
            simulation.step()
        stepping.append((time.perf_counter() - began) / given.every)
        clear(folder, comm)
        began = time.perf_counter()
        writer(simulation)
        comm.barrier()
        checkpoints.append(time.perf_counter() - began)
        size = writer.newest.stat().st_size
        clear(folder, comm)
        if comm.rank == 0:
            data = np.random.default_rng(0).integers(0, 256, size, np.uint8) if data is None else data
            plain.append(plain_write(folder / "plain", data[:size]))
            progress.tell(f"{precision}, round {number}: {checkpoints[-1]:.3f} s, plain {plain[-1]:.3f} s")
        comm.barrier()
    return size, *(statistics.median(times[1:]) if times else 0.0 for times in (checkpoints, plain, stepping))


def main():
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--cells", type=int, default=128)
    options.add_argument("--every", type=int, default=100)
    options.add_argument("--rounds", type=int, default=9)
    options.add_argument("--folder", type=Path, default=Path(), help="on the disk to be measured")
    given = options.parse_args()
    comm = communication.from_launcher()
    folder = comm.broadcast(Path(tempfile.mkdtemp(dir=given.folder)))
    progress = Progress(2 * (given.rounds + 1))
    rows = []
    for precision in ("float32", "float64"):
        size, checkpoint, plain, step = measure(precision, given, comm, folder, progress)
        share = f"{plain / checkpoint:.0%}" if plain else ""
        cost = f"{checkpoint / (given.every * step):.1%}"
        rows.append(
            f"| {precision} | {comm.size} | {size / 1e6:.0f} | {checkpoint:.3f} | {plain:.3f} | {share} | {cost} |"
        )
        clear(folder, comm)
    if comm.rank == 0:
        print("\n".join(machine()))
        print(
            "| precision | ranks | MB | checkpoint, s | plain write, s | share of its bandwidth | of the steps between |"
        )
        print("|---|---|---|---|---|---|---|")
        print("\n".join(rows))


if __name__ == "__main__":
    main()
