"""What each law costs: alone on lanes, and as part of a whole step, beside the neo-Hookean solid.

    python benchmarks/laws.py [--docs docs] [--laws LABEL ...] [--quick]

Needs one core and 2 GB, and the extra `viz` for --docs; takes under 6 minutes with an empty cache of kernels, most of which is
compiling. A block of 30^3 cells of one material, 8 particles per cell at random places, is sheared with the same increment of
strain in every step. Each law takes turns with the neo-Hookean solid, a turn being a few steps from the same particles, so
that ratios are of times taken within the same second; times are processor time. With --docs it writes results/laws.md and
pictures/laws.png there. Exits with 1 where a law makes the step more than MOST times the neo-Hookean one and no reason is
stated in REASONS. --quick is for work on this file: a block of 12^3 cells and two rounds, which judges and writes nothing.
"""

import argparse
import statistics
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

import laws_page
import machine
import numpy as np
from stages import Progress

import pmpm
from pmpm.kernels import targets
from pmpm.kernels.lane_loops import FIELD_TUPLES, put
from pmpm.kernels.lanes import flush_denormals, in_all_lanes, restore_denormals
from pmpm.kernels.needs import law_needs
from pmpm.physics import hencky, stability
from pmpm.physics import tensors3 as la
from pmpm.physics.materials import neo_hookean as law
from pmpm.physics.words import exp, log, where
from pmpm.scene.materials import material
from pmpm.state.fields import Layout

PRECISIONS = ("float32", "float64")
REFERENCE = "neo_hookean"
MOST = 2.2  # times the neo-Hookean step
CELLS, QUICK_CELLS, MARGIN = 30, 12, 5  # of the block along each axis, and around it
CELL_SIZE = 1.0 / 40.0
ROUNDS, QUICK_ROUNDS = 9, 2
WARMING, STEPS = 1, 4  # of a turn
CFL = 0.05  # so short that stresses, which differ from particle to particle, hardly change the motion
# Velocity gradient times dt: a shear with some rotation and no change of volume.
FLOW = 2e-3 * np.array([[0.25, 1.0, 0.125], [-0.375, -0.125, 0.5], [0.0, 0.25, -0.125]])
COMPRESSION, NOISE = 0.01, 0.003  # of the strain along each axis at the start
SLIGHT = 0.1  # part of the strain and of the noise in which nothing yields
SOLID_NOISE = 0.03  # of laws that do not yield
LOADING = 40  # steps by FLOW, forwards for half of the particles and backwards for the others, before the start
DIFFERENT = 2048  # states, of which each particle takes one
BLOCKS, LOOPS = 64, 100  # of the law alone: 1024 particles, which stay in the caches

ELASTIC = {"density": 1500.0, "youngs_modulus": 1.0e5, "poisson_ratio": 0.3}
SAND = {"model": "drucker_prager", **ELASTIC, "friction_angle": 35.0}
SOIL = {"model": "mohr_coulomb", **ELASTIC, "cohesion": 500.0, "friction_angle": 25.0}
SOFTENING = {"residual_cohesion": 50.0, "residual_friction_angle": 15.0, "softening_strain": 0.5}
STEEL = {"model": "von_mises", **ELASTIC, "yield_stress": 1000.0}
CLAY = {
    "model": "cam_clay",
    "density": 1800.0,
    "shear_modulus": 1.6e6,
    "swelling_index": 0.03,
    "compression_index": 0.08,
    "critical_state_slope": 0.9,
    "preconsolidation_pressure": 2.0e5,
}
MUD = {"model": "bingham", "density": 1000.0, "bulk_modulus": 1.0e4, "shear_modulus": 1.0e3, "yield_stress": 10.0}
WATER = {"model": "fluid", "density": 1000.0, "bulk_modulus": 1.0e4}


def stress_of_my_own(F, mu, lam):
    """Neo-Hookean, as a user would write it."""
    return la.scale_plus_diagonal(mu, la.left_cauchy_green(F), lam * log(la.det(F)) - mu)


def damaged_stress(F, damage, mu, lam, strength):
    return la.scale_plus_diagonal(1.0 - damage, stress_of_my_own(F, mu, lam), 0.0)


def grow_damage(F, G, dt, damage, mu, lam, strength):
    F = la.add(F, la.matmul(G, F))
    load = mu * (la.trace_symmetric(la.left_cauchy_green(F)) - la.DIM) / strength
    return F, max(damage, 1.0 - exp(-max(load, 0.0)))


