"""What the volume correction of sand is for: a bed that is dilated again and again, and a crater that falls in.

    python benchmarks/sand_volume.py [--quick] [--docs docs]

Three 2-D scenes, each with and without `volume_correction` of drucker_prager, in this process. Prints a line per cycle and the
tables, checks the gates below and exits non-zero where one fails. With --docs it writes results/sand_volume.md and two
pictures there (needs matplotlib). --quick: cells of twice the size and 3 cycles, without gates on the crater.

tossed   a bed between slip walls gets the velocity V y / h(t) upwards, flies apart evenly, falls, rests; h: its top
heaved   a plunger in the floor rises and returns in 0.1 s (a region with a velocity), the bed rests for 0.5 s
crater   a charge in the middle of a bed throws up what is above it

Volume correction: A. P. Tampubolon et al., ACM Trans. Graph. 36 (2017) 105, section 4.3.4.

What is expected of `tossed`. While it flies, the bed is stretched evenly and free of stress, so that a grain at y has a
trajectory of its own. Without correction the strain starts from zero at every moment of flight: any compression is answered
at once, and a grain stops for good where it turns, v^2 / 2g higher. The top gains V^2 / 2g per cycle, the mean V^2 / 6g (soft
sand loses a part of it to the compression of its landing). With correction nothing resists before the old volume is back.
Gates: with correction mean height and area change by at most 3 % in all cycles of `tossed`; without it the mean gains 0.6 to
1.1 of the above per cycle. The crater: vertical force of every section within 1 % of the weight above in both; with
correction area within 3 %, without at least 3 times that.
"""

import argparse
import math
import sys
from pathlib import Path

import numpy as np
import pages

import pmpm

GRAVITY, DENSITY = 9.81, 2000.0
SAND = {
    "model": "drucker_prager",
    "density": DENSITY,
    "youngs_modulus": 8e5,
    "poisson_ratio": 0.3,
    "friction_angle": 30.0,
}
CYCLE, CYCLES = 0.6, 6  # s
WIDTH, HEIGHT = 0.2, 0.1  # of the bed that is tossed and heaved, m
TOSS, HEAVE = 0.5, 0.6  # m/s
BED = (0.3, 0.12)  # of the crater, m
CHARGE, DEPTH, REACH, REST = 2.5, 0.06, 0.03, 2.5  # m/s, m above the floor, m, s
DAMPING = 2.0  # 1/s, of the crater: a bed of sand rings for long in its elastic range
KEPT, GAINS, BALANCE = 0.03, (0.6, 1.1), 0.01
NAMES = {True: "with correction", False: "without"}


def bed(corrected, cell_size, size, end, headroom=2.0, method=None, **more):
    """Scene of a bed of sand under the stress of its weight, between slip walls."""
    walls = {"x_min": "slip", "x_max": "slip", "y_min": "separate", "y_max": "separate"}
    return pmpm.Scene(
        domain={
            "size": [size[0], round((1.0 + headroom) * size[1] / cell_size) * cell_size],
            "cell_size": cell_size,
            "gravity": [0.0, -GRAVITY],
            "walls": walls,
        },
        method=method or {},
        time={"end": end},
        materials={"sand": SAND | {"volume_correction": corrected}},
        bodies=[
            {
                "material": "sand",
                "shape": {"type": "box", "min": [0.0, 0.0], "max": list(size)},
                "stress": {"type": "geostatic"},
            }
        ],
        **more,
    )


# ---- measures ------------------------------------------------------------------------------------------------------------


def profile(simulation):
    """Height (m) of the highest grain in each column of cells."""
    x, cell_size = simulation.particles.x, simulation.scene.domain.cell_size
    top = np.zeros(round(simulation.scene.domain.size[0] / cell_size))
    np.maximum.at(top, np.minimum((x[:, 0] / cell_size).astype(int), len(top) - 1), x[:, 1])
    return np.where(top > 0.0, top + 0.25 * cell_size, 0.0)  # grains are half a cell wide


