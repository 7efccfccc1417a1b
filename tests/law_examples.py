"""One material of each law and of each of its switches, and random particles of it: for the tests that hold for all laws."""

import functools
from dataclasses import dataclass

import numpy as np
import own_laws

from pmpm.kernels import targets
from pmpm.kernels.needs import law_needs
from pmpm.physics import tensors2, tensors3
from pmpm.state.fields import Layout

TENSORS = {2: tensors2, 3: tensors3}
ELASTIC = {"density": 1000.0, "youngs_modulus": 1000.0, "poisson_ratio": 0.3}
CLAY = {
    "density": 1000.0,
    "shear_modulus": 400.0,
    "swelling_index": 0.1,
    "compression_index": 0.3,
    "friction_angle": 25.0,
    "preconsolidation_pressure": 50.0,
}
MUD = {"density": 1000.0, "bulk_modulus": 1000.0, "shear_modulus": 400.0, "yield_stress": 20.0}
# Label -> keys of a scene, with moduli of about 1 kPa, so that the tests may measure stresses by one STIFFNESS.
EXAMPLES = {
    "neo_hookean": {"model": "neo_hookean", **ELASTIC},
    "fixed_corotated": {"model": "fixed_corotated", **ELASTIC},
    "fluid": {"model": "fluid", "density": 1000.0, "bulk_modulus": 1000.0, "gamma": 7.0},
    "fluid, gamma 1": {"model": "fluid", "density": 1000.0, "bulk_modulus": 1000.0, "gamma": 1.0},
    "drucker_prager": {"model": "drucker_prager", **ELASTIC, "friction_angle": 30.0},
    "drucker_prager, no volume correction": {
        "model": "drucker_prager",
        **ELASTIC,
        "friction_angle": 30.0,
        "volume_correction": False,
    },
    "fluid, viscous, in tension": {
        "model": "fluid",
        "density": 1000.0,
        "bulk_modulus": 1000.0,
        "viscosity": 3.0,
        "tension_cutoff": False,
    },
    "von_mises": {"model": "von_mises", **ELASTIC, "yield_stress": 50.0},
    "von_mises, hardening": {"model": "von_mises", **ELASTIC, "yield_stress": 50.0, "hardening_modulus": 100.0},
    "cam_clay": {"model": "cam_clay", **CLAY, "initial_pressure": 30.0},
    "cam_clay, attraction": {"model": "cam_clay", **CLAY, "attraction": 30.0},
    "mu_i": {
        "model": "mu_i",
        **ELASTIC,
        "static_friction": 0.38,
        "dynamic_friction": 0.64,
        "grain_diameter": 1e-3,
        "grain_density": 2500.0,
    },
    "bingham": {"model": "bingham", **MUD, "viscosity": 0.5},
    "bingham, thinning": {"model": "bingham", **MUD, "viscosity": 5.0, "flow_index": 0.5},
    "bingham, thickening, gamma 1": {"model": "bingham", **MUD, "viscosity": 0.5, "flow_index": 1.5, "gamma": 1.0},
    "drucker_prager, cohesion": {"model": "drucker_prager", **ELASTIC, "friction_angle": 30.0, "cohesion": 20.0},
    "drucker_prager, dilatancy": {
        "model": "drucker_prager",
        **ELASTIC,
        "friction_angle": 30.0,
        "dilatancy_angle": 10.0,
    },
    "drucker_prager, cohesion and dilatancy, no volume correction": {
        "model": "drucker_prager",
        **ELASTIC,
        "friction_angle": 30.0,
        "cohesion": 20.0,
        "dilatancy_angle": 10.0,
        "volume_correction": False,
    },
    "hencky": {"model": "hencky", **ELASTIC},
    "mohr_coulomb": {"model": "mohr_coulomb", **ELASTIC, "cohesion": 20.0, "friction_angle": 30.0},
    "mohr_coulomb, softening": {
        "model": "mohr_coulomb",
        **ELASTIC,
        "cohesion": 20.0,
        "friction_angle": 30.0,
        "residual_cohesion": 2.0,
        "residual_friction_angle": 15.0,
        "softening_strain": 0.2,
    },
    "mohr_coulomb, softening and dilatancy": {
        "model": "mohr_coulomb",
        **ELASTIC,
        "cohesion": 20.0,
        "friction_angle": 30.0,
        "dilatancy_angle": 10.0,
        "residual_cohesion": 2.0,
        "residual_friction_angle": 15.0,
        "softening_strain": 0.2,
    },
    "snow": {"model": "snow", **ELASTIC, "critical_compression": 0.1, "critical_stretch": 0.05, "hardening": 1.0},
    "snow, capped": {
        "model": "snow",
        **ELASTIC,
        "critical_compression": 0.3,
        "critical_stretch": 0.3,
        "hardening": 5.0,
        "largest_hardening": 2.0,
    },
    "breaking": own_laws.MATERIAL,
}
STIFFNESS = 2000.0
# Eps by which lanes may miss plain Python in one step: twice what was found, at least 20. Of the fluid, J^-8 takes the
# round-off of J eightfold.
BOUND = dict.fromkeys(EXAMPLES, 20.0) | {"fluid": 60.0}
# Largest entries of the strain of every third particle: beyond 0.2, laws that know series leave them.
FAR = 0.45


