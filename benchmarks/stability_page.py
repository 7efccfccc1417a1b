"""The page and the picture of benchmarks/stability.py (the picture needs matplotlib)."""

import math
import sys
from datetime import date

import machine
import matplotlib
import numpy as np
import pages
from stress.explained import NOT_RUN, ROWS
from stress.matrix import DOUBLE, FAILED, SINGLE, STOPPED, SURVIVES

matplotlib.use("Agg")
from matplotlib import pyplot  # noqa: E402

COLOURS = {SURVIVES: "#8fce8f", STOPPED: "#f5d76e", FAILED: "#e07060", None: "#f4f4f4"}
MOST_LISTED = 6  # schemes named one by one where a run is not as expected
ONLY_SOME = 4  # columns of a case that runs under a few schemes alone


def worst(verdicts):
    return next((letter for letter in (FAILED, STOPPED, SURVIVES) if letter in verdicts), None)


def by_case(results):
    """{case: {scheme: {variant: result}}}, in the order of the matrix."""
    found = {}
    for entry, result in results.items():
        found.setdefault(entry.case, {}).setdefault(entry.scheme, {})[entry.variant] = result
    return found


def counts(runs):
    """What a cell says: S where all survive, else how many of how many do what."""
    verdicts = [run["verdict"] for run in runs.values()]
    present = [letter for letter in (SURVIVES, STOPPED, FAILED) if letter in verdicts]
    return present[0] if len(present) == 1 else " ".join(f"{letter}{verdicts.count(letter)}" for letter in present)


def unexpected(runs):
    return any(run["verdict"] not in run["expected"] for run in runs.values())


def cell(runs):
    return counts(runs) + (" ✘" if unexpected(runs) else "")


def number(values, digits=3):
    known = [v for v in values if v is not None and math.isfinite(v)]
    return f"{max(known):.{digits}g}" if known else "-"


def energy_of(runs):
    """The highest ratio of all runs that came to their end."""
    return number([run["energy"] for run in runs.values() if run["verdict"] != STOPPED])


def wall_of(runs):
    return f"{sum(run['wall'] for run in runs.values()):.1f}"


def step_of(runs):
    steps = [run["smallest_dt"] for run in runs.values() if run["steps"] > 1 and math.isfinite(run["smallest_dt"])]
    return f"{min(steps):.1e}" if steps else "-"


def short(scheme):
    return f"{scheme.transfer} {['linear', 'quadratic', 'cubic'].index(scheme.shape_function) + 1}"


def grid(cases, columns, show):
    columns = [s for s in columns if any(s in schemes for schemes in cases.values())]
    rows = {
        case: schemes
        for case, schemes in cases.items()
        if len(case.schemes) > ONLY_SOME and set(columns) & set(schemes)
    }
    lines = ["| | " + " | ".join(map(short, columns)) + " |", "|" + " --- |" * (len(columns) + 1)]
    for case, schemes in rows.items():
        told = [show(schemes[s]) if s in schemes else "" for s in columns]
        lines.append(f"| {case.row} {case.name} | " + " | ".join(told) + " |")
    return "\n".join(lines) if rows else "none was run"


def first_failing(runs):
    """The smallest ratio of the bound that does not survive."""
    bad = [float(variant.split()[0]) for variant, run in runs.items() if run["verdict"] != SURVIVES]
    silent = [float(variant.split()[0]) for variant, run in runs.items() if run["verdict"] == FAILED]
    if not bad:
        return f"> {max(float(variant.split()[0]) for variant in runs):g}"
    return f"{min(bad):g}" + (f" (F at {min(silent):g})" if silent else "")


def few(cases):
    """Cases that run under a few schemes alone, a line each."""
    lines = ["| case | scheme | runs | verdicts |", "| --- | --- | --- | --- |"]
    for case, schemes in cases.items():
        if len(case.schemes) <= ONLY_SOME:
            lines += [f"| {case.row} {case.name} | {s} | {len(runs)} | {cell(runs)} |" for s, runs in schemes.items()]
    return "\n".join(lines)


