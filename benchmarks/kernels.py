"""The speed of a whole time step, beside Taichi and Warp on the same cores: the numbers pmpm must reach.

    python benchmarks/kernels.py [--docs docs] [--workloads W1 W2 W3] [--quick]

Needs the extras `bench` and `mpi`, two cores and 8 GB; takes under 15 minutes. Every code is a process of its own; they take
turns of some steps (contest.py), so that ratios are of times taken in the same minutes. Workloads are in workloads.py. Exits
with 1 where a must fails. With --docs it writes results/kernels.md and pictures/kernels.png there. --quick is for work on this
file: 1/60 of the particles, which stay in the caches, so that no must is judged.

A step of pmpm is all of `Simulation.step()`: choice of dt, sorting, grid, halo. Its sorts fall into some rounds and not into
others; their time is spread evenly over all steps.
"""

import argparse
import contextlib
import importlib.util
import os
import statistics
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

import ceilings
import contest
import kernels_page
import machine
import numpy as np
from contest import Child, ContestantError
from kernels_page import Goal
from stages import Progress
from workloads import LAWS, Workload

PACKAGES = ("numba", "numpy", "taichi", "warp-lang", "mpi4py")
ROUNDS = 6
COMPARED = 8  # steps from the start after which positions are compared
# The peers keep positions in metres: a float32 in [0.5, 1) has a last place of 6e-8. Half of it is lost when a step is added,
# the other half is left for what weights and velocities lose.
DIFFERENCE = COMPARED * 2.0**-24
LEAST_STEPS, LEAST_SORTS = 60, 2
AVX2 = {"NUMBA_CPU_NAME": "x86-64-v3", "NUMBA_CPU_FEATURES": "+avx2,+fma"}
ORDINARY, FAST = "ordinary", "fast"

TAICHI = {"W1": (15.0, 25.0), "W2": (22.0, 38.0), "W3": (15.0, 25.0)}  # times faster: must, stretch
WARP = {"W1": (4.5, 6.5), "W2": (14.0, 22.0), "W3": (4.5, 6.5)}
TWO_RANKS = {"W1": 12.0, "W2": 15.0, "W3": 12.0}
TOUCHED = {"W1": 96, "W2": 100, "W3": 64}  # bytes per particle
HELD = {"W1": 112, "W2": 116, "W3": 80}


@dataclass(frozen=True)
class Contestant:
    """A code as it is timed: a module of peers/ with its arguments, and how many steps make a turn."""

    label: str
    module: str
    arguments: tuple = ()
    steps: int = 20
    ranks: int = 1
    two_cores: bool = False
    environment: dict = field(default_factory=dict, hash=False)
    same_problem: bool = True  # its positions can be compared


TAICHI_1 = Contestant("Taichi", "peers.taichi_mpm", steps=2)
WARP_1 = Contestant("Warp", "peers.warp_mpm", steps=3)
PMPM = Contestant("pmpm", "peers.pmpm_mpm")
FLOAT64 = Contestant("pmpm float64", "peers.pmpm_mpm", ("--precision", "float64"))
ONLY_AVX2 = Contestant("pmpm AVX2", "peers.pmpm_mpm", environment=AVX2)
SHUFFLED = Contestant("pmpm shuffled", "peers.pmpm_mpm", ("--shuffled",))
CUBIC = Contestant("pmpm cubic", "peers.pmpm_mpm", ("--shape-function", "cubic"), same_problem=False)
OWN_LAW = Contestant("pmpm, own law", "peers.pmpm_mpm", ("--own-law",))
PLANE = Contestant("pmpm 2-D", "peers.pmpm_mpm", ("--dim", "2"), same_problem=False)
TAICHI_2 = Contestant("Taichi, 2 threads", "peers.taichi_mpm", steps=2, two_cores=True)
PMPM_2 = Contestant("pmpm, 2 ranks", "peers.pmpm_mpm", ranks=2, two_cores=True)
ON_ONE_CORE = (TAICHI_1, WARP_1, PMPM)
ALL = {
    "W1": (*ON_ONE_CORE, FLOAT64, ONLY_AVX2, SHUFFLED, OWN_LAW, CUBIC, PLANE, TAICHI_2, PMPM_2),
    "W2": (*ON_ONE_CORE, TAICHI_2, PMPM_2),
    "W3": (*ON_ONE_CORE, FLOAT64, ONLY_AVX2, TAICHI_2, PMPM_2),
}


@dataclass
class Timing:
    """What one contestant took, one entry per round."""

    particles: int
    steps: list = field(default_factory=list)
    seconds: list = field(default_factory=list)
    phases: list = field(default_factory=list)
    sorts: int = 0

    def add(self, answer):
        self.steps.append(len(answer["seconds"]))
        self.seconds.append(sum(answer["seconds"]))
        self.phases.append(answer["phases"])
        self.sorts += answer["sorts"]

    def costs(self):
        """ns per particle-step of each round, sorting spread evenly over all of them."""
        sorting = [phases.get("regroup", 0.0) for phases in self.phases]
        spread = sum(sorting) / sum(self.steps)
        per_step = [(s - r) / n + spread for s, r, n in zip(self.seconds, sorting, self.steps, strict=True)]
        return [1e9 * seconds / self.particles for seconds in per_step]

    def cost(self):
        return statistics.median(self.costs())

    def phase(self, name):
        """ns per particle-step, mean over all rounds."""
        return 1e9 * sum(p.get(name, 0.0) for p in self.phases) / sum(self.steps) / self.particles

    def phase_names(self):
        return [name for name in self.phases[0] if name != "compile"]


