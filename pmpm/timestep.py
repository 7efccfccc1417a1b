"""How long the next step may be, and whether particles may have used up the padding of their layers.

Four bounds, of which the shortest counts:
  cfl dx / (c sqrt(d))    c the largest current wave speed, with viscosity (Sun, Shinar, Schroeder 2020; quadratic splines)
  MOVE dx / max|v|        what a particle moves, and the surface of a collider
  sqrt(MOVE dx / max|a|)  what gravity, loads and body force let a particle at rest move
  STRETCH / max|grad v|   what a particle is strained: a lone one may stand still and expand
Maxima over all ranks come from a reduction that was started LAG steps ago, so that no step waits for it; what a particle may
move meanwhile is covered by the padding. The largest of the last RECENT to 2 RECENT steps count, and unless they have fallen
by more than STEADY those before: a step that followed each swing of the stiffest particles, LAG steps late, would pump energy
into it. (A lone particle, stretched by 30 %, swings in 8 steps at cfl 0.4. As a map of one degree of freedom: with a step of
its own for each step its energy grows 226-fold, with the largest of 32 or more by 2 %, with both not at all.)
"""

import math
from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np

LAG = 2  # steps between the start of a reduction and its use
MOVE = 0.2  # cells a particle may move in a step: LAG + 1 such steps and a margin fit into one cell of padding
STRETCH = 0.1  # strain of a particle in a step: until it is known, LAG steps later, waves have changed little
RECENT = 32  # steps: four swings of the highest frequency at cfl 0.4, one at cfl 0.1
STEADY = 0.05  # of a bound: no change
EVERY = 8  # steps between two counts of disorder
# ns of one more run, and of a regroup per particle: estimates for one core of an AVX-512 Xeon.
RUN_COST, REGROUP_COST = 8, 75
MARGIN = 1.5  # growth of the largest speed that is allowed for between two reductions
# What is reduced: max |v|^2, max c^2, max drift in cells, max |grad v|^2, max |b|^2 of the body force, minus the failed step,
# and what a rank has been asked for.
SPEED, WAVE, DRIFT, GRADIENT, FORCE, FAILED, REQUEST = range(7)
BOUNDS = ("waves", "speed", "acceleration", "strain")
LEARNT = (SPEED, WAVE, GRADIENT, FORCE)  # of what is reduced, what bounds the step
# Of StepControl, beside its counts.
NUMBERS = ("moving", "travel", "drift", "drift_travel", "regroup_travel")
COUNTS = ("begun", "regroup_step")


@dataclass
class Pending:
    """A reduction on its way: the step that started it, and the travel bound (cells) accumulated until then."""

    step: int
    travel: float = 0.0
    handle: Any = None
    values: Any = None

    def arrived(self, comm):
        """What has been reduced; waits for it."""
        if self.values is None:
            self.values = comm.finish(self.handle)
        return self.values


class Disorder:
    """Says when the particles have lost their order so far that sorting them again saves more than it takes.

    P2G works fastest on runs of consecutive particles with the same stencil. What steps since the last regroup have spent on
    more runs than there were right after it is set against what a regroup costs. Costs are constants and runs are counted
    over all ranks, EVERY steps and LAG steps late: the same decision on any number of ranks, on any machine.
    """

    def __init__(self, comm):
        self.comm = comm
        self.pending: Pending | None = None
        self.regrouped(0)

    def regrouped(self, step):
        self.step, self.sorted_runs, self.excess, self.particles = step, None, 0, 1

    def start(self, step, runs, particles):
        """Begin to count what step number `step` found."""
        if (step - self.step) % EVERY == 1 and self.pending is None:
            self.pending = Pending(step, handle=self.comm.start_sum(np.array([runs, particles], np.int64)))

    def pays(self, step):
        """Whether a regroup before step number `step` pays."""
        if self.pending is not None and step > self.pending.step + LAG:
            counted, self.pending = self.pending, None
            runs, self.particles = map(int, counted.arrived(self.comm))
            if counted.step > self.step:
                self.sorted_runs = runs if self.sorted_runs is None else self.sorted_runs
                self.excess += EVERY * max(runs - self.sorted_runs, 0)
        return RUN_COST * self.excess > REGROUP_COST * self.particles

    def state(self):
        """What the next decisions depend on, as plain numbers. Collective."""
        pending = self.pending and [self.pending.step, *map(int, self.pending.arrived(self.comm))]
        return {"step": self.step, "sorted_runs": self.sorted_runs, "excess": self.excess, "particles": self.particles,
                "pending": pending}  # fmt: skip

    def resume(self, state):
        """Go on from what `state` gave."""
        self.step, self.sorted_runs = state["step"], state["sorted_runs"]
        self.excess, self.particles = state["excess"], state["particles"]
        pending = state["pending"]
        self.pending = pending and Pending(pending[0], values=pending[1:])


