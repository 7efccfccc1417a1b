"""Pictures and films of a run for `pmpm render`: its particles, coloured by a field, drawn without a screen.

By PyVista in space, where it works (see vista.py), by matplotlib in the plane and where it does not.

For cuts, contours and a camera of one's own there is ParaView: every run leaves a snapshots.xdmf for it.
"""

import difflib
import math
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from pmpm.output import film
from pmpm.output.datasets import UNITS
from pmpm.output.files import OutputError, unfinished_name
from pmpm.output.outlines import outlines
from pmpm.output.pictures import Surface, figure_class, plain, save
from pmpm.output.progress import LINE_INTERVAL
from pmpm.output.reader import load, reading
from pmpm.output.run_directory import SCENE
from pmpm.state.fields import OUTPUT_NAMES

STILLS, FILMS = (".png", ".pdf", ".svg"), (".gif", ".mp4")
MOST = 200_000  # particles of a picture: of more every n-th is drawn
WIDTH, LEAST, DPI = 8.0, 3.0, 130  # inches, and dots per inch
COLOURS = 10  # of materials: then they begin anew
PREFERRED = "speed", "velocity", "pressure", "material"
BACKENDS = ("pyvista", "matplotlib")
VECTOR_STILLS = (".pdf", ".svg")
ISO = (18.0, -62.0)  # degrees of elevation and azimuth
PIXELS = (100, 8000)  # least and most of a side


@dataclass(frozen=True)
class Asked:
    """How a picture is asked for. field: its name, None for the first of PREFERRED; backend: one of BACKENDS, None for the one
    that suits; view: see `camera_of`; zoom: 1 shows the whole domain; limits: of the colours; colours: a colour map of
    matplotlib; pixels: (width, height) or None; box: whether the domain is drawn; surfaces: more pictures.Surface."""

    field: str | None = None
    backend: str | None = None
    view: str = "iso"
    zoom: float = 1.0
    limits: tuple[float, float] | None = None
    colours: str | None = None
    pixels: tuple[int, int] | None = None
    box: bool = True
    surfaces: tuple[Surface, ...] = ()


@dataclass(frozen=True)
class View:
    """What all frames share: sizes (m), names and order of the axes (the last one upright), distance of particles (m), field,
    its label, its range, names of materials if it is their number; the camera's unit vectors to the right, up and toward the
    eye, and its angles (elevation, azimuth) among the axes in their order; the rest as in Asked."""

    title: str
    size: np.ndarray
    order: tuple[int, ...]
    spacing: float
    field: str
    label: str
    limits: tuple[float, float]
    materials: tuple[str, ...]
    camera: tuple[np.ndarray, np.ndarray, np.ndarray]
    angles: tuple[float, float]
    zoom: float = 1.0
    colours: Any = "viridis"
    material_colours: tuple = ()
    pixels: tuple[int, int] | None = None
    box: bool = True
    surfaces: tuple[Surface, ...] = ()


def render(path, asked=None, number=-1, file=None, quiet=False):
    """Draw a snapshot (its number, negative ones from the last) of the run in the folder `path` into a picture, or all of them
    into a film, if the file's name ends as one of FILMS. Default: render.png in the folder. Returns a line of text.

    Raises OutputError for what cannot be read or written, SceneError where what draws is missing.
    """
    asked = asked or Asked()
    run = load(path)
    file = Path(file) if file is not None else Path(path) / "render.png"
    kind = file.suffix.lower()
    if kind not in STILLS + FILMS:
        raise OutputError(f"--out {file}: the name must end with one of {', '.join(STILLS + FILMS)}")
    check_asked(asked)
    snapshots = run.snapshots
    if not -len(snapshots) <= number < len(snapshots):
        there = f"they are 0 to {len(snapshots) - 1}" if len(snapshots) else "there is none yet"
        raise OutputError(f"{path}: no snapshot {number}: {there}")
    Figure = figure_class("pmpm render")  # noqa: N806
    chosen = list(snapshots) if kind in FILMS else [snapshots[number]]
    try:
        view = view_of(run.table, chosen, asked)
    except (KeyError, TypeError, ValueError, ArithmeticError) as error:
        raise OutputError(f"{Path(path) / SCENE} is damaged: {' '.join(str(error).split())}") from error
    backend, note = backend_of(asked, view, kind)
    try:
        if kind in FILMS:
            film.check(file)
            film.write(file, frames(backend, Figure, view, told(chosen, quiet)))
        elif backend == "pyvista":
            (picture,) = frames(backend, Figure, view, chosen)
            save_pixels(picture, file)
        else:
            figure = new_figure(Figure, view)
            draw(figure, view, chosen[0])
            save(figure, file)
    except OSError as error:
        raise OutputError(f"--out {file}: {error.strerror or error}") from None
    count = f"{len(chosen)} frames" if kind in FILMS else f"t = {chosen[0].time:.6g} s"
    return f"{file}: {view.label}, {count}, drawn by {'PyVista' if backend == 'pyvista' else 'matplotlib'}{note}"


