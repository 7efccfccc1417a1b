"""Tables, CSV and picture of runs on different numbers of ranks, for benchmarks/scaling.py."""

import csv
import statistics
from dataclasses import dataclass

from scaling_runs import KINDS, Run

COLUMNS = (
    "run", "ranks", "hosts", "particles", "steps", "seconds", "million particle-steps/s", "efficiency",
    "of one round: min / median / max", "million per core", *KINDS, "rest", "imbalance", "messages per step", "of theory",
    "MB per step", "of dense planes",
)  # fmt: skip
NOTES = """\
- Seconds are those of the steps alone, of the slowest rank: no reading, no compiling, no output. Figures are medians over
  rounds.
- Efficiency: particle-steps per second and core, over those of the best run on the fewest ranks; then the same over that run of
  the same round. With one scene of one size that is strong scaling, with a size that grows with the ranks weak.
- Shares are means over ranks. `communication` is the halo (packing, sending, adding; also waiting, where run.json does not
  tell it apart), `waiting` what ranks wait for messages, `rest` the choice of the step and what lies between phases.
- Imbalance: work of the busiest rank over the mean, as counted when cuts were last looked at.
- Messages and MB: of the halo, of all ranks, beside what they are when every node of the shared planes is occupied.
"""


@dataclass(frozen=True)
class Row:
    """Runs of one kind, one of each round, or what went wrong with them."""

    name: str
    runs: list[Run]
    failure: str = ""

    def median(self, what):
        return statistics.median(what(run) for run in self.runs)


def reference(rows):
    """The Row of the fewest ranks that has runs; None where none has."""
    return min((row for row in rows if row.runs), key=lambda row: row.runs[0].ranks, default=None)


def cells(row, first):
    """A row of the table; `first`: the Row it is compared with."""
    if row.failure:
        return [row.name, row.failure, *[""] * (len(COLUMNS) - 2)]
    run, best = row.runs[0], max(one.rate_per_core for one in first.runs)
    seconds, rate = row.median(lambda one: one.seconds), row.median(lambda one: one.rate)
    by_round = [one.rate_per_core / other.rate_per_core for one, other in zip(row.runs, first.runs, strict=False)]
    spread = " / ".join(f"{value:.3f}" for value in (min(by_round), statistics.median(by_round), max(by_round)))
    shares = [row.median(lambda one, kind=kind: one.shares[kind]) for kind in KINDS]
    return [
        row.name, run.ranks, run.hosts, run.particles, run.steps, f"{seconds:.4g}", f"{rate / 1e6:.4g}",
        f"{efficiency(row, best):.1%}", spread, f"{row.median(lambda one: one.rate_per_core) / 1e6:.4g}",
        *(f"{share:.1%}" for share in shares), f"{max(0.0, 1.0 - sum(shares)):.1%}", f"{run.imbalance:.3f}",
        *sent_cells(run),
    ]  # fmt: skip


def efficiency(row, best):
    return row.median(lambda one: one.rate_per_core) / best


def sent_cells(run):
    """Messages and MB per step of all ranks, measured and expected."""
    (messages, size), (expected, most) = run.halo or (None, None), run.theory or (None, None)
    return [
        "-" if messages is None else f"{messages:.4g}", "-" if expected is None else f"{expected}",
        "-" if size is None else f"{size / 1e6:.4g}", "-" if most is None else f"{most / 1e6:.4g}",
    ]  # fmt: skip


def table(rows):
    """Markdown lines over rows, by number of ranks."""
    first = reference(rows)
    ordered = sorted(rows, key=lambda row: row.runs[0].ranks if row.runs else 0)
    lines = [COLUMNS, ["---"] * len(COLUMNS), *(cells(row, first) for row in ordered)]
    return ["| " + " | ".join(map(str, line)) + " |" for line in lines]


def write_csv(rows, path):
    """One line for each run, of every round."""
    names = ("run", "round", "ranks", "threads", "hosts", "particles", "steps", "seconds", "rate", "imbalance", *KINDS)
    with open(path, "w", newline="", encoding="utf-8") as file:
        out = csv.writer(file)
        out.writerow((*names, "messages", "bytes", "messages_of_theory", "bytes_of_dense_planes"))
        for row in rows:
            for number, run in enumerate(row.runs):
                counts = [*(run.halo or ("", "")), *(run.theory or ("", ""))]
                facts = [
                    run.ranks,
                    run.threads,
                    run.hosts,
                    run.particles,
                    run.steps,
                    run.seconds,
                    run.rate,
                    run.imbalance,
                ]
                out.writerow([row.name, number, *facts, *(run.shares[kind] for kind in KINDS), *counts])


def plot(rows, path, title):
    """Speed and efficiency against cores as a PNG file; returns what to say where that cannot be."""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        return "no picture: matplotlib is not installed: pip install 'pmpm[viz]'"
    known = sorted((row for row in rows if row.runs), key=lambda row: row.runs[0].ranks)
    best = max(run.rate_per_core for run in reference(rows).runs)
    used = [row.runs[0].ranks * row.runs[0].threads for row in known]
    figure = Figure(figsize=(8.0, 3.4), dpi=150, layout="constrained")
    speed, share = figure.subplots(1, 2)
    for row, count in zip(known, used, strict=True):
        speed.plot([count] * len(row.runs), [run.rate / 1e6 for run in row.runs], ".", color="tab:grey", ms=4)
    speed.plot(
        used, [row.median(lambda one: one.rate) / 1e6 for row in known], "o-", color="tab:blue", label="measured"
    )
    speed.plot(used, [best * count / 1e6 for count in used], "k--", lw=0.8, label="ideal")
    speed.set(xscale="log", yscale="log", xlabel="cores", ylabel="million particle-steps per second")
    speed.legend(frameon=False, fontsize=8)
    bottom = [0.0] * len(known)
    for kind in KINDS:
        heights = [row.median(lambda one, kind=kind: one.shares[kind]) for row in known]
        share.bar(range(len(known)), heights, 0.6, bottom, label=kind)
        bottom = [low + height for low, height in zip(bottom, heights, strict=True)]
    share.plot(range(len(known)), [efficiency(row, best) for row in known], "ko-", ms=4, label="efficiency")
    share.set_xticks(range(len(known)), map(str, used))
    share.set(xlabel="cores", ylabel="share of the step", ylim=(0.0, 1.15))
    share.legend(frameon=False, fontsize=7, ncols=3, loc="upper center")
    figure.suptitle(title, fontsize=9)
    figure.savefig(path, format="png")
    return None
