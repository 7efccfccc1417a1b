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

import numpy as np

import cases
import pmpm
from cases import Case, Check, Plot, Table, at_least, at_most, between, near
from pmpm.failure import NumericalFailure
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
        return cases.with_globals(source, **names)

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
        staggered=False,
    ):
        """One period with `cells` along the unit box, `per_axis`^dim particles in each.

        The step is `courant` dx / sqrt(E / rho0), or `cfl` of the stable one if that is given. `staggered`: velocities start
        half a fixed step early, where those of symplectic Euler belong.
        """
        dx = 1.0 / cells
        start = -0.5 * courant * dx if staggered else 0.0
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
            "velocity": lambda X: self.velocity(X, start),
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


# ---- what is expected, and checked ---------------------------------------------------------------------------------------

# e_u at 32, 64 and 128 cells of an independent one-dimensional program of the same schemes, rounded to two digits: neo-Hookean
# with nu = 0, 2 particles per cell, steps of 0.2 dx / sqrt(E / rho0).
EXPECTED = {
    0.1: {
        ("flip", "linear"): (0.15, 0.29, 0.57),  # cell crossing: refining makes it worse
        ("flip", "quadratic"): (6.1e-2, 1.6e-2, 4.2e-3),
        ("flip", "cubic"): (8.0e-2, 2.0e-2, 5.05e-3),
        ("apic", "linear"): (0.14, 0.32, 0.56),
        ("apic", "quadratic"): (3.1e-2, 8.0e-3, 2.4e-3),
        ("apic", "cubic"): (4.0e-2, 1.0e-2, 2.5e-3),
        ("mls", "quadratic"): (2.6e-2, 6.9e-3, 2.2e-3),
        ("mls", "cubic"): (3.6e-2, 9.1e-3, 2.3e-3),
        ("pic", "quadratic"): (0.44, 0.25, 0.14),
    },
    1e-4: {
        ("flip", "linear"): (3.2e-2, 8.1e-3, 2.0e-3),
        ("flip", "quadratic"): (6.2e-2, 1.6e-2, 3.9e-3),
        ("flip", "cubic"): (8.0e-2, 2.0e-2, 5.0e-3),
        ("apic", "linear"): (9.6e-3, 2.4e-3, 6.1e-4),
        ("apic", "quadratic"): (3.2e-2, 8.1e-3, 2.0e-3),
        ("apic", "cubic"): (3.9e-2, 1.0e-2, 2.5e-3),
        ("mls", "quadratic"): (2.5e-2, 6.4e-3, 1.6e-3),
        ("mls", "cubic"): (3.5e-2, 8.9e-3, 2.2e-3),
        ("pic", "quadratic"): (0.44, 0.25, 0.14),
    },
}
EXPECTED_CELLS = (32, 64, 128)
# Of PIC with quadratic splines at 64 cells: {step / (dx / sqrt(E / rho0)): e_u}. Its filter acts once per step.
EXPECTED_OF_PIC = {0.05: 0.68, 0.1: 0.44, 0.2: 0.25, 0.4: 0.14}
# Of APIC at 64 cells, A k = 0.1: {particles per axis: e_u}.
EXPECTED_OF_PARTICLES = {1: 7.9e-3, 2: 8.0e-3, 4: 7.6e-3, 8: 7.5e-3}
PROGRAM, SECOND = "an independent one-dimensional program", (1.75, 2.25)
ORDER = "second order: lumped mass and particle quadrature, whatever the spline"
CELLS = {"tiny": (16, 32), "standard": (16, 32, 64, 128), "sweep": (8, 16, 32, 64, 128, 256)}
CELLS_2D = {"tiny": (16, 32), "standard": (16, 32, 64), "sweep": (8, 16, 32, 64, 128)}
CELLS_3D = {"tiny": (8, 16), "standard": (8, 16, 32), "sweep": (8, 16, 32, 48)}
TIMES = 50  # at which errors are taken in two and three dimensions


def measured(comm, solution, cells, *scheme, times=None, **more):
    """e_u of a run, nan of one that stops."""
    try:
        return cases.errors(solution.scene(cells, *scheme, **more), comm, times).largest["displacement"]
    except NumericalFailure:
        return math.nan


def spacing(cells):
    return [1.0 / count for count in cells]


def along_one_axis(size, comm):
    """The independent program's numbers, and the order of each scheme."""
    cells = CELLS[size]
    for strain, expected in EXPECTED.items():
        solution = AxisAligned(moving=1, poisson_ratio=0.0, strain=strain)
        lines, rows = {}, []
        for scheme, known in expected.items():
            name = f"{' '.join(scheme)}, A k = {strain:g}"
            found = {count: measured(comm, solution, count, *scheme) for count in cells}
            lines[" ".join(scheme)] = cells, [found[count] for count in cells]
            rows.append((*scheme, *found.values()))
            for count, value in zip(EXPECTED_CELLS, known, strict=True):
                if count in found:
                    yield near(f"{name}: e_u at {count} cells", found[count], value, 0.1, PROGRAM)
            yield from judge_order(name, scheme, strain, {count: found[count] for count in cells if 16 <= count <= 64})
        yield Table(f"e_u along one axis, A k = {strain:g}", ("transfer", "spline", *map(str, cells)), rows)
        yield Plot(f"One axis, A k = {strain:g}", "cells", "e_u", lines, "loglog")


def judge_order(name, scheme, strain, found):
    cells, errors = list(found), list(found.values())
    observed = cases.order(errors, spacing(cells))
    what = f"{name}: order, {cells[0]} to {cells[-1]} cells"
    if scheme[0] == "pic":
        yield between(what, observed, 0.6, 1.1, "a viscosity dx^2 / (4 dt) is of first order at a fixed Courant number")
    elif scheme[1] != "linear":
        yield between(what, observed, *SECOND, ORDER)
    elif strain < 1e-3:
        yield at_least(what, observed, 1.9, "second order as long as no particle leaves its cell")
    else:
        yield at_most(what, observed, 0.5, "particles cross cells: no convergence")