@dataclass(frozen=True)
class Example:
    """A law of EXAMPLES in 2-D or 3-D."""

    label: str
    dim: int

    @property
    def keys(self):
        """All keys of the material, defaults filled in."""
        return self.material.parameters

    @property
    def material(self):
        from pmpm.scene.materials import material

        return material(EXAMPLES[self.label]).complete(self.dim)

    @property
    def needs(self):
        return law_needs(self.material.model, self.keys)

    @property
    def module(self):
        return self.needs.module

    @property
    def layout(self):
        return Layout.of(self.needs, self.dim)

    @property
    def state_size(self):
        return self.layout.size - self.layout.state_first

    @property
    def params(self):
        return self.module.parameters(self.keys, self.dim)

    @property
    def words(self):
        """What a target takes to compile functions of this law."""
        return {"la": TENSORS[self.dim], "law": self.module, **dict(self.needs.choices)}

    def plain(self, name):
        """A function of the law in plain Python."""
        return targets.plain(**self.words).compile(getattr(self.module, name))

    def particles(self, count, seed=5):
        """(states, gradients times dt) of `count` particles, as rows: every third strained far, every second one a step old."""
        return particles(self, count, seed)


@functools.cache
def particles(example, count, seed):
    rng, dim = np.random.default_rng(seed), example.dim
    at, advance = example.plain("state_at"), example.plain("advance")
    states, gradients = [], 0.05 * rng.standard_normal((count, dim * dim))
    for n in range(count):
        strain = 0.05 * rng.standard_normal((dim, dim))
        if n % 3 == 0:
            strain = np.copysign(rng.uniform(0.2, FAR, (dim, dim)), strain)
        state = at(tuple(map(float, matrix_exponential(strain).ravel())), example.params)
        if n % 2:
            state = advance(state, tuple(map(float, 0.05 * rng.standard_normal(dim * dim))), 1e-3, example.params)
        states.append(state)
    return np.array(states), gradients


def matrix_exponential(A):
    """exp(A) by scaling and squaring of its series: A is small."""
    term = total = np.eye(len(A))
    for n in range(1, 20):
        term = term @ A / (4.0 * n)
        total = total + term
    for _ in range(2):
        total = total @ total
    return total


def each_example():
    """All examples in 2-D and in 3-D."""
    return [Example(label, dim) for label in EXAMPLES for dim in (2, 3)]


def identify(part):
    """A name for pytest."""
    return f"{part.label}, {part.dim}-D" if isinstance(part, Example) else getattr(part, "__name__", str(part))