BREAKING = pmpm.Law(damaged_stress, advance=grow_damage, state={"damage": 0.0}, name="breaking")
OWN = {"density": 1500.0, "mu": 4.0e4, "lam": 6.0e4}
# Label -> keys of a material. Strengths are such that particles yield at strains of about 1 %.
MATERIALS = {
    "neo_hookean": {"model": "neo_hookean", **ELASTIC},
    "law of your own, a function": {"model": stress_of_my_own, **OWN},
    "law of your own, with damage": {"model": BREAKING, **OWN, "strength": 1.0e5},
    "fixed_corotated": {"model": "fixed_corotated", **ELASTIC},
    "hencky": {"model": "hencky", **ELASTIC},
    "fluid": {**WATER, "gamma": 7.0},
    "fluid, gamma 1": {**WATER, "gamma": 1.0},
    "fluid, viscous": {**WATER, "gamma": 7.0, "viscosity": 0.1},
    "von_mises": STEEL,
    "von_mises, hardening": {**STEEL, "hardening_modulus": 1.0e3},
    "drucker_prager": SAND,
    "drucker_prager, cohesion, dilatancy": {**SAND, "cohesion": 200.0, "dilatancy_angle": 5.0},
    "mohr_coulomb": SOIL,
    "mohr_coulomb, softening": {**SOIL, **SOFTENING},
    "mohr_coulomb, softening, dilatancy": {**SOIL, **SOFTENING, "dilatancy_angle": 5.0},
    "cam_clay": {**CLAY, "initial_pressure": 1.0e5},
    "cam_clay, attraction": {**CLAY, "initial_pressure": 1.0e5, "attraction": 1.0e4},
    "snow": {"model": "snow", **ELASTIC},
    "snow, capped": {"model": "snow", **ELASTIC, "largest_hardening": 2.0},
    "mu_i": {
        "model": "mu_i",
        **ELASTIC,
        "static_friction": 0.38,
        "dynamic_friction": 0.64,
        "grain_diameter": 1e-3,
        "grain_density": 2500.0,
    },
    "bingham": {**MUD, "viscosity": 0.5},
    "bingham, thinning": {**MUD, "viscosity": 2.0, "flow_index": 0.5},
    "bingham, thickening": {**MUD, "viscosity": 0.1, "flow_index": 1.5},
}
# Why a law is dearer than MOST says.
REASONS: dict[str, str] = {}

# What stands here is replaced by each target.
load_state = load_gradient = STATE_SIZE = VISCOUS = real = None


