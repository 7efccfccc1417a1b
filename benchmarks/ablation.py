"""What an optional feature costs where it is not used, where it is there and does nothing, and what the guard costs.

    python benchmarks/ablation.py [--quick] [--docs docs]

Unused: the fast loops are compiled twice, as they are and from a source in which the branches of every optional feature are
cut out, and the machine code of P2G and G2P is compared, instruction by instruction; bytes per particle are those of
`pmpm check`. Used: a block of rubber takes turns with the same block and one feature more, a few steps each, so that ratios
are of times taken within the same second; the feature does nothing (a force of zero, a second material far away), so that
the motion stays the same. The guard: jelly, sand and water of a million particles (benchmarks/workloads.py), with the sum of
energies timed by itself and the check of each particle's state compiled in or out. With --docs it writes
results/ablation.md there. Exits with 1 where unused features leave an instruction or a byte, or the guard costs more than 2 %.
Needs one core and 3 GB; 5 minutes. --quick: smaller blocks, fewer rounds, which judge the machine code alone.
"""

import argparse
import ast
import inspect
import os
import re
import statistics
import sys
import tempfile
import time
import types
from contextlib import contextmanager
from pathlib import Path
from unittest import mock

import machine
import pages
from peers.pmpm_mpm import PmpmSteps
from stages import Progress
from workloads import LAWS, Workload

import pmpm
from pmpm import estimate
from pmpm.kernels import build, lane_loops
from pmpm.scene.needs import scene_needs

# Constants of the fast loops that a scene turns on by asking for something.
OPTIONAL = ("FORCED", "LOADED", "VISCOUS", "F_BAR", "DIVERGENCE", "BLENDS", "PERIODIC_MIDDLE", "PERIODIC_ROW")
RUBBER = {"model": "neo_hookean", "density": 1000.0, "youngs_modulus": 1e4, "poisson_ratio": 0.3}
HENCKY = RUBBER | {"model": "hencky"}
SAND = RUBBER | {"model": "drucker_prager", "friction_angle": 35.0}
WATER = {"model": "fluid", "density": 1000.0, "sound_speed": 4.0}
CELLS, QUICK_CELLS, MARGIN = 24, 8, 6  # of the block along each axis, and around it
CELL_SIZE = 0.01
ROUNDS, QUICK_ROUNDS, STEPS = 9, 3, 5
LARGEST_GUARD = 0.02  # of a step
MILLION, QUICK_BLOCK = 128, 32  # cells per metre of the workloads
ENERGY_SUMS = 5


# ---- unused: what is compiled ------------------------------------------------------------------------------------------------


class WithoutBranches(ast.NodeTransformer):
    """Cuts out `if FEATURE:` and leaves what stands behind its `else`."""

    def __init__(self):
        self.cut = 0

    def visit_If(self, node):  # noqa: N802 - the name that ast asks for
        self.generic_visit(node)
        if isinstance(node.test, ast.Name) and node.test.id in OPTIONAL:
            self.cut += 1
            return node.orelse
        return node


def loops_without_features():
    """(the fast loops from a source without the branches of optional features, how many branches that were)."""
    cutter = WithoutBranches()
    tree = ast.fix_missing_locations(cutter.visit(ast.parse(inspect.getsource(lane_loops))))
    module = types.ModuleType(lane_loops.__name__)
    exec(compile(tree, lane_loops.__file__, "exec"), module.__dict__)
    return module, cutter.cut


@contextmanager
def compiled_afresh(loops):
    """Build kernels from these fast loops, into an empty cache: what is loaded from one keeps no text."""
    with (
        tempfile.TemporaryDirectory() as folder,
        mock.patch.dict(os.environ, PMPM_CACHE_DIR=folder),
        mock.patch.object(build, "lane_loops", loops),
        mock.patch.dict(build.LOOPS, lanes=loops),
    ):
        yield


