"""A study as a picture: error against run time, a line for each scheme.

Where no error is known of a scheme it is named and has no line: its differences between levels are no errors, and would look
smaller than those of others. Where no error is known of any scheme, differences are drawn.
"""

from pmpm.output.pictures import INSTALL, plain, save
from pmpm.studies.runs import FINISHED

MISSING = f"no picture: matplotlib is not installed: {INSTALL}, and run the same command again"
NOTHING = "no picture: no run has an error or a difference"
SIZE, DPI = (5.6, 4.2), 120
MARKERS = "osD^vP*X"


def draw(study, file):
    """Draw a study into a PNG file; returns None, or what to say where that cannot be."""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        return MISSING
    known = any(scheme.points for scheme in study.schemes)
    lines = [(scheme, positive(scheme.points if known else differences_of(scheme))) for scheme in study.schemes]
    if not any(points for _, points in lines):
        return NOTHING
    figure = Figure(figsize=SIZE, dpi=DPI, layout="constrained")
    axes = figure.subplots()
    for number, (scheme, points) in enumerate(lines):
        draw_line(axes, scheme, points, known, f"C{number % 10}", MARKERS[number % len(MARKERS)])
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel("run time of the steps (s)")
    error = "error of displacement" if study.exact else "estimated error of displacement"
    axes.set_ylabel(error if known else "difference of displacement to the next level")
    axes.set_title(study.title, fontsize=9)
    plain(axes, "both")
    axes.legend(fontsize=8, frameon=False)
    save(figure, file)
    return None


def differences_of(scheme):
    """[(seconds, difference to the next level)], coarse first."""
    pairs = zip(scheme.rows, scheme.estimate.differences, strict=True)
    return [(row["seconds"], value) for row, value in pairs if value is not None and row["status"] == FINISHED]


def positive(points):
    """The points that can stand on logarithmic axes."""
    return [point for point in points if min(point) > 0.0]


def draw_line(axes, scheme, points, known, colour, marker):
    """Draw the runs of a scheme, coarse first; hollow and dashed where they are but differences."""
    seconds, values = zip(*points, strict=True) if points else ((), ())
    failed = sum(row["status"] != FINISHED for row in scheme.rows)
    label = f"{scheme.label}, {scheme.estimate.verdict}" + (f", {failed} failed" if failed else "")
    style = {"ls": "-"} if known else {"ls": "--", "mfc": "none"}
    if not points:
        style = {"ls": "none", "marker": "none"}
    axes.plot(seconds, values, **({"color": colour, "marker": marker, "ms": 5, "lw": 1.2, "label": label} | style))
