"""Generalized vortex (Brannon, Kamojjala and Sadeghirad, ECCOMAS Particles 2011): a ring that turns and shears, exactly.

Plane strain, neo-Hookean, 0.75 <= R <= 1.25: x = Rot(alpha) X with alpha = A sin(w t) h(R), h = (16 (R - 1)^2 - 1)^2, about the
ring's centre. J = 1 everywhere, and h = h' = 0 on both edges, which are free of traction. The body force that makes it
exact, in the turned frame, does not depend on lam:

    b_r = -R (A w cos(w t) h)^2 + (mu / rho0) R alpha_R^2
    b_t = -R w^2 alpha - (mu / rho0) (3 alpha_R + R alpha_RR)
"""

import math
from dataclasses import dataclass

import numpy as np

import cases
import pmpm
from cases import Case, Check, Plot, Table, at_least, at_most, holds
from pmpm import accuracy
from pmpm.failure import NumericalFailure
from pmpm.physics.words import cos, sin, sqrt

CENTRE = (2.03, 1.98)  # m, of the ring, off the grid
INNER, OUTER = 0.75, 1.25  # m
DENSITY, YOUNGS_MODULUS, POISSON_RATIO = 1000.0, 1000.0, 0.3
SHEAR_MODULUS = 0.5 * YOUNGS_MODULUS / (1.0 + POISSON_RATIO)
FREQUENCY = math.pi * math.sqrt(YOUNGS_MODULUS / DENSITY)
END = 1.0  # s, when the ring is back where it was
# Integral over the ring of h R^2 dA: the angular momentum is rho0 A w cos(w t) times it.
TURNED = 2.0 * math.pi * (16.0 / 15.0 + 3.0 / 105.0) / 4.0

AMPLITUDE = 0.0  # replaced by that of a solution in the copy of `force` that it gets


def force(x, X, t):
    rx, ry = X[0] - CENTRE[0], X[1] - CENTRE[1]
    R = sqrt(max(rx * rx + ry * ry, 1e-12))
    d = R - 1.0
    bump = 16.0 * d * d - 1.0
    h, slope, curvature = bump * bump, 64.0 * d * bump, 64.0 * (48.0 * d * d - 1.0)
    swing, rate = AMPLITUDE * sin(FREQUENCY * t), AMPLITUDE * FREQUENCY * cos(FREQUENCY * t) * h
    turn, shear = swing * h, swing * slope
    b_r = -R * rate * rate + SHEAR_MODULUS / DENSITY * R * shear * shear
    b_t = -R * FREQUENCY * FREQUENCY * turn - SHEAR_MODULUS / DENSITY * (3.0 * shear + R * swing * curvature)
    c, s = cos(turn), sin(turn)
    ex, ey = (rx * c - ry * s) / R, (rx * s + ry * c) / R
    return (ex * b_r - ey * b_t, ey * b_r + ex * b_t)


