"""Memory that begins a cache line: what kernels load in whole lines."""

import numpy as np

CACHE_LINE = 64  # bytes


def aligned(count, dtype, make=np.zeros):
    """Numbers that begin a cache line; `make`: np.zeros, or np.empty for what is written before it is read."""
    size = count * np.dtype(dtype).itemsize
    memory = make(size + CACHE_LINE, np.uint8)
    first = -memory.ctypes.data % CACHE_LINE
    return memory[first : first + size].view(dtype)
