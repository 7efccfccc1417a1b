"""What a driven point is shown as: a table on the screen, a CSV file, a picture."""

import numpy as np

from pmpm.output.files import OutputError, write_atomically
from pmpm.point.paths import ACROSS, AXIAL, SHEAR, VOLUME
from pmpm.scene.errors import SceneError

UNITS = {"time": "s", "p": "Pa", "q": "Pa"}  # and stress_..; all else is a pure number or a state variable
SILENT = 1e-9  # of the largest stress or strain: what stays below is zero on the screen, a column of it is left out
ALWAYS = ("step", "strain", "p", "q", "J")
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
    """{name: number below which a value of the column is shown as zero} of the columns that say something."""
    largest = {name: float(np.nanmax(np.abs(record[name]), initial=0.0)) for name in record.columns}
    stress = max(record.rounding / SILENT, *(value for name, value in largest.items() if unit_of(name) == "Pa"))
    strain = max(value for name, value in largest.items() if name.startswith(("strain", "gamma")))
    zero = {name: SILENT * (stress if unit_of(name) == "Pa" else strain) for name in largest}
    same = {name for name in record.columns if name.startswith("strain_") and (record[name] == record["strain"]).all()}
    names = [name for name in record.columns if name not in same | {"time"}]
    return {name: zero[name] for name in names if name in ALWAYS or largest[name] > zero[name]}


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


def figure_class():
    """matplotlib's Figure. Raises SceneError with what to install where matplotlib is missing."""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise SceneError("--plot needs matplotlib, which is not installed: pip install 'pmpm[viz]'") from None
    return Figure


def prefix_of(largest):
    """(factor, prefix) in which numbers of that size read well."""
    for factor, prefix in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if largest >= factor:
            return factor, prefix
    return 1.0, ""


def draw(record, path, title, file):
    """Draw the stress that a path is about over its strain and, where there is shear, the stress path q over p.

    `path` is one of paths.PATHS, None for a path of one's own.
    """
    panels = [strain_panel(path)]
    if float(record["q"].max()) > max(1e-6 * float(np.abs(record["p"]).max()), record.rounding):
        panels.append(("p", "q", "mean pressure p", "von Mises stress q"))
    Figure = figure_class()  # noqa: N806
    figure = Figure(figsize=(SIZE[0] * len(panels), SIZE[1]), dpi=DPI, layout="constrained")
    figure.suptitle(title, fontsize=9)
    for axes, (x, y, x_label, y_label) in zip(np.atleast_1d(figure.subplots(1, len(panels))), panels, strict=True):
        across, x_text = in_units(record, x, x_label)
        along, y_text = in_units(record, y, y_label)
        axes.plot(across, along, color="#1f4e79", lw=1.3)
        axes.plot(across[:1], along[:1], "o", color="#1f4e79", ms=3)
        axes.set_xlabel(x_text, fontsize=8)
        axes.set_ylabel(y_text, fontsize=8)
        axes.tick_params(labelsize=7)
        axes.grid(color="#dddddd", lw=0.5)
        axes.spines[["top", "right"]].set_visible(False)
    try:
        figure.savefig(file)
    except (OSError, ValueError) as error:
        raise OutputError(f"--plot {file}: {getattr(error, 'strerror', None) or error}") from None


def strain_panel(path):
    """(x, y, label of x, label of y) of the first panel."""
    if path is None:
        return "strain", "q", "length of the strain path", "von Mises stress q"
    if path.driven == SHEAR:
        return "strain", "stress_xy", r"shear strain $\gamma$", r"shear stress $\sigma_{xy}$"
    if path.driven == VOLUME:
        return "strain", "p", "volume strain ln J", "mean pressure p"
    assert path.driven == AXIAL
    stress = ("q", "von Mises stress q") if path.held == ACROSS and path.pressure == "required" else None
    y, label = stress or ("stress_xx", r"axial stress $\sigma_{xx}$")
    return "strain", y, r"axial strain $\ln\lambda_x$", label


def in_units(record, name, label):
    """(values, label with unit): stresses in the power of a thousand that suits them."""
    values = record[name]
    if unit_of(name) != "Pa":
        return values, label
    factor, prefix = prefix_of(float(np.nanmax(np.abs(values), initial=0.0)))
    return values / factor, f"{label} ({prefix}Pa)"
