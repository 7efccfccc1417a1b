"""Measures the constants of benchmarks/scaling_model.py on this machine: `python benchmarks/scaling_model.py --fit`.

Costs of a particle-step and of a regroup come from workloads W1 to W3 on one core (contest.py), the link between two ranks of a
node from ping_pong.py, copying from a triad over arrays beyond the caches (ceilings.py).
"""

import json
import os
import statistics
import subprocess
import sys
from pathlib import Path

import ceilings
import machine
from contest import Child
from kernels import Timing
from scaling_model import Constants, LawCost, Link
from scaling_runs import RunError, start_words, surroundings
from stages import Progress
from workloads import LAWS

CELLS, QUICK_CELLS, FEWEST_CELLS = 128, 40, 8
ROUNDS, STEPS = 6, 20
READS = 3  # times that a step moves what it touches: P2G reads it, G2P reads and writes it
FILE_BYTES = 137.0  # of a particle of W1 in a checkpoint, docs/results/reliability.md


def fit(quick=False):
    """The Constants of this machine. Raises RunError or ContestantError where something does not run."""
    progress = Progress(3 + len(LAWS))
    progress.tell("memory of one core")
    copy = ceilings.bandwidth()
    progress.tell("messages between two ranks")
    local = link()
    laws, every = {}, []
    for name in LAWS:
        progress.tell(f"{name} on one core")
        laws[name], steps = law_cost(name, QUICK_CELLS if quick else CELLS, 2 if quick else ROUNDS)
        every.append(steps)
    progress.tell("a step of next to no particles")
    return Constants(
        laws, fixed_seconds(), statistics.mean(every), copy, local, FILE_BYTES, f"Measured: {machine.text()}."
    )


def fixed_seconds():
    """s of a step of 216 particles, median."""
    child = Child("peers.pmpm_mpm", ("W1", FEWEST_CELLS), sorted(os.sched_getaffinity(0))[:1])
    try:
        child.read()
        child.ask(do="start", fast=False)
        return statistics.median(child.ask(do="step", steps=1000)["seconds"])
    finally:
        child.end()


def law_cost(name, cells, rounds):
    """(LawCost, steps between two regroups) of a workload."""
    child = Child("peers.pmpm_mpm", (name, cells), sorted(os.sched_getaffinity(0))[:1])
    try:
        facts = child.read()
        child.ask(do="start", fast=False)
        timing = Timing(facts["particles"])
        for _ in range(rounds):
            timing.add(child.ask(do="step", steps=STEPS))
    finally:
        child.end()
    steps, sorts = sum(timing.steps), max(timing.sorts, 1)
    sorting = 1e-9 * timing.phase("regroup")
    particle = 1e-9 * timing.cost() - sorting
    return LawCost(
        particle, sorting * steps / sorts, round(facts["held"]), round(READS * facts["touched"])
    ), steps / sorts


def link():
    """The Link between two ranks on two cores."""
    words = start_words([sys.executable, str(Path(__file__).with_name("ping_pong.py"))], 2)
    done = subprocess.run(words, env=surroundings(), stdin=subprocess.DEVNULL, capture_output=True, text=True)
    if done.returncode:
        raise RunError(f"ping_pong.py ended with status {done.returncode}: {done.stderr.strip()[-200:]}")
    return link_of(json.loads(done.stdout))


def link_of(found):
    """The Link that takes the seconds of [[bytes, seconds], ...] for the smallest and the largest message."""
    latency, (size, seconds) = found[0][1], found[-1]
    return Link(latency, (size - found[0][0]) / (seconds - latency))
