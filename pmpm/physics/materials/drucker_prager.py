"""Dry cohesionless sand: Hencky elasticity inside a Drucker-Prager cone, with volume correction.

psi = mu |E|^2 + lam/2 (tr E)^2 in the elastic Hencky strain E; tau = 2 mu E + lam tr E I. Yield: |dev tau| + alpha tr tau <= 0.
In strains the cone is |dev E| <= slope (-tr E), slope = alpha (d lam + 2 mu) / (2 mu); the return is along dev E (no
plastic volume change), and to the stress-free tip where tr E > 0. `v_c` is the expansion spent at the tip and not yet
undone: v_c + tr E is unchanged by the return. d is the dimension of the scene: in 2-D the map acts in the plane.
Sources: Klar et al., ACM Trans. Graph. 35 (2016) 103; Tampubolon et al., ACM Trans. Graph. 36 (2017) 105, section 4.3.4.
"""

import math

from pmpm.physics import hencky
from pmpm.physics import tensors2 as la
from pmpm.physics.materials.keys import DENSITY, POISSON_RATIO, YOUNGS_MODULUS, Key, StateField, lame
from pmpm.physics.words import NAN, TINY, expm1, where

SOURCE = "Klar et al. (2016), ACM Trans. Graph. 35, 103; Tampubolon et al. (2017), 36, 105"
KEYS = (
    DENSITY,
    YOUNGS_MODULUS,
    POISSON_RATIO,
    Key("friction_angle", "deg", "angle of internal friction", at_least=0.0, below=90.0),
    Key(
        "friction_fit",
        "-",
        "stress state in which the cone meets Mohr-Coulomb (default: plane_strain in 2-D, triaxial in 3-D)",
        optional=True,
        choices=("triaxial", "plane_strain"),
    ),
    Key("cohesion", "Pa", "strength without pressure", default=0.0, at_least=0.0, only=0.0),
    Key("dilatancy_angle", "deg", "angle of plastic expansion", default=0.0, only=0.0),
    Key("volume_correction", "-", "remember expansion at the tip and undo it before pressure returns", default=True),
)
STATE = (
    StateField("hencky_strain", "symmetric", "-", "elastic logarithmic strain, 1/2 ln b"),
    StateField("v_c", "scalar", "-", "logarithmic volume gained at the tip and not yet undone"),
)
VOLUME_CORRECTION = True


def conflicts(keys):
    return None


def choices(keys):
    return {"VOLUME_CORRECTION": bool(keys["volume_correction"])}


def state_fields(keys):
    return STATE if keys["volume_correction"] else STATE[:1]


def friction_slope(friction_angle, fit, dim):
    """alpha of |dev tau| + alpha tr tau <= 0, for an angle in degrees.

    In the plane (d = 2), sin(phi)/sqrt(2) is Mohr-Coulomb itself; in 3-D the cone can meet it in triaxial compression
    (Klar et al. 2016) or in plane strain.
    """
    phi = math.radians(friction_angle)
    if fit is None:
        fit = "plane_strain" if dim == 2 else "triaxial"
    if fit == "triaxial":
        return math.sqrt(2.0 / 3.0) * 2.0 * math.sin(phi) / (3.0 - math.sin(phi))
    if dim == 2:
        return math.sin(phi) / math.sqrt(2.0)
    return math.sqrt(2.0) * math.tan(phi) / math.sqrt(9.0 + 12.0 * math.tan(phi) ** 2)


def parameters(keys, dim):
    """(mu in Pa, lam in Pa, slope of the cone in strains)."""
    mu, lam = lame(keys["youngs_modulus"], keys["poisson_ratio"])
    alpha = friction_slope(keys["friction_angle"], keys.get("friction_fit"), dim)
    return mu, lam, alpha * (dim * lam + 2.0 * mu) / (2.0 * mu)


def state_at(F, params):
    E = hencky.strain_of(F)
    if VOLUME_CORRECTION:
        return E + (la.det(F) - la.det(F),)
    return E


def kirchhoff_stress(state, params):
    mu, lam, slope = params
    E = la.symmetric_part(state)
    return la.scale_plus_diagonal(2.0 * mu, E, lam * la.trace_symmetric(E))


def out_of_plane_stress(state, params):
    mu, lam, slope = params
    return lam * la.trace_symmetric(la.symmetric_part(state))


def advance(state, G, dt, params):
    mu, lam, slope = params
    E = hencky.trial_strain(la.symmetric_part(state), G)
    trace = la.trace_symmetric(E)
    D = la.scale_plus_diagonal(1.0, E, -trace / la.DIM)
    if VOLUME_CORRECTION:
        trace = trace + la.after_symmetric(state)
    closed = min(trace, 0.0)
    shrink = min(1.0, slope * -closed / max(la.norm_symmetric(D), TINY))
    kept = where(la.det(la.identity_plus(G)) > 0.0, shrink, NAN)
    E = la.scale_plus_diagonal(kept, D, closed / la.DIM)
    if VOLUME_CORRECTION:
        return E + (trace - closed,)
    return E


def valid(state):
    return la.norm_symmetric(la.symmetric_part(state)) < hencky.LARGEST


def volume_ratio(state):
    E = la.symmetric_part(state)
    if VOLUME_CORRECTION:
        return expm1(la.trace_symmetric(E) + la.after_symmetric(state)) + 1.0
    return expm1(la.trace_symmetric(E)) + 1.0


def wave_speed_squared(state, params, density):
    """Upper bound of (lam + 2 mu - 2 mu ln F - lam ln J) / rho0, the spatial P-wave speed squared along a principal axis.

    It bounds the waves along other axes too while no elastic strain is beyond 1; at 2, shear waves exceed it by 12 %.
    """
    mu, lam, slope = params
    E = la.symmetric_part(state)
    stiffer = 2.0 * mu * la.row_sum_bound(E) - lam * min(la.trace_symmetric(E), 0.0)
    return (lam + 2.0 * mu + stiffer) / density


def energy(state, params):
    mu, lam, slope = params
    E = la.symmetric_part(state)
    norm, trace = la.norm_symmetric(E), la.trace_symmetric(E)
    return mu * norm * norm + 0.5 * lam * trace * trace
