"""The pictures of the README, from runs of built-in scenes (needs matplotlib).

python benchmarks/pictures.py [--out runs] [--docs docs]
"""

import argparse
import subprocess
import sys
from pathlib import Path

import matplotlib
import numpy as np

import pmpm

matplotlib.use("Agg")
from matplotlib import pyplot  # noqa: E402

SCENES = {
    "dam_break": ("domain.cell_size=0.000714375", (0.0, 0.04, 0.09, 0.13), "speed", "speed (m/s)", "viridis"),
    "column_collapse": ("time.end=0.6", (0.0, 0.15, 0.3, 0.6), "speed", "speed (m/s)", "cividis"),
}


def run(name, setting, out):
    """The run of a built-in scene in the folder `out`, made if it is not there yet."""
    command = [sys.executable, "-m", "pmpm", "run", name, "--out", str(out), "--set", setting, "--set"]
    if not (out / "run.json").exists():
        subprocess.run([*command, 'output.fields=["velocity", "pressure", "speed", "material"]'], check=True)
    return pmpm.load(out)


def panels(figure, name, loaded, times, field, label, colours):
    """One row of pictures of a run at the snapshots nearest to `times`, coloured by a field."""
    shots = [min(loaded.snapshots, key=lambda s: abs(s.time - t)) for t in times]
    top = max(float(np.quantile(getattr(s, field), 0.99)) for s in shots)
    row = figure.subplots(1, len(shots), sharex=True, sharey=True)
    width, height = loaded.scene.domain.size
    for axes, shot in zip(row, shots, strict=True):
        drawn = axes.scatter(*(1000 * shot.x.T), c=getattr(shot, field), s=0.4, vmin=0, vmax=top, cmap=colours, lw=0)
        axes.set(title=f"t = {shot.time:.2f} s", aspect="equal", xlim=(0, 1000 * width), ylim=(0, 1000 * height))
        axes.set_xlabel("mm")
    figure.colorbar(drawn, ax=row, label=label, fraction=0.02, pad=0.01)
    figure.suptitle(f"{name}: {loaded.snapshots[0].x.shape[0]} particles", x=0.01, ha="left", fontsize=10)


def main():
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--out", type=Path, default=Path("runs"), help="folder of the runs")
    options.add_argument("--docs", type=Path, default=Path("docs"), help="folder that holds pictures/")
    given = options.parse_args()
    figure = pyplot.figure(figsize=(12, 4.2), layout="constrained")
    for part, (name, (setting, times, *look)) in zip(figure.subfigures(2, 1), SCENES.items(), strict=True):
        panels(part, name, run(name, setting, given.out / f"picture_{name}"), times, *look)
    figure.savefig(given.docs / "pictures" / "built_in_scenes.png", dpi=130)


if __name__ == "__main__":
    main()
