"""How many particles fit: memory, speed and files of a big run, phase by phase.

    mpirun -n 2 python benchmarks/big_run.py [--particles 1e8] [--steps 5] [--folder .] [--docs docs]
    mpirun -n 2 python benchmarks/big_run.py --quick

A block of water in a box, 3-D, float32, 8 particles per cell: it is seeded, makes some steps, is regrouped twice, once with
cuts moved by a twentieth, written as a snapshot and as a checkpoint, dropped, restarted from the checkpoint, and goes on.
Memory is the largest resident size of each rank during a phase, beyond what a small run of the same scene left (interpreter,
kernels) and the arrays of the grid, over the bytes that its particles hold in blocks. Gates: at most 1.25 of them, judged from
a million particles per rank on; and after the restart the run measures the same totals, bit for bit, as the one that went on.
The files, about 170 bytes a particle, lie in a folder of their own that is deleted at the end; --quick takes a million.
"""

import argparse
import gc
import math
import shutil
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

import pages

sys.path.insert(0, str(Path(__file__).parent))

import numpy as np
from machine import text as machine_text
from stages import Progress

import pmpm
from pmpm.output.datasets import default_parallel
from pmpm.output.snapshots import write_snapshot
from pmpm.parallel import comm as communication
from pmpm.simulation import Simulation

MOST, JUDGED_FROM = 1.25, 1_000_000  # of the bytes held; particles per rank
FILE_BYTES = 200  # per particle, of both files and something to spare
FIELDS = ("velocity", "pressure", "material")
PHASES = 9

PAGE = """# A big run

`mpirun -n {ranks} python benchmarks/big_run.py --particles {asked:g} --steps {steps} --docs docs` wrote this page.
{machine}.

{particles:,} particles of water, 3-D, float32, quadratic splines, APIC, 8 per cell, {held:.1f} bytes each in their blocks.
Memory: the largest resident size of any rank during a phase, beyond interpreter and kernels ({base:.0f} MB) and grid
({grid:.0f} MB), over the bytes that its particles hold. Gate: at most {most}; {judged}.

| phase | s | ns per particle | most memory over bytes held | peak of a rank, MB | file, MB/s |
|---|---|---|---|---|---|
{rows}

{restart}
"""