class StepControl:
    """Chooses dt and says when a regroup is due; the same decisions on every rank."""

    def __init__(self, comm, time, cell_size, dim, farthest, settled_drift, most_travel):
        self.comm, self.cell_size, self.dim = comm, cell_size, dim
        self.cfl, self.fixed_step, self.forced, self.end = time.cfl, time.step, time.force_step, time.end
        self.farthest, self.settled_drift, self.most_travel = farthest, settled_drift, most_travel
        self.pending: deque[Pending] = deque()
        self.disorder = Disorder(comm)
        self.travel = 0.0
        self.regrouped(0)
        self.begun = self.asked = 0
        self.shortest = self.stable = math.inf  # s, of the bounds for the step last chosen, and what cfl makes of them
        self.largest = [[0.0] * len(LEARNT)] * 2  # until the last multiple of RECENT steps, and of those since then
        self.moving = 0.0  # m/s, the largest speed known last
        self.floor = (0.0,) * len(LEARNT)  # what counts at least, whatever particles tell

    def begin(self, step, maxima):
        """Take the maxima over the particles of this rank, in the order of what is reduced, of a state that no step has made,
        before the step after `step`. Collective."""
        self.begun = step
        found = [math.sqrt(value) for value in self.comm.max(maxima)[list(LEARNT)]]
        self.largest, self.moving = [found, found], found[0]

    def learn(self, step, values):
        """Take the maxima that step number `step` found."""
        found = [math.sqrt(values[kind]) for kind in LEARNT]
        before, since = self.largest
        if step % RECENT == 0:
            kept = [
                new if new < (1.0 - STEADY) * old else max(new, old) for new, old in zip(since, before, strict=True)
            ]
            self.largest = [kept, found]
        else:
            self.largest = [before, list(map(max, since, found))]
        self.moving = found[0]

    @property
    def recent(self):
        """The largest speed (m/s), wave speed (m/s), |grad v| (1/s) and body force (m/s2) that count."""
        return tuple(map(max, *self.largest, self.floor))

    def bounds(self, driven):
        """The longest step in s by each of BOUNDS; `driven`: acceleration by gravity and loads, m/s2."""
        speed, wave, gradient, force = self.recent
        found = stable_bounds(self.cell_size, self.dim, wave, speed, driven + force, gradient)
        self.shortest = min(found)
        return found

    def stable_step(self, driven):
        """The step in s that cfl and the bounds allow."""
        waves, *others = self.bounds(driven)
        self.stable = min(self.cfl * waves, *others)
        return self.stable

    def choose(self, time, driven):
        """dt of the next step in s."""
        dt = self.fixed_step if self.fixed_step is not None else self.stable_step(driven)
        return min(dt, self.end - time) if self.end - time > 0 else dt

    def exceeds(self, driven):
        """The longest stable step in s if the user's fixed step is longer than it, else None."""
        if self.fixed_step is None:
            return None
        bound = min(self.bounds(driven))
        return bound if self.fixed_step > bound else None

    def move_bound(self, dt):
        """Cells a particle may move in a step of dt."""
        return MARGIN * max(self.moving, self.floor[SPEED]) * dt / self.cell_size

    def regroup_due(self, step, dt):
        """Whether a particle might leave its layer's padded planes, or its place overflow, in step number `step`; or whether
        a new order pays for itself."""
        coming = self.travel + self.move_bound(dt)
        drifts_out = self.drift + coming - self.drift_travel > self.farthest
        return self.disorder.pays(step) or drifts_out or coming - self.regroup_travel > self.most_travel

    def regrouped(self, step):
        """Every particle is at most half a cell from its home again."""
        self.regroup_step, self.drift = step, self.settled_drift
        self.drift_travel = self.regroup_travel = self.travel
        self.disorder.regrouped(step)

    def start(self, step, dt, values):
        """Begin the reduction of what step number `step` found."""
        self.travel += self.move_bound(dt)
        self.pending.append(Pending(step, self.travel, self.comm.start_max(values)))

    def collect(self):
        """Use the reduction started LAG steps ago. Returns the earliest failed step it knows of, or None."""
        if len(self.pending) < LAG:
            return None
        arrived = self.pending.popleft()
        arrived.arrived(self.comm)
        self.asked = max(self.asked, int(arrived.values[REQUEST]))
        if arrived.step > self.begun and np.isfinite(arrived.values[:FAILED]).all():
            self.learn(arrived.step, arrived.values)
        if arrived.step > self.regroup_step:
            self.drift, self.drift_travel = arrived.values[DRIFT], arrived.travel
        return failed_step(arrived)

    def known_failure(self):
        """The earliest failed step in anything on its way, or None; waits for it but changes no later decision."""
        for reduction in self.pending:
            reduction.arrived(self.comm)
        found = [step for step in map(failed_step, self.pending) if step is not None]
        return min(found, default=None)

    def state(self):
        """What the next decisions depend on, as plain numbers, requests left out. Collective; nothing may have failed."""
        numbers = {name: float(getattr(self, name)) for name in NUMBERS} | {
            name: getattr(self, name) for name in COUNTS
        }
        pending = [[r.step, r.travel, *map(float, r.arrived(self.comm)[:FAILED])] for r in self.pending]
        return numbers | {"largest": self.largest, "pending": pending, "disorder": self.disorder.state()}

    def resume(self, state):
        """Go on from what `state` gave."""
        for name in (*NUMBERS, *COUNTS):
            setattr(self, name, state[name])
        self.largest = [list(found) for found in state["largest"]]
        self.pending = deque(
            Pending(step, travel, values=np.array([*found, -math.inf, 0.0]))
            for step, travel, *found in state["pending"]
        )
        self.disorder.resume(state["disorder"])


def stable_bounds(cell_size, dim, wave, speed, acceleration, gradient=0.0):
    """The longest step in s by each of BOUNDS, for cfl = 1; infinite where nothing bounds it. In m, m/s, m/s2 and 1/s."""
    return (
        cell_size / (wave * math.sqrt(dim)) if wave > 0.0 else math.inf,
        MOVE * cell_size / speed if speed > 0.0 else math.inf,
        math.sqrt(MOVE * cell_size / acceleration) if acceleration > 0.0 else math.inf,
        STRETCH / gradient if gradient > 0.0 else math.inf,
    )


def failed_step(reduction):
    """The step number a reduction reports as failed, or None."""
    value = reduction.values[FAILED]
    return None if value == -math.inf else int(-value)
