"""A column that settles under its own weight, laterally confined: the static solution is exact at any strain.

Weight above a material point is all it carries: P_yy(F(X)) = -rho0 g (L - X), where P is the law's stress in uniaxial strain
and F = dy/dX; y(X) is the integral of F. Without lateral stretch the Cauchy stress sigma_yy is P_yy. The laws' stresses are
written here from their energies, F is found by bisection, and nothing of pmpm is used for it.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

import pmpm
from cases import Case, Table, at_least, at_most, holds, order
from cases.gathered import by_id

WIDTH = 3  # cells between slip walls
GAMMA = 7.0
DEPTHS = 20_000  # midpoints of the integral


@dataclass(frozen=True)
class Column:
    """Material and measures, SI units; `modulus`: Young's, or the bulk modulus of the fluid."""

    model: str
    modulus: float
    poisson_ratio: float
    density: float
    gravity: float
    length: float

    @property
    def lame(self):
        E, nu = self.modulus, self.poisson_ratio
        return E / (2.0 * (1.0 + nu)), E * nu / ((1.0 + nu) * (1.0 - 2.0 * nu))

    @property
    def wave_modulus(self):
        mu, lam = self.lame
        return self.modulus if self.model == "fluid" else lam + 2.0 * mu

    @property
    def period(self):
        """Of the lowest vibration of the undeformed column, 4 L / c."""
        return 4.0 * self.length / math.sqrt(self.wave_modulus / self.density)

    @property
    def material(self):
        if self.model == "fluid":
            return {"model": "fluid", "density": self.density, "bulk_modulus": self.modulus, "gamma": GAMMA}
        elastic = {"youngs_modulus": self.modulus, "poisson_ratio": self.poisson_ratio}
        return {"model": self.model, "density": self.density, **elastic}

    def stress(self, F):
        """P_yy at the stretch F > 0: the derivative of the energy in uniaxial strain."""
        (mu, lam), log_F = self.lame, np.log(F)
        if self.model == "neo_hookean":
            return mu * (F - 1.0 / F) + lam * log_F / F
        if self.model == "fixed_corotated":
            return (lam + 2.0 * mu) * (F - 1.0)
        if self.model == "hencky":
            return (lam + 2.0 * mu) * log_F / F
        return -self.modulus / GAMMA * (F**-GAMMA - 1.0)

    def weight_above(self, X):
        return self.density * self.gravity * (self.length - X)

    def stretch(self, X):
        """F at material heights X (n,), nan where no F > 0 carries the weight."""
        low, high = np.full_like(X, 1e-12), np.ones_like(X)
        carried = self.stress(low) <= -self.weight_above(X)
        for _ in range(100):
            middle = 0.5 * (low + high)
            too_weak = self.stress(middle) > -self.weight_above(X)
            low, high = np.where(too_weak, low, middle), np.where(too_weak, middle, high)
        return np.where(carried, 0.5 * (low + high), math.nan)

    def heights(self, X):
        """y of material heights X (n,), nan where there is no equilibrium."""
        return np.interp(X, *self.table)

    def settlement(self, X):
        """u (n, 2) at X (n, 2)."""
        return np.stack([np.zeros(len(X)), self.heights(X[:, 1]) - X[:, 1]], axis=-1)

    def deformation(self, X):
        """F (n, 2, 2) at X (n, 2)."""
        F = np.tile(np.eye(2), (len(X), 1, 1))
        F[:, 1, 1] = self.stretch(X[:, 1])
        return F

    @cached_property
    def table(self):
        """(X, y) at the ends of DEPTHS pieces."""
        edges = np.linspace(0.0, self.length, DEPTHS + 1)
        F = self.stretch(0.5 * (edges[1:] + edges[:-1]))
        return edges, np.append(0.0, np.cumsum(F) * self.length / DEPTHS)

    @property
    def height(self):
        return float(self.heights(np.array([self.length]))[0])


SOLIDS = ("neo_hookean", "fixed_corotated", "hencky")
FAINT = Column("neo_hookean", 1e8, 0.3, 1000.0, 9.81, 10.0)
STIFF = {model: Column(model, 1e6, 0.3, 1000.0, 9.81, 10.0) for model in SOLIDS}
SOFT = {model: Column(model, 1e5, 0.3, 1000.0, 9.81, 5.0) for model in SOLIDS}
SEVERE = {model: Column(model, 1e4, 0.0, 80.0, 10.0, 50.0) for model in SOLIDS}
WATER = Column("fluid", 1000.0 * 45.0**2, 0.0, 1000.0, 10.0, 1.0)