def instructions(simulation):
    """{kernel: lines of machine code} of P2G and G2P, without directives and the names of symbols."""
    found = {}
    for name in ("p2g 0", "g2p 0"):
        entry = simulation.kernels.entries[name]
        text = re.sub(r"_ZN\S+?(?=[\s,@()\"]|$)|\$?\.const\.\w+", "symbol", entry.inspect_asm(entry.signatures[0]))
        found[name] = [line for line in text.splitlines() if re.match(r"\t[a-z]", line)]
    return found


def left_by_unused(scene):
    """{kernel: (instructions, how many of them differ without the branches of optional features)}, and how many were cut."""
    module, cut = loops_without_features()
    with compiled_afresh(lane_loops):
        whole = instructions(pmpm.Simulation(scene))
    with compiled_afresh(module):
        bare = instructions(pmpm.Simulation(scene))
    differ = {name: different_lines(whole[name], bare[name]) for name in whole}
    return {name: (len(whole[name]), differ[name]) for name in whole}, cut


def different_lines(one, other):
    return abs(len(one) - len(other)) + sum(a != b for a, b in zip(one, other, strict=False))


# ---- used: what a step takes -------------------------------------------------------------------------------------------------


def no_force(x, X, t):
    return (0.0 * x[0], 0.0 * x[1], 0.0 * x[2])


def force_of_reference(x, X, t):
    return (0.0 * X[0], 0.0 * x[1], 0.0 * x[2])


def block(cells, material=RUBBER, beside=None, method=None, domain=None, **parts):
    """A block of one material in the middle, at rest; `beside`: a material of which one cell lies in the corner."""
    size = (cells + 2 * MARGIN) * CELL_SIZE
    low, high = MARGIN * CELL_SIZE, (MARGIN + cells) * CELL_SIZE
    bodies = [{"material": "block", "shape": {"type": "box", "min": [low] * 3, "max": [high] * 3}}]
    materials = {"block": material}
    if beside is not None:
        materials["beside"] = beside
        bodies.append(
            {"material": "beside", "shape": {"type": "box", "min": [CELL_SIZE] * 3, "max": [2 * CELL_SIZE] * 3}}
        )
    return pmpm.Scene(
        domain={"size": [size] * 3, "cell_size": CELL_SIZE} | (domain or {}),
        method={"precision": "float32"} | (method or {}),
        time={"end": 1.0, "step": 2e-4},
        materials=materials,
        bodies=bodies,
        **({"guard": {"energy_gain": 0.0}} | parts),
    )


def features(cells):
    """{feature: (scene without it, scene with it)}; without it, and unless told otherwise, everything optional is absent."""
    plain = block(cells)
    whole = {"type": "box", "min": [0.0] * 3, "max": [1.0] * 3}
    corner = {"type": "box", "min": [0.0] * 3, "max": [2 * CELL_SIZE] * 3}
    water = block(cells, WATER)
    return {
        "nothing: the same scene twice": (plain, block(cells)),
        "gravity": (plain, block(cells, domain={"gravity": [0.0, 0.0, -1e-9]})),
        "a body force": (plain, block(cells, body_force=no_force)),
        "a body force that reads X": (plain, block(cells, body_force=force_of_reference)),
        "loads": (plain, block(cells, loads=[{"shape": whole, "acceleration": [0.0, 0.0, 0.0]}])),
        "a region in motion": (plain, block(cells, motions=[{"shape": corner, "velocity": [0.0] * 3, "moves": False}])),
        "damping": (plain, block(cells, method={"damping": 1e-9})),
        "a second material, same law": (plain, block(cells, beside=RUBBER | {"density": 900.0})),
        "a second material, another law": (plain, block(cells, beside=WATER)),
        "a periodic axis": (plain, block(cells, domain={"periodic": ["y"]})),
        "an affine field (APIC after PIC)": (block(cells, method={"transfer": "pic"}), plain),
        "FLIP's velocities (AFLIP after APIC)": (plain, block(cells, method={"transfer": "aflip"})),
        "F-bar": (plain, block(cells, method={"f_bar": True})),
        "viscosity of a fluid": (water, block(cells, WATER | {"viscosity": 1e-9})),
        "plasticity (sand after Hencky)": (
            block(cells, HENCKY),
            block(cells, SAND | {"volume_correction": False}),
        ),
        "volume correction of sand": (
            block(cells, SAND | {"volume_correction": False}),
            block(cells, SAND),
        ),
        "cohesion and dilatancy of sand": (
            block(cells, SAND),
            block(cells, SAND | {"cohesion": 1e-3, "dilatancy_angle": 1.0}),
        ),
        "the guard's energies": (plain, block(cells, guard={"energy_gain": 0.5})),
        "diagnostics every 20 steps": (plain, plain),
    }


