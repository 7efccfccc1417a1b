"""Axis-aligned manufactured solution (Wallstedt and Guilkey, J. Comput. Phys. 227 (2008) 9628), for four elastic laws.

u_i = A sin(k X_i) sin(w t + phi_i), so that F = diag(1 + A k cos(k X_i) sin(w t + phi_i)), in a periodic box or between slip
walls, driven by the body force that makes it exact:

    b_i = u_i (k^2 m_i / rho0 - w^2), with J = prod F_ii and
    neo-Hookean       m_i = mu + (mu - lam (ln J - 1)) / F_ii^2
    fixed corotated   m_i = 2 mu + lam (J / F_ii)^2
    Hencky            m_i = (2 mu + lam - 2 mu ln F_ii - lam ln J) / F_ii^2
    fluid             m_i = B J^(-gamma - 1) (J / F_ii)^2

from Div P = -rho0 k^2 m_i u_i, P_ii the derivative of the energy. One function is compiled with each law's m_i and constants.
"""

import math
from dataclasses import dataclass
from types import FunctionType

import numpy as np

import pmpm
from pmpm.physics.words import cos, exp, log, sin

GAMMA = 7.0
DENSITY = 1.0
WIDTH = 8  # cells across a solution that moves along x only

# ---- the body force, compiled: names in capitals, and `m`, are those of a solution in the copy that it gets -----------------

AMPLITUDE = PHASE = (0.0, 0.0, 0.0)
WAVE = FREQUENCY = 0.0
MODULI = (0.0, 0.0)  # mu and lam, of a fluid B and gamma


def m_of_neo_hookean(F, J, mu, lam):
    return mu + (mu - lam * (log(J) - 1.0)) / (F * F)


def m_of_fixed_corotated(F, J, mu, lam):
    others = J / F
    return 2.0 * mu + lam * others * others


def m_of_hencky(F, J, mu, lam):
    return (2.0 * mu + lam - 2.0 * mu * log(F) - lam * log(J)) / (F * F)


def m_of_fluid(F, J, bulk_modulus, gamma):
    others = J / F
    return bulk_modulus * exp(-(gamma + 1.0) * log(J)) * others * others


m = m_of_neo_hookean


def motion(X, t, amplitude, phase, wave, frequency):
    """(displacement, stretch) along an axis."""
    swing = amplitude * sin(frequency * t + phase)
    return swing * sin(wave * X), 1.0 + wave * swing * cos(wave * X)


def force(u, m_of_axis, wave, frequency):
    return u * (wave * wave * m_of_axis / DENSITY - frequency * frequency)


def force_2d(x, X, t):
    ux, Fx = motion(X[0], t, AMPLITUDE[0], PHASE[0], WAVE, FREQUENCY)
    uy, Fy = motion(X[1], t, AMPLITUDE[1], PHASE[1], WAVE, FREQUENCY)
    J = Fx * Fy
    return (
        force(ux, m(Fx, J, MODULI[0], MODULI[1]), WAVE, FREQUENCY),
        force(uy, m(Fy, J, MODULI[0], MODULI[1]), WAVE, FREQUENCY),
    )


def force_3d(x, X, t):
    ux, Fx = motion(X[0], t, AMPLITUDE[0], PHASE[0], WAVE, FREQUENCY)
    uy, Fy = motion(X[1], t, AMPLITUDE[1], PHASE[1], WAVE, FREQUENCY)
    uz, Fz = motion(X[2], t, AMPLITUDE[2], PHASE[2], WAVE, FREQUENCY)
    J = Fx * Fy * Fz
    return (
        force(ux, m(Fx, J, MODULI[0], MODULI[1]), WAVE, FREQUENCY),
        force(uy, m(Fy, J, MODULI[0], MODULI[1]), WAVE, FREQUENCY),
        force(uz, m(Fz, J, MODULI[0], MODULI[1]), WAVE, FREQUENCY),
    )


LAWS = {
    "neo_hookean": m_of_neo_hookean,
    "fixed_corotated": m_of_fixed_corotated,
    "hencky": m_of_hencky,
    "fluid": m_of_fluid,
}


