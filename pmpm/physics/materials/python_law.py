"""A law of your own: Python functions of the deformation gradient and, if it has any, of state variables of its own.

The functions of the scene come as choices, see own_law. What a law does not tell is done as in every hyperelastic solid: F
advances with the motion, and the state is valid while det F > 0 and its own numbers are finite.
A function tells nothing about its stiffness away from rest. The step follows c^2 = c0^2 B / min(J, 1), with c0 the speed at
rest and B a bound of the largest squared stretch, at least 1: a material wave covers stretched ground, and compression
stiffens. This is an upper bound for neo-Hookean and Hencky solids; a law that stiffens more needs a larger sound_speed, or a
wave_speed of its own.
"""

from pmpm.physics import tensors2 as la
from pmpm.physics.materials import neo_hookean, own_law
from pmpm.physics.materials.keys import DENSITY, Key, no_conflicts
from pmpm.physics.words import NAN

WORK = 102
SOURCE = "a function or a pmpm.Law given to pmpm.Scene in Python"
PREFIX = "python:"  # of the name of such a model, where built-in laws have their own
SOUND_SPEED = Key(
    "sound_speed",
    "m/s",
    "bound of the speed of waves at rest; of waves along the axes if not given",
    optional=True,
    above=0.0,
)
KEYS = (DENSITY, SOUND_SPEED)  # and the parameters of the functions
STATE = neo_hookean.STATE  # and the state variables of the law
conflicts, advance_elastically = no_conflicts, neo_hookean.advance
SMALLEST = neo_hookean.SMALLEST
OWN_STATE = ADVANCES = KNOWS_ENERGY = KNOWS_SPEED = CHECKS = False
# Replaced by the functions of the scene.
user_stress = user_advance = user_energy = user_wave_speed = user_valid = user_rest = neo_hookean.kirchhoff_stress


def choices(keys):
    return dict(own_law.bound(keys["law"]))


def state_fields(keys):
    return STATE + keys["law"].fields


def parameters(keys, dim):
    """(square of the wave speed at rest in m2/s2, or 0 if the law tells it, the numbers of the functions in order)."""
    speed = keys.get("sound_speed") or 0.0
    return speed * speed, *(keys[name] for name in keys["law"].parameters)


def state_at(F, params):
    if OWN_STATE:
        return F + user_rest(la.det(F) - la.det(F))
    return F


def kirchhoff_stress(state, params):
    return la.symmetric_part(user_stress(state, params))


def out_of_plane_stress(state, params):
    """The fourth number in 2-D; nan if the function does not tell."""
    tau = user_stress(state, params)
    return tau[3] if len(tau) == 4 else NAN


def advance(state, G, dt, params):
    if ADVANCES:
        return user_advance(state, G, dt, params)
    if OWN_STATE:
        return advance_elastically(la.tensor_part(state), G, dt, params) + la.after_tensor(state)
    return advance_elastically(state, G, dt, params)


def valid(state):
    if CHECKS:
        return (la.det(state) > 0.0) & user_valid(state)
    return la.det(state) > 0.0


def volume_ratio(state):
    return la.det(state)


def wave_speed_squared(state, params, density):
    if KNOWS_SPEED:
        speed = user_wave_speed(state, params)
        return speed * speed
    stretch_squared = max(la.row_sum_bound(la.left_cauchy_green(state)), 1.0)
    return params[0] * stretch_squared / max(min(la.det(state), 1.0), SMALLEST)


def energy(state, params):
    """Of a law that does not tell it nan, not a silent zero."""
    if KNOWS_ENERGY:
        return user_energy(state, params)
    return la.det(state) * NAN
