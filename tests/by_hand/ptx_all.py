"""By hand: every kernel of every pair of values of tests/by_hand/on_card_all.py, and of the scenes of its own, compiled to PTX.

python tests/by_hand/ptx_all.py

Needs no card. Prints a row for each scene and exits with 1 where a kernel does not compile, or computes in double precision in
a scene of float32. A quarter of an hour on one core.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

import fast_and_scalar as agreement  # noqa: E402
import on_card  # noqa: E402

from pmpm.processors.plan import kernels_of  # noqa: E402

CAPABILITY = (9, 0)


def main():
    rows = agreement.every_pair.every_pair(on_card.FACTORS, agreement.allowed)
    scenes = {agreement.label(row): row["precision"] for row in rows} | {
        "driven": "float64",
        on_card.ON_NODES: "float64",
    }
    seen, bad = set(), 0
    for label, precision in scenes.items():
        complaints, count = [], 0
        for noted in kernels_of(on_card.SCENES[label]()):
            key = noted.function.__qualname__, noted.types
            if key in seen:
                continue
            seen.add(key)
            count += 1
            try:
                if ".f64" in noted.ptx(CAPABILITY) and precision == "float32":
                    complaints.append(f"{noted.name}: double arithmetic")
            except Exception as error:
                complaints.append(f"{noted.name}: {str(error).strip().splitlines()[0]}")
        bad += bool(complaints)
        print(f"{label:60s} {count:3d} kernels {'; '.join(complaints)}", flush=True)
    print(f"{len(scenes)} scenes, {bad} bad")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
