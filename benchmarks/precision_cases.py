"""The cases of benchmarks/work_precision.py as scenes, and as plain numbers for the peers.

Steps are fixed, `cfl` times dx / (c sqrt(d)) with the wave speed c at rest, so that all codes take the same ones. Where
waves get much faster (fluid, column, sand) `cfl` is that of the scene, and follows them.
"""

import math
from dataclasses import dataclass

import numpy as np
from cases import bar, column, mms, vortex
from peers.problem import Problem, Vortex, Waves

import pmpm

WAVES = {"waves 2-D": mms.AxisAligned(2, 2), "waves 3-D": mms.AxisAligned(3, 3)}
VORTEX = vortex.Vortex(0.1)
FLUID = mms.AxisAligned(2, 2, law="fluid")
COLUMN = column.STIFF["neo_hookean"]
SAND_WIDTH = 0.1  # m, of the column that collapses
QUANTILES = 200
STABLE = 0.9  # of dx / (c sqrt(d)) with c at rest: a longer step is beyond the bound at some time


@dataclass(frozen=True)
class Fixed:
    """What a case with fixed steps is measured by: wave speed at rest (m/s), end (s), cells per metre for each of a point."""

    wave_speed: float
    end: float
    cells_per_metre: float = 1.0


def wave_speed(mu, lam, density):
    return math.sqrt((lam + 2.0 * mu) / density)


def vortex_moduli():
    nu = vortex.POISSON_RATIO
    return vortex.SHEAR_MODULUS, 2.0 * vortex.SHEAR_MODULUS * nu / (1.0 - 2.0 * nu)


FIXED = {name: Fixed(wave_speed(*case.moduli, mms.DENSITY), case.period) for name, case in WAVES.items()}
FIXED |= {"vortex": Fixed(wave_speed(*vortex_moduli(), vortex.DENSITY), vortex.END)}
FIXED |= {"bar": Fixed(bar.WAVE_SPEED, 4.0 * bar.LENGTH / bar.WAVE_SPEED, 1.0 / bar.LENGTH)}


def dim(case):
    return 3 if case == "waves 3-D" else 2


def steps(point):
    """How many steps a point takes where they are fixed, else None."""
    if point.case not in FIXED:
        return None
    fixed = FIXED[point.case]
    per_metre = fixed.cells_per_metre * point.cells
    return math.ceil(fixed.end * fixed.wave_speed * math.sqrt(dim(point.case)) * per_metre / point.cfl)


def expected_steps(point):
    """`steps`, or about as many where they follow the waves."""
    if point.code == "kratos":
        return int(point.transfer.split()[-1])
    per_cell = {"fluid": 1.8, "column": 12.0, "sand": 125.0}  # at cfl = 1
    return steps(point) or math.ceil(per_cell[point.case] * point.cells / point.cfl)


def particles(point):
    """About how many."""
    cells = point.cells ** dim(point.case)
    if point.case in ("bar", "column"):
        cells = 3 * point.cells
    if point.case == "vortex":
        cells *= math.pi * (vortex.OUTER**2 - vortex.INNER**2)
    return round(cells) * point.per_direction ** dim(point.case)


# ---- scenes ----------------------------------------------------------------------------------------------------------------


def scene(point):
    method = {"transfer": point.transfer, "shape_function": point.degree, "precision": point.precision}
    if point.blend is not None:
        method["flip_blend"] = point.blend
    built = SCENES[point.case](point)
    method |= {"damping": built.method.damping}
    if point.case not in FIXED:
        return changed(built, method=method, time=times(built) | {"cfl": point.cfl})
    time = {"end": built.time.end, "step": built.time.end / steps(point)}
    return changed(built, method=method, time=time | ({"force_step": True} if point.cfl > STABLE else {}))


def waves(point):
    return WAVES[point.case].scene(point.cells, per_axis=point.per_direction)


def ring(point):
    return VORTEX.scene(point.cells, particles_per_cell=point.per_direction**2)


