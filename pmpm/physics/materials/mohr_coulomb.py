"""Soil and rock: Hencky elasticity inside Mohr and Coulomb's pyramid, with dilatancy, tension cut-off and softening.

psi = mu |E|^2 + lam/2 (tr E)^2 in the elastic Hencky strain E, whose out-of-plane entry is kept in plane strain; tau = 2 mu E +
lam tr E I. Yield: (tau_1 - tau_3) + (tau_1 + tau_3) sin(phi) <= 2 c cos(phi), for principal Kirchhoff stresses tau_1 >= tau_2
>= tau_3, tension positive. Flow follows the same pyramid with the dilatancy angle psi in place of phi.

Return: in principal strains e_1 >= e_2 >= e_3, in closed form. First to the plane above, where flow is along (1 + sin psi, 0,
-1 + sin psi). Where that breaks the order, to the edge e_2 = e_3 (triaxial compression) or e_1 = e_2 (extension), on which two
planes flow together. Where that breaks it too, to the apex tau = c / tan(phi) I: the tension cut-off, reached without regard
to psi. The plane of e that contains the hydrostatic axis and the flow tells which edge. Without friction there is no apex.

Softening: c and phi fall linearly with the accumulated plastic strain e_p, from their values at 0 to residual ones at
`softening_strain`. A step increases e_p by sqrt(2/3) |dev dE_p| and returns to the strength of its beginning, so that the
return stays closed; the strength lags by one step. Softening localises in bands as wide as the grid's cells allow.

What is opened at the apex closes without resistance and is forgotten, so that volume ratios are the elastic ones; with
dilatancy, `v_p` holds all plastic expansion, and volume ratios are whole.
Source: de Souza Neto, Peric, Owen, Computational Methods for Plasticity (2008), section 8.2.
"""

import math

from pmpm.physics import hencky
from pmpm.physics import tensors2 as la
from pmpm.physics.materials.keys import DILATANCY_ANGLE, ELASTIC_KEYS, FRICTION_ANGLE, Key, StateField, lame
from pmpm.physics.words import TINY, any_of, expm1, sqrt, where

WORK = 134
SOURCE = "de Souza Neto, Peric, Owen (2008), section 8.2"
KEYS = (
    *ELASTIC_KEYS,
    Key("cohesion", "Pa", "shear strength without pressure", at_least=0.0),
    FRICTION_ANGLE,
    DILATANCY_ANGLE,
    Key("residual_cohesion", "Pa", "cohesion once softened; default: no softening of it", optional=True, at_least=0.0),
    Key(
        "residual_friction_angle",
        "deg",
        "friction angle once softened; default: no softening of it",
        optional=True,
        at_least=0.0,
        below=90.0,
    ),
    Key("softening_strain", "-", "accumulated plastic strain at which strength is residual", optional=True, above=0.0),
)
STATE = (
    StateField("elastic_strain", "solid", "-", "elastic logarithmic strain, 1/2 ln b"),
    StateField("e_p", "scalar", "-", "accumulated plastic strain, sqrt(2/3) |dev| of each increment"),
    StateField("v_p", "scalar", "-", "logarithmic plastic volume"),
)
PLASTIC_STRAIN = "e_p"
SOFTENING = False
DILATANCY = False
# sin x = x (1 - x^2/3! + ...), the highest power of x^2 first: to round-off up to a right angle.
SINE = tuple((-1.0) ** n / math.factorial(2 * n + 1) for n in range(10, -1, -1))
RIGHT_ANGLE = 0.5 * math.pi
DET_TO_SINE = 3.0 * math.sqrt(6.0)  # det of dev E / |dev E| to sin(3 t) of Lode's angle t
ROOT_2, ROOT_2_3 = math.sqrt(2.0), math.sqrt(2.0 / 3.0)
# Tangents of sin(t) over sin(3 t) at t = -15, -25 and -29 degrees: (height at 0, slope).
TANGENTS = tuple(
    (
        math.sin(t) - math.sin(3.0 * t) * math.cos(t) / (3.0 * math.cos(3.0 * t)),
        math.cos(t) / (3.0 * math.cos(3.0 * t)),
    )
    for t in (math.radians(-15.0), math.radians(-25.0), math.radians(-29.0))
)
(HEIGHT_15, SLOPE_15), (HEIGHT_25, SLOPE_25), (HEIGHT_29, SLOPE_29) = TANGENTS


def residual(keys):
    """(cohesion in Pa, friction angle in degrees) once softened."""
    cohesion, angle = keys.get("residual_cohesion"), keys.get("residual_friction_angle")
    return keys["cohesion"] if cohesion is None else cohesion, keys["friction_angle"] if angle is None else angle


