"""`pmpm` in which one rank raises an error of its own: raise_on_one_rank.py RANK STEP [pmpm's arguments]."""

import sys

from pmpm.cli import main
from pmpm.simulation import Simulation

rank, step = int(sys.argv.pop(1)), int(sys.argv.pop(1))
advance = Simulation.advance


def failing(self, dt):
    if self.comm.rank == rank and self.step_count == step:
        raise RuntimeError(f"no luck on rank {rank}")
    advance(self, dt)


if __name__ == "__main__":
    Simulation.advance = failing
    sys.exit(main())
