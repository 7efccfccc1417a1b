"""What stops a run that still computes but makes no sense: time steps that shrink without end, and energy out of nothing.

Particles that are not numbers, turned inside out or out of reach are found in every step by G2P; see kernels.loops.

Energy. Without work from outside the sum of kinetic, strain and potential energy can only fall, but for the error of the
scheme: symplectic Euler lets the energy of a wave swing by omega dt / 2 of itself. An unstable run feeds on that and grows.
Every `guard.interval` steps a kernel sums the energy of the particles; what has been created since the run began is compared
with the most that was in motion and in strain at any time. Sums are whole numbers of a small unit, added over layers
and ranks in any order to the same bits, and arrive some steps later like all reductions. What body force and loads do, P2G
tells; where other work is not known (walls and regions that move, gravity along a periodic axis) nothing is summed.
"""

import numpy as np

from pmpm import estimate, failure
from pmpm.physics.materials import law_of
from pmpm.timestep import BOUNDS, LAG, Pending

CRAWL = 1e-4  # of the step at the start: snow of xi = 10 crushed to nothing has waves exp(xi / 2) = 150 times as fast
UNITS = 2.0**36  # in M c^2, M the mass of all particles and c their fastest wave at rest, or their speed at the start
# Units of all layers together; a layer's part of it also stands for an energy that is not a number.
MOST = 2**61
NOISE = 1e-6  # of M c^2 that may always be created: strains of 1e-3
BEYOND_INTERVAL = 8  # steps, of those that are longer than the stable one
KINETIC, STRAIN, POTENTIAL, WORK = range(4)


# ---- time steps that shrink without end ------------------------------------------------------------------------------------


def smallest_step(scene, needs, tables):
    """The step in s below which a run stops."""
    told = scene.time.smallest_step
    if told is not None or scene.time.step is not None:
        return told or 0.0
    return CRAWL * estimate.first_step(scene, needs, tables)


def stop_crawling(simulation, driven):
    """Raise NumericalFailure on all ranks, naming what makes the step so short, and the particle that does."""
    control, given = simulation.control, simulation.scene.time.smallest_step is not None
    bounds, (speed, wave, gradient, force) = control.bounds(driven), control.recent
    allowed = (control.cfl * bounds[0], *bounds[1:])
    kind = BOUNDS[int(np.argmin(allowed))]
    why = {
        "waves": f"waves run at {wave:.4g} m/s through material as stiff, compressed or stretched as it is",
        "speed": f"particles move at {speed:.4g} m/s",
        "acceleration": f"gravity, loads and body force reach {driven + force:.4g} m/s2",
        "strain": f"particles are strained at a rate of {gradient:.4g} 1/s",
    }[kind]
    floor = "time.smallest_step" if given else f"time.smallest_step (not given: {CRAWL:g} of the first step)"
    cause = f"the stable step, {min(allowed):.4g} s, is below {floor} = {simulation.smallest_step:.4g} s: {why}"
    of_particles = [
        {"waves": d.wave_speed_squared, "strain": d.strain_rate}.get(kind, d.speed)()
        for d in simulation.derived(np.float64)
    ]
    failure.stop_at_largest(simulation, of_particles, cause)


# ---- energy out of nothing -------------------------------------------------------------------------------------------------


def unknown_work(scene):
    """What does work on the particles that nobody adds up, as a text; None if there is nothing such."""
    gravity = scene.domain.gravity
    periodic = [axis for axis, pull in zip("xyz", gravity, strict=False) if pull and axis in scene.domain.periodic]
    moving = [face for face, wall in scene.domain.walls.items() if wall.velocity is not None]
    found = {
        "motions": bool(scene.motions),
        "colliders that move": any(collider.moves for collider in scene.colliders),
        "inflows": bool(scene.inflows),
        f"the moving wall {' and '.join(moving)}": bool(moving),
        f"gravity along the periodic axis {' and '.join(periodic)}": bool(periodic),
        "a law that tells no energy": any(tells_no_energy(material) for material in scene.materials.values()),
    }
    return ", ".join(name for name, there in found.items() if there) or None


def tells_no_energy(material):
    return law_of(material.model).choices(material.parameters).get("KNOWS_ENERGY") is False


def watches_energy(scene):
    return scene.guard.energy_gain > 0.0 and unknown_work(scene) is None


