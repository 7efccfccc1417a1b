"""Rigid motion: what flies, falls or spins must not strain.

Flight and fall are exact in the scheme: x = x0 + v0 t + g t (t + dt) / 2 of symplectic Euler. The spinning disk starts in its
steady state, in which what was at R lies at r(R): plane strain, P_R' + (P_R - P_T) / R + rho0 w^2 r = 0 with a free edge,
neo-Hookean, solved by shooting; the spinning cube in a homogeneous state of the right mean stress.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

import pmpm
from cases import Case, Check, Table, at_most
from pmpm import accuracy

MATERIAL = {"model": "neo_hookean", "density": 1000.0, "youngs_modulus": 1e6, "poisson_ratio": 0.3}
MU, LAM = 1e6 / 2.6, 0.3e6 / (1.3 * 0.4)
RADIUS, SPIN = 0.2, 5.0  # m, half the cube's edge; rad/s: rho0 w^2 R^2 / E = 1e-3
PULL, THROWN, STEP = (1.0, -9.81), (3.0, 5.0), 1e-3  # m/s2, m/s, s


# ---- flight and fall -----------------------------------------------------------------------------------------------------


def flying(velocity=(100.0, 0.0), cells=200, precision="float64", transfer="apic"):
    """A block of 8 x 8 cells of 1 m that crosses so many of them."""
    speed = max(map(abs, velocity))
    size = [12.0 + math.ceil(cells * abs(v) / speed) for v in velocity]
    return block(size, [2.0, 2.0], velocity, cells / speed, precision, transfer)


def falling(steps=400, precision="float64", transfer="apic"):
    """A block that is thrown up and falls, with a fixed step of 1 ms."""
    return block([40.0, 40.0], [6.0, 20.0], THROWN, steps * STEP, precision, transfer, PULL, STEP)


def block(size, low, velocity, end, precision, transfer, gravity=(0.0, 0.0), step=None):
    return pmpm.Scene(
        title="Rigid motion",
        domain={"size": size, "cell_size": 1.0, "gravity": gravity},
        method={"transfer": transfer, "precision": precision},
        time={"end": end} | ({} if step is None else {"step": step}),
        materials={"material": MATERIAL},
        bodies=[
            {
                "material": "material",
                "shape": {"type": "box", "min": low, "max": [corner + 8.0 for corner in low]},
                "velocity": velocity,
            }
        ],
        exact={"displacement": Parabola(tuple(velocity), tuple(gravity), step or 0.0).displacement},
    )


@dataclass(frozen=True)
class Parabola:
    """What symplectic Euler makes of a constant acceleration: velocities grow before places move."""

    velocity: tuple
    gravity: tuple
    step: float

    def displacement(self, X, t):
        moved = np.array(self.velocity) * t + np.array(self.gravity) * t * (t + self.step) / 2.0
        return np.broadcast_to(moved, X.shape)


def deviations(simulation):
    """Largest (|v - exact|, |F - I|, |x - exact|) over all particles of all ranks."""
    particles, t, exact = simulation.particles, simulation.time, simulation.scene.exact
    gravity, thrown = simulation.scene.domain.gravity, simulation.scene.bodies[0].velocity
    X = particles.X.astype(float)
    found = (
        particles.v - np.add(thrown, np.multiply(gravity, t)),
        particles.F - np.eye(simulation.dim),
        particles.x - X - exact.displacement(X, t),
    )
    largest = [float(np.abs(values).max(initial=0.0)) for values in found]
    return [max(ranks) for ranks in zip(*simulation.comm.gather(largest), strict=True)]


# ---- spinning ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Spinning:
    """A disk (2-D) or a cube (3-D) of half width 0.2 m that spins about z in the middle of its domain."""

    dim: int = 2
    cell_size: float = 0.04

    @property
    def edge(self):
        """Of the domain, m: the body, its corners and four cells around."""
        reach = RADIUS * (1.0 if self.dim == 2 else math.sqrt(2.0))
        return self.cell_size * 2.0 * math.ceil(reach / self.cell_size + 4.0)

    @property
    def middle(self):
        return np.full(self.dim, 0.5 * self.edge)

    @cached_property
    def profile(self):
        """(R, r, dr/dR) of the disk's steady state."""
        low, high = 1.0, 1.01
        for _ in range(60):
            centre = 0.5 * (low + high)
            low, high = (centre, high) if shoot(centre)[1] < 0.0 else (low, centre)
        return shoot(low)[0]

    @cached_property
    def stretches(self):
        """Of the cube along x, y, z: mean P_xx = P_yy = rho0 w^2 a^2 / 3 at the half width a, P_zz = 0."""
        s, load = np.ones(3), MATERIAL["density"] * SPIN**2 * RADIUS**2 / 3.0
        for _ in range(20):
            P = MU * (s - 1.0 / s) + LAM * np.log(s.prod()) / s
            slope = np.diag(MU * (1.0 + s**-2) - LAM * np.log(s.prod()) / s**2) + LAM / np.outer(s, s)
            s = s - np.linalg.solve(slope, P - [load * s[0], load * s[1], 0.0])
        return s

    def start(self, X):
        """(places from the middle (n, dim), F (n, dim, dim)) of the state that spins."""
        r = X - self.middle
        if self.dim == 3:
            return r * self.stretches, np.broadcast_to(np.diag(self.stretches), (len(X), 3, 3))
        R = np.sqrt((r * r).sum(axis=1))
        at, stretched, slope = self.profile
        hoop = np.interp(R, at[1:], stretched[1:] / at[1:])
        radial, outer = np.interp(R, at, slope), r[:, :, None] * r[:, None, :] / (R * R)[:, None, None]
        F = hoop[:, None, None] * np.eye(2) + (radial - hoop)[:, None, None] * outer
        return hoop[:, None] * r, F

    def rotation(self, t):
        turn = np.eye(self.dim)
        turn[:2, :2] = [[math.cos(SPIN * t), -math.sin(SPIN * t)], [math.sin(SPIN * t), math.cos(SPIN * t)]]
        return turn

    def displacement(self, X, t):
        return self.start(X)[0] @ self.rotation(t).T + self.middle - X

    def velocity(self, X, t):
        return self.start(X)[0] @ self.rotation(t).T @ self.gradient.T

    @property
    def gradient(self):
        """Of the velocity, 1/s."""
        found = np.zeros((self.dim, self.dim))
        found[0, 1], found[1, 0] = -SPIN, SPIN
        return found

    def deformation(self, X, t):
        return self.rotation(t) @ self.start(X)[1]

    def scene(self, turns, transfer="apic", shape_function="quadratic", flip_blend=1.0):
        box = {"type": "box", "min": list(self.middle - RADIUS), "max": list(self.middle + RADIUS)}
        disk = {"type": "sphere", "center": list(self.middle), "radius": RADIUS}
        method = {"transfer": transfer, "shape_function": shape_function}
        return pmpm.Scene(
            title="Spinning body",
            domain={"size": [self.edge] * self.dim, "cell_size": self.cell_size},
            method=method | ({"flip_blend": flip_blend} if transfer == "flip" else {}),
            time={"end": turns * 2.0 * math.pi / SPIN},
            materials={"material": MATERIAL},
            bodies=[
                {
                    "material": "material",
                    "shape": disk if self.dim == 2 else box,
                    "displacement": lambda X: self.displacement(X, 0.0),
                    "velocity": lambda X: self.velocity(X, 0.0),
                    "deformation": lambda X: self.deformation(X, 0.0),
                }
            ],
            exact={"displacement": self.displacement, "velocity": self.velocity, "deformation": self.deformation},
        )

    def simulation(self, turns, *scheme, comm=None):
        """The simulation at its start, C being the gradient of the velocity."""
        found = pmpm.Simulation(self.scene(turns, *scheme), comm)
        if found.needs.scheme.affine:
            found.particles.C = np.broadcast_to(self.gradient, found.particles.C.shape)
        return found

    def out_of_shape(self, simulation):
        """Root mean square distance, m, from the steady state turned by whatever angle fits best."""
        particles = simulation.particles
        rows = simulation.comm.gather((particles.id, particles.X, particles.x))
        order = np.argsort(np.concatenate([ids for ids, _, _ in rows]))
        X, x = (np.concatenate([row[n] for row in rows])[order].astype(float) for n in (1, 2))
        wanted, found = self.start(X)[0], x - x.mean(axis=0)
        wanted = wanted - wanted.mean(axis=0)
        across = (wanted[:, 0] * found[:, 1] - wanted[:, 1] * found[:, 0]).sum()
        angle = math.atan2(across, (wanted[:, :2] * found[:, :2]).sum())
        return float(np.sqrt(((found - wanted @ self.rotation(angle / SPIN).T) ** 2).sum(axis=1).mean()))


