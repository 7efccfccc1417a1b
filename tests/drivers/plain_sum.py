"""`pmpm` with a plain sum at the cuts: each rank sums its own layers, then the two sums are added.

The same on both sides, and as exact as the ordered sum, but the bits depend on where the cuts are.
"""

import sys

from pmpm.cli import main
from pmpm.parallel.halo import Halo


def finish(self, handle):
    self.comm.finish(handle)
    for incoming, planes in self.as_earlier:
        for plane, partial in partial_sums(incoming, planes).items():
            self.nodes[plane] += partial
    for sums, shared, first_slot, planes in self.as_later:
        self.nodes[shared] = sums
        own = self.unsummed[first_slot : first_slot + len(planes)]
        for plane, partial in partial_sums(own, planes).items():
            self.nodes[plane] += partial


def partial_sums(unsummed, planes):
    """{plane: sum of the layers after the cut}."""
    sums = {}
    for values, plane in zip(unsummed, planes, strict=True):
        sums[plane] = sums.get(plane, 0) + values
    return sums


if __name__ == "__main__":
    Halo.finish = finish
    sys.exit(main())
