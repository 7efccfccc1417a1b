"""What is said when a particle fails: the record its rank keeps, and the one message all ranks stop with."""

import math

import numpy as np

from pmpm.kernels import loops


class NumericalFailure(Exception):  # noqa: N818
    """The run stopped for a numerical cause; the text names step, time, rank, particle, position and material."""


def describe(simulation, law, block, lane, cause):
    """What there is to say about a particle that failed here; `cause`: a number of kernels.loops, or a text."""
    population, layout = simulation.populations[law], simulation.layouts[law]
    index = int(np.flatnonzero(population.lanes.ravel()).searchsorted(block * population.lanes.shape[1] + lane))
    x = simulation.derived_of(law, np.float64).x()[index]
    state = {f.name: population.reals[block, layout.where(f.name), lane] for f in layout.state}
    body = int(population.block_row[block])
    return {
        "step": simulation.step_count + 1,
        "time": simulation.time,
        "rank": simulation.comm.rank,
        "law": law,
        "id": int(population.id[block, lane]),
        "position": [float(value) for value in x],
        "material": simulation.scene.sources[body].material,
        "velocity": [float(value) for value in population.reals[block, layout.where("v"), lane]],
        "cause": cause,
        "state": ", ".join(f"{name} = {np.array2string(value, precision=4)}" for name, value in state.items()),
    }


def stop_at_largest(simulation, values, cause):
    """Raise NumericalFailure on all ranks for a cause that is none particle's own, naming the particle of the largest of
    `values`, (n,) per law; of equals the first by law and then in the one global order. Collective."""
    found = []
    for law, of_particles in enumerate(values):
        ranked = np.where(np.isnan(of_particles), np.inf, of_particles)
        if len(ranked):
            found.append((-float(ranked.max()), law, int(ranked.argmax())))
    mine = min(found) if found else (math.inf, 0, 0)
    told = simulation.comm.gather(mine[:2])
    if found and told.index(min(told)) == simulation.comm.rank:
        width = simulation.populations[mine[1]].lanes.shape[1]
        place = int(np.flatnonzero(simulation.populations[mine[1]].lanes.ravel())[mine[2]])
        block, lane = divmod(place, width)
        simulation.failure = describe(simulation, mine[1], block, lane, cause)
    simulation.stop(simulation.step_count + 1)


def message(record):
    """One line a user can act on."""
    finite = all(math.isfinite(value) for value in record["velocity"])
    causes = {
        loops.CAUSE_POSITION: "it moved further in a few steps than the padding of its slab allows: the time step is too "
        "long" if finite else "its velocity is not a number",
        loops.CAUSE_STATE: f"its state is no longer valid: {record['state']}",
        loops.CAUSE_LEFT: "it left the domain",
    }  # fmt: skip
    position = ", ".join(f"{value:.6g}" for value in record["position"])
    cause = causes.get(record["cause"], record["cause"])
    return (
        f"step {record['step']}, t = {record['time']:.6g} s, rank {record['rank']}: particle {record['id']} of material "
        f"{record['material']} at ({position}) m: {cause} (velocity {record['velocity']} m/s)"
    )
