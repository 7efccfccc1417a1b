"""What one particle gives to one node (P2G) and takes from it (G2P).

APIC (Jiang et al. 2015): a particle carries v and C = B D^-1 and gives w m (v + C (x_i - x_p)). Internal force:
-V0 tau grad N (`gradient`), or MLS-MPM's -V0 tau D^-1 (x_i - x_p) w (Hu et al. 2018), which needs no gradients and lets
force and affine momentum share one matrix. Distances `d` are x_i - x_p in cells, slopes `dw` in 1 / cells.
"""

from pmpm.physics import tensors2 as la
from pmpm.physics.bspline import INERTIA_QUADRATIC as INERTIA

MLS = False


def momentum_matrix(mass, C, volume0_dt, tau, dx, inv_dx):
    """(A, S): a node at distance d receives momentum w (m v + A d + S d) + force_by_gradient.

    A is the affine momentum per cell in kg m/s; S, symmetric, MLS-MPM's stress impulse per cell (zero work for APIC).
    """
    A = la.scale(mass * dx, C)
    if MLS:
        S = la.scale_plus_diagonal(-(volume0_dt * INERTIA * inv_dx), tau, 0.0)
    else:
        S = tau
    return A, S


def node_momentum(w, d, dw, momentum, A, S, minus_impulse):
    """Momentum (kg m/s) given to one node; `minus_impulse` = -V0 dt / dx."""
    if MLS:
        given = la.add_scaled_vector(momentum, 1.0, la.apply(A, d))
        return la.scale_vector(w, la.add_scaled_vector(given, 1.0, la.apply_symmetric(S, d)))
    given = la.scale_vector(w, la.add_scaled_vector(momentum, 1.0, la.apply(A, d)))
    return la.add_scaled_vector(given, minus_impulse, la.apply_symmetric(S, dw))


def gather_velocity(v, w, v_node):
    """v + w v_i: the particle's velocity, node after node."""
    return la.add_scaled_vector(v, w, v_node)


def gather_affine(B, w, v_node, d):
    """B + w v_i d^T: APIC's B in m/s cells, node after node."""
    return la.add_outer(B, la.scale_vector(w, v_node), d)


def gather_gradient(L, v_node, dw):
    """L + v_i grad N^T: the velocity gradient in m/s per cell, node after node."""
    return la.add_outer(L, v_node, dw)
