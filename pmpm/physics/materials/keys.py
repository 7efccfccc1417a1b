"""What a law tells the outside world about itself: the keys a scene sets and the state a particle carries."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Key:
    """One key of a material in a scene file. `default` None: the key must be given, or see `optional`.

    Bounds are exclusive (`above`, `below`) or inclusive (`at_least`, `at_most`). `only` names the one value that is built
    so far; the others are a clear error and come later.
    """

    name: str
    unit: str
    meaning: str
    default: object = None
    optional: bool = False
    above: float | None = None
    at_least: float | None = None
    below: float | None = None
    at_most: float | None = None
    choices: tuple = ()
    only: object = None


@dataclass(frozen=True)
class StateField:
    """One quantity a law keeps on its particles. `kind`: scalar, tensor (dim x dim), symmetric, or solid (symmetric with its
    out-of-plane entry in 2-D), or numbers; `rest`: its undeformed value, per diagonal entry for tensors (others rest at zero),
    of numbers a tuple of all."""

    name: str
    kind: str
    unit: str
    meaning: str
    rest: float | tuple = 0.0


DENSITY = Key("density", "kg/m3", "mass per volume of the undeformed material", above=0.0)
YOUNGS_MODULUS = Key("youngs_modulus", "Pa", "stiffness in uniaxial stress", above=0.0)
POISSON_RATIO = Key("poisson_ratio", "-", "lateral contraction per axial extension", above=-1.0, below=0.5)

ELASTIC_KEYS = (DENSITY, YOUNGS_MODULUS, POISSON_RATIO)
FRICTION_ANGLE = Key("friction_angle", "deg", "angle of internal friction", at_least=0.0, below=90.0)
DILATANCY_ANGLE = Key(
    "dilatancy_angle",
    "deg",
    "angle of plastic expansion, at most the friction angle",
    default=0.0,
    at_least=0.0,
    below=90.0,
)


# What a law answers that needs nothing to be said: it takes these for its own functions.


def no_conflicts(keys):
    return None


def no_choices(keys):
    return {}


def lame_parameters(keys, dim):
    """(mu, lam) in Pa."""
    return lame(keys["youngs_modulus"], keys["poisson_ratio"])


def lame(youngs_modulus, poisson_ratio):
    """(mu, lam) in Pa: the Lame parameters of an isotropic solid."""
    mu = youngs_modulus / (2.0 * (1.0 + poisson_ratio))
    lam = youngs_modulus * poisson_ratio / ((1.0 + poisson_ratio) * (1.0 - 2.0 * poisson_ratio))
    return mu, lam
