"""Weakly compressible inviscid fluid with the Tait equation of state; a particle keeps only its volume ratio J.

p = B/gamma (J^-gamma - 1), never below zero: a free surface may open without suction. B = rho0 c0^2.
Source: Monaghan, J. Comput. Phys. 110 (1994) 399; tension cut-off as in the usual free-surface codes.
"""

from pmpm.physics import tensors2 as la
from pmpm.physics.materials.keys import DENSITY, Key, StateField
from pmpm.physics.words import exp, log

SOURCE = "Monaghan (1994), J. Comput. Phys. 110, 399"
KEYS = (
    DENSITY,
    Key(
        "sound_speed",
        "m/s",
        "speed of sound at rest; ten times the flow speed keeps the density within 1 %",
        optional=True,
        above=0.0,
    ),
    Key("bulk_modulus", "Pa", "stiffness against compression, instead of sound_speed", optional=True, above=0.0),
    Key("gamma", "-", "exponent of the Tait equation", default=7.0, at_least=1.0, at_most=20.0),
    Key("viscosity", "Pa s", "dynamic viscosity", default=0.0, at_least=0.0, only=0.0),
)
STATE = (StateField("J", "scalar", "-", "volume ratio", 1.0),)
LOGARITHMIC = False  # gamma = 1 integrates to a logarithm
NEWTON_STEPS = 6  # to round-off from where weight / gamma, the compression at rest stiffness, is up to 1
SMALLEST = 1e-4  # volume ratios below it only keep the logarithm finite until `valid` stops the run


def conflicts(keys):
    given = [name for name in ("sound_speed", "bulk_modulus") if keys.get(name) is not None]
    if len(given) != 1:
        return f"give exactly one of sound_speed (m/s) and bulk_modulus (Pa), not {' and '.join(given) or 'none'}"
    return None


def choices(keys):
    return {"LOGARITHMIC": keys["gamma"] == 1.0}


def state_fields(keys):
    return STATE


def parameters(keys, dim):
    """(bulk modulus in Pa, gamma)."""
    if keys.get("bulk_modulus") is not None:
        return keys["bulk_modulus"], keys["gamma"]
    return keys["density"] * keys["sound_speed"] * keys["sound_speed"], keys["gamma"]


def pressure(J, params):
    bulk_modulus, gamma = params
    return max(bulk_modulus / gamma * (exp(-gamma * log(max(J, SMALLEST))) - 1.0), 0.0)


def hydrostatic_state(depth, gravity, params, density):
    """State in equilibrium under `depth` (m) of the same fluid, whose particles are spaced as at rest.

    Then it is J p, the stress on the undeformed volume, that carries the weight: J p = density gravity depth, which is
    J^(1 - gamma) - J = weight below, solved by Newton's method.
    """
    bulk_modulus, gamma = params
    weight = gamma * density * gravity * max(depth, 0.0) / bulk_modulus
    J = exp(-log(1.0 + weight) / gamma)
    for _ in range(NEWTON_STEPS):
        power = exp((1.0 - gamma) * log(J))
        J = max(J + (power - J - weight) / ((gamma - 1.0) * power / J + 1.0), SMALLEST)
    return (J,)


def state_at(F, params):
    return (la.det(F),)


def kirchhoff_stress(state, params):
    (J,) = state
    return la.isotropic(-J * pressure(J, params))


def out_of_plane_stress(state, params):
    (J,) = state
    return -J * pressure(J, params)


def advance(state, G, dt, params):
    (J,) = state
    return (J + J * la.trace(G),)


def valid(state):
    return state[0] > SMALLEST


def volume_ratio(state):
    return state[0]


def wave_speed_squared(state, params, density):
    """dp/drho = B/rho0 J^(1 - gamma)."""
    bulk_modulus, gamma = params
    (J,) = state
    return bulk_modulus / density * exp((1.0 - gamma) * log(max(min(J, 1.0), SMALLEST)))


def energy(state, params):
    """Work of compression: the integral of p from J to 1; none once the fluid has opened."""
    bulk_modulus, gamma = params
    J = max(min(state[0], 1.0), SMALLEST)
    log_J = log(J)
    if LOGARITHMIC:
        return bulk_modulus * (J - 1.0 - log_J)
    return bulk_modulus / gamma * ((exp((1.0 - gamma) * log_J) - 1.0) / (gamma - 1.0) + J - 1.0)
