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
    row = {"number": entry.number, "scheme": entry.scheme, "level": entry.level} | of_scene(entry.scene)
    seconds: list[float] = []
    try:
        found, samples = first_run(entry.scene, plan, comm, progress_of, requests, seconds)
        for _ in range(plan.options.repeat - 1):
            again(entry.scene, comm, progress_of, requests, seconds)
    except (NumericalFailure, SceneError) as failure:
        return row | {"status": FAILED, "cause": " ".join(str(failure).split())}, None
    return row | {"status": FINISHED, "cause": ""} | found | timing(seconds, found), samples


def first_run(scene, plan, comm, progress_of, requests, seconds):
    """(what a row says of a run, samples or None); its time is appended to `seconds`. Collective."""
    began = clock.perf_counter()
    simulation = Simulation(scene, comm)
    took = np.array([clock.perf_counter() - began, simulation.timers.seconds["compile"]])
    whole, compiling = map(float, simulation.comm.max(took))
    watcher = watch(simulation, plan.base)
    report = step_to_end(simulation, progress_of(simulation), requests, seconds)
    errors, samples = found_by(watcher, simulation)
    found = {"compile_seconds": compiling, "startup_seconds": max(whole - compiling, 0.0)}
    found |= {name: report[name] for name in COUNTS} | {"bytes_per_particle": memory(simulation)}
    return found | errors, samples


def again(scene, comm, progress_of, requests, seconds):
    """Take a run once more, for its time. Collective."""
    simulation = Simulation(scene, comm)
    step_to_end(simulation, progress_of(simulation), requests, seconds)


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


def watch(simulation, base):
    """Attach what measures the error of a run: Errors or a Sampler."""
    if simulation.scene.exact is not None:
        errors = Errors(simulation)
        simulation.every(errors, seconds=simulation.scene.time.end / MEASURED, at_start=True)
        return errors
    sampler = Sampler(simulation, base)
    simulation.every(sampler, steps=1, at_start=True)
    return sampler


def step_to_end(simulation, progress, requests, seconds):
    """Run a simulation, telling it what is asked from outside; returns its report and appends to `seconds`.

    Raises Stopped, NumericalFailure.
    """
    simulation.every(progress, steps=1, at_start=True)
    simulation.every(requests, steps=1)
    simulation.run()
    progress.finish(simulation)
    if not simulation.finished:
        raise Stopped
    report = simulation.report()
    seconds.append(report["stretch"]["seconds"])
    return report


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


def timing(seconds, found):
    middle = statistics.median(seconds)
    per_second = found["steps"] * found["particles"] / middle if middle > 0.0 else None
    return {
        "seconds": middle,
        "seconds_least": min(seconds),
        "seconds_most": max(seconds),
        "repeats": len(seconds),
        "particle_steps_per_second": per_second,
    }