def conflicts(keys):
    c, phi, psi = keys["cohesion"], keys["friction_angle"], keys.get("dilatancy_angle") or 0.0
    residual_c, residual_phi = residual(keys)
    softens = [name for name in ("residual_cohesion", "residual_friction_angle") if keys.get(name) is not None]
    if softens and keys.get("softening_strain") is None:
        return f"{softens[0]} = {keys[softens[0]]:g} needs softening_strain, the strain at which it is reached"
    if keys.get("softening_strain") is not None and not softens:
        return (
            f"softening_strain = {keys['softening_strain']:g} needs residual_cohesion (Pa) or "
            "residual_friction_angle (deg) to soften to"
        )
    if residual_c > c:
        return f"residual_cohesion = {residual_c:g} Pa must be at most cohesion = {c:g} Pa"
    if residual_phi > phi:
        return f"residual_friction_angle = {residual_phi:g} deg must be at most friction_angle = {phi:g} deg"
    if psi > residual_phi:
        name = "residual_friction_angle" if residual_phi < phi else "friction_angle"
        return f"dilatancy_angle = {psi:g} deg must be at most {name} = {residual_phi:g} deg: flow would give energy"
    return None


def choices(keys):
    return {"SOFTENING": keys.get("softening_strain") is not None, "DILATANCY": keys["dilatancy_angle"] > 0.0}


def state_fields(keys):
    kept = {
        "elastic_strain": True,
        "e_p": keys.get("softening_strain") is not None,
        "v_p": keys["dilatancy_angle"] > 0.0,
    }
    return tuple(field for field in STATE if kept[field.name])


def parameters(keys, dim):
    """(mu in Pa, lam in Pa, lam / mu, sin psi), then the strength.

    Without softening (sin phi, c cos(phi) / mu, strain along each axis at the apex, hencky.NEVER without friction); with
    softening (c / mu and its fall, phi in radians and its fall, 1 / softening_strain).
    """
    mu, lam = lame(keys["youngs_modulus"], keys["poisson_ratio"])
    c, phi = keys["cohesion"], math.radians(keys["friction_angle"])
    elastic = mu, lam, lam / mu, math.sin(math.radians(keys.get("dilatancy_angle") or 0.0))
    if keys.get("softening_strain") is not None:
        residual_c, residual_phi = residual(keys)
        fall = phi - math.radians(residual_phi)
        return *elastic, c / mu, (c - residual_c) / mu, phi, fall, 1.0 / keys["softening_strain"]
    apex = c / math.tan(phi) / (3.0 * lam + 2.0 * mu) if phi > 0.0 else hencky.NEVER
    return *elastic, math.sin(phi), c * math.cos(phi) / mu, apex


def sine(x):
    """sin x of an angle between 0 and a right one."""
    y = x * x
    total = y - y
    for coefficient in SINE:
        total = total * y + coefficient
    return x * total


def pyramid(state, params):
    """(sin phi, c cos(phi) / mu, strain at the apex) of the yield surface of a particle.

    Divided by 2 mu it is e_1 - e_3 + (e_1 + e_3 + lam/mu tr E) sin(phi) <= c cos(phi) / mu.
    """
    if SOFTENING:
        softened = min(la.after_solid(state)[0] * params[8], 1.0)
        phi = params[6] - softened * params[7]
        s, cohesive = sine(phi), (params[4] - softened * params[5]) * sine(RIGHT_ANGLE - phi)
        return s, cohesive, cohesive / (max(s, TINY) * (3.0 * params[2] + 2.0))
    return params[4], params[5], params[6]


def range_bound(E, s):
    """Upper bound of e_1 - e_3 + s (dev e_1 + dev e_3) without eigenvectors, near in compression, for 0 <= s < 1.

    With Lode's angle t from -30 (triaxial compression) to 30 degrees, e_1 - e_3 = sqrt(2) |dev E| cos t, and the middle entry
    of dev E is -sqrt(2/3) |dev E| sin t. sin 3t = 3 sqrt(6) det(dev E / |dev E|). As a function of it sin t is odd, and
    concave below 0: there tangents bound it, above the chord; the sum grows with t as long as t < 0.
    """
    D = la.scale_plus_diagonal_solid(1.0, E, -la.trace_solid(E) / 3.0)
    norm = la.norm_solid(D)
    lode = DET_TO_SINE * la.det_solid(la.scale_plus_diagonal_solid(1.0 / max(norm, TINY), D, 0.0))
    first = min(lode / 3.0, HEIGHT_15 + SLOPE_15 * lode)
    second = min(HEIGHT_25 + SLOPE_25 * lode, HEIGHT_29 + SLOPE_29 * lode)
    below = min(first, second)
    sine_t = where(lode > 0.0, 0.5 * lode, below)
    for_cosine = where(lode > 0.0, lode / 3.0, below)
    cosine_t = sqrt(max(1.0 - for_cosine * for_cosine, 0.0))
    return norm * (ROOT_2 * cosine_t + ROOT_2_3 * s * sine_t)


