"""Volumetric locking near nu = 0.5, and what `method.f_bar` does about it, on two vibrations whose frequencies are known.

    python benchmarks/locking.py [--quick] [--docs docs]

Beam: a free plane-strain beam, 6 times as long as high and 4 cells high, swings in its first bending mode. Theory: Timoshenko's
beam with E / (1 - nu^2) and shear factor 5/6. A frequency too high by x is a deflection under a load too small by 2 x.
Square: 8 x 8 cells swing in Lame's mode, u = (cos kx sin ky, -sin kx cos ky), k = pi / a, which changes no volume and loads no
edge: omega = sqrt(2) k c_s whatever nu is (Lame 1852; Graff, Wave motion in elastic solids, 1975), and no pressure at all.
All is given for nu from 0.3 to 0.4999 with and without F-bar. --quick: two values of nu. Prints a row as it is done, checks the
claims below and exits non-zero where one fails; with --docs it writes results/locking.md there.

Claims. Without F-bar linear splines lock: their beam swings at more than 1.2 times the frequency it has at nu = 0.3. With F-bar
no scheme's does by more than 5 %. The noise of pressure at the largest nu falls to less than half, and no row gains energy: at
the end it has at most 1.05 of what it began with. They were set after a first survey, before which every plain scheme was
expected to stiffen: in this bending quadratic splines do so with MLS forces only, cubic ones not at all.
"""

import argparse
import math
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pages

import pmpm
from pmpm.failure import NumericalFailure

RATIOS = (0.3, 0.45, 0.49, 0.499, 0.4999)
QUICK_RATIOS = (0.3, 0.49)
SCHEMES = (
    ("linear", "apic"),
    ("quadratic", "apic"),
    ("quadratic", "mls"),
    ("quadratic", "flip"),
    ("cubic", "apic"),
    ("cubic", "mls"),
)
SLENDERNESS, CELLS_HIGH, SQUARE_CELLS = 6.0, 4, 8
SHEAR_FACTOR = 5.0 / 6.0
STRAIN = 1e-4  # of the vibrations
LOCKS, STIFFENS, NOISE, HIGHEST_ENERGY = 0.2, 0.05, 0.5, 1.05


@dataclass(frozen=True)
class Swing:
    """What a vibration showed: frequency against theory, noise of pressure, energy left at the end."""

    frequency: float = math.nan
    noise: float = math.nan
    energy: float = math.nan
    steps: int = 0


# ---- theory of the beam ------------------------------------------------------------------------------------------------------


class Beam:
    """First free-free mode of a Timoshenko beam with height, density and E / (1 - nu^2) of one; state (w, psi, M, Q)."""

    def __init__(self, poisson_ratio, length=SLENDERNESS):
        self.length, self.lateral = length, poisson_ratio / (1.0 - poisson_ratio)
        self.bending, self.shear = 1.0 / 12.0, SHEAR_FACTOR * (1.0 - poisson_ratio) / 2.0
        slender = (4.730041 / length) ** 2 * math.sqrt(self.bending)  # of a beam without shear, which is faster
        trials = slender * np.linspace(0.5, 1.0, 101)
        ends = [self.determinant(omega) for omega in trials]
        first = next(k for k in range(100) if ends[k] * ends[k + 1] < 0.0)
        low, high = trials[first : first + 2]
        for _ in range(60):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self.determinant(low) * self.determinant(middle) > 0.0 else (low, middle)
        self.omega = low
        ends = self.transfer(low, self.length)[2:, :2]
        self.start = np.array([-ends[0, 1], ends[0, 0], 0.0, 0.0])

    def transfer(self, omega, x):
        M = np.zeros((4, 4))
        M[0, 1], M[0, 3], M[1, 2] = 1.0, 1.0 / self.shear, 1.0 / self.bending
        M[2, 1], M[2, 3], M[3, 0] = -(omega**2) / 12.0, -1.0, -(omega**2)
        values, vectors = np.linalg.eig(M)
        return ((vectors * np.exp(values * x)) @ np.linalg.inv(vectors)).real

    def determinant(self, omega):
        """Zero where an end without M and Q at x = 0 leads to another one."""
        return np.linalg.det(self.transfer(omega, self.length)[2:, :2])

    def mode(self, x):
        """(velocity (n, 2), its gradient (n, 2, 2)) at x from the left end and y from the axis: w, psi, and what the section
        widens by where it is pressed together."""
        places, at = np.unique(x[:, 0], return_inverse=True)
        w, psi, M, Q = np.array([self.transfer(self.omega, place) @ self.start for place in places])[at].T
        y, bend = x[:, 1], M / self.bending
        v = np.stack([-psi * y, w + self.lateral * bend * (y * y / 2.0 - 1.0 / 24.0)], axis=-1)
        C = np.zeros((len(x), 2, 2))
        C[:, 0, 0], C[:, 0, 1], C[:, 1, 0], C[:, 1, 1] = -bend * y, -psi, psi + Q / self.shear, self.lateral * bend * y
        size = np.abs(v).max()
        return v / size, C / size


