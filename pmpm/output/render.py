"""Pictures and films of a run for `pmpm render`: its particles, coloured by a field, drawn by matplotlib without a screen.

For cuts, contours and a camera of one's own there is ParaView: every run leaves a snapshots.xdmf for it.
"""

import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pmpm.output.datasets import UNITS
from pmpm.output.files import OutputError, unfinished_name
from pmpm.output.pictures import figure_class, plain, save
from pmpm.output.progress import LINE_INTERVAL
from pmpm.output.reader import load, reading
from pmpm.output.run_directory import SCENE

STILLS, FILMS = (".png", ".pdf", ".svg"), (".gif", ".mp4")
MOST = 200_000  # particles of a picture: of more every n-th is drawn
WIDTH, LEAST, DPI = 8.0, 3.0, 130  # inches, and dots per inch
FRAMES_PER_SECOND = 15
COLOURS = 10  # of materials: then they begin anew
PREFERRED = "speed", "velocity", "pressure", "material"
CAMERA = {"elev": 18.0, "azim": -62.0}


@dataclass(frozen=True)
class View:
    """What all frames share: sizes (m), names and order of the axes (the last one upright), distance of particles (m), field,
    its label, its range, names of materials if it is their number."""

    title: str
    size: np.ndarray
    order: tuple[int, ...]
    spacing: float
    field: str
    label: str
    limits: tuple[float, float]
    materials: tuple[str, ...]


def render(path, field=None, number=-1, file=None, quiet=False):
    """Draw a snapshot (its number, negative ones from the last) of the run in the folder `path` into a picture, or all of them
    into a film, if the file's name ends as one of FILMS. Default: render.png in the folder. Returns a line of text.

    Raises OutputError for what cannot be read or written, SceneError where matplotlib is missing.
    """
    run = load(path)
    file = Path(file) if file is not None else Path(path) / "render.png"
    kind = file.suffix.lower()
    if kind not in STILLS + FILMS:
        raise OutputError(f"--out {file}: the name must end with one of {', '.join(STILLS + FILMS)}")
    snapshots = run.snapshots
    if not -len(snapshots) <= number < len(snapshots):
        there = f"they are 0 to {len(snapshots) - 1}" if len(snapshots) else "there is none yet"
        raise OutputError(f"{path}: no snapshot {number}: {there}")
    Figure = figure_class("pmpm render")  # noqa: N806
    chosen = list(snapshots) if kind in FILMS else [snapshots[number]]
    try:
        view = view_of(run.table, chosen, field)
    except (KeyError, TypeError, ValueError, ArithmeticError) as error:
        raise OutputError(f"{Path(path) / SCENE} is damaged: {' '.join(str(error).split())}") from error
    try:
        if kind in FILMS:
            film(Figure, view, chosen, file, quiet)
        else:
            figure = Figure(figsize=figure_size(view), dpi=DPI, layout="constrained")
            draw(figure, view, chosen[0])
            save(figure, file)
    except OSError as error:
        raise OutputError(f"--out {file}: {error.strerror or error}") from None
    frames = f"{len(chosen)} frames" if kind in FILMS else f"t = {chosen[0].time:.6g} s"
    return f"{file}: {view.label}, {frames}"


def view_of(scene, snapshots, field):
    """The View of some snapshots of a scene (see reader.Run.table), coloured by a field of theirs."""
    domain = scene["domain"]
    dim, gravity = len(domain["size"]), domain["gravity"]
    up = int(np.argmax(np.abs(gravity))) if any(gravity) else dim - 1
    order = (*(axis for axis in range(dim) if axis != up), up)
    field = field or next((name for name in PREFERRED if name in snapshots[0].fields), "id")
    low, high = range_of(snapshots, field)
    sources = [*scene.get("bodies", ()), *scene.get("inflows", ())]
    spacing = domain["cell_size"] / min(source["particles_per_cell"] for source in sources) ** (1.0 / dim)
    unit = UNITS.get(field, "-")
    name = "speed" if field == "velocity" else field.replace("_", " ")
    return View(
        scene.get("title", ""), np.array(domain["size"]), order if dim == 3 else (0, 1), spacing, field,
        f"{name} ({unit})" if unit != "-" else name, (low, high),
        tuple(scene["materials"]) if field == "material" else (),
    )  # fmt: skip


def range_of(snapshots, field):
    """(lowest, highest) finite value of a field in any of the snapshots; not the same, so that colours can be told."""
    low, high = np.inf, -np.inf
    for snapshot in snapshots:
        values = scalars(snapshot, field)
        values = values[np.isfinite(values)]
        if len(values):
            low, high = min(low, float(values.min())), max(high, float(values.max()))
    if not low <= high:
        return 0.0, 1.0
    return low, high if high > low else low + (abs(low) or 1.0)


