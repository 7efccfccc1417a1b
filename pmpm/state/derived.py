"""Quantities that follow from what a particle carries: fields for files and users, contributions to the totals.

Computed by numpy from the same physics source as the kernels (targets.arrays): nothing is compiled for it.
"""

from functools import cached_property

import numpy as np

from pmpm.kernels import targets
from pmpm.physics import hencky, invariants, stability

MASS, VOLUME0, DENSITY, PARAMETERS = 0, 1, 2, 3  # columns of a law's table, one row per body
ELASTIC_STRAINS = ("hencky_strain", "elastic_strain")  # under which laws keep 1/2 ln b


class DerivedFields:
    """Fields of one law's particles, each (n, ...) in the order of the population, computed when asked for."""

    def __init__(self, population, law, layout, needs, geometry, table, real):
        self.population, self.law, self.layout, self.affine = population, law, layout, needs.scheme.affine
        self.geometry, self.real = geometry, real
        self.target = targets.arrays(real, la=needs.tensors, law=law.module, **dict(law.choices))
        self.table = table.astype(real)

    @cached_property
    def row_values(self):
        """(n, columns) of the law's table."""
        return self.table[self.population.per_particle(self.population.block_row)]

    @cached_property
    def state(self):
        state = self.population.rows(slice(self.layout.state_first, self.layout.size)).astype(self.real)
        return tuple(np.ascontiguousarray(column) for column in state.T)

    @cached_property
    def params(self):
        return tuple(np.ascontiguousarray(column) for column in self.row_values.T[PARAMETERS:])

    def evaluate(self, name, *arguments):
        """A function of the law over all particles."""
        return self.call(getattr(self.law.module, name), *arguments)

    def call(self, function, *arguments):
        """A function of the physics over all particles."""
        with np.errstate(all="ignore"):
            return self.target.compile(function)(self.state, *arguments)

    def field(self, name):
        """Rows of a common field or state variable as stored; None if the law keeps no such field."""
        where = self.layout.where(name)
        return None if where is None else self.population.rows(where)

    def x(self):
        """(n, dim) float64 positions in m."""
        node, part = self.population.cells(self.geometry.axes)
        return (node + part) * self.geometry.cell_size

    def velocity(self):
        return self.field("v")

    def speed(self):
        v = self.field("v")
        with np.errstate(over="ignore"):  # too fast for any run, which will say so
            return np.sqrt((v * v).sum(axis=1))

    def strain_rate(self):
        """(n,) |C| in 1/s, zero where particles have none."""
        C = self.field("C")
        return np.zeros(len(self.population)) if C is None else np.sqrt((C * C).sum(axis=1))

    def mass(self):
        return self.shared(self.row_values[:, MASS])

    def volume0(self):
        return self.shared(self.row_values[:, VOLUME0])

    def shared(self, whole):
        """Of each particle its share of what a whole one has, where particles carry shares."""
        share = self.field("share")
        return whole if share is None else whole * share[:, 0]

    def J(self):
        return self.evaluate("volume_ratio")

    def density(self):
        return self.row_values[:, DENSITY] / self.J()

    def stress(self):
        """(n, 6) Cauchy stress xx yy zz xy yz xz in Pa."""
        tau = self.evaluate("kirchhoff_stress", self.params)
        zero = np.zeros_like(tau[0])
        if self.geometry.dim == 2:
            entries = (tau[0], tau[2], self.evaluate("out_of_plane_stress", self.params), tau[1], zero, zero)
        else:
            entries = (tau[0], tau[3], tau[5], tau[1], tau[4], tau[2])
        return np.stack(np.broadcast_arrays(*entries), axis=-1) / self.J()[:, None]

    def pressure(self):
        sigma = self.stress()
        return -(sigma[:, 0] + sigma[:, 1] + sigma[:, 2]) / self.real(3.0)

    def von_mises_stress(self):
        with np.errstate(all="ignore"):
            return self.target.compile(invariants.von_mises)(*self.stress().T)

    def strain(self):
        """(n, 6) elastic logarithmic strain 1/2 ln b, entries as of `stress`: of F (whole in a law without plastic flow) or as
        the law keeps it; nan where it keeps neither, or det F <= 0."""
        rows, dim = len(self.population), self.geometry.dim
        kept = next((name for name in ELASTIC_STRAINS if self.layout.where(name) is not None), None)
        if kept is not None:
            E = self.field(kept).astype(self.real).T
        elif self.layout.where("F") is not None:
            F = tuple(np.ascontiguousarray(column) for column in self.field("F").astype(self.real).T)
            with np.errstate(all="ignore"):
                E = self.target.compile(hencky.strain_of)(F)
        else:
            return np.full((rows, 6), np.nan, self.real)
        zero = np.zeros(rows, self.real)
        if dim == 2:
            entries = (E[0], E[2], E[3] if len(E) == 4 else zero, E[1], zero, zero)
        else:
            entries = (E[0], E[3], E[5], E[1], E[4], E[2])
        return np.stack(np.broadcast_arrays(*entries), axis=-1)

    def von_mises_strain(self):
        """(n,) sqrt(2/3 dev E : dev E): a bar's own strain where it is stretched without a change of volume."""
        with np.errstate(all="ignore"):
            return self.target.compile(invariants.von_mises)(*self.strain().T) * self.real(2.0 / 3.0)

    def plastic_strain(self):
        """(n,) accumulated equivalent plastic strain; nan where the law keeps none."""
        kept = getattr(self.law.module, "PLASTIC_STRAIN", None)
        values = None if kept is None else self.field(kept)
        return np.full(len(self.population), np.nan, self.real) if values is None else values[:, 0]

    def displacement(self):
        """(n, dim) m from the reference position, the short way round where the domain repeats; nan where none is kept."""
        X, geometry = self.field("X"), self.geometry
        if X is None:
            return np.full((len(self.population), geometry.dim), np.nan, self.real)
        moved = self.x() - X.astype(np.float64)
        for axis in range(geometry.dim):
            if geometry.periodic[axis]:
                length = geometry.cells[axis] * geometry.cell_size
                moved[:, axis] -= length * np.rint(moved[:, axis] / length)
        return moved.astype(self.real)

    def volume(self):
        """(n,) m3, in 2-D per metre of thickness."""
        return self.volume0() * self.J()

    def deformation_gradient(self):
        """(n, 9) F row by row, plane strain completed by F_zz = 1; nan where the law keeps none."""
        F = self.field("F")
        full = np.full((len(self.population), 9), np.nan, self.real)
        if F is not None and self.geometry.dim == 3:
            full[:] = F
        elif F is not None:
            full[:] = (0, 0, 0, 0, 0, 0, 0, 0, 1)
            full[:, [0, 1, 3, 4]] = F
        return full

    def wave_speed_squared(self):
        """Square of the speed that bounds the step; see physics.stability."""
        return self.call(stability.signal_speed_squared, self.params, self.row_values[:, DENSITY],
                         self.real(1.0 / self.geometry.cell_size))  # fmt: skip

    def body_force_squared(self, force, time):
        """(n,) |b|^2 in m2/s4 of a function b(x, X, t)."""
        x, X = self.x().astype(self.real), self.field("X")
        with np.errstate(all="ignore"):
            b = self.target.compile(force)(tuple(x.T), tuple((x if X is None else X).T), self.real(time))
            return sum((np.asarray(along) ** 2 for along in b), np.zeros(len(x)))

    def spin(self):
        """(n, dim, dim) C D in m2/s, with the angular momentum of the affine field (Jiang et al. 2015, section 5.3)."""
        dim, C = self.geometry.dim, self.field("C")
        if not self.affine:
            return np.zeros((len(self.population), dim, dim))
        inertia = np.full((len(self.population), dim), 1.0)
        if self.geometry.stencil.inertia > 0.0:
            inertia /= self.geometry.stencil.inertia
        else:  # linear splines: g (1 - g) per axis
            _, part = self.population.cells(self.geometry.axes)
            inertia = part * (1.0 - part)
        return C.astype(np.float64).reshape(-1, dim, dim) * (inertia * self.geometry.cell_size**2)[:, None, :]

    def totals(self, gravity):
        """dict of (n,) contributions to the totals of `Simulation.measure`, float64."""
        dim, m, x, v = self.geometry.dim, self.mass(), self.x(), self.velocity().astype(np.float64)
        spin = self.spin()
        found = {}
        for axis in range(dim):
            found[f"momentum_{'xyz'[axis]}"] = m * v[:, axis]
        for axis in (2,) if dim == 2 else (0, 1, 2):
            p, q = (axis + 1) % 3, (axis + 2) % 3
            found[f"angular_momentum_{'xyz'[axis]}"] = m * (
                x[:, p] * v[:, q] - x[:, q] * v[:, p] + spin[:, q, p] - spin[:, p, q]
            )
        found["kinetic"] = 0.5 * m * (v * v).sum(axis=1)
        found["strain"] = self.volume0() * self.evaluate("energy", self.params)
        found["potential"] = -m * (x @ np.asarray(gravity))
        return found
