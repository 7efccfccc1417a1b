"""A case with an exact solution as plain numbers, for codes other than pmpm: what taichi_exact.py and warp_exact.py solve.

All of them: neo-Hookean, MLS-MPM with quadratic splines, symplectic Euler, the body force of the exact solution at each
particle's place in the undeformed body. The particles are pmpm's, in its order (by cell), which suits caches.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Waves:
    """u_i = A sin(k X_i) sin(w t + phases_i) in a periodic box (Wallstedt and Guilkey 2008)."""

    A: float
    k: float
    w: float
    phases: tuple


@dataclass(frozen=True)
class Vortex:
    """Material turned by A sin(w t) (16 (R - 1)^2 - 1)^2 about a centre (Brannon, Kamojjala and Sadeghirad 2011)."""

    A: float
    w: float
    centre: tuple


@dataclass(frozen=True)
class Problem:
    """x, v (n, dim), F (n, dim, dim) at the start and X (n, dim), float64; `nodes` of the grid per axis; SI units."""

    force: Waves | Vortex
    nodes: tuple
    cell_size: float
    periodic: bool
    mu: float
    lam: float
    density: float
    volume: float  # of a particle
    step: float
    X: np.ndarray
    x: np.ndarray
    v: np.ndarray
    F: np.ndarray

    @property
    def dim(self):
        return self.X.shape[1]
