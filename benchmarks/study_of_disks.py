"""An example of `pmpm study`: colliding elastic disks in four transfers at four levels, as a page with table and picture.

    python benchmarks/study_of_disks.py [--out runs/study_of_disks] [--quick] [--docs docs]

Goes on in its folder where it was interrupted. Prints the table; with --docs it writes results/study_of_disks.md and
pictures/study_of_disks.png there. --quick: two levels, one run of each. Exits non-zero if a run fails, or if a scheme that
conserves angular momentum does not converge: with one contact it must, if with order 1, for bodies feel each other as soon as
they share nodes, at a distance that shrinks with the cells.
"""

import argparse
import shutil
import sys
from pathlib import Path

import pages

import pmpm
from pmpm.studies import report

TRANSFERS = ("apic", "mls", "flip", "pic")
CONSERVING = ("apic", "mls")
LEVELS, REPEAT = 4, 3
PICTURE = "study_of_disks.png"
COMMAND = f"pmpm study colliding_disks --levels {LEVELS} --transfer {','.join(TRANSFERS)} --repeat {REPEAT}"


def complaints(study, quick):
    """What is not as it must be, one line each."""
    found = [
        f"{row['scheme']}, level {row['level']}: {row['cause']}" for row in study.rows if row["status"] == "failed"
    ]
    if not quick:
        found += [
            f"{scheme.label}: {scheme.estimate.verdict}"
            for scheme in study.schemes
            if scheme.label in CONSERVING and scheme.estimate.order is None
        ]
    return found


def write(study, docs):
    """Write page and picture."""
    title, rest = report.page(study, f"../pictures/{PICTURE}").split("\n", 1)
    text = f"{title}\n\n`python benchmarks/study_of_disks.py --docs docs` wrote this page; it is `{COMMAND}`.\n{rest}"
    pages.write(docs, "study_of_disks", text)
    shutil.copyfile(study.path / "study.png", docs / "pictures" / PICTURE)


def main():
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--out", type=Path, default=Path("runs/study_of_disks"), help="folder of the study")
    options.add_argument("--quick", action="store_true", help="two levels, one run of each; writes no page")
    options.add_argument("--docs", type=Path, help="write page and picture here")
    given = options.parse_args()
    if given.docs and given.quick:
        options.error("--docs wants a full study, not --quick")
    levels, repeat = (2, 1) if given.quick else (LEVELS, REPEAT)
    scene = pmpm.Scene.builtin("colliding_disks")
    study = pmpm.study(scene, given.out, levels=levels, repeat=repeat, transfer=TRANSFERS)
    print(study.text)
    found = complaints(study, given.quick)
    print("\n".join(f"FAILED: {line}" for line in found) or "all gates hold")
    if given.docs:
        write(study, given.docs)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