def bytes_of(scene):
    """Of a particle of the block."""
    return sum(estimate.bytes_per_particle(scene_needs(scene))[0].values())


def compared(feature, pair, rounds):
    """(median of the ratios of step times, smallest, largest, ns per particle and step without, with)."""
    simulations = [pmpm.Simulation(scene) for scene in pair]
    if feature.startswith("diagnostics"):
        simulations[1].every(lambda simulation: simulation.measure(), steps=4 * STEPS)
    # The guard's sum comes every 100 steps: its share is the same when its interval and the turn are as long.
    turn = simulations[1].scene.guard.interval if feature.startswith("the guard") else STEPS
    turn = 4 * STEPS if feature.startswith("diagnostics") else turn
    for simulation in simulations:
        simulation.run(steps=turn)
    ratios, seconds = [], [[], []]
    for round_number in range(rounds):
        order = (0, 1) if round_number % 2 else (1, 0)
        for which in order:
            began = time.process_time()
            simulations[which].run(steps=turn)
            seconds[which].append((time.process_time() - began) / turn)
        ratios.append(seconds[1][-1] / seconds[0][-1])
    rows = simulations[0].rows()
    ns = [1e9 * min(found) / rows for found in seconds]
    return statistics.median(ratios), min(ratios), max(ratios), *ns


# ---- the guard ---------------------------------------------------------------------------------------------------------------


def always_valid(state):
    """Of a particle's state, without looking at it."""
    return state[0] == state[0]


def workload_steps(name, cells):
    steps = PmpmSteps(Workload(name, cells), "float32", "quadratic", False, False, None)
    steps.start(False)
    return steps


def guard_costs(name, cells, rounds):
    """What the guard adds to a step of a workload, as parts of it: (check of states, sum of energies), and ns per particle of
    a step and of a sum."""
    with_check = workload_steps(name, cells)
    module = with_check.simulation.needs.laws[0].module
    with mock.patch.object(module, "valid", always_valid):
        without = workload_steps(name, cells)
    ratios, seconds = [], []
    for round_number in range(rounds + 1):
        pair = {}
        for steps in (with_check, without) if round_number % 2 else (without, with_check):
            began = time.process_time()
            for _ in range(STEPS):
                steps.step()
            pair[steps] = (time.process_time() - began) / STEPS
        if round_number:
            ratios.append(pair[with_check] / pair[without])
            seconds.append(pair[with_check])
    simulation = with_check.simulation
    simulation.energies()
    began = time.process_time()
    for _ in range(ENERGY_SUMS):
        simulation.energies()
    of_sum = (time.process_time() - began) / ENERGY_SUMS
    step, interval = min(seconds), simulation.scene.guard.interval
    per_particle = 1e9 / with_check.particles
    return statistics.median(ratios) - 1.0, of_sum / interval / step, step * per_particle, of_sum * per_particle


# ---- the page ----------------------------------------------------------------------------------------------------------------


