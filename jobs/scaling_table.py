#!/usr/bin/env python3
"""Print a table of runs on different numbers of ranks, as Markdown: python jobs/scaling_table.py RUN [RUN ...]

Reads run.json of each run folder and needs nothing but Python. Seconds are those of the steps alone, of the slowest rank,
since the last restart: no reading, no compiling, no output. The efficiency of a run is its particle-steps per second and
rank over those of the first row: with one scene of one size that is strong scaling, with a size that grows with the ranks weak.
"""

import json
import sys
from pathlib import Path

COLUMNS = (
    "run",
    "ranks",
    "hosts",
    "particles",
    "steps",
    "seconds",
    "million particle-steps/s",
    "efficiency",
    "in the halo",
)


def read(folder):
    """What a table needs of the run in a folder. Raises ValueError, with what to say, if it does not hold it."""
    path = Path(folder) / "run.json"
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ValueError(f"{path} cannot be read: {error}") from None
    report = record.get("report") or {}
    if not report.get("stretch", {}).get("steps"):
        raise ValueError(f"{path}: the run is {record.get('status', 'unknown')} and tells of no steps")
    stretch = report["stretch"]
    halo = report["seconds_per_phase"].get("halo", {}).get("mean", 0.0)
    return {
        "run": Path(folder).name,
        "ranks": report["ranks"],
        "hosts": len(record["hosts"]),
        "particles": report["particles"],
        "steps": stretch["steps"],
        "seconds": stretch["seconds"],
        "rate": report["particles"] * stretch["steps"] / stretch["seconds"],
        "halo": halo / stretch["seconds"],
    }


def table(runs):
    """Lines of the table over runs, as `read` gives them, by number of ranks."""
    runs = sorted(runs, key=lambda run: run["ranks"])
    reference = runs[0]["rate"] / runs[0]["ranks"]
    lines = [COLUMNS, ["---"] * len(COLUMNS)]
    for run in runs:
        efficiency = run["rate"] / run["ranks"] / reference
        lines.append(
            [run["run"], run["ranks"], run["hosts"], run["particles"], run["steps"], f"{run['seconds']:.4g}",
             f"{run['rate'] / 1e6:.4g}", f"{efficiency:.1%}", f"{run['halo']:.1%}"]
        )  # fmt: skip
    return ["| " + " | ".join(map(str, line)) + " |" for line in lines]


def main(folders):
    if not folders or folders[0].startswith("-"):
        print(__doc__.strip())
        return 0 if folders else 2
    try:
        print("\n".join(table([read(folder) for folder in folders])))
    except ValueError as error:
        print(f"scaling_table: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
