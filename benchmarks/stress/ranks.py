"""S11: particles on few of many ranks, ranks without particles, crossings of cuts: the same bits on any number of ranks.

Started again under mpirun (`stability.py --as-rank SCHEME FILE`), every rank count runs all scenes; rank 0 leaves their hashes.
"""

import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from conservation import bits

from pmpm.failure import NumericalFailure

from .judge import Found, follow
from .matrix import Case, Scheme
from .scenes import box, simulation, solid

CELL, STEPS = 0.1, 240
RUBBER = solid()
RANKS = ("2", "3", "4", "8")
SCHEMES = tuple(
    Scheme(transfer, shape, precision)
    for transfer, shape, precision in (
        ("apic", "linear", "float64"), ("apic", "quadratic", "float64"), ("apic", "cubic", "float64"),
        ("mls", "quadratic", "float64"), ("mls", "cubic", "float64"), ("flip", "quadratic", "float64"),
        ("pic", "quadratic", "float64"), ("apic", "quadratic", "float32"),
    )
)  # fmt: skip


def one_side(scheme, comm=None):
    """All particles in the first three cells of 64: most ranks hold none, and the block flies towards them."""
    return simulation(scheme, [6.4, 0.6], CELL, [box([0.0, 0.0], [0.3, 0.6], velocity=[7.0, 0.0])], RUBBER, comm=comm)


def few_cells(scheme, comm=None):
    """A domain of 8 x 7 cells: room for one rank, the others idle."""
    return simulation(
        scheme,
        [0.8, 0.7],
        CELL,
        [box([0.1, 0.0], [0.6, 0.5], velocity=[-1.0, -1.0])],
        RUBBER,
        comm=comm,
        gravity=[0.0, -9.81],
    )


def crossing(scheme, comm=None):
    """Sheets of which all particles pass from one layer to the next, and across a cut, in the same step."""
    run = simulation(
        scheme, [6.4, 0.8], CELL,
        [box([0.3 + 0.8 * n, 0.0], [0.4 + 0.8 * n, 0.8], velocity=[30.0, 0.0]) for n in range(8)], RUBBER, comm=comm,
        periodic=["x"],
    )  # fmt: skip
    x = run.particles.x
    x[:, 0] = CELL * (np.floor(x[:, 0] / CELL) + 0.49)
    run.particles.x = x
    return run


def swinging(scheme, comm=None):
    """Blocks between walls of waves: each swings to and fro over where a cut may be."""
    run = simulation(scheme, [6.4, 0.8], CELL, [box([0.0, 0.0], [6.4, 0.8])], RUBBER, comm=comm)
    x = run.particles.x
    v = np.zeros_like(x)
    v[:, 0] = 4.0 * np.sin(2.0 * np.pi * x[:, 0] / 0.8 + 1.0)
    run.particles.v = v
    return run


def on_cuts(scheme, comm=None):
    """Particles exactly on the planes between cells and half way, where cuts lie."""
    run = simulation(scheme, [6.4, 0.8], CELL, [box([0.0, 0.0], [6.4, 0.8], particles_per_cell=1)], RUBBER, comm=comm)
    x = run.particles.x
    x[:, 0] = CELL * np.floor(x[:, 0] / CELL)
    run.particles.x = x
    run.particles.v = np.tile([1.0, 0.3], (run.rows(), 1))
    return run


SCENES = {
    "one side": one_side, "few cells": few_cells, "crossing": crossing, "swinging": swinging, "on cuts": on_cuts,
}  # fmt: skip


def result_of(run):
    """A hash of all particles after STEPS steps, or the message with which the run stops."""
    try:
        run.run(steps=STEPS)
    except NumericalFailure as failure:
        return str(failure).split("rank")[0]
    return bits(run)


def run_as_a_rank(scheme, path):
    """Run all scenes under mpirun and leave {scene: [result, crossings of cuts]} in a file."""
    from mpi4py import MPI

    comm, found = MPI.COMM_WORLD, {}
    scheme = Scheme(*scheme.split())
    for name, make in SCENES.items():
        run = make(scheme, comm)
        result = result_of(run)
        sent = run.report()["sent"]
        found[name] = [result, sum(map(sum, sent)) - sum(sent[rank][rank] for rank in range(comm.size))]
    if comm.rank == 0:
        Path(path).write_text(json.dumps(found), encoding="utf-8")


def same_bits(scheme, variant):
    mpirun = shutil.which("mpirun", path=f"{Path(sys.executable).parent}{os.pathsep}{os.environ.get('PATH', '')}")
    if mpirun is None:
        return Found(wrong=["not run: no mpirun"])
    found = follow(one_side(scheme), steps=STEPS)
    alone = {name: result_of(make(scheme)) for name, make in SCENES.items()}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "found.json"
        program = Path(__file__).resolve().parent.parent / "stability.py"
        command = [mpirun, "-n", variant, sys.executable, str(program), "--as-rank", str(scheme), str(path)]
        subprocess.run(command, check=True, capture_output=True, timeout=300)
        several = json.loads(path.read_text(encoding="utf-8"))
    for name, (result, crossings) in several.items():
        found.numbers[name] = crossings
        found.claim(result == alone[name], f"{name}: other bits than one rank")
    return found


CASES = (
    Case(
        "S11", "ranks", "few of many ranks with particles, idle ranks, crossings: bits of one rank; numbers are crossings",
        RANKS, same_bits, schemes=SCHEMES, limit=400.0, quick=1,
    ),
)  # fmt: skip
