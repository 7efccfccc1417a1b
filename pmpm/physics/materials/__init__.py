"""The constitutive laws, one file each. A law is a module with

- KEYS, `conflicts(keys)`, `parameters(keys, dim)`: what a scene sets, and the numbers the formulas use;
- STATE, `state_fields(keys)`, `choices(keys)`: what a particle carries, and compile-time constants of the formulas;
- `kirchhoff_stress(state, params)`, `advance(state, G, params)`, `valid(state)`, `wave_speed_squared(state, params, density)`,
  `energy(state, params)`, `volume_ratio(state)`, `out_of_plane_stress(state, params)`: the physics of one particle.

`state` is the flat tuple of STATE's numbers; G = dt grad v, row by row; stresses are in Pa, energies in J/m3 of the
undeformed volume.
"""

from pmpm.physics.materials import drucker_prager, fluid, neo_hookean, python_law

LAWS = {"neo_hookean": neo_hookean, "fluid": fluid, "drucker_prager": drucker_prager}
PLANNED = ("fixed_corotated", "hencky", "snow", "von_mises", "cam_clay", "mu_i", "bingham")


def law_of(model):
    """The module of a model: one of LAWS, or the one around a function, whose model is called python:<name>."""
    return python_law if model.startswith(python_law.PREFIX) else LAWS[model]
