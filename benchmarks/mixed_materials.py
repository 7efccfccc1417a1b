"""Four laws on one grid for thousands of steps: the built-in scene mixed_materials on two ranks, its energies and pictures.

    python benchmarks/mixed_materials.py [--ranks 2] [--steps 5000] [--out runs] [--docs docs] [--no-run]

Runs `mpirun -n 2 python -m pmpm run mixed_materials --steps 5000` as a user would, reads what it left behind, prints the
energies, checks the gates below and exits non-zero where one fails. With --docs it writes results/mixed_materials.md and two
pictures there (needs matplotlib); --no-run takes the run that is in the folder.

Gates. All steps were made and no particle or mass was lost. Nothing gives energy to the box: walls are smooth and at rest,
gravity's work is in the potential energy. Kinetic + strain + potential energy may therefore only fall; heights count from
the floor, so that no part of it is negative. It may never exceed what it was at the start, nor any earlier value, by more
than 1 % of the energy at the start (elastic energy that a coarse step or a clamped stretch gives; see the laws). Each pair of
materials must have met: been in neighbouring cells, so that they shared nodes, in some snapshot.
"""

import argparse
import itertools
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pages

import pmpm

GAIN = 0.01  # of the energy at the start, by which it may grow
MASS_ROUND_OFF = 1e-12  # the same masses, summed in another order as particles change layers
COLOURS = {"water": "#3b82c4", "sand": "#d9a441", "jelly": "#c0395a", "snow": "#9fb4c7"}
FRACTIONS = (0.0, 0.28, 0.45, 1.0)  # of the end: pictures
ELEVATION, AZIMUTH = 30, -62  # degrees, of the camera
PARTS = ("kinetic", "strain", "potential")


def energies(run):
    """(times in s, {part: energies in J}, their sum) of the lines of diagnostics.csv."""
    told = run.diagnostics
    parts = {name: told[name] for name in PARTS}
    return told["time"], parts, sum(parts.values())


def largest_gain(total):
    """The most by which the energy has ever exceeded an earlier value, as a part of that at the start."""
    return float((total - np.minimum.accumulate(total)).max() / total[0])


def meetings(run):
    """{pair of materials: time in s of the first snapshot that has both in neighbouring cells, None if none has}."""
    names, size, shape = run.snapshots[0].attributes["materials"], run.scene.domain.cell_size, run.scene.cells
    first = dict.fromkeys(itertools.combinations(sorted(names), 2))
    for snapshot in run.snapshots:
        # Of half a cell beyond a wall: its cells are those at the wall.
        cells = np.clip(np.floor(snapshot.x / size).astype(np.int64), 0, np.array(shape) - 1)
        held = {name: occupied(cells[snapshot.material == n], shape) for n, name in enumerate(names)}
        for one, two in first:
            if first[one, two] is None and (held[one] & neighbours(held[two])).any():
                first[one, two] = snapshot.time
    return first


def occupied(cells, shape):
    """Of each cell of the box, whether it is among these."""
    flags = np.zeros(shape, bool)
    flags[tuple(cells.T)] = True
    return flags


def neighbours(flags):
    """Cells that are flagged or have a flagged one on any side, edge or corner."""
    for axis in range(flags.ndim):
        wide = np.pad(flags, [(int(axis == other),) * 2 for other in range(flags.ndim)])
        parts = [wide.take(range(shift, shift + flags.shape[axis]), axis) for shift in range(3)]
        flags = parts[0] | parts[1] | parts[2]
    return flags


def counts(snapshot):
    """{material: particles}."""
    numbers = np.bincount(snapshot.material, minlength=len(snapshot.attributes["materials"]))
    return dict(zip(snapshot.attributes["materials"], map(int, numbers), strict=True))


