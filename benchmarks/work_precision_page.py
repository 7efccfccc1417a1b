"""What benchmarks/work_precision.py prints and writes: its tables, the page, the list of all points and the pictures."""

import csv
import statistics
from dataclasses import replace
from datetime import date

import pages
import work_precision_figures
from kernels_page import markdown, number
from precision_arithmetic import order, pareto, ranks
from precision_found import CODES_OF_PEERS, LEVELS
from precision_plan import COMMON, DT_SWEEP, DT_TRANSFERS, FAST, REFERENCE, SWEPT_CELLS, Point

ABOUT = {
    "waves 2-D": "standing waves in a periodic box, neo-Hookean, nu = 0.3, A k = 0.1, one period (Wallstedt, Guilkey 2008)",
    "waves 3-D": "the same in 3-D",
    "vortex": "ring turned and sheared, neo-Hookean, A = 0.1, to t = 1 (Brannon, Kamojjala and Sadeghirad 2011)",
    "bar": "vibration of a bar, one period, strain 1e-4; nothing crosses cells (Bardenhagen 2002)",
    "column": "static column under its own weight, 7 % of settlement; the error is that at the end",
    "fluid": "the waves in Tait's fluid with gamma = 7",
    "sand": "collapse of a column of sand. No exact solution, but self-convergence: e_u is the RMS distance of where sand "
    f"lies from the same scheme's run {REFERENCE['sand']} times finer than the finest here, relative to how far it goes",
}
MANY = 50_000  # particles, from which on their arrays are most of what a run takes
COLUMNS = (
    "case", "code", "transfer", "blend", "degree", "precision", "per_direction", "cells", "cfl", "particles", "steps", "step",
    "particle_steps", "e_u", "e_end", "e_v", "e_F", "e_J", "e_stress", "energy", "median", "least", "most", "rounds", "ns",
    "rate", "held", "nodes", "peak", "built", "sorts", "stopped",
)  # fmt: skip

PAGE = """# Work and precision

`python benchmarks/work_precision.py{arguments} --docs docs` wrote this page on {today}{minutes}, at {commit}.
{processor}; one core, one thread, one rank, output off; {versions}.

How long a scheme steps until its error e_u is down to a level, beside codes that others would take for the same. e_u is the RMS
error of displacement over all particles, relative to the largest RMS displacement, at its largest over some 64 times of the
run. Seconds are those of stepping alone; compiling and start-up have [a table of their own](#start-up). A time is the median of
{rounds} runs, one in each round over all points; bars and brackets are the fastest and the slowest. Errors come from a run of
their own, so that nobody watches those that are timed.

`cfl` is the step over dx / (c sqrt(d)), c being the wave speed at rest (fluid, column and sand: the fastest now). {common:g} is
the step common to all; *best* is the faster of {common:g} and {fast:g} for the level asked (mls quadratic also tried 0.1 and
0.2). The base of all variations is mls quadratic, float64, 2 particles per cell and direction, explicit. An implicit
integrator is not built.

{cases}

Taichi and Warp solve the same problem: MLS-MPM, quadratic splines, 2 particles per cell and direction, the same particles,
steps, stress and body force, written as their users write it, at the same two steps and at sizes as far as they are fast
enough. Kratos finds the static column by Newton's method with linear quadrilaterals ("static n": in n load steps): another
integrator and another degree, comparable on the axis of time alone. There it is sooner where one load step does: explicit
steps have to follow the column on its way to rest. Statics want an implicit solver.
{agreement}

{verdict}

![Error against time, particle-steps and step](../pictures/work_precision.png)

![Error against time in the other cases](../pictures/work_precision_cases.png)

All points, with errors of velocity and deformation, energy, bytes and rates, are in [work_precision.csv](work_precision.csv).

"""
NOTES = """## Notes

- Times to an error are interpolated in logarithms between two grids. `<=`: the coarsest grid run is already below the level, so
  that a coarser one may do. `-`: not reached at the sizes run; nothing is extrapolated.
- Rank: by median; the range in brackets is what overlapping bars leave open.
- Energy: kinetic and strain energy at the end over that at the start, less one. Waves, vortex, bar and fluid come back to their
  start, where an exact run has 0. What the body force does in between is not in it.
- `held`: bytes of all particle arrays, `nodes` of the grid, `peak`: growth of resident memory since before the simulation was
  made, all per particle; the last only of runs with many particles, and blurred by what the process had free.
- Linear splines and cell crossing, PIC and short steps: [transfers](../theory.md#transfers).
- Not run: implicit (not built); GPU codes (this page is one core); the cantilever in Kratos (the column was taken);
  nairn-mpm-fea, matter, Karamelo (no packages: not built here).
"""


