"""One particle of a law, driven by deformation increments in plain Python and measured in numpy matrices of space."""

import functools

import numpy as np
from flat import flat, in_dimension

from pmpm.physics.materials import law_of
from pmpm.scene.materials import material


@functools.cache
def compiled(law, name, dim, choices):
    return in_dimension(getattr(law, name), dim, **dict(choices))


class Particle:
    """A particle of a material: its state, stress and volume; `dim` 2 is plane strain."""

    def __init__(self, dim, F=None, **keys):
        made = material(keys).complete(dim)
        self.law, self.dim, self.keys = law_of(keys["model"]), dim, made.parameters
        self.params = self.law.parameters(self.keys, dim)
        self.choices = self.law.choices(self.keys)
        self.state = self("state_at", flat(np.eye(dim) if F is None else F), self.params)

    def __call__(self, name, *arguments):
        return compiled(self.law, name, self.dim, tuple(sorted(self.choices.items())))(*arguments)

    def advance(self, G, dt=1.0):
        self.state = self("advance", self.state, flat(np.asarray(G, float)[: self.dim, : self.dim]), dt, self.params)
        return self

    def tau(self, state=None):
        """Kirchhoff stress in space, Pa."""
        state = self.state if state is None else state
        return in_space(self("kirchhoff_stress", state, self.params), self("out_of_plane_stress", state, self.params))

    @property
    def strain(self):
        """The solid strain that the state begins with, in space."""
        size = 4 if self.dim == 2 else 6
        E = self.state[:size]
        return in_space(E[:3], E[3]) if self.dim == 2 else in_space(E, None)

    @property
    def rest(self):
        """The state after the strain."""
        return self.state[4 if self.dim == 2 else 6 :]

    @property
    def energy(self):
        return self("energy", self.state, self.params)

    @property
    def volume(self):
        return self("volume_ratio", self.state)

    @property
    def valid(self):
        return self("valid", self.state)


def in_space(S, out_of_plane):
    """A flat symmetric tensor as a 3 x 3 matrix; in 2-D the entry out of the plane is given."""
    if len(S) == 3:
        return np.array([[S[0], S[1], 0.0], [S[1], S[2], 0.0], [0.0, 0.0, out_of_plane]])
    return np.array([[S[0], S[1], S[2]], [S[1], S[3], S[4]], [S[2], S[4], S[5]]])


def deviator(A):
    return A - np.trace(A) / 3.0 * np.eye(3)


def mises(tau):
    """q = sqrt(3/2) |dev tau|."""
    return float(np.sqrt(1.5) * np.linalg.norm(deviator(tau)))


def equivalent_shear(tau):
    """|dev tau| / sqrt 2, the shear stress in simple shear."""
    return float(np.linalg.norm(deviator(tau)) / np.sqrt(2.0))


def pressure(tau):
    return float(-np.trace(tau) / 3.0)


def simple_shear(gamma):
    G = np.zeros((3, 3))
    G[0, 1] = gamma
    return G


def random_increment(random, dim, size):
    G = np.zeros((3, 3))
    G[:dim, :dim] = size * random.normal(size=(dim, dim))
    return G


def stretch(*principal):
    """The increment G of a step with these logarithmic strains along the axes."""
    return np.diag(np.expm1(principal))
