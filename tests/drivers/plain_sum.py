"""`pmpm` with a plain sum at the cuts: each rank sums its own layers, then the two sums are added.

The same on both sides, and as exact as the ordered sum, but the bits depend on where the cuts are.
"""

import sys

import numpy as np

from pmpm.cli import main
from pmpm.parallel.halo import Halo


def finish(self, handle):
    self.comm.finish(handle)
    nodes, boxes = self.patch.nodes, self.patch.boxes
    for incoming, planes in self.as_earlier:
        self.add_partial_sums(incoming, planes)
    for incoming, low, own, planes in self.as_later:
        self.kernels.take_planes(nodes, boxes, low, incoming.boxes, incoming.reals)
        self.add_partial_sums(own, planes)


def add_partial_sums(self, message, planes):
    """Sum the layers after the cut, then add that."""
    nodes, boxes = self.patch.nodes, self.patch.boxes
    sums = np.zeros_like(nodes)
    self.kernels.add_planes(sums, boxes, planes, message.boxes, message.reals)
    nodes += sums


if __name__ == "__main__":
    Halo.finish, Halo.add_partial_sums = finish, add_partial_sums
    sys.exit(main())
