"""What two bodies do to each other on a node where both are, each with a velocity of its own.

Bodies of one velocity field are bonded where they share nodes. Of several fields (Bardenhagen, Brackbill, Sulsky 2000,
section 3) each node has a mass and a momentum per field, and bodies exchange momentum only where they touch and approach:
as much as takes their relative normal velocity, and along the surface at most Coulomb's part of it. What one gains the other
loses. The normal lies along the difference of the gradients of both volumes (Lemiale, Nairn, Hurmane 2010, section 2.3),
so that both see the same one.

Bodies share nodes before they touch. Whether they do is told by the volume around a node, weighted as momentum is: a body with
a flat surface at distance s fills the part P(s) of it, and P(s) + P(-s) = 1 for every even weight and every direction of the
surface, so two bodies touch exactly where together they fill it.
"""

from pmpm.physics import boundary
from pmpm.physics import tensors2 as la
from pmpm.physics.words import TINY, sqrt


def normal_between(gradient_a, gradient_b):
    """The unit normal from a to b, of the gradients sum V grad N that point out of each, in parts of what there may be; zero
    where both are the same."""
    along = la.add_scaled_vector(gradient_a, -1.0, gradient_b)
    return la.scale_vector(1.0 / max(sqrt(la.dot(along, along)), TINY), along)


def momentum_gained(a, mass_a, b, mass_b, n, friction):
    """What the body with momentum a (kg m/s) gains from the one with momentum b, n pointing from it to the other.

    To the velocity with which a comes, the other body is a wall; what that changes is given to a mass that both have.
    """
    coming = la.add_scaled_vector(la.scale_vector(1.0 / mass_a, a), -1.0 / mass_b, b)
    kept = boundary.wall_friction(coming, la.scale_vector(-1.0, n), friction, 0.0)
    return la.scale_vector(mass_a * (mass_b / (mass_a + mass_b)), la.add_scaled_vector(kept, -1.0, coming))