class EnergyWatch:
    """Sums the energy of all particles now and then, and says when it has grown out of nothing."""

    def __init__(self, simulation):
        scene = simulation.scene
        self.flow = simulation.flow
        self.comm, self.interval, self.allowed = simulation.comm, scene.guard.interval, scene.guard.energy_gain
        by_waves = estimate.stable_bounds(scene, simulation.needs, simulation.tables)[0]
        self.wave = scene.domain.cell_size / by_waves or 1.0  # m/s; a medium without waves has no unit of its own
        self.most = MOST // simulation.geometry.layers
        self.pending: Pending | None = None
        self.unit, self.first, self.active = 0.0, 0, 0
        self.work = 0  # units that body force and loads have put into the layers of this rank

    def begin(self, measured):
        """Count from a state of which `Simulation.measure` has told this."""
        self.unit = measured["mass"] * max(self.wave, measured["max_speed"]) ** 2 / UNITS
        found = [self.in_units(measured[name]) for name in ("kinetic", "strain", "potential")]
        self.pending, self.first, self.active = None, int(sum(found)), int(found[KINETIC] + found[STRAIN])
        self.first -= self.net_flow()
        self.work = 0

    def net_flow(self):
        """Units that have come in, less those that have left through open faces."""
        return int(self.in_units(self.flow.net_energy)) if self.flow else 0

    def in_units(self, joules):
        """Whole numbers of units, no more than fit; what is not a number counts as the most."""
        with np.errstate(all="ignore"):
            units = np.rint(np.divide(joules, self.unit))
        return np.where(np.isfinite(units), np.clip(units, -self.most, self.most), self.most).astype(np.int64)

    def sums(self, simulation):
        """(4,) int64 kinetic, strain and potential energy of this rank's particles, and the work done on them, in units; what
        flows in or out counts as work."""
        work = self.work + (self.net_flow() if self.comm.rank == 0 else 0)
        return np.append(self.in_units(simulation.energies()).sum(axis=0), work)

    def note_work(self, works):
        """Add (layers,) J that have been put into this rank's layers in a step."""
        units = float(np.rint(works / self.unit).sum())
        self.work += int(units) if abs(units) < self.most else 0

    def due(self, simulation):
        """Whether to sum after this step: more often where it was longer than the stable one, by the scene's own wish."""
        beyond = simulation.dt > simulation.control.shortest
        interval = min(self.interval, BEYOND_INTERVAL) if beyond else self.interval
        return self.pending is None and simulation.step_count % interval == 0

    def after(self, simulation):
        """Look after a step: collect what was started LAG steps ago, and start anew when it is due. Collective."""
        step = simulation.step_count
        if self.pending is not None and step >= self.pending.step + LAG:
            counted, self.pending = self.pending, None
            self.judge(simulation, counted.step, counted.arrived(self.comm))
        if self.due(simulation):
            self.pending = Pending(step, handle=self.comm.start_sum(self.sums(simulation)))

    def last_look(self, simulation):
        """Judge the state at the end, however few steps there were. Collective."""
        measured = simulation.measure()
        found = [int(self.in_units(measured[name])) for name in ("kinetic", "strain", "potential")]
        self.judge(simulation, simulation.step_count, np.array([*found, self.all_work() + self.net_flow()], np.int64))

    def all_work(self):
        """Units that body force and loads have put into all particles. Collective."""
        return int(self.comm.sum(np.array([self.work], np.int64))[0])

    def judge(self, simulation, step, sums):
        """Raise NumericalFailure on all ranks if the sums of a step hold energy out of nothing."""
        self.active = max(self.active, int(sums[KINETIC] + sums[STRAIN]))
        created = int(sums[KINETIC] + sums[STRAIN] + sums[POTENTIAL] - sums[WORK]) - self.first
        if created <= self.allowed * self.active + NOISE * UNITS:
            return
        cause = (
            f"the energy of all particles had grown by {created * self.unit:.4g} J out of nothing by step {step}, more than "
            f"guard.energy_gain = {self.allowed:g} of the {self.active * self.unit:.4g} J in motion and strain: the run is "
            "unstable, and this particle holds most of it"
        )
        totals = [d.totals(simulation.drive.gravity) for d in simulation.derived(np.float64)]
        failure.stop_at_largest(simulation, [found["kinetic"] + found["strain"] for found in totals], cause)

    def state(self):
        """What the next decisions depend on, as plain numbers. Collective."""
        pending = self.pending and [self.pending.step, *map(int, self.pending.arrived(self.comm))]
        return {
            "unit": self.unit,
            "first": self.first,
            "active": self.active,
            "work": self.all_work(),
            "pending": pending,
        }

    def resume(self, state):
        """Go on from what `state` gave."""
        self.unit, self.first, self.active = state["unit"], state["first"], state["active"]
        self.work = state["work"] if self.comm.rank == 0 else 0
        pending = state["pending"]
        self.pending = pending and Pending(pending[0], values=np.array(pending[1:], np.int64))
