"""The constitutive laws, one file each. A law is a module with

- SOURCE, WORK: where it is from, and what a step of one of its particles costs, in hundredths of a neo-Hookean one's (measured:
  docs/results/laws.md, half of the particles yielding);
- KEYS, `conflicts(keys)`, `parameters(keys, dim)`: what a scene sets, and the numbers the formulas use;
- STATE, `state_fields(keys)`, `choices(keys)`: what a particle carries, and compile-time constants of the formulas;
- `state_at(F, params)`: the state of a fresh particle that is deformed elastically by F, the identity as a rule;
- `kirchhoff_stress(state, params)`, `advance(state, G, dt, params)`, `valid(state)`, `energy(state, params)`,
  `wave_speed_squared(state, params, density)`, `volume_ratio(state)`, `out_of_plane_stress(state, params)`: the physics of one
  particle;
- PLASTIC_STRAIN, in laws with one: the name of the state that is the accumulated equivalent plastic strain;
- with the choice VISCOUS, `viscous_stress(state, L, params)` and `kinematic_viscosity(state, params, density)` besides.

`state` is the flat tuple of STATE's numbers; G = dt grad v and L = grad v, row by row; stresses are in Pa, energies in J/m3
of the undeformed volume, viscosities in m2/s.
"""

from pmpm.physics.materials import (
    bingham,
    cam_clay,
    drucker_prager,
    fixed_corotated,
    fluid,
    hencky,
    mohr_coulomb,
    mu_i,
    neo_hookean,
    python_law,
    snow,
    von_mises,
)

LAWS = {
    "neo_hookean": neo_hookean,
    "fixed_corotated": fixed_corotated,
    "hencky": hencky,
    "fluid": fluid,
    "drucker_prager": drucker_prager,
    "mohr_coulomb": mohr_coulomb,
    "von_mises": von_mises,
    "cam_clay": cam_clay,
    "snow": snow,
    "mu_i": mu_i,
    "bingham": bingham,
}


def law_of(model):
    """The module of a model: one of LAWS, or the one around a function, whose model is called python:<name>."""
    return python_law if model.startswith(python_law.PREFIX) else LAWS[model]
