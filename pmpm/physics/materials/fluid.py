"""Weakly compressible fluid with the Tait equation of state; a particle keeps only its volume ratio J.

p = B/gamma (J^-gamma - 1), B = rho0 c0^2; never below zero with `tension_cutoff`: a free surface may open without suction.
A Newtonian viscosity adds tau = 2 J eta dev sym L, L = grad v, with the deviator of space also in plane strain. It depends on
the motion, not on the state: the stress in files, out of the plane too, and the stored energy are those of pressure alone.
Source: Monaghan, J. Comput. Phys. 110 (1994) 399; tension cut-off as in the usual free-surface codes.
"""

from pmpm.physics import tensors2 as la
from pmpm.physics.materials.keys import DENSITY, Key, StateField
from pmpm.physics.words import exp, log

WORK = 95
SOURCE = "Monaghan (1994), J. Comput. Phys. 110, 399"
STIFFNESS = (
    Key(
        "sound_speed",
        "m/s",
        "speed of sound at rest; ten times the flow speed keeps the density within 1 %",
        optional=True,
        above=0.0,
    ),
    Key("bulk_modulus", "Pa", "stiffness against compression, instead of sound_speed", optional=True, above=0.0),
    Key(
        "flow_speed",
        "m/s",
        "largest speed of the flow, a tenth of sound_speed, instead of it",
        optional=True,
        above=0.0,
    ),
    Key("gamma", "-", "exponent of the Tait equation", default=7.0, at_least=1.0, at_most=20.0),
)
KEYS = (
    DENSITY,
    *STIFFNESS,
    Key("viscosity", "Pa s", "dynamic viscosity", default=0.0, at_least=0.0),
    Key("tension_cutoff", "-", "no pressure below zero; else down to -B/gamma", default=True),
)
STATE = (StateField("J", "scalar", "-", "volume ratio", 1.0),)
LOGARITHMIC = False  # gamma = 1 integrates to a logarithm
VISCOUS = False
TENSION_CUTOFF = True
SOUND_OF_FLOW = 10.0  # sound speed over flow speed: the density varies by its inverse square, 1 %
NEWTON_STEPS = 6  # to round-off from where weight / gamma, the compression at rest stiffness, is up to 1
LARGEST = 1e6  # of J: a drop that flies apart for long would leave the range of float32
SMALLEST = 1e-4  # volume ratios below it only keep the logarithm finite until `valid` stops the run


def conflicts(keys):
    return stiffness_conflict(keys)


def stiffness_conflict(keys):
    """What is wrong with the keys of STIFFNESS together, or None."""
    units = {"sound_speed": "m/s", "bulk_modulus": "Pa", "flow_speed": "m/s"}
    given = [name for name in units if keys.get(name) is not None]
    if len(given) != 1:
        known = [f"{name} ({unit})" for name, unit in units.items()]
        return f"give exactly one of {', '.join(known[:-1])} and {known[-1]}, not {' and '.join(given) or 'none'}"
    return None


def choices(keys):
    return {
        "LOGARITHMIC": keys["gamma"] == 1.0,
        "VISCOUS": keys["viscosity"] > 0.0,
        "TENSION_CUTOFF": bool(keys["tension_cutoff"]),
    }


def state_fields(keys):
    return STATE


def bulk_modulus_of(keys):
    """B in Pa of one of the keys of STIFFNESS."""
    if keys.get("bulk_modulus") is not None:
        return keys["bulk_modulus"]
    speed = SOUND_OF_FLOW * keys["flow_speed"] if keys.get("sound_speed") is None else keys["sound_speed"]
    return keys["density"] * speed * speed


def parameters(keys, dim):
    """(bulk modulus in Pa, gamma, viscosity in Pa s)."""
    return bulk_modulus_of(keys), keys["gamma"], keys["viscosity"]


def pressure(J, params):
    bulk_modulus, gamma, viscosity = params
    p = bulk_modulus / gamma * (exp(-gamma * log(max(J, SMALLEST))) - 1.0)
    if TENSION_CUTOFF:
        return max(p, 0.0)
    return p


def hydrostatic_state(depth, gravity, params, density):
    """State in equilibrium under `depth` (m) of the same fluid, whose particles are spaced as at rest.

    Then it is J p, the stress on the undeformed volume, that carries the weight: J p = density gravity depth, which is
    J^(1 - gamma) - J = weight below, solved by Newton's method.
    """
    bulk_modulus, gamma, viscosity = params
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


def viscous_stress(state, L, params):
    """2 J eta dev sym L: what viscosity adds to the Kirchhoff stress."""
    bulk_modulus, gamma, viscosity = params
    (J,) = state
    D = la.symmetrize(L)
    return la.scale_plus_diagonal(2.0 * viscosity * J, D, -(2.0 * viscosity * J) * la.trace(L) / 3.0)


def kinematic_viscosity(state, params, density):
    """eta / rho = J eta / rho0."""
    bulk_modulus, gamma, viscosity = params
    (J,) = state
    return viscosity / density * J


def out_of_plane_stress(state, params):
    (J,) = state
    return -J * pressure(J, params)


def advance(state, G, dt, params):
    """J det(I + G): the volume that particles move into; 1 + tr G misses it by as much as dt, and errors with it."""
    (J,) = state
    return (min(J * la.det(la.identity_plus(G)), LARGEST),)


def valid(state):
    return state[0] > SMALLEST


def volume_ratio(state):
    return state[0]


def wave_speed_squared(state, params, density):
    """dp/drho = B/rho0 J^(1 - gamma); where the fluid is expanded, that at rest, which is more.

    Under tension the stress on the undeformed volume, tau = -J p, stiffens: dtau/dlnJ = B/gamma ((gamma - 1) J^(1 - gamma) + J)
    is what a particle alone swings with.
    """
    bulk_modulus, gamma, viscosity = params
    (J,) = state
    power = exp((1.0 - gamma) * log(max(min(J, 1.0), SMALLEST)))
    if TENSION_CUTOFF:
        return bulk_modulus / density * power
    return bulk_modulus / density * max(power, 1.0 + (J - 1.0) / gamma)


def energy(state, params):
    """Work of compression: the integral of p from J to 1; with the cut-off none once the fluid has opened."""
    bulk_modulus, gamma, viscosity = params
    J = max(state[0], SMALLEST)
    if TENSION_CUTOFF:
        J = min(J, 1.0)
    log_J = log(J)
    if LOGARITHMIC:
        return bulk_modulus * (J - 1.0 - log_J)
    return bulk_modulus / gamma * ((exp((1.0 - gamma) * log_J) - 1.0) / (gamma - 1.0) + J - 1.0)
