"""Pure arithmetic of slabs: which rank owns which layers, and which planes two ranks share at a cut.

A layer is one cell thick; its particles touch planes layer - reach_low .. layer + reach_high (padding included).

      left rank: layers .. c-2 c-1 | c c+1 c+2 .. right rank
      shared planes        c-RL .......... c-1+RH            (RL + RH of them)

At a cut the rank whose layers come first in the sum (`earlier`) sends the planes it has summed so far, the other (`later`)
sends the planes of its layers *unsummed*, and both continue the same sum: the order of additions, hence every bit, does not
depend on where the cuts are. On a periodic axis the seam is a cut as well, with the low layers earlier.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Cut:
    """A place where two ranks share planes. `earlier_first`, `later_first`: number of the first shared plane in either
    rank's own counting; `unsummed`: (layer, plane in the later rank's counting), in the order they are added."""

    earlier: int
    later: int
    earlier_first: int
    later_first: int
    planes: int
    unsummed: tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class Slabs:
    """Layers cut[r] .. cut[r+1] - 1 belong to rank r; ranks beyond the room there is own none."""

    layers: int
    periodic: bool
    reach_low: int
    reach_high: int
    edges: tuple[int, ...]

    def __post_init__(self):
        widths = np.diff(self.edges)
        alone = self.active == 1 and not self.periodic  # nothing is shared
        window = 1 if alone else self.reach_low + self.reach_high + 1
        if (
            self.edges[0] != 0
            or self.edges[-1] != self.layers
            or any(0 < w < window for w in widths)
            or min(widths) < 0
            or any(widths[self.active :])
        ):
            raise ValueError(
                f"slabs of {self.edges} must cover 0 .. {self.layers} with at least {window} layers each; "
                "ranks without layers come last"
            )

    @property
    def active(self):
        """How many ranks own layers."""
        return int(np.count_nonzero(np.diff(self.edges)))

    def owned(self, rank):
        """(first, last + 1) layer of a rank."""
        return self.edges[rank], self.edges[rank + 1]

    def owner(self, layer):
        """Rank of each layer of an array."""
        return np.searchsorted(self.edges[1:], layer, side="right")

    @property
    def cuts(self):
        shared = self.reach_low + self.reach_high
        found = []
        for right in range(1, self.active):
            c = self.edges[right]
            first, last = c - self.reach_low, c - 1 + self.reach_high
            unsummed = tuple((c + q, plane) for q in range(shared) for plane in range(c + q - self.reach_low, last + 1))
            found.append(Cut(right - 1, right, first, first, shared, unsummed))
        if self.periodic:
            n = self.layers
            first = n - self.reach_low
            unsummed = tuple(
                (n - shared + q, p) for q in range(shared) for p in range(first, n - shared + q + self.reach_high + 1)
            )
            found.append(Cut(0, self.active - 1, -self.reach_low, first, shared, unsummed))
        return tuple(found)


def room(layers, window):
    """How many ranks a domain of this many layers can feed."""
    return max(1, layers // window)