class Square:
    """Lame's mode of a square of edge one with shear modulus and density of one."""

    omega = math.sqrt(2.0) * math.pi

    def mode(self, x):
        k = math.pi
        c, s = np.cos(k * x), np.sin(k * x)
        v = np.stack([c[:, 0] * s[:, 1], -s[:, 0] * c[:, 1]], axis=-1)
        diagonal, other = k * s[:, 0] * s[:, 1], k * c[:, 0] * c[:, 1]
        return v, np.stack([-diagonal, other, -other, diagonal], axis=-1).reshape(-1, 2, 2)


# ---- runs --------------------------------------------------------------------------------------------------------------------


def simulation(shape_function, transfer, f_bar, poisson_ratio, modulus, edges, dx):
    """A body with edges (m) in the middle of nothing, its corner a quarter of a cell off the nodes."""
    blend = {"flip_blend": 1.0} if transfer == "flip" else {}
    corner = [4.25 * dx, 4.25 * dx]
    shape = {"type": "box", "min": corner, "max": [c + e for c, e in zip(corner, edges, strict=True)]}
    found = pmpm.Simulation(
        pmpm.Scene(
            domain={"size": [e + 9.0 * dx for e in edges], "cell_size": dx},
            method={"transfer": transfer, "shape_function": shape_function, "f_bar": f_bar} | blend,
            time={"end": 1e6},
            materials={
                "material": {
                    "model": "neo_hookean",
                    "density": 1.0,
                    "youngs_modulus": modulus,
                    "poisson_ratio": poisson_ratio,
                }
            },
            bodies=[{"material": "material", "shape": shape}],
        )
    )
    return found, np.array(corner)


def swing(run, origin, theory, noise):
    """Let a body swing in a mode from its resting shape until its velocity has changed its sign twice.

    Half a period lies between the two, whatever part of a step velocities lag behind. `noise(x, pressure)` is asked at the
    first, where the shape is farthest out.
    """
    v, C = theory.mode(run.particles.x - origin)
    size = STRAIN * theory.omega / np.abs(C).max()
    run.particles.v = size * v
    if run.needs.scheme.affine:
        run.particles.C = size * C
    weights = v[np.argsort(run.particles.id)]
    begun, before, zeros, found = run.measure()["kinetic"], (0.0, 1.0), [], {}
    while len(zeros) < 2 and run.time < 3.0 * math.pi / theory.omega:
        run.step()
        now = run.time, float((run.particles.v[np.argsort(run.particles.id)] * weights).sum())
        if now[1] * before[1] < 0.0:
            zeros.append(before[0] - before[1] * (now[0] - before[0]) / (now[1] - before[1]))
            if len(zeros) == 1:
                found["noise"] = noise(run.particles.x - origin, run.fields(["pressure"])["pressure"])
        before = now
    run.check()
    measured = run.measure()
    if len(zeros) == 2:
        found["frequency"] = float(math.pi / theory.omega / (zeros[1] - zeros[0])) - 1.0
    return Swing(energy=(measured["kinetic"] + measured["strain"]) / begun, steps=run.step_count, **found)


def root_mean_square(values):
    return float(np.sqrt(np.mean(values**2)))


def swing_beam(shape_function, transfer, f_bar, nu, cells_high=CELLS_HIGH):
    beam = Beam(nu)
    edges = (SLENDERNESS, 1.0)
    run, corner = simulation(shape_function, transfer, f_bar, nu, 1.0 - nu * nu, edges, 1.0 / cells_high)

    def noise(x, pressure):
        """What is left of the pressure, relative, besides a distance from the axis times a polynomial along the beam."""
        along = 2.0 * x[:, :1] / SLENDERNESS - 1.0
        smooth = x[:, 1:] * along ** np.arange(9)
        fitted = smooth @ np.linalg.lstsq(smooth, pressure, rcond=None)[0]
        return root_mean_square(pressure - fitted) / root_mean_square(fitted)

    return swing(run, corner + [0.0, 0.5], beam, noise)


def swing_square(shape_function, transfer, f_bar, nu):
    modulus = 2.0 * (1.0 + nu)
    run, corner = simulation(shape_function, transfer, f_bar, nu, modulus, (1.0, 1.0), 1.0 / SQUARE_CELLS)

    def noise(x, pressure):
        """Pressure of a mode that has none, in shear moduli times its strain."""
        return root_mean_square(pressure) / STRAIN

    return swing(run, corner, Square(), noise)


CASES = {"beam": swing_beam, "square": swing_square}


