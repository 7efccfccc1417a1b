"""Compressible neo-Hookean solid.

Energy per reference volume: psi = mu/2 (tr b - 3) - mu ln J + lam/2 (ln J)^2 with b = F F^T; tau = mu (b - I) + lam ln J I.
In plane strain the out-of-plane stretch is 1. Source: Bonet, Wood, Nonlinear Continuum Mechanics for Finite Element
Analysis, 2nd ed. (2008), section 6.4.3.
"""

from pmpm.physics import tensors2 as la
from pmpm.physics.materials.keys import ELASTIC_KEYS, StateField, lame_parameters, no_choices, no_conflicts
from pmpm.physics.words import log

WORK = 100
SOURCE = "Bonet and Wood (2008), section 6.4.3"
KEYS = ELASTIC_KEYS
STATE = (StateField("F", "tensor", "-", "deformation gradient", 1.0),)
SMALLEST = 1e-10  # volume ratios below it only keep the logarithm finite until `valid` stops the run
conflicts, choices, parameters = no_conflicts, no_choices, lame_parameters


def state_fields(keys):
    return STATE


def state_at(F, params):
    return F


def kirchhoff_stress(F, params):
    mu, lam = params
    return la.scale_plus_diagonal(mu, la.left_cauchy_green(F), lam * log(max(la.det(F), SMALLEST)) - mu)


def out_of_plane_stress(F, params):
    mu, lam = params
    return lam * log(max(la.det(F), SMALLEST))


def advance(F, G, dt, params):
    return la.add(F, la.matmul(G, F))


def valid(F):
    return la.det(F) > 0.0


def volume_ratio(F):
    return la.det(F)


def wave_speed_squared(F, params, density):
    """Upper bound over directions n of (mu n.b n + mu + lam (1 - ln J)) / rho0, the spatial P-wave speed squared."""
    mu, lam = params
    b = la.row_sum_bound(la.left_cauchy_green(F))
    return (mu * b + max(mu + lam * (1.0 - log(max(la.det(F), SMALLEST))), 0.0)) / density


def energy(F, params):
    mu, lam = params
    log_J = log(max(la.det(F), SMALLEST))
    # Sum of s^2 - 1 - ln s^2 over the stretches s: never negative, but its rounding near a rotation is.
    shear = max(la.trace_symmetric(la.left_cauchy_green(F)) - la.DIM - 2.0 * log_J, 0.0)
    return 0.5 * mu * shear + 0.5 * lam * log_J * log_J
