"""By hand: fifty kills of one rank of three, each followed by a restart on one to four ranks, compared bit for bit.

python tests/by_hand/kills_all.py FOLDER [--count 50] [--first 0]

Prints one row for each and a table over the kinds, and exits with 1 on any difference. About 10 s for each on 2 cores. FOLDER
keeps those that differ.
"""

import argparse
import shutil
import sys
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

import kills  # noqa: E402


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--count", type=int, default=50)
    parser.add_argument("--first", type=int, default=0)
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    whole, same, from_the_start, all_of = kills.undisturbed(options.folder), Counter(), Counter(), Counter()
    print(f"undisturbed: {whole.counts} on {kills.RANKS} ranks", flush=True)
    for number, kill in list(enumerate(kills.kills(options.count)))[options.first :]:
        left, differences = kills.attempt(kill, whole, options.folder / f"{number:02d}")
        all_of[kill.moment] += 1
        same[kill.moment] += not differences
        from_the_start[kill.moment] += not left
        newest = f"from checkpoint {left[0]}" if left else "from the start"
        print(
            f"{number:2d} rank {kill.rank} {kill.moment:8s} at {kill.when:.2f}, again on {kill.again_on} {newest:20s}",
            end=" ",
        )
        print("the same bits" if not differences else f"DIFFERS: {differences[:3]}", flush=True)
        if not differences:
            shutil.rmtree(options.folder / f"{number:02d}")
    print("\n| moment | kills | of them before the first checkpoint | the same bits at the end |\n|---|---|---|---|")
    for moment, count in all_of.items():
        print(f"| {moment} | {count} | {from_the_start[moment]} | {same[moment]} |")
    return 0 if same == all_of else 1


if __name__ == "__main__":
    sys.exit(main())
