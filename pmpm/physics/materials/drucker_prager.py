"""Sand: Hencky elasticity inside a Drucker-Prager cone, with cohesion, dilatancy and volume correction.

psi = mu |E|^2 + lam/2 (tr E)^2 in the elastic Hencky strain E; tau = 2 mu E + lam tr E I, which is
2 mu dev E + (lam + 2 mu / d) tr E I. Yield: |dev tau| + alpha tr tau <= k. d is the dimension of the scene: in 2-D the map
acts in the plane.

The cone in strains. |dev E| <= radius - slope tr E with slope = alpha (d lam + 2 mu) / (2 mu) and radius = k / (2 mu). Its
tip is at tr tau = k / alpha, tr E = k / (alpha (d lam + 2 mu)): without stress where there is no cohesion. k = d c alpha /
tan(phi) puts it where Mohr and Coulomb's pyramid has its apex, at a tension of c / tan(phi), so that c and phi are theirs in
each `friction_fit`. Without friction there is no tip, and |dev tau| <= k is von Mises' cylinder.

The return. Flow is along dev E and, with dilatancy, expands: dE_p = gamma (n + a I), n = dev E / |dev E|, where a is alpha
at the dilatancy angle psi in place of phi (psi = phi: associated; psi = 0, the default: no plastic volume change). With y =
|dev E| + slope tr E - radius of the trial strain, gamma = y / (1 + slope d a). Where that is more than |dev E| the flow ends
on the axis and beyond the tip, and the rest of the trace, tr E - d a |dev E| - tr E_tip, opens the material.

Volume correction. `v_c` is the opening at the tip that is not yet undone: it joins tr E of the next trial, and v_c + tr E is
unchanged by a return without dilatancy. Expansion by dilatancy is not of that kind: grains have climbed over each other, and
compression does not undo it. `v_p` keeps it, so that v_c + v_p + tr E is the logarithm of the volume ratio; without volume
correction v_p keeps the opening too. psi is constant: nothing ends dilatancy at a critical density.
Sources: Klar et al., ACM Trans. Graph. 35 (2016) 103; Tampubolon et al., ACM Trans. Graph. 36 (2017) 105, section 4.3.4;
cohesion, flow and tip: de Souza Neto, Peric, Owen, Computational Methods for Plasticity (2008), section 8.3.
"""

import math

from pmpm.physics import hencky
from pmpm.physics import tensors2 as la
from pmpm.physics.materials.keys import DILATANCY_ANGLE, ELASTIC_KEYS, FRICTION_ANGLE, Key, StateField, lame
from pmpm.physics.words import NAN, TINY, expm1, where

WORK = 113
SOURCE = "Klar et al. (2016), ACM Trans. Graph. 35, 103; Tampubolon et al. (2017), 36, 105; de Souza Neto et al. (2008)"
KEYS = (
    *ELASTIC_KEYS,
    FRICTION_ANGLE,
    Key(
        "friction_fit",
        "-",
        "stress state in which the cone meets Mohr-Coulomb (default: plane_strain in 2-D, triaxial in 3-D)",
        optional=True,
        choices=("triaxial", "plane_strain"),
    ),
    Key("cohesion", "Pa", "Mohr and Coulomb's shear strength without pressure", default=0.0, at_least=0.0),
    DILATANCY_ANGLE,
    Key("volume_correction", "-", "remember expansion at the tip and undo it before pressure returns", default=True),
)
STATE = (
    StateField("hencky_strain", "symmetric", "-", "elastic logarithmic strain, 1/2 ln b"),
    StateField("v_c", "scalar", "-", "logarithmic volume gained at the tip and not yet undone"),
    StateField("v_p", "scalar", "-", "logarithmic volume gained by dilatancy (and at the tip, where no v_c is kept)"),
)
VOLUME_CORRECTION = True
COHESION = False
DILATANCY = False


def conflicts(keys):
    if (keys.get("dilatancy_angle") or 0.0) > keys["friction_angle"]:
        return (
            f"dilatancy_angle = {keys['dilatancy_angle']:g} deg must be at most friction_angle = "
            f"{keys['friction_angle']:g} deg: flow would give energy"
        )
    return None


def choices(keys):
    return {
        "VOLUME_CORRECTION": bool(keys["volume_correction"]),
        "COHESION": keys["cohesion"] > 0.0,
        "DILATANCY": keys["dilatancy_angle"] > 0.0,
    }


def state_fields(keys):
    kept = {"hencky_strain": True, "v_c": keys["volume_correction"], "v_p": keys["dilatancy_angle"] > 0.0}
    return tuple(field for field in STATE if kept[field.name])


