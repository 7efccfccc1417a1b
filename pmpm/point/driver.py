"""Drive one particle of a material: strains are given, stresses are held by finding the strains that are free.

The law's own functions in plain Python, the same source as the kernels. Stress is that of P2G: from the state at the end of a
step, plus the viscous part of the step's velocity gradient (in plane strain not of its zz).
"""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pmpm.kernels import targets
from pmpm.kernels.needs import law_needs
from pmpm.physics import tensors2, tensors3
from pmpm.physics.invariants import von_mises
from pmpm.point.paths import NORMAL, SHEAR, VOLUME, pattern

EPS = float(np.finfo(float).eps)
PRECISION = 1e-9  # of a held stress, relative to it
ROUNDING = (
    1e-12  # of a held stress, relative to the material's stiffness: what strains of 1 leave after a few operations
)
JUMP = 1e-6  # the same where round-off of the free strain, not of the stress, ends the search
FARTHEST = 2.0  # free strain of one step beyond which the search gives up
EXPANSIONS, REFINEMENTS = 80, 200
HALVINGS = 6  # how often a step is cut in half when the stress cannot be held
CONSOLIDATION_STEPS = 50
ENTRIES = {2: ((0, 0), (0, 1), (1, 1)), 3: ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))}
STRESSES = {2: ("xx", "yy", "zz", "xy"), 3: ("xx", "yy", "zz", "xy", "yz", "xz")}
AXES = "xyz"


class Unreachable(Exception):  # noqa: N818
    """No free strain makes the held stress what it should be; the text says what was found."""


class PathEnds(Exception):  # noqa: N818
    """The path cannot be followed further, for a physical or numerical cause; its text is for the user."""


@dataclass(frozen=True)
class Trial:
    """Where an increment leads: the new state, Cauchy stress (3, 3) in Pa (nan where not valid) and volume ratio."""

    G: Any
    state: tuple
    sigma: Any
    J: float
    is_valid: bool


@dataclass
class Record:
    """What was found, a list per column; `failure` says why the path ended early.

    Stresses below `rounding` (Pa) are round-off of strains.
    """

    rounding: float
    columns: dict[str, list[float]] = field(default_factory=dict)
    failure: str | None = None

    def add(self, row):
        for name, value in row.items():
            self.columns.setdefault(name, []).append(value)

    def __getitem__(self, name):
        return np.array(self.columns[name])

    @property
    def rows(self):
        return len(next(iter(self.columns.values()), ()))


class Point:
    """A particle of a material: `model` and all its `keys`, defaults filled in, in 2-D (plane strain) or 3-D."""

    def __init__(self, model, keys, dim):
        needs = law_needs(model, keys)
        self.law, self.dim, self.density = needs.module, dim, keys["density"]
        self.params = self.law.parameters(keys, dim)
        tensors = tensors2 if dim == 2 else tensors3
        self.target = targets.plain(la=tensors, law=self.law, **dict(needs.choices))
        self.is_viscous = bool(dict(needs.choices).get("VISCOUS"))
        self.state_names = [name for one in needs.fields for name in entry_names(one, dim)]
        self.state = self.call("state_at", tuple(map(float, np.eye(dim).ravel())), self.params)
        self.sigma = self.cauchy_stress(self.state, np.zeros((dim, dim)))
        self.time, self.strain, self.shear = 0.0, np.zeros(3), np.zeros((3, 3))

    def call(self, name, *arguments):
        """A function of the law."""
        return self.target.compile(getattr(self.law, name))(*arguments)

    def cauchy_stress(self, state, L):
        """(3, 3) in Pa."""
        sigma = np.zeros((3, 3))
        tau = self.call("kirchhoff_stress", state, self.params)
        if self.is_viscous:
            viscous = self.call("viscous_stress", state, tuple(map(float, np.ravel(L))), self.params)
            tau = tuple(a + b for a, b in zip(tau, viscous, strict=True))
        for value, (i, j) in zip(tau, ENTRIES[self.dim], strict=True):
            sigma[i, j] = sigma[j, i] = value
        if self.dim == 2:
            sigma[2, 2] = self.call("out_of_plane_stress", state, self.params)
        return sigma / self.call("volume_ratio", state)

    def stiffness(self):
        """Modulus of waves in the present state, Pa: what stresses are measured by."""
        try:
            modulus = self.density * self.call("wave_speed_squared", self.state, self.params, self.density)
        except (ArithmeticError, ValueError):
            return 0.0
        return modulus if math.isfinite(modulus) else 0.0

    def attempt(self, G, dt):
        """Where the increment G = dt grad v leads; the point stays where it is."""
        try:
            state = self.call("advance", self.state, tuple(map(float, np.ravel(G))), dt, self.params)
            if self.call("valid", state):
                sigma = self.cauchy_stress(state, G / dt)
                return Trial(G, state, sigma, self.call("volume_ratio", state), True)
        except (ArithmeticError, ValueError):  # plain Python complains where numbers of the kernels become inf or nan
            state = (math.nan,) * len(self.state)
        return Trial(G, state, np.full((3, 3), math.nan), math.nan, False)

    def accept(self, trial, dt):
        """Go where a trial leads. Raises PathEnds where the law calls that state wrong."""
        if not trial.is_valid:
            raise PathEnds(
                "the material's state is not valid any more: it has been deformed beyond what its law describes"
            )
        self.state, self.sigma = trial.state, trial.sigma
        self.time += dt
        G = np.zeros((3, 3))
        G[: self.dim, : self.dim] = trial.G
        self.strain = self.strain + np.log1p(np.diag(G))
        self.shear = self.shear + G + G.T

    def held_stress(self, held, sigma=None):
        """Mean normal stress along the axes of `held`, Pa."""
        weights = np.array(pattern(held, self.dim))
        sigma = self.sigma if sigma is None else sigma
        return float(weights @ np.diag(sigma)[: self.dim] / weights.sum())

    def row(self, step, strain):
        """Numbers of the present state by name."""
        sigma = self.sigma
        p = -float(np.trace(sigma)) / 3.0
        found = {"step": step, "time": self.time, "strain": strain}
        found |= {f"strain_{AXES[i]}{AXES[i]}": float(self.strain[i]) for i in range(self.dim)}
        pairs = ((0, 1),) if self.dim == 2 else ((0, 1), (1, 2), (0, 2))
        found |= {f"gamma_{AXES[i]}{AXES[j]}": float(self.shear[i, j]) for i, j in pairs}
        found |= {f"stress_{name}": float(sigma[tuple(map(AXES.index, name))]) for name in STRESSES[self.dim]}
        xx, yy, zz = map(float, np.diag(sigma))
        found |= {"p": p, "q": von_mises(xx, yy, zz, *(float(sigma[pair]) for pair in ((0, 1), (1, 2), (0, 2))))}
        found["J"] = self.call("volume_ratio", self.state)
        return found | {name: value for name, value in zip(self.state_names, self.state, strict=True) if name != "J"}


