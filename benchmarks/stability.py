"""The stability matrix: stiff and extreme cases S1 to S20 over transfer, spline and precision; what survives and what does not.

    python benchmarks/stability.py [--quick] [--rows S1,S4] [--schemes 'apic quadratic'] [--out FOLDER] [--jobs N]
        [--page-only] [--docs docs]

Every run is one entry: S (survives), E (stopped or refused with a complete message) or F (anything else): stress/judge.py.
stress/*.py hold the cases. Children run the entries of one case and scheme, one after another, and leave a JSON
file for each in the folder of --out; what is there is not run again, so that the matrix can be stopped, resumed and run in
parts. A child that crashes or runs over its time costs the entry it was at, which fails, and is started again behind it.

--quick: two variants of each case under three schemes. --jobs: children at once; wall times are then marked as such.
--docs: write results/stability.md and pictures/stability.png there; with --page-only of what has a result, nothing being run,
and the page says how many entries were not run. Exits non-zero if an entry of APIC or MLS with quadratic
or cubic splines in float64 is not as expected.
"""

import argparse
import faulthandler
import json
import os
import subprocess
import sys
import time
import traceback
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import machine
from stages import Progress
from stress import ranks
from stress.cases import CASES
from stress.judge import Found, refused
from stress.matrix import FAILED, QUICK, Entry

from pmpm.scene.errors import SceneError

HERE = Path(__file__).resolve().parent
STARTING = 120.0  # s that a child may take besides its entries: imports, and kernels that have to be compiled


def entries(rows, quick, schemes):
    """All entries asked for, those of one case and scheme together."""
    found = []
    for case in CASES:
        columns = [s for s in case.schemes if not quick or s in QUICK or len(case.schemes) == 1]
        for scheme in columns:
            if (not rows or case.row in rows) and (
                not schemes or any(str(scheme).startswith(name) for name in schemes)
            ):
                variants = case.quick_variants() if quick else case.variants
                found += [Entry(case, scheme, variant) for variant in variants]
    return found


# ---- in a child ----------------------------------------------------------------------------------------------------------


def run_entry(entry):
    """dict of what an entry comes to."""
    began = time.perf_counter()
    try:
        found = entry.case.run(entry.scheme, entry.variant)
    except SceneError as error:
        found = refused(error)
    except Exception as error:
        found = Found(wrong=[f"{type(error).__name__}: {error}"])
        traceback.print_exc()
    return found.as_dict() | {"wall": time.perf_counter() - began}


def run_as_child(out, keys):
    """Run entries by their keys; a run that takes too long ends the process with a traceback, wherever it is."""
    commit = machine.commit()
    known = {
        entry.key: entry for case in CASES for s in case.schemes for v in case.variants for entry in [Entry(case, s, v)]
    }
    for key in keys:
        entry = known[key]
        faulthandler.dump_traceback_later(entry.case.limit + STARTING, exit=True)
        result = run_entry(entry)
        faulthandler.cancel_dump_traceback_later()
        write(result_of(entry, out), {"entry": str(entry), "expected": entry.expected, "commit": commit} | result)


def write(path, result):
    """All or nothing."""
    part = path.with_suffix(".part")
    part.write_text(json.dumps(result, default=float, indent=1), encoding="utf-8")
    part.replace(path)


# ---- children ------------------------------------------------------------------------------------------------------------


def run_group(group, out):
    """Run entries of one case and scheme in children, until each has its file; yields an entry as it is done."""
    left = [entry for entry in group if not result_of(entry, out).exists()]
    while left:
        environment = os.environ | {"OMP_NUM_THREADS": "1"} | left[0].case.environment
        command = [sys.executable, __file__, "--out", str(out), "--child", *(entry.key for entry in left)]
        limit = sum(entry.case.limit + STARTING for entry in left)
        try:
            done = subprocess.run(
                command, env=environment, capture_output=True, text=True, timeout=limit, errors="replace"
            )
            status, said = done.returncode, done.stderr
        except subprocess.TimeoutExpired:
            status, said = "none", ""
        missing = [entry for entry in left if not result_of(entry, out).exists()]
        (out / f"{group[0].key}.log").write_text(said, encoding="utf-8")
        if missing:  # the first of them is where the child ended
            late = "Timeout (" in said or status == "none"
            why = "a hang: over its time" if late else f"a crash: exit status {status}, {said.strip()[-300:]}"
            write(
                result_of(missing[0], out),
                {"entry": str(missing[0]), "expected": missing[0].expected, "commit": machine.commit()}
                | Found(wrong=[why]).as_dict() | {"wall": missing[0].case.limit if late else 0.0},
            )  # fmt: skip
        yield from (entry for entry in left if result_of(entry, out).exists())
        left = missing[1:]


