"""The page docs/scaling.md and its picture, out of benchmarks/scaling_model.py."""

from dataclasses import replace
from pathlib import Path

import machine
from scaling_machines import ALL, FRONTIER, FRONTIER_GPUS
from scaling_model import (
    NODE_COST,
    NODE_REALS,
    QUAD,
    Block,
    Split,
    best_bricks,
    checkpoint_seconds,
    efficiency,
    fits,
    largest_part,
    most_slabs,
    planes_of_cut,
    step_seconds,
    surface,
    unit_seconds,
    within_node,
)

from pmpm.kernels.needs import STENCILS

LAW = "W1"
SIZES = (1e6, 1e7, 1e8, 1e9)
CUBE, CHANNEL, SHEET = "cube", "channel, 10 : 1 : 1", "sheet, 20 : 1 : 20"
SHAPES = {CUBE: (1.0, 1.0, 1.0), CHANNEL: (10.0, 1.0, 1.0), SHEET: (20.0, 1.0, 20.0)}
NODE_BYTES = 4 * NODE_REALS  # float32
NODES = (1, 2, 4, 8, 16, 32, 64, 128, 256)
RANKS = (2, 10, 100, 1000, 10_000)
TEXT = Path(__file__).with_name("scaling_text.md")
PICTURE = "scaling_model.png"
DISK = 2e9  # bytes/s at which a node writes in the example of a checkpoint
GOOD = 0.8


def block_of(particles, shape=CUBE):
    """A Block of about so many particles, its sides in the ratios of a shape."""
    ratios = SHAPES[shape]
    unit = (particles / 8.0 / (ratios[0] * ratios[1] * ratios[2])) ** (1.0 / 3.0)
    return Block(tuple(max(1, round(unit * ratio)) for ratio in ratios))


def slabs(ranks, threads=1):
    return Split((ranks, 1, 1), threads)


def number(value):
    """Three digits: 21,300, and from 10^5 on with a power of ten."""
    if value < 1e5:
        return f"{float(f'{value:.3g}'):,.15g}"
    digits, exponent = f"{value:.2e}".split("e")
    return f"10^{int(exponent)}" if float(digits) == 1.0 else f"{float(digits):g} x 10^{int(exponent)}"


def listed(words):
    """a, b and c."""
    *most, last = map(str, words)
    return f"{', '.join(most)} and {last}"


def lines_of(head, rows):
    """Markdown."""
    return "\n".join("| " + " | ".join(map(str, row)) + " |" for row in (head, ["---"] * len(head), *rows))


# ---- tables ----------------------------------------------------------------------------------------------------------------


def link_text(link):
    return f"{1e6 * link.latency:.2f} us, {link.bandwidth / 1e9:.3g} GB/s"


def constants_table(constants):
    rows = [
        [f"particle-step, {name}", f"{1e9 * law.particle:.1f} ns on one core, sorting left out",
         f"regroup {1e9 * law.regroup:.0f} ns per particle; {law.held} bytes held, {law.moved} moved per step"]
        for name, law in constants.laws.items()
    ]  # fmt: skip
    rows += [
        ["node updated beside the neighbour", f"{NODE_COST:.2f} particle-steps", "what the balance of cuts counts"],
        ["regroup", f"every {constants.every:.0f} steps", "of these workloads; faster flow, more often"],
        ["fixed part of a step", f"{1e6 * constants.step:.0f} us", "Python, choice of the step, posting"],
        ["memory of one core", f"{constants.copy / 1e9:.1f} GB/s", "packing reads and writes each byte once"],
        ["message between ranks of a node", link_text(constants.local), "through mpi4py"],
    ]  # fmt: skip
    return lines_of(("", "", ""), rows)


def halo_table(constants):
    rows = []
    for name, stencil in STENCILS.items():
        reach = stencil.reach_low, stencil.reach_high
        summed, unsummed = planes_of_cut(reach)
        window = sum(reach) + 1
        sent = [(summed + unsummed) * NODE_REALS * size for size in (4, 8)]
        rows.append([name, window, summed, unsummed, *(f"{n} bytes x M x K" for n in sent)])
    head = ("spline", "planes of a layer, least width of a slab", "planes summed, one way", "unsummed, the other way")
    return lines_of((*head, "one cut, both ways: float32", "float64"), rows)


