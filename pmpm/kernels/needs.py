"""What a scene asks of the kernels, in plain names and constants; never a scene itself."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pmpm.kernels.places import FORMATS, PADDING
from pmpm.physics import bspline, tensors2, tensors3
from pmpm.physics.materials import law_of
from pmpm.physics.materials.keys import StateField


@dataclass(frozen=True)
class Stencil:
    """Reach of a shape function, in nodes. `low`: nodes below the centre one; `window`: planes a padded layer touches."""

    nodes: int
    low: int
    round: float
    inertia: float
    origins: tuple[float, ...]
    weights: Callable
    slopes: Callable

    @property
    def reach_low(self):
        return self.low + PADDING

    @property
    def reach_high(self):
        return self.nodes - 1 - self.low + PADDING

    @property
    def window(self):
        return self.reach_low + self.reach_high + 1

    @property
    def beyond(self):
        """Nodes beyond a wall that a particle reaches which has passed it by less than half a cell."""
        return self.low - math.floor(self.round - 0.5)

    @property
    def offsets(self):
        """Distances of the nodes from the centre node, in cells."""
        return tuple(float(n - self.low) for n in range(self.nodes))


STENCILS = {
    "linear": Stencil(
        bspline.NODES_LINEAR,
        bspline.LOW_LINEAR,
        bspline.ROUND_LINEAR,
        bspline.INERTIA_LINEAR,
        bspline.ORIGINS_LINEAR,
        bspline.weights_linear,
        bspline.slopes_linear,
    ),
    "quadratic": Stencil(
        bspline.NODES_QUADRATIC,
        bspline.LOW_QUADRATIC,
        bspline.ROUND_QUADRATIC,
        bspline.INERTIA_QUADRATIC,
        bspline.ORIGINS_QUADRATIC,
        bspline.weights_quadratic,
        bspline.slopes_quadratic,
    ),
    "cubic": Stencil(
        bspline.NODES_CUBIC,
        bspline.LOW_CUBIC,
        bspline.ROUND_CUBIC,
        bspline.INERTIA_CUBIC,
        bspline.ORIGINS_CUBIC,
        bspline.weights_cubic,
        bspline.slopes_cubic,
    ),
}


@dataclass(frozen=True)
class Transfer:
    """What a transfer scheme does. `affine`: particles carry an affine velocity field; `blends`: they keep a part of their
    own velocity (FLIP), for which the grid is also filled without forces; `mls`: forces without weight gradients."""

    affine: bool = False
    blends: bool = False
    mls: bool = False


TRANSFERS = {
    "apic": Transfer(affine=True),
    "mls": Transfer(affine=True, mls=True),
    "pic": Transfer(),
    "flip": Transfer(blends=True),
    "aflip": Transfer(affine=True, blends=True),
}


@dataclass(frozen=True)
class LawNeeds:
    """One constitutive law with its compile-time choices, in one velocity field: all materials that share these share
    storage. Kernels know nothing of velocity fields."""

    model: str
    choices: tuple[tuple[str, object], ...]
    fields: tuple[StateField, ...]  # what a particle carries
    velocity_field: int = 0  # on whose nodes its particles meet others, see physics.contact

    @property
    def module(self):
        return law_of(self.model)

    @property
    def state(self):
        """Names of the fields."""
        return tuple(field.name for field in self.fields)

    @property
    def viscous(self):
        """Whether stress follows from the velocity gradient, too."""
        return bool(dict(self.choices).get("VISCOUS"))


@dataclass(frozen=True)
class Needs:
    """Constants of a scene's kernels: dimension, precision, transfer, which axis is cut into slabs, which are periodic."""

    dim: int
    precision: str
    transfer: str
    shape_function: str
    slab_axis: int
    periodic: tuple[bool, ...]
    laws: tuple[LawNeeds, ...]
    wall_types: tuple[str, ...]
    collider_types: tuple[str, ...] = ()  # surfaces of colliders
    f_bar: bool = False  # volume changes are averaged over nodes
    body_force: Callable | None = None  # acceleration(x, X, t) of the scene
    uses_reference: bool = False  # whether it reads X, or errors are measured at X
    loaded: bool = False  # whether particles carry an acceleration of their own
    open_axes: tuple[bool, ...] = ()  # which axes have a face that particles leave through; none if empty
    shared: bool = False  # whether they carry a volume of their own, as a part of what their body gives

    @property
    def scheme(self):
        return TRANSFERS[self.transfer]

    @property
    def affine_by_inertia(self):
        """Whether C is B D^-1, with a D that is the same everywhere; of linear splines it is grad v."""
        return self.scheme.affine and self.stencil.inertia > 0.0

    def carried(self, law):
        """Names of what particles of a law carry besides position, velocity and state."""
        carries = {"C": self.scheme.affine or law.viscous, "X": self.uses_reference, "load": self.loaded}
        carries |= {"divergence": self.f_bar, "share": self.shared}
        return tuple(name for name, needed in carries.items() if needed)

    @property
    def open(self):
        """Whether particles may leave."""
        return any(self.open_axes)

    def has_ends(self, axis):
        """Whether particles are waited for beyond an end of this axis: they come back at the other one, or leave."""
        return self.periodic[axis] or (self.open and self.open_axes[axis])

    @property
    def driven(self):
        """Whether something that P2G adds does work on the particles."""
        return self.loaded or self.body_force is not None

    @property
    def velocity_fields(self):
        """How many there are: more than one where bodies are in contact, and not bonded."""
        return 1 + max(law.velocity_field for law in self.laws)

    @property
    def contact(self):
        return self.velocity_fields > 1

    @property
    def stencil(self):
        return STENCILS[self.shape_function]

    @property
    def places(self):
        """How positions are stored."""
        return FORMATS[np.dtype(self.precision)]

    @property
    def tensors(self):
        return tensors2 if self.dim == 2 else tensors3

    @property
    def axes(self):
        """(slab, middle, row): the physical axis of each array axis of the grid; in 2-D there is no middle axis (-1)."""
        rest = [axis for axis in range(self.dim) if axis != self.slab_axis]
        return (self.slab_axis, rest[0] if self.dim == 3 else -1, rest[-1])


def law_needs(model, keys, velocity_field=0):
    """The LawNeeds of a material with these keys."""
    module = law_of(model)
    choices = tuple(sorted(module.choices(keys).items()))
    return LawNeeds(model, choices, tuple(module.state_fields(keys)), velocity_field)


def labels(laws):
    """A name per law: its model; laws of one model with different choices or velocity fields are told apart by a number."""
    models = [law.model for law in laws]
    repeats = [models[: number + 1].count(model) for number, model in enumerate(models)]
    return [f"{model}_{n}" if n > 1 else model for model, n in zip(models, repeats, strict=True)]
