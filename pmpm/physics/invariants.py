"""Invariants of a stress."""

from pmpm.physics.words import sqrt


def von_mises(xx, yy, zz, xy, yz, xz):
    """sqrt(3 J2) in Pa of a stress, sqrt(3/2) times the norm of its deviator (von Mises 1913)."""
    mean = (xx + yy + zz) / 3.0
    a, b, c = xx - mean, yy - mean, zz - mean
    return sqrt(1.5 * (a * a + b * b + c * c + 2.0 * (xy * xy + yz * yz + xz * xz)))