def tables(found, reasons):
    """All tables, as one markdown text."""
    parts = []
    if claims := found.claims():
        parts.append(("pmpm and its peers: seconds to an error", claim_table(claims, reasons)))
    parts.append(("Who is soonest", winners_table(found)))
    for case in found.cases:
        parts.append((f"{case}: seconds to an error", f"{ABOUT[case]}.\n\n{reached_table(found, case)}"))
        if text := rank_table(found, case):
            parts.append((f"{case}: ranks", text))
        parts.append((f"{case}: Pareto front", pareto_table(found, case)))
        parts.append((f"{case}: one factor at a time", factor_table(found, case)))
    parts += [("Error against the step", step_table(found)), ("Start-up", startup_table(found))]
    parts += [("Runs that stopped", stopped_text(found)), ("Peers that were not run", absent_text(found))]
    return "\n\n".join(f"## {title}\n\n{text}" for title, text in parts if text)


def seconds_text(reached):
    """A (seconds, exact, ...) as text."""
    return "-" if reached is None else ("" if reached[1] else "<= ") + number(reached[0])


def claim_table(claims, reasons):
    rows = []
    for claim in claims:
        if claim.mine is None and claim.theirs is None:
            continue
        ratio = "-" if None in (claim.mine, claim.theirs) else f"{claim.theirs / claim.mine:.2f}"
        note = "" if not claim.lost else "✘ " + reasons.get((claim.case, claim.level, claim.peer), "no reason stated")
        mine, theirs = ("-" if value is None else number(value) for value in (claim.mine, claim.theirs))
        rows.append((claim.case, f"{claim.level:g}", mine, claim.option, claim.peer, theirs, ratio, note))
    return markdown(("", "e_u", "pmpm (s)", "with", "peer", "its best (s)", "peer / pmpm", ""), rows)


def winners_table(found):
    rows = []
    for case in found.cases:
        for level in LEVELS:
            best = sorted(found.best(case, level).items(), key=lambda item: item[1][0])
            best = [(scheme, reached) for scheme, reached in best if not scheme.startswith(CODES_OF_PEERS)]
            if best:
                (first, won), *others = best
                second = f"{others[0][0]}, {others[0][1][0] / won[0]:.2f} times as long" if others else "-"
                rows.append((case, f"{level:g}", first, f"{won[2]:g}", seconds_text(won), second))
    return markdown(("", "e_u", "soonest of pmpm", "cfl", "seconds", "next"), rows)


def reached_table(found, case):
    """Schemes by levels, at the common step and at the best one."""
    common = {level: found.best(case, level, common=True) for level in LEVELS}
    best = {level: found.best(case, level) for level in LEVELS}
    series, rows, nowhere = found.series(case), [], []
    for scheme in dict.fromkeys(scheme for scheme, _ in series):
        runs = series.get((scheme, COMMON), [])
        slope = order([run.point.cells for run in runs], [run.error for run in runs])
        cells = []
        for level in LEVELS:
            steps = best[level].get(scheme)
            at_best = seconds_text(steps) + (f" ({steps[2]:g})" if steps and steps[2] else "")
            cells += [seconds_text(common[level].get(scheme)), at_best]
        if set(cells) != {"-"}:
            rows.append((scheme, "-" if slope is None else f"{slope:.2f}", *cells))
        else:
            nowhere.append(scheme)
    heads = [text for level in LEVELS for text in (f"{level:g}, cfl {COMMON:g}", f"{level:g}, best (cfl)")]
    parts = [markdown(("scheme", "order", *heads), rows)] if rows else []
    parts += [f"At none of these errors: {', '.join(nowhere)}."] if nowhere else []
    return "\n\n".join(parts)


