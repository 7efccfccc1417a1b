"""The compiled kernels of a scene: the loops with the scene's constants, one entry per law and phase."""

import os
import platform
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from pmpm.kernels import lane_loops, loops, scalar_loops, sorting, spans, targets
from pmpm.kernels.alignment import CACHE_LINE, aligned
from pmpm.kernels.lanes import WIDTH
from pmpm.kernels.needs import LawNeeds
from pmpm.physics import boundary

# Of each type of wall: rule on its nodes, image beyond it, whether it holds material on both ways.
WALLS = {
    "stick": (boundary.wall_stick, boundary.image_reversed, True),
    "slip": (boundary.wall_slip, boundary.image_mirrored, True),
    "separate": (boundary.wall_separate, boundary.image_mirrored, False),
    "friction": (boundary.wall_friction, boundary.image_mirrored, False),
}
PER_SCENE = ("add_gravity", "divide_by_mass")
PER_OPTION = ("damp",)  # likewise, only where a scene asks for them
PER_CUT = ("add_planes", "add_slots")  # called, hence compiled, only where there are cuts
PER_CONTACT = ("touch", "mirror_volumes")  # likewise, only where bodies may part, the other one where there are walls
PER_OPEN = ("count_beyond", "take_beyond")  # called, hence compiled, only where a face is open
PER_PLACES = ("count_moves", "take_leaving", "loosen", "permute")
SORTING = ("cell_order", "cut_segments")
LAYING_OUT = ("mark_cells", "find_spans", "place_spans")
OUT_OF_BLOCKS = ("take_rows", "take_positions")  # called, hence compiled, only where a checkpoint is written
LOOPS = {"lanes": lane_loops, "scalar": scalar_loops}
VECTOR_MACHINES = ("x86_64", "amd64", "aarch64", "arm64")


@dataclass(frozen=True)
class Kernels:
    """Entry kernels, and what the lanes work in.

    Per law p2g and g2p, p2g without impulses for schemes that blend velocities, p2g of volumes for contact, p2g of the
    divergence and what measures it for F-bar, what sums energies for the guard; `shared` by name; walls and images by wall
    type, colliders by surface.
    """

    p2g: tuple[Any, ...]
    g2p: tuple[Any, ...]
    sum_energies: tuple[Any, ...]
    shared: dict[str, Any]
    walls: dict[str, Any]
    images: dict[str, Any]
    colliders: dict[str, Any]
    scratch: np.ndarray
    first_nodes: np.ndarray
    constants: np.ndarray
    p2g_before: tuple[Any, ...] = ()
    p2g_volumes: tuple[Any, ...] = ()
    p2g_divergence: tuple[Any, ...] = ()
    measure_divergence: tuple[Any, ...] = ()

    def __getattr__(self, name):
        try:
            return self.shared[name]
        except KeyError:
            raise AttributeError(name) from None

    @property
    def entries(self):
        return {
            **{f"p2g {i}": kernel for i, kernel in enumerate(self.p2g)},
            **{f"g2p {i}": kernel for i, kernel in enumerate(self.g2p)},
            **{f"p2g before {i}": kernel for i, kernel in enumerate(self.p2g_before)},
            **{f"p2g volumes {i}": kernel for i, kernel in enumerate(self.p2g_volumes)},
            **{f"p2g divergence {i}": kernel for i, kernel in enumerate(self.p2g_divergence)},
            **{f"divergence {i}": kernel for i, kernel in enumerate(self.measure_divergence)},
            **{f"energies {i}": kernel for i, kernel in enumerate(self.sum_energies)},
            **self.shared,
            **{f"wall {name}": kernel for name, kernel in self.walls.items()},
            **{f"image {name}": kernel for name, kernel in self.images.items()},
            **{f"collider {name}": kernel for name, kernel in self.colliders.items()},
        }


def law_entries(needs, guarded):
    """Names of the entries that each law has of its own, as in `Kernels.entries` without the law's number; `guarded`: the
    energy of the run is watched."""
    blended = ["p2g before"] if needs.scheme.blends else []
    touching = ["p2g volumes"] if needs.contact else []
    averaged = ["p2g divergence", "divergence"] if needs.f_bar else []
    return ["p2g", "g2p", *blended, *touching, *averaged, *(["energies"] if guarded else [])]