def why(result):
    return "; ".join([*result["wrong"], result["message"]]).strip("; ").replace("|", "\\|").replace("\n", " ")


def not_as_expected(cases):
    """A line for each case, variant and cause, with the schemes under which it is so."""
    groups = {}
    for case, schemes in cases.items():
        for scheme, runs in schemes.items():
            for variant, run in runs.items():
                if run["verdict"] not in run["expected"]:
                    groups.setdefault((case, run["verdict"], variant), []).append((scheme, run))
    lines = ["| case | variant | verdict | schemes | energy | of the first |", "| --- | --- | --- | --- | --- | --- |"]
    for (case, verdict, variant), found in groups.items():
        names = [f"{short(s)}{' f32' if s.single else ''}" for s, _ in found]
        told = ", ".join(names[:MOST_LISTED]) + (
            f" and {len(names) - MOST_LISTED} more" if len(names) > MOST_LISTED else ""
        )
        energy = number([run["energy"] for _, run in found])
        lines.append(
            f"| {case.row} {case.name} | {variant} | {verdict} | {told} | {energy} | {why(found[0][1])[:200]} |"
        )
    return "\n".join(lines) if groups else "None."


def reported(case, schemes):
    """Numbers that a case reports, for the default scheme, a line for each variant."""
    scheme = next((s for s in schemes if (s.transfer, s.shape_function) == ("apic", "quadratic")), next(iter(schemes)))
    runs = schemes[scheme]
    names = list(dict.fromkeys(name for run in runs.values() for name in run["numbers"]))
    if not names:
        return ""
    head = ["variant", "verdict", "steps", "smallest dt, s", "energy", *names]
    lines = [f"{case.name} under {scheme}:", "", "| " + " | ".join(head) + " |", "|" + " --- |" * len(head)]
    for variant, run in runs.items():
        values = [run["numbers"].get(name, "") for name in names]
        told = [f"{v:.3g}" if isinstance(v, float) else str(v) for v in values]
        alone = {variant: run}
        told = [variant, run["verdict"], str(run["steps"]), step_of(alone), energy_of(alone), *told]
        lines.append("| " + " | ".join(told) + " |")
    return "\n".join(lines) + "\n"


def sections(cases):
    """Each row in words, with what its cases report."""
    parts = []
    for row, text in ROWS.items():
        parts.append(f"### {row} {text}\n")
        for case in cases:
            if case.row == row:
                parts.append(f"- {case.name}: {case.what}\n")
        parts += [table for case, schemes in cases.items() if case.row == row and (table := reported(case, schemes))]
    return "\n".join(parts)


