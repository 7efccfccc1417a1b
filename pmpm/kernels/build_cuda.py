"""The kernels of a scene for graphics cards: the same physics, the loops of cuda_loops."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from pmpm.kernels import cuda_loops, scalar_loops, targets
from pmpm.kernels.build import WALLS, law_choices, scalar_choices, scene_choices

TILE_BYTES = (
    24_000  # of shared memory, of which a block of threads may have 48 kB: two such blocks and more run at a time
)
OF_NODES = ("fill", "copy", "sum_images", "add_gravity", "damp", "divide_by_mass", "impose")


@dataclass(frozen=True)
class CudaKernels:
    """Entry kernels: per law those of particles, `nodes` by name, walls and images by wall type."""

    p2g: tuple[Any, ...]
    g2p: tuple[Any, ...]
    p2g_before: tuple[Any, ...]
    p2g_divergence: tuple[Any, ...]
    measure_divergence: tuple[Any, ...]
    sum_energies: tuple[Any, ...]
    mark: Any
    nodes: dict[str, Any]
    walls: dict[str, Any]
    images: dict[str, Any]

    @property
    def entries(self):
        """{name: kernel}."""
        per_law = ("p2g", "g2p", "p2g_before", "p2g_divergence", "measure_divergence", "sum_energies")
        found = {f"{name} {i}": kernel for name in per_law for i, kernel in enumerate(getattr(self, name))}
        found |= {"mark": self.mark} | self.nodes
        found |= {f"wall {name}": kernel for name, kernel in self.walls.items()}
        return found | {f"image {name}": kernel for name, kernel in self.images.items()}


def build(needs, layouts, parameter_counts, tiled=True):
    """Kernels for these needs, not compiled yet. Layouts and counts are per law; `tiled`: see cuda_loops.p2g."""
    targets.use_cache_folder()
    real = np.dtype(needs.precision).type
    scene = scene_choices(needs) | scalar_choices(needs)
    scene |= {"TILED": tiled, "TILE_REALS": TILE_BYTES // np.dtype(real).itemsize}
    general = targets.cuda(real, **scene)
    p2g, g2p, before, divergences, measures, energies = [], [], [], [], [], []
    for law, layout, count in zip(needs.laws, layouts, parameter_counts, strict=True):
        own = scene | law_choices(law, layout, count, scalar_loops.FIELD_TUPLES, np.dtype(real))
        own |= {"load_row": scalar_loops.FIELD_TUPLES[max(count, 1)]}
        target = targets.cuda(real, **own, IMPULSE=True, BY_GRADIENT=not needs.scheme.mls)
        p2g.append(target.entry(cuda_loops.p2g))
        g2p.append(target.entry(cuda_loops.g2p))
        energies.append(target.entry(cuda_loops.sum_energies))
        silent = {"IMPULSE": False, "BY_GRADIENT": False, "FORCED": False, "DRIVEN": False}
        if needs.scheme.blends:
            before.append(targets.cuda(real, **(own | silent)).entry(cuda_loops.p2g))
        if needs.f_bar:
            counts_volume = own | silent | {"DIVERGENCE": True, "AFFINE": False}
            divergences.append(targets.cuda(real, **counts_volume).entry(cuda_loops.p2g))
            by_slope = own | {"MLS": False, "BY_INERTIA": False}
            measures.append(targets.cuda(real, **by_slope).entry(cuda_loops.measure_divergence))
    walls, images = {}, {}
    for name in sorted(set(needs.wall_types) & set(WALLS)):
        wall, image, two_sided = WALLS[name]
        target = targets.cuda(real, **scene, wall=wall, image=image, TWO_SIDED=two_sided, BEYOND=needs.stencil.beyond)
        walls[name], images[name] = target.entry(cuda_loops.apply_wall), target.entry(cuda_loops.fill_beyond_wall)
    nodes = {name: general.entry(getattr(cuda_loops, name)) for name in OF_NODES}
    return CudaKernels(
        tuple(p2g), tuple(g2p), tuple(before), tuple(divergences), tuple(measures), tuple(energies),
        general.entry(cuda_loops.mark), nodes, walls, images,
    )  # fmt: skip
