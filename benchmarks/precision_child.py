"""The process in which benchmarks/work_precision.py runs one code, pinned to one core: a run per message, its numbers back.

python precision_child.py pmpm --cores 0        then one JSON line with a point on its input for each run
python precision_child.py pmpm --startup POINT  seconds until the first step is done, the import of the code included
"""

import time

BEGAN = time.perf_counter()

import argparse  # noqa: E402 - imports are part of what --startup times
import importlib  # noqa: E402
import json  # noqa: E402
import math  # noqa: E402
import resource  # noqa: E402
import sys  # noqa: E402
from pathlib import Path  # noqa: E402

import contest  # noqa: E402
import numpy as np  # noqa: E402
import precision_cases  # noqa: E402
from precision_plan import Point  # noqa: E402

import pmpm  # noqa: E402
from pmpm.failure import NumericalFailure  # noqa: E402

OBSERVATIONS = 64  # of the error in a run, or one in each step if it has fewer
PEERS = {"taichi": ("peers.taichi_exact", "TaichiExact"), "warp": ("peers.warp_exact", "WarpExact")}


def run(point, observe):
    """dict of what one run of a point tells; with `observe` also its errors."""
    try:
        ways = {"pmpm": run_pmpm, "kratos": run_kratos}
        return ways.get(point.code, run_peer)(point, observe)
    except (NumericalFailure, pmpm.SceneError) as failure:
        return {"stopped": str(failure).split("\n")[0]}


# ---- pmpm ------------------------------------------------------------------------------------------------------------------


def run_pmpm(point, observe):
    resident = start_of_peak()
    began = time.perf_counter()
    simulation = pmpm.Simulation(precision_cases.scene(point))
    built = time.perf_counter() - began
    errors = precision_cases.watch(point, simulation, OBSERVATIONS) if observe else dict
    energy = mechanical(simulation)
    simulation.run()
    steps, seconds = simulation.stretch
    count = simulation.rows()
    return {
        "particles": count,
        "steps": steps,
        "seconds": seconds,
        "built": built,
        "step": simulation.time / steps,
        "held": simulation.nbytes / count,
        "nodes": simulation.patch.nodes.nbytes / count,
        "peak": (peak() - resident) / count if resident else None,
        "energy": mechanical(simulation) / energy - 1.0 if energy > 0.0 else None,
        "sorts": simulation.regroups,
        **errors(),
    }


def mechanical(simulation):
    measured = simulation.measure()
    return measured["kinetic"] + measured["strain"]


def start_of_peak():
    """Begin to look for the peak of resident memory, and say what is resident; None where the kernel does not allow it."""
    try:
        Path("/proc/self/clear_refs").write_text("5", encoding="utf-8")
    except OSError:
        return None
    return 1024 * int(status("VmRSS"))


def peak():
    """Bytes."""
    return 1024 * int(status("VmHWM"))


def status(name):
    lines = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
    return next(line.split()[1] for line in lines if line.startswith(name))


# ---- peers -----------------------------------------------------------------------------------------------------------------


def run_peer(point, observe):
    simulation = pmpm.Simulation(precision_cases.scene(point))  # for its particles at the start
    problem = precision_cases.problem(point, simulation)
    exact = simulation.scene.exact.displacement
    module, name = PEERS[point.code]
    resident = start_of_peak()
    began = time.perf_counter()
    code = getattr(importlib.import_module(module), name)(problem, point.precision)
    built, steps, count = time.perf_counter() - began, precision_cases.steps(point), len(problem.X)
    if not observe:
        began = time.perf_counter()
        code.run(steps)
        seconds, found = time.perf_counter() - began, {}
    else:
        found, seconds = observed(code, problem, exact, steps), None
    return found | {
        "particles": count,
        "steps": steps,
        "seconds": seconds,
        "built": built,
        "step": problem.step,
        "peak": (peak() - resident) / count if resident else None,
    }


def run_kratos(point, observe):
    """The static column; nobody watches it, so that every run has error and time."""
    from peers import kratos_column

    resident, load_steps = start_of_peak(), precision_cases.expected_steps(point)
    done = kratos_column.settle(precision_cases.COLUMN, point.cells, load_steps, point.per_direction)
    off = done.heights - precision_cases.COLUMN.heights(done.start)
    settled = done.start - precision_cases.COLUMN.heights(done.start)
    error, count = math.sqrt(np.mean(off**2) / np.mean(settled**2)), len(off)
    return {
        "particles": count,
        "steps": done.steps,
        "seconds": done.seconds,
        "built": done.built,
        "peak": (peak() - resident) / count if resident else None,
        "e_u": error,
        "e_end": error,
    }


def observed(code, problem, exact, steps):
    """The error as `pmpm.Errors` takes it, all particles being of the same volume."""
    largest = reference = 0.0
    every, done = max(1, steps // OBSERVATIONS), 0
    while True:
        u = exact(problem.X, done * problem.step)
        difference = code.positions().astype(float) - problem.X - u
        if problem.periodic:
            difference -= np.rint(difference)
        largest, reference = np.maximum(largest, rms(difference)), max(reference, rms(u))
        if done == steps or not math.isfinite(largest):
            break
        ahead = min(every, steps - done)
        code.run(ahead)
        done += ahead
    if not math.isfinite(largest):
        return {"stopped": f"not a number by step {done}"}
    farthest = float(np.abs(problem.X).max())
    return {"e_u": float(largest) / reference, "reference": reference, "farthest": farthest}


def rms(vectors):
    return math.sqrt(np.mean(np.sum(vectors * vectors, axis=1)))


# ---- the process -------------------------------------------------------------------------------------------------------------


def serve():
    for command in contest.commands(None):
        print(json.dumps(run(Point(**command["point"]), command["observe"])), flush=True)


def first_step(point):
    """Seconds from the import of a code until its first step is done."""
    if point.code != "pmpm":
        return run_peer(point, observe=False)["built"]
    pmpm.Simulation(precision_cases.scene(point)).step()
    return time.perf_counter() - BEGAN


def main():
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("code", help="pmpm, taichi or warp")
    options.add_argument("--cores", type=int, nargs="+", default=[])
    options.add_argument("--startup", help="a point as JSON")
    given = options.parse_args()
    if given.cores:
        contest.pin(given.cores)
    if given.startup:
        seconds = first_step(Point(**json.loads(given.startup)))
        print(json.dumps({"seconds": seconds, "rss": 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss}))
        return
    serve()


if __name__ == "__main__":
    sys.exit(main())
