"""The kernels of a scene for graphics cards: the same physics, the loops of cuda_loops."""

from dataclasses import dataclass
from functools import partial
from typing import Any

import numba
import numpy as np

from pmpm.kernels import cuda_loops, cuda_sorting, scalar_loops, targets
from pmpm.kernels.build import (
    entries_of_colliders,
    entries_of_laws,
    entries_of_walls,
    law_choices,
    scalar_choices,
    scene_choices,
)

THREADS = 128  # of a block of threads: eight blocks of particles
TILE_BYTES = 24_000  # of shared memory; a block of threads may have 48 kB, with half of it more blocks run at a time
OF_NODES = ("clear", "copy", "sum_images", "add_received", "add_gravity", "damp", "divide_by_mass", "impose",
            "touch", "mirror_volumes")  # fmt: skip
SORTING = (
    "find_homes", "pack_leaving", "count_digits", "sum_tiles", "add_totals", "move_by_digit", "find_segments",
    "describe_blocks", "gather_fields", "put_fields", "gather_ids", "put_ids",
)  # fmt: skip
OF_NUMBERS = ("mark", "forget", "clear_reals", "clear_words")


@dataclass(frozen=True)
class CudaKernels:
    """Entry kernels: per law those of particles, `nodes` and `sorting` by name, walls and images by wall type, colliders by
    surface."""

    p2g: tuple[Any, ...]
    g2p: tuple[Any, ...]
    sum_energies: tuple[Any, ...]
    mark: Any
    forget: Any
    clear_reals: Any
    clear_words: Any
    nodes: dict[str, Any]
    sorting: dict[str, Any]
    walls: dict[str, Any]
    images: dict[str, Any]
    colliders: dict[str, Any]
    threads: int  # of a block of threads
    p2g_before: tuple[Any, ...] = ()
    p2g_volumes: tuple[Any, ...] = ()
    p2g_divergence: tuple[Any, ...] = ()
    measure_divergence: tuple[Any, ...] = ()

    @property
    def entries(self):
        """{name: kernel}."""
        per_law = ("p2g", "g2p", "p2g_before", "p2g_volumes", "p2g_divergence", "measure_divergence", "sum_energies")
        found = {f"{name} {i}": kernel for name in per_law for i, kernel in enumerate(getattr(self, name))}
        found |= {name: getattr(self, name) for name in OF_NUMBERS} | self.nodes | self.sorting
        found |= {f"wall {name}": kernel for name, kernel in self.walls.items()}
        found |= {f"image {name}": kernel for name, kernel in self.images.items()}
        return found | {f"collider {name}": kernel for name, kernel in self.colliders.items()}


def build(needs, layouts, parameter_counts, tiled=True):
    """Kernels for these needs, not compiled yet. Layouts and counts are per law; `tiled`: see cuda_loops.p2g."""
    targets.use_cache_folder()
    numba.config.CUDA_LOW_OCCUPANCY_WARNINGS = 0  # type: ignore[attr-defined]  # some kernels have little to do
    real = np.dtype(needs.precision).type
    make = partial(targets.cuda, real)
    scene = scene_choices(needs) | scalar_choices(needs)
    scene |= {"TILED": tiled, "TILE_REALS": TILE_BYTES // np.dtype(real).itemsize}
    scene |= {"THREADS": THREADS, "COUNTERS": cuda_sorting.DIGITS * THREADS}
    general, tuples = make(**scene), scalar_loops.FIELD_TUPLES
    of_laws = [
        scene | law_choices(law, layout, count, tuples, np.dtype(real)) | {"load_row": tuples[max(count, 1)]}
        for law, layout, count in zip(needs.laws, layouts, parameter_counts, strict=True)
    ]
    walls, images = entries_of_walls(needs, make, cuda_loops, scene)
    return CudaKernels(
        **entries_of_laws(needs, make, cuda_loops, of_laws),
        sum_energies=tuple(make(**of_law).entry(cuda_loops.sum_energies) for of_law in of_laws),
        **{name: general.entry(getattr(cuda_loops, name)) for name in OF_NUMBERS},
        nodes={name: general.entry(getattr(cuda_loops, name)) for name in OF_NODES},
        sorting={name: general.entry(getattr(cuda_sorting, name)) for name in SORTING},
        walls=walls,
        images=images,
        colliders=entries_of_colliders(needs, make, cuda_loops, scene),
        threads=THREADS,
    )
