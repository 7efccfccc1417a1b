"""Snow: a fixed corotated solid that yields at small stretches and hardens with compaction.

Energy per reference volume: psi = mu sum (s_i - 1)^2 + lam/2 (J - 1)^2 in the principal elastic stretches s_i and J =
s_1 s_2 s_3; tau = sum [2 mu (s_i - 1) s_i] n_i n_i^T + lam (J - 1) J I. Yield: each s_i is clamped to [1 - theta_c, 1 +
theta_s], in 2-D those of the plane. Hardening: mu and lam are those of the keys times exp(xi (1 - J_P)), J_P the plastic
volume ratio.

The law is isotropic: it keeps E = 1/2 ln b, s_i = exp(e_i), and clamps the eigenvalues of the trial strain; J_P grows by what
was cut off, so that J_P exp(tr E) is the volume ratio. (s - 1) s = exp(2 e) - exp(e) is a power series in E, whose terms
suffice for critical stretches of 0.3 either way: stress needs no eigenvectors. Clamping is no flow rule: where an axis at
its largest stretch is under pressure, because the others are, cutting it gives energy.

exp(xi (1 - J_P)) is at most exp(xi): 2.2e4 for xi = 10, waves 148 times as fast. `largest_hardening` caps the factor, and with
it the cost of crushed snow. Torn snow loses stiffness without end; J_P stops at LARGEST_J_P, beyond which a lone particle in
flight would take it out of the range of float32. Stretched there, it no longer says how far apart the snow is.
Source: Stomakhin, Schroeder, Chai, Teran, Selle, ACM Trans. Graph. 32 (2013) 102.
"""

import math

from pmpm.physics import hencky
from pmpm.physics import tensors2 as la
from pmpm.physics.materials.keys import ELASTIC_KEYS, Key, StateField, lame
from pmpm.physics.words import EXP_OF_TWICE_LESS_EXP, EXPM1_OF_TWICE, any_of, exp, expm1, where

WORK = 135
SOURCE = "Stomakhin et al. (2013), ACM Trans. Graph. 32, 102"
KEYS = (
    *ELASTIC_KEYS,
    Key(
        "critical_compression",
        "-",
        "theta_c: principal stretches are at least 1 - theta_c",
        default=0.025,
        above=0.0,
        at_most=0.3,
    ),
    Key(
        "critical_stretch",
        "-",
        "theta_s: principal stretches are at most 1 + theta_s",
        default=0.0075,
        above=0.0,
        at_most=0.3,
    ),
    Key(
        "hardening",
        "-",
        "xi: stiffness is that of fresh snow times exp(xi (1 - J_P))",
        10.0,
        at_least=0.0,
        at_most=50.0,
    ),
    Key("largest_hardening", "-", "cap of that factor; default: none", optional=True, at_least=1.0),
)
STATE = (
    StateField("hencky_strain", "symmetric", "-", "elastic logarithmic strain, 1/2 ln b"),
    StateField("J_P", "scalar", "-", "plastic volume ratio", 1.0),
)
CAPPED = False
LARGEST_J_P = 1e6
SURELY = 1.0 - 1.0 / 128.0  # of a limit: what is within this is within the limit for any round-off of determinants


def conflicts(keys):
    if keys.get("largest_hardening") is not None and keys["hardening"] == 0.0:
        return f"largest_hardening = {keys['largest_hardening']:g} has nothing to cap with hardening = 0"
    return None


def choices(keys):
    return {"CAPPED": keys.get("largest_hardening") is not None}


def state_fields(keys):
    return STATE


def parameters(keys, dim):
    """(mu, lam in Pa, ln(1 - theta_c), ln(1 + theta_s), xi) and, if there is one, the logarithm of the cap."""
    params = (
        *lame(keys["youngs_modulus"], keys["poisson_ratio"]),
        math.log1p(-keys["critical_compression"]),
        math.log1p(keys["critical_stretch"]),
        keys["hardening"],
    )
    if keys.get("largest_hardening") is not None:
        return *params, math.log(keys["largest_hardening"])
    return params