def entry_names(one, dim):
    """A column name for each number of a StateField."""
    symmetric = [AXES[i] + AXES[j] for i, j in ENTRIES[dim]]
    entries = {
        "scalar": [""],
        "vector": list(AXES[:dim]),
        "tensor": [a + b for a in AXES[:dim] for b in AXES[:dim]],
        "symmetric": symmetric,
        "solid": [*symmetric, "zz"] if dim == 2 else symmetric,
        "numbers": list(map(str, range(len(one.rest)))) if isinstance(one.rest, tuple) else [],
    }
    return [f"{one.name}_{entry}".rstrip("_") for entry in entries[one.kind]]


def motion(dim, driven, amount, held=None, free=0.0):
    """G of an increment: `amount` of the driven strain, `free` of the strain along the axes of `held`."""
    logarithms = np.zeros(dim)
    if driven is not None and driven != SHEAR:
        logarithms += amount * np.array(pattern(driven, dim))
    if held is not None:
        logarithms += free * np.array(pattern(held, dim))
    G = np.diag(np.expm1(logarithms))
    if driven == SHEAR:
        G[0, 1] = amount
    return G


def find_root(residual, guess, size, tolerance, coarse):
    """x with |residual(x)| <= tolerance: by growing steps until the sign changes, then by Chandrupatla's method.

    Plasticity makes residuals with corners and flat stretches, which Newton's method does not survive. nan is a place where
    nothing is defined: the search stays away. Where the residual jumps by no more than `coarse`, the nearer side will do.
    Source: T. R. Chandrupatla, Adv. Eng. Softw. 28 (1997) 145.
    """
    start = residual(guess)
    if math.isnan(start) and guess != 0.0:
        guess = 0.0
        start = residual(guess)
    if math.isnan(start):
        raise Unreachable("the state is not valid where the search for the free strain begins")
    if abs(start) <= tolerance:
        return guess
    seen = [start]
    for direction in (-math.copysign(1.0, start), math.copysign(1.0, start)):
        a, fa, step = guess, start, size
        for _ in range(EXPANSIONS):
            b = a + direction * step
            if abs(b) > FARTHEST or step < EPS * abs(a):
                break
            fb = residual(b)
            if math.isnan(fb):
                step *= 0.25
                continue
            if abs(fb) <= tolerance:
                return b
            if (fb > 0.0) != (fa > 0.0):
                return refine(residual, a, fa, b, fb, tolerance, coarse)
            seen.append(fb)
            a, fa, step = b, fb, 2.0 * step
    raise Unreachable(f"it misses the aim by {min(seen):.6g} to {max(seen):.6g} Pa whatever the free strain")