def shoot(stretch, steps=400):
    """((R, r, dr/dR), P_R at the edge) of a disk whose middle is stretched by `stretch`; Runge and Kutta's fourth order."""

    def slope(R, y):
        r, a = y
        h = r / R if R > 0.0 else a
        log_J = math.log(a * h)
        hoop_rate = (a - h) / R if R > 0.0 else 0.0
        P_R, P_T = (MU * (s - 1.0 / s) + LAM * log_J / s for s in (a, h))
        # P_R' = dP_R/da a' + dP_R/dh h'
        by_a, by_h = MU * (1.0 + a**-2) + LAM * (1.0 - log_J) / (a * a), LAM / (a * h)
        load = (P_R - P_T) / R if R > 0.0 else 0.0
        return np.array([a, (-load - MATERIAL["density"] * SPIN**2 * r - by_h * hoop_rate) / by_a])

    dR, y = RADIUS / steps, np.array([0.0, stretch])
    path = [(0.0, 0.0, stretch)]
    for n in range(steps):
        R = n * dR
        k1 = slope(R, y)
        k2 = slope(R + 0.5 * dR, y + 0.5 * dR * k1)
        k3 = slope(R + 0.5 * dR, y + 0.5 * dR * k2)
        k4 = slope(R + dR, y + dR * k3)
        y = y + dR / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        path.append((R + dR, *y))
    r, a = y
    h = r / RADIUS
    return tuple(np.array(path).T), MU * (a - 1.0 / a) + LAM * math.log(a * h) / a


