"""How far a run is from the exact solution that its scene carries.

Errors are root mean squares over all particles, weighted with their reference volumes V0, relative to the largest such
mean of the exact solution so far: e_u = sqrt(sum V0 |x - X - u|^2 / max over time of sum V0 |u|^2). Sums run over the
particles of a layer and then over layers, and the functions are called layer by layer, so that no rank count shows.
"""

import math

import numpy as np

from pmpm.scene.errors import SceneError
from pmpm.scene.functions import Unfit
from pmpm.scene.messages import value_text

VOLUME, COMPLAINTS = "volume", "complaints"


class Errors:
    """Measures errors each time it is called: `simulation.every(errors, steps=1, at_start=True)`. Collective.

    Keys are "displacement" and, where the scene gives the functions, "velocity", "deformation" (of particles whose law keeps F)
    and "J" (all particles, against det F). Means of deformation and J are relative to those of F - I and J - 1.
    `largest` and `last` are relative errors, `inf` where the exact solution has been zero so far; `largest_rms`, `last_rms` and
    `reference_rms` the means themselves, in m, m/s and 1. All are the same on all ranks. A displacement on a periodic axis is
    that to the nearest image. In float32 X is known to 6e-8 of itself, and errors no better.
    Raises SceneError for a scene without `exact`, and, when called, where its functions fail.
    """

    def __init__(self, simulation):
        exact = simulation.scene.exact
        if exact is None:
            raise SceneError("scene: exact is missing: errors are measured against its functions of (X, t)")
        names = list(exact.shapes(simulation.dim))
        if exact.deformation is not None:
            kept = any(layout.where("F") is not None for layout in simulation.layouts)
            names = [name for name in names if name != "deformation" or kept] + ["J"]
        self.largest_rms, self.last_rms, self.reference_rms = (dict.fromkeys(names, 0.0) for _ in range(3))

    def __call__(self, simulation):
        sums = total(simulation, list(self.last_rms))
        for name in self.last_rms:
            volume = sums[VOLUME, name]
            self.last_rms[name] = math.sqrt(sums["error", name] / volume)
            self.largest_rms[name] = float(np.maximum(self.largest_rms[name], self.last_rms[name]))  # nan stays
            reference = math.sqrt(sums["exact", name] / volume)
            self.reference_rms[name] = max(self.reference_rms[name], reference)

    @property
    def largest(self):
        """{name: largest relative error of all calls}."""
        return {name: relative(rms, self.reference_rms[name]) for name, rms in self.largest_rms.items()}

    @property
    def last(self):
        """{name: relative error at the last call}."""
        return {name: relative(rms, self.reference_rms[name]) for name, rms in self.last_rms.items()}


def relative(rms, reference):
    if reference > 0.0:
        return rms / reference
    return 0.0 if rms == 0.0 else rms * math.inf


def total(simulation, names):
    """{(kind, name): sum over all ranks} of V0 |difference|^2 ("error"), V0 |exact|^2 ("exact") and V0. Collective."""
    layers = simulation.geometry.layers
    per_layer = {(kind, name): np.zeros(layers) for name in names for kind in ("error", "exact", VOLUME)}
    complaint = None
    try:
        for derived in simulation.derived(np.float64):
            layer = derived.population.per_particle(derived.population.block_layer)
            for name, (error, exact) in squares(simulation, derived, layer, names).items():
                for kind, values in (("error", error), ("exact", exact), (VOLUME, 1.0)):
                    weights = derived.volume0() * values
                    per_layer[kind, name] += np.bincount(layer, weights=weights, minlength=layers)
    except Unfit as error:
        complaint = str(error)
    failed = np.full(layers, float(complaint is not None))
    summed = simulation.comm.sum(np.stack([*per_layer.values(), failed]))
    if summed[-1].any():
        # Lower ranks own lower layers, so that the first complaint is the same for any number of ranks.
        raise SceneError(next(told for told in simulation.comm.gather(complaint) if told is not None))
    return {key: math.fsum(row) for key, row in zip(per_layer, summed, strict=False)}


def squares(simulation, derived, layer, names):
    """{name: (|difference|^2 (n,), |exact|^2 (n,))} of a law's particles, for what is known of them."""
    X, dim = derived.field("X").astype(np.float64), simulation.dim
    known = exact_values(simulation, X, layer)
    found = {"displacement": (displacement(simulation, derived.x() - X - known["displacement"]), known["displacement"])}
    if "velocity" in known:
        found["velocity"] = derived.velocity() - known["velocity"], known["velocity"]
    if "deformation" in known:
        F, identity = known["deformation"], np.eye(dim)
        held = derived.field("F")
        if held is not None:
            found["deformation"] = held.reshape(-1, dim, dim) - F, F - identity
        J = np.linalg.det(F)
        found["J"] = derived.J() - J, J - 1.0
    return {name: tuple(map(square, found[name])) for name in names if name in found}


def square(values):
    flat = values.reshape(len(values), math.prod(values.shape[1:])).astype(np.float64)
    return (flat * flat).sum(axis=1)


def displacement(simulation, difference):
    """A difference of positions (n, dim) in m, to the nearest image where the domain repeats."""
    size = np.array(simulation.scene.domain.size)
    for axis in np.flatnonzero(simulation.geometry.periodic):
        difference[:, axis] -= size[axis] * np.rint(difference[:, axis] / size[axis])
    return difference


def exact_values(simulation, X, layer):
    """{key: (n, ...)} of the exact solution at X (n, dim), now. Raises Unfit."""
    exact = simulation.scene.exact
    ends = np.flatnonzero(np.diff(layer, append=-1)) + 1
    found = {}
    for key, shape in exact.shapes(simulation.dim).items():
        values = np.zeros((len(X), *shape))
        for first, last in zip([0, *ends], ends, strict=False):
            try:
                values[first:last] = exact.at(key, X[first:last], simulation.time, shape)
            except Unfit as complaint:
                raise Unfit(f"scene: exact.{key} = {value_text(getattr(exact, key))} {complaint}") from None
        found[key] = values
    return found