def refine(residual, a, fa, b, fb, tolerance, coarse):
    """The root between a and b, where the residual has two signs."""
    t = 0.5
    for _ in range(REFINEMENTS):
        x = a + t * (b - a)
        fx = residual(x)
        if math.isnan(fx):
            raise Unreachable("the state is not valid between two free strains at which it is")
        if (fx > 0.0) == (fa > 0.0):
            c, fc = a, fa
        else:
            c, fc, b, fb = b, fb, a, fa
        a, fa = x, fx
        best, found = (a, fa) if abs(fa) < abs(fb) else (b, fb)
        if abs(found) <= tolerance:
            return best
        least = 2.0 * EPS * abs(best) / abs(b - c) if b != c else 1.0
        if least > 0.5 or abs(b - a) <= 4.0 * EPS * abs(best):
            break
        xi, phi = (a - b) / (c - b), (fa - fb) / (fc - fb) if fc != fb else 1.0
        t = 0.5
        if phi * phi < xi and (1.0 - phi) ** 2 < 1.0 - xi:
            t = fa / (fb - fa) * fc / (fb - fc) + (c - a) / (b - a) * fa / (fc - fa) * fb / (fc - fb)
        t = min(1.0 - least, max(least, t))
    if abs(found) <= coarse:
        return best
    raise Unreachable(f"it jumps from {min(fa, fb):.6g} to {max(fa, fb):.6g} Pa about the aim at one free strain")


@dataclass
class Control:
    """A held stress: along the axes of `held`, and what is remembered of the last increment to begin the next search."""

    held: str
    ratio: float = 0.0
    last: float = 0.0


def advance(point, driven, amount, dt, control=None, aims=(0.0, 0.0), halvings=HALVINGS):
    """Advance the point by an increment; the held stress goes from aims[0] to aims[1]. Raises PathEnds.

    What cannot be done in one step is tried in two halves, and they in theirs.
    """
    if control is None:
        point.accept(point.attempt(motion(point.dim, driven, amount), dt), dt)
        return
    held, stiffness = control.held, point.stiffness()
    tolerance = PRECISION * abs(aims[1]) + ROUNDING * stiffness

    def residual(free):
        trial = point.attempt(motion(point.dim, driven, amount, held, free), dt)
        return point.held_stress(held, trial.sigma) - aims[1]

    guess = control.ratio * amount if driven else control.last
    size = max(0.1 * abs(amount), abs(guess), 1e-8)
    try:
        free = find_root(residual, guess, size, tolerance, JUMP * stiffness)
    except Unreachable as unreachable:
        if halvings == 0:
            place = {VOLUME: "the mean normal stress", NORMAL: "stress_yy"}.get(held, "the stress across")
            raise PathEnds(f"{place} cannot be held at {aims[1]:.6g} Pa: {unreachable}") from None
        middle = 0.5 * (aims[0] + aims[1])
        for part in ((aims[0], middle), (middle, aims[1])):
            advance(point, driven, 0.5 * amount, 0.5 * dt, control, part, halvings - 1)
        return
    control.last, control.ratio = free, free / amount if amount else 0.0
    point.accept(point.attempt(motion(point.dim, driven, amount, held, free), dt), dt)


def consolidate(point, pressure, rate):
    """Bring the point to an isotropic pressure, slowly, by equal strains along all axes; strains count from there.

    Pressure here is minus the mean of the normal stresses along the scene's axes. Raises PathEnds.
    """
    control, first = Control(VOLUME), point.held_stress(VOLUME)
    for n in range(CONSOLIDATION_STEPS):
        aims = tuple(first + (-pressure - first) * part / CONSOLIDATION_STEPS for part in (n, n + 1))
        advance(point, None, 0.0, 1.0 / rate, control, aims)
    point.sigma = point.cauchy_stress(point.state, np.zeros((point.dim, point.dim)))
    point.time, point.strain, point.shear = 0.0, np.zeros(3), np.zeros((3, 3))


def drive(point, path, strains, rate, pressure=None):
    """Drive a point along one of paths.PATHS to each of `strains` in turn, at |d strain / dt| = rate (1/s)."""
    record, number, at = Record(ROUNDING * point.stiffness()), 0, 0.0
    control = Control(path.held) if path.held else None
    aim = -(pressure or 0.0)
    try:
        if pressure is not None or control and abs(point.held_stress(VOLUME)) > record.rounding:
            consolidate(point, pressure or 0.0, rate)
        record.add(point.row(0, 0.0))
        for number, strain in enumerate(strains, 1):  # noqa: B007
            advance(point, path.driven, strain - at, abs(strain - at) / rate, control, (aim, aim))
            at = strain
            record.add(point.row(number, strain))
    except PathEnds as end:
        record.failure = f"step {number}, strain {at:.6g}: {end}" if record.rows else f"under the first pressure: {end}"
    return record


def follow(point, increments, times, rate, pressure=None):
    """Drive a point by given increments G; `times` (s) of each, or None: then |largest entry| / rate.

    The column `strain` sums the Frobenius norms of the increments.
    """
    record, number, length = Record(ROUNDING * point.stiffness()), 0, 0.0
    try:
        if pressure is not None:
            consolidate(point, pressure, rate)
        record.add(point.row(0, 0.0))
        for number, G in enumerate(increments, 1):
            dt = times[number - 1] if times is not None else float(np.abs(G).max()) / rate or 1.0 / rate
            point.accept(point.attempt(G, dt), dt)
            length += float(np.linalg.norm(G))
            record.add(point.row(number, length))
    except PathEnds as end:
        record.failure = f"step {number}: {end}" if record.rows else f"under the first pressure: {end}"
    return record
