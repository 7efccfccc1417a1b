"""The verification suite: cases with known answers, each with its gates.

    python benchmarks/verification.py [--case V1,V2] [--size tiny|standard|sweep] [--quick] [--results FOLDER] [--docs docs]
    mpirun -n 2 python benchmarks/verification.py --case V1

Runs the cases named (all if none is), prints a line per row as it is known and leaves a file per case in the folder of its
size under --results. With --docs it then writes results/verification.md and its pictures there from all files of that size,
whenever they were made; --page-only writes the page and runs nothing. --quick is --size tiny. Exits non-zero if a gate is
missed.
"""

import argparse
import datetime
import json
import sys
import time
from dataclasses import asdict
from pathlib import Path

import machine
import verification_page
from cases import (
    SIZES,
    Check,
    Plot,
    Table,
    bar,
    blocks,
    cantilever,
    column,
    dam_break,
    incline,
    mms,
    pile,
    ranks,
    rigid,
    shock,
    vortex,
)  # fmt: skip

from pmpm.failure import NumericalFailure
from pmpm.parallel.comm import from_launcher

ORDER = (mms, vortex, bar, column, shock, rigid, incline, cantilever, dam_break, blocks, pile, ranks)  # of the page
CASES = tuple(family.CASE for family in ORDER)
KINDS = {"check": Check, "table": Table, "plot": Plot}


def run(case, size, comm, say):
    """What a case finds, in the order in which it does; a run that stops is a gate missed."""
    found = []
    try:
        for row in case.verify(size, comm):
            found.append(row)
            say(row)
    except NumericalFailure as failure:
        found.append(Check(f"comes to its end: {failure}", 0.0, 1.0, None, "a run must not stop"))
        say(found[-1])
    return found


def as_table(case, size, ranks, seconds, found):
    """What is kept of a case: plain values for JSON."""
    names = {kind: name for name, kind in KINDS.items()}
    return {
        "name": case.name,
        "size": size,
        "ranks": ranks,
        "seconds": round(seconds, 1),
        "commit": machine.commit(),
        "machine": machine.processor(),
        "versions": machine.versions(),
        "date": datetime.date.today().isoformat(),
        "results": [{"kind": names[type(row)], **asdict(row)} for row in found],
    }


def read(folder):
    """{name: kept table with its rows made again} of the cases that have been run."""
    kept = {}
    for path in sorted(folder.glob("*.json")):
        table = json.loads(path.read_text(encoding="utf-8"))
        rows = [(KINDS[row.pop("kind")], row) for row in table["results"]]
        kept[table["name"]] = table | {"results": [kind(**row) for kind, row in rows]}
    return kept


def parse():
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    names = [case.name for case in CASES]
    options.add_argument("--case", default=",".join(names), help=f"of {', '.join(names)}")
    options.add_argument("--size", choices=SIZES, default="standard")
    options.add_argument("--quick", action="store_const", dest="size", const="tiny", help="the same as --size tiny")
    options.add_argument("--results", type=Path, default=Path("runs/verification"), help="folder of what was found")
    options.add_argument("--docs", type=Path, help="write the page here")
    options.add_argument("--page-only", action="store_true", help="run nothing")
    given = options.parse_args()
    given.case = given.case.split(",")
    unknown = sorted(set(given.case) - set(names))
    if unknown:
        options.error(f"--case {','.join(unknown)}: known are {', '.join(names)}")
    return given


def main():
    given, comm = parse(), from_launcher()
    folder, missed = given.results / given.size, []
    for case in () if given.page_only else [case for case in CASES if case.name in given.case]:
        began = time.perf_counter()

        def say(row, case=case, began=began):
            if comm.rank == 0:
                print(f"[{time.perf_counter() - began:.0f} s] {case.name} {verification_page.line(row)}", flush=True)

        found = run(case, given.size, comm, say)
        missed += [f"{case.name}: {row.what}" for row in found if isinstance(row, Check) and not row.met]
        if comm.rank == 0:
            folder.mkdir(parents=True, exist_ok=True)
            kept = as_table(case, given.size, comm.size, time.perf_counter() - began, found)
            (folder / f"{case.name}.json").write_text(json.dumps(kept, indent=1), encoding="utf-8")
    if comm.rank == 0:
        print("\n".join(f"MISSED: {line}" for line in missed) or "all gates are met")
        if given.docs:
            verification_page.write(given.docs, CASES, read(folder), given.size)
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