def friction_slope(friction_angle, fit, dim):
    """alpha of |dev tau| + alpha tr tau <= k, for an angle in degrees.

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


def strength(cohesion, friction_angle, fit, dim):
    """k of |dev tau| + alpha tr tau <= k in Pa: d c alpha / tan(phi), written so that phi may be zero."""
    phi = math.radians(friction_angle)
    if fit is None:
        fit = "plane_strain" if dim == 2 else "triaxial"
    if fit == "triaxial":
        over_tangent = math.sqrt(2.0 / 3.0) * 2.0 * math.cos(phi) / (3.0 - math.sin(phi))
    elif dim == 2:
        over_tangent = math.cos(phi) / math.sqrt(2.0)
    else:
        over_tangent = math.sqrt(2.0) / math.sqrt(9.0 + 12.0 * math.tan(phi) ** 2)
    return dim * cohesion * over_tangent


def parameters(keys, dim):
    """(mu in Pa, lam in Pa, slope of the cone in strains), and behind them what the options need.

    With cohesion (radius of the cone at tr E = 0, tr E of the tip: hencky.NEVER without friction), with dilatancy (d a, the
    share of y that flows).
    """
    mu, lam = lame(keys["youngs_modulus"], keys["poisson_ratio"])
    phi, psi, fit = keys["friction_angle"], keys.get("dilatancy_angle") or 0.0, keys.get("friction_fit")
    slope = friction_slope(phi, fit, dim) * (dim * lam + 2.0 * mu) / (2.0 * mu)
    params = mu, lam, slope
    if keys.get("cohesion"):
        radius = strength(keys["cohesion"], phi, fit, dim) / (2.0 * mu)
        params += radius, (radius / slope if slope > 0.0 else hencky.NEVER)
    if psi > 0.0:
        dilation = dim * friction_slope(psi, fit, dim)
        params += dilation, 1.0 / (1.0 + slope * dilation)
    return params


def state_at(F, params):
    E, zero = hencky.strain_of(F), la.det(F) - la.det(F)
    if VOLUME_CORRECTION and DILATANCY:
        return E + (zero, zero)
    if VOLUME_CORRECTION or DILATANCY:
        return E + (zero,)
    return E


def kirchhoff_stress(state, params):
    mu, lam = params[0], params[1]
    E = la.symmetric_part(state)
    return la.scale_plus_diagonal(2.0 * mu, E, lam * la.trace_symmetric(E))


def out_of_plane_stress(state, params):
    return params[1] * la.trace_symmetric(la.symmetric_part(state))


def advance(state, G, dt, params):
    slope = params[2]
    E = hencky.trial_strain(la.symmetric_part(state), G)
    trace = la.trace_symmetric(E)
    D = la.scale_plus_diagonal(1.0, E, -trace / la.DIM)
    if VOLUME_CORRECTION:
        trace = trace + la.after_symmetric(state)
    norm = la.norm_symmetric(D)
    if DILATANCY:
        gained, trace = dilated(norm, trace, params)
    if COHESION:
        closed = min(trace, params[4])
        # At the tip, round-off may leave a radius below zero.
        shrink = min(1.0, max(params[3] - slope * closed, 0.0) / max(norm, TINY))
    else:
        closed = min(trace, 0.0)
        shrink = min(1.0, slope * -closed / max(norm, TINY))
    kept = where(la.det(la.identity_plus(G)) > 0.0, shrink, NAN)
    E = la.scale_plus_diagonal(kept, D, closed / la.DIM)
    if DILATANCY:
        if VOLUME_CORRECTION:
            return E + (trace - closed, state[-1] + gained)
        return E + (state[-1] + gained + (trace - closed),)
    if VOLUME_CORRECTION:
        return E + (trace - closed,)
    return E


def dilated(norm, trace, params):
    """(plastic expansion by flow, what it leaves of the trace) for a trial strain with |dev E| = norm."""
    dilation, share = params[-2], params[-1]
    y = norm + params[2] * trace
    if COHESION:
        y = y - params[3]
    gained = dilation * min(max(y * share, 0.0), norm)
    return gained, trace - gained


def valid(state):
    finite = la.norm_symmetric(la.symmetric_part(state)) < hencky.LARGEST
    if DILATANCY:
        return finite & (state[-1] == state[-1])
    return finite


def volume_ratio(state):
    """The whole one; without volume correction and dilatancy, which leave no trace of openings, that of E."""
    log_J = la.trace_symmetric(la.symmetric_part(state))
    if VOLUME_CORRECTION:
        log_J = log_J + la.after_symmetric(state)
    if DILATANCY:
        log_J = log_J + state[-1]
    return expm1(log_J) + 1.0


def wave_speed_squared(state, params, density):
    """Upper bound of (lam + 2 mu - 2 mu ln F - lam ln J) / rho0, the spatial P-wave speed squared along a principal axis.

    It bounds the waves along other axes too while no elastic strain is beyond 1; at 2, shear waves exceed it by 12 %.
    """
    mu, lam = params[0], params[1]
    E = la.symmetric_part(state)
    trace = la.trace_symmetric(E)
    if COHESION:  # tension, in which a negative lam stiffens
        stiffer = 2.0 * mu * la.row_sum_bound(E) + max(-lam * trace, 0.0)
    else:
        stiffer = 2.0 * mu * la.row_sum_bound(E) - lam * min(trace, 0.0)
    return (lam + 2.0 * mu + stiffer) / density


def energy(state, params):
    mu, lam = params[0], params[1]
    E = la.symmetric_part(state)
    norm, trace = la.norm_symmetric(E), la.trace_symmetric(E)
    return mu * norm * norm + 0.5 * lam * trace * trace