def returned(e, s, cohesive, apex, params):
    """(whether principal strains e are beyond the pyramid, what the return adds to them in the same order)."""
    stiffness, p = params[2], params[3]
    a, b, c = e
    high, low = max(max(a, b), c), min(min(a, b), c)
    middle = max(min(a, b), min(max(a, b), c))
    common = s * stiffness * (a + b + c) - cohesive
    f = (1.0 + s) * high - (1.0 - s) * low + common
    both = s * p
    flow = f / (2.0 + 2.0 * both * (1.0 + stiffness))
    plane_high, plane_low = high - flow * (1.0 + p), low + flow * (1.0 - p)
    at_right = (1.0 - p) * high + (1.0 + p) * low > 2.0 * middle
    edge = 3.0 + both * (3.0 + 4.0 * stiffness)
    pair = 0.5 * (middle + low)
    flow = 2.0 * ((1.0 + s) * high - (1.0 - s) * pair + common) / (edge + s + p)
    right_high, right_low = high - flow * (1.0 + p), pair + 0.5 * flow * (1.0 - p)
    pair = 0.5 * (high + middle)
    flow = 2.0 * ((1.0 + s) * pair - (1.0 - s) * low + common) / (edge - s - p)
    left_high, left_low = pair - 0.5 * flow * (1.0 + p), low + flow * (1.0 - p)
    edge_high = where(at_right, right_high, left_high)
    edge_middle = where(at_right, right_low, left_high)
    edge_low = where(at_right, right_low, left_low)
    # Beyond the apex edges cross. Without friction they cross by round-off at most: there the trace is kept.
    tip = min(apex, (edge_high + edge_middle + edge_low) / 3.0)
    ordered = edge_high >= edge_low
    on_plane = (plane_high >= middle) & (middle >= plane_low)
    new_high = where(on_plane, plane_high, where(ordered, edge_high, tip))
    new_middle = where(on_plane, middle, where(ordered, edge_middle, tip))
    new_low = where(on_plane, plane_low, where(ordered, edge_low, tip))
    # Equal trial strains return to equal ones, so that it is no matter which of them passes for the middle one.
    added_high, added_middle, added_low = new_high - high, new_middle - middle, new_low - low
    return f > 0.0, (
        where(a == high, added_high, where(a == low, added_low, added_middle)),
        where(b == high, added_high, where(b == low, added_low, added_middle)),
        where(c == high, added_high, where(c == low, added_low, added_middle)),
    )


def state_at(F, params):
    E, zero = hencky.strain_of_solid(F), la.det(F) - la.det(F)
    if SOFTENING and DILATANCY:
        return E + (zero, zero)
    if SOFTENING or DILATANCY:
        return E + (zero,)
    return E


def kirchhoff_stress(state, params):
    return hencky.stress(la.solid_part(state), params[0], params[1])


def out_of_plane_stress(state, params):
    return hencky.out_of_plane_stress(la.solid_part(state), params[0], params[1])


def advance(state, G, dt, params):
    trial = hencky.trial_strain_solid(la.solid_part(state), G)
    trial = la.scale_plus_diagonal_solid(hencky.kept_if_forward(G), trial, 0.0)
    s, cohesive, apex = pyramid(state, params)
    trace = la.trace_solid(trial)
    beyond = range_bound(trial, s) + s * (params[2] + 2.0 / 3.0) * trace > cohesive
    E = trial
    if any_of(beyond):
        axes, e = la.principal_solid(trial)
        yields, added = returned(e, s, cohesive, apex, params)
        E = la.where_solid(beyond & yields, la.add_along_solid(trial, axes, added), trial)
    if SOFTENING or DILATANCY:
        lost = trace - la.trace_solid(E)
    if SOFTENING:
        flow = la.add_solid(trial, la.scale_plus_diagonal_solid(-1.0, E, -lost / 3.0))
        e_p = la.after_solid(state)[0] + ROOT_2_3 * la.norm_solid(flow)
        if DILATANCY:
            return E + (e_p, state[-1] + lost)
        return E + (e_p,)
    if DILATANCY:
        return E + (state[-1] + lost,)
    return E


def valid(state):
    finite = la.norm_solid(la.solid_part(state)) < hencky.LARGEST
    if SOFTENING:
        finite = finite & (la.after_solid(state)[0] >= 0.0)
    if DILATANCY:
        finite = finite & (state[-1] == state[-1])
    return finite


def volume_ratio(state):
    """The whole one with dilatancy; without, the elastic one, from which openings at the apex are missing."""
    log_J = la.trace_solid(la.solid_part(state))
    if DILATANCY:
        log_J = log_J + state[-1]
    return expm1(log_J) + 1.0


def wave_speed_squared(state, params, density):
    """Upper bound of the spatial wave speed squared; see `hencky.wave_modulus`."""
    return hencky.wave_modulus(la.solid_part(state), params[0], params[1]) / density


def energy(state, params):
    return hencky.energy(la.solid_part(state), params[0], params[1])
