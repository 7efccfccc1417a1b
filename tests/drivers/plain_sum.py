"""`pmpm` with a plain sum at the cuts: each rank sums its own layers, then the two sums are added.

The same on both sides, and as exact as the ordered sum, but the bits depend on where the cuts are.
"""

import sys

from pmpm.cli import main
from pmpm.parallel.halo import Halo


def finish(self):
    for _, _, message, planes, _ in self.as_earlier:
        add_partial_sums(self.patch.nodes[0], self.add, message, planes)
    for _, _, message, planes, pairs in self.as_later:
        self.add(message, planes)
        add_partial_sums(self.patch.nodes[0], self.patch.add_apart, self.kernels, pairs)


def add_partial_sums(nodes, add, *arguments):
    """Sum the layers after the cut, then add that."""
    sums = nodes.copy()
    nodes[:] = 0.0
    add(*arguments)
    nodes += sums


if __name__ == "__main__":
    Halo.finish = finish
    sys.exit(main())
