"""Follows a run and judges it by its arrays alone, whatever pmpm's own guards say of it.

S, survives: no nan or infinity in anything a particle carries, J > 0 where the law needs it, total energy (see
Watch.compare_energy) never more than 1.05 of that at the start and the work of loads, particles inside the domain (nodes hold
what is half a cell beyond a wall), mass exact. E: it stopped, with a message that names step, time, rank, particle, position,
material and cause, or it was refused before it began. F: all else, such as energy from nowhere, nan, a traceback, a hang, a
number that misses the limit of its case.
"""

import math
import re
from dataclasses import dataclass, field

import numpy as np
from conservation import energy

from pmpm.failure import NumericalFailure

from .matrix import FAILED, STOPPED, SURVIVES

HIGHEST_ENERGY = 1.05
BEYOND = 0.5  # cells
LOOKS = 400  # at the state in a run of a known number of steps, at least every EVERY steps
EVERY = 5
COMPLETE = re.compile(r"step \d+, t = \S+ s")
PARTICLE = re.compile(r"rank \d+: particle \d+ of material .+ at \(.+\) m: .+")


@dataclass
class Found:
    """What came out of a run; `numbers` are those that its case reports, `wrong` what it holds against it."""

    steps: int = 0
    time: float = 0.0
    smallest_dt: float = math.inf
    energy: float | None = None
    beyond: float = 0.0
    wrong: list[str] = field(default_factory=list)
    message: str = ""
    numbers: dict = field(default_factory=dict)

    def claim(self, holds, text):
        """Hold against the run what is not so."""
        if not holds and text not in self.wrong:
            self.wrong.append(text)

    @property
    def verdict(self):
        if self.message and not incomplete(self.message):
            return STOPPED
        return FAILED if self.wrong or self.message else SURVIVES

    def as_dict(self):
        told = {"verdict": self.verdict, "steps": self.steps, "time": self.time, "smallest_dt": self.smallest_dt}
        return told | {
            "energy": self.energy, "beyond": self.beyond, "wrong": self.wrong, "message": self.message,
            "numbers": self.numbers,
        }  # fmt: skip


def incomplete(message):
    """Whether a message leaves open where and why a run stopped."""
    names_particle = "particle" not in message or PARTICLE.search(message)
    return not (message.startswith("refused: ") or (COMPLETE.search(message) and names_particle))


def refused(error):
    """What comes of a run that is refused before it begins."""
    return Found(message=f"refused: {error}")


def energies(simulation):
    """(that of motion, of the affine field too; strain energy and potential energy from where x is zero) in J."""
    measured = simulation.measure()
    return energy(simulation, measured) - measured["strain"], measured["strain"] + measured["potential"]


def masses(simulation):
    """(n, 2) ids and masses, in the order of ids: a total is rounded by layers, and would change as particles change layers."""
    rows = np.stack([simulation.particles.id, simulation.particles.mass], axis=1)
    return rows[np.argsort(rows[:, 0])]


class Watch:
    """Looks at a simulation from time to time. `work`: a function of it, J put in by loads since the step before; `highest`:
    what energy may rise to, of that at the start and the work."""

    def __init__(self, simulation, invertible=False, work=None, with_energy=True, highest=HIGHEST_ENERGY):
        self.simulation, self.invertible, self.work, self.with_energy = simulation, invertible, work, with_energy
        self.highest = highest
        self.found = Found()
        self.masses, self.done = masses(simulation), 0.0
        self.before = None  # of a look in the step before: energies, and what they are compared with
        self.first_energy = self.most = sum(energies(simulation))
        self.look()

    def look(self):
        found, simulation = self.found, self.simulation
        for population, layout in zip(simulation.populations, simulation.layouts, strict=True):
            numbers = population.rows(slice(simulation.dim, layout.size))  # x stands elsewhere
            found.claim(bool(np.isfinite(numbers).all()), "a state is not a number")
        if not self.invertible:
            found.claim(bool((simulation.particles.J > 0.0).all()), "J <= 0")
        self.look_at_places()
        found.claim(np.array_equal(masses(simulation), self.masses), "mass changed")
        if self.with_energy and self.first_energy + self.done > 0.0:
            self.before = (*energies(simulation), self.first_energy + self.done)
            self.most = max(self.most, self.first_energy + self.done)

    def compare_energy(self):
        """Of the state a step ago. Symplectic Euler's velocities belong to the middle of a step: the energy of motion at its
        end is the mean of those before and after, without which the total would swing by omega dt / 2 of itself. Where loads
        take energy back, an excess counts against the most that there has been.
        """
        if self.before is None:
            return
        (motion, stored, allowed), found = self.before, self.found
        held = stored + 0.5 * (motion + energies(self.simulation)[0])
        ratio = 1.0 + (held - allowed) / self.most
        found.energy = ratio if math.isnan(ratio) else max(found.energy or 0.0, ratio)
        found.claim(ratio <= self.highest, "energy from nowhere")
        self.before = None

    def look_at_places(self):
        domain, dx = self.simulation.scene.domain, self.simulation.scene.domain.cell_size
        x = self.simulation.particles.x
        for axis, size in enumerate(domain.size):
            if "xyz"[axis] not in domain.periodic:
                beyond = float(max(-x[:, axis].min(), x[:, axis].max() - size) / dx)
                self.found.beyond = max(self.found.beyond, beyond)
                self.found.claim(beyond <= BEYOND, "a particle is outside the domain")

    def after_step(self):
        found, simulation = self.found, self.simulation
        found.steps, found.time = simulation.step_count, simulation.time
        if not simulation.finished:  # the last step is as short as the end asks for
            found.smallest_dt = min(found.smallest_dt, simulation.dt)
        self.compare_energy()
        if self.work is not None:
            self.done += self.work(simulation)


def follow(simulation, until=None, steps=None, looks=LOOKS, least=EVERY, each=None, **watching):
    """Run to the time `until` (s) or for so many `steps`, whichever comes first, and return what was Found.

    `looks`: about so many, `least` steps apart; `each` is called with the simulation at every one. Other arguments are Watch's.
    """
    watch = Watch(simulation, **watching)
    found, most = watch.found, math.inf if steps is None else steps
    until = simulation.scene.time.end if until is None else until
    every = least if steps is None else max(least, steps // looks)
    try:
        while simulation.step_count < most and simulation.time < until:
            simulation.step()
            watch.after_step()
            if simulation.step_count % every == 0:
                watch.look()
                if each is not None:
                    each(simulation)
        simulation.check()
        watch.look()
        if found.energy is None:  # the energy of motion of the last step has no other to be averaged with
            watch.compare_energy()
    except NumericalFailure as failure:
        found.message = str(failure)
    return found