def rank_table(found, case):
    """At the smallest level that three schemes or more reach; None without one, or without two rounds."""
    level = next((level for level in reversed(LEVELS) if len(found.best(case, level)) > 2), None)
    if level is None or found.rounds(case) < 2:
        return None
    times = {}
    for number_of_round in range(found.rounds(case)):
        for scheme, reached in found.best(case, level, number_of_round).items():
            times.setdefault(scheme, []).append(reached[0])
    rows = []
    for scheme, (place, first, last) in ranks(times).items():
        values = times[scheme]
        spread = f"{number(min(values))} .. {number(max(values))}"
        rows.append((f"{place} ({first} .. {last})", scheme, number(statistics.median(values)), spread))
    return f"To e_u = {level:g}, each at its best step.\n\n" + markdown(("rank", "scheme", "seconds", "rounds"), rows)


def pareto_table(found, case):
    timed = [run for run in found.runs.values() if run.point.case == case and run.times]
    front = pareto([(run.seconds, run.error, run) for run in timed if run.point.code == "pmpm"])
    rows = [
        (number(seconds), f"{error:.2e}", run.point.scheme, f"{run.point.cfl:g}", str(run.point.cells), number(run.ns))
        for seconds, error, run in front
    ]
    return markdown(("seconds", "e_u", "scheme", "cfl", "cells", "ns per particle-step"), rows)


def factor_table(found, case):
    """Every option at the finest grid of all schemes, beside the base."""
    runs = [run for run in found.runs.values() if run.point.case == case and run.times]
    bases = [run.point.cells for run in runs if run.point == Point(case, run.point.cells)]
    finest = max(bases, default=0)
    base = found.runs.get(Point(case, finest))
    rows = []
    for run in runs:
        if run.point.cells != finest or run.point.code != "pmpm":
            continue
        ratio = f"{run.seconds / base.seconds:.2f}" if base and base.times else "-"
        worse = f"{run.error / base.error:.2f}" if base else "-"
        spread = f"{number(run.seconds)} ({number(min(run.times))} .. {number(max(run.times))})"
        energy = run.row.get("energy")
        rows.append(
            (
                run.point.scheme, f"{run.point.cfl:g}", f"{run.error:.2e}", worse, spread, ratio, number(run.ns),
                number(1e3 / run.ns), "-" if energy is None else f"{energy:+.1e}", bytes_text(found, run),
            )
        )  # fmt: skip
    head = (
        "scheme",
        "cfl",
        "e_u",
        "of base",
        "seconds",
        "of base",
        "ns",
        "1e6 per s",
        "energy",
        "bytes: held, nodes, peak",
    )
    return f"At {finest} cells; ns and rate are of particle-steps.\n\n" + markdown(head, rows)


def bytes_text(found, run):
    return f"{run.row['held']:.0f}, {run.row['nodes']:.0f}, {number(peak_of(found, run.point))}"


def peak_of(found, point):
    """The median growth of resident memory over a point's runs; None where it is not mostly that of particles."""
    peaks = [
        row["peak"] for (key, _), row in found.rows.known.items() if key == point.key and row.get("peak") is not None
    ]
    row = found.rows.error_row(point)
    return statistics.median(peaks) if peaks and row["particles"] >= MANY else None


def step_table(found):
    """Errors at a fixed grid by step, and where it ends."""
    points = [Point("waves 2-D", SWEPT_CELLS, transfer=transfer, blend=blend) for transfer, blend in DT_TRANSFERS]
    rows = []
    for cfl in DT_SWEEP:
        cells = []
        for point in points:
            run, row = found.runs.get(replace(point, cfl=cfl)), found.rows.error_row(replace(point, cfl=cfl))
            cells.append(f"{run.error:.2e}" if run else "stopped" if row else "-")
        if set(cells) != {"-"}:
            rows.append((f"{cfl:g}", *cells))
    if not rows:
        return None
    text = f"e_u of the waves in 2-D at {SWEPT_CELLS} cells; beyond about 1 a step is refused unless it is forced, as here.\n\n"
    return text + markdown(("cfl", *(point.scheme for point in points)), rows)


