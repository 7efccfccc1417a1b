"""Memory of particles: what has been read is handed on, piece by piece, to the place where they are written, so that no more
than a piece is there twice.

Handing pages on (Linux: mremap) spares their zeroing, and on a machine that lends its free memory to others, such as a virtual
one, waiting for it: there, 150 MB given back and asked for again took 0.3 s in place of 0.01.
"""

import contextlib
import ctypes
import mmap

import numpy as np

from pmpm.kernels.alignment import aligned

PIECE = 1 << 22  # bytes that are worth a call to the system
PAGE = 1 << 21  # bytes: numpy asks for pages of this size, and giving back a part of one would break it up
HAND_ON = 1 | 2 | 4  # MREMAP_MAYMOVE, MREMAP_FIXED, MREMAP_DONTUNMAP (Linux 5.7): the old addresses stay valid
MAP_FIXED = 16


def room(rows, columns, dtype):
    """Rows of uninitialised numbers that begin a cache line. What nobody writes to takes no memory."""
    shape = (rows, *columns)
    return aligned(int(np.prod(shape, dtype=np.int64)), dtype, np.empty).reshape(shape)


def system_call(name):
    """A call of the C library, or None where there is no such call."""
    with contextlib.suppress(OSError, TypeError):
        return getattr(ctypes.CDLL(None, use_errno=True), name, None)
    return None


def release(first, last):
    """Give the memory at these addresses back to the system; what it held is lost.

    Where the system knows no such call the memory stays until the array goes.
    """
    advise, advice = system_call("madvise"), getattr(mmap, "MADV_DONTNEED", None)
    if advise is not None and advice is not None:
        advise(ctypes.c_void_p(first), ctypes.c_size_t(last - first), advice)


def hand_on(first, last, there):
    """Let the memory at these addresses, whole large pages, be that at another address; what was there is lost, and what is
    read at the old addresses afterwards is zero. Returns up to which address it has been done."""
    remap = system_call("mremap")
    if remap is None:
        return first
    remap.restype = ctypes.c_void_p
    page = ctypes.c_size_t(PAGE)
    for begin in range(first, last, PAGE):
        target = there + begin - first
        if remap(ctypes.c_void_p(begin), page, page, ctypes.c_int(HAND_ON), ctypes.c_void_p(target)) != target:
            put_back(target)
            return begin
    return last


def put_back(address):
    """Make sure that there is memory at a large page: a call that was to replace it may have taken it away and then failed."""
    take, readable = system_call("mmap"), mmap.PROT_READ | mmap.PROT_WRITE
    take.restype = ctypes.c_void_p
    kind = mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS | MAP_FIXED
    take(
        ctypes.c_void_p(address), ctypes.c_size_t(PAGE), ctypes.c_int(readable), ctypes.c_int(kind), ctypes.c_int(-1),
        ctypes.c_long(0),
    )  # fmt: skip


class Scratch:
    """Arrays that are needed again and again, of any length: their memory is kept, by name, as long as this is. `empty(size,
    dtype)` makes it."""

    def __init__(self, empty=np.empty):
        self.kept, self.empty = {}, empty

    def array(self, name, shape, dtype):
        """Uninitialised; what was taken under this name before must not be used any more."""
        size = int(np.prod(shape, dtype=np.int64))
        key = name, np.dtype(dtype)
        if key not in self.kept or len(self.kept[key]) < size:
            self.kept[key] = self.empty(size + size // 8, dtype)
        return self.kept[key][:size].reshape(shape)


class Source:
    """Rows that are read once, from the first on, and whose memory is handed on behind the reader."""

    def __init__(self, *arrays):
        self.arrays = arrays
        self.first = [upwards(array.ctypes.data) for array in arrays]  # address of what has not been handed on
        self.filled = [(0, 0)] * len(arrays)  # address of the array that took it, and to which address it has

    def done(self, row, targets):
        """Nobody will read what lies before this row. targets: of each array, (array, rows of it that have been written): what
        lies behind them takes the memory as far as there is room."""
        for number, (array, (target, written)) in enumerate(zip(self.arrays, targets, strict=True)):
            first, last = self.first[number], downwards(array.ctypes.data + row * array[:1].nbytes)
            if last - first < PIECE:
                continue
            self.first[number] = last
            base = target.ctypes.data
            filled = self.filled[number][1] if self.filled[number][0] == base else 0
            there = max(upwards(base + written * target[:1].nbytes), filled)
            handed = max(0, min(last - first, downwards(base + target.nbytes) - there))
            done = hand_on(first, first + handed, there)
            self.filled[number] = base, there + done - first
            if done < last:
                release(done, last)

    def end(self, targets):
        """All is written: what has been handed on and is not needed goes back to the system."""
        for (base, filled), (target, written) in zip(self.filled, targets, strict=True):
            first = upwards(target.ctypes.data + written * target[:1].nbytes)
            if base == target.ctypes.data and first < filled:
                release(first, filled)


def upwards(address):
    """The first large page from an address on."""
    return -(-address // PAGE) * PAGE


def downwards(address):
    """The beginning of the large page that an address lies in."""
    return address // PAGE * PAGE


def moved(array, used, rows):
    """The first `used` rows of an array with room for so many, and the old one's memory handed on on the way."""
    wider, source = room(rows, array.shape[1:], array.dtype), Source(array)
    step = max(1, PIECE // max(array[:1].nbytes, 1))
    for first in range(0, used, step):
        last = min(first + step, used)
        wider[first:last] = array[first:last]
        source.done(last, [(wider, last)])
    source.end([(wider, used)])
    return wider