def scene(column, cells, settle=5.0, ramp=2.0, from_rest=False, particles_per_cell=4, **method):
    """`cells` along the height; gravity grows over `ramp` periods and all is over after `settle` more.

    The damping is critical for the lowest vibration: what is left of it after n periods is exp(-2 pi n) (1 + 2 pi n). With
    `from_rest` the column starts in the static solution, under all of gravity.
    """
    dx, top, solved = column.length / cells, column.length + 2.0 * column.length / cells, not math.isnan(column.height)
    body = {
        "material": "material",
        "shape": {"type": "box", "min": [0.0, 0.0], "max": [WIDTH * dx, column.length]},
        "particles_per_cell": particles_per_cell,
    }
    if from_rest:
        ramp = 0.0
        body |= {"displacement": column.settlement, "deformation": column.deformation}
    exact = {"displacement": lambda X, t: column.settlement(X), "deformation": lambda X, t: column.deformation(X)}
    return pmpm.Scene(
        title=f"Column under its weight, {column.model}",
        domain={
            "size": [WIDTH * dx, top],
            "cell_size": dx,
            "gravity": [0.0, -column.gravity],
            "walls": {"x_min": "slip", "x_max": "slip", "y_min": "slip"},
        },
        method={"damping": 4.0 * math.pi / column.period} | method,
        time={"end": (ramp + settle) * column.period, "ramp": ramp * column.period},
        materials={"material": column.material},
        bodies=[body],
        exact=exact if solved else None,
    )


def errors(simulation, column):
    """How far a simulation is from the static solution, by root mean squares over its particles. Collective.

    height: of the top, relative; e_y: of all heights, relative to the settlements; stress: of sigma_yy, relative to itself, and
    of the eight tenths in the middle alone; kinetic: energy over M g L.
    """
    X, x, sigma = by_id(simulation, "X", "x", "stress")
    exact = column.heights(X[:, 1])
    off, settled = x[:, 1] - exact, X[:, 1] - exact
    top = X[:, 1] == X[:, 1].max()
    weight = column.weight_above(X[:, 1])
    off_stress = sigma[:, 1] + weight
    inside = np.abs(X[:, 1] - 0.5 * column.length) < 0.4 * column.length
    measured = simulation.measure()
    return {
        "height": float(off[top].mean() / column.height),
        "e_y": rms(off) / rms(settled),
        "stress": rms(off_stress) / rms(weight),
        "stress_inside": rms(off_stress[inside]) / rms(weight[inside]),
        "kinetic": measured["kinetic"] / (measured["mass"] * column.gravity * column.length),
    }


def rms(values):
    return float(np.sqrt(np.mean(values**2)))


def settled(column, cells, comm=None, **keys):
    """`errors` of a column laid to rest."""
    simulation = pmpm.Simulation(scene(column, cells, **keys), comm)
    simulation.run()
    return errors(simulation, column)


def collapsed(column, cells, comm=None, **keys):
    """What becomes of a column that nothing holds up: (lowest J, largest speed over the speed of sound, nothing but numbers,
    whether the run speaks of it at its end)."""
    simulation = pmpm.Simulation(scene(column, cells, **keys), comm)
    simulation.run()
    J, x, v, sigma = by_id(simulation, "J", "x", "velocity", "stress")
    sound = math.sqrt(column.wave_modulus / column.density)
    finite = all(bool(np.isfinite(values).all()) for values in (J, x, v, sigma[:, :2]))
    return float(J.min()), float(np.abs(v).max()) / sound, finite, bool(simulation.closing_notes)


# ---- verification ------------------------------------------------------------------------------------------------------------

FAINT_CELLS = {"tiny": (8, 16), "standard": (16, 32, 64, 128), "sweep": (16, 32, 64, 128, 256)}
CELLS = {"tiny": (16,), "standard": (16, 32, 64), "sweep": (16, 32, 64, 128)}
SCHEMES = {
    "apic, quadratic": {},
    "apic, quadratic, 16 per cell": {"particles_per_cell": 16},
    "mls, quadratic": {"transfer": "mls"},
    "flip, quadratic": {"transfer": "flip"},
    "apic, cubic": {"shape_function": "cubic"},
}
HEAD = ("column", "scheme", "N", "height", "e_y", "stress", "stress inside", "kinetic / M g L")