def startup_table(found):
    rows = []
    for (key, _), row in found.rows.known.items():
        if key.startswith("start-up: "):
            rows.append((key.removeprefix("start-up: "), number(row["cold"]), number(row["cached"])))
    if not rows:
        return None
    about = (
        "Seconds from the start of the code until its first step is done, in a process of its own on the same core: with an\n"
        "empty cache, and again with what is there then. Add them to the seconds of stepping for the time to a first result.\n"
        "Peers compile sizes and steps in, and compile again where these change.\n\n"
    )
    return about + markdown(("", "cold", "cached"), rows)


def stopped_text(found):
    lines = []
    for point in found.wanted:
        row = found.rows.error_row(point)
        if row is not None and "stopped" in row:
            lines.append(f"- {point.key}: {row['stopped']}")
    return "\n".join(lines) or "None."


def absent_text(found):
    if found.absent is None:
        return "Peers were not asked for (`--peers`)."
    return "\n".join(f"- {name}: not installed" for name in sorted(found.absent)) or "All that were asked for ran."


# ---- files -----------------------------------------------------------------------------------------------------------------


def write(docs, found, reasons, compared, failed):
    """results/work_precision.md and .csv, pictures/work_precision.png and work_precision_cases.png in the folder `docs`."""
    for folder in ("results", "pictures"):
        (docs / folder).mkdir(parents=True, exist_ok=True)
    write_points(docs / "results" / "work_precision.csv", found)
    work_precision_figures.plot_main(found, docs / "pictures" / "work_precision.png")
    work_precision_figures.plot_cases(found, docs / "pictures" / "work_precision_cases.png")
    agreement = (
        f"In {compared} runs with the same grid and step their errors are those of pmpm up to round-off."
        if compared and not any("differs" in line for line in failed)
        else f"{compared} runs were compared with pmpm's."
    )
    lost = [claim for claim in found.claims() if claim.lost]
    verdict = "All musts hold." if not failed else "Musts that fail:\n\n" + "\n".join(f"- {line}" for line in failed)
    contested = list(dict.fromkeys(claim.case for claim in found.claims()))
    if found.claims():
        verdict += (
            f" No peer reaches any of these errors of {', '.join(contested)} sooner than pmpm."
            if not lost
            else f"\n\nA peer is sooner at {len(lost)} of {len(found.claims())} errors: marked below."
        )
    rounds = max((found.rounds(case) for case in found.cases), default=0)
    arguments = (" --quick" if found.quick else "") + (" --peers" if found.absent is not None else "")
    arguments += f" --rounds {rounds}"
    cases = "\n".join(f"- {case}: {ABOUT[case]}" for case in found.cases)
    minutes = f" in {found.minutes:.0f} minutes"
    text = PAGE.format(
        arguments=arguments, today=date.today(), minutes=minutes, rounds=rounds, common=COMMON, fast=FAST, cases=cases,
        agreement=agreement, verdict=verdict, **found.setting,
    )  # fmt: skip
    text += tables(found, reasons) + "\n\n" + NOTES
    pages.write(docs, "work_precision", text)


def write_points(path, found):
    """Every point as a line, those that stopped too."""
    with path.open("w", encoding="utf-8", newline="") as file:
        lines = csv.DictWriter(file, COLUMNS, extrasaction="ignore", lineterminator="\n")
        lines.writeheader()
        for point in found.wanted:
            row, run = found.rows.error_row(point), found.runs.get(point)
            if row is None:
                continue
            times = run.times if run else ()
            line = point.table | row | {"peak": peak_of(found, point)}
            if run:
                line |= {"particle_steps": run.particle_steps, "e_u": run.error}
            if times:
                line |= {"median": run.seconds, "least": min(times), "most": max(times), "rounds": len(times)}
                line |= {"ns": run.ns, "rate": 1e9 / run.ns}
            lines.writerow({name: short(value) for name, value in line.items()})


def short(value):
    return f"{value:.5g}" if isinstance(value, float) else value
