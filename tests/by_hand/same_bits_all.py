"""By hand: every built-in scene in both precisions gives the same bits on 1, 2, 3, 4 and 7 ranks, run to its end.

python tests/by_hand/same_bits_all.py FOLDER [--ranks 2 3 4 7] [--scenes NAME ...] [--precisions float32 float64]

Prints one row for each run and exits with 1 on any difference. 2-D scenes run complete, 3-D ones to a share of their end; the
collapse in 3-D is given a push, for else nothing crosses the plane of its symmetry, where the cut of two ranks lies.
About half an hour on 2 cores; FOLDER takes about 1 GB and keeps the runs that differ.
"""

import argparse
import shutil
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

import bits  # noqa: E402

from pmpm.scene.files import builtin_scenes  # noqa: E402
from pmpm.scene.schema import Scene  # noqa: E402

SHARE = {"column_collapse_3d": 0.1, "dam_break_3d": 0.6, "mixed_materials": 0.3}
PUSH = {"column_collapse_3d": {"bodies.0.velocity": [0.5, 0.0, 0.0]}}
LIMIT = 3600
ROW = "{:20s} {:9s} {:>5} {:>8} {:>10} {:>9} {:>9} {:>8}  {:22s} {}"


def run(name, precision, ranks, out):
    options = ["--quiet", "--precision", precision]
    if name in SHARE:
        options += ["--until", SHARE[name] * Scene.builtin(name).time.end]
    return bits.run(name, out, ranks if ranks > 1 else None, PUSH.get(name, {}), options, limit=LIMIT)


def show(*cells):
    print(ROW.format(*map(str, cells)), flush=True)


def compare(name, precision, rank_counts, folder):
    """Whether all rank counts give the bits of one rank; prints a row for each."""
    alone, same = folder / f"{name}_{precision}_1", True
    for ranks in (1, *rank_counts):
        out = folder / f"{name}_{precision}_{ranks}"
        seconds = run(name, precision, ranks, out).seconds
        wrong = bits.differences(alone, out)
        told = bits.report(out)
        files = len(list((out / "snapshots").iterdir()))
        verdict = f"{len(wrong)} DIFFER: {wrong[0]} ..." if wrong else "same" if ranks > 1 else ""
        crossings = bits.crossings(out)
        if crossings and not any(crossings):
            verdict += ", but nothing crossed a cut"
        crossed = " ".join(map(str, crossings))
        counts = (told["steps"], told["particles"], files, bits.datasets(out))
        show(name, precision, ranks, *counts, f"{seconds:.1f}", crossed, verdict)
        same = same and not wrong
        if ranks > 1 and not wrong:
            shutil.rmtree(out)
    if same:
        shutil.rmtree(alone)
    return same


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--ranks", type=int, nargs="+", default=[2, 3, 4, 7])
    parser.add_argument("--scenes", nargs="+", default=list(builtin_scenes()))
    parser.add_argument("--precisions", nargs="+", default=["float32", "float64"])
    given = parser.parse_args()
    folder = given.folder.absolute()
    show("scene", "precision", "ranks", "steps", "particles", "snapshots", "datasets", "seconds", "crossings", "bits")
    found = [compare(name, precision, given.ranks, folder) for name in given.scenes for precision in given.precisions]
    print("all the same" if all(found) else "NOT all the same")
    return 0 if all(found) else 1


if __name__ == "__main__":
    sys.exit(main())