def page(results, not_run, jobs, verdict):
    cases = by_case(results)
    tally = {letter: sum(r["verdict"] == letter for r in results.values()) for letter in (SURVIVES, STOPPED, FAILED)}
    sweeps = {case: schemes for case, schemes in cases.items() if case.row == "S4"}
    left = f"\n{not_run} more of the matrix were not run for this page: their cells are empty.\n" if not_run else ""
    told = f"{jobs} at once on one machine" if jobs > 1 else "one at a time"
    commits = ", ".join(dict.fromkeys(run["commit"] for run in results.values()))
    return f"""# The stability matrix

`python benchmarks/stability.py --docs docs` wrote this page: {len(results)} runs of stiff and extreme scenes under every
transfer, spline and precision. {tally[SURVIVES]} survive (S), {tally[STOPPED]} stop or are refused with a clear message (E),
{tally[FAILED]} fail (F). A ✘ marks what is not what its row expects; nothing that fails is left out.
{left}
{machine.processor()}; {machine.versions()}; found at {commits}, up to {date.today().isoformat()}. Runs {told}, with what it
takes to judge them; times are those of a machine that may have had other work.

![The matrix in colours](../pictures/stability.png)

- S: no nan or infinity in any state, J > 0 where the law needs it, total energy never more than 1.05 of that at the start and
  the work of loads, all particles inside the domain to half a cell, every mass exact, and the numbers of the row within their
  limits. Judged by the arrays, every five steps or more, whatever pmpm's own guards say.
- E: a stop whose message names step, time, rank, particle, position, material and cause, or input refused before anything
  runs. The failed state and the checkpoints that go with it have [tests of their own](../reliability.md).
- F: anything else: energy from nowhere, garbage without a word, a hang, a traceback, a missed limit.

{verdict}

Columns: transfer and degree of the spline. flip and aflip blend 0.99. A number behind a letter: of so many variants. Linear
splines may stop anywhere: their stable step goes to zero at a free surface ([why](conservation.md)).

## float64

{grid(cases, DOUBLE, cell)}

## float32

{grid(cases, SINGLE, cell)}

## Cases under a few schemes

{few(cases)}

## First step that does not survive

As a ratio of the stable step dx / (c sqrt(d)): all below survive. F: what ends in garbage without a word.

float64:

{grid(sweeps, DOUBLE, first_failing)}

float32:

{grid(sweeps, SINGLE, first_failing)}

## Not as expected

{not_as_expected(cases)}

## Highest energy

Over that at the start and the work of loads, of the runs that were not stopped.

{grid(cases, DOUBLE, energy_of)}

{grid(cases, SINGLE, energy_of)}

## Smallest step, s

{grid(cases, DOUBLE, step_of)}

{grid(cases, SINGLE, step_of)}

## Wall time of all variants, s

Kernels that had to be compiled included.

{grid(cases, DOUBLE, wall_of)}

{grid(cases, SINGLE, wall_of)}

## The rows

{sections(cases)}

{NOT_RUN}"""


def draw(path, results):
    cases = by_case(results)
    columns = [*DOUBLE, *SINGLE]
    figure, axes = pyplot.subplots(figsize=(15, 0.34 * len(cases) + 1.6), layout="constrained")
    colours = [COLOURS[letter] for letter in (None, SURVIVES, STOPPED, FAILED)]
    numbers = {None: 0, SURVIVES: 1, STOPPED: 2, FAILED: 3}
    values = np.zeros((len(cases), len(columns)))
    for i, schemes in enumerate(cases.values()):
        for j, scheme in enumerate(columns):
            if scheme in schemes:
                runs = schemes[scheme]
                values[i, j] = numbers[worst([run["verdict"] for run in runs.values()])]
                mark = "bold" if unexpected(runs) else "normal"
                axes.text(j, i, counts(runs), ha="center", va="center", fontsize=6, weight=mark)
    axes.imshow(values, cmap=matplotlib.colors.ListedColormap(colours), vmin=-0.5, vmax=3.5, aspect="auto")
    axes.set_xticks(range(len(columns)), [short(s) for s in columns], rotation=90, fontsize=7)
    axes.set_yticks(range(len(cases)), [f"{case.row} {case.name}" for case in cases], fontsize=7)
    axes.set_xticks(np.arange(len(columns) + 1) - 0.5, minor=True)
    axes.set_yticks(np.arange(len(cases) + 1) - 0.5, minor=True)
    axes.grid(which="minor", color="white", lw=1.0)
    axes.tick_params(which="both", length=0)
    axes.axvline(len(DOUBLE) - 0.5, color="black", lw=1.0)
    axes.set_title(
        "float64 left, float32 right. Green: survives; yellow: some stop with a message; red: some fail; bold: not as expected",
        fontsize=8,
    )
    figure.savefig(path, dpi=130)


def write(docs, results, not_run, jobs, missed):
    which = "with APIC and MLS, quadratic and cubic splines, float64"
    lines = "\n".join(f"- {line}" for line in missed)
    verdict = f"Not as expected {which}:\n\n{lines}" if missed else f"All is as expected {which}."
    (docs / "pictures").mkdir(parents=True, exist_ok=True)
    (docs / "results").mkdir(parents=True, exist_ok=True)
    draw(docs / "pictures" / "stability.png", results)
    pages.write(docs, "stability", page(results, not_run, jobs, verdict))


if __name__ == "__main__":
    sys.exit("run benchmarks/stability.py")
