"""Words of the physics that differ between targets, with their plain Python meaning; `kernels/targets.py` replaces them."""

import math
from math import exp, expm1, log, log1p, sqrt  # noqa: F401

TINY = 1e-150  # squares of numbers below it underflow: 1e-150 in float64, 1e-19 in float32
SWEEPS = 6  # cyclic Jacobi sweeps of a symmetric 3 x 3 matrix: 6 in float64, 5 in float32
NAN = math.nan


def where(condition, a, b):
    return a if condition else b


def floor(x):
    return float(math.floor(x))