def survey(ratios):
    """{case: {(spline, transfer): {(f_bar, nu): Swing}}}, a line printed for each."""
    found = {}
    for case, function in CASES.items():
        for scheme in SCHEMES:
            for f_bar in (False, True):
                for nu in ratios:
                    try:
                        result = function(*scheme, f_bar, nu)
                    except NumericalFailure as failure:
                        print(failure, flush=True)
                        result = Swing()
                    found.setdefault(case, {}).setdefault(scheme, {})[f_bar, nu] = result
                    print(case, *scheme, "F-bar" if f_bar else "plain", nu, result, flush=True)
    return found


# ---- verdicts ------------------------------------------------------------------------------------------------------------


def complaints(found, ratios):
    """What misses its claim, one line each."""
    wrong, soft, hard = [], ratios[0], ratios[-1]
    for scheme, swings in found["beam"].items():
        plain, averaged = (
            (1.0 + swings[f_bar, hard].frequency) / (1.0 + swings[f_bar, soft].frequency) - 1.0
            for f_bar in (False, True)
        )
        if scheme[0] == "linear" and not plain > LOCKS:
            wrong.append(f"beam, {', '.join(scheme)}, plain: stiffens by {plain:.1%}")
        if not averaged < STIFFENS:
            wrong.append(f"beam, {', '.join(scheme)}, F-bar: stiffens by {averaged:.1%}")
    for case, schemes in found.items():
        for scheme, swings in schemes.items():
            plain, averaged = (swings[f_bar, hard].noise for f_bar in (False, True))
            if not averaged < NOISE * plain:
                wrong.append(f"{case}, {', '.join(scheme)}: noise {averaged:.2f} with F-bar, {plain:.2f} without")
            for (f_bar, nu), result in swings.items():
                if not result.energy <= HIGHEST_ENERGY:
                    name = f"{case}, {', '.join(scheme)}, {'F-bar' if f_bar else 'plain'}, nu = {nu}"
                    wrong.append(f"{name}: {result.energy:.4f} of the energy at the start")
    return wrong


def table(schemes, ratios, show):
    head = ["spline", "transfer", "", *(f"nu = {nu}" for nu in ratios)]
    lines = ["| " + " | ".join(head) + " |", "|" + " --- |" * len(head)]
    for (shape_function, transfer), swings in schemes.items():
        for f_bar in (False, True):
            cells = [show(swings[f_bar, nu]) for nu in ratios]
            lines.append("| " + " | ".join([shape_function, transfer, "F-bar" if f_bar else "plain", *cells]) + " |")
    return "\n".join(lines)


def page(found, ratios, verdict):
    beam, square = found["beam"], found["square"]

    def percent(name):
        return lambda result: f"{getattr(result, name):+.1%}"

    def number(name):
        return lambda result: f"{getattr(result, name):.2f}"

    return f"""# Volumetric locking and F-bar

`python benchmarks/locking.py --docs docs` wrote this page: two free vibrations of nearly incompressible bodies, plain and with
`method.f_bar = true`, with 2 x 2 particles per cell. Theory and claims stand in that file.

What it shows: linear splines, and quadratic ones with MLS forces, lock without F-bar and do not with it; the others swing at
their frequency at any nu, but fill with noise of pressure, least with cubic splines. F-bar costs stiffness at small nu, about
2 % of the frequency on 4 cells. Near nu = 0.5 the stable step is so short that what APIC and MLS lose in each step damps the
swing in half a period, F-bar or not; so damped, it is no clean measure of stiffness. FLIP keeps its energy.

## A beam in bending, {SLENDERNESS:g} times as long as high, {CELLS_HIGH} cells high

Frequency against Timoshenko's beam. A frequency too high by x % is a deflection too small by 2 x %: locking.

{table(beam, ratios, percent("frequency"))}

Noise of the pressure where the beam is bent most, of the pressure:

{table(beam, ratios, number("noise"))}

Energy left after three quarters of a period, which more and more steps fill as nu nears 0.5:

{table(beam, ratios, number("energy"))}

## A square of {SQUARE_CELLS} x {SQUARE_CELLS} cells in Lame's mode, which changes no volume

Frequency against theory, in which nu does not matter:

{table(square, ratios, percent("frequency"))}

Pressure, all of it noise, in shear moduli times the strain of the mode:

{table(square, ratios, number("noise"))}

Energy left after three quarters of a period:

{table(square, ratios, number("energy"))}

{verdict}
"""


def main():
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--quick", action="store_true", help="two values of nu")
    options.add_argument("--docs", type=Path, help="write the page here")
    given = options.parse_args()
    ratios = QUICK_RATIOS if given.quick else RATIOS
    found = survey(ratios)
    wrong = complaints(found, ratios)
    verdict = "All claims hold." if not wrong else "Claims that fail:\n\n" + "\n".join(f"- {line}" for line in wrong)
    text = page(found, ratios, verdict)
    print(text)
    if given.docs:
        pages.write(given.docs, "locking", text)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
