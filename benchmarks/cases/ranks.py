"""The same bits on any number of ranks: scenes of the suite, run again under mpirun.

    mpirun -n 3 python -m cases.ranks hashes.json

with benchmarks on the path is what `verify` starts; it leaves {scene: [hash of all particles, crossings of cuts]} in a file.
"""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from conservation import bits, mpirun

import pmpm
from cases import Case, Table, blocks, column, holds, incline, mms, rigid, shock
from pmpm.parallel.comm import from_launcher

STEPS = 400
RANKS = {"tiny": (1, 2, 3), "standard": (1, 2, 3, 4, 7), "sweep": (1, 2, 3, 4, 7)}
FIELDS = ("id", "x", "velocity", "J", "stress")
TESTED = {
    "V1": lambda: mms.AxisAligned().scene(40),
    "V4": lambda: column.scene(column.SOFT["hencky"], 64),
    "V5": lambda: shock.scene(shock.Impact(shock.WATER, 0.5), 64),
    "V6": lambda: rigid.Spinning(cell_size=0.01).scene(1.0),
    "V7": lambda: incline.scene(incline.friction(15.0), 24, 5.0, speed=6.0),
    "V10": lambda: blocks.scene(8, 3),
}

MOVING = ("V5", "V6", "V7", "V10")  # far enough to cross cuts


def crossings(simulation):
    """Particles that have gone from one rank to another. Collective."""
    sent = np.array(simulation.report()["sent"])
    return int(sent.sum() - np.trace(sent))


def run_all(comm):
    """{scene: (hash, crossings)} of TESTED on the ranks of `comm`."""
    found = {}
    for name, scene in TESTED.items():
        simulation = pmpm.Simulation(scene(), comm)
        simulation.run(steps=STEPS)
        found[name] = bits(simulation, FIELDS), crossings(simulation)
    return found


def on_ranks(launcher, ranks, folder):
    """What `run_all` finds on so many ranks."""
    path, benchmarks = Path(folder) / f"{ranks}.json", Path(__file__).parent.parent
    known = os.pathsep.join([str(benchmarks), str(benchmarks.parent), os.environ.get("PYTHONPATH", "")])
    command = [launcher, "-n", str(ranks), sys.executable, "-m", "cases.ranks", str(path)]
    subprocess.run(command, check=True, env=os.environ | {"PYTHONPATH": known})
    return json.loads(path.read_text(encoding="utf-8"))


def verify(size, comm):
    launcher = mpirun()
    if comm.size > 1 or launcher is None:
        yield Table("Not run: this case starts mpirun itself", ("",), ())
        return
    alone, rows = run_all(comm), []
    with tempfile.TemporaryDirectory() as folder:
        for ranks in RANKS[size]:
            found = on_ranks(launcher, ranks, folder)
            rows += [(name, ranks, str(crossed)) for name, (_, crossed) in found.items()]
            for name, (text, crossed) in found.items():
                yield holds(f"{name} on {ranks} ranks: equal bits", text == alone[name][0], f"== after {STEPS} steps")
                if ranks > 1 and name in MOVING:
                    yield holds(f"{name} on {ranks} ranks: particles cross cuts", crossed > 0, "else equality is cheap")
    yield Table("Particles that went from rank to rank", ("scene", "ranks", "crossings"), rows)


ABOUT = f"""
Scenes of the suite for {STEPS} steps under mpirun: a hash of ids, positions, velocities, J and stresses of all particles equals
that of one process alone. Cuts stay where they were at the start: moving cuts to balance loads is not built.
"""

CASE = Case("V12", "Equal bits on any number of ranks", ABOUT, verify)


def main():
    comm = from_launcher()
    found = run_all(comm)
    if comm.rank == 0:
        Path(sys.argv[1]).write_text(json.dumps(found), encoding="utf-8")


if __name__ == "__main__":
    main()
