"""By hand: every built-in scene gives the same bits on 64 ranks as on one, idle ranks and ranks without particles among them.

python tests/by_hand/many_ranks_all.py FOLDER [--ranks 64] [--scenes NAME ...]

Prints one row for each scene and exits with 1 on any difference. Any number of cores will do; 64 ranks take 12 GB, and a few
minutes on 2 cores, most of them to start. FOLDER takes 0.5 GB and keeps the runs that differ.
"""

import argparse
import shutil
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

import bits  # noqa: E402
import many_ranks  # noqa: E402

from pmpm.scene.files import builtin_scenes  # noqa: E402

LIMIT = 3600
ROW = "{:20s} {:>5} {:>16} {:>6} {:>9} {:>9} {:>8} {:>9}  {}"


def show(*cells):
    print(ROW.format(*map(str, cells)), flush=True)


def compare(name, folder, ranks):
    """Whether the runs of a scene are the same; prints its row."""
    alone, together = folder / "1" / name, folder / str(ranks) / name
    wrong, told = bits.differences(alone, together), bits.report(together)
    owners, _ = many_ranks.ranks_that_own_layers(together)
    crossed = sum(map(sum, told["sent"]))
    verdict = f"{len(wrong)} DIFFER: {wrong[0]} ..." if wrong else "same"
    if not wrong:
        shutil.rmtree(alone)
        shutil.rmtree(together)
    show(
        name,
        ranks,
        owners,
        told["steps"],
        told["particles"],
        told["regroups"],
        told["balance"]["cuts_moved"],
        crossed,
        verdict,
    )
    return not wrong


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--ranks", type=int, default=64)
    parser.add_argument("--scenes", nargs="+", default=list(builtin_scenes()))
    given = parser.parse_args()
    folder = given.folder.absolute()
    for ranks in (None, given.ranks):
        seconds = many_ranks.run_several(given.scenes, folder / str(ranks or 1), ranks, limit=LIMIT)
        print(f"{len(given.scenes)} scenes on {ranks or 1} ranks: {seconds:.0f} s", flush=True)
    show("scene", "ranks", "that own layers", "steps", "particles", "regroups", "cuts", "crossings", "bits")
    found = [compare(name, folder, given.ranks) for name in given.scenes]
    print("all the same" if all(found) else "NOT all the same")
    return 0 if all(found) else 1


if __name__ == "__main__":
    sys.exit(main())
