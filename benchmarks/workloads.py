"""What benchmarks/kernels.py times: the same block of particles for every code, as plain numbers.

A block of 51^3 cells with 8 particles per cell on average, at random places, in the middle of a unit cube of 128^3 cells;
it turns, falls and is sheared, so that particles change cells. Random places make cells of unequal fill: harder than a
lattice. Particles are numbered cell by cell; `x` and `v` are float32 values, so that every code starts from the same ones.
"""

import math
from dataclasses import dataclass

import numpy as np

STEP = 1e-4  # s
GRAVITY = -9.8  # m/s2, along y
DENSITY = 1.0  # kg/m3
YOUNGS_MODULUS, POISSON_RATIO = 1000.0, 0.2
MU = YOUNGS_MODULUS / (2.0 * (1.0 + POISSON_RATIO))
LAM = YOUNGS_MODULUS * POISSON_RATIO / ((1.0 + POISSON_RATIO) * (1.0 - 2.0 * POISSON_RATIO))
BULK_MODULUS = 400.0  # of water: p = B (1/J - 1), Tait with gamma = 1, and no tension
FRICTION_ANGLE = 45.0
SIN_PHI = math.sin(math.radians(FRICTION_ANGLE))
ALPHA = math.sqrt(2.0 / 3.0) * 2.0 * SIN_PHI / (3.0 - SIN_PHI)  # triaxial fit
SLOPE = ALPHA * (3.0 * LAM + 2.0 * MU) / (2.0 * MU)  # Drucker-Prager cone in strains: |dev E| <= SLOPE (-tr E)
NOISE = 0.03  # of the deformation gradient at the start
FAST = 0.19  # cells per step of the fastest particle in the fast variant; pmpm refuses more than 0.2
LAWS = {"W1": "jelly", "W2": "sand", "W3": "water"}


@dataclass(frozen=True)
class Workload:
    """One case: `name` W1 jelly (neo-Hookean), W2 sand (Drucker-Prager), W3 water (J alone); `cells` per metre.

    In 2-D the domain is 5 x 5 and the block 4 x 4, with the same cell size, step and speeds: 1.05e6 particles at 128 cells.
    `length`: blocks one after the other along x, without a gap, in a domain that is longer by as much.
    """

    name: str
    cells: int = 128
    dim: int = 3
    length: int = 1

    @property
    def cell_size(self):
        return 1.0 / self.cells

    @property
    def domain_cells(self):
        return self.cells if self.dim == 3 else 5 * self.cells

    @property
    def block_cells(self):
        return round(0.4 * self.cells) if self.dim == 3 else 4 * self.cells

    @property
    def first_cell(self):
        return (self.domain_cells - self.block_cells) // 2

    @property
    def particles_per_cell(self):
        return 2**self.dim

    @property
    def domain_shape(self):
        """Cells along each axis."""
        longer = (self.length - 1) * self.block_cells
        return (self.domain_cells + longer, *[self.domain_cells] * (self.dim - 1))

    @property
    def block_shape(self):
        """Cells along each axis."""
        return (self.block_cells * self.length, *[self.block_cells] * (self.dim - 1))

    @property
    def particles(self):
        return math.prod(self.block_shape) * self.particles_per_cell

    @property
    def volume(self):
        """Of one particle, in m3 (m2 in 2-D)."""
        return self.cell_size**self.dim / self.particles_per_cell


@dataclass(frozen=True)
class Start:
    """Particles at the start: x, v (n, dim) float32; F (n, dim, dim), strain (n, dim, dim) and v_c (n,) float64.

    The strain lies inside the cone already: pmpm takes stress from the state at once, the peers after a return map that
    must then change nothing. F is the stretch that belongs to it, in W1 any deformation, in W3 the identity.
    """

    x: np.ndarray
    v: np.ndarray
    F: np.ndarray
    strain: np.ndarray
    v_c: np.ndarray


def start(workload, fast=False, seed=0):
    """The Start of a workload; `fast`: the whole block also flies along the diagonal, at FAST cells per step.

    Faster flight, not faster shear: that would stretch the jelly until its waves allow no step of 1e-4 s.
    """
    random = np.random.default_rng(seed)
    count, dim, cell = workload.particles, workload.dim, workload.cell_size
    edge = workload.block_cells * cell
    x = workload.first_cell * cell + np.array(workload.block_shape) * cell * random.random((count, dim))
    base = np.floor(x / cell - 0.5).astype(np.int64)
    x = x[np.lexsort(base.T[::-1])].astype(np.float32)
    v = velocity((x - x.mean(axis=0)) / edge)
    if fast:
        v = v + flight(v, FAST * cell / STEP)
    F = np.broadcast_to(np.eye(dim), (count, dim, dim))
    strain, v_c = np.zeros_like(F), np.zeros(count)
    if workload.name != "W3":
        F = F + NOISE * random.standard_normal(F.shape)
    if workload.name == "W2":
        strain, v_c = inside_cone(F)
        stretches, axes = np.linalg.eigh(strain)
        F = spectral(axes, np.exp(stretches))
    return Start(x, v.astype(np.float32), F, strain, v_c)


def velocity(place):
    """(n, dim) m/s at places around the middle, in edges of one block."""
    parts = [-0.8 * place[:, 1], 0.8 * place[:, 0] - 1.0]
    if place.shape[1] == 3:
        parts.append(np.sin(8.0 * place[:, 2]))
    return np.stack(parts, axis=1)


def flight(v, fastest):
    """(dim,) the velocity along the diagonal that brings the fastest of `v` to `fastest`."""
    direction = np.full(v.shape[1], v.shape[1] ** -0.5)
    along = v @ direction
    return direction * np.min(np.sqrt(along**2 - np.sum(v**2, axis=1) + fastest**2) - along)


def spectral(axes, values):
    """Q diag(values) Q^T for each particle."""
    return np.einsum("nij,nj,nkj->nik", axes, values, axes)


def inside_cone(F):
    """(strain, v_c): the Hencky strain of F F^T returned to the Drucker-Prager cone, and the volume spent at its tip."""
    squares, axes = np.linalg.eigh(F @ F.transpose(0, 2, 1))
    e = 0.5 * np.log(squares)
    trace = e.sum(axis=1)
    deviator = e - trace[:, None] / 3.0
    closed = np.minimum(trace, 0.0)
    shrink = np.minimum(1.0, SLOPE * -closed / np.linalg.norm(deviator, axis=1))
    return spectral(axes, shrink[:, None] * deviator + closed[:, None] / 3.0), trace - closed
