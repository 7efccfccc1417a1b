"""Metal: Hencky elasticity inside von Mises' cylinder, with linear isotropic hardening.

psi = mu |E|^2 + lam/2 (tr E)^2 in the elastic Hencky strain E. Yield: sqrt(3/2) |dev tau| <= yield_stress +
hardening_modulus alpha, alpha the accumulated plastic strain. The return is along dev E (no plastic volume change) and, the
hardening being linear, exact in one step. In plane strain the plastic flow strains elastically along z too. Softening is
refused: strain would gather in one row of cells, and the answer depend on their size. The energy is the elastic one; what
hardening stores counts as dissipated. Sources: Simo and Hughes, Computational Inelasticity (1998), box 3.1; in logarithmic
strains de Souza Neto, Peric, Owen, Computational Methods for Plasticity (2008), section 14.4.
"""

from pmpm.physics import hencky
from pmpm.physics import tensors2 as la
from pmpm.physics.materials.keys import ELASTIC_KEYS, Key, StateField, lame, no_conflicts
from pmpm.physics.words import TINY, exp

WORK = 110
SOURCE = "Simo and Hughes (1998), box 3.1; de Souza Neto, Peric and Owen (2008), section 14.4"
KEYS = (
    *ELASTIC_KEYS,
    Key("yield_stress", "Pa", "stress at which a bar begins to flow", above=0.0),
    Key("hardening_modulus", "Pa", "growth of the yield stress per plastic strain", default=0.0, at_least=0.0),
)
STATE = (
    StateField("elastic_strain", "solid", "-", "elastic logarithmic strain, 1/2 ln b"),
    StateField("alpha", "scalar", "-", "accumulated plastic strain"),
)
PLASTIC_STRAIN = "alpha"
HARDENING = False
ROOT_TWO_THIRDS = 0.816496580927726
conflicts = no_conflicts


def choices(keys):
    return {"HARDENING": keys["hardening_modulus"] > 0.0}


def state_fields(keys):
    return STATE if keys["hardening_modulus"] > 0.0 else STATE[:1]


def parameters(keys, dim):
    """(mu in Pa, lam in Pa, |dev E| at first yield, its growth with alpha)."""
    mu, lam = lame(keys["youngs_modulus"], keys["poisson_ratio"])
    per_stress = ROOT_TWO_THIRDS / (2.0 * mu)
    return mu, lam, per_stress * keys["yield_stress"], per_stress * keys["hardening_modulus"]


def state_at(F, params):
    E = hencky.strain_of_solid(F)
    if HARDENING:
        return E + (la.det(F) - la.det(F),)
    return E


def kirchhoff_stress(state, params):
    mu, lam, radius, growth = params
    return hencky.stress(la.solid_part(state), mu, lam)


def out_of_plane_stress(state, params):
    mu, lam, radius, growth = params
    return hencky.out_of_plane_stress(la.solid_part(state), mu, lam)


def advance(state, G, dt, params):
    """Radial return; alpha grows by sqrt(2/3) of the plastic strain's norm."""
    mu, lam, radius, growth = params
    E = hencky.trial_strain_solid(la.solid_part(state), G)
    third = la.trace_solid(E) / 3.0
    norm = la.norm_solid(la.scale_plus_diagonal_solid(1.0, E, -third))
    if HARDENING:
        (alpha,) = la.after_solid(state)
        flow = max(norm - (radius + growth * alpha), 0.0) / (1.0 + ROOT_TWO_THIRDS * growth)
    else:
        flow = max(norm - radius, 0.0)
    lost = flow / max(norm, TINY)
    E = la.scale_plus_diagonal_solid((1.0 - lost) * hencky.kept_if_forward(G), E, lost * third)
    if HARDENING:
        return E + (alpha + ROOT_TWO_THIRDS * flow,)
    return E


def valid(state):
    return la.norm_solid(la.solid_part(state)) < hencky.LARGEST


def volume_ratio(state):
    return exp(la.trace_solid(la.solid_part(state)))


def wave_speed_squared(state, params, density):
    mu, lam, radius, growth = params
    return hencky.wave_modulus(la.solid_part(state), mu, lam) / density


def energy(state, params):
    mu, lam, radius, growth = params
    return hencky.energy(la.solid_part(state), mu, lam)
