"""Memory of particles: given back piece by piece while what lies in it moves elsewhere, so that no more than a piece is there
twice."""

import ctypes
import mmap

import numpy as np

from pmpm.kernels.alignment import aligned

PIECE = 1 << 22  # bytes that are worth a call to the system


def room(rows, columns, dtype):
    """Rows of uninitialised numbers that begin a cache line. What nobody writes to takes no memory."""
    shape = (rows, *columns)
    return aligned(int(np.prod(shape, dtype=np.int64)), dtype, np.empty).reshape(shape)


def release(array):
    """Give the memory of a contiguous array back to the system, as far as it is whole pages; what it held is lost.

    Where the system knows no such call the memory stays until the array goes.
    """
    advise, advice = getattr(ctypes.CDLL(None), "madvise", None), getattr(mmap, "MADV_DONTNEED", None)
    if advise is None or advice is None:
        return
    address, page = array.ctypes.data, mmap.PAGESIZE
    first, last = -(-address // page) * page, (address + array.nbytes) // page * page
    if first < last:
        advise(ctypes.c_void_p(first), ctypes.c_size_t(last - first), advice)


class Source:
    """Rows that are read once, from the first on, and whose memory goes back to the system behind the reader."""

    def __init__(self, *arrays):
        self.arrays, self.first = arrays, 0

    def done(self, row):
        """Nobody will read what lies before this row."""
        if (row - self.first) * sum(array[:1].nbytes for array in self.arrays) >= PIECE:
            for array in self.arrays:
                release(array[self.first : row])
            self.first = row


def moved(array, used, rows):
    """The first `used` rows of an array with room for so many, and the old one's memory given back on the way."""
    wider, source = room(rows, array.shape[1:], array.dtype), Source(array)
    step = max(1, PIECE // max(array[:1].nbytes, 1))
    for first in range(0, used, step):
        last = min(first + step, used)
        wider[first:last] = array[first:last]
        source.done(last)
    return wider
