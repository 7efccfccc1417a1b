"""A study as tables: for a terminal, as a page in Markdown, and all numbers as CSV."""

import csv
import io
import os
import platform
from pathlib import Path

from pmpm.output.files import now
from pmpm.output.run_directory import version_of
from pmpm.studies.runs import FAILED

VERSIONS_OF = ("pmpm", "numpy", "numba", "mpi4py")
COLUMNS = (
    "number", "scheme", "level", "status", "cause", "transfer", "shape_function", "precision", "cfl", "fixed_step",
    "cell_size", "particles", "steps", "seconds", "seconds_least", "seconds_most", "repeats", "compile_seconds",
    "kernels_compiled", "startup_seconds", "particle_steps_per_second", "bytes_per_particle", "ranks", "machine",
)  # fmt: skip
NAMES = {
    "velocity": "velocity",
    "deformation": "F",
    "mass": "where the mass is",
    "extent": "extent",
    "center": "center of mass",
    "kinetic": "kinetic energy",
}
NOTE = {
    True: "Errors are against the exact solution of the scene: root mean square displacement, the largest over "
    "{measured} times, relative to the largest exact one.",
    False: "The scene has no exact solution: each scheme is compared with itself. A difference is that of mean "
    "displacements of what starts in a cell of the coarsest grid, between a level and the next one: root mean square, "
    "the largest over {times} times, relative to the largest displacement. Where differences shrink, the order is log2 "
    "of their ratio, and from both follows the error that is left at the finest level (Richardson extrapolation): an "
    "estimate. Where they do not, no error is known.",
}


