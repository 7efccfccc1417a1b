"""What one particle gives to one node (P2G) and takes from it (G2P).

All transfers give w m v. With an affine velocity field a particle gives w m (v + C (x_i - x_p)): APIC (Jiang et al. 2015),
C = B D^-1 with B = sum w v_i (x_i - x_p)^T and D = sum w (x_i - x_p)(x_i - x_p)^T. Linear splines have a D that is singular on
nodes; there C = grad v, which is the same where D can be inverted (Jiang et al. 2017, section 5.2). The internal force is
-V0 tau grad N, or MLS-MPM's -V0 tau D^-1 (x_i - x_p) w (Hu et al. 2018), which needs no gradients and lets force and affine
momentum share one matrix. PIC (Harlow 1964) takes the grid's velocity, FLIP (Brackbill and Ruppel 1986) only what the step has
changed of it; AFLIP is APIC with FLIP's velocities. Distances `d` are x_i - x_p in cells, slopes `dw` in 1 / cells.

F-bar takes the volume change of a step from the average theta_i = sum w V0 div v / sum w V0 on nodes, gathered like a velocity:
one constraint per node in place of one per particle, so that nearly incompressible solids do not lock (after de Souza Neto,
Peric, Dutko, Owen 1996, who average over an element).
"""

from pmpm.physics import tensors2 as la
from pmpm.physics.bspline import INERTIA_QUADRATIC as INERTIA


def affine_momentum(mass, C, dx):
    """M in kg m/s per cell of the affine field: a node at distance d receives w (m v + M d)."""
    return la.scale(mass * dx, C)


def stress_momentum(volume0_dt, tau, inv_dx):
    """MLS-MPM's part of M: the stress impulse, -V0 dt tau D^-1."""
    return la.full(la.scale_plus_diagonal(-(volume0_dt * INERTIA * inv_dx), tau, 0.0))


def node_momentum(w, d, momentum, M):
    """Momentum (kg m/s) given to a node at distance d."""
    return la.scale_vector(w, la.add_scaled_vector(momentum, 1.0, la.apply(M, d)))


def node_impulse(given, dw, tau, minus_impulse):
    """`given`, and the impulse of the internal force; `minus_impulse` = -V0 dt / dx."""
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


def with_divergence(G, divergence):
    """G with another trace: the volume change that is averaged over the neighbourhood."""
    return la.add_diagonal(G, (divergence - la.trace(G)) / la.DIM)


def blend_velocity(v_grid, v_particle, v_grid_before, blend):
    """FLIP's velocity: the grid's new one, and of what the grid could not hold of the particle's old one the part `blend`."""
    return la.add_scaled_vector(v_grid, blend, la.add_scaled_vector(v_particle, -1.0, v_grid_before))