@dataclass(frozen=True)
class Vortex:
    """The ring with an amplitude A (rad); its largest shear is 7.05 A."""

    amplitude: float = 0.1

    def polar(self, X, t):
        """r (n, 2) from the centre, R (n,), and of each ring its angle, the angle's slope over R, and its rate."""
        r = X - CENTRE
        R = np.sqrt((r * r).sum(axis=1))
        d = R - 1.0
        h = (16.0 * d * d - 1.0) ** 2
        swing = self.amplitude * math.sin(FREQUENCY * t)
        rate = self.amplitude * FREQUENCY * math.cos(FREQUENCY * t) * h
        return r, R, swing * h, swing * 64.0 * d * (16.0 * d * d - 1.0), rate

    def displacement(self, X, t):
        r, _, angle, _, _ = self.polar(X, t)
        return turned(r, angle) - r

    def velocity(self, X, t):
        r, _, angle, _, rate = self.polar(X, t)
        return rate[:, None] * turned(r, angle + 0.5 * math.pi)

    def deformation(self, X, t):
        r, R, angle, slope, _ = self.polar(X, t)
        across = np.stack([-r[:, 1], r[:, 0]], axis=-1)
        sheared = np.eye(2) + (slope / R)[:, None, None] * across[:, :, None] * r[:, None, :]
        c, s = np.cos(angle), np.sin(angle)
        rotation = np.stack([np.stack([c, -s], axis=-1), np.stack([s, c], axis=-1)], axis=-2)
        return rotation @ sheared

    def angular_momentum(self, t):
        """About the centre, kg m2/s per metre."""
        return DENSITY * self.amplitude * FREQUENCY * math.cos(FREQUENCY * t) * TURNED

    @property
    def body_force(self):
        """The function b(x, X, t) of this solution, which kernels can compile."""
        return cases.with_globals(force, AMPLITUDE=self.amplitude)

    def scene(
        self,
        cells,
        transfer="mls",
        shape_function="quadratic",
        precision="float64",
        particles_per_cell=4,
        cfl=0.2,
        flip_blend=1.0,
    ):
        """Half a period, in which the ring turns and comes back, with `cells` per metre; 5 particles per cell lie at random."""
        method = {"transfer": transfer, "shape_function": shape_function, "precision": precision}
        disks = [{"type": "sphere", "center": CENTRE, "radius": radius} for radius in (OUTER, INNER)]
        material = {"model": "neo_hookean", "density": DENSITY}
        return pmpm.Scene(
            title="Generalized vortex",
            domain={"size": [4.0, 4.0], "cell_size": 1.0 / cells},
            method=method | ({"flip_blend": flip_blend} if transfer in ("flip", "aflip") else {}),
            time={"end": END, "cfl": cfl},
            materials={
                "material": material | {"youngs_modulus": YOUNGS_MODULUS, "poisson_ratio": POISSON_RATIO},
            },
            bodies=[
                {
                    "material": "material",
                    "shape": {"type": "difference", "of": disks},
                    "particles_per_cell": particles_per_cell,
                    "velocity": lambda X: self.velocity(X, 0.0),
                }
            ],
            body_force=self.body_force,
            exact={"displacement": self.displacement, "velocity": self.velocity, "deformation": self.deformation},
        )


def turned(r, angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * r[:, 0] - s * r[:, 1], s * r[:, 0] + c * r[:, 1]], axis=-1)


# ---- what is checked -----------------------------------------------------------------------------------------------------

CELLS = {"tiny": (20, 40), "standard": (20, 40, 80), "sweep": (20, 40, 80, 160)}  # per metre
SCHEMES = (("mls", "quadratic"), ("apic", "quadratic"), ("mls", "cubic"), ("flip", "quadratic"), ("pic", "quadratic"))
TIMES = 50  # at which errors are taken
STRETCHED = (
    "the step follows the waves, up to 7 A times faster where stretched; at A = 1 a run may stop, with a message"
)
STRONG = {"tiny": (1.0,), "standard": (0.5, 1.0), "sweep": (0.5, 1.0)}


@dataclass(frozen=True)
class Found:
    """Largest e_u and root mean square of J - 1, e_u at the end, and the angular momentum there over the exact one."""

    e_u: float
    e_J: float
    last: float
    turned: float


def measure(comm, amplitude, cells, *scheme, **more):
    """Found of a run. NumericalFailure where it stops."""
    solution = Vortex(amplitude)
    simulation = pmpm.Simulation(solution.scene(cells, *scheme, **more), comm)
    errors = accuracy.Errors(simulation)
    simulation.every(errors, seconds=END / TIMES, at_start=True)
    simulation.run()
    total = simulation.measure()
    spin = total["angular_momentum_z"] - CENTRE[0] * total["momentum_y"] + CENTRE[1] * total["momentum_x"]
    turned = spin / solution.angular_momentum(simulation.time)
    return Found(errors.largest["displacement"], errors.largest_rms["J"], errors.last["displacement"], turned)


