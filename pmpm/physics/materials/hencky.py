"""Solid that is linear in its logarithmic (Hencky) strain: St Venant-Kirchhoff's energy with E = 1/2 ln b in place of Green's.

Energy per reference volume: psi = mu |E|^2 + lam/2 (tr E)^2; tau = 2 mu E + lam tr E I. A particle keeps E; in plane strain
its out-of-plane entry is zero. Stretched beyond e-fold the law loses stiffness, as all of this energy do: dP/dF along an
axis is zero at ln F = 1.
Source: Bonet, Wood, Nonlinear Continuum Mechanics for Finite Element Analysis, 2nd ed. (2008), section 6.6.
"""

from pmpm.physics import hencky
from pmpm.physics import tensors2 as la
from pmpm.physics.materials.keys import ELASTIC_KEYS, StateField, lame_parameters, no_choices, no_conflicts
from pmpm.physics.words import expm1

WORK = 106
SOURCE = "Bonet and Wood (2008), section 6.6"
KEYS = ELASTIC_KEYS
STATE = (StateField("hencky_strain", "symmetric", "-", "elastic logarithmic strain, 1/2 ln b"),)
conflicts, choices, parameters = no_conflicts, no_choices, lame_parameters


def state_fields(keys):
    return STATE


def state_at(F, params):
    return hencky.strain_of(F)


def kirchhoff_stress(E, params):
    mu, lam = params
    return la.scale_plus_diagonal(2.0 * mu, E, lam * la.trace_symmetric(E))


def out_of_plane_stress(E, params):
    mu, lam = params
    return lam * la.trace_symmetric(E)


def advance(E, G, dt, params):
    return la.scale_plus_diagonal(hencky.kept_if_forward(G), hencky.trial_strain(E, G), 0.0)


def valid(E):
    return la.norm_symmetric(E) < hencky.LARGEST


def volume_ratio(E):
    return expm1(la.trace_symmetric(E)) + 1.0


def wave_speed_squared(E, params, density):
    """Upper bound of the spatial wave speeds squared.

    Along a principal axis P waves have lam + 2 mu - 2 mu ln F - lam ln J, and shear waves between two axes, whose strains
    differ by x, 2 mu x / (1 - exp(-2 x)) <= mu + 2 mu x.
    """
    mu, lam = params
    bound, trace = la.row_sum_bound(E), la.trace_symmetric(E)
    along = lam + 2.0 * mu + 2.0 * mu * bound + max(-lam * trace, 0.0)
    return max(along, mu + 4.0 * mu * bound) / density


def energy(E, params):
    mu, lam = params
    norm, trace = la.norm_symmetric(E), la.trace_symmetric(E)
    return mu * norm * norm + 0.5 * lam * trace * trace
