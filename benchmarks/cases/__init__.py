"""Cases with known answers, one file per family: benchmarks and tests take their scenes from here.

A case file has functions that return a `pmpm.Scene` (with `exact` where there is an exact solution) from size arguments, and
one or more `Case`s for benchmarks/verification.py, each listed there in CASES.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from types import FunctionType
from typing import Any

import pmpm
from pmpm import accuracy

SIZES = ("tiny", "standard", "sweep")  # seconds, minutes, as fine as is worth waiting for


def with_globals(function, **names):
    """A copy of a body force that sees other numbers under these names: kernels refuse closures."""
    return FunctionType(function.__code__, function.__globals__ | names, function.__name__)


@dataclass(frozen=True)
class Check:
    """A measured number, the gate it must pass and why the gate is there; without limits it is only reported."""

    what: str
    value: float
    low: float | None = None
    high: float | None = None
    reason: str = ""

    @property
    def judged(self):
        return self.low is not None or self.high is not None

    @property
    def met(self):
        """Whether the number passes; never if it is not a number, unless nothing is asked of it."""
        if not self.judged:
            return True
        return (self.low is None or self.value >= self.low) and (self.high is None or self.value <= self.high)

    @property
    def gate(self):
        if not self.judged:
            return "reported"
        if self.low is None or self.high is None:
            return f"<= {short(self.high)}" if self.low is None else f">= {short(self.low)}"
        return f"{short(self.low)} .. {short(self.high)}"


@dataclass(frozen=True)
class Table:
    """Numbers and words for the page; `head` names the columns."""

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[Any]]


@dataclass(frozen=True)
class Plot:
    """Lines {label: (x values, y values)} for the page; `scale` is linear, logx, logy or loglog."""

    title: str
    x: str
    y: str
    lines: dict[str, tuple[Sequence[float], Sequence[float]]]
    scale: str = "linear"


@dataclass(frozen=True)
class Case:
    """A part of the suite. `about` is markdown for the page: formulas, where they come from, what was learnt.

    `verify(size, comm)` yields a Check, Table or Plot as soon as it is known, the same on all ranks of `comm`, which goes to
    `pmpm.Simulation` and has the verbs of pmpm/parallel/comm.py. It may let a NumericalFailure pass: that is a gate missed.
    """

    name: str
    title: str
    about: str
    verify: Callable[[str, Any], Iterator[Check | Table | Plot]]


def at_most(what, value, high, reason):
    return Check(what, value, None, high, reason)


def at_least(what, value, low, reason):
    return Check(what, value, low, None, reason)


def between(what, value, low, high, reason):
    return Check(what, value, low, high, reason)


def near(what, value, expected, relative, reason):
    """A gate that a number passes within `relative` of `expected`."""
    spread = relative * abs(expected)
    return Check(what, value, expected - spread, expected + spread, reason)


def holds(what, claim, reason):
    """A gate of a claim: 1 if it is true, else 0."""
    return Check(what, float(claim), 1.0, None, reason)


def order(errors, sizes):
    """Least-squares slope of log error over log size, 2 for a method of second order in a cell size."""
    logs = [(math.log(size), math.log(error)) for size, error in zip(sizes, errors, strict=True)]
    x, y = (sum(values) / len(logs) for values in zip(*logs, strict=True))
    return sum((a - x) * (b - y) for a, b in logs) / sum((a - x) ** 2 for a, _ in logs)


def short(value):
    """A number with as many digits as a reader needs."""
    if isinstance(value, str):
        return value
    return f"{value:.3g}"


def errors(scene, comm=None, times=None):
    """Run a scene that carries its exact solution; returns its pmpm.accuracy.Errors.

    They are taken after every step, or at so many `times`: measuring costs more than a step does.
    """
    simulation = pmpm.Simulation(scene, comm)
    found = accuracy.Errors(simulation)
    simulation.every(found, **({"steps": 1} if times is None else {"seconds": scene.time.end / times}), at_start=True)
    simulation.run()
    return found