def wall_entries(needs):
    return [f"{part} {name}" for part in ("wall", "image") for name in sorted(set(needs.wall_types) & set(WALLS))]


def collider_entries(needs):
    return [f"collider {name}" for name in needs.collider_types]


def contact_entries(needs):
    return [name for name in PER_CONTACT if needs.contact and (needs.wall_types or name != "mirror_volumes")]


def shared_entries(gravity, damped, cuts, opened=False, touching=()):
    """Names of the entries without a law that a run calls: the others are never compiled."""
    per_scene = [name for name in PER_SCENE if gravity or name != "add_gravity"]
    optional = [*(PER_OPTION if damped else ()), *(PER_CUT if cuts else ()), *(PER_OPEN if opened else ())]
    return [*per_scene, *optional, *touching, *PER_PLACES, *SORTING, *LAYING_OUT]


def chosen_loops():
    """PMPM_LOOPS if it is set, which may be anything; else the name of the faster of LOOPS on this machine: `scalar` where
    nobody has tried the vectors."""
    return os.environ.get("PMPM_LOOPS") or ("lanes" if platform.machine().lower() in VECTOR_MACHINES else "scalar")


def row_constants(stencil, real):
    """What a row of four nodes is computed from, node by node: distances, origins, then coefficients of the powers 0 .. 3 of
    weights and slopes, counted from the origins.

    The coefficients come out of the physics itself, by calling it with a polynomial.
    """
    from numpy.polynomial import Polynomial

    table = np.zeros((2 + 4 + 4, 4))
    table[0] = np.arange(4.0) - stencil.low
    for node, origin in enumerate(stencil.origins):
        table[1, node] = origin
        for first, function in ((2, stencil.weights), (6, stencil.slopes)):
            coefficients = (function(Polynomial([origin, 1.0]))[node] + Polynomial([0.0])).coef
            table[first : first + len(coefficients), node] = coefficients
    constants = aligned(lane_loops.CONSTANTS, real)
    constants[:] = np.repeat(table.ravel(), 4)
    return constants


def scene_choices(needs):
    """Constants and functions that depend on the scene but not on the law."""
    slab, middle, row = needs.axes
    stencil, two, places = needs.stencil, needs.dim == 2, needs.places
    vector = needs.dim
    return {
        "la": needs.tensors,
        "integer": places.integer.type,
        "DIMENSIONS": needs.dim,
        "SLAB": slab,
        "MIDDLE": middle,
        "ROW": row,
        "NODES": stencil.nodes,
        "WINDOW": stencil.window,
        "BEFORE_RING": int(needs.scheme.blends),
        "DIVERGENCE_RING": needs.scheme.blends + needs.f_bar,
        "MIDDLE_NODES": 1 if two else stencil.nodes,
        "INERTIA": stencil.inertia,
        "OFFSETS": stencil.offsets,
        "FRACTION": places.fraction,
        "HALF": places.whole(stencil.round),
        "CENTRE": places.whole(0.5 - stencil.round),
        "UNIT": places.unit,
        "ONE_CELL": 2.0**places.fraction,
        "AFFINE": needs.scheme.affine,
        "BY_INERTIA": needs.affine_by_inertia,
        "MLS": needs.scheme.mls,
        "BLENDS": needs.scheme.blends,
        "F_BAR": needs.f_bar,
        "FORCED": needs.body_force is not None,
        "body_force": needs.body_force or loops.no_force,
        "LOADED": needs.loaded,
        "SHARED": needs.shared,
        "DRIVEN": needs.driven,
        "ENDS_MIDDLE": not two and needs.has_ends(middle),
        "ENDS_ROW": needs.has_ends(row),
        "OPEN": needs.open,
        "V_FIELD": vector,
        "weights": stencil.weights,
        "slopes": stencil.slopes,
        "load_normal": loops.normal_2 if two else loops.normal_3,
        "node_of_segment": loops.node_of_segment_2 if two else loops.node_of_segment_3,
        "momentum_at": loops.momentum_2 if two else loops.momentum_3,
        "vector_in": loops.vector_in_2 if two else loops.vector_in_3,
        "MOMENTS": 1 if two else 3,
        "BEYOND": stencil.beyond,
    }


