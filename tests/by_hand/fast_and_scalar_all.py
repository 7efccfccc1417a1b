"""By hand: the fast kernels and the scalar ones agree for every combination of material, dimension and method.

python tests/by_hand/fast_and_scalar_all.py [--ranks 1 2] [--materials NAME ...]

Prints a row for each combination: how far the two are apart after 50 steps, in eps (tests/fast_and_scalar.py says of what),
then the largest of each precision; exits with 1 where a bound is exceeded. About 25 minutes the first time,
nearly all of it compilation. One process for each material, because compiled kernels stay in memory, 0.1 GB a row.
"""

import argparse
import json
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

import fast_and_scalar as agreement  # noqa: E402
import launch  # noqa: E402

from pmpm.parallel.comm import from_launcher  # noqa: E402

COLUMNS = ("x", "v", "C", "divergence", "F", "J", "hencky_strain", "elastic_strain", "v_c")
ROW = "{:66s} {:>5} {:>9} {:>8} {:>7}" + " {:>6}" * len(COLUMNS)
LIMIT = 7200


def show(*cells):
    print(ROW.format(*map(str, cells)), flush=True)


def measure(material):
    """On all ranks: a line of JSON for each combination of this material."""
    comm = from_launcher()
    for row in agreement.ALL:
        if row["material"] == material:
            began, scene = time.monotonic(), agreement.scene(row)
            fast, scalar = (agreement.run(scene, loops, comm) for loops in ("lanes", "scalar"))
            told = {"row": row, "apart": agreement.distances(fast, scalar), "regroups": fast.regroups}
            told |= {"particles": fast.report()["particles"], "seconds": time.monotonic() - began}
            if comm.rank == 0:
                print("\n" + json.dumps(told), flush=True)


def measured(material, ranks):
    """What `measure` found on so many ranks."""
    done = launch.python([__file__, "--measure", material], ranks if ranks > 1 else None, LIMIT)
    assert done.status == 0, done.text
    return [json.loads(line) for line in done.text.splitlines() if line.startswith('{"row"')]


def numbers(apart):
    return [f"{apart[name]:.0f}" if name in apart else "-" for name in COLUMNS]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--ranks", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--materials", nargs="+", default=list(agreement.MATERIALS))
    parser.add_argument("--measure", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.measure:
        return measure(given.measure)
    worst, count, outside, began = {}, 0, 0, time.monotonic()
    show("combination", "ranks", "particles", "regroups", "seconds", *(name[:6] for name in COLUMNS))
    for ranks in given.ranks:
        for material in given.materials:
            for told in measured(material, ranks):
                row, apart = told["row"], told["apart"]
                seconds = f"{told['seconds']:.1f}"
                show(agreement.label(row), ranks, told["particles"], told["regroups"], seconds, *numbers(apart))
                largest = worst.setdefault((row["precision"], ranks), {})
                largest |= {name: max(distance, largest.get(name, 0.0)) for name, distance in apart.items()}
                count += 1
                outside += not all(distance <= agreement.BOUND for distance in apart.values())
    for (precision, ranks), largest in worst.items():
        show(f"largest in {precision}", ranks, "", "", "", *numbers(largest))
    print(
        f"{count} runs, {outside} of them apart by more than {agreement.BOUND:g} eps, in {time.monotonic() - began:.0f} s"
    )
    return 1 if outside else 0


if __name__ == "__main__":
    sys.exit(main())