def check_asked(asked):
    """Raise OutputError for what no picture can be like."""
    if not 0.0 < asked.zoom < math.inf:
        raise OutputError(f"--zoom {asked.zoom:g}: must be greater than 0")
    if asked.limits is not None and not -math.inf < asked.limits[0] < asked.limits[1] < math.inf:
        raise OutputError(
            f"--range {asked.limits[0]:g} {asked.limits[1]:g}: the second number must be greater than the first"
        )
    if asked.pixels is not None and not all(PIXELS[0] <= count <= PIXELS[1] for count in asked.pixels):
        raise OutputError(f"--size {asked.pixels[0]} {asked.pixels[1]}: each must be {PIXELS[0]} to {PIXELS[1]} pixels")


def backend_of(asked, view, kind):
    """(who draws, what to say of it): who is asked for, else PyVista in space, if it works here, else matplotlib."""
    if asked.backend == "matplotlib" or (asked.backend is None and (len(view.size) == 2 or kind in VECTOR_STILLS)):
        return "matplotlib", ""
    if kind in VECTOR_STILLS:
        raise OutputError(
            f"--with pyvista: draws {', '.join(s for s in STILLS if s not in VECTOR_STILLS)} and films, not {kind}"
        )
    from pmpm.output import vista

    if asked.backend == "pyvista":
        vista.require()
    elif (reason := vista.trouble()) is not None:
        return "matplotlib", f" ({reason})"
    return "pyvista", ""


def view_of(scene, snapshots, asked):
    """The View of some snapshots of a scene (see reader.Run.table), as it is Asked for."""
    domain = scene["domain"]
    dim, gravity = len(domain["size"]), domain["gravity"]
    up = int(np.argmax(np.abs(gravity))) if any(gravity) else dim - 1
    order = (*(axis for axis in range(dim) if axis != up), up) if dim == 3 else (0, 1)
    field = asked.field or next((name for name in PREFERRED if name in snapshots[0].fields), "id")
    limits = asked.limits or range_of(snapshots, field)
    sources = [*scene.get("bodies", ()), *scene.get("inflows", ())]
    spacing = domain["cell_size"] / min(source["particles_per_cell"] for source in sources) ** (1.0 / dim)
    unit = UNITS.get(field, "-")
    name = "speed" if field == "velocity" else field.replace("_", " ")
    camera, angles = camera_of(asked.view, order)
    view = View(
        scene.get("title", ""), np.array(domain["size"]), order, spacing, field,
        f"{name} ({unit})" if unit != "-" else name, limits, tuple(scene["materials"]) if field == "material" else (),
        camera, angles, asked.zoom, colour_map(asked.colours), (), asked.pixels, asked.box,
        (*outlines(scene), *asked.surfaces),
    )  # fmt: skip
    return with_material_colours(view) if view.materials else view


def colour_map(name):
    """A colour map of matplotlib by its name. OutputError for one that it has not."""
    from matplotlib import colormaps

    if name is not None and name not in colormaps:
        near = difflib.get_close_matches(name, list(colormaps), n=3, cutoff=0.4)
        guess = f"did you mean {', '.join(near)}?" if near else "viridis, plasma, coolwarm, turbo, ..."
        raise OutputError(f"--colors {name}: is no colour map of matplotlib; {guess}")
    return name or "viridis"