def scene(particles):
    """A block of about so many particles, twice as long as wide, with room above and on one side."""
    wide = max(round((particles / 16.0) ** (1.0 / 3.0)), 6)
    cell = 1.0 / wide
    size = [(2 * wide + wide // 8) * cell, 1.0, (wide + wide // 8) * cell]
    return pmpm.Scene(
        domain={"size": size, "cell_size": cell, "gravity": [0.0, 0.0, -9.81]},
        method={"precision": "float32"},
        time={"end": 1.0},
        materials={"water": {"model": "fluid", "density": 1000.0, "sound_speed": 30.0}},
        bodies=[
            {
                "material": "water",
                "shape": {"type": "box", "min": [0.0, 0.0, 0.0], "max": [2.0, 1.0, 1.0]},
                "particles_per_cell": 8,
            }
        ],
        guard={"keep_copy": False},
    )


def resident(name):
    """Bytes of this process: VmRSS now, VmHWM at most."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith(name))


def forget_peak():
    """Let VmHWM begin anew."""
    gc.collect()
    Path("/proc/self/clear_refs").write_text("5")


def array_bytes(thing):
    """Bytes of the arrays that an object holds, each once."""
    arrays = [value for value in vars(thing).values() if isinstance(value, np.ndarray)]
    return sum({array.__array_interface__["data"][0]: array.nbytes for array in arrays}.values())


class Phases:
    """Runs what is measured, and keeps a row of each phase."""

    def __init__(self, comm):
        self.comm, self.base, self.rows, self.passed = comm, resident("VmRSS"), [], True
        self.progress = Progress(PHASES)

    def run(self, name, call, simulation=None, path=None, times=1):
        """What `call` returns; `simulation`: whose particles count, else what comes back; `times`: particle-steps, or the
        like, of each particle; `path`: the file it writes."""
        forget_peak()
        self.comm.barrier()
        began = time.perf_counter()
        found = call()
        self.comm.barrier()
        seconds, peak = time.perf_counter() - began, resident("VmHWM")
        simulation = simulation or found
        grid = array_bytes(simulation.patch) + array_bytes(simulation.halo)
        ratio = (peak - self.base - grid) / max(simulation.nbytes, 1)
        told = self.comm.gather((ratio, peak, simulation.rows()))
        count = sum(rows for *_, rows in told)
        most = max(ratio for ratio, *_ in told)
        judged = min(rows for *_, rows in told) >= JUDGED_FROM
        missed = judged and most > MOST
        self.passed &= not missed
        speed = f"{path.stat().st_size / seconds / 1e6:.0f}" if path else ""
        per_particle = seconds / max(count * times, 1) * 1e9
        mark = (" ✘" if missed else " ✔") if judged else ""
        highest = max(peak for _, peak, _ in told) / 1e6
        row = f"| {name} | {seconds:.2f} | {per_particle:.1f} | {most:.2f}{mark} | {highest:.0f} | {speed} |"
        self.rows.append(row)
        self.tell(row)
        return found

    def tell(self, text):
        if self.comm.rank == 0:
            self.progress.tell(text)


def moved(simulation):
    """Edges with every cut moved by a twentieth of a slab, as far as slabs allow."""
    edges, window = list(simulation.slabs.edges), simulation.needs.stencil.window
    for cut in range(1, simulation.slabs.active):
        width = edges[cut] - edges[cut - 1]
        edges[cut] -= min(math.ceil(width / 20), max(width - window, 0))
    return edges


def warm_up(comm, folder):
    """Compile all kernels, and import all modules, with a small run of the same scene."""
    simulation = Simulation(scene(3456 * comm.size), comm)
    simulation.run(steps=3)
    simulation.measure()
    write_snapshot(comm, folder / "warm.hdf", simulation, simulation.scene, FIELDS, default_parallel(comm))
    simulation.save(folder / "warm_checkpoint.hdf")
    Simulation.restart(folder / "warm_checkpoint.hdf", comm=comm)


def measure(given, comm, folder):
    """(Phases, particles, bytes held by each, bytes of the grid, whether the restarted run measured the same)."""
    made = scene(given.particles)
    warm_up(comm, folder)
    gc.collect()
    phases = Phases(comm)
    checkpoint = folder / "checkpoint.hdf"
    simulation = phases.run("seeding", lambda: Simulation(made, comm))
    particles, held = simulation.rows(), simulation.nbytes
    grid = array_bytes(simulation.patch) + array_bytes(simulation.halo)
    expected = go_through(phases, simulation, given.steps, folder / "snapshot.hdf", checkpoint)
    del simulation
    again = phases.run("restart", lambda: Simulation.restart(checkpoint, comm=comm))
    phases.run("steps after it", lambda: again.run(steps=given.steps), again, times=given.steps)
    same = again.measure() == expected
    phases.passed &= same
    return phases, int(comm.sum(np.array([particles]))[0]), held / max(particles, 1), grid, same


def go_through(phases, simulation, steps, snapshot, checkpoint):
    """All that is measured between seeding and restart; returns the totals some steps after the checkpoint."""
    comm, made = phases.comm, simulation.scene
    phases.run("steps", lambda: simulation.run(steps=steps), simulation, times=steps)
    phases.run("regroup", simulation.regroup, simulation)
    phases.run("regroup with moved cuts", lambda: simulation.regroup(moved(simulation)), simulation)
    parallel = default_parallel(comm)
    write = partial(write_snapshot, comm, snapshot, simulation, made, FIELDS, parallel)
    phases.run("snapshot", write, simulation, snapshot)
    phases.run("checkpoint", lambda: simulation.save(checkpoint), simulation, checkpoint)
    simulation.run(steps=steps)
    return phases.run("totals", simulation.measure, simulation)


def check_space(folder, particles):
    """Stop where the files would not fit."""
    free, wanted = shutil.disk_usage(folder).free, FILE_BYTES * particles
    if free < wanted:
        sys.exit(f"{folder} has {free / 1e9:.1f} GB free, the files take {wanted / 1e9:.1f} GB: give another --folder")


def main():
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--particles", type=float, default=1e8)
    options.add_argument("--steps", type=int, default=5)
    options.add_argument("--folder", type=Path, default=Path(), help="on the disk to be measured")
    options.add_argument("--docs", type=Path)
    options.add_argument("--quick", action="store_true", help="a million particles")
    given = options.parse_args()
    given.particles = min(given.particles, 1e6) if given.quick else given.particles
    comm = communication.from_launcher()
    check_space(given.folder, given.particles)
    folder = comm.broadcast(Path(tempfile.mkdtemp(dir=given.folder, prefix="big_run_")) if comm.rank == 0 else None)
    try:
        phases, particles, held, grid, same = measure(given, comm, folder)
    finally:
        comm.barrier()
        if comm.rank == 0:
            shutil.rmtree(folder)
    if comm.rank == 0:
        restart = "✔ The restarted run measures" if same else "✘ The restarted run does not measure"
        page = PAGE.format(
            ranks=comm.size, asked=given.particles, steps=given.steps, machine=machine_text(), particles=particles,
            held=held, base=phases.base / 1e6, grid=grid / 1e6, most=MOST, rows="\n".join(phases.rows),
            judged=f"judged from {JUDGED_FROM:,} particles per rank on",
            restart=f"{restart} the same totals, bit for bit, as the one that went on.",
        )  # fmt: skip
        if given.docs:
            pages.write(given.docs, "big_run", page)
        print(page)
    sys.exit(not phases.passed)


if __name__ == "__main__":
    main()