# ---- the solution and its scene ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class AxisAligned:
    """A solution in a unit box (m), of unit modulus (Pa) and density: E of a solid, B of a fluid, so that sqrt(E / rho0) is 1.

    `strain` is A k; `moving`: along how many axes it moves, the others being a few cells wide where only one does.
    """

    dim: int = 2
    moving: int = 2
    law: str = "neo_hookean"
    poisson_ratio: float = 0.3
    strain: float = 0.1
    walls: bool = False

    @property
    def wave(self):
        return math.pi if self.walls else 2.0 * math.pi

    @property
    def period(self):
        """Of the solution, s: its frequency is k sqrt(E / rho0)."""
        return 2.0 * math.pi / self.wave

    @property
    def amplitudes(self):
        return tuple(self.strain / self.wave if axis < self.moving else 0.0 for axis in range(3))

    @property
    def phases(self):
        return (0.0, 2.0 * math.pi / 3.0, 4.0 * math.pi / 3.0) if self.walls else (0.0, 1.0, 2.0)

    @property
    def material(self):
        if self.law == "fluid":
            keys = {"bulk_modulus": 1.0, "gamma": GAMMA, "tension_cutoff": False}
        else:
            keys = {"youngs_modulus": 1.0, "poisson_ratio": self.poisson_ratio}
        return {"model": self.law, "density": DENSITY, **keys}

    @property
    def moduli(self):
        nu = self.poisson_ratio
        if self.law == "fluid":
            return 1.0, GAMMA
        return 0.5 / (1.0 + nu), nu / ((1.0 + nu) * (1.0 - 2.0 * nu))

    def swings(self, t):
        angles = self.wave * t + np.array(self.phases)
        amplitudes = np.array(self.amplitudes)
        swing, rate = amplitudes * np.sin(angles), self.wave * amplitudes * np.cos(angles)
        return swing[: self.dim], rate[: self.dim]

    def displacement(self, X, t):
        return self.swings(t)[0] * np.sin(self.wave * X)

    def velocity(self, X, t):
        return self.swings(t)[1] * np.sin(self.wave * X)

    def deformation(self, X, t):
        stretches = 1.0 + self.wave * self.swings(t)[0] * np.cos(self.wave * X)
        return stretches[:, :, None] * np.eye(self.dim)

    @property
    def body_force(self):
        """The function b(x, X, t) of this solution, which kernels can compile."""
        names = {
            "m": LAWS[self.law],
            "AMPLITUDE": self.amplitudes,
            "PHASE": self.phases,
            "WAVE": self.wave,
            "FREQUENCY": self.wave,
            "MODULI": self.moduli,
        }
        source = force_2d if self.dim == 2 else force_3d
        return FunctionType(source.__code__, source.__globals__ | names, source.__name__)

    def scene(
        self,
        cells,
        transfer="mls",
        shape_function="quadratic",
        precision="float64",
        per_axis=2,
        courant=0.2,
        cfl=None,
        flip_blend=1.0,
    ):
        """One period with `cells` along the unit box, `per_axis`^dim particles in each.

        The step is `courant` dx / sqrt(E / rho0), or `cfl` of the stable one if that is given.
        """
        dx = 1.0 / cells
        size = [1.0 if axis < self.moving or self.moving > 1 else WIDTH * dx for axis in range(self.dim)]
        axes = "xyz"[: self.dim]
        around = {"walls": {f"{a}_{end}": "slip" for a in axes for end in ("min", "max")}}
        if not self.walls:
            around = {"periodic": list(axes)}
        body = {
            "material": "material",
            "shape": {"type": "box", "min": [0.0] * self.dim, "max": size},
            "particles_per_cell": per_axis**self.dim,
            "displacement": lambda X: self.displacement(X, 0.0),
            "velocity": lambda X: self.velocity(X, 0.0),
            "deformation": lambda X: self.deformation(X, 0.0),
        }
        method = {"transfer": transfer, "shape_function": shape_function, "precision": precision}
        return pmpm.Scene(
            title=f"Axis-aligned manufactured solution, {self.law}",
            domain={"size": size, "cell_size": dx, **around},
            method=method | ({"flip_blend": flip_blend} if transfer in ("flip", "aflip") else {}),
            time={"end": self.period, **({"step": courant * dx} if cfl is None else {"cfl": cfl})},
            materials={"material": self.material},
            bodies=[body],
            body_force=self.body_force,
            exact={"displacement": self.displacement, "velocity": self.velocity, "deformation": self.deformation},
        )
