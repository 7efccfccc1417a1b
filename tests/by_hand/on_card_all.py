"""By hand: every pair of values of material (all laws), dimension, spline, transfer, precision, F-bar and number of ranks on
simulated cards.

python tests/by_hand/on_card_all.py FOLDER [--at-once 2]

Prints a row for each scene, the largest distance from the processor in eps (see tests/fast_and_scalar.py), and exits with 1
where it is beyond the bound or a run fails. Each scene compiles kernels of its own: an hour and more on two cores.
"""

import argparse
import json
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

import fast_and_scalar as agreement  # noqa: E402
import launch  # noqa: E402
import on_card  # noqa: E402

LIMIT = 7200
RANKS = 1, 2


def one(folder, row):
    """(text about a row of factors, whether it is good)."""
    ranks = row["ranks"]
    label = agreement.label({factor: value for factor, value in row.items() if factor != "ranks"})
    own = folder / f"{label} on {ranks}".replace(" ", "_").replace(",", "")
    own.mkdir(parents=True, exist_ok=True)
    program = [*(["-m", "mpi4py"] if ranks > 1 else []), launch.ROOT / "tests" / "on_card.py", own, label]
    done = launch.python(program, ranks if ranks > 1 else None, LIMIT, own, NUMBA_ENABLE_CUDASIM="1")
    found = [json.loads(line) for line in done.text.splitlines() if line.startswith("{")]
    if done.status or not found:
        return f"{label:60s} {ranks} failed: {done.text.strip().splitlines()[-1:]}", False
    far = max(distance for apart in found[0]["apart"].values() for distance in apart.values())
    return (
        f"{label:60s} {ranks} {far:8.1f} eps, {found[0]['sent']} particles crossed cuts",
        far <= agreement.BOUND and found[0]["alike"],
    )


def main():
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("folder", type=Path)
    options.add_argument("--at-once", type=int, default=1, help="scenes that run at a time")
    given = options.parse_args()
    rows = agreement.every_pair.every_pair(on_card.FACTORS | {"ranks": RANKS}, agreement.allowed)
    bad = 0
    with ThreadPoolExecutor(given.at_once) as pool:
        for text, good in pool.map(lambda row: one(given.folder, row), rows):
            print(text, flush=True)
            bad += not good
    print(f"{len(rows)} scenes, {bad} bad")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