def complaints(run, steps):
    """What misses its gate, one line each."""
    told, (_, _, total) = run.diagnostics, energies(run)
    found = []
    if run.status not in ("finished", "stopped early") or run.record["report"]["steps"] < steps:
        found.append(f"the run is {run.status} after {told['step'][-1]} of {steps} steps")
    if not np.isfinite(total).all():
        found.append("an energy is not a number")
    if len(set(told["particles"])) > 1 or any(counts(s) != counts(run.snapshots[0]) for s in run.snapshots):
        found.append("particles were lost or changed their material")
    if np.abs(told["mass"] / told["mass"][0] - 1.0).max() > MASS_ROUND_OFF:
        found.append("mass changed")
    if total.max() > (1.0 + GAIN) * total[0]:
        found.append(f"the energy exceeds that at the start by {total.max() / total[0] - 1.0:.2%}")
    if largest_gain(total) > GAIN:
        found.append(f"the energy grew by {largest_gain(total):.2%} of that at the start")
    if min(values.min() for values in energies(run)[1].values()) < 0.0:
        found.append("a part of the energy is negative")
    found += [f"{' and '.join(pair)} never met" for pair, time in meetings(run).items() if time is None]
    return found


def table(run, rows=9):
    """Markdown table of the energies at some times."""
    times, parts, total = energies(run)
    lines = ["| t (s) | step | " + " | ".join(f"{name} (J)" for name in PARTS) + " | total (J) | dissipated (J) |"]
    lines.append("|" + " --- |" * (len(PARTS) + 4))
    for n in np.unique(np.linspace(0, len(times) - 1, rows).round().astype(int)):
        cells = [f"{times[n]:.3f}", str(run.diagnostics["step"][n]), *(f"{parts[name][n]:.3f}" for name in PARTS)]
        lines.append("| " + " | ".join([*cells, f"{total[n]:.3f}", f"{run.diagnostics['dissipated'][n]:.3f}"]) + " |")
    return "\n".join(lines)


def plot_energies(run, path):
    from matplotlib import pyplot

    times, parts, total = energies(run)
    figure, axes = pyplot.subplots(figsize=(6.4, 3.6), layout="constrained")
    axes.plot(times, total, color="black", label="total")
    for (name, values), style in zip(parts.items(), ("-", ":", "--"), strict=True):
        axes.plot(times, values, style, label=name)
    axes.axhline((1.0 + GAIN) * total[0], color="grey", lw=0.6, label="bound")
    axes.set(xlabel="t (s)", ylabel="energy (J)", xlim=(0.0, times[-1]), ylim=(0.0, None))
    axes.legend(frameon=False, ncols=2)
    axes.grid(alpha=0.3)
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def plot_particles(run, path):
    """The box at four times, coloured by material; seen from in front and above."""
    from matplotlib import pyplot
    from matplotlib.colors import to_rgb

    up, around = np.radians(ELEVATION), np.radians(AZIMUTH)
    towards_camera = (np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up))
    shots = list(run.snapshots)
    shots = [min(shots, key=lambda s: abs(s.time - part * shots[-1].time)) for part in FRACTIONS]
    names, size = shots[0].attributes["materials"], run.scene.domain.size
    figure = pyplot.figure(figsize=(10, 7.2), layout="constrained")
    for place, shot in enumerate(shots):
        axes = figure.add_subplot(2, 2, place + 1, projection="3d", computed_zorder=False)
        x, material = shot.x, shot.material
        order = np.argsort(x @ towards_camera)  # from far to near
        light = np.where(x[:, 1] < run.scene.domain.cell_size, 0.75, 1.0)  # the cut at the front wall is in the shade
        light *= 0.9 + 0.1 * (shot.id * 0.618 % 1.0)  # grain
        colours = np.array([to_rgb(COLOURS[name]) for name in names])[material] * light[:, None]
        axes.scatter(*x[order].T, c=colours[order], s=3.0, lw=0, depthshade=False)
        axes.set(xlim=(0, size[0]), ylim=(0, size[1]), zlim=(0, size[2]), title=f"t = {shot.time:.2f} s")
        axes.set_box_aspect(size, zoom=1.25)
        axes.view_init(elev=ELEVATION, azim=AZIMUTH)
        axes.set(xticks=(0, 0.4, 0.8), yticks=(0, 0.3), zticks=(0, 0.2, 0.4))
    handles = [pyplot.Line2D([], [], marker="o", ls="", color=COLOURS[name], label=name) for name in names]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(names), frameon=False)
    figure.savefig(path, dpi=100)
    quantize(path)
    pyplot.close(figure)


