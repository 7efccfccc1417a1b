"""Places: positions as integers, in cells times 2^FRACTION, from a base node that many particles share.

A place is exact wherever the particle is: no loss far from the origin, the same resolution everywhere, and a result that does
not depend on the base. One base serves a segment of particles, so that a position costs one number per axis and no more.
"""

from dataclasses import dataclass

import numpy as np

PADDING = 1  # cells a particle may drift from the layer it joined at the last regroup
NEAR = 1  # layers that it is then at most from there: padding and half a cell are less than two
REACH = 110  # cells between a base node and the home nodes of its particles, at a regroup
TRAVEL = 8.0  # cells a particle may travel from there: 110 + 8 + 1 stays inside the integers of float32 places


@dataclass(frozen=True)
class PlaceFormat:
    """`fraction` bits for a part of a cell; the bits above count cells from the base."""

    integer: np.dtype
    fraction: int

    @property
    def unit(self):
        """Cells per step of the integer; a power of two."""
        return 2.0**-self.fraction

    def whole(self, cells):
        """The place of a number of cells that is a multiple of a power of two, as a Python integer."""
        return int(cells * 2**self.fraction)

    def from_cells(self, offset):
        """Places of float offsets in cells, to the nearest."""
        return np.rint(np.asarray(offset, np.float64) * 2.0**self.fraction).astype(self.integer)

    def to_cells(self, place):
        """Float64 offsets in cells; exact for float32 places."""
        return place * self.unit

    def split(self, base, place):
        """(node, part): the node below int64 places from base nodes, and the part of a cell from there as a float."""
        whole = place >> self.fraction
        return base + whole, self.to_cells(place - (whole << self.fraction))

    def moved_from(self, other, place):
        """Places of another format in this one, to the nearest."""
        place = place.astype(np.int64)
        if self.fraction >= other.fraction:
            return (place << (self.fraction - other.fraction)).astype(self.integer)
        fewer = other.fraction - self.fraction
        return ((place + (1 << (fewer - 1))) >> fewer).astype(self.integer)


FORMATS = {
    np.dtype("float32"): PlaceFormat(np.dtype(np.int32), 24),
    np.dtype("float64"): PlaceFormat(np.dtype(np.int64), 52),
}
