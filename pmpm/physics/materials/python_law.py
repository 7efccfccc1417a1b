"""A law of your own: a Python function of the deformation gradient, without memory.

`user_stress(F, a, b, ...)` is the function of the scene, tau its Kirchhoff stress. F advances as in every hyperelastic solid.
A function tells nothing about its stiffness away from rest. The step follows c^2 = c0^2 B / min(J, 1), with c0 the speed at
rest and B a bound of the largest squared stretch, at least 1: a material wave covers stretched ground, and compression
stiffens. This is an upper bound for neo-Hookean and Hencky solids; a law that stiffens more needs a larger sound_speed.
"""

from pmpm.physics import tensors2 as la
from pmpm.physics.materials import neo_hookean
from pmpm.physics.materials.keys import DENSITY, Key
from pmpm.physics.words import NAN

SOURCE = "a function given to pmpm.Scene in Python"
PREFIX = "python:"  # of the name of such a model, where built-in laws have their own
SOUND_SPEED = Key(
    "sound_speed",
    "m/s",
    "bound of the speed of waves at rest; of waves along the axes if not given",
    optional=True,
    above=0.0,
)
KEYS = (DENSITY, SOUND_SPEED)  # and the parameters of the function
STATE = neo_hookean.STATE
SMALLEST = neo_hookean.SMALLEST
state_at, advance, valid, volume_ratio = (
    neo_hookean.state_at,
    neo_hookean.advance,
    neo_hookean.valid,
    neo_hookean.volume_ratio,
)
user_stress = neo_hookean.kirchhoff_stress  # replaced by the function of the scene


def conflicts(keys):
    return None


def choices(keys):
    return {"user_stress": keys["function"]}


def state_fields(keys):
    return STATE


def parameter_names(function):
    """Names of the function's arguments after F."""
    return function.__code__.co_varnames[1 : function.__code__.co_argcount]


def parameters(keys, dim):
    """(square of the wave speed at rest in m2/s2, the numbers of the function in its order)."""
    return keys["sound_speed"] ** 2, *(keys[name] for name in parameter_names(keys["function"]))


def kirchhoff_stress(F, params):
    return la.symmetric_part(user_stress(F, *params[1:]))


def out_of_plane_stress(F, params):
    """The fourth number in 2-D; nan if the function does not tell."""
    tau = user_stress(F, *params[1:])
    return tau[3] if len(tau) == 4 else NAN


def wave_speed_squared(F, params, density):
    stretch_squared = max(la.row_sum_bound(la.left_cauchy_green(F)), 1.0)
    return params[0] * stretch_squared / max(min(la.det(F), 1.0), SMALLEST)


def energy(F, params):
    """Not known: nan, not a silent zero."""
    return la.det(F) * NAN
