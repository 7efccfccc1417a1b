"""Mud and debris: Bingham or Herschel-Bulkley flow on a deviatoric elasticity, pressure from the Tait equation of state.

psi = U(J) + mu |dev E|^2 in the elastic Hencky strain E, whose trace is ln J; U and p are those of the fluid, and p is never
below zero: what has opened bears no tension, but still shears as before. Flow: s = |dev tau| / sqrt 2 = yield_stress +
viscosity gamma_dot^flow_index, where s would exceed yield_stress; below it the mud is elastic, so that it comes to rest.
gamma_dot = sqrt 2 |D_p| along dev E. Backward Euler in time: closed form for flow_index 1, else Newton's method on a convex
and almost straight function of one logarithm; no viscous bound of the step. Stresses are Kirchhoff's.
Source: Yue et al., ACM Trans. Graph. 34 (2015) 160, sections 3 and 4, here in logarithmic strains.
"""

from pmpm.physics import hencky
from pmpm.physics import tensors2 as la
from pmpm.physics.materials.fluid import STIFFNESS, bulk_modulus_of, stiffness_conflict
from pmpm.physics.materials.keys import DENSITY, Key, StateField
from pmpm.physics.words import EPS, TINY, any_of, exp, expm1, log, log1p, where

WORK = 135
SOURCE = "Yue et al. (2015), ACM Trans. Graph. 34, 160"
KEYS = (
    DENSITY,
    *STIFFNESS,
    Key("shear_modulus", "Pa", "stiffness in shear below yield", above=0.0),
    Key("yield_stress", "Pa", "shear stress at which it begins to flow", at_least=0.0),
    Key("viscosity", "Pa s^n", "consistency: plastic viscosity where flow_index is 1", at_least=0.0),
    Key("flow_index", "-", "n, below 1 thinner the faster", default=1.0, at_least=0.1, at_most=10.0),
)
STATE = (StateField("elastic_strain", "solid", "-", "elastic logarithmic strain; its trace is ln J"),)
LOGARITHMIC = False  # gamma = 1
LINEAR = True  # flow_index = 1
THICKENING = False  # flow_index > 1
ARRIVED = 0.01  # of eps, the square of a step that is the last
NEWTON_STEPS = 8  # at most, to round-off for every flow_index allowed
ROOT_TWO = 1.4142135623730951


def conflicts(keys):
    if keys["flow_index"] != 1.0 and keys["viscosity"] == 0.0:
        return f"viscosity = 0 Pa s^n leaves nothing for flow_index = {keys['flow_index']:g} to act on: leave flow_index out"
    return stiffness_conflict(keys)


def choices(keys):
    n = keys["flow_index"]
    return {"LOGARITHMIC": keys["gamma"] == 1.0, "LINEAR": n == 1.0, "THICKENING": n > 1.0}


def state_fields(keys):
    return STATE


def parameters(keys, dim):
    """(bulk modulus in Pa, gamma, mu in Pa, elastic shear at yield, viscosity / mu in s^n, n)."""
    mu = keys["shear_modulus"]
    ratios = keys["yield_stress"] / mu, keys["viscosity"] / mu
    return bulk_modulus_of(keys), keys["gamma"], mu, *ratios, keys["flow_index"]


def volume_stress(log_J, params):
    """-J p; differences of expm1, so that small strains keep their digits."""
    bulk_modulus, gamma, mu, yield_strain, time, n = params
    closed = min(log_J, 0.0)
    return -(bulk_modulus / gamma) * (expm1((1.0 - gamma) * closed) - expm1(closed))


def state_at(F, params):
    return hencky.strain_of_solid(F)


def kirchhoff_stress(E, params):
    bulk_modulus, gamma, mu, yield_strain, time, n = params
    trace = la.trace_solid(E)
    return la.scale_plus_diagonal(2.0 * mu, la.in_plane(E), volume_stress(trace, params) - 2.0 / 3.0 * mu * trace)


