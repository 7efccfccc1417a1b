"""The compiled kernels of a scene: cpu.py's loops with the scene's constants, one entry per law and phase."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from pmpm.kernels import cpu, targets
from pmpm.physics import boundary, bspline

# Of each type of wall: rule on its nodes, image beyond it, whether it holds material on both ways.
WALLS = {
    "stick": (boundary.wall_stick, boundary.image_reversed, True),
    "slip": (boundary.wall_slip, boundary.image_mirrored, True),
    "separate": (boundary.wall_separate, boundary.image_mirrored, False),
    "friction": (boundary.wall_friction, boundary.image_mirrored, False),
}


@dataclass(frozen=True)
class Kernels:
    """Entry kernels: p2g and g2p per law, the others per scene; `walls` and `images` by wall type."""

    p2g: tuple[Any, ...]
    g2p: tuple[Any, ...]
    fold_windows: Any
    add_gravity: Any
    divide_by_mass: Any
    walls: dict[str, Any]
    images: dict[str, Any]

    @property
    def entries(self):
        return {
            **{f"p2g {i}": kernel for i, kernel in enumerate(self.p2g)},
            **{f"g2p {i}": kernel for i, kernel in enumerate(self.g2p)},
            "fold_windows": self.fold_windows,
            "add_gravity": self.add_gravity,
            "divide_by_mass": self.divide_by_mass,
            **{f"wall {name}": kernel for name, kernel in self.walls.items()},
            **{f"image {name}": kernel for name, kernel in self.images.items()},
        }


def scene_choices(needs):
    """Constants and functions that depend on the scene but not on the law."""
    slab, middle, row = needs.axes
    stencil, two = needs.stencil, needs.dim == 2
    vector, matrix = needs.dim, needs.dim * needs.dim
    return {
        "la": needs.tensors,
        "DIMENSIONS": needs.dim,
        "SLAB": slab,
        "MIDDLE": middle,
        "ROW": row,
        "NODES": stencil.nodes,
        "MIDDLE_NODES": 1 if two else stencil.nodes,
        "ROUND": stencil.round,
        "INERTIA": stencil.inertia,
        "OFFSETS": tuple(float(n - stencil.low) for n in range(stencil.nodes)),
        "MLS": needs.transfer == "mls",
        "V_FIELD": vector,
        "C_FIELD": 2 * vector,
        "STATE_FIELD": 2 * vector + matrix,
        "weights": bspline.weights_quadratic,
        "slopes": bspline.slopes_quadratic,
        "load_vector": cpu.LOADS[vector],
        "load_matrix": cpu.LOADS[matrix],
        "load_normal": cpu.normal_2 if two else cpu.normal_3,
        "centres": cpu.centres_2 if two else cpu.centres_3,
        "along_axes": cpu.along_axes_2 if two else cpu.along_axes_3,
        "stencil_node": cpu.stencil_node_2 if two else cpu.stencil_node_3,
        "momentum_at": cpu.momentum_2 if two else cpu.momentum_3,
    }


def law_choices(law, layout, parameter_count):
    """Constants and functions of one law."""
    state_size = layout.size - layout.state_first
    return dict(law.choices) | {
        "law": law.module,
        "load_state": cpu.LOADS[state_size],
        "load_parameters": cpu.ROWS[parameter_count],
    }


def build(needs, layouts, parameter_counts):
    """Kernels for these needs, not compiled yet: numba compiles at the first call. Layouts and counts are per law."""
    targets.use_cache_folder()
    real = np.dtype(needs.precision).type
    scene = scene_choices(needs)
    general = targets.scalar(real, **scene)
    p2g, g2p = [], []
    for law, layout, count in zip(needs.laws, layouts, parameter_counts, strict=True):
        target = targets.scalar(real, **scene, **law_choices(law, layout, count))
        p2g.append(target.entry(cpu.p2g))
        g2p.append(target.entry(cpu.g2p))
    walls, images = {}, {}
    for name in sorted(set(needs.wall_types) & set(WALLS)):
        wall, image, two_sided = WALLS[name]
        target = targets.scalar(real, **scene, wall=wall, image=image, TWO_SIDED=two_sided)
        walls[name], images[name] = target.entry(cpu.apply_wall), target.entry(cpu.fill_beyond_wall)
    return Kernels(
        tuple(p2g),
        tuple(g2p),
        general.entry(cpu.fold_windows),
        general.entry(cpu.add_gravity),
        general.entry(cpu.divide_by_mass),
        walls,
        images,
    )
