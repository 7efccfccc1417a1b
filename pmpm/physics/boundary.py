"""What a rigid boundary does to the velocity of one node. `n` is the unit normal pointing into the material."""

from pmpm.physics import tensors2 as la
from pmpm.physics.words import TINY, sqrt


def wall_stick(v, n, coefficient):
    """No motion."""
    return la.scale_vector(0.0, v)


def wall_slip(v, n, coefficient):
    """No normal motion either way, no friction."""
    return la.add_scaled_vector(v, -la.dot(v, n), n)


def wall_separate(v, n, coefficient):
    """May leave, may not enter, no friction."""
    return la.add_scaled_vector(v, -min(la.dot(v, n), 0.0), n)


def wall_friction(v, n, coefficient):
    """May leave, may not enter; the tangential velocity loses at most `coefficient` times the normal one (Coulomb)."""
    stopped = -min(la.dot(v, n), 0.0)
    tangential = la.add_scaled_vector(v, -la.dot(v, n), n)
    speed = sqrt(la.dot(tangential, tangential))
    kept = max(0.0, 1.0 - coefficient * stopped / max(speed, TINY))
    return la.add_scaled_vector(la.scale_vector(kept, tangential), max(la.dot(v, n), 0.0), n)
