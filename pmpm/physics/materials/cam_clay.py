"""Modified Cam-Clay: logarithmic elasticity with an energy, elliptic yield surface, hardening by plastic compression.

With the elastic Hencky strain E, v = tr E, P = p + attraction and p = -tr tau / 3: P = P_0 exp(-v / kappa), tau = (attraction
- P) I + 2 mu dev E, the derivative of psi = kappa P + attraction v + mu |dev E|^2. P_0 belongs to the undeformed particle,
whose pressure is `initial_pressure`. Yield: (q / M)^2 + P (P - P_c) <= 0, q = sqrt(3/2) |dev tau|, flow associated, and
d ln P_c = -d(plastic volume strain) / (lambda - kappa). So ln P falls by 1/lambda per volume strain along isotropic
consolidation, by 1/kappa in unloading, and shearing without change of volume ends at q = M P.

`attraction`, c cot(phi), moves all of it along the axis of pressure: it gives the stiffness attraction / kappa at zero
pressure, where the logarithmic law alone has none, and a small cohesion. Mean tension is cut off (shear is not): beyond p = 0
the particle opens, and `v_c`, the logarithmic volume gained, must be undone before pressure returns. Without attraction p
cannot fall to zero and nothing is cut. The shear modulus is constant: a constant Poisson's ratio has no energy (Zytynski et
al. 1978).

The return is implicit. On the ellipse q = M P_c sin(t) / 2, P = P_c (1 + cos t) / 2, all is a function of u = tan(t/2) (its
inverse where the trial lies on the dry side), and consistency one smooth equation between the trial's u and 1, the critical
state. Sources: Borja and Tamagnini, Comput. Methods Appl. Mech. Engrg. 155 (1998) 73; Roscoe and Burland (1968).
"""

import math

from pmpm.physics import hencky
from pmpm.physics import tensors2 as la
from pmpm.physics.materials.keys import DENSITY, Key, StateField
from pmpm.physics.words import EPS, TINY, any_of, exp, log, sqrt, where

WORK = 192
SOURCE = "Borja and Tamagnini (1998), Comput. Methods Appl. Mech. Engrg. 155, 73"
KEYS = (
    DENSITY,
    Key("shear_modulus", "Pa", "stiffness in shear, constant", above=0.0),
    Key(
        "swelling_index", "-", "kappa, fall of the logarithm of volume per logarithm of pressure, unloading", above=0.0
    ),
    Key("compression_index", "-", "lambda, the same in first loading, more than swelling_index", above=0.0),
    Key(
        "critical_state_slope",
        "-",
        "M, ratio of shear stress q to pressure at the critical state",
        optional=True,
        above=0.0,
    ),
    Key(
        "friction_angle",
        "deg",
        "angle of the critical state in triaxial compression, instead of critical_state_slope",
        optional=True,
        above=0.0,
        below=90.0,
    ),
    Key("preconsolidation_pressure", "Pa", "largest isotropic pressure borne so far", above=0.0),
    Key("initial_pressure", "Pa", "pressure of the undeformed particle", default=0.0, at_least=0.0),
    Key("attraction", "Pa", "cohesion over the tangent of the friction angle", default=0.0, at_least=0.0),
)
STATE = (
    StateField("elastic_strain", "solid", "-", "elastic logarithmic strain, 1/2 ln b"),
    StateField("plastic_volume", "scalar", "-", "plastic logarithmic volume strain, negative in compression"),
    StateField("v_c", "scalar", "-", "logarithmic volume gained in opening and not yet undone"),
)
ATTRACTION = False
ARRIVED = 0.01  # of eps, the square of a step that is the last
NEWTON_STEPS = 12  # at most, to round-off: see tests/physics/test_cam_clay.py for the range tried
ROOT_SIX = 2.449489742783178
LOG_TWO = 0.6931471805599453
MOST = 60.0  # logarithms of pressures over others are cut there, only to keep numbers finite