def scalar_choices(needs):
    """What the scalar loops take besides."""
    two = needs.dim == 2
    return {
        "along_first": lane_loops.along_first_2 if two else lane_loops.along_first_3,
        "load_vector": scalar_loops.FIELD_TUPLES[needs.dim],
        "load_matrix": scalar_loops.FIELD_TUPLES[needs.dim**2],
        "vector_at": scalar_loops.vector_at_2 if two else scalar_loops.vector_at_3,
        "along_axes": scalar_loops.along_axes_2 if two else scalar_loops.along_axes_3,
        "stencil_node": scalar_loops.stencil_node_2 if two else scalar_loops.stencil_node_3,
        "cells_to_metres": scalar_loops.cells_to_metres_2 if two else scalar_loops.cells_to_metres_3,
    }


def lane_choices(needs):
    """What the loops on lanes take besides."""
    two, n = needs.dim == 2, needs.stencil.nodes
    group = {needs.axes[0]: 1, needs.axes[1]: 2, needs.axes[2]: 3}
    by_nodes = {
        name: getattr(lane_loops, f"{name}_{n}") for name in ("moments", "row_weights", "add_particle", "flush")
    }
    across = 1 if two else n
    by_middle = {name: getattr(lane_loops, f"{name}_{across}") for name in ("add_slab", "flush_slab", "gather_slab")}
    by_dimension = {
        name: getattr(lane_loops, f"{name}_{needs.dim}")
        for name in ("store_column", "store_constant", "vector", "matrix", "position", "along_first", "largest_part")
    }
    return {
        "LINE": CACHE_LINE // np.dtype(needs.precision).itemsize,
        "load_vector": lane_loops.FIELD_TUPLES[needs.dim],
        "load_matrix": lane_loops.FIELD_TUPLES[needs.dim**2],
        "empty_stencil": getattr(lane_loops, f"stencil_{n}"),
        "middle_rows": getattr(lane_loops, f"rows_{across}"),
        "gather_slabs": getattr(lane_loops, f"gather_slabs_{n}"),
        "GROUP": (group[0], group[1], group.get(2, 0)),
        "store_column": by_dimension["store_column"],
        "store_constant": by_dimension["store_constant"],
        "vector_of": by_dimension["vector"],
        "matrix_of": by_dimension["matrix"],
        "position_of": by_dimension["position"],
        "along_first": by_dimension["along_first"],
        "largest_part": by_dimension["largest_part"],
        **by_nodes,
        **by_middle,
    }