def quantize(path):
    """Keep 64 colours: the picture has few, and is a third as large."""
    from PIL import Image  # matplotlib brings it

    Image.open(path).convert("RGB").quantize(64).save(path, optimize=True)


def page(run, found, given):
    """The text of results/mixed_materials.md."""
    told, report = run.diagnostics, run.record["report"]
    _, parts, total = energies(run)
    met = ", ".join(f"{' and '.join(pair)} at {time:.2f} s" for pair, time in meetings(run).items() if time is not None)
    numbers = ", ".join(f"{count} {name}" for name, count in counts(run.snapshots[0]).items())
    phases = ", ".join(f"{name} {seconds['mean']:.1f}" for name, seconds in report["seconds_per_phase"].items())
    mass = np.abs(told["mass"] / told["mass"][0] - 1.0).max()
    return f"""# Four materials in one box

`python benchmarks/mixed_materials.py --docs docs` wrote this page: the built-in scene `mixed_materials`, {report["steps"]}
steps by `mpirun -n {given.ranks} python -m pmpm run mixed_materials --steps {given.steps}`. The gates stand in that file.

{report["particles"]} particles ({numbers}), {run.scene.method.precision}, up to t = {report["time"]:.3f} s with steps of
{told["dt"].min():.3g} to {told["dt"].max():.3g} s, {report["regroups"]} regroups. Seconds per phase, mean over ranks, on a
machine busy with other work (halo: also waiting for the other rank): {phases}.

![The box at four times](../pictures/mixed_materials.png)

- {"All gates hold." if not found else "Gates that fail: " + "; ".join(found)}
- Particles, and how many are of each material: the same in all lines and snapshots. Mass: the same within {mass:.1e}, the
  round-off of its sum.
- Energy: {total[0]:.3f} J at the start, {total[-1]:.3f} J at the end. It never exceeded an earlier value by more than
  {largest_gain(total):.1e} of that at the start; {GAIN:g} is allowed. Strain energy: at most {parts["strain"].max():.3f} J.
  Fastest particle: {told["max_speed"].max():.2f} m/s.
- In neighbouring cells for the first time, looked for every {run.scene.output.snapshot_interval:g} s: {met}.

{table(run)}

Dissipated is what the total has lost: friction in sand, crushing of snow, impacts of water and the transfer scheme itself.
Materials touch through the nodes they share, which have one velocity: where they touch they do not slip along each other.
The cells are coarse: the bank of sand is five of them high, and slumps less than on finer ones. Run by hand, the sand alone
in a box a quarter as deep moved its upper edge forward by 1.6 cm in 0.3 s, and by 4.3 cm with half the cell size.

![Energies over time](../pictures/mixed_materials_energies.png)
"""


def main():
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--ranks", type=int, default=2)
    options.add_argument("--steps", type=int, default=5000)
    options.add_argument("--out", type=Path, default=Path("runs"), help="folder of the run")
    options.add_argument("--docs", type=Path, help="write the page and its pictures here")
    options.add_argument("--no-run", action="store_true", help="take the run that is there")
    given = options.parse_args()
    out = given.out / "mixed_materials"
    if not given.no_run:
        beside = Path(sys.executable).parent / "mpirun"
        launcher = str(beside) if beside.is_file() else shutil.which("mpirun")
        command = [launcher, "-n", str(given.ranks), sys.executable, "-m", "pmpm", "run", "mixed_materials"]
        subprocess.run([*command, "--steps", str(given.steps), "--out", str(out), "--overwrite"], check=True)
    run = pmpm.load(out)
    print(table(run))
    found = complaints(run, given.steps)
    print("\n".join(f"FAILED: {line}" for line in found) or "all gates hold")
    if given.docs:
        import matplotlib

        matplotlib.use("Agg")
        plot_energies(run, given.docs / "pictures" / "mixed_materials_energies.png")
        plot_particles(run, given.docs / "pictures" / "mixed_materials.png")
        pages.write(given.docs, "mixed_materials", page(run, found, given))
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