def log_hardening(J_P, params):
    """xi (1 - J_P), capped."""
    if CAPPED:
        return min(params[4] * (1.0 - J_P), params[5])
    return params[4] * (1.0 - J_P)


def yielded(E, J_P, params):
    """(E, J_P) after a trial strain E: eigenvalues beyond the limits are cut off, which is what makes J_P.

    Eigenvalues are computed only where a determinant tells that one is near or beyond a limit.
    """
    low, high = params[2], params[3]
    from_low = la.scale_plus_diagonal(1.0, E, -SURELY * low)
    from_high = la.scale_plus_diagonal(-1.0, E, SURELY * high)
    beyond = la.not_positive_definite(from_low) | la.not_positive_definite(from_high)
    E_after, J_P_after = E, J_P
    if any_of(beyond):
        axes, e = la.principal_symmetric(E)
        added = la.into_range(e, low, high)
        E_after = la.where_symmetric(beyond, la.add_along(E, axes, added), E)
        J_P_after = where(beyond, min(J_P * exp(-la.sum_of(added)), LARGEST_J_P), J_P)
    return E_after, J_P_after


def state_at(F, params):
    E, J_P = yielded(hencky.strain_of(F), la.det(F) - la.det(F) + 1.0, params)
    return E + (J_P,)


def kirchhoff_stress(state, params):
    E = la.symmetric_part(state)
    factor = exp(log_hardening(la.after_symmetric(state), params))
    J_less_1 = expm1(la.trace_symmetric(E))
    S = la.polynomial(EXP_OF_TWICE_LESS_EXP, E)
    return la.scale_plus_diagonal(2.0 * params[0] * factor, S, params[1] * factor * J_less_1 * (J_less_1 + 1.0))


def out_of_plane_stress(state, params):
    J_less_1 = expm1(la.trace_symmetric(la.symmetric_part(state)))
    return params[1] * exp(log_hardening(la.after_symmetric(state), params)) * J_less_1 * (J_less_1 + 1.0)


def advance(state, G, dt, params):
    E = hencky.trial_strain(la.symmetric_part(state), G)
    E = la.scale_plus_diagonal(hencky.kept_if_forward(G), E, 0.0)
    E, J_P = yielded(E, la.after_symmetric(state), params)
    return E + (J_P,)


def valid(state):
    J_P = la.after_symmetric(state)
    return (la.norm_symmetric(la.symmetric_part(state)) < hencky.LARGEST) & (J_P > 0.0) & (J_P <= LARGEST_J_P)


def volume_ratio(state):
    return la.after_symmetric(state) * (expm1(la.trace_symmetric(la.symmetric_part(state))) + 1.0)


def wave_speed_squared(state, params, density):
    """Upper bound of (2 mu s^2 + lam J^2) / rho0 with the hardened moduli, the P-wave speed squared along a principal axis.

    s^2 and J^2 are both at most exp(2 max(sum of a row of |E|, tr E)), which takes the place of hardening's exponential.
    """
    E = la.symmetric_part(state)
    stretch = max(la.row_sum_bound(E), la.trace_symmetric(E))
    factor = exp(log_hardening(la.after_symmetric(state), params) + 2.0 * stretch)
    return factor * (2.0 * params[0] + max(params[1], 0.0)) / density


def energy(state, params):
    E = la.symmetric_part(state)
    factor = exp(log_hardening(la.after_symmetric(state), params))
    stretch_less_1 = la.norm_symmetric(la.polynomial(EXPM1_OF_TWICE, la.scale_plus_diagonal(0.5, E, 0.0)))
    J_less_1 = expm1(la.trace_symmetric(E))
    return factor * (params[0] * stretch_less_1 * stretch_less_1 + 0.5 * params[1] * J_less_1 * J_less_1)
