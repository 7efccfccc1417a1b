"""What one particle gives to one node (P2G) and takes from it (G2P).

APIC (Jiang et al. 2015): a particle carries v and C = B D^-1 and gives w m (v + C (x_i - x_p)). Internal force:
-V0 tau grad N (`gradient`), or MLS-MPM's -V0 tau D^-1 (x_i - x_p) w (Hu et al. 2018), which needs no gradients and lets
force and affine momentum share one matrix. Distances `d` are x_i - x_p in cells, slopes `dw` in 1 / cells.
"""

from pmpm.physics import tensors2 as la
from pmpm.physics.bspline import INERTIA_QUADRATIC as INERTIA

MLS = False


def affine_momentum(mass, C, volume0_dt, tau, dx, inv_dx):
    """M in kg m/s per cell: a node at distance d receives w (m v + M d), besides what weight gradients give.

    The affine momentum m C; for MLS-MPM also the stress impulse, -V0 dt tau D^-1.
    """
    A = la.scale(mass * dx, C)
    if MLS:
        return la.add(A, la.full(la.scale_plus_diagonal(-(volume0_dt * INERTIA * inv_dx), tau, 0.0)))
    return A


def node_momentum(w, d, dw, momentum, M, tau, minus_impulse):
    """Momentum (kg m/s) given to one node; `minus_impulse` = -V0 dt / dx."""
    given = la.scale_vector(w, la.add_scaled_vector(momentum, 1.0, la.apply(M, d)))
    if MLS:
        return given
    return la.add_scaled_vector(given, minus_impulse, la.apply_symmetric(tau, dw))


def gather_velocity(v, w, v_node):
    """v + w v_i: the particle's velocity, node after node."""
    return la.add_scaled_vector(v, w, v_node)


def gather_affine(B, w, v_node, d):
    """B + w v_i d^T: APIC's B in m/s cells, node after node."""
    return la.add_outer(B, la.scale_vector(w, v_node), d)


def gather_gradient(L, v_node, dw):
    """L + v_i grad N^T: the velocity gradient in m/s per cell, node after node."""
    return la.add_outer(L, v_node, dw)