def verify(size, comm):
    cells, rows, lines = CELLS[size], [], {}
    for count, schemes in ((16, SCHEMES[:4]), (4, SCHEMES)):
        for scheme in schemes[:2] if size == "tiny" else schemes:
            name = f"{' '.join(scheme)}, {count} per cell"
            found = [measure(comm, 0.1, n, *scheme, particles_per_cell=count) for n in cells]
            rows += [row(count, 0.1, " ".join(scheme), *pair) for pair in zip(cells, found, strict=True)]
            lines[name] = cells, [run.e_u for run in found]
            yield from judge(name, count, cells, found)
    for n in cells[:2]:
        rows.append(row("5 at random", 0.1, "mls quadratic", n, measure(comm, 0.1, n, particles_per_cell=5)))
    for amplitude in STRONG[size]:
        for count in (4, 16):
            for n in cells[:2]:
                what = f"A = {amplitude:g}, mls quadratic, {count} per cell, dx = 1/{n} m: comes to its end"
                try:
                    found = measure(comm, amplitude, n, cfl=0.4, particles_per_cell=count)
                except NumericalFailure as failure:
                    yield at_least(f"{what}; {failure}", 0.0, 1.0 if amplitude < 1.0 else None, STRETCHED)
                    continue
                yield holds(what, True, STRETCHED)
                rows.append(row(count, amplitude, "mls quadratic", n, found))
    head = ("particles per cell", "A", "scheme", "1/dx", "e_u", "RMS J - 1", "e_u at the end", "L / exact at the end")
    yield Table("Vortex", head, rows)
    yield Plot("Vortex, A = 0.1", "cells per metre", "e_u", lines, "loglog")


def judge(name, count, cells, found):
    """Gates; of the order only where 16 particles per cell resolve the ring."""
    observed = cases.order([run.e_u for run in found], [1.0 / n for n in cells])
    what = f"A = 0.1, {name}: order, dx = 1/{cells[0]} to 1/{cells[-1]} m"
    if count < 16:
        yield Check(what, observed)
    else:
        yield at_least(what, observed, 1.5, "second order, less what free edges may take")
    if 80 in cells and "pic" not in name:
        finest = found[cells.index(80)]
        yield at_most(f"A = 0.1, {name}: e_u at dx = 1/80 m", finest.e_u, 0.02, "the ring is 40 cells thick")
        yield at_most(f"A = 0.1, {name}: RMS of J - 1 at dx = 1/80 m", finest.e_J, 0.01, "the motion changes no volume")


def row(particles, amplitude, name, cells, found):
    return particles, amplitude, name, cells, found.e_u, found.e_J, found.last, f"{found.turned:.4f}"


ABOUT = """
A ring that turns and shears, with a body force that makes it exact and free edges (Brannon, Kamojjala and Sadeghirad,
ECCOMAS Particles 2011): x = Rot(A sin(w t) h(R)) X, h = (16 (R - 1)^2 - 1)^2 for 0.75 <= R <= 1.25 m, J = 1, E = 1000 Pa,
nu = 0.3, 1000 kg/m3, plane strain, the centre off the grid at (2.03, 1.98) m; half a period, after which it is back. The
largest shear is 7.05 A. Steps of 0.2 of the stable one at A = 0.1, 0.4 else; errors at 50 times.

The gate of the order is that of 16 particles per cell. With 4 the order is lower (the table); at 40 cells per metre half the
step changes e_u by 3 %, 16 particles per cell halve it. What they resolve better, the free edges, which are a staircase of
particles, or the stresses inside, was not told apart. At A = 0.5 (shear 3.5) and 4 particles per cell the error is larger than
the motion, with 16 it is 1 % to 4 %. At A = 1 (shear 7) 16 have 22 % at 20 cells per metre, and stop at 40, before the end.
"""

CASE = Case("V2", "Generalized vortex", ABOUT, verify)
