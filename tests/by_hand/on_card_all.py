"""By hand: every pair of values of material (all laws), dimension, spline, transfer, precision and F-bar on a simulated card.

python tests/by_hand/on_card_all.py FOLDER [--ranks 2]

Prints a row for each scene, the largest distance from the processor in eps (see tests/fast_and_scalar.py), and exits with 1
where it is beyond the bound or a run fails. Each scene compiles kernels of its own: half an hour on two cores.
"""

import argparse
import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

import fast_and_scalar as agreement  # noqa: E402
import launch  # noqa: E402
import on_card  # noqa: E402

LIMIT = 7200


def main():
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("folder", type=Path)
    options.add_argument("--ranks", type=int, default=1)
    given = options.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    labels = [agreement.label(row) for row in agreement.every_pair.every_pair(on_card.FACTORS, agreement.allowed)]
    program = [*(["-m", "mpi4py"] if given.ranks > 1 else []), launch.ROOT / "tests" / "on_card.py", given.folder]
    bad = 0
    for label in labels:
        ranks = given.ranks if given.ranks > 1 else None
        done = launch.python([*program, label], ranks, LIMIT, given.folder, NUMBA_ENABLE_CUDASIM="1")
        found = [json.loads(line) for line in done.text.splitlines() if line.startswith("{")]
        if done.status or not found:
            bad += 1
            print(f"{label:60s} failed: {done.text.strip().splitlines()[-1:]}", flush=True)
            continue
        far = max(distance for apart in found[0]["apart"].values() for distance in apart.values())
        bad += not far <= agreement.BOUND
        print(f"{label:60s} {far:8.1f} eps, {found[0]['sent']} particles crossed cuts", flush=True)
    print(f"{len(labels)} scenes, {bad} bad")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