def occupied(simulation):
    """(twice the mean height of grains, mean height of the surface, largest speed) in m and m/s."""
    particles = simulation.particles
    return 2.0 * particles.x[:, 1].mean(), profile(simulation).mean(), np.abs(particles.v).max()


def sections(simulation, size, count=8):
    """(height, vertical force / weight above) of horizontal sections halfway between rows of nodes.

    Nodes above such a section rest where sum V0 tau_yy hat((y - Y) / dx) / dx over the grains is their weight: rows of
    quadratic splines above it add up to the integral of a hat, and that is the share that their nodes have of a grain.
    """
    particles, cell_size = simulation.particles, simulation.scene.domain.cell_size
    V_tau, weight = particles.stress[:, 1] * particles.volume, GRAVITY * particles.mass
    found = []
    for row in np.unique(np.linspace(1, 0.8 * size[1] / cell_size, count).astype(int)):
        height = (row + 0.5) * cell_size
        s = np.clip((particles.x[:, 1] - height) / cell_size, -1.0, 1.0)
        force = -(V_tau * (1.0 - np.abs(s))).sum() / cell_size
        above = (weight * (0.5 + s - 0.5 * s * np.abs(s))).sum()
        found.append((height, force / above))
    return np.array(found)


def claims(simulation):
    """(mean volume ratio J, share of the opening v_c that a twentieth of the grains keep) with correction, else nan."""
    if not simulation.scene.materials["sand"].parameters["volume_correction"]:
        return math.nan, math.nan
    v_c = np.sort(np.expm1(simulation.particles.v_c))
    return simulation.particles.J.mean(), v_c[-(len(v_c) // 20) :].sum() / max(v_c.sum(), 1e-300)


def pressure(simulation):
    """Of grains, Pa: minus the mean of the normal stresses."""
    return -simulation.particles.stress[:, :3].mean(axis=1)


def unloaded(simulation):
    """Share of grains with less than a tenth of the weight above as vertical stress, of those 4 cells below the surface."""
    particles, cell_size = simulation.particles, simulation.scene.domain.cell_size
    top = profile(simulation)
    columns = np.minimum((particles.x[:, 0] / cell_size).astype(int), len(top) - 1)
    deep = top[columns] - particles.x[:, 1] > 4.0 * cell_size
    # The weight of what lies above in the column, not of its height: loose sand weighs less.
    weight = np.zeros(len(deep))
    for column in np.unique(columns):
        (rows,) = np.nonzero(columns == column)
        order = rows[np.argsort(-particles.x[rows, 1])]
        weight[order] = np.cumsum(particles.mass[order]) * GRAVITY / cell_size
    return np.count_nonzero(-particles.stress[deep, 1] < 0.1 * weight[deep]) / np.count_nonzero(deep)


# ---- scenes --------------------------------------------------------------------------------------------------------------


def toss(simulation, speed=TOSS):
    """Give the sand the velocity speed * y / top upwards."""
    x = simulation.particles.x
    v = simulation.particles.v
    v[:, 1] += speed * x[:, 1] / x[:, 1].max()
    simulation.particles.v = v


def tossed(corrected, cell_size, cycles, tell=print, size=(WIDTH, HEIGHT)):
    """Rows (mean, surface, speed) of `occupied` at the start and after each cycle, relative to the bed's height."""
    simulation = pmpm.Simulation(bed(corrected, cell_size, size, CYCLE * cycles))
    found = [occupied(simulation)]
    for cycle in range(1, cycles + 1):
        toss(simulation)
        simulation.run(until=CYCLE * cycle)
        found.append(occupied(simulation))
        tell(line("tossed", corrected, cycle, found, size[1]))
    if corrected:
        tell("tossed, mean J {:.4f}, {:.0%} of the opening in 5 % of the grains".format(*claims(simulation)))
    return np.array(found) / [size[1], size[1], 1.0]


def lift(time):
    """Velocity of the plunger: up and down again in the first 0.1 s of each cycle."""
    within = time % CYCLE
    return (0.0, HEAVE * math.sin(20.0 * math.pi * within) if within < 0.1 else 0.0)


def heaved(corrected, cell_size, cycles, tell=print):
    plunger = {"shape": {"type": "box", "min": [0.06, -0.02], "max": [0.14, 0.02]}, "velocity": lift}
    simulation = pmpm.Simulation(bed(corrected, cell_size, (WIDTH, HEIGHT), CYCLE * cycles, motions=[plunger]))
    found = [occupied(simulation)]
    for cycle in range(1, cycles + 1):
        simulation.run(until=CYCLE * cycle)
        found.append(occupied(simulation))
        tell(line("heaved", corrected, cycle, found, HEIGHT))
    if corrected:
        tell("heaved, mean J {:.4f}, {:.0%} of the opening in 5 % of the grains".format(*claims(simulation)))
    return np.array(found) / [HEIGHT, HEIGHT, 1.0]


def line(scene, corrected, cycle, found, height):
    mean, surface, speed = found[-1]
    return (
        f"{scene}, {NAMES[corrected]:15} cycle {cycle}: mean height {mean / found[0][0] - 1.0:+8.2%}, "
        f"surface {surface / found[0][1] - 1.0:+8.2%}, largest speed {speed:.1e} m/s"
    )


def crater(corrected, cell_size, tell=print):
    """dict of what a crater leaves: shots (x, pressure) in flight and at rest, sections, gains."""
    simulation = pmpm.Simulation(bed(corrected, cell_size, BED, REST, method={"damping": DAMPING}))
    _, first, _ = occupied(simulation)
    from_charge = simulation.particles.x - [0.5 * BED[0], DEPTH]
    fall = np.exp(0.5 - 0.5 * (from_charge**2).sum(axis=1) / REACH**2) * (from_charge[:, 1] > 0.0)
    simulation.particles.v = CHARGE * fall[:, None] * [0.5, 1.0] * from_charge / REACH
    shots = []
    for time in (0.1, 0.2, REST):
        simulation.run(until=time)
        shots.append((simulation.time, simulation.particles.x, pressure(simulation)))
    mean, surface, speed = occupied(simulation)
    found = {
        "shots": shots,
        "sections": sections(simulation, BED),
        "surface": surface / first - 1.0,
        "unloaded": unloaded(simulation),
        "speed": speed,
        "claims": claims(simulation),
    }
    lowest, highest = found["sections"][:, 1].min(), found["sections"][:, 1].max()
    tell(
        f"crater, {NAMES[corrected]:15} at rest: surface {found['surface']:+.2%}, vertical force {lowest:.3f} to {highest:.3f} "
        f"of the weight above, unloaded {found['unloaded']:.1%}, J {found['claims'][0]:.4f}, "
        f"{found['claims'][1]:.0%} of the opening in 5 % of the grains, largest speed {speed:.1e} m/s"
    )
    return found


# ---- verdict and page ----------------------------------------------------------------------------------------------------


def complaints(toss, holes=None):
    """What misses its gate, one line each; toss: corrected -> rows of `tossed`, holes: corrected -> `crater`."""
    found = []
    kept = np.abs(toss[True][:, :2] / toss[True][0, :2] - 1.0).max()
    if kept > KEPT:
        found.append(f"tossed with correction: mean height or surface changes by {kept:.1%}")
    per_cycle = (toss[False][-1, 0] - toss[False][0, 0]) / (len(toss[False]) - 1)
    share = per_cycle / (TOSS**2 / (3.0 * GRAVITY * HEIGHT))
    if not GAINS[0] <= share <= GAINS[1]:
        found.append(f"tossed without correction: gains {share:.2f} of V^2 / 6g per cycle")
    if holes:
        for corrected, hole in holes.items():
            off = np.abs(hole["sections"][:, 1] - 1.0).max()
            if off > BALANCE:
                found.append(
                    f"crater {NAMES[corrected]}: a section carries {off:.1%} more or less than the weight above"
                )
        if abs(holes[True]["surface"]) > KEPT:
            found.append(f"crater with correction: the surface changes by {holes[True]['surface']:+.1%}")
        if holes[False]["surface"] < 3.0 * KEPT:
            found.append(f"crater without correction: the surface changes by {holes[False]['surface']:+.1%} only")
    return found


def cycle_table(runs):
    """Markdown table; runs: name -> corrected -> rows."""
    columns = [(name, corrected) for name in runs for corrected in (True, False)]
    lines = ["| cycle | " + " | ".join(f"{name}, {NAMES[c]}: mean, surface" for name, c in columns) + " |"]
    lines.append("|" + " --- |" * (1 + len(columns)))
    for cycle in range(1, len(runs["tossed"][True])):
        cells = [str(cycle)]
        for name, corrected in columns:
            mean, surface = runs[name][corrected][cycle, :2] / runs[name][corrected][0, :2] - 1.0
            cells.append(f"{mean:+.1%}, {surface:+.1%}")
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def crater_table(holes):
    lines = ["| crater, at rest | with correction | without |", "| --- | --- | --- |"]
    rows = {
        "volume under the surface": lambda hole: f"{hole['surface']:+.1%}",
        "vertical force of sections / weight above": lambda hole: "{:.3f} to {:.3f}".format(
            hole["sections"][:, 1].min(), hole["sections"][:, 1].max()
        ),
        "unloaded, of the grains 4 cells below the surface": lambda hole: f"{hole['unloaded']:.1%}",
        "mean J that the grains remember": lambda hole: f"{hole['claims'][0]:.3f}",
        "share of the opening in 5 % of the grains": lambda hole: f"{hole['claims'][1]:.0%}",
        "largest speed, m/s": lambda hole: f"{hole['speed']:.1e}",
    }
    lines += [f"| {name} | {value(holes[True])} | {value(holes[False])} |" for name, value in rows.items()]
    lines = [text.replace("nan%", "not kept").replace("nan", "not kept") for text in lines]
    return "\n".join(lines)


def start_plots():
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    return pyplot


def plot_cycles(runs, path):
    figure, row = start_plots().subplots(1, len(runs), figsize=(8.4, 3.4), layout="constrained", sharey=True)
    for axes, (name, pair) in zip(row, runs.items(), strict=True):
        for corrected, colour in ((True, "tab:blue"), (False, "tab:red")):
            found = pair[corrected]
            axes.plot(
                found[:, 0] / found[0, 0] - 1.0, "o-", color=colour, ms=4, label=f"{NAMES[corrected]}: mean height"
            )
            axes.plot(found[:, 1] / found[0, 1] - 1.0, "s--", color=colour, ms=4, mfc="none", label="surface")
        if name == "tossed":
            cycles = np.arange(len(pair[False]))
            axes.plot(TOSS**2 / (3.0 * GRAVITY * HEIGHT) * cycles, "k:", label=r"mean + $V^2/6g$ per cycle")
        axes.set(title=name, xlabel="cycle")
        axes.grid(alpha=0.3)
    row[0].set_ylabel("gain of volume at rest")
    row[0].legend(frameon=False, fontsize=8)
    figure.savefig(path, dpi=110)


def plot_crater(holes, path):
    times = [time for time, _, _ in holes[True]["shots"]]
    figure, rows = start_plots().subplots(
        2, len(times), figsize=(9.6, 3.9), layout="constrained", sharex=True, sharey=True
    )
    for corrected, row in zip((True, False), rows, strict=True):
        for axes, (time, x, p) in zip(row, holes[corrected]["shots"], strict=True):
            look = {"s": 1.5, "lw": 0, "antialiased": False, "vmin": 0.0, "vmax": DENSITY * GRAVITY * BED[1]}
            drawn = axes.scatter(*(1000.0 * x.T), c=p, cmap="viridis", **look)
            axes.axhline(1000.0 * BED[1], color="grey", lw=0.6)
            axes.set(
                title=f"{NAMES[corrected]}, t = {time:.1f} s", aspect="equal", xlim=(0, 1000.0 * BED[0]), ylim=(0, 240)
            )
            axes.title.set_fontsize(9)
    figure.colorbar(drawn, ax=rows, label="pressure (Pa)", fraction=0.02, pad=0.01)
    figure.savefig(path, dpi=80)
    from PIL import Image

    # Thousands of dots: with colours of a palette they take a third.
    Image.open(path).convert("RGB").quantize(48, dither=Image.Dither.NONE).save(path, optimize=True)


def write_page(docs, runs, holes, verdict):
    plot_cycles(runs, docs / "pictures" / "sand_volume_cycles.png")
    plot_crater(holes, docs / "pictures" / "sand_volume_crater.png")
    gain, stroke = TOSS**2 / (3.0 * GRAVITY * HEIGHT), 1000.0 * HEAVE * 0.1 / math.pi
    text = f"""# The volume of sand that is dilated and falls again

`python benchmarks/sand_volume.py --docs docs` wrote this page: beds of `drucker_prager` sand with and without
`volume_correction` (Tampubolon et al. 2017, section 4.3.4). Scenes, gates and their reasons stand in that file. Each bed rests
at the end of a cycle; `mean` is the change of the mean height of the grains, `surface` that of the area under the surface.

{cycle_table(runs)}

![gain of volume against cycles](../pictures/sand_volume_cycles.png)

tossed: the bed gets the velocity V y / h upwards, V = {TOSS:g} m/s. Without correction a grain stays where it turns,
V^2 y^2 / (2 g h^2) above its place, because sand that has flown apart resists as soon as it closes: {gain:.1%} of the mean
height per cycle. heaved: a plunger in the floor, 80 mm wide, rises by {stroke:.0f} mm and returns; the surface is no longer
flat, and the mean height tells of its shape too.

{crater_table(holes)}

![pressure around the crater](../pictures/sand_volume_crater.png)

The grey line is the surface before. Without correction what was thrown up stays there, as a roof over a hole. With it, sand
falls until it has its volume again. Each section carries the weight above either way: all that rests does; what the
correction decides is where it comes to rest.

What falls short. J follows the velocity gradient of the grid. A grain that flies alone keeps its own, sees no neighbour, and
its J grows on as exp(t div v), where sand that flies apart grows as (1 + t div v / 2)^2: after 0.1 s with div v = 20 / s
one grain in free flight has J = 7.4, not 4. With div v = -20 / s it bounces first, and ends at 6.8. It lands with an opening
that its neighbours do not have. Until it is compressed by as much it carries nothing, and they carry its share: the
unloaded grains in the table, and the streaks of high and low pressure in the picture. So volume is kept on average, but
stress where sand has landed is uneven, and a little volume is gained in each cycle. Averages of v_c over neighbours are not
built.

{verdict}
"""
    pages.write(docs, "sand_volume", text)


def main():
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--quick", action="store_true", help="coarse, 3 cycles")
    options.add_argument("--docs", type=Path, help="write the page and its pictures here")
    given = options.parse_args()

    def tell(text):
        print(text, flush=True)

    cell_size, cycles = (0.01, 3) if given.quick else (0.005, CYCLES)
    runs = {
        scene.__name__: {corrected: scene(corrected, cell_size, cycles, tell) for corrected in (True, False)}
        for scene in (tossed, heaved)
    }
    holes = {corrected: crater(corrected, cell_size, tell) for corrected in (True, False)}
    print(cycle_table(runs), "\n\n", crater_table(holes), sep="")
    found = complaints(runs["tossed"], None if given.quick else holes)
    print("\n".join(f"FAILED: {line}" for line in found) or "all gates hold")
    if given.docs:
        verdict = "All gates hold." if not found else "Gates that fail: " + "; ".join(found)
        write_page(given.docs, runs, holes, verdict)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