def fluid(point):
    return FLUID.scene(point.cells, per_axis=point.per_direction, cfl=point.cfl)


def ringing(point):
    return with_particles(bar.ringing(point.cells, periods=1.0), point)


def settling(point):
    return with_particles(column.scene(COLUMN, point.cells), point)


def sand(point):
    built = pmpm.Scene.builtin("column_collapse")
    return changed(
        with_particles(built, point), domain=built.domain.model_dump() | {"cell_size": SAND_WIDTH / point.cells}
    )


def with_particles(scene, point):
    """A scene of one body with the particles per cell of a point."""
    (body,) = scene.bodies
    keys = {name: getattr(body, name) for name in body.model_fields_set}
    return changed(scene, bodies=[keys | {"particles_per_cell": point.per_direction ** dim(point.case)}])


def times(scene):
    return {"end": scene.time.end, "ramp": scene.time.ramp}


def changed(scene, **tables):
    """A scene with other tables in the place of its own."""
    return pmpm.Scene(**({name: getattr(scene, name) for name in scene.model_fields_set} | tables))


SCENES = {
    "waves 2-D": waves,
    "waves 3-D": waves,
    "vortex": ring,
    "bar": ringing,
    "fluid": fluid,
    "column": settling,
    "sand": sand,
}


# ---- errors ----------------------------------------------------------------------------------------------------------------


def watch(point, simulation, observations):
    """Have errors taken about so many times during a run that has not begun; returns what gives them by name at its end."""
    if point.case == "sand":
        return lambda: {"quantiles": quantiles(simulation)}
    if point.case == "column":
        return lambda: static_errors(column.errors(simulation, COLUMN))
    errors = pmpm.Errors(simulation)
    simulation.every(errors, steps=max(1, expected_steps(point) // observations), at_start=True)
    return lambda: errors_so_far(errors, simulation)


def static_errors(found):
    return {"e_u": found["e_y"], "e_end": found["e_y"], "e_stress": found["stress"]}


def errors_so_far(errors, simulation):
    errors(simulation)
    names = {"displacement": "e_u", "velocity": "e_v", "deformation": "e_F", "J": "e_J"}
    found = {names[key]: value for key, value in errors.largest.items() if math.isfinite(value)}
    return found | {"e_end": errors.last["displacement"]}


def quantiles(simulation):
    """The x and the y that a part of all sand lies below, QUANTILES of each: where sand is, whoever the particles are."""
    parts = (np.arange(QUANTILES) + 0.5) / QUANTILES
    return [list(map(float, np.quantile(values, parts))) for values in simulation.particles.x.astype(float).T]


def sand_error(found, reference):
    """RMS distance of quantiles from those of a finer run, relative to how far these are from the start."""
    parts = SAND_WIDTH * (np.arange(QUANTILES) + 0.5) / QUANTILES
    off, moved = np.array(found) - reference, np.array(reference) - parts
    return float(np.sqrt(np.sum(off**2) / np.sum(moved**2)))


# ---- for peers -------------------------------------------------------------------------------------------------------------


def problem(point, simulation):
    """What a peer solves: the scene of a simulation that has not begun."""
    particles, dx = simulation.particles, simulation.scene.domain.cell_size
    state = (np.asarray(getattr(particles, name), float) for name in ("X", "x", "v", "F"))
    volume, step = float(particles.volume0[0]), simulation.scene.time.step
    if point.case == "vortex":
        force = Vortex(VORTEX.amplitude, vortex.FREQUENCY, vortex.CENTRE)
        nodes, periodic, moduli, density = (4 * point.cells + 1,) * 2, False, vortex_moduli(), vortex.DENSITY
    else:
        solution = WAVES[point.case]
        force = Waves(solution.amplitudes[0], solution.wave, solution.wave, solution.phases[: simulation.dim])
        nodes, periodic, moduli, density = (point.cells,) * simulation.dim, True, solution.moduli, mms.DENSITY
    return Problem(force, nodes, dx, periodic, *moduli, density, volume, step, *state)