def steps_and_particles(size, comm):
    """What PIC's error, and the number of particles, depend on; float32."""
    solution, cells = AxisAligned(moving=1, poisson_ratio=0.0), 64
    courants = EXPECTED_OF_PIC if size != "tiny" else {0.2: 0.25, 0.4: 0.14}
    for courant, expected in courants.items():
        error = measured(comm, solution, cells, "pic", courant=courant)
        yield near(f"PIC quadratic, 64 cells, step {courant} dx / c: e_u", error, expected, 0.1, PROGRAM)
    if size == "tiny":
        return
    for per_axis, expected in EXPECTED_OF_PARTICLES.items():
        error = measured(comm, solution, cells, "apic", per_axis=per_axis, times=TIMES)
        yield near(f"APIC quadratic, 64 cells, {per_axis} particles per axis: e_u", error, expected, 0.1, PROGRAM)
    for strain, why in ((0.1, "e_u is that of float64 to 2 %"), (1e-4, "")):
        solution = AxisAligned(moving=1, poisson_ratio=0.0, strain=strain)
        single, double = (measured(comm, solution, cells, "apic", precision=p) for p in ("float32", "float64"))
        what = f"APIC quadratic, 64 cells, A k = {strain:g}: e_u in float32 over that in float64"
        yield near(what, single / double, 1.0, 0.02, why) if why else Check(what, single / double)


def in_space(size, comm, dim, cells, schemes):
    """Orders of schemes and laws in two or three dimensions, and between walls."""
    rows = []
    for law, walls, *scheme in schemes:
        solution = AxisAligned(dim, dim, law, walls=walls, strain=0.05 * math.pi if walls else 0.1)
        found = [measured(comm, solution, count, *scheme, times=TIMES, staggered=True) for count in cells]
        where = "slip walls" if walls else "periodic"
        name = f"{dim}-D, {law}, {where}, {' '.join(scheme)}"
        rows.append((law, where, *scheme, *found))
        yield between(
            f"{name}: order, {cells[0]} to {cells[-1]} cells", cases.order(found, spacing(cells)), *SECOND, ORDER
        )
    yield Table(f"e_u in {dim}-D", ("law", "box", "transfer", "spline", *map(str, cells)), rows)


def start_of_velocities(size, comm):
    """What it costs to give symplectic Euler velocities of the wrong half step."""
    solution, cells = AxisAligned(walls=True, strain=0.05 * math.pi), CELLS_2D[size]
    for staggered, when in ((True, "half a step before"), (False, "at")):
        found = [measured(comm, solution, count, "mls", "cubic", times=TIMES, staggered=staggered) for count in cells]
        yield Check(
            f"2-D, slip walls, MLS cubic, velocities of {when} t = 0: order", cases.order(found, spacing(cells))
        )


SCHEMES = [(transfer, spline) for transfer in ("flip", "apic", "mls") for spline in ("quadratic", "cubic")]
SCHEMES_2D = [
    *(("neo_hookean", False, *scheme) for scheme in SCHEMES),
    *(
        (law, walls, "mls", "cubic")
        for law in LAWS
        for walls in (False, True)
        if (law, walls) != ("neo_hookean", False)
    ),
]
SCHEMES_3D = [
    *(("neo_hookean", False, transfer, "quadratic") for transfer in ("flip", "apic", "mls")),
    *((law, False, "mls", "cubic") for law in LAWS),
    ("neo_hookean", True, "mls", "cubic"),
]


def verify(size, comm):
    yield from along_one_axis(size, comm)
    yield from steps_and_particles(size, comm)
    yield from start_of_velocities(size, comm)
    tiny = [("neo_hookean", False, "mls", "quadratic"), ("fluid", True, "mls", "cubic")]
    yield from in_space(size, comm, 2, CELLS_2D[size], tiny if size == "tiny" else SCHEMES_2D)
    yield from in_space(size, comm, 3, CELLS_3D[size], tiny[:1] if size == "tiny" else SCHEMES_3D)


ABOUT = """
u_i = A sin(k X_i) sin(w t + phi_i) along every axis, F diagonal, with the body force of Wallstedt and Guilkey, J. Comput. Phys.
227 (2008) 9628, for four laws ([the formulas](../../benchmarks/cases/mms.py)): k = 2 pi, phi = (0, 1, 2) in a periodic box;
k = pi, phi = (0, 2 pi / 3, 4 pi / 3), A = 0.05 between slip walls. Particles start displaced and deformed. One period, 2
particles per axis and cell, steps of 0.2 dx / sqrt(E / rho0), float64 unless said otherwise; nu = 0 along one axis, else 0.3;
gamma = 7.

- The degree of the spline does not raise the order above 2, and quadratic splines have the smaller constant. What cubic
  ones buy is a lower floor, where the sum over particles no longer stands for the integral: e_F of quadratic ones stays near
  0.02 at A k = 0.1. With more particles per cell that floor sinks.
- Linear splines are of second order until particles cross cells, then diverge.
- PIC's filter is a viscosity dx^2 / (4 dt): the smaller the step, the larger the error.
- Velocities of symplectic Euler belong half a step before positions. Where the displacement does not start at zero (phi not 0)
  those of t = 0 make an error of first order in dt. In two and three dimensions runs start with those of -dt / 2; one case
  shows both. e_v, taken at full steps, is of first order either way.
"""

CASE = Case("V1", "Axis-aligned manufactured solution", ABOUT, verify)
