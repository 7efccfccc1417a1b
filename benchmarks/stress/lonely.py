"""S8: particles with nothing around them: one, two, and a thousand, at rest with noise, in flight, and under tension.

What a lone particle does is a swing of its volume against the affine velocity of its own nodes. Sun, Shinar, Schroeder (2020)
bound its step: dt < 2 / omega, omega^2 = d k c^2 / dx^2 with k = 1/D: 4 for quadratic, 3 for cubic splines; a spline's own
slopes make k depend on the place in the cell, and for linear ones it has no bound.
"""

import math

import numpy as np

from .judge import HIGHEST_ENERGY, energies, follow
from .matrix import Case
from .scenes import box, simulation, solid

CELLS, CELL = 32, 1.0
NOISE, GROWN = 1e-10, 100.0  # of J at the start; as many times as that is growth
STEPS, LOOKS = 10_000, 100
# Of the energy: a lone particle swings with the highest frequency that there is, omega dt = 0.8 at cfl 0.4, and
# (omega dt)^2 / 4 = 0.16 is what the mean over a step leaves of the small swing of symplectic Euler's energy. Swings of 30 % of
# the volume: 0.29, as the same map of one degree of freedom with steps that never change has it, and what is in the first
# steps, whose velocities do not belong to the middle of a step yet. In any case it must not grow.
SWINGING, GROWING = 1.4, 1.05
BEGINNING = 1000  # steps
FLIGHT = np.array([0.02, 0.007])  # of the wave speed
PLACES = {"on a node": 0.0, "in the middle": 0.5, "1e-8 from a node": 1e-8, "1e-12 from a node": 1e-12}
FLUID = {"model": "fluid", "density": 1.0, "sound_speed": 1.0, "tension_cutoff": False}
LAWS = {"solid": solid(density=1.0, youngs_modulus=1.3 * 0.4 / 0.7), "fluid": FLUID}
DUST_SPACING, DUST_ROWS = 5, (40, 25)


def particles(scheme, law, x, size):
    """A particle of a cell's volume at each x (n, 2), in a periodic box of `size` cells."""
    count = len(x)
    run = simulation(
        scheme, size, CELL, [box([0.0, 0.0], [float(count % size[0] or size[0]), -(-count // size[0])], particles_per_cell=1)],
        LAWS[law], periodic=["x", "y"],
    )  # fmt: skip
    run.particles.x = x
    return run


def stretch(run, law, J):
    """Give the particles volume ratios J (n,)."""
    if law == "fluid":
        run.particles.J = J
    else:
        run.particles.F = np.sqrt(J)[:, None, None] * np.eye(2)


def alone(run, law, volume=1.0, velocity=FLIGHT):
    """Follow particles in flight whose volumes are `volume` and noise: what J makes of the noise, and where they fly."""
    noise = NOISE * np.random.default_rng(0).standard_normal(run.rows())
    run.particles.v = np.tile(velocity, (run.rows(), 1))
    stretch(run, law, volume + noise)
    begun = float(np.abs(noise).max())
    worst = [0.0]

    def volumes(run):
        worst[0] = max(worst[0], float(np.abs(run.particles.J - 1.0).max()))

    # What noise alone holds is below the round-off of energies.
    moving, highest = bool(np.any(velocity)), HIGHEST_ENERGY if volume == 1.0 else SWINGING
    first = sum(energies(run))
    found = follow(run, steps=BEGINNING, looks=LOOKS, each=volumes, with_energy=moving, highest=highest)
    if not found.message:
        at_first, now = found.energy, sum(energies(run))
        found = follow(run, steps=STEPS, looks=LOOKS, each=volumes, with_energy=moving, highest=math.inf)
        if moving:
            found.energy *= now / first
            found.claim(found.energy <= GROWING * at_first, "energy from nowhere")
    drift = float(np.abs(run.particles.v - velocity).max())
    found.numbers = {"largest |J - 1|": worst[0], "change of v": drift}
    if volume == 1.0 and not found.message:
        found.claim(worst[0] <= GROWN * begun, "noise of the volume grows")
        found.claim(drift <= 1e-12, "free flight is not straight")
    return found


def single(scheme, variant):
    law, place = variant.split(", ")
    run = particles(scheme, law, np.array([[10.0, 12.0]]) + PLACES[place], [CELLS, CELLS])
    return alone(run, law, velocity=np.zeros(2))


def flying(scheme, variant):
    law, count = variant.split(", ")
    x = np.array([[10.1, 12.3], [20.1, 12.3]])[: 1 if count == "one" else 2]
    return alone(particles(scheme, law, x, [CELLS, CELLS]), law)


def dust(scheme, variant):
    law, state = variant.split(", ")
    columns, rows = DUST_ROWS
    grid = np.stack(np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij"), -1).reshape(-1, 2)
    x = DUST_SPACING * (grid + 0.25) + 1.5 * np.random.default_rng(1).random(grid.shape)
    run = particles(scheme, law, x, [DUST_SPACING * columns, DUST_SPACING * rows])
    return alone(run, law, {"at rest": 1.0, "stretched": 1.3, "compressed": 0.7}[state])


CASES = (
    Case(
        "S8", "single", "a lone particle with a volume ratio of 1 + 1e-10, on, between and next to nodes",
        tuple(f"{law}, {place}" for law in LAWS for place in PLACES), single,
    ),
    Case(
        "S8", "flight", "one particle, and two at 10 cells, in flight through a periodic box",
        tuple(f"{law}, {count}" for law in LAWS for count in ("one", "two")), flying,
    ),
    Case(
        "S8", "dust", "1000 lone particles in flight, at rest (noise of 1e-10), stretched and compressed",
        tuple(f"{law}, {state}" for law in LAWS for state in ("at rest", "stretched", "compressed")), dust,
    ),
)  # fmt: skip
