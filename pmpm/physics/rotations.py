"""Rotations in a plane: the steps of Jacobi sweeps and of decompositions, in any dimension."""

from pmpm.physics.words import EPS, TINY, sqrt, where


def rotation_to_diagonal(a, b, c):
    """(tangent, cosine, sine) of the Jacobi rotation that removes the off-diagonal c between diagonal entries a and b."""
    difference, twice = b - a, 2.0 * c
    root = sqrt(difference * difference + twice * twice) + TINY
    t = twice / (difference + where(difference < 0.0, -root, root))
    cosine = 1.0 / sqrt(1.0 + t * t)
    return t, cosine, t * cosine


def givens(x, y):
    """(cosine, sine) of the rotation that turns the vector (x, y) onto (r, 0), r >= 0: at any size, none for zero."""
    size = max(abs(x), abs(y))
    none = size == 0.0
    x, y = where(none, 1.0, x / where(none, 1.0, size)), y / where(none, 1.0, size)
    r = sqrt(x * x + y * y)
    return x / r, y / r


def turn_to_orthogonal(first, second, product):
    """(cosine, sine, size) of the turn that makes two vectors u, v orthogonal, the longer one first: for u.u, v.v and u.v.

    A turn of at most 45 degrees, with its tangent as size, or that one and an exchange, with size 1. What is orthogonal, or
    equally long, to round-off is left as it is.
    """
    noise = 2.0 * EPS * (first + second)
    difference, twice = first - second, 2.0 * product
    twice = where(abs(twice) <= noise, 0.0, twice)
    exchange = difference < -noise
    t = twice / (abs(difference) + sqrt(difference * difference + twice * twice) + TINY)
    cosine = 1.0 / sqrt(1.0 + t * t)
    sine = t * cosine
    return where(exchange, sine, cosine), where(exchange, cosine, sine), where(exchange, 1.0, abs(t))
