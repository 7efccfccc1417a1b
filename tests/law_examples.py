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
# Label -> keys of a scene, with moduli of about 1 kPa, so that the tests may measure stresses by one STIFFNESS.
EXAMPLES = {
    "neo_hookean": {"model": "neo_hookean", **ELASTIC},
    "fluid": {"model": "fluid", "density": 1000.0, "bulk_modulus": 1000.0, "gamma": 7.0},
    "fluid, gamma 1": {"model": "fluid", "density": 1000.0, "bulk_modulus": 1000.0, "gamma": 1.0},
    "drucker_prager": {"model": "drucker_prager", **ELASTIC, "friction_angle": 30.0},
    "drucker_prager, no volume correction": {
        "model": "drucker_prager",
        **ELASTIC,
        "friction_angle": 30.0,
        "volume_correction": False,
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