def machine():
    """The processor and how many cores of it this process may use."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    model = next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.machine())
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return f"{model}, {cores} core{'s' if cores != 1 else ''}"


def facts(planned, rows, ranks):
    """What a page says of a study besides its results."""
    return {
        "date": now(),
        "ranks": ranks,
        "machines": list(dict.fromkeys(row["machine"] for row in rows.values())),
        "versions": {"python": platform.python_version()} | {name: version_of(name) for name in VERSIONS_OF},
        "until": planned.options.until or planned.base.time.end,
        "options": planned.options.table(),
    }


# ---- cells of tables -------------------------------------------------------------------------------------------------------


def run_rows(study):
    """The table of runs as texts, its head first."""
    head = ["scheme", "cell (m)", "step", "particles", "steps", "time (s)", "compile (s)", "start (s)", "Mp-steps/s"]
    head += ["error", "at the end", "order"] if study.exact else ["difference", "error", "order"]
    table = [head]
    for scheme in study.schemes:
        for level, row in enumerate(scheme.rows):
            step = f"cfl {row['cfl']:g}" if row["fixed_step"] is None else f"{row['fixed_step']:.3g} s"
            start = [scheme.label, f"{row['cell_size']:g}", step]
            if row["status"] == FAILED:
                table.append([*start, *["-"] * (len(head) - 4), "failed"])
                continue
            told = [scheme.estimate.errors[level], row.get("error_displacement_end")]
            if not study.exact:
                told = [scheme.estimate.differences[level], scheme.estimate.errors[level]]
            rate = row["particle_steps_per_second"]
            table.append(
                [
                    *start, str(row["particles"]), str(row["steps"]), f"{row['seconds']:.3g}",
                    f"{row['compile_seconds']:.2g}", f"{row['startup_seconds']:.2g}",
                    "-" if rate is None else f"{rate / 1e6:.3g}", *map(error_text, told),
                    order_text(scheme.estimate.orders[level]),
                ]
            )  # fmt: skip
    return table


def quantity_rows(study):
    """The table of all quantities at the finest level: error, or difference to it, and order."""
    names = list(dict.fromkeys(name for scheme in study.schemes for name in scheme.estimates))
    table = [["scheme", *(NAMES.get(name, name) for name in names)]]
    for scheme in study.schemes:
        cells = []
        for name in names:
            estimate = scheme.estimates.get(name)
            values = (estimate.errors if study.exact else estimate.differences) if estimate else ()
            known = [value for value in values if value is not None]
            cells.append(f"{error_text(known[-1])} ({order_text(last_order(estimate))})" if known else "-")
        table.append([scheme.label, *cells])
    return table


def last_order(estimate):
    return next((order for order in reversed(estimate.orders) if order is not None), None)


def error_text(value):
    return "-" if value is None else f"{value:.2e}"


def order_text(value):
    return "-" if value is None else f"{value:.2f}"


def verdicts(study):
    """A line for each scheme, and for each run that failed or scheme that could not be."""
    lines = []
    for scheme in study.schemes:
        text = f"{scheme.label}: {scheme.estimate.verdict}"
        if scheme.estimate.left:
            kind = "error" if study.exact else "estimated error"
            text += f", {kind} of {scheme.estimate.left[1]:.2g} at level {scheme.estimate.left[0]}"
        if scheme.label in study.apart:
            best, apart = study.apart[scheme.label]
            text += f"; its finest run differs from that of {best} by {apart:.2g}"
            if scheme.estimate.left and apart > left_together(study, scheme.label, best):
                text += ", more than both estimates together: at least one of them is too small"
        lines.append(text)
        failed = [row for row in scheme.rows if row["status"] == FAILED]
        lines += [f"{scheme.label}, cells of {row['cell_size']:g} m: failed: {row['cause']}" for row in failed]
    return lines + [f"{label}: left out: {why}" for label, why in study.left_out.items()]


def left_together(study, *labels):
    left = [scheme.estimate.left for scheme in study.schemes if scheme.label in labels]
    return sum(found[1] for found in left if found is not None)


# ---- whole texts -----------------------------------------------------------------------------------------------------------


def text(study):
    """The study for a terminal."""
    head = f"{study.title}: {refined(study)}, to t = {study.facts['until']:g} s, {ranks_text(study)}"
    parts = [head, "", aligned(run_rows(study)), ""]
    parts += [quantity_title(study), "", aligned(quantity_rows(study)), "", *verdicts(study), "", study.sentence]
    return "\n".join(parts)


def page(study, picture):
    """The study as a page in Markdown; `picture`: name of its file, or None."""
    given = ", ".join(f"{name} {value}" for name, value in study.facts["versions"].items() if value)
    machines = " and ".join(study.facts["machines"])
    fair = (
        " Runs of different machines are mixed: their times do not compare." if len(study.facts["machines"]) > 1 else ""
    )
    lines = [
        f"# {study.title}",
        "",
        f"A study by pmpm: {refined(study)}, to t = {study.facts['until']:g} s, {ranks_text(study)}, {study.facts['date']}.",
        f"{machines}; {given}.{fair}",
        "",
        markdown(run_rows(study)),
        "",
        "Time is that of the steps alone; compiling, the rest of the start, and all that watches a run are not in it.",
        note(study),
        "",
        f"{quantity_title(study)}:",
        "",
        markdown(quantity_rows(study)),
        "",
        *(f"- {line}" for line in verdicts(study)),
        "",
        study.sentence,
        *(["", f"![Error against run time]({picture})"] if picture else []),
    ]
    return "\n".join(lines) + "\n"


def note(study):
    from pmpm.studies.runs import MEASURED
    from pmpm.studies.samples import TIMES

    return NOTE[study.exact].format(measured=MEASURED, times=TIMES)


def refined(study):
    return "cells refined by two" if study.refine == "space" else "time steps refined by two"


def ranks_text(study):
    ranks, repeat = study.facts["ranks"], study.facts["options"]["repeat"]
    again = f", median of {repeat} runs each" if repeat > 1 else ""
    return f"{ranks} rank{'s' if ranks > 1 else ''}{again}"


def quantity_title(study):
    if study.exact:
        return "Largest errors of the finest run, and orders"
    return "Largest differences between the two finest runs, and orders"


def aligned(table):
    """Lines of a table with columns of even width: the first to the left, the others to the right."""
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    return "\n".join(
        "  ".join([row[0].ljust(widths[0]), *(c.rjust(w) for c, w in zip(row[1:], widths[1:], strict=True))]).rstrip()
        for row in table
    )


def markdown(table):
    head, *rows = table
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(row)} |" for row in lines)


def csv_text(study):
    """All numbers of all runs; differences and orders of a level are those towards the next one, and from coarser ones."""
    names = list(dict.fromkeys(name for scheme in study.schemes for name in scheme.estimates))
    measured = list(dict.fromkeys(key for row in study.rows for key in row if key.startswith("error_")))
    estimated = (
        [] if study.exact else [f"{what}_{name}" for name in names for what in ("difference", "estimated_error")]
    )
    orders = [f"order_{name}" for name in names]
    file = io.StringIO()
    writer = csv.DictWriter(
        file, [*COLUMNS, *measured, *estimated, *orders], restval="", extrasaction="ignore", lineterminator="\n"
    )
    writer.writeheader()
    for scheme in study.schemes:
        for level, row in enumerate(scheme.rows):
            told = {}
            for name, estimate in scheme.estimates.items():
                told[f"difference_{name}"] = estimate.differences[level]
                told[f"estimated_error_{name}"] = estimate.errors[level]
                told[f"order_{name}"] = estimate.orders[level]
            writer.writerow({key: "" if value is None else value for key, value in (row | told).items()})
    return file.getvalue()
