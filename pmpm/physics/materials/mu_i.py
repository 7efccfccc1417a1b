"""Dense granular flow: Hencky elasticity, and plastic shear at the rate of the mu(I) rheology; free where it is not dense.

psi = mu |E|^2 + lam/2 (tr E)^2 in the elastic Hencky strain E, p = -tr tau / 3, equivalent shear stress s = |dev tau| / sqrt 2.
Flow: s = mu(I) p with mu(I) = mu_s + (mu_2 - mu_s) / (I_0 / I + 1), I = gamma_dot d sqrt(rho_s / p), where s would exceed
mu_s p; rigid but for the elasticity below it. gamma_dot = sqrt 2 |D_p|, along dev E and without change of volume. Backward
Euler in time: the shear stress at the end of a step is the smaller root of a quadratic, so that neither stiffness nor
viscosity of the flow bound the step. Looser than `density`, grains do not touch: no stress, and `v_c`, the logarithmic volume
gained since they parted, must be undone before pressure returns. Pressure is Kirchhoff's here, J p: J is within p over the
bulk modulus of 1. Sources: Jop, Forterre, Pouliquen, Nature 441 (2006) 727; Dunatunga and Kamrin, J. Fluid Mech. 779 (2015)
483, section 3.2; the bookkeeping of volume as in Tampubolon et al., ACM Trans. Graph. 36 (2017) 105, section 4.3.4.
"""

import math

from pmpm.physics import hencky
from pmpm.physics import tensors2 as la
from pmpm.physics.materials.keys import ELASTIC_KEYS, Key, StateField, lame, no_choices
from pmpm.physics.words import TINY, exp, sqrt, where

WORK = 115
SOURCE = "Jop, Forterre and Pouliquen (2006), Nature 441, 727; Dunatunga and Kamrin (2015), J. Fluid Mech. 779, 483"
KEYS = (
    *ELASTIC_KEYS,
    Key("static_friction", "-", "mu_s, ratio of shear stress to pressure at rest", optional=True, above=0.0),
    Key(
        "friction_angle",
        "deg",
        "steepest incline on which a layer rests, instead of static_friction, its tangent",
        optional=True,
        above=0.0,
        below=90.0,
    ),
    Key("dynamic_friction", "-", "mu_2, the ratio in the fastest flow", above=0.0),
    Key("reference_inertial_number", "-", "I_0, where the ratio is half way between both", default=0.279, above=0.0),
    Key("grain_diameter", "m", "diameter of a grain", above=0.0),
    Key("grain_density", "kg/m3", "density of the grains themselves", above=0.0),
)
STATE = (
    StateField("elastic_strain", "solid", "-", "elastic logarithmic strain, 1/2 ln b"),
    StateField("v_c", "scalar", "-", "logarithmic volume gained since the grains parted and not yet undone"),
)
ROOT_TWO = 1.4142135623730951
choices = no_choices


def static_friction(keys):
    if keys.get("friction_angle") is not None:
        return math.tan(math.radians(keys["friction_angle"]))
    return keys["static_friction"]


def conflicts(keys):
    given = [name for name in ("static_friction", "friction_angle") if keys.get(name) is not None]
    if len(given) != 1:
        return f"give exactly one of static_friction and friction_angle (deg), not {' and '.join(given) or 'none'}"
    if keys["dynamic_friction"] < static_friction(keys):
        return (
            f"dynamic_friction = {keys['dynamic_friction']:g} must be at least the static friction, "
            f"{static_friction(keys):.6g}: friction that falls with the rate has no steady flow"
        )
    if keys["density"] > keys["grain_density"]:
        return (
            f"density = {keys['density']:g} kg/m3, that of grains and gaps, must be at most grain_density = "
            f"{keys['grain_density']:g} kg/m3"
        )
    return None


def state_fields(keys):
    return STATE


def parameters(keys, dim):
    """(mu in Pa, lam in Pa, mu_s, mu_2, I_0 / (d sqrt rho_s): shear rate at I_0 over the root of the pressure)."""
    mu, lam = lame(keys["youngs_modulus"], keys["poisson_ratio"])
    rate = keys["reference_inertial_number"] / (keys["grain_diameter"] * math.sqrt(keys["grain_density"]))
    return mu, lam, static_friction(keys), keys["dynamic_friction"], rate


def state_at(F, params):
    return hencky.strain_of_solid(F) + (la.det(F) - la.det(F),)


def kirchhoff_stress(state, params):
    mu, lam, static, dynamic, rate = params
    return hencky.stress(la.solid_part(state), mu, lam)


def out_of_plane_stress(state, params):
    mu, lam, static, dynamic, rate = params
    return hencky.out_of_plane_stress(la.solid_part(state), mu, lam)


def sheared(trial, s_static, s_dynamic, a):
    """The elastic shear g at the end of a step: the smaller root of (trial - g)(s_dynamic - g) = a (g - s_static).

    All are stresses over the shear modulus; a is the plastic shear of a step at I_0. The discriminant is written as a sum of
    what is not negative, the root as a quotient: nothing cancels.
    """
    b = s_dynamic + trial + a
    difference = trial - s_dynamic + a
    root = sqrt(difference * difference + 4.0 * a * (s_dynamic - s_static))
    return 2.0 * (s_dynamic * trial + s_static * a) / max(b + root, TINY)


def advance(state, G, dt, params):
    mu, lam, static, dynamic, rate = params
    (v_c,) = la.after_solid(state)
    E = hencky.trial_strain_solid(la.solid_part(state), G)
    trace = la.trace_solid(E)
    D = la.scale_plus_diagonal_solid(1.0, E, -trace / 3.0)
    trace = trace + v_c
    closed = min(trace, 0.0)
    pressure = -(lam + 2.0 / 3.0 * mu) * closed
    trial = ROOT_TWO * la.norm_solid(D)
    over_modulus = pressure / mu
    s_static = static * over_modulus
    flowing = sheared(trial, s_static, dynamic * over_modulus, dt * rate * sqrt(pressure))
    kept = where(trial > s_static, min(flowing / max(trial, TINY), 1.0), 1.0)
    E = la.scale_plus_diagonal_solid(kept * hencky.kept_if_forward(G), D, closed / 3.0)
    return E + (trace - closed,)


def valid(state):
    return la.norm_solid(la.solid_part(state)) < hencky.LARGEST


def volume_ratio(state):
    (v_c,) = la.after_solid(state)
    return exp(la.trace_solid(la.solid_part(state)) + v_c)


def wave_speed_squared(state, params, density):
    mu, lam, static, dynamic, rate = params
    return hencky.wave_modulus(la.solid_part(state), mu, lam) / density


def energy(state, params):
    mu, lam, static, dynamic, rate = params
    return hencky.energy(la.solid_part(state), mu, lam)
