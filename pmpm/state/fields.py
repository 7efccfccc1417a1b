"""THE particle field table: what a particle carries, where it lies in its block, and what may be written to files.

Storage, migration, output and documentation read it; a law adds its own state in its file in physics/materials.
"""

from dataclasses import dataclass

import numpy as np

KIND_SIZE = {
    "scalar": lambda dim: 1,
    "vector": lambda dim: dim,
    "tensor": lambda dim: dim * dim,
    "symmetric": lambda dim: dim * (dim + 1) // 2,
    "solid": lambda dim: 4 if dim == 2 else 6,
}


@dataclass(frozen=True)
class Field:
    """One quantity of a particle: `kind` scalar, vector, tensor, symmetric, solid or numbers; `rest` as in StateField."""

    name: str
    kind: str
    unit: str
    meaning: str
    rest: float | tuple[float, ...] = 0.0

    @classmethod
    def of(cls, state_field):
        """The Field of a law's StateField."""
        return cls(state_field.name, state_field.kind, state_field.unit, state_field.meaning, state_field.rest)

    def size(self, dim):
        return len(self.rest) if isinstance(self.rest, tuple) else KIND_SIZE[self.kind](dim)

    def rest_values(self, dim):
        """The undeformed value, flat."""
        values = np.zeros(self.size(dim))
        if self.kind == "tensor":
            values[:: dim + 1] = self.rest
        elif self.kind == "symmetric":
            values[list(diagonal(dim))] = self.rest
        elif self.kind == "solid":
            values[list((0, 2, 3) if dim == 2 else (0, 3, 5))] = self.rest
        else:
            values[:] = self.rest
        return values


SHARE_STEPS = 1 << 24  # shares are whole numbers of these, so that sums of them are exact, in float32 too


def in_steps(shares):
    """(n,) int64 SHARE_STEPS of shares (n, 1), which are whole numbers of them."""
    return np.rint(shares[:, 0].astype(np.float64) * SHARE_STEPS).astype(np.int64)


COMMON = (
    Field("x", "vector", "cells", "position, as a place (see kernels.places); files and users see metres"),
    Field("v", "vector", "m/s", "velocity"),
)

OPTIONAL = (
    Field("C", "tensor", "1/s", "affine velocity field of APIC, or the velocity gradient that viscous stress follows"),
    Field("X", "vector", "m", "reference position, which a body force or an exact solution asks for"),
    Field("divergence", "scalar", "1/s", "of the velocity in this step, which F-bar averages"),
    Field("load", "vector", "m/s2", "acceleration by the loads of the scene"),
    Field(
        "share", "scalar", "-", "mass and volume as a part of those of a whole particle of its body, in steps of 2^-24"
    ),
)

OUTPUT = (
    Field("velocity", "vector", "m/s", "velocity"),
    Field("speed", "scalar", "m/s", "magnitude of the velocity"),
    Field("pressure", "scalar", "Pa", "minus the mean Cauchy stress: positive in compression"),
    Field("stress", "symmetric", "Pa", "Cauchy stress"),
    Field("von_mises_stress", "scalar", "Pa", "sqrt(3/2) times the norm of the deviator of the Cauchy stress"),
    Field(
        "strain", "symmetric", "-", "elastic logarithmic (Hencky) strain 1/2 ln b, where the law keeps F or a strain"
    ),
    Field("von_mises_strain", "scalar", "-", "sqrt(2/3) times the norm of the deviator of that strain"),
    Field("plastic_strain", "scalar", "-", "accumulated equivalent plastic strain, where the law keeps one"),
    Field("displacement", "vector", "m", "from the reference position, where particles carry one"),
    Field("volume", "scalar", "m3", "current volume; in 2-D of a metre of thickness"),
    Field("deformation_gradient", "tensor", "-", "F, where the law keeps one"),
    Field("J", "scalar", "-", "volume ratio"),
    Field("density", "scalar", "kg/m3", "current density"),
    Field("material", "scalar", "-", "number of the material in the scene"),
)
OUTPUT_NAMES = tuple(field.name for field in OUTPUT)
OUTPUT_VECTORS = tuple(field.name for field in OUTPUT if field.kind == "vector")


def diagonal(dim):
    """Positions of the diagonal in a flat symmetric tensor."""
    return (0, 2) if dim == 2 else (0, 3, 5)


@dataclass(frozen=True)
class Layout:
    """Where each field of one law's particles begins in a block, and how many reals a particle holds."""

    common: tuple[Field, ...]
    state: tuple[Field, ...]
    dim: int

    @classmethod
    def of(cls, law, dim, carried=()):
        """`carried`: names of OPTIONAL fields."""
        return cls(
            COMMON + tuple(field for field in OPTIONAL if field.name in carried), tuple(map(Field.of, law.fields)), dim
        )

    @property
    def fields(self):
        return self.common + self.state

    @property
    def size(self):
        return sum(field.size(self.dim) for field in self.fields)

    @property
    def state_first(self):
        return sum(field.size(self.dim) for field in self.common)

    def where(self, name):
        """slice of the reals that hold field `name`, or None if the law keeps no such field."""
        first = 0
        for field in self.fields:
            if field.name == name:
                return slice(first, first + field.size(self.dim))
            first += field.size(self.dim)
        return None

    def rest_state(self):
        """Flat undeformed state of the law."""
        return np.concatenate([field.rest_values(self.dim) for field in self.state])