def law_choices(law, layout, parameter_count, tuples, real):
    """Constants and functions of one law."""
    first = {
        name: where.start if (where := layout.where(name)) else 0 for name in ("C", "X", "load", "divergence", "share")
    }
    return dict(law.choices) | {
        "law": law.module,
        "FIELDS": layout.size,
        "C_FIELD": first["C"],
        "STORES_C": layout.where("C") is not None,
        "REFERENCE_FIELD": first["X"],
        "DIVERGENCE_FIELD": first["divergence"],
        "LOAD_FIELD": first["load"],
        "SHARE_FIELD": first["share"],
        "STATE_FIELD": layout.state_first,
        "LINES": -(-layout.size * real.itemsize // CACHE_LINE),
        "load_state": tuples[layout.size - layout.state_first],
        "PARAMETERS": parameter_count,
    }


def phases(needs):
    """{phase: (name of its loop, choices besides those of scene and law)} of the kernels of particles that a scene needs."""
    whole = {"IMPULSE": True, "BY_GRADIENT": not needs.scheme.mls}
    silent = {"IMPULSE": False, "BY_GRADIENT": False, "FORCED": False, "DRIVEN": False}
    volumes = silent | {"VOLUMES": True, "BY_GRADIENT": True, "AFFINE": False, "MLS": False}
    found = {"p2g": ("p2g", whole), "g2p": ("g2p", whole)}
    if needs.scheme.blends:
        found["p2g_before"] = "p2g", silent
    if needs.contact:
        found["p2g_volumes"] = "p2g", volumes
    if needs.f_bar:
        found["p2g_divergence"] = "p2g", silent | {"DIVERGENCE": True, "AFFINE": False}
        found["measure_divergence"] = "measure_divergence", {"MLS": False, "BY_INERTIA": False}
    return found


def entries_of_laws(needs, make, module, of_laws):
    """{phase: entries, one for each law}: loops of a module for a target `make`, with these choices of each law."""
    return {
        phase: one_for_each(needs.laws, [of_law | choices for of_law in of_laws], make, getattr(module, loop))
        for phase, (loop, choices) in phases(needs).items()
    }


def one_for_each(laws, of_laws, make, loop):
    """An entry of a loop for each law; laws that differ in their velocity field alone share one."""
    made: dict[LawNeeds, Any] = {}
    for law, of_law in zip(laws, of_laws, strict=True):
        anywhere = replace(law, velocity_field=0)
        if anywhere not in made:
            made[anywhere] = make(**of_law).entry(loop)
    return tuple(made[replace(law, velocity_field=0)] for law in laws)


def entries_of_walls(needs, make, module, scene):
    """({wall type: entry of its rule}, the same of its image)."""
    walls, images = {}, {}
    for name in sorted(set(needs.wall_types) & set(WALLS)):
        wall, image, two_sided = WALLS[name]
        target = make(**scene, wall=wall, image=image, TWO_SIDED=two_sided)
        walls[name], images[name] = target.entry(module.apply_wall), target.entry(module.fill_beyond_wall)
    return walls, images


def entries_of_colliders(needs, make, module, scene):
    """{surface of colliders: entry of its rule}."""
    return {name: make(**scene, wall=WALLS[name][0]).entry(module.collide) for name in needs.collider_types}


def build(needs, layouts, parameter_counts, kind, threads=1):
    """Kernels for these needs, not compiled yet: numba compiles at the first call. Layouts and counts are per law; `kind` is
    one of LOOPS.
    """
    targets.use_cache_folder()
    real = np.dtype(needs.precision).type
    module = LOOPS[kind]
    make = partial(targets.lanes if module is lane_loops else targets.scalar, real)
    own = lane_choices(needs) if module is lane_loops else scalar_choices(needs)
    scene, scalar = scene_choices(needs), partial(targets.scalar, real)
    general = scalar(**scene)
    per_law = list(zip(needs.laws, layouts, parameter_counts, strict=True))
    of_laws = [scene | own | law_choices(*law, module.FIELD_TUPLES, np.dtype(real)) for law in per_law]
    to_sum = [
        scene | scalar_choices(needs) | law_choices(*law, scalar_loops.FIELD_TUPLES, np.dtype(real)) for law in per_law
    ]
    walls, images = entries_of_walls(needs, scalar, loops, scene)
    shared = {name: general.entry(getattr(loops, name)) for name in (*PER_SCENE, *PER_OPTION, *PER_CUT, *PER_CONTACT)}
    for_places = targets.scalar(real)
    shared |= {name: for_places.entry(getattr(sorting, name)) for name in (*PER_PLACES, *PER_OPEN)}
    for_orders = targets.scalar(np.float64)
    shared |= {name: for_orders.entry(getattr(sorting, name)) for name in (*SORTING, *OUT_OF_BLOCKS)}
    shared |= {name: for_orders.entry(getattr(spans, name)) for name in LAYING_OUT}
    return Kernels(
        **entries_of_laws(needs, make, module, of_laws),
        sum_energies=one_for_each(needs.laws, to_sum, scalar, scalar_loops.sum_energies),
        shared=shared,
        walls=walls,
        images=images,
        colliders=entries_of_colliders(needs, scalar, loops, scene),
        scratch=aligned(threads * lane_loops.SCRATCH, real).reshape(threads, -1),
        first_nodes=aligned(threads * WIDTH, np.int32).reshape(threads, -1),
        constants=row_constants(needs.stencil, real),
    )
