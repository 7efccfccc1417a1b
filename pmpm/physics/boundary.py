"""What a rigid wall does to the grid: to the momentum of the nodes on it, and to the nodes beyond it.

`n` is the unit normal pointing into the material; p is the momentum of a node (the rules are homogeneous: they hold for
velocities as well). A wall is a mirror. A stencil that reaches beyond it meets the image of the material: what it gives to
the node beyond is given, as the image, to the inner node, and the node beyond moves as the image of the inner one. Then the
velocity at the wall is exactly the wall's, and pressure there is balanced, which rules on nodes alone do not achieve: they
leave half a cell without its counterpart and are of first order only.
"""

from pmpm.physics import tensors2 as la
from pmpm.physics.words import TINY, sqrt


def image_reversed(p, n):
    """The image in a wall that sticks: what moves along it moves the other way, too."""
    return la.scale_vector(-1.0, p)


def image_mirrored(p, n):
    """The image in a wall that lets material move along it."""
    return la.add_scaled_vector(p, -2.0 * la.dot(p, n), n)


def mirror_impulse(beyond, mass_beyond, inner, mass_inner, n):
    """Normal momentum the wall takes by mirroring, besides that of the node on it; negative where it pushes.

    Before, the nodes beyond and inside carry p_b and p_i; after, (m_i - m_b) v with v = (p_i - p_b) / (m_i + m_b).
    """
    along = mass_inner * la.dot(beyond, n) + mass_beyond * la.dot(inner, n)
    return 2.0 * along / (mass_inner + mass_beyond)


def wall_stick(p, n, coefficient, pressed):
    """No motion."""
    return la.scale_vector(0.0, p)


def wall_slip(p, n, coefficient, pressed):
    """No normal motion either way, no friction."""
    return la.add_scaled_vector(p, -la.dot(p, n), n)


def wall_separate(p, n, coefficient, pressed):
    """May leave, may not enter, no friction."""
    return la.add_scaled_vector(p, -min(la.dot(p, n), 0.0), n)


def wall_friction(p, n, coefficient, pressed):
    """May leave, may not enter; tangential momentum loses at most `coefficient` times the normal one (Coulomb).

    `pressed` is the normal momentum that the wall takes elsewhere on account of this node, at least zero.
    """
    normal = la.dot(p, n)
    tangential = la.add_scaled_vector(p, -normal, n)
    size = sqrt(la.dot(tangential, tangential))
    kept = max(0.0, 1.0 - coefficient * (pressed - min(normal, 0.0)) / max(size, TINY))
    return la.add_scaled_vector(la.scale_vector(kept, tangential), max(normal, 0.0), n)