# ---- what is checked -----------------------------------------------------------------------------------------------------

TURNS = {"tiny": 0.2, "standard": 10.0, "sweep": 10.0}
CELL_SIZES = {"tiny": 0.05, "standard": 0.04, "sweep": 0.02}
SCHEMES = (("apic", "quadratic"), ("mls", "quadratic"), ("mls", "cubic"), ("flip", "quadratic"), ("pic", "quadratic"))


def verify(size, comm):
    for transfer in ("apic",) if size == "tiny" else ("apic", "mls", "flip", "pic"):
        for precision in ("float64", "float32"):
            yield from fly_and_fall(transfer, precision, comm)
    rows = []
    for dim in (2, 3):
        for scheme in SCHEMES[:2] if size == "tiny" or dim == 3 else SCHEMES:
            yield from spin(Spinning(dim, CELL_SIZES[size] if dim == 2 else 0.05), TURNS[size], scheme, comm, rows)
    head = ("body", "transfer", "spline", "turns", "out of shape, cells", "L left, less 1", "e_u at the end")
    yield Table("Spinning bodies", head, rows)


def fly_and_fall(transfer, precision, comm):
    eps = float(np.finfo(precision).eps)
    name = f"{transfer}, {precision}"
    flight = pmpm.Simulation(flying(precision=precision, transfer=transfer), comm)
    flight.run()
    v, F, x = deviations(flight)
    rounding, each = eps * flight.step_count, "each step may round"
    yield at_most(f"flight across 200 cells, {name}: |v - v0| / v0", v / 100.0, rounding, each)
    yield at_most(f"flight across 200 cells, {name}: |F - I|", F, rounding, each)
    yield at_most(
        f"flight across 200 cells, {name}: |x - exact|, cells", x, 10.0 * rounding, "offsets of a few cells round"
    )
    fall = pmpm.Simulation(falling(precision=precision, transfer=transfer), comm)
    fall.run()
    v, F, x = deviations(fall)
    yield at_most(
        f"free fall, {name}: |x - exact|, cells", x, 500.0 * eps, "the parabola of symplectic Euler to round-off"
    )
    yield at_most(f"free fall, {name}: |F - I|", F, 100.0 * eps, "nothing strains")


def spin(body, turns, scheme, comm, rows):
    simulation = body.simulation(turns, *scheme, comm=comm)
    errors, before = accuracy.Errors(simulation), simulation.measure()["angular_momentum_z"]
    simulation.run()
    errors(simulation)
    out = body.out_of_shape(simulation) / body.cell_size
    lost = simulation.measure()["angular_momentum_z"] / before - 1.0
    name = f"{'disk' if body.dim == 2 else 'cube'}, {' '.join(scheme)}, {turns:g} turns"
    rows.append(("disk" if body.dim == 2 else "cube", *scheme, turns, out, lost, errors.last["displacement"]))
    if scheme[0] in ("apic", "mls"):
        yield at_most(f"{name}: out of shape, cells", out, 0.5, "a body that spins keeps its shape")
        yield at_most(f"{name}: change of L", abs(lost), 1e-10, "APIC and MLS conserve it in each step, to round-off")
    else:
        yield Check(f"{name}: out of shape, cells", out)
        yield Check(f"{name}: change of L", lost)


ABOUT = """
A block flies at 100 cells per second across 200 cells, and another is thrown and falls: both must stay as they are, to
round-off, under mpirun across the cuts. A disk and a cube (E = 1e6 Pa, nu = 0.3, 1000 kg/m3, half width 0.2 m, 5 rad/s) spin
ten turns from the state in which centrifugal load and stress balance: of the disk exactly, of the cube in the mean. Out of
shape: root mean square distance from that state at the angle that fits best. L: the angular momentum, the affine field's
included.
"""

CASE = Case("V6", "Rigid motion", ABOUT, verify)