@dataclass
class Measured:
    """All that one call found, by (workload, pace, label) or (workload, label)."""

    timings: dict = field(default_factory=dict)
    facts: dict = field(default_factory=dict)
    differences: dict = field(default_factory=dict)  # max |x - x of pmpm|, m
    moved: dict = field(default_factory=dict)  # (workload, pace) -> longest way of a particle, m
    absent: dict = field(default_factory=dict)  # why there is no timing
    flops: float = 0.0
    bandwidth: float = 0.0

    def ratio(self, workload, slow, quick, pace=ORDINARY):
        """(ratio of the medians, ratios round by round) of the costs of two contestants; None if one has none."""
        pair = [self.timings.get((workload, pace, label)) for label in (slow, quick)]
        if None in pair:
            return None
        rounds = [a / b for a, b in zip(*(timing.costs() for timing in pair), strict=True)]
        return pair[0].cost() / pair[1].cost(), rounds


class Contest:
    """All contestants of one workload, in turns; one that breaks down is left out from then on, and why is noted."""

    def __init__(self, name, contestants, cells, measured, progress):
        self.name, self.contestants, self.measured, self.progress = name, contestants, measured, progress
        cores = sorted(os.sched_getaffinity(0))[:2]
        self.children = {
            one: Child(
                one.module,
                (name, cells, *one.arguments),
                cores if one.two_cores else cores[:1],
                one.ranks,
                one.environment,
            )
            for one in contestants
        }

    def with_each(self, contestants, act):
        for one in [c for c in contestants if c in self.children]:
            try:
                act(one, self.children[one])
            except ContestantError as error:
                self.measured.absent[self.name, one.label] = str(error)
                self.progress.tell(f"{self.name}: {one.label} is out: {error}")
                self.progress.done -= 1
                self.children.pop(one).end()

    def run(self, rounds):
        self.progress.tell(f"{self.name}: starting {len(self.children)} contestants")
        self.with_each(self.contestants, self.note_facts)
        self.run_pace(ORDINARY, self.contestants, rounds)
        self.run_pace(FAST, ON_ONE_CORE, rounds)

    def note_facts(self, one, child):
        self.measured.facts[self.name, one.label] = child.read()

    def run_pace(self, pace, contestants, rounds):
        self.progress.tell(f"{self.name}, {pace}: {COMPARED} steps to compare")
        positions = {}

        def compare(one, child):
            child.ask(do="start", fast=pace == FAST)
            first = saved_positions(child)
            child.ask(do="step", steps=COMPARED)
            positions[one] = saved_positions(child)
            if one is PMPM:
                moved = np.linalg.norm(positions[one] - first, axis=1).max()
                self.measured.moved[self.name, pace] = moved

        self.with_each(contestants, compare)
        for one, x in positions.items():
            if one.same_problem and one is not PMPM and PMPM in positions:
                difference = np.abs(x - positions[PMPM]).max()
                self.measured.differences[self.name, pace, one.label] = difference

        def take_turn(one, child):
            key = self.name, pace, one.label
            timing = self.measured.timings.setdefault(
                key, Timing(self.measured.facts[self.name, one.label]["particles"])
            )
            timing.add(child.ask(do="step", steps=one.steps))

        for number in range(rounds):
            self.progress.tell(f"{self.name}, {pace}: round {number + 1} of {rounds}")
            self.with_each(contestants, take_turn)

    def close(self):
        for child in self.children.values():
            child.end()


