"""By hand: twenty sequences of random cuts for each scene of tests/random_cuts.py give the bits of one rank, on 2 to 7 ranks.

python tests/by_hand/random_cuts_all.py [--ranks 2 3 5 7] [--sequences 20] [--cases TEXT ...]

Prints a row for each scene and number of ranks and exits with 1 on any difference, naming seed and cuts. --cases: only scenes
whose names hold one of these texts.
"""

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

import launch  # noqa: E402
import random_cuts  # noqa: E402

from pmpm.parallel.comm import from_launcher  # noqa: E402

LIMIT = 7200
ROW = "{:50s} {:>5} {:>9} {:>6} {:>6} {:>9}  {}"


def show(*cells):
    print(ROW.format(*map(str, cells)), flush=True)


def draw(cases, sequences):
    """On all ranks: rank 0 prints a row for each scene; whether all are the same."""
    comm, same = from_launcher(), True
    for case in cases:
        expected, cuts, fewest, crossed, wrong = random_cuts.bits_of_one(case, comm), set(), comm.size, 0, []
        for seed in range(sequences):
            found, edges, sent = random_cuts.cut_at_random(case, seed, comm)
            cuts |= set(edges)
            fewest, crossed = min(fewest, *(len(set(e)) - 1 for e in edges)), crossed + sent
            if found != expected:
                wrong.append(f"seed {seed} DIFFERS: {edges}")
        if comm.rank == 0:
            show(case, comm.size, sequences, len(cuts), fewest, crossed, "; ".join(wrong) or "same")
        same = same and not wrong
    return same


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--ranks", type=int, nargs="+", default=[2, 3, 5, 7])
    parser.add_argument("--sequences", type=int, default=20)
    parser.add_argument("--cases", nargs="+", default=[""], metavar="TEXT")
    parser.add_argument("--as-rank", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.as_rank:
        cases = [case for case in random_cuts.CASES if any(text in case for text in given.cases)]
        return 0 if draw(cases, given.sequences) else 1
    show("scene", "ranks", "sequences", "cuts", "fewest", "crossings", "bits")
    same = True
    for ranks in given.ranks:
        arguments = ["--as-rank", "--sequences", given.sequences, "--cases", *given.cases]
        done = launch.python([__file__, *arguments], ranks, LIMIT)
        print("\n".join(line for line in done.text.splitlines() if not line.startswith("MPICH: ")), flush=True)
        same = same and done.status == 0
    print("all the same" if same else "NOT all the same")
    return 0 if same else 1


if __name__ == "__main__":
    sys.exit(main())