def with_material_colours(view):
    """A View of the number of the material: as many colours as there are, which begin anew after COLOURS."""
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap

    known = colormaps["tab10" if view.colours == "viridis" else view.colours]
    count = min(len(view.materials), COLOURS)
    shades = [known(n if known.N <= 20 else n / max(count - 1, 1)) for n in range(count)]
    return replace(
        view, limits=(-0.5, count - 0.5), colours=ListedColormap(shades),
        material_colours=tuple(shades[n % COLOURS] for n in range(len(view.materials))),
    )  # fmt: skip


def camera_of(name, order):
    """((right, up, toward) unit vectors, (elevation, azimuth) in degrees) of a view: "iso", an axis from which one looks, such
    as "x" or "-x", or "elevation,azimuth" with the azimuth from the first of the axes in their `order`, counter-clockwise seen
    from above. OutputError for another."""
    axes = np.eye(3)
    if len(order) == 2:
        if name not in ("iso", "z"):
            raise OutputError(f"--view {name}: is for runs in space")
        return tuple(axes), (90.0, -90.0)
    first, up = axes[order[0]], axes[order[2]]
    left = np.cross(up, first)  # of who looks along the first axis; completes a right-handed frame with it and up
    elevation, azimuth = angles_of(name, first, left, up)
    h, v = np.radians(azimuth), np.radians(elevation)
    toward = np.cos(v) * (np.cos(h) * first + np.sin(h) * left) + np.sin(v) * up
    right = -np.sin(h) * first + np.cos(h) * left
    return (right, np.cross(toward, right), toward), (elevation, azimuth)


def angles_of(name, first, left, up):
    if name == "iso":
        return ISO
    sign, axis = (-1.0, name[1:]) if name.startswith("-") else (1.0, name)
    if axis in ("x", "y", "z"):
        eye = sign * np.eye(3)["xyz".index(axis)]
        if abs(eye @ up) > 0.5:
            return 90.0 * float(eye @ up), -90.0
        return 0.0, float(np.degrees(np.arctan2(eye @ left, eye @ first)))
    try:
        elevation, azimuth = map(float, name.split(","))
        if -90.0 <= elevation <= 90.0 and abs(azimuth) <= 360.0:
            return elevation, azimuth
    except ValueError:
        pass
    raise OutputError(
        f"--view {name}: must be iso, x, y, z, -x, -y, -z or ELEVATION,AZIMUTH in degrees, such as 18,-62"
    )


def frames(backend, Figure, view, snapshots):  # noqa: N803
    """Yield a picture (height, width, 3) of bytes of each snapshot."""
    if backend == "pyvista":
        from pmpm.output.vista import Stage

        stage = Stage(view)
        try:
            for snapshot in snapshots:
                yield stage.frame(snapshot.x, colour_values(view, snapshot), snapshot.time, snapshot.collider_places)
        finally:
            stage.close()
        return
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    figure = new_figure(Figure, view)
    canvas = FigureCanvasAgg(figure)
    for snapshot in snapshots:
        figure.clear()
        draw(figure, view, snapshot)
        canvas.draw()
        yield np.asarray(canvas.buffer_rgba())[..., :3].copy()


def new_figure(Figure, view):  # noqa: N803
    return Figure(figsize=figure_size(view), dpi=DPI, layout="constrained")


def save_pixels(picture, file):
    """Write a picture of bytes, whole or not at all."""
    from PIL import Image

    unfinished = unfinished_name(file)
    try:
        Image.fromarray(picture).save(unfinished, format="PNG")
        unfinished.replace(file)
    finally:
        unfinished.unlink(missing_ok=True)


def colour_values(view, snapshot):
    values = scalars(snapshot, view.field)
    return values % COLOURS if view.materials else values


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
        if field == "speed" and field not in held and "velocity" in held:
            field = "velocity"  # whose length it is
        if field not in held:
            advice = "; add it to output.fields of the scene and run it again" if field in OUTPUT_NAMES else ""
            raise OutputError(f"{snapshot.path} holds no field {field}; it holds {', '.join(sorted(held))}{advice}")
        values = held[field][...]
    if values.ndim == 2 and values.shape[1] > 3:
        raise OutputError(f"--field {field}: a tensor has no colour; von_mises_stress and pressure are numbers")
    return np.sqrt((values * values).sum(axis=1)) if values.ndim == 2 else values