def machines_table(constants):
    law = constants.laws[LAW]
    rows = []
    for one in ALL:
        alone = unit_seconds(law, one, 1)
        full = unit_seconds(law, one, one.units)
        rows.append(
            [one.name, f"{one.units} {'GPU dies, **prediction**' if one.is_predicted else 'cores'}",
             f"{one.memory / 1e9:.0f} GB/s", f"{link_text(one.link)}, {one.links} per node",
             f"{1e9 * alone:.3g} ns", f"{1e9 * full:.3g} ns", f"{within_node(one, law):.0%}"]
        )  # fmt: skip
    head = (
        "machine",
        "per node",
        "memory of a node",
        "network",
        "particle-step, one unit alone",
        "all units of a node",
    )
    return lines_of((*head, "speed kept"), rows)


def limits_table(constants):
    rows = []
    for shape in SHAPES:
        for size in SIZES:
            block = block_of(size, shape)
            most = most_slabs(block)
            split = slabs(most)
            value = efficiency(block, split, FRONTIER, constants.laws[LAW], constants)
            rows.append(
                [shape, number(size), f"{block.cells[0]} x {block.cells[1]} x {block.cells[2]}", most,
                 number(block.particles / most), f"{surface(block, split).sent / 1e6:.3g}", f"{value:.0%}",
                 most * FRONTIER.units]
            )  # fmt: skip
    head = ("shape", "particles", "cells", "most ranks", "particles per rank there", "MB a rank sends per step")
    return lines_of((*head, "efficiency, one core per rank", f"cores with {FRONTIER.units} threads per rank"), rows)


def terms_table(constants):
    block, law = block_of(1e8), constants.laws[LAW]
    rows = []
    for ranks in sorted({1, 2, 4, 8, 16, 32, most_slabs(block)}):
        split = slabs(ranks, FRONTIER.units)
        terms = step_seconds(block, split, FRONTIER, law, constants)
        both = (efficiency(block, split, FRONTIER, law, constants, overlap=o) for o in (0.0, 1.0))
        rows.append(
            [ranks, *(f"{1e3 * seconds:.3g}" for seconds in terms.values()), *(f"{value:.0%}" for value in both)]
        )
    names = list(step_seconds(block, slabs(1, FRONTIER.units), FRONTIER, law, constants))
    return lines_of(("nodes", *(f"{name}, ms" for name in names), "efficiency", "messages hidden"), rows)


def strong_value(block, nodes, one, constants):
    """(efficiency, whether bricks were needed) of one rank per node, or per GPU; None where no cut is possible."""
    threads = 1 if one.is_predicted else one.units
    ranks = nodes * (one.units if one.is_predicted else 1)
    split = slabs(ranks, threads)
    needs_bricks = not fits(block, split)
    if needs_bricks:
        split = best_bricks(block, ranks, threads)
    return split and (efficiency(block, split, one, constants.laws[LAW], constants), needs_bricks)


def strong_table(constants):
    rows = []
    for one in ALL:
        for size in SIZES:
            found = [strong_value(block_of(size), nodes, one, constants) for nodes in NODES]
            rows.append(
                [
                    one.name,
                    number(size),
                    *("-" if v is None else f"*{v[0]:.0%}*" if v[1] else f"{v[0]:.0%}" for v in found),
                ]
            )
    return lines_of(("machine", "particles", *(f"{n} node{'s' * (n > 1)}" for n in NODES)), rows)


def weak_value(one, ranks, threads, constants, share=1.0):
    """Efficiency where each rank has a million particles per core, or a hundred million per GPU, times `share`."""
    piece = block_of(share * (1e8 if one.is_predicted else 1e6 * threads))
    block = replace(piece, cells=(piece.cells[0] * ranks, *piece.cells[1:]))
    return efficiency(block, slabs(ranks, threads), one, constants.laws[LAW], constants)


def weak_table(constants):
    rows = []
    for one in ALL:
        for threads in (1,) if one.is_predicted else (1, one.units):
            what = "one per GPU" if one.is_predicted else f"{threads} thread{'s' * (threads > 1)} each"
            values = (weak_value(one, ranks, threads, constants) for ranks in RANKS)
            rows.append([one.name, what, *(f"{value:.1%}" for value in values)])
    return lines_of(("machine", "ranks", *(f"{number(ranks)} ranks" for ranks in RANKS)), rows)


