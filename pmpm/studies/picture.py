"""A study as a picture: error against run time, a line for each scheme."""

from pmpm.output.files import unfinished_name
from pmpm.studies.runs import FINISHED

MISSING = "no picture: matplotlib is not installed: pip install 'pmpm[viz]', and run the same command again"
NOTHING = "no picture: no run has an error or a difference"
SIZE, DPI = (5.6, 4.2), 120
MARKERS = "osD^vP*X"


def draw(study, file):
    """Draw a study into a PNG file; returns None, or what to say where that cannot be."""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        return MISSING
    lines = [(scheme, *points_of(scheme)) for scheme in study.schemes]
    if not any(points for _, points, _ in lines):
        return NOTHING
    figure = Figure(figsize=SIZE, dpi=DPI, layout="constrained")
    axes = figure.subplots()
    for number, (scheme, points, known) in enumerate(lines):
        if points:
            draw_line(axes, scheme, points, known, f"C{number % 10}", MARKERS[number % len(MARKERS)])
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel("run time of the steps (s)")
    axes.set_ylabel("error of displacement" if study.exact else "estimated error of displacement")
    axes.set_title(study.title, fontsize=9)
    axes.grid(which="both", color="#dddddd", lw=0.5)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(fontsize=8, frameon=False)
    unfinished = unfinished_name(file)
    figure.savefig(unfinished, format="png")
    unfinished.replace(file)
    return None


def points_of(scheme):
    """([(seconds, error)], whether these are errors): differences to the next level where no error is known."""
    if scheme.points:
        return [point for point in scheme.points if point[1] > 0.0], True
    pairs = zip(scheme.rows, scheme.estimate.differences, strict=True)
    return [(row["seconds"], value) for row, value in pairs if value and row["status"] == FINISHED], False


def draw_line(axes, scheme, points, known, colour, marker):
    """Draw the runs of a scheme, coarse first; hollow and dashed where they are but differences."""
    seconds, errors = zip(*points, strict=True)
    label = f"{scheme.label}, {scheme.estimate.verdict}" + ("" if known else " (differences)")
    failed = sum(row["status"] != FINISHED for row in scheme.rows)
    label += f", {failed} failed" if failed else ""
    style = {"ls": "-"} if known else {"ls": "--", "mfc": "none"}
    axes.plot(seconds, errors, color=colour, marker=marker, ms=5, lw=1.2, label=label, **style)
