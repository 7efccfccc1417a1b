"""By hand: 1e5 steps with checkpoints, and the same with ten restarts on varying rank counts, compared bit for bit.

python tests/by_hand/long_run.py FOLDER [--steps 100000]

The dam break on coarse cells, long after the water has come to rest. Prints the memory of each rank and exits with 1 on any
difference, or if a rank of the run without restarts holds 2 % more at its end than after 1000 steps. Minutes on 2 cores.
"""

import argparse
import re
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

import bits  # noqa: E402

DRIVER = Path(__file__).parent.parent / "drivers" / "watch_memory.py"
RANKS = (2, 1, 3, 4, 2, 3, 1, 4, 2, 3, 1)
SETTINGS = {
    "domain.cell_size": 0.0028575,
    "time.end": 1000.0,
    "output.snapshot_interval": 0.5,
    "output.diagnostics_interval": 0.05,
    "output.checkpoint_interval": 0.02,
}
MOST = 0.02


def leg(out, ranks, steps, restarts):
    options = ["--quiet", "--steps", steps, *(["--restart", out] if restarts else [])]
    done = bits.run("dam_break", out, ranks, SETTINGS, options, limit=7200, program=[DRIVER])
    told = re.findall(r"memory .*", done.text)
    print(f"{ranks} ranks, {steps} steps, {done.seconds:.0f} s: {'; '.join(told)}", flush=True)
    return [float(growth) / 100 for growth in re.findall(r"([+-][0-9.]+)%", done.text)]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--steps", type=int, default=100_000)
    options = parser.parse_args()
    growth = leg(options.folder / "whole", 2, options.steps, False)
    parts = [options.steps * k // len(RANKS) for k in range(len(RANKS) + 1)]
    for number, ranks in enumerate(RANKS):
        leg(options.folder / "parts", ranks, parts[number + 1] - parts[number], number > 0)
    found = bits.differences(options.folder / "whole", options.folder / "parts")
    written = bits.report(options.folder / "whole")
    print(
        f"{written['steps']} steps to t = {written['time']:.3f} s, {len(RANKS) - 1} restarts:", found or "the same bits"
    )
    return 1 if found or max(growth) > MOST else 0


if __name__ == "__main__":
    sys.exit(main())
