"""What a driven point is shown as: a table on the screen, a CSV file, a picture."""

from pathlib import Path

import numpy as np

from pmpm.output.files import OutputError, write_atomically
from pmpm.output.pictures import figure_class, plain, save
from pmpm.point.paths import SHEAR, VOLUME

UNITS = {"time": "s", "p": "Pa", "q": "Pa"}  # and stress_..; all else is a pure number or a state variable
SILENT = 1e-9  # of the largest stress or strain: what stays below is zero on the screen, a column of it is left out
ALWAYS = ("step", "strain", "p", "q", "J")
LABELS = {
    "p": "mean pressure p",
    "q": "von Mises stress q",
    "stress_xx": r"axial stress $\sigma_{xx}$",
    "stress_xy": r"shear stress $\sigma_{xy}$",
    "volume": r"volume strain $\ln J$",
}
COLOUR = "#1f4e79"
SIZE, DPI = (3.4, 2.9), 90  # of one panel, inches and dots per inch


def csv_text(record):
    """The whole record, one row per step."""
    rows = zip(*record.columns.values(), strict=True)
    return "\n".join([",".join(record.columns), *(",".join(map(number_text, row)) for row in rows)]) + "\n"


def number_text(value):
    return repr(value) if isinstance(value, int) else repr(float(value))


def table_text(record, rows):
    """At most `rows` rows, evenly spread, the last among them; columns that stay at zero are left out."""
    if not record.rows:
        return ""
    chosen = np.unique(np.linspace(0, record.rows - 1, min(rows, record.rows)).round().astype(int))
    zero = shown(record)
    names = list(zero)
    cells = [names, [unit_of(name) for name in names]]
    cells += [[cell(name, record.columns[name][n], zero[name]) for name in names] for n in chosen]
    widths = [max(len(row[column]) for row in cells) for column in range(len(names))]
    return "\n".join("  ".join(text.rjust(width) for text, width in zip(row, widths, strict=True)) for row in cells)


def shown(record):
    """{name: number below which a value of the column is zero} of the columns that say something."""
    zero = zeros(record)
    same = {name for name in record.columns if name.startswith("strain_") and (record[name] == record["strain"]).all()}
    names = [name for name in record.columns if name not in same | {"time"}]
    return {name: zero[name] for name in names if name in ALWAYS or largest(record, name) > zero[name]}


def zeros(record):
    """{name: number below which a value of the column is no more than round-off}."""
    stress = max(largest(record, name) for name in record.columns if unit_of(name) == "Pa")
    strain = max(largest(record, name) for name in record.columns if name.startswith(("strain", "gamma")))
    stress_zero, strain_zero = max(SILENT * stress, record.rounding), SILENT * strain
    return {name: stress_zero if unit_of(name) == "Pa" else strain_zero for name in record.columns}


def largest(record, name):
    return float(np.nanmax(np.abs(record[name]), initial=0.0))


def unit_of(name):
    return "Pa" if name.startswith("stress_") else UNITS.get(name, "-")


def cell(name, value, zero):
    if name == "step":
        return str(value)
    return "0" if abs(value) <= zero else f"{value:.6g}"


def write_csv(record, file):
    try:
        write_atomically(file, csv_text(record))
    except OSError as error:
        raise OutputError(f"--out {file}: {error.strerror or error}") from None


def prefix_of(largest):
    """(factor, prefix) in which numbers of that size read well."""
    for factor, prefix in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if largest >= factor:
            return factor, prefix
    return 1.0, ""


def draw(record, path, title, file):
    """Draw the stress that a path is about over its strain, and the change of volume or the stress path q over p.

    `path` is one of paths.PATHS, None for a path of one's own.
    """
    Figure = figure_class("--plot")  # noqa: N806
    panels = panels_of(record, path)
    figure = Figure(figsize=(SIZE[0] * len(panels), SIZE[1]), dpi=DPI, layout="constrained")
    figure.suptitle(title, fontsize=9)
    for axes, (x, y) in zip(np.atleast_1d(figure.subplots(1, len(panels))), panels, strict=True):
        (across, x_label), (along, y_label) = (in_units(record, name) for name in (x, y))
        axes.plot(across, along, color=COLOUR, lw=1.3)
        axes.plot(across[:1], along[:1], "o", color=COLOUR, ms=3)
        axes.set_xlabel(x_label if x != "strain" else strain_label(path), fontsize=8)
        axes.set_ylabel(y_label, fontsize=8)
        axes.locator_params(nbins=5)
        axes.tick_params(labelsize=7)
        plain(axes)
    try:
        save(figure, Path(file))
    except (OSError, ValueError) as error:
        raise OutputError(f"--plot {file}: {getattr(error, 'strerror', None) or error}") from None


def panels_of(record, path):
    """[(x, y)] of the panels, names for `column`; the second only where there is something to see."""
    if path is None:
        first, second = ("strain", "q"), ("p", "q")
    elif path.driven == VOLUME:
        first, second = ("strain", "p"), ("p", "q")
    else:
        first = ("strain", "stress_xy" if path.driven == SHEAR else "stress_xx")
        second = ("p", "q") if path.held is None else ("strain", "volume")
    return [first, second] if all(np.ptp(column(record, name)) > 0.0 for name in second) else [first]


def strain_label(path):
    if path is None:
        return "length of the strain path"
    return {SHEAR: r"shear strain $\gamma$", VOLUME: r"volume strain $\ln J$"}.get(
        path.driven, r"axial strain $\ln\lambda_x$"
    )


def column(record, name):
    """Values of a column, or ln J as `volume`; what is round-off is zero."""
    if name == "volume":
        values, zero = sum(record[one] for one in record.columns if one.startswith("strain_")), SILENT
    else:
        values, zero = record[name], zeros(record)[name]
    return np.where(np.abs(values) <= zero, 0.0, values)


def in_units(record, name):
    """(values, label with unit) of a column: stresses in the power of a thousand that suits them."""
    values, label = column(record, name), LABELS.get(name, name)
    if unit_of(name) != "Pa":
        return values, label
    factor, prefix = prefix_of(float(np.nanmax(np.abs(values), initial=0.0)))
    return values / factor, f"{label} ({prefix}Pa)"
