"""`pmpm` that says how much memory each rank holds after its 1000th step and at its end: watch_memory.py [pmpm's arguments]."""

import sys
from pathlib import Path

from pmpm import cli
from pmpm.simulation import Simulation

AFTER = 1000
steps = 0
take_step = Simulation.step


def resident():
    """Bytes of this process in memory."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096


def counted(self):
    global steps, held
    take_step(self)
    steps += 1
    if steps == AFTER:
        held = resident()


if __name__ == "__main__":
    Simulation.step = counted
    status = cli.main()
    if steps >= AFTER:
        end = resident()
        print(
            f"memory {held / 1e6:.1f} MB after {AFTER} steps, {end / 1e6:.1f} MB after {steps}: {end / held - 1:+.2%}"
        )
    sys.exit(status)