def bricks_table(constants):
    law, rows = constants.laws[LAW], []
    for size, nodes in ((1e7, 16), (1e8, 32), (1e9, 64), (1e9, 256), (1e9, 1024)):
        block = block_of(size)
        splits = [slabs(nodes, FRONTIER.units), *(best_bricks(block, nodes, FRONTIER.units, axes) for axes in (2, 3))]
        splits = [split if split and fits(block, split) else None for split in splits]
        sent = ("no room" if split is None else f"{surface(block, split).sent / 1e6:.3g} MB" for split in splits)
        values = ("-" if s is None else f"{efficiency(block, s, FRONTIER, law, constants):.0%}" for s in splits)
        rows.append([number(size), nodes, nodes * FRONTIER.units, *sum(zip(sent, values, strict=True), ())])
    head = ("particles of a cube", "nodes", "cores", "slabs: sent per rank and step", "efficiency")
    return lines_of((*head, "2-D bricks", "efficiency", "3-D bricks", "efficiency"), rows)


TABLES = (
    constants_table, halo_table, machines_table, limits_table, terms_table, strong_table, weak_table, bricks_table,
)  # fmt: skip


def tables(constants):
    """All tables, for the screen."""
    return "\n\n".join(make(constants) for make in TABLES)


# ---- the page --------------------------------------------------------------------------------------------------------------


def last_good(size, constants, one=FRONTIER):
    """Most nodes of NODES at which slabs of a cube keep GOOD efficiency."""
    found = [(nodes, strong_value(block_of(size), nodes, one, constants)) for nodes in NODES]
    return max(nodes for nodes, value in found if value and not value[1] and value[0] >= GOOD)


def facts(constants):
    """What the text says in numbers, by the names that stand in scaling_text.md."""
    law, (summed, unsummed) = constants.laws[LAW], planes_of_cut()
    planes, window = summed + unsummed, summed + 1
    cubes = {size: block_of(size) for size in SIZES}
    most = {size: most_slabs(cubes[size]) for size in SIZES}
    good = {size: last_good(size, constants) for size in SIZES}
    alone = (efficiency(cubes[size], slabs(most[size]), FRONTIER, law, constants) for size in SIZES)
    last = step_seconds(cubes[1e9], slabs(most[1e9], FRONTIER.units), FRONTIER, law, constants)
    per_particle = planes * NODE_BYTES / 8 / window
    checkpoint = checkpoint_seconds(1e8, constants, 16 * DISK)
    step = sum(step_seconds(cubes[1e8], slabs(16, FRONTIER.units), FRONTIER, law, constants).values())
    on_32 = slabs(32, FRONTIER.units), best_bricks(cubes[1e8], 32, FRONTIER.units, 2)
    before, after = (efficiency(cubes[1e8], split, FRONTIER, law, constants) for split in on_32)
    layers, largest = cubes[1e8].cells[0], largest_part(cubes[1e8], on_32[0])[0]
    side, across = cubes[1e6].cells[0] / window, FRONTIER.units ** (1.0 / 3.0)
    return {
        "machine": machine.text(), "source": constants.source, "law": LAW, "picture": PICTURE, "quad": QUAD,
        "window": window, "summed": summed, "planes": planes, "plain": 2 * summed, "units": FRONTIER.units,
        "sizes": listed(map(number, SIZES)), "most": listed(most.values()), "most_1e9": most[1e9],
        "alone": listed(f"{value:.0%}" for value in alone), "fills": number(8 * (window * FRONTIER.units) ** 3),
        "good_share": f"{GOOD:.0%}", "good": listed(f"{good[s]} nodes for {number(s)} particles" for s in SIZES[1:]),
        "good_1e8": good[1e8], "good_1e9": good[1e9], "share": f"{FRONTIER_GPUS.share:.0%}",
        "channel": f"{most_slabs(block_of(1e9, CHANNEL)) / most[1e9]:.1f}",
        "sheet": f"{most_slabs(block_of(1e9, SHEET)) / most[1e9]:.1f}",
        "particle_ns": f"{1e9 * law.particle:.0f}", "thread_ns": f"{1e9 * law.particle / FRONTIER.units:.2f}",
        "moved": law.moved, "demand": f"{law.moved / law.particle / 1e9:.1f}", "both_ways": planes * NODE_BYTES,
        "per_particle": f"{per_particle:.1f}", "wire_ns": f"{1e9 * per_particle / FRONTIER.link.bandwidth:.2f}",
        "dearer": f"{planes / (2 * summed):.2f}", "layers_1e8": layers, "largest": largest,
        "uneven": f"{largest * 32 / layers - 1.0:.0%}", "fixed_us": f"{1e6 * constants.step:.0f}",
        "fixed_particles": number(constants.step / law.particle), "layers_1e6": cubes[1e6].cells[0],
        "cube_cores": int(side**1.5) + 1, "cube_nodes": int((side * across) ** 1.5) + 1,
        "serial_ms": f"{1e3 * last['packing'] * FRONTIER.units:.0f}", "whole_ms": f"{1e3 * sum(last.values()):.0f}",
        "gain_1e8": f"{100 * (after - before):.0f}", "file_bytes": f"{constants.file_bytes:.0f}",
        "disk": f"{DISK / 1e9:.0f}", "checkpoint_s": f"{checkpoint:.2f}", "checkpoint_steps": f"{checkpoint / step:.0f}",
        "checkpoint_share": f"{checkpoint / step / 1000:.1%}",
        "sources": "\n".join(f"- {one.name}: {'; '.join(one.sources)}." for one in ALL),
    }  # fmt: skip


