"""`pmpm` in which one rank sends itself a signal before a step: signal_one_rank.py RANK SIGNAL STEP [pmpm's arguments]."""

import os
import sys

from pmpm.cli import main
from pmpm.simulation import Simulation

rank, number, step = (int(sys.argv.pop(1)) for _ in range(3))
advance = Simulation.advance


def signalled(self, dt):
    if self.comm.rank == rank and self.step_count == step:
        os.kill(os.getpid(), number)
    advance(self, dt)


if __name__ == "__main__":
    Simulation.advance = signalled
    sys.exit(main())
