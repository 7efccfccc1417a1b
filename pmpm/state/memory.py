"""Memory of particles: given back piece by piece while what lies in it moves elsewhere, so that no more than a piece is there
twice."""

import ctypes
import mmap

import numpy as np

from pmpm.kernels.alignment import aligned

PIECE = 1 << 22  # bytes that are worth a call to the system
PAGE = 1 << 21  # bytes: numpy asks for pages of this size, and giving back a part of one would break it up


def room(rows, columns, dtype):
    """Rows of uninitialised numbers that begin a cache line. What nobody writes to takes no memory."""
    shape = (rows, *columns)
    return aligned(int(np.prod(shape, dtype=np.int64)), dtype, np.empty).reshape(shape)


def release(first, last):
    """Give the memory at these addresses back to the system; what it held is lost.

    Where the system knows no such call the memory stays until the array goes.
    """
    advise, advice = getattr(ctypes.CDLL(None), "madvise", None), getattr(mmap, "MADV_DONTNEED", None)
    if advise is not None and advice is not None:
        advise(ctypes.c_void_p(first), ctypes.c_size_t(last - first), advice)


class Scratch:
    """Arrays that are needed again and again, of any length: their memory is kept, by name, as long as this is."""

    def __init__(self):
        self.kept = {}

    def array(self, name, shape, dtype):
        """Uninitialised; what was taken under this name before must not be used any more."""
        size = int(np.prod(shape, dtype=np.int64))
        if name not in self.kept or len(self.kept[name]) < size:
            self.kept[name] = np.empty(size + size // 8, dtype)
        return self.kept[name][:size].reshape(shape)


class Source:
    """Rows that are read once, from the first on, and whose memory goes back to the system behind the reader."""

    def __init__(self, *arrays):
        self.arrays = arrays
        self.first = [-(-array.ctypes.data // PAGE) * PAGE for array in arrays]  # address of what has not been given back

    def done(self, row):
        """Nobody will read what lies before this row."""
        for number, (array, first) in enumerate(zip(self.arrays, self.first, strict=True)):
            last = (array.ctypes.data + row * array[:1].nbytes) // PAGE * PAGE
            if last - first >= PIECE:
                release(first, last)
                self.first[number] = last


def moved(array, used, rows):
    """The first `used` rows of an array with room for so many, and the old one's memory given back on the way."""
    wider, source = room(rows, array.shape[1:], array.dtype), Source(array)
    step = max(1, PIECE // max(array[:1].nbytes, 1))
    for first in range(0, used, step):
        last = min(first + step, used)
        wider[first:last] = array[first:last]
        source.done(last)
    return wider