HEAD = """# What optional features cost

`python benchmarks/ablation.py --docs docs`, {machine}. One core, processor time, 3-D,
float32, APIC with quadratic splines.

## Unused

The fast loops were compiled as they are, and from a source in which all {cut} branches of optional features had been cut out:
{optional}.

| kernel | instructions | of them different |
| --- | --- | --- |
{unused}

A feature that a scene does not use leaves no instruction, hence no time. Nor does it leave a byte: what a particle holds is
listed field by field in [what each scene needs](what_scenes_need.md), and a test compares that with what is allocated.

## Used

A block of {cells}^3 cells, 8 particles each, with the feature present and doing nothing, in turns with the block without it:
median of {rounds} rounds, with the smallest and largest. The first row tells what a difference of nothing looks like.

| feature | ns per particle without | with | ratio | from .. to | bytes more |
| --- | --- | --- | --- | --- | --- |
{used}

## The guard

Workloads of benchmarks/kernels.py. Every step checks each particle's state (not a number, det F <= 0, out of reach); every
100 steps the energies are summed. Allowed: {allowed:g} % of a step in all.

| workload | step, ns per particle | check of states, % of a step | a sum of energies, ns per particle | its share, % |
| --- | --- | --- | --- | --- |
{guards}

The check of states was compared with kernels whose law says `valid` of everything; a value below zero is noise.
"""


def page(unused, cut, rows, guards, rounds, cells):
    """The text of results/ablation.md."""
    of_features = (
        f"| {feature} | {ns[0]:.1f} | {ns[1]:.1f} | {ratio:.3f} | {low:.3f} .. {high:.3f} | {more} |"
        for feature, (ratio, low, high, *ns), more in rows
    )
    of_guard = (
        f"| {name} {LAWS[name]} | {step:.1f} | {100 * check:+.1f} | {one_sum:.1f} | {100 * share:.2f} |"
        for name, (check, share, step, one_sum) in guards.items()
    )
    return HEAD.format(
        machine=machine.text(),
        cut=cut,
        optional=", ".join(OPTIONAL),
        unused="\n".join(f"| {name} | {count} | {differ} |" for name, (count, differ) in unused.items()),
        cells=cells,
        rounds=rounds,
        used="\n".join(of_features),
        allowed=100 * LARGEST_GUARD,
        guards="\n".join(of_guard),
    )


def main():
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--quick", action="store_true", help="small blocks, few rounds; judges the machine code alone")
    options.add_argument("--docs", type=Path, help="folder of the documentation, for results/ablation.md")
    given = options.parse_args()
    cells, rounds = (QUICK_CELLS, QUICK_ROUNDS) if given.quick else (CELLS, ROUNDS)
    pairs = features(cells)
    progress = Progress(len(pairs) + len(LAWS) + 1)
    progress.tell("machine code of what is not used")
    unused, cut = left_by_unused(block(QUICK_CELLS))
    print(unused, flush=True)
    rows, guards = [], {}
    for feature, pair in pairs.items():
        progress.tell(feature)
        found, more = compared(feature, pair, rounds), bytes_of(pair[1]) - bytes_of(pair[0])
        rows.append((feature, found, more))
        print(f"    {found[3]:.1f} -> {found[4]:.1f} ns, ratio {found[0]:.3f}, {more} bytes", flush=True)
    for name in LAWS:
        progress.tell(f"guard on {name} {LAWS[name]}")
        guards[name] = guard_costs(name, QUICK_BLOCK if given.quick else MILLION, rounds)
        print("    check {:+.3f}, energies {:.4f} of a step of {:.1f} ns".format(*guards[name]), flush=True)
    if given.docs:
        pages.write(given.docs, "ablation", page(unused, cut, rows, guards, rounds, cells))
    missed = [f"{name}: {differ} instructions differ" for name, (_, differ) in unused.items() if differ]
    if not given.quick:
        missed += [
            f"the guard takes {100 * (check + share):.1f} % of a step of {name}"
            for name, (check, share, *_) in guards.items()
            if check + share > LARGEST_GUARD
        ]
    print("\n".join(missed) or "no unused feature leaves an instruction or a byte")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