def scalars(snapshot, field):
    """(n,) numbers of a field; of a vector its length. OutputError for a field that the snapshot has not, or of tensors."""
    with reading(snapshot.path) as file:
        held = file["VTKHDF/PointData"]
        if field not in held:
            raise OutputError(f"{snapshot.path} holds no field {field}; it holds {', '.join(sorted(held))}")
        values = held[field][...]
    if values.ndim == 2 and values.shape[1] > 3:
        raise OutputError(f"--field {field}: a tensor has no colour; von_mises_stress and pressure are numbers")
    return np.sqrt((values * values).sum(axis=1)) if values.ndim == 2 else values


def figure_size(view):
    """Inches."""
    if len(view.size) == 3:
        return WIDTH, 0.72 * WIDTH
    return WIDTH, max(LEAST, 0.86 * WIDTH * view.size[1] / view.size[0] + 0.9)


def draw(figure, view, snapshot):
    """Draw a snapshot into an empty figure."""
    x, values = snapshot.x, scalars(snapshot, view.field)
    every = -(-len(x) // MOST) or 1
    x, values = x[::every], values[::every]
    two = len(view.size) == 2
    axes = figure.add_subplot(projection=None if two else "3d")
    style: dict[str, Any] = {"linewidths": 0, "rasterized": True}
    if view.materials:
        style |= {"cmap": "tab10", "vmin": -0.5, "vmax": COLOURS - 0.5}
        values = values % COLOURS
    else:
        style |= {"cmap": "viridis", "vmin": view.limits[0], "vmax": view.limits[1]}
    columns = [x[:, axis] for axis in view.order]
    if two:
        axes.set_xlim(0.0, view.size[0])
        axes.set_ylim(0.0, view.size[1])
        axes.set_aspect("equal")
        plain(axes)
        style["marker"] = "s"
    else:
        axes.set_box_aspect([view.size[axis] for axis in view.order])
        for limit, axis in zip((axes.set_xlim, axes.set_ylim, axes.set_zlim), view.order, strict=True):
            limit(0.0, view.size[axis])
        axes.view_init(**CAMERA)
        axes.set_zlabel(f"{'xyz'[view.order[2]]} (m)", fontsize=8)
        style["depthshade"] = False
    axes.set_xlabel(f"{'xyz'[view.order[0]]} (m)", fontsize=8)
    axes.set_ylabel(f"{'xyz'[view.order[1]]} (m)", fontsize=8)
    axes.tick_params(labelsize=7)
    points = axes.scatter(*columns, c=values, s=marker_area(view, every), **style)
    if view.materials:
        for place, name in enumerate(view.materials):
            axes.scatter(*[[] for _ in view.order], color=points.cmap(points.norm(place % COLOURS)), label=name, s=20)
        axes.legend(fontsize=8, frameon=False, loc="upper right")
    else:
        colours = figure.colorbar(points, ax=axes, shrink=0.8, pad=0.02 if two else 0.1)
        colours.set_label(view.label, fontsize=8)
        colours.ax.tick_params(labelsize=7)
    axes.set_title(f"{view.title}    t = {snapshot.time:.4g} s".strip(), fontsize=10)


def marker_area(view, every):
    """Square points of a marker as wide as a particle is."""
    inches = 0.8 * WIDTH / view.size[view.order[0]] if len(view.size) == 2 else 0.45 * WIDTH / view.size.max()
    width = 72.0 * inches * view.spacing * every ** (1.0 / len(view.size))
    return max((1.25 * width) ** 2, 0.1)


def film(Figure, view, snapshots, file, quiet):  # noqa: N803
    """Draw snapshots one after another. OutputError where MP4 is asked for and nobody can make it."""
    from matplotlib import animation

    kind = file.suffix.lower()
    if kind == ".mp4" and not animation.FFMpegWriter.isAvailable():
        raise OutputError(f"--out {file}: MP4 needs the program ffmpeg (Debian: apt install ffmpeg); GIF needs nothing")
    writer = (animation.FFMpegWriter if kind == ".mp4" else animation.PillowWriter)(fps=FRAMES_PER_SECOND)
    figure = Figure(figsize=figure_size(view), dpi=DPI, layout="constrained")
    unfinished = unfinished_name(file).with_suffix(kind)
    try:
        with writer.saving(figure, unfinished, DPI):
            for snapshot in told(snapshots, quiet):
                figure.clear()
                draw(figure, view, snapshot)
                writer.grab_frame()
        unfinished.replace(file)
    finally:
        unfinished.unlink(missing_ok=True)


def told(snapshots, quiet):
    """The snapshots, one after another, with a bar on a terminal and some lines elsewhere."""
    if quiet or sys.stderr is None:
        yield from snapshots
    elif sys.stderr.isatty():
        from tqdm import tqdm

        yield from tqdm(snapshots, desc="frames", file=sys.stderr)
    else:
        due = time.perf_counter() + LINE_INTERVAL
        for number, snapshot in enumerate(snapshots, 1):
            if time.perf_counter() >= due:
                print(f"frame {number} of {len(snapshots)}", file=sys.stderr, flush=True)
                due = time.perf_counter() + LINE_INTERVAL
            yield snapshot
