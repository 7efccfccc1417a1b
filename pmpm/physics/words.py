"""Words of the physics that differ between targets, with their plain Python meaning; `kernels/targets.py` replaces them."""

import math
from math import cos, exp, expm1, log, log1p, sin, sqrt  # noqa: F401

TINY = 1e-150  # squares of numbers below it underflow: 1e-150 in float64, 1e-19 in float32
SWEEPS = 6  # cyclic Jacobi sweeps of a symmetric 3 x 3 matrix: 6 in float64, 5 in float32
# Coefficients of power series, the highest power first. At x = 0.5, y = 0.25 what is left out is a tenth of eps or less:
# 18 and 25 terms in float64, 11 and 11 in float32.
EXPM1_OF_TWICE = (*(2.0**n / math.factorial(n) for n in range(18, 0, -1)), 0.0)  # exp(2 x) - 1
ATANH_OVER_ROOT = tuple(1.0 / (2 * n + 1) for n in range(24, -1, -1))  # atanh(sqrt y) / sqrt y
NAN = math.nan


def where(condition, a, b):
    return a if condition else b


def any_of(condition):
    """Whether a condition holds for at least one of the particles that are computed together; here there is but one."""
    return bool(condition)


def floor(x):
    return float(math.floor(x))