def conflicts(keys):
    given = [name for name in ("critical_state_slope", "friction_angle") if keys.get(name) is not None]
    if len(given) != 1:
        return f"give exactly one of critical_state_slope and friction_angle (deg), not {' and '.join(given) or 'none'}"
    if keys["compression_index"] <= keys["swelling_index"]:
        return (
            f"compression_index = {keys['compression_index']:g} must be above swelling_index = "
            f"{keys['swelling_index']:g}: first loading compresses more than unloading gives back"
        )
    if keys["initial_pressure"] + keys["attraction"] <= 0.0:
        return "give initial_pressure or attraction > 0 Pa: without either the clay has no stiffness to begin with"
    if keys["preconsolidation_pressure"] < keys["initial_pressure"]:
        return (
            f"preconsolidation_pressure = {keys['preconsolidation_pressure']:g} Pa must be at least initial_pressure = "
            f"{keys['initial_pressure']:g} Pa"
        )
    return None


def choices(keys):
    return {"ATTRACTION": keys["attraction"] > 0.0}


def state_fields(keys):
    return STATE if keys["attraction"] > 0.0 else STATE[:2]


def critical_state_slope(keys):
    """M; Mohr-Coulomb's 6 sin phi / (3 - sin phi) in triaxial compression."""
    if keys.get("critical_state_slope") is not None:
        return keys["critical_state_slope"]
    sine = math.sin(math.radians(keys["friction_angle"]))
    return 6.0 * sine / (3.0 - sine)


def parameters(keys, dim):
    """(mu in Pa, kappa, lambda, M, P_0 in Pa, ln(P_c / P_0) at the start, attraction in Pa, v at p = 0, energy at v = 0 to
    subtract in Pa)."""
    kappa, attraction = keys["swelling_index"], keys["attraction"]
    P_0 = keys["initial_pressure"] + attraction
    log_ratio = math.log((keys["preconsolidation_pressure"] + attraction) / P_0)
    opening = kappa * math.log(P_0 / attraction) if attraction > 0.0 else 0.0
    offset = attraction * (kappa + opening)
    slopes = kappa, keys["compression_index"], critical_state_slope(keys)
    return keys["shear_modulus"], *slopes, P_0, log_ratio, attraction, opening, offset


def pressure(E, params):
    """P = p + attraction."""
    mu, kappa, slope, M, P_0, log_ratio, attraction, opening, offset = params
    return P_0 * exp(min(-la.trace_solid(E) / kappa, MOST))


def state_at(F, params):
    zero = la.det(F) - la.det(F)
    E = hencky.strain_of_solid(F)
    if ATTRACTION:
        return E + (zero, zero)
    return E + (zero,)


def kirchhoff_stress(state, params):
    mu, kappa, slope, M, P_0, log_ratio, attraction, opening, offset = params
    E = la.solid_part(state)
    isotropic = attraction - pressure(E, params)
    return la.scale_plus_diagonal(2.0 * mu, la.in_plane(E), isotropic - 2.0 / 3.0 * mu * la.trace_solid(E))


def out_of_plane_stress(state, params):
    mu, kappa, slope, M, P_0, log_ratio, attraction, opening, offset = params
    E = la.solid_part(state)
    return attraction - pressure(E, params) + 2.0 * mu * (la.out_of_plane(E) - la.trace_solid(E) / 3.0)


def returned(log_r, a, b, ratio, wet):
    """(ln of trial over final P / P_c, sin t / 2) of the return from a trial with ln(2 P / P_c) = log_r, `wet` above 0.

    a = 2 q / (M P_c) of the trial, b = 6 mu kappa (lambda - kappa) / (lambda M^2 P_c), ratio = kappa / lambda. Newton's method
    from the trial's own u; 0 <= u <= 1. A particle whose last step was less than a tenth of the root of eps is done, since
    convergence is quadratic.
    """
    near = exp(-min(abs(log_r), MOST))
    lowest = sqrt(max(where(wet, 2.0 * near - 1.0, near / (2.0 - near)), 0.0))
    sign = where(wet, 1.0, -1.0)
    u = lowest
    step = sign
    for _ in range(NEWTON_STEPS):
        moving = step * step > ARRIVED * EPS
        if any_of(moving):
            square = u * u
            w = 1.0 + square
            way = log_r - log(2.0 * where(wet, 1.0, square) / w)
            size = sign * way
            c = exp(ratio * way)
            other = where(wet, square, 1.0)
            over = a * w - 2.0 * u * c
            f = (1.0 - square) * over - 2.0 * b * u * w * size
            turn = (1.0 - square) * (2.0 * u * a - 2.0 * c - 4.0 * c * ratio * sign * other / w)
            slope = turn - 2.0 * u * over - 2.0 * b * (size * (w + 2.0 * square) + 2.0 * other)
            moved = min(max(u - f / slope, lowest), 1.0)
            step, u = where(moving, moved - u, step), where(moving, moved, u)
    square = u * u
    way = log_r - log(2.0 * where(wet, 1.0, square) / (1.0 + square))
    return way, u / (1.0 + square)