def figure_size(view):
    """Inches."""
    if view.pixels is not None:
        return view.pixels[0] / DPI, view.pixels[1] / DPI
    if len(view.size) == 3:
        return WIDTH, 0.72 * WIDTH
    return WIDTH, max(LEAST, 0.86 * WIDTH * view.size[1] / view.size[0] + 0.9)


def draw(figure, view, snapshot):
    """Draw a snapshot into an empty figure."""
    x, values = snapshot.x, colour_values(view, snapshot)
    every = -(-len(x) // MOST) or 1
    x, values = x[::every], values[::every]
    two = len(view.size) == 2
    axes = figure.add_subplot(projection=None if two else "3d")
    style: dict[str, Any] = {"linewidths": 0, "rasterized": True, "cmap": view.colours}
    style |= {"vmin": view.limits[0], "vmax": view.limits[1], "plotnonfinite": False}
    columns = [x[:, axis] for axis in view.order]
    if two:
        middle, half = 0.5 * view.size, 0.5 * view.size / view.zoom
        axes.set_xlim(middle[0] - half[0], middle[0] + half[0])
        axes.set_ylim(middle[1] - half[1], middle[1] + half[1])
        axes.set_aspect("equal")
        plain(axes)
        style["marker"] = "s"
    else:
        axes.set_box_aspect([view.size[axis] for axis in view.order], zoom=view.zoom)
        for limit, axis in zip((axes.set_xlim, axes.set_ylim, axes.set_zlim), view.order, strict=True):
            limit(0.0, view.size[axis])
        if mirrored(view.order):  # else left and right were exchanged
            axes.set_ylim(view.size[view.order[1]], 0.0)
        axes.view_init(elev=view.angles[0], azim=view.angles[1])
        axes.set_zlabel(f"{'xyz'[view.order[2]]} (m)", fontsize=8)
        style["depthshade"] = False
        if not view.box:
            axes.set_axis_off()
    axes.set_xlabel(f"{'xyz'[view.order[0]]} (m)", fontsize=8)
    axes.set_ylabel(f"{'xyz'[view.order[1]]} (m)", fontsize=8)
    axes.tick_params(labelsize=7)
    points = axes.scatter(*columns, c=values, s=marker_area(view, every), **style)
    draw_surfaces(axes, view, snapshot)
    if view.materials:
        for name, colour in zip(view.materials, view.material_colours, strict=True):
            axes.scatter(*[[] for _ in view.order], color=colour, label=name, s=20)
        axes.legend(fontsize=8, frameon=False, loc="upper right")
    else:
        colours = figure.colorbar(points, ax=axes, shrink=0.8, pad=0.02 if two else 0.1)
        colours.set_label(view.label, fontsize=8)
        colours.ax.tick_params(labelsize=7)
    axes.set_title(f"{view.title}    t = {snapshot.time:.4g} s".strip(), fontsize=10)


def mirrored(order):
    """Whether axes in this order make a left-handed frame."""
    return order in ((0, 2, 1), (2, 1, 0), (1, 0, 2))


def draw_surfaces(axes, view, snapshot):
    """Draw the Surfaces of a View into its axes, where they are in a snapshot."""
    where = snapshot.collider_places
    placed = [(surface, points) for surface in view.surfaces for points in surface.at(snapshot.time, where)]
    for surface, points in placed:
        points = points[:, list(view.order)]
        if surface.triangles is None:
            axes.plot(*points.T, color="black", lw=1.2)
        elif len(view.size) == 3:
            from mpl_toolkits.mplot3d.art3d import Poly3DCollection

            corners = points[np.asarray(surface.triangles)]
            axes.computed_zorder = (
                False  # it sorts whole collections by their middles: particles come before what they lie on
            )
            axes.add_collection3d(Poly3DCollection(corners, facecolor="#b8b0a0", alpha=surface.opacity, lw=0, zorder=0))


def marker_area(view, every):
    """Square points of a marker as wide as a particle is."""
    inches = (
        0.8 * figure_size(view)[0] * view.zoom / view.size[view.order[0]]
        if len(view.size) == 2
        else 0.45 * figure_size(view)[0] * view.zoom / view.size.max()
    )
    width = 72.0 * inches * view.spacing * every ** (1.0 / len(view.size))
    return max((1.25 * width) ** 2, 0.1)


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
