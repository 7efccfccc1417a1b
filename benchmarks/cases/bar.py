"""A bar that rings in its lowest mode, and the decay that PIC's filter gives to a wave (Bardenhagen 2002; Steffen et al. 2008).

Bar: 0 <= X <= L fixed at 0, free at L, slip sides, nu = 0: for small strain u = v0 / (b c) sin(b c t) sin(b X), b = pi / (2 L).
Filter: a stress-free wave sin(k x) of velocities on particles at rest loses, with PIC, exp(-D k^2) in each step, D = dx^2 / 4
for quadratic splines and dx^2 / 3 for cubic ones; in an oscillator, which is filtered while it moves only, half of it.
"""

import math
from dataclasses import dataclass

import numpy as np

import pmpm
from cases import Case, Plot, Table, at_least, at_most, near

LENGTH, WAVE_SPEED, DENSITY = 25.0, 10.0, 1.0
STRAIN = 1e-4
SAMPLES = 40  # per period
D = {"linear": 1.0 / 6.0, "quadratic": 0.25, "cubic": 1.0 / 3.0}  # in cells squared, in the mean
FIXED = math.pi / (2.0 * LENGTH)  # b
HEIGHT = 1e-9  # m/s, of the wave that is filtered


# ---- the bar -------------------------------------------------------------------------------------------------------------


def displacement(X, t):
    swing = STRAIN / FIXED * math.sin(FIXED * WAVE_SPEED * t)
    return swing * np.sin(FIXED * X) * along(X)


def velocity(X, t):
    return STRAIN * WAVE_SPEED * math.cos(FIXED * WAVE_SPEED * t) * np.sin(FIXED * X) * along(X)


def along(X):
    """1 for the axis of the bar, 0 for the others."""
    return np.arange(X.shape[1]) == 0


def start(X):
    return velocity(X, 0.0)


def ringing(cells, periods=10.0, transfer="apic", shape_function="quadratic", precision="float64", cfl=0.4):
    """The bar, 3 cells thick, with strains up to 1e-4; FLIP without PIC."""
    dx, method = LENGTH / cells, {"transfer": transfer, "shape_function": shape_function, "precision": precision}
    return pmpm.Scene(
        title="Vibrating bar",
        domain={
            "size": [(cells + 6) * dx, 3.0 * dx],
            "cell_size": dx,
            "walls": {"x_min": "stick", "y_min": "slip", "y_max": "slip"},
        },
        method=method | ({"flip_blend": 1.0} if transfer == "flip" else {}),
        time={"end": periods * 4.0 * LENGTH / WAVE_SPEED, "cfl": cfl},
        materials={
            "material": {
                "model": "neo_hookean",
                "density": DENSITY,
                "youngs_modulus": DENSITY * WAVE_SPEED**2,
                "poisson_ratio": 0.0,
            }
        },
        bodies=[
            {
                "material": "material",
                "shape": {"type": "box", "min": [0.0, 0.0], "max": [LENGTH, 3.0 * dx]},
                "velocity": start,
            }
        ],
        exact={"displacement": displacement, "velocity": velocity},
    )


@dataclass(frozen=True)
class Ring:
    """What a bar does: relative error of its frequency, loss of amplitude per period, and the trace of its energy."""

    frequency: float
    decay: float
    steps_per_period: float
    times: tuple
    energies: tuple


def ring(scene, comm=None):
    """Run a bar and fit angle and logarithm of amplitude of its mode by straight lines in time."""
    simulation, mode, energies = pmpm.Simulation(scene, comm), [], []

    def sample(simulation):
        p = simulation.particles
        shape = np.sin(FIXED * p.X[:, 0].astype(float))
        moved = (p.x[:, 0].astype(float) - p.X[:, 0]) @ shape
        parts = simulation.comm.gather((moved * FIXED * WAVE_SPEED, p.v[:, 0].astype(float) @ shape))
        mode.append((simulation.time, *(math.fsum(column) for column in zip(*parts, strict=True))))
        measured = simulation.measure()
        energies.append(measured["kinetic"] + measured["strain"])

    period = 4.0 * LENGTH / WAVE_SPEED
    simulation.every(sample, seconds=period / SAMPLES, at_start=True)
    simulation.run()
    t, u, v = np.array(mode).T
    angles = np.unwrap(np.arctan2(u, v))
    rate = np.polyfit(t, angles, 1)[0]
    loss = np.polyfit(t, np.log(np.hypot(u, v)), 1)[0]
    return Ring(
        rate / (FIXED * WAVE_SPEED) - 1.0,
        1.0 - math.exp(loss * period),
        simulation.step_count * period / simulation.time,
        tuple(t / period),
        tuple(np.array(energies) / energies[0]),
    )


# ---- the filter ----------------------------------------------------------------------------------------------------------


