"""What empty space costs: as many particles in a tight box, in a domain that is 1 % full, and as a thin inclined sheet.

    python benchmarks/empty_space.py [--quick] [--rounds 5] [--docs docs]

3-D water in float32, one rank. "Block": a cube of particles in a domain of its own size, and in one a hundred times as large.
"Sheet": a disk three cells thick, normal to (1, 1, 1), in a domain as large as its own bounds, of which it fills about 1 %,
against one of as many particles that lies flat in a tight box; and against a cube, to tell what it costs to be thin: a sheet's
particles reach three times the nodes of a cube's, and fewer share their stencil. All move slowly, so that nodes are laid out
anew now and then. Time: processor time of steps, cases taken in turns in one process, medians over rounds. Memory: the largest
resident size of a process of its own for each case, less that of one with a few hundred particles. Gate: 1.15 times the tight
box, but not of the cube.
"""

import argparse
import json
import math
import resource
import statistics
import subprocess
import sys
import time
from pathlib import Path

import machine
import pages
import stages

import pmpm

CELL, THICKNESS, FULL, GATE, STEPS = 0.01, 3, 0.01, 1.15, 20
SIZES = {
    "full": (64, 216),
    "quick": (40, 60),
    "nothing": (4, 4),
}  # cells along a side of the block, and of the radius of the sheet
CASES = ("tight block", "block, domain 1 % full", "flat sheet, tight", "inclined sheet", "cube like the sheet")
PAIRS = ((0, 1, True), (2, 3, True), (4, 3, False))  # reference, compared, whether it is judged


def sides(case, size):
    """(cells of the body along the axes or None, cells of the domain) of a case, for one of SIZES. A disk of radius r and
    thickness t has the volume pi r^2 t and bounds of 2 r sqrt(2/3) + t / sqrt 3: r = 72 t fills 1 % of them."""
    cells, radius = SIZES[size]
    cube = round((math.pi * radius**2 * THICKNESS) ** (1 / 3))
    flat = (round(radius * math.sqrt(math.pi)),) * 2 + (THICKNESS,)
    bounds = math.ceil(2 * radius * math.sqrt(2 / 3) + THICKNESS / math.sqrt(3))
    return {
        CASES[0]: ((cells,) * 3, (cells,) * 3),
        CASES[1]: ((cells,) * 3, (round(cells * FULL ** (-1 / 3)),) * 3),
        CASES[2]: (flat, flat),
        CASES[3]: (None, (bounds,) * 3),
        CASES[4]: ((cube,) * 3, (cube,) * 3),
    }[case]


def scene(case, size):
    body, domain = sides(case, size)
    centre = [0.5 * cells * CELL for cells in domain]
    if body is None:
        disk = {"center": centre, "axis": [1, 1, 1], "radius": SIZES[size][1] * CELL, "height": THICKNESS * CELL}
        shape = {"type": "cylinder", **disk}
    else:
        low = [(around - cells) // 2 for around, cells in zip(domain, body, strict=True)]
        high = [first + cells for first, cells in zip(low, body, strict=True)]
        shape = {"type": "box", "min": [CELL * c for c in low], "max": [CELL * c for c in high]}
    return pmpm.Scene(
        domain={"size": [cells * CELL for cells in domain], "cell_size": CELL, "gravity": [0.0, 0.0, -9.81]},
        method={"precision": "float32"},
        time={"end": 10.0},
        materials={"water": {"model": "fluid", "density": 1000.0, "sound_speed": 20.0}},
        bodies=[{"material": "water", "shape": shape, "velocity": [0.2, 0.1, 0.0]}],
    )


def resident():
    """Bytes of the largest resident size so far."""
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def memory(case, size):
    """(particles, bytes) of a process that takes STEPS steps of a case."""
    simulation = pmpm.Simulation(scene(case, size))
    for _ in range(STEPS):
        simulation.step()
    return simulation.rows(), resident()


def in_a_process(case, size):
    command = [sys.executable, __file__, "--child", case, "--size", size]
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()[-1])


def nothing():
    """Bytes of a process that has loaded the same and holds next to no particles."""
    in_a_process(CASES[0], "nothing")  # compiles
    return in_a_process(CASES[0], "nothing")[1]


def times(size, rounds, progress):
    """Of each case, seconds of processor time per particle-step in each round; and (particles, cells of its domain)."""
    simulations, facts, found = [], [], {case: [] for case in CASES}
    for case in CASES:
        progress.tell(f"{case}: filled")
        simulations.append(pmpm.Simulation(scene(case, size)))
        facts.append((simulations[-1].rows(), sides(case, size)[1]))
        for _ in range(3):
            simulations[-1].step()
    for number in range(rounds):
        progress.tell(f"round {number + 1} of {rounds}")
        for case, simulation in zip(CASES, simulations, strict=True):
            began = time.process_time()
            for _ in range(STEPS):
                simulation.step()
            found[case].append((time.process_time() - began) / STEPS / simulation.rows())
    return found, dict(zip(CASES, facts, strict=True))


def main():
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--rounds", type=int, default=5)
    options.add_argument(
        "--quick", action="store_true", help="smaller, 3 rounds: too few particles for memory to be judged"
    )
    options.add_argument("--docs", type=Path, help="folder in which results/empty_space.md is written")
    options.add_argument("--child", help=argparse.SUPPRESS)
    options.add_argument("--size", choices=SIZES, default="full", help=argparse.SUPPRESS)
    given = options.parse_args()
    size = "quick" if given.quick else given.size
    if given.child:
        print(json.dumps(memory(given.child, size)))
        return 0
    rounds = 3 if given.quick else given.rounds
    progress = stages.Progress(2 * len(CASES) + rounds + 1)
    progress.tell("a process with next to nothing")
    floor = nothing()
    held = {}
    for case in CASES:
        progress.tell(f"{case}: memory")
        particles, most = in_a_process(case, size)
        held[case] = (most - floor) / particles
    found, facts = times(size, rounds, progress)
    lines, good = table(found, facts, held, judged=not given.quick)
    print("\n".join(lines))
    if given.docs:
        write(given.docs, lines, rounds)
    return 0 if good else 1


def table(found, facts, held, judged):
    """Lines of the table, and whether all gates are met."""
    lines = [
        "| case | particles | domain, cells | full | ns per particle-step | of the tight box | bytes per particle "
        "| of the tight box |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    good = True
    for tight, loose, gated in PAIRS:
        for case in (CASES[tight], CASES[loose]):
            ratios = [a / b for a, b in zip(found[case], found[CASES[tight]], strict=True)]
            slow, large = statistics.median(ratios), held[case] / held[CASES[tight]]
            particles, domain = facts[case]
            met = not gated or (slow <= GATE and (large <= GATE or not judged))
            good &= met
            lines.append(
                f"| {case} | {particles} | {' x '.join(map(str, domain))} | {particles / 8 / math.prod(domain):.1%} "
                f"| {1e9 * statistics.median(found[case]):.1f} | {slow:.2f} "
                f"| {held[case]:.0f} | {large:.2f}{'' if met else ' **missed**'} |"
            )
    return lines, good


def write(docs, lines, rounds):
    text = f"""# What empty space costs

`python benchmarks/empty_space.py --rounds {rounds} --docs docs`. {" ".join(__doc__.split(chr(10) * 2)[2].split())}

{machine.text()}

{chr(10).join(lines)}
"""
    pages.write(docs, "empty_space", text)


if __name__ == "__main__":
    sys.exit(main())