def advance(state, G, dt, params):
    mu, kappa, slope, M, P_0, log_ratio, attraction, opening, offset = params
    rest = la.after_solid(state)
    plastic_volume = rest[0]
    E = hencky.trial_strain_solid(la.solid_part(state), G)
    trace = la.trace_solid(E)
    D = la.scale_plus_diagonal_solid(1.0, E, -trace / 3.0)
    if ATTRACTION:
        total = trace + rest[1]
        trace = min(total, opening)
        v_c = total - trace
    log_P_c = log_ratio - plastic_volume / (slope - kappa)
    log_r = LOG_TWO - trace / kappa - log_P_c
    norm = la.norm_solid(D)
    P_c = P_0 * exp(max(min(log_P_c, MOST), -MOST))
    a = (2.0 * ROOT_SIX) * mu * norm / (M * P_c)
    from_centre = exp(max(min(log_r, MOST), -MOST)) - 1.0
    outside = from_centre * from_centre + a * a > 1.0
    volume = norm - norm
    kept = 1.0 + volume
    if any_of(outside):
        way_of_volume = kappa * (slope - kappa) / slope
        way, half_sine = returned(
            where(outside, log_r, 0.0), where(outside, a, 2.0), 6.0 * mu * way_of_volume / (M * M * P_c), kappa / slope,
            log_r > 0.0,
        )  # fmt: skip
        volume = where(outside, way_of_volume * way, volume)
        grown = M * P_c * exp(max(min(kappa / slope * way, MOST), -MOST))
        kept = where(outside, min(grown * half_sine / max(ROOT_SIX * mu * norm, TINY), 1.0), kept)
    E = la.scale_plus_diagonal_solid(kept * hencky.kept_if_forward(G), D, (trace + volume) / 3.0)
    if ATTRACTION:
        return E + (plastic_volume - volume, v_c)
    return E + (plastic_volume - volume,)


def valid(state):
    size = la.norm_solid(la.solid_part(state))
    return (size < hencky.LARGEST) & (abs(la.after_solid(state)[0]) < hencky.LARGEST)


def volume_ratio(state):
    rest = la.after_solid(state)
    log_J = la.trace_solid(la.solid_part(state)) + rest[0]
    if ATTRACTION:
        return exp(log_J + rest[1])
    return exp(log_J)


def wave_speed_squared(state, params, density):
    """Upper bound of (P / kappa + 4/3 mu - tau) / rho0, the spatial P-wave speed squared along an axis."""
    mu, kappa, slope, M, P_0, log_ratio, attraction, opening, offset = params
    E = la.solid_part(state)
    D = la.scale_plus_diagonal(1.0, la.in_plane(E), -la.trace_solid(E) / 3.0)
    P = pressure(E, params)
    return (P / kappa + P + mu * (4.0 / 3.0 + 2.0 * la.row_sum_bound(D))) / density


def energy(state, params):
    """Elastic, counted from p = 0; without attraction from the infinite expansion that this would need."""
    mu, kappa, slope, M, P_0, log_ratio, attraction, opening, offset = params
    E = la.solid_part(state)
    trace = la.trace_solid(E)
    norm = la.norm_solid(la.scale_plus_diagonal_solid(1.0, E, -trace / 3.0))
    return kappa * pressure(E, params) + attraction * trace - offset + mu * norm * norm