def text(constants):
    """The page."""
    made = {make.__name__: make(constants) for make in TABLES}
    return TEXT.read_text(encoding="utf-8").format(**facts(constants), **made)


def draw(constants, path):
    """Two panels: efficiency of a cube against cores, and weak scaling against ranks."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 3.8), dpi=150, layout="constrained")
    strong, weak = figure.subplots(1, 2)
    law, nodes = constants.laws[LAW], [2**n for n in range(11)]
    for number_, size in enumerate(SIZES):
        block, colour = block_of(size), f"C{number_}"
        known = [n for n in nodes if fits(block, slabs(n, FRONTIER.units))]
        known = sorted({*known, most_slabs(block)})
        values = [efficiency(block, slabs(n, FRONTIER.units), FRONTIER, law, constants) for n in known]
        strong.plot(
            [n * FRONTIER.units for n in known], values, "o-", ms=3, color=colour, label=f"{size:.0e} particles"
        )
        ranks = sorted({n for n in (1, 2, 5, 10, 20, 50) if n <= most_slabs(block)} | {most_slabs(block)})
        values = [efficiency(block, slabs(n), FRONTIER, law, constants) for n in ranks]
        strong.plot(ranks, values, ".:", ms=3, lw=1, color=colour)
        bricks = [(n, best_bricks(block, n, FRONTIER.units)) for n in nodes]
        bricks = [(n, split) for n, split in bricks if split and n >= known[-1] / 2]
        values = [efficiency(block, split, FRONTIER, law, constants) for _, split in bricks]
        strong.plot([n * FRONTIER.units for n, _ in bricks], values, "--", lw=0.8, color=colour)
    strong.set(xscale="log", xlabel="cores", ylabel="efficiency", ylim=(0, 1.05))
    strong.set_title("a cube on Frontier's CPUs", fontsize=9)
    strong.plot([], [], "k.:", ms=3, lw=1, label="slabs, a core each")
    strong.plot([], [], "ko-", ms=3, label=f"slabs, {FRONTIER.units} threads each")
    strong.plot([], [], "k--", lw=0.8, label="bricks (not built)")
    strong.legend(frameon=False, fontsize=7, loc="lower left")
    ranks = [2**n for n in range(1, 14)] + [10_000]
    for one, style in zip(ALL, ("-", "--", "-.", ":"), strict=True):
        threads = 1 if one.is_predicted else one.units
        for share, colour in ((1.0, "tab:blue"), (0.01, "tab:orange")):
            label = one.name + (", prediction" if one.is_predicted else "") if share == 1.0 else None
            values = [weak_value(one, n, threads, constants, share) for n in ranks]
            weak.plot(ranks, values, style, color=colour, label=label)
    weak.plot([], [], color="tab:orange", label="a hundredth of the particles")
    weak.set(xscale="log", xlabel="ranks (nodes, or GPUs)", ylim=(0, 1.05))
    weak.set_title("longer along the slab axis: $10^6$ particles per core, $10^8$ per GPU", fontsize=9)
    weak.legend(frameon=False, fontsize=7, loc="lower left")
    for axes in (strong, weak):
        axes.grid(alpha=0.3)
    figure.savefig(path, format="png")


def write(constants, docs):
    """Write scaling.md and its picture under `docs`."""
    draw(constants, docs / "pictures" / PICTURE)
    (docs / "scaling.md").write_text(text(constants), encoding="utf-8")