def run_all(chosen, out, jobs):
    """Run what has no result yet, `jobs` children at once."""
    groups = {}
    for entry in chosen:
        groups.setdefault((entry.case.row, entry.case.name, entry.scheme), []).append(entry)
    todo = sum(not result_of(entry, out).exists() for entry in chosen)
    progress = Progress(max(todo, 1))

    def run(group):
        for entry in run_group(group, out):
            result = read(out, entry)
            progress.tell(f"{result['verdict']}{'' if as_expected(result) else ' ✘'} {entry}: {summary(result)}")

    with ThreadPoolExecutor(jobs) as pool:
        list(pool.map(run, groups.values()))


def result_of(entry, out):
    """Where its result is, once it has one."""
    return out / f"{entry.key}.json"


def read(out, entry):
    return json.loads(result_of(entry, out).read_text(encoding="utf-8"))


def as_expected(result):
    return result["verdict"] in result["expected"]


def summary(result):
    energy = "-" if result["energy"] is None else f"{result['energy']:.3g}"
    numbers = ", ".join(f"{k} {v:.3g}" if isinstance(v, float) else f"{k} {v}" for k, v in result["numbers"].items())
    why = "; ".join([*result["wrong"], result["message"][:160]]).strip("; ")
    told = f"{result['steps']} steps, {result['wall']:.1f} s, energy {energy}"
    return "; ".join(filter(None, [told, numbers, why]))


# ---- verdicts ------------------------------------------------------------------------------------------------------------


def complaints(results):
    """Entries that are not as expected where that is promised, one line each."""
    return [
        f"{entry}: {result['verdict']} instead of {result['expected']}: {summary(result)}"
        for entry, result in results.items()
        if entry.scheme.held and not as_expected(result)
    ]


def main():
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--quick", action="store_true", help="two variants of each case under three schemes")
    options.add_argument("--rows", default="", help="such as S1,S4")
    options.add_argument("--schemes", default="", help="such as 'apic quadratic,mls': what their names begin with")
    options.add_argument("--out", type=Path, default=Path("runs/stability"), help="folder of the results")
    options.add_argument("--jobs", type=int, default=1, help="children at once")
    options.add_argument("--docs", type=Path, help="write the page and its picture here")
    options.add_argument("--page-only", action="store_true", help="run nothing: judge and show what has a result")
    options.add_argument("--child", nargs="+", help=argparse.SUPPRESS)
    options.add_argument("--as-rank", nargs=2, help=argparse.SUPPRESS)
    given = options.parse_args()
    if given.as_rank:
        ranks.run_as_a_rank(*given.as_rank)
        return 0
    given.out.mkdir(parents=True, exist_ok=True)
    if given.child:
        run_as_child(given.out, given.child)
        return 0
    chosen = entries(
        given.rows.split(",") if given.rows else [], given.quick, given.schemes.split(",") if given.schemes else []
    )
    if not given.page_only:
        run_all(chosen, given.out, given.jobs)
    results = {entry: read(given.out, entry) for entry in chosen if result_of(entry, given.out).exists()}
    not_run = len(entries([], False, [])) - len(results)
    missed = complaints(results)
    print("\n".join(missed) or "All is as expected with APIC and MLS, quadratic and cubic, in float64.")
    failed = sum(result["verdict"] == FAILED for result in results.values())
    print(f"{len(results)} runs, {failed} of them F")
    if given.docs:
        import stability_page

        stability_page.write(given.docs, results, not_run, given.jobs, missed)
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