def law_alone(states, gradients, times, dt, inv_dx, params, density, advanced, stresses):
    """The law's part of `times` P2G and G2P of all blocks; the largest wave speed squared of valid particles in `advanced[0]`.

    The results lie behind each other, from the second block on.
    """
    before = flush_denormals()
    waves = in_all_lanes(real(0.0))
    for _ in range(times):
        for k in range(len(states) // (16 * STATE_SIZE)):
            G = load_gradient(gradients, 144 * k)
            state = law.advance(load_state(states, 16 * STATE_SIZE * k), G, dt, params)
            put(advanced, 16 + 16 * STATE_SIZE * k, state)
            tau = law.kirchhoff_stress(state, params)
            if VISCOUS:
                tau = la.add_symmetric(tau, law.viscous_stress(state, la.scale(1.0 / dt, G), params))
            put(stresses, 96 * k, tau)
            wave = stability.signal_speed_squared(state, params, density, inv_dx)
            waves = max(waves, where(law.valid(state), wave, real(0.0)))
    put(advanced, 0, (waves,))
    restore_denormals(before)


@dataclass
class Timing:
    """What one law takes in one precision, in ns per particle, one entry per round; `ratios` to the reference beside it."""

    alone: list = field(default_factory=list)  # half of the particles yielding
    at_rest: list = field(default_factory=list)
    steps: list = field(default_factory=list)
    ratios: list = field(default_factory=list)
    yielding: float | None = None  # fraction of the particles, None of laws that do not
    state_bytes: int = 0
    particles: int = 0

    def step(self):
        return statistics.median(self.steps)

    def ratio(self):
        return statistics.median(self.ratios)


def timed(function, *arguments):
    """Seconds of processor time."""
    began = time.process_time()
    function(*arguments)
    return time.process_time() - began


class Case:
    """A law of MATERIALS in one precision: a block of it that can be brought back to its start, and its law alone."""

    def __init__(self, label, precision, cells):
        self.label, self.real = label, np.dtype(precision).type
        self.material = material(MATERIALS[label]).complete(3)
        self.needs = law_needs(self.material.model, self.material.parameters)
        self.layout = Layout.of(self.needs, 3)
        self.words = {"la": la, "law": self.needs.module, **dict(self.needs.choices)}
        self.params = self.needs.module.parameters(self.material.parameters, 3)
        self.density = self.material.parameters["density"]
        self.random = np.random.default_rng(0)
        arrays = targets.arrays(np.float64, **self.words)
        self.state_at, self.law_advance = (
            arrays.compile(getattr(self.needs.module, name)) for name in ("state_at", "advance")
        )
        self.dt = CFL * CELL_SIZE / (np.sqrt(3.0) * self.wave_speed(arrays))
        self.set_law_alone()
        self.set_block(cells)

    # ---- states ----

    @property
    def yields(self):
        """Whether the law keeps an elastic strain that it may return to a yield surface."""
        return self.material.model != "hencky" and self.layout.state[0].name in ("elastic_strain", "hencky_strain")

    def states(self, count, noise, loading, compression=COMPRESSION):
        """(fields, count) states after some steps by FLOW."""
        spread = noise * self.random.standard_normal((count, 3, 3))
        strain = -compression * np.eye(3) + 0.5 * (spread + spread.transpose(0, 2, 1))
        values, axes = np.linalg.eigh(strain)
        F = np.einsum("nij,nj,nkj->nik", axes, np.exp(values), axes)
        state = self.state_at(tuple(F.reshape(count, 9).T.copy()), self.params)
        way = np.where(self.random.random(count) < 0.5, -1.0, 1.0)
        for _ in range(loading):
            state = self.law_advance(state, tuple(g * way for g in FLOW.ravel()), self.dt, self.params)
        return np.stack(np.broadcast_arrays(*state))

    def wave_speed(self, arrays):
        """m/s of states to start from."""
        self.dt = 1e-4
        state = tuple(self.states(64, NOISE, 0))
        squared = arrays.compile(self.needs.module.wave_speed_squared)(state, self.params, self.density)
        return float(np.sqrt(np.max(squared)))

    def in_use(self):
        """Particles after loading, of which half are loaded on and half are unloaded."""
        return self.states(DIFFERENT, NOISE if self.yields else SOLID_NOISE, LOADING if self.yields else 0)

    # ---- the law alone ----

    def set_law_alone(self):
        size = self.layout.size - self.layout.state_first
        words = {
            "load_state": FIELD_TUPLES[size],
            "load_gradient": FIELD_TUPLES[9],
            "STATE_SIZE": size,
            "VISCOUS": False,
        }
        self.kernel = targets.lanes(self.real, **(words | self.words)).entry(law_alone)
        count = 16 * BLOCKS
        self.start_alone = in_blocks(self.in_use()[:, :count], self.real)
        self.rest_alone = in_blocks(self.states(count, SLIGHT * NOISE, 0, SLIGHT * COMPRESSION), self.real)
        gradients = FLOW.ravel()[:, None] * self.random.uniform(0.9, 1.1, (1, count))
        self.gradients = in_blocks(gradients, self.real)
        self.advanced = np.zeros(16 + size * count, self.real)
        self.stresses = np.zeros(6 * count, self.real)

    def run_alone(self, states, gradients, times):
        params, inv_dx = tuple(map(self.real, self.params)), self.real(1.0 / CELL_SIZE)
        numbers = self.real(self.dt), inv_dx, params, self.real(self.density)
        self.kernel(states, gradients, times, *numbers, self.advanced, self.stresses)

    def time_alone(self, timing, times):
        for states, gradients, found in (
            (self.start_alone, self.gradients, timing.alone),
            (self.rest_alone, self.real(SLIGHT) * self.gradients, timing.at_rest),
        ):
            self.run_alone(states, gradients, 1)
            found.append(1e9 * timed(self.run_alone, states, gradients, times) / (16 * BLOCKS * times))

    # ---- the whole step ----

    def set_block(self, cells):
        low, high = MARGIN * CELL_SIZE, (MARGIN + cells) * CELL_SIZE
        box = {"type": "box", "min": [low] * 3, "max": [high] * 3}
        self.simulation = simulation = pmpm.Simulation(
            pmpm.Scene(
                domain={"size": [(cells + 2 * MARGIN) * CELL_SIZE] * 3, "cell_size": CELL_SIZE},
                method={"precision": np.dtype(self.real).name, "transfer": "mls"},
                time={"end": 1e6},
                materials={"block": MATERIALS[self.label]},
                bodies=[{"material": "block", "shape": box, "particles_per_cell": 8}],
            )
        )
        count = simulation.rows()
        simulation.particles.x = low + (high - low) * self.random.random((count, 3))
        (population,), (layout,) = simulation.populations, simulation.layouts
        gradient = FLOW / self.dt
        states, chosen = self.in_use(), self.random.integers(0, DIFFERENT, count)
        population.set_rows(layout.where("v"), (simulation.particles.x - 0.5 * (low + high)) @ gradient.T)
        population.set_rows(layout.where("C"), np.broadcast_to(gradient.ravel(), (count, 9)))
        population.set_rows(slice(layout.state_first, layout.size), states[:, chosen].T)
        self.saved = population.reals.copy(), population.places.copy()
        self.particles = count

    def restart(self):
        population = self.simulation.populations[0]
        population.reals[:], population.places[:] = self.saved

    def steps(self, count):
        """All of Simulation.step but the choice of dt and sorting, which would fall into some turns and not into others."""
        for _ in range(count):
            self.simulation.advance(self.real(self.dt))
            if self.simulation.control.collect() is not None:
                sys.exit(f"{self.label}: a particle has failed: {self.simulation.failure}")

    def turn(self):
        """ns per particle-step."""
        self.restart()
        self.steps(WARMING)
        return 1e9 * timed(self.steps, STEPS) / (self.particles * STEPS)

    def fraction_yielding(self, most=20000):
        """Particles that a step of a turn has left with another elastic strain than their trial one."""
        if not self.yields:
            return None
        self.restart()
        self.steps(WARMING + STEPS - 1)
        name, every = self.layout.state[0].name, max(1, self.particles // most)
        before = getattr(self.simulation.particles, name)[::every]
        self.steps(1)
        after, C = (getattr(self.simulation.particles, n)[::every] for n in (name, "C"))
        trial = targets.arrays(np.float64, la=la).compile(hencky.trial_strain)
        expected = trial(tuple(before.astype(float).T), tuple(self.dt * C.reshape(-1, 9).astype(float).T))
        return float(np.mean(np.abs(after - np.stack(expected, axis=-1)).max(axis=1) > 0.01 * np.abs(FLOW).max()))


def in_blocks(rows, real):
    """(fields, particles) as blocks of 16 particles, flat."""
    return np.ascontiguousarray(rows.reshape(len(rows), -1, 16).swapaxes(0, 1), real).reshape(-1)


def precisions(label):
    """A switch of a law in float32 alone: compiling takes most of the time of this benchmark."""
    return PRECISIONS[:1] if ", " in label else PRECISIONS


def measure(labels, cells, rounds, loops):
    """{(label, precision): Timing}."""
    chosen = {precision: [label for label in labels if precision in precisions(label)] for precision in PRECISIONS}
    found, progress = {}, Progress(sum(map(len, chosen.values())), end=": ")
    for precision in PRECISIONS:
        reference = Case(REFERENCE, precision, cells)
        for label in chosen[precision]:
            progress.tell(f"{precision}, {label}")
            case = reference if label == REFERENCE else Case(label, precision, cells)
            state_bytes = (case.layout.size - case.layout.state_first) * case.real().itemsize
            timing = Timing(state_bytes=state_bytes, particles=case.particles)
            for _ in range(rounds):
                beside, own = reference.turn(), case.turn()
                timing.steps.append(own)
                timing.ratios.append(own / beside)
                case.time_alone(timing, loops)
            timing.yielding = case.fraction_yielding()
            found[label, precision] = timing
            print(f"{timing.step():.1f} ns, {timing.ratio():.2f} times the neo-Hookean step", flush=True)
    return found


def main():
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--laws", nargs="+", choices=list(MATERIALS), default=list(MATERIALS), help="which of them")
    options.add_argument("--quick", action="store_true", help="a small block and two rounds; judges and writes nothing")
    options.add_argument("--docs", type=Path, help="write page and picture here")
    given = options.parse_args()
    if given.docs and (given.quick or list(given.laws) != list(MATERIALS)):
        options.error("--docs wants a full run: neither --quick nor --laws")
    began = time.perf_counter()
    sizes = (QUICK_CELLS, QUICK_ROUNDS, LOOPS // 10) if given.quick else (CELLS, ROUNDS, LOOPS)
    found = measure(given.laws, *sizes)
    minutes = (time.perf_counter() - began) / 60.0
    print(laws_page.tables(found, MOST, REASONS))
    if given.quick:
        return 0
    failed = laws_page.failed(found, MOST, REASONS)
    print("\n".join(f"FAILED: {line}" for line in failed) or "all musts hold")
    if given.docs:
        laws_page.write(given.docs, found, MOST, REASONS, minutes, failed, (machine.processor(), machine.versions()))
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