def saved_positions(child):
    """(n, dim) float64, in the order of the workload."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "x.npy"
        child.ask(do="positions", path=str(path))
        return np.load(path).astype(np.float64)


def measure(names, cells, rounds):
    measured = Measured()
    progress = Progress(len(names) * (4 + 2 * rounds))
    for name in names:
        progress.tell(f"{name}: what one core can do")
        measure_ceilings(measured)
        with contextlib.closing(Contest(name, ALL[name], cells, measured, progress)) as race:
            race.run(rounds)
    return measured


def measure_ceilings(measured):
    """The best found so far on one core: other work on the machine only ever lowers it."""
    cores = os.sched_getaffinity(0)
    contest.pin([min(cores)])
    measured.flops = max(measured.flops, ceilings.peak_flops())
    measured.bandwidth = max(measured.bandwidth, ceilings.bandwidth())
    contest.pin(cores)


def goals(measured, names):
    """Every must of the speed of a step, with what has been reached."""
    found = []
    for name in names:
        law = f"{name} {LAWS[name]}"
        found += [
            faster(measured, name, f"{law}: Taichi, 1 thread / pmpm", "Taichi", "pmpm", *TAICHI[name]),
            faster(measured, name, f"{law}: Warp / pmpm", "Warp", "pmpm", *WARP[name]),
            faster(measured, name, f"{law}: 2 threads / 2 ranks", TAICHI_2.label, PMPM_2.label, TWO_RANKS[name]),
            Goal(f"{law}: bytes touched per particle", fact(measured, name, "touched"), TOUCHED[name], at_least=False),
            Goal(f"{law}: bytes held per particle", fact(measured, name, "held"), HELD[name], at_least=False),
            Goal(
                f"{law}: ordered sum, share of the step (%)", share_of_ordered_sum(measured, name), 5.0, at_least=False
            ),
        ]
        if ONLY_AVX2 in ALL[name]:
            found.append(faster(measured, name, f"{law}: Taichi / pmpm AVX2", "Taichi", ONLY_AVX2.label, 8.0))
        if FLOAT64 in ALL[name]:
            found.append(dearer(measured, name, f"{law}: float64 / float32", FLOAT64.label, 2.6, 2.2))
    if "W1" in names:
        found += [
            dearer(measured, "W1", "W1 jelly: cubic / quadratic", CUBIC.label, 2.2),
            dearer(measured, "W1", "W1 jelly: 2-D / 3-D, per particle", PLANE.label, 0.75, 0.5),
            # Not 1: two equal codes differ by this much on a shared machine.
            dearer(measured, "W1", "W1 jelly: shuffled / sorted start", SHUFFLED.label, 1.1),
            dearer(measured, "W1", "W1 jelly: law given as a Python function / built-in", OWN_LAW.label, 1.1),
        ]
    for name in names:
        timing = measured.timings.get((name, ORDINARY, "pmpm"))
        steps, sorts = (sum(timing.steps), timing.sorts) if timing else (None, None)
        found += [
            Goal(f"{name}: steps measured", steps, LEAST_STEPS),
            Goal(f"{name}: sorts among them", sorts, LEAST_SORTS),
        ]
        for pace in (ORDINARY, FAST):
            others = [d for (n, p, _), d in measured.differences.items() if (n, p) == (name, pace)]
            worst = float(np.max(others)) if others else None  # nan if any is
            found.append(Goal(f"{name}, {pace}: positions differ by (m)", worst, DIFFERENCE, at_least=False))
    return found


def faster(measured, name, text, slow, quick, must, stretch=None):
    ratio = measured.ratio(name, slow, quick)
    return Goal(text, ratio and ratio[0], must, stretch, spread=ratio and ratio[1])


def dearer(measured, name, text, label, must, stretch=None):
    ratio = measured.ratio(name, label, "pmpm")
    return Goal(text, ratio and ratio[0], must, stretch, at_least=False, spread=ratio and ratio[1])


def fact(measured, name, key):
    """Rounded to a tenth: of the bytes, blocks filled up with nothing and the table of segments are less."""
    value = measured.facts.get((name, "pmpm"), {}).get(key)
    return value and round(value, 1)


def share_of_ordered_sum(measured, name):
    timing, facts = measured.timings.get((name, ORDINARY, "pmpm")), measured.facts.get((name, "pmpm"))
    return 100.0 * facts["ordered sum"] / timing.cost() if timing and facts else None


def missing():
    """Names of packages that this benchmark needs and does not find."""
    return [name for name in ("taichi", "warp", "matplotlib", "mpi4py") if importlib.util.find_spec(name) is None]


def main():
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--workloads", nargs="+", choices=list(ALL), default=list(ALL), help="which of them")
    options.add_argument("--quick", action="store_true", help="a small grid and two rounds; judges and writes nothing")
    options.add_argument("--docs", type=Path, help="write page and picture here")
    given = options.parse_args()
    if lacking := missing():
        print(f"{', '.join(lacking)}: not installed; pip install 'pmpm[bench,mpi]'", file=sys.stderr)
        return 2
    if len(os.sched_getaffinity(0)) < 2:
        print("this benchmark needs two cores", file=sys.stderr)
        return 2
    if given.docs and (given.quick or set(given.workloads) != set(ALL)):
        options.error("--docs wants a full run: neither --quick nor --workloads")
    began = time.perf_counter()
    measured = measure(given.workloads, 32 if given.quick else Workload("W1").cells, 2 if given.quick else ROUNDS)
    minutes = (time.perf_counter() - began) / 60.0
    judged = goals(measured, given.workloads)
    tables = kernels_page.tables(measured, judged, given.workloads)
    print(tables)
    if given.quick:
        return 0
    found = [goal.text for goal in judged if not goal.met]
    print("\n".join(f"FAILED: {line}" for line in found) or "all musts hold")
    if given.docs:
        kernels_page.write(
            given.docs, tables, measured, judged, (machine.processor(), machine.versions(PACKAGES)), minutes, found
        )
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
