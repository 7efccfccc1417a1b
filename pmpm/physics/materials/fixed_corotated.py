"""Fixed corotated solid: linear in the stretches, soft under extreme compression, and elastic through inversion.

Energy per reference volume: psi = mu sum (s_i - 1)^2 + lam/2 (J - 1)^2 with the singular values s_i of F = U diag(s) V^T, U and
V rotations, so that the smallest carries the sign of J = det F; with the rotation R = U V^T, sum (s_i - 1)^2 = |F - R|^2 and
    P = 2 mu (F - R) + lam (J - 1) cof F,    tau = P F^T = 2 mu (F - R) F^T + lam (J - 1) J I.
A particle that was turned inside out is pushed back: dpsi/ds_i is finite, and below zero for the s_i < 0.
In plane strain the out-of-plane stretch is 1, whose share of psi is zero, and tau_zz = s_z dpsi/ds_z = lam (J - 1) J; a
negative singular value is one in the plane. No hardening, no yield. F - R has the round-off of F: in float32 strains below
1e-6 are noise.
Source: Stomakhin, Howes, Schroeder, Teran, Energetically consistent invertible elasticity, SCA (2012), section 3.
"""

from pmpm.physics import tensors2 as la
from pmpm.physics.materials import neo_hookean

WORK = 107
SOURCE = "Stomakhin et al. (2012), Energetically consistent invertible elasticity, SCA"
KEYS, STATE = neo_hookean.KEYS, neo_hookean.STATE
LARGEST = 1e12  # of |F|^2: no solid is stretched a millionfold
conflicts, choices, parameters = neo_hookean.conflicts, neo_hookean.choices, neo_hookean.parameters
state_fields, state_at = neo_hookean.state_fields, neo_hookean.state_at
advance, volume_ratio = neo_hookean.advance, neo_hookean.volume_ratio


def strain(F):
    """F - R."""
    return la.add(F, la.scale(-1.0, la.polar(F)))


def kirchhoff_stress(F, params):
    mu, lam = params
    return la.scale_plus_diagonal(2.0 * mu, la.product_symmetric(strain(F), F), out_of_plane_stress(F, params))


def out_of_plane_stress(F, params):
    mu, lam = params
    J = la.det(F)
    return lam * (J - 1.0) * J


def valid(F):
    """False for nan."""
    return la.norm_squared(F) <= LARGEST


def wave_speed_squared(F, params, density):
    """Upper bound over directions n of (2 mu n.b n + lam J^2) / rho0, the spatial P-wave speed squared along principal axes.

    A wave m along n has rho0 c^2 |m|^2 = d2/dh2 psi(F + h m (F^T n)^T). |F - R|^2 = |F|^2 - 2 x + constant, of which |F|^2
    gives 2 |m|^2 n.b n, and x = tr R^T F, being the largest tr Q^T F of all rotations Q, is convex, so that -2 x can only slow
    it down; J changes linearly, by h J m.n. Hence rho0 c^2 <= 2 mu n.b n + lam J^2 for any F, inverted or not; where lam < 0,
    its term can only slow it down too, and is left out.
    """
    mu, lam = params
    J = la.det(F)
    return (2.0 * mu * la.row_sum_bound(la.left_cauchy_green(F)) + max(lam, 0.0) * J * J) / density


def energy(F, params):
    mu, lam = params
    volume = la.det(F) - 1.0
    return mu * la.norm_squared(strain(F)) + 0.5 * lam * volume * volume
