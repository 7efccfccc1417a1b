"""One run of a study: the scene stepped to its end with nothing written, what it cost and how far it is from the solution."""

import statistics
import time as clock

import numpy as np

from pmpm.accuracy import Errors
from pmpm.failure import NumericalFailure
from pmpm.scene.errors import SceneError
from pmpm.simulation import Simulation
from pmpm.studies.samples import Sampler

FINISHED, FAILED = "finished", "failed"
MEASURED = 200  # times at which errors against an exact solution are measured
COUNTS = ("particles", "steps", "kernels_compiled")


class Stopped(Exception):  # noqa: N818
    """The run was asked to stop before its end."""


def run_entry(entry, plan, comm, progress_of, requests):
    """(row, samples or None) of one run, which is taken `plan.options.repeat` times for its time. Collective.

    `progress_of`: makes an observer for a run; `requests`: a requests.Requests that listens. Raises Stopped.
    """
    row, samples = {"number": entry.number, "scheme": entry.scheme, "level": entry.level} | of_scene(entry.scene), None
    seconds: list[float] = []
    for repeat in range(plan.options.repeat):
        try:
            simulation, watcher, startup = begun(entry.scene, plan, comm, first=repeat == 0)
            if repeat == 0:
                row |= startup
            step_to_end(simulation, progress_of(simulation), requests)
            simulation.check()
        except (NumericalFailure, SceneError) as failure:
            cause = " ".join(str(failure).split())
            return row | {"status": FAILED, "cause": cause}, None
        report = simulation.report()
        seconds.append(report["stretch"]["seconds"])
        if repeat == 0:
            row |= {name: report[name] for name in COUNTS}
            row["bytes_per_particle"] = memory(simulation)
            errors, samples = found_by(watcher, simulation)
            row |= errors
    return row | {"status": FINISHED, "cause": ""} | timing(seconds, row), samples


def of_scene(scene):
    """What a row says of its scene."""
    method, time = scene.method, scene.time
    return {
        "cell_size": scene.domain.cell_size,
        "transfer": method.transfer,
        "shape_function": method.shape_function,
        "precision": method.precision,
        "cfl": time.cfl,
        "fixed_step": time.step,
    }


def begun(scene, plan, comm, first):
    """(simulation, what watches it or None, seconds of its start) of a run that is ready to step. Collective."""
    began = clock.perf_counter()
    simulation = Simulation(scene, comm)
    took = np.array([clock.perf_counter() - began, simulation.timers.seconds["compile"]])
    whole, compiling = map(float, simulation.comm.max(took))
    watcher: Errors | Sampler | None = None
    if first and scene.exact is not None:
        watcher = Errors(simulation)
        simulation.every(watcher, seconds=scene.time.end / MEASURED, at_start=True)
    elif first:
        watcher = Sampler(simulation, plan.base)
        simulation.every(watcher, steps=1, at_start=True)
    return simulation, watcher, {"compile_seconds": compiling, "startup_seconds": max(whole - compiling, 0.0)}


def step_to_end(simulation, progress, requests):
    """Run a simulation, telling it what is asked from outside. Raises Stopped, NumericalFailure."""
    simulation.every(progress, steps=1, at_start=True)
    simulation.every(requests, steps=1)
    simulation.run()
    progress.finish(simulation)
    if not simulation.finished:
        raise Stopped


def found_by(watcher, simulation):
    """({key: number} of errors, samples or None) at the end of a run. Collective."""
    if isinstance(watcher, Sampler):
        return {}, watcher.result()
    watcher(simulation)
    largest, last = watcher.largest, watcher.last
    errors = {f"error_{name}": largest[name] for name in largest}
    return errors | {f"error_{name}_end": last[name] for name in last}, None


def memory(simulation):
    """Bytes over all ranks that a particle takes, with what lies idle in the last blocks of segments. Collective."""
    size, rows = simulation.comm.sum(np.array([simulation.nbytes, simulation.rows()], np.int64))
    return float(size / rows)


def timing(seconds, row):
    middle = statistics.median(seconds)
    per_second = row["steps"] * row["particles"] / middle if middle > 0.0 else None
    return {
        "seconds": middle,
        "seconds_least": min(seconds),
        "seconds_most": max(seconds),
        "repeats": len(seconds),
        "particle_steps_per_second": per_second,
    }