def out_of_plane_stress(E, params):
    bulk_modulus, gamma, mu, yield_strain, time, n = params
    trace = la.trace_solid(E)
    return 2.0 * mu * (la.out_of_plane(E) - trace / 3.0) + volume_stress(trace, params)


def share_of_flow(excess, dt, time, n):
    """Which part of the elastic shear beyond yield, `excess`, is left at the end of a step.

    With y the part that flows, y + k y^n = 1, k = time excess^(n - 1) / dt^n. With w = ln y and m = n where n < 1, else
    w = ln(k y^n) and m = 1/n, it is ln(e^w + k' e^(m w)) = 0: convex in w, with slopes from m to 1. Newton's method goes
    there from above without overshooting. A particle whose last step was less than a tenth of the root of eps is done, since
    convergence is quadratic.
    """
    if LINEAR:
        return time / (time + dt)
    log_k = log(time) + (n - 1.0) * log(excess) - n * log(dt)
    m = n
    if THICKENING:
        log_k = -log_k / n
        m = 1.0 / n
    w = min(-log_k / m, 0.0)
    step = w - w + 1.0
    for _ in range(NEWTON_STEPS):
        moving = step * step > ARRIVED * EPS
        if any_of(moving):
            d = log_k + (m - 1.0) * w
            smaller = exp(-abs(d))
            share = where(d > 0.0, smaller, 1.0) / (1.0 + smaller)
            step = where(moving, (w + max(d, 0.0) + log1p(smaller)) / (share + m * (1.0 - share)), step)
            w = where(moving, w - step, w)
    if THICKENING:
        return exp(w)
    return exp(log_k + m * w)


def advance(E, G, dt, params):
    """The deviator is advanced by itself, so that what has opened far stays within the power series."""
    bulk_modulus, gamma, mu, yield_strain, time, n = params
    log_J = la.trace_solid(E)
    D = hencky.trial_strain_solid(la.scale_plus_diagonal_solid(1.0, E, -log_J / 3.0), G)
    change = la.trace_solid(D)
    D = la.scale_plus_diagonal_solid(1.0, D, -change / 3.0)
    shear = ROOT_TWO * la.norm_solid(D)
    flowing = shear > yield_strain
    kept = 1.0 + (shear - shear)
    if any_of(flowing):
        excess = where(flowing, shear - yield_strain, 1.0)
        left = (yield_strain + excess * share_of_flow(excess, dt, time, n)) / max(shear, TINY)
        kept = where(flowing, min(left, 1.0), kept)
    return la.scale_plus_diagonal_solid(kept * hencky.kept_if_forward(G), D, (log_J + change) / 3.0)


def valid(E):
    return la.norm_solid(E) < hencky.LARGEST


def volume_ratio(E):
    return exp(la.trace_solid(E))


def wave_speed_squared(E, params, density):
    """Upper bound of (B J^(1 - gamma) + 4/3 mu - 2 mu dev ln F) / rho0, the spatial P-wave speed squared along an axis."""
    bulk_modulus, gamma, mu, yield_strain, time, n = params
    trace = la.trace_solid(E)
    D = la.scale_plus_diagonal(1.0, la.in_plane(E), -trace / 3.0)
    shear = mu * (4.0 / 3.0 + 2.0 * la.row_sum_bound(D))
    return (bulk_modulus * exp((1.0 - gamma) * min(trace, 0.0)) + shear) / density


def energy(E, params):
    """Elastic: work of compression, none once opened, and of shear."""
    bulk_modulus, gamma, mu, yield_strain, time, n = params
    trace = la.trace_solid(E)
    norm = la.norm_solid(la.scale_plus_diagonal_solid(1.0, E, -trace / 3.0))
    closed = min(trace, 0.0)
    if LOGARITHMIC:
        volume = bulk_modulus * (expm1(closed) - closed)
    else:
        volume = bulk_modulus / gamma * (expm1((1.0 - gamma) * closed) / (gamma - 1.0) + expm1(closed))
    return volume + mu * norm * norm
