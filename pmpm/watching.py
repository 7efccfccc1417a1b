"""Who watches a run and when they are called, and how long its phases take."""

import math
import time as clock
from collections.abc import Callable
from dataclasses import dataclass, field

# What a simulation may be asked for while it runs, by urgency; above STOP: the number of the signal that asked.
CHECKPOINT, OUT_OF_TIME, SIGNALLED = 1, 2, 10
STOP = OUT_OF_TIME
MOST_COUNT = 2.0**53  # of intervals: quotients of times may be infinite


@dataclass
class Observer:
    """Something that watches the run: called every `steps` steps, or at the first step not before count * seconds."""

    call: Callable
    steps: int | None
    seconds: float | None
    count: int = 1
    name: str | None = None

    def due(self, simulation):
        if self.steps is not None:
            return simulation.step_count % self.steps == 0
        assert self.seconds is not None
        if simulation.time < self.count * self.seconds:
            return False
        self.count = next_count(simulation.time, self.seconds)
        return True


def next_count(time, seconds):
    """The first multiple of an interval that lies after a time; of intervals next to nothing, one that has passed."""
    return math.floor(min(time / seconds, MOST_COUNT)) + 1


@dataclass
class Timers:
    """Wall seconds per phase on this rank."""

    seconds: dict = field(default_factory=dict)

    def add(self, phase, began):
        now = clock.perf_counter()
        self.seconds[phase] = self.seconds.get(phase, 0.0) + now - began
        return now


def spread(per_rank):
    """min, mean and max over ranks of each phase's seconds."""
    names = sorted({name for seconds in per_rank for name in seconds})
    values = {name: [seconds.get(name, 0.0) for seconds in per_rank] for name in names}
    return {
        name: {"min": min(v), "mean": math.fsum(v) / len(v), "max": max(v)} for name, v in values.items()
    }  # fmt: skip
