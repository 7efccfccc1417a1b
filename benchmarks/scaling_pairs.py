"""What two ranks lose against two separate processes at the same time: `python benchmarks/scaling.py pairs`.

Workloads W1 to W3 of docs/results/kernels.md, a million particles per rank: a single process with the other core idle, two such
processes at once, each on a core of its own, one run on two ranks of a block of twice the length, and the same on one rank of
two threads. They take turns of some steps (contest.py). Two processes share what the machine shares (caches, memory, clock)
and nothing else, so that the ratio holds what pmpm's own parallel step costs: halo, ghost nodes, waiting, imbalance.
"""

import os
import statistics

import machine
import pages
from contest import Child, ContestantError
from kernels import Timing
from stages import Progress
from workloads import LAWS, Workload

THREADS_GATE = 0.9  # threads meet several times in a step, and one of them balances and migrates for all
GATE = 0.95  # the ordered sum and the halo cost 2 to 3 % of a step, and packing as much again
STEPS = 40  # of a turn
CELLS, QUICK_CELLS = 128, 32
NAMES = ("one, the other core idle", "two processes", "two ranks", "two threads")
COLUMNS = (
    "",
    "one process",
    "two processes",
    "two ranks",
    "ratio",
    "rounds: min / median / max",
    "weak efficiency",
    "two threads",
    "over two ranks",
    "",
)
NOTES = """\
- The first three columns are million particle-steps per second; sorts fall into some turns only, their time is spread evenly.
- `ratio`: two ranks over two processes, medians; then the same round by round. It must be at least {gate}.
- `weak efficiency`: two ranks over twice one process that has the machine to itself.
- `over two ranks`: one rank of two threads over two ranks of one, medians; at least {threads_gate}.
"""


def rates(timings):
    """Particle-steps per second of each round; of several timings at the same time, their sum."""
    return [sum(1e9 / cost for cost in costs) for costs in zip(*(timing.costs() for timing in timings), strict=True)]


class Pair:
    """The processes of one workload. Raises ContestantError where one of them cannot be started or breaks down."""

    def __init__(self, name, cells):
        first, second = sorted(os.sched_getaffinity(0))[:2]
        alone, both = (name, cells), (name, cells, "--length", 2)
        self.children = []
        threads = (*both, "--threads", 2)
        for arguments, where, ranks in (
            (alone, [first], 1), (alone, [second], 1), (both, [first, second], 2), (threads, [first, second], 1),
        ):  # fmt: skip
            self.children.append(Child("peers.pmpm_mpm", arguments, where, ranks))
        facts = [child.read() for child in self.children]
        *singles, self.ranks, self.threads = (Timing(fact["particles"]) for fact in facts)
        self.alone, self.singles = Timing(facts[0]["particles"]), singles
        assert facts[2]["particles"] == Workload(name, cells, length=2).particles
        for child in self.children:
            child.ask(do="start", fast=False)

    def take_turns(self):
        one, other, ranks, threads = self.children
        self.alone.add(one.ask(do="step", steps=STEPS))
        for child in (one, other):
            child.tell(do="step", steps=STEPS)
        for child, timing in zip((one, other), self.singles, strict=True):
            timing.add(child.read())
        self.ranks.add(ranks.ask(do="step", steps=STEPS))
        self.threads.add(threads.ask(do="step", steps=STEPS))

    def rates(self):
        """{name: rates, one of each round}."""
        return dict(zip(NAMES, map(rates, ([self.alone], self.singles, [self.ranks], [self.threads])), strict=True))

    def end(self):
        for child in self.children:
            child.end()


def measure(name, cells, rounds, progress):
    """Rates of one workload by NAMES."""
    progress.tell(f"{name}: starting four runs")
    pair = Pair(name, cells)
    try:
        for number in range(rounds):
            pair.take_turns()
            progress.tell(f"{name}: round {number + 1} of {rounds}")
        return pair.rates()
    finally:
        pair.end()


def row(name, found, judged=True):
    """(cells of the table, whether the gate is met, or not asked); `found`: rates by NAMES, or what went wrong."""
    label = f"{name} {LAWS[name]}"
    if isinstance(found, str):
        return [label, found, *[""] * (len(COLUMNS) - 3), "✘"], False
    alone, two, ranks, threads = (statistics.median(found[key]) for key in NAMES)
    by_round = [a / b for a, b in zip(found[NAMES[2]], found[NAMES[1]], strict=True)]
    spread = " / ".join(f"{value:.3f}" for value in (min(by_round), statistics.median(by_round), max(by_round)))
    holds = (ranks / two >= GATE and threads / ranks >= THREADS_GATE) or not judged
    mark = "-" if not judged else "✔" if holds else "✘"
    speeds = (f"{rate / 1e6:.2f}" for rate in (alone, two, ranks))
    return [label, *speeds, f"{ranks / two:.3f}", spread, f"{ranks / 2.0 / alone:.3f}", f"{threads / 1e6:.2f}",
            f"{threads / ranks:.3f}", mark], holds  # fmt: skip


def compare(rounds, quick, docs):
    """Measure, print and write results/pairs.md under `docs`; returns the exit status."""
    if len(os.sched_getaffinity(0)) < 2:
        print("scaling: pairs need two cores")
        return 2
    progress, rows, holds = Progress(len(LAWS) * (1 + rounds)), [], True
    for name in LAWS:
        try:
            found = measure(name, QUICK_CELLS if quick else CELLS, rounds, progress)
        except ContestantError as error:
            found = str(error)
        cells, is_met = row(name, found, judged=not quick)
        rows.append(cells)
        holds = holds and is_met
        print(" | ".join(cells), flush=True)
    lines = ["| " + " | ".join(cells) + " |" for cells in (COLUMNS, ["---"] * len(COLUMNS), *rows)]
    print("\n".join(lines))
    print(
        "no gate is judged"
        if quick and holds
        else "the gate holds"
        if holds
        else f"FAILED: a ratio is below {GATE} or, of threads, {THREADS_GATE}, or a run has failed"
    )
    if docs:
        text = f"# Two ranks and two processes\n\n`python benchmarks/scaling.py pairs --rounds {rounds} --docs docs` "
        text += f"wrote this page.\n{machine.text()}.\n\n{__doc__.split(chr(10), 2)[2]}\n" + "\n".join(lines)
        pages.write(docs, "pairs", f"{text}\n\n{NOTES.format(gate=GATE, threads_gate=THREADS_GATE)}")
    return 0 if holds else 1