def wave(cells=32, transfer="pic", shape_function="quadratic", steps=50):
    """A wave of velocities over the periodic box in a material that hardly resists: one wave length, so many steps of 1 s."""
    dx = 1.0 / cells
    return pmpm.Scene(
        title="A wave under the transfers alone",
        domain={"size": [1.0, 8.0 * dx], "cell_size": dx, "periodic": ["x", "y"]},
        method={"transfer": transfer, "shape_function": shape_function}
        | ({"flip_blend": 1.0} if transfer == "flip" else {}),
        time={"end": float(steps), "step": 1.0},
        materials={"material": {"model": "neo_hookean", "density": 1.0, "youngs_modulus": 1e-18, "poisson_ratio": 0.0}},
        bodies=[
            {
                "material": "material",
                "shape": {"type": "box", "min": [0.0, 0.0], "max": [1.0, 8.0 * dx]},
                "velocity": one_wave,
            }
        ],
        exact={"displacement": at_rest},
    )


def one_wave(X):
    return HEIGHT * np.sin(2.0 * math.pi * X) * along(X)


def at_rest(X, t):
    return np.zeros_like(X)


def lost(scene, comm=None):
    """Loss of a wave per step: -ln(amplitude at the end / at the start) / steps.

    C starts as the gradient of the velocity: at zero, as of any body, the first step of APIC and MLS is one of PIC.
    """
    simulation = pmpm.Simulation(scene, comm)
    if simulation.needs.scheme.affine:
        C = np.zeros(simulation.particles.C.shape)
        C[:, 0, 0] = HEIGHT * 2.0 * math.pi * np.cos(2.0 * math.pi * simulation.particles.X[:, 0])
        simulation.particles.C = C

    def amplitude():
        p = simulation.particles
        return math.fsum(simulation.comm.gather(float(p.v[:, 0] @ np.sin(2.0 * math.pi * p.X[:, 0]))))

    before = amplitude()
    simulation.run()
    return -math.log(amplitude() / before) / simulation.step_count


def law(cells, shape_function):
    """D k^2 of PIC for one wave over so many cells."""
    return D[shape_function] * (2.0 * math.pi / cells) ** 2


# ---- what is checked -----------------------------------------------------------------------------------------------------

CELLS = {"tiny": (13, 26), "standard": (13, 26, 52, 104), "sweep": (13, 26, 52, 104, 208)}
FREQUENCY = {26: 0.01, 104: 0.001}
DECAY = {"flip": 0.01, "apic": 0.05, "mls": 0.05}
SCHEMES = (("flip", "quadratic"), ("apic", "quadratic"), ("mls", "quadratic"), ("mls", "cubic"), ("pic", "quadratic"))


def verify(size, comm):
    yield from filtered(comm)
    rows, traces, periods = [], {}, 2.0 if size == "tiny" else 10.0
    for scheme in SCHEMES[1:3] if size == "tiny" else SCHEMES:
        for cells in CELLS[size]:
            found = ring(ringing(cells, periods, *scheme), comm)
            name = f"{' '.join(scheme)}, {cells} cells"
            rows.append((*scheme, cells, f"{found.frequency:+.3%}", f"{found.decay:.3%}"))
            if cells in FREQUENCY and scheme[0] != "pic" and scheme[1] == "quadratic":
                why = "Bardenhagen's bar, 1 % at 26 cells and .1 % at 104"
                yield at_most(f"{name}: |error of frequency|", abs(found.frequency), FREQUENCY[cells], why)
            if cells == 52 and scheme[0] in DECAY:
                yield at_most(f"{name}: decay per period", found.decay, DECAY[scheme[0]], "small against PIC's")
            if scheme[0] == "pic":
                expected = 0.5 * D["quadratic"] * (FIXED * LENGTH / cells) ** 2 * found.steps_per_period
                why = "filtered while it moves: half of D k^2 in each step"
                yield near(f"{name}: decay rate per period", -math.log(1.0 - found.decay), expected, 0.05, why)
            if cells == 52:
                traces[" ".join(scheme)] = found.times, found.energies
    head = ("transfer", "spline", "cells", "frequency", "amplitude lost per period")
    yield Table("Bar", head, rows)
    if traces:
        yield Plot("Energy of the bar, 52 cells", "periods", "of that at the start", traces)


def filtered(comm):
    for spline in ("quadratic", "cubic"):
        for cells in (32, 64):
            expected, pic = law(cells, spline), lost(wave(cells, "pic", spline), comm)
            what = f"PIC {spline}, k dx = {2.0 * math.pi / cells:.3f}: loss per step"
            yield near(what, pic, expected, 0.01, "D k^2 for k dx <= 0.2")
            for transfer in ("apic", "mls", "flip"):
                kept = abs(lost(wave(cells, transfer, spline), comm))
                what = f"{transfer} {spline}, k dx = {2.0 * math.pi / cells:.3f}: PIC's loss over its own"
                yield at_least(what, pic / max(kept, 1e-300), 50.0, "an affine field, or no filter")


ABOUT = """
A bar 25 m long, E = 100 Pa, 1 kg/m3, nu = 0, fixed at one end between slip sides, rings in its lowest mode with strains of 1e-4
(Bardenhagen, J. Comput. Phys. 180 (2002) 383): frequency and loss of amplitude come from straight lines through angle and
logarithm of amplitude of the mode, 40 times per period. Before it, a wave of velocities in a material without stiffness, to
which transfers alone do something: PIC loses D k^2 of it in each step, D = dx^2 / 4 or dx^2 / 3.
"""

CASE = Case("V3", "Vibrating bar and PIC's filter", ABOUT, verify)