def verify(size, comm):
    rows, cells = [], FAINT_CELLS[size]
    for scheme in ("apic, quadratic", "apic, cubic"):
        found = [settled(FAINT, n, comm, **SCHEMES[scheme]) for n in cells]
        rows += [("faint, neo_hookean", scheme, n, *e.values()) for n, e in zip(cells, found, strict=True)]
        sizes = [1.0 / n for n in cells]
        what = f"{scheme}, settles by 0.04 %, N = {cells[0]} .. {cells[-1]}: order of"
        yield at_least(f"{what} e_y", order([e["e_y"] for e in found], sizes), 1.7, "of second order without crossings")
        yield at_least(f"{what} the stress", order([e["stress"] for e in found], sizes), 1.0, "its gradient")
    cells = CELLS[size]
    schemes = ("apic, quadratic",) if size == "tiny" else tuple(SCHEMES)
    for name, columns in {"stiff": STIFF, "soft": SOFT}.items():
        for model, column in columns.items():
            for scheme in schemes if model == "neo_hookean" else schemes[:1]:
                found = [settled(column, n, comm, **SCHEMES[scheme]) for n in cells]
                rows += [(f"{name}, {model}", scheme, n, *e.values()) for n, e in zip(cells, found, strict=True)]
                what, last = f"{name} {model}, {scheme}, N = {cells[-1]}:", found[-1]
                yield at_most(f"{what} error of the height", abs(last["height"]), 2e-3, "of a settled column")
                yield at_most(f"{what} e_y", last["e_y"], 4e-3, "quadrature: as much as crossing particles add")
                yield at_most(f"{what} error of the stress", last["stress"], 0.05, "quadrature, whatever the cell size")
        column = columns["neo_hookean"]
        found = [settled(column, n, comm, from_rest=True) for n in cells]
        rows += [(f"{name}, neo_hookean", "from rest", n, *e.values()) for n, e in zip(cells, found, strict=True)]
        yield at_most(f"{name}, from rest, N = {cells[-1]}: e_y", found[-1]["e_y"], 4e-3, "the solution must stay")
    yield from verify_severe(cells, comm, rows)
    found = [settled(WATER, n, comm) for n in cells]
    rows += [("water", "apic, quadratic", n, *e.values()) for n, e in zip(cells, found, strict=True)]
    yield at_most(f"water, N = {cells[-1]}: error of the pressure", found[-1]["stress"], 0.01, "at rest")
    yield at_most(f"water, N = {cells[-1]}: kinetic energy / M g H", found[-1]["kinetic"], 1e-6, "at rest")
    yield Table("Columns at rest", HEAD, rows)


def verify_severe(cells, comm, rows):
    for model in ("neo_hookean", "hencky"):
        found = [settled(SEVERE[model], n, comm) for n in cells]
        rows += [(f"severe, {model}", "apic, quadratic", n, *e.values()) for n, e in zip(cells, found, strict=True)]
        reason = "falls to a third of its height and less: each crossing of a cell adds to F what quadrature errs"
        yield at_most(f"severe {model}, N = {cells[-1]}: error of the height", abs(found[-1]["height"]), 0.01, reason)
    lowest, speed, finite, told = collapsed(SEVERE["fixed_corotated"], cells[-1], comm)
    what = f"severe fixed_corotated, N = {cells[-1]}, carries no more than lam + 2 mu and has no equilibrium:"
    yield holds(f"{what} all is finite", finite, "no nan")
    yield at_most(f"{what} lowest J", lowest, 0.01, "it has collapsed")
    yield holds(f"{what} the run says so at its end", told, "a collapse is no result to take for good")
    yield at_most(f"{what} largest speed / c", speed, 1e-6, "the heap is at rest")


ABOUT = """
A column between slip walls under its own weight. All that a material point carries is what lies above it, P_yy(F(X)) =
-rho0 g (L - X), and y is the integral of F; exact at any strain (laws' stresses and F in `cases/column.py`, which uses
nothing of pmpm). Gravity grows over two periods T = 4 L / c, in five more critical damping brings the column to rest.

| column | E, Pa | nu | rho0 | g | L, m | height: neo-Hookean | fixed corotated | Hencky |
| --- | --- | --- | --- | --- | --- | --- | --- | --- |
| stiff | 1e6 | 0.3 | 1000 | 9.81 | 10 | 9.651447 | 9.635629 | 9.659863 |
| soft | 1e5 | 0.3 | 1000 | 9.81 | 5 | 4.259399 | 4.089071 | 4.316717 |
| severe | 1e4 | 0 | 80 | 10 | 50 | 16.169594 | none | 24.059646 |

Orders are asked where particles stay in their cells (`faint`: E = 1e8 Pa), bounds of the other columns. There particles end
where the quadrature of internal forces is inexact (Steffen, Kirby, Berzins, Int. J. Numer. Meth. Eng. 76 (2008) 922): the
stress errs by the same part of itself at any cell size, 1 % at 7 % strain and 3 % at 27 %, and heights converge with first
order or not at all. The path matters less: `from rest` starts in the exact state and has the same errors of the stress. MLS
forces, more particles per cell and above all cubic splines make them smaller.

A fixed corotated solid carries at most lam + 2 mu in compression. Its severe column has no equilibrium and falls into a
heap of J near zero, finite and at rest. The law allows that state, so nothing stops the run, and no message tells of it.
"""

CASE = Case("V4", "Column under its own weight", ABOUT, verify)
