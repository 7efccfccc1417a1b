"""A run's diagnostics over time as a picture, for `pmpm plot`: energies, momentum, how far material has come, time steps,
forces on colliders, what has left and come in, where the run time went; its probes and gauges over time, and its maps."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pmpm.output.files import OutputError
from pmpm.output.pictures import figure_class, plain, save
from pmpm.output.reader import load, reading, table_in, title_of
from pmpm.output.run_directory import SCENE

KINDS = (".png", ".pdf", ".svg")
PANEL, DPI, COLUMNS = (3.9, 2.9), 130, 3
MOST_SNAPSHOTS = 100  # that are looked at for how far material has come
ROWS = 1 << 20  # of a snapshot that are read at a time
TINY = 1e-300  # of an axis: what rests has one as well
ENERGIES = "kinetic", "strain", "potential", "dissipated"
MAPS = (
    ("max_depth", "largest depth", "m"),
    ("max_speed", "largest speed in a column", "m/s"),
    ("deposit", "depth at the end", "m"),
)
STEADY = 1e-12  # of the largest energy: a line that moves less is round-off


@dataclass(frozen=True)
class Panel:
    """One panel: lines (label, x, y) over time, or `along` something else; or bars (label, least, mean, most); or an image
    (values (n, m), names of the two axes, their ends in m: left, right, low, high)."""

    title: str
    unit: str
    lines: tuple = ()
    bars: tuple = ()
    from_zero: bool = False
    along: str = "time (s)"
    image: tuple = ()


def plot(path, file=None):
    """Draw the run in the folder `path`, finished or running, into a file (default: plot.png in the folder). Returns a line of
    text. Raises OutputError, or SceneError where matplotlib is missing."""
    run = load(path)
    file = Path(file) if file is not None else Path(path) / "plot.png"
    if file.suffix.lower() not in KINDS:
        raise OutputError(f"--out {file}: the name must end with one of {', '.join(KINDS)}")
    Figure = figure_class("pmpm plot")  # noqa: N806
    panels = panels_of(run)
    if not panels:
        raise OutputError(f"{path} holds nothing to draw yet: no two lines of diagnostics")
    rows = -(-len(panels) // COLUMNS)
    columns = min(len(panels), COLUMNS)
    figure = Figure(figsize=(PANEL[0] * columns, PANEL[1] * rows + 0.4), dpi=DPI, layout="constrained")
    figure.suptitle(f"{title_of(run.path / SCENE) or Path(path).name} ({run.status})", fontsize=10)
    grid = np.atleast_1d(figure.subplots(rows, columns)).ravel()
    for axes, panel in zip(grid, panels, strict=False):
        draw(axes, panel)
    for axes in grid[len(panels) :]:
        axes.set_axis_off()
    try:
        save(figure, file)
    except OSError as error:
        raise OutputError(f"--out {file}: {error.strerror or error}") from None
    return f"{file}: {', '.join(panel.title for panel in panels)}"


def panels_of(run):
    """The Panels that there is something to see in."""
    diagnostics = run.diagnostics
    found = []
    if len(diagnostics.get("time", ())) > 1:
        found = [
            Panel("energies", "J", energies(diagnostics)),
            Panel("momentum", "N s", columns(diagnostics, "momentum_")),
            Panel("largest speed", "m/s", columns(diagnostics, "max_speed"), from_zero=True),
            Panel("time step", "s", columns(diagnostics, "dt"), from_zero=True),
            *(Panel(f"force along {axis} on colliders", "N", columns(diagnostics, f"force_{axis}_")) for axis in "xyz"),
            Panel("mass that has left", "kg", columns(diagnostics, "left_mass"), from_zero=True),
            Panel("mass that has come in", "kg", columns(diagnostics, "emitted_mass"), from_zero=True),
        ]
    found.append(Panel("extent of material", "m", extents(run.snapshots)))
    found.append(Panel("run time by phase", "s", bars=phases(table_in(run.record, "report"))))
    found += [*series_panels(run.probes, run.gauges), *map_panels(run.maps)]
    return [panel for panel in found if panel.lines or panel.bars or panel.image]


def series_panels(probes, gauges):
    """Panels of the probes and gauges over time, one for each quantity, with a line for each of them."""

    def lines(of, column):
        return tuple((name, told["time"], told[column]) for name, told in of.items() if column in told)

    speeds = {
        name: told | {"speed": np.sqrt(sum(told[key] ** 2 for key in told if key.startswith("velocity_")))}
        for name, told in probes.items()
        if "time" in told
    }
    return [
        Panel("speed at probes", "m/s", lines(speeds, "speed"), from_zero=True),
        Panel("pressure at probes", "Pa", lines(speeds, "pressure")),
        Panel("height of the surface at gauges", "m", lines(gauges, "height")),
        Panel("discharge at gauges", "m3/s", lines(gauges, "discharge")),
    ]


def map_panels(maps):
    """Panels of the maps of a run: images over a plane, or lines along an axis."""
    axes = [axis for axis in "xyz" if axis in maps]
    found = []
    for name, title, unit in MAPS:
        if name not in maps or not 1 <= len(axes) <= 2 or maps[name].shape != tuple(len(maps[axis]) for axis in axes):
            continue
        if len(axes) == 1:
            line = ("", maps[axes[0]], maps[name])
            found.append(Panel(title, unit, (line,), from_zero=True, along=f"{axes[0]} (m)"))
        else:
            ends = [end for axis in axes for end in (0.0, maps[axis][0] + maps[axis][-1])]
            found.append(Panel(title, unit, image=(maps[name], axes, ends)))
    return found


def phases(report):
    """Bars of the phases of a run, the longest last."""
    of_phases = table_in(report, "seconds_per_phase")
    told = [(name, *(table_in(of_phases, name).get(key) for key in ("min", "mean", "max"))) for name in of_phases]
    whole = [bar for bar in told if all(isinstance(value, float) for value in bar[1:])]
    return tuple(sorted(whole, key=lambda bar: bar[2]))


def energies(diagnostics):
    """Lines of the energies, potential energy counted from its first value. What is dissipated completes their sum: less than
    nothing of it is energy that came out of nothing, or that walls in motion put in."""
    values = {name: diagnostics[name] for name in ENERGIES if name in diagnostics}
    if "potential" in values:
        values["potential"] = values["potential"] - values["potential"][0]
    largest = max((np.nanmax(np.abs(value), initial=0.0) for value in values.values()), default=0.0)
    return tuple(
        (name, diagnostics["time"], value) for name, value in values.items() if np.ptp(value) > STEADY * largest
    )


def columns(diagnostics, prefix):
    """Lines of the columns whose names begin so, by what follows."""
    return tuple(
        (name.removeprefix(prefix), diagnostics["time"], values)
        for name, values in diagnostics.items()
        if name.startswith(prefix)
    )


def extents(snapshots):
    """Lines of the lowest and highest coordinate of any particle along each axis, over some of the snapshots."""
    if len(snapshots) < 2:
        return ()
    chosen = np.unique(np.linspace(0, len(snapshots) - 1, MOST_SNAPSHOTS).astype(int))
    times, found = [], []
    for number in chosen:
        snapshot = snapshots[int(number)]
        times.append(snapshot.time)
        found.append(extent_of(snapshot))
    reach = np.array(found)
    return tuple(
        (f"{end} {axis}", np.array(times), reach[:, which, place])
        for place, axis in enumerate("xyz"[: reach.shape[2]])
        for which, end in enumerate(("lowest", "highest"))
    )


def extent_of(snapshot):
    """(2, dim) lowest and highest coordinates in m; nan where there are no particles."""
    dim = snapshot.attributes["dim"]
    low, high = np.full(dim, np.inf), np.full(dim, -np.inf)
    with reading(snapshot.path) as file:
        points = file["VTKHDF/Points"]
        for first in range(0, len(points), ROWS):
            x = points[first : first + ROWS, :dim]
            low, high = np.minimum(low, x.min(axis=0)), np.maximum(high, x.max(axis=0))
    return np.where(low <= high, (low, high), np.nan)


def draw(axes, panel):
    """Draw one panel."""
    axes.set_title(panel.title, fontsize=9)
    if panel.bars:
        names, least, mean, most = zip(*panel.bars, strict=True)
        spread = np.array([np.subtract(mean, least), np.subtract(most, mean)]).clip(0.0)
        axes.barh(names, mean, xerr=spread, color="#7fa7c9", error_kw={"lw": 1.0})
        axes.set_xlabel(f"{panel.unit}, mean over ranks, from least to most", fontsize=8)
    elif panel.image:
        draw_image(axes, panel)
    else:
        for number, (label, x, y) in enumerate(panel.lines):
            axes.plot(x, y, lw=1.2, color=f"C{number}", label=label or None)
        if panel.from_zero:
            axes.set_ylim(0.0, max(1.05 * max(np.nanmax(y, initial=0.0) for _, _, y in panel.lines), TINY))
        axes.set_xlabel(panel.along, fontsize=8)
        axes.set_ylabel(panel.unit, fontsize=8)
        if len(panel.lines) > 1:
            axes.legend(fontsize=7, frameon=False)
    axes.tick_params(labelsize=7)
    axes.yaxis.get_offset_text().set_fontsize(7)
    plain(axes)
    if panel.image:
        axes.grid(False)


def draw_image(axes, panel):
    """Draw a map seen from above; what nothing has reached stays white."""
    values, names, ends = panel.image
    shown = np.ma.masked_less_equal(values, 0.0)
    picture = axes.imshow(shown.T, origin="lower", extent=ends, cmap="viridis", vmin=0.0, interpolation="nearest")
    axes.set_xlabel(f"{names[0]} (m)", fontsize=8)
    axes.set_ylabel(f"{names[1]} (m)", fontsize=8)
    colours = axes.figure.colorbar(picture, ax=axes, shrink=0.8)
    colours.set_label(panel.unit, fontsize=8)
    colours.ax.tick_params(labelsize=7)
