"""How well bodies in contact slide, stick and roll, by the slope of their surfaces to the grid, particles and cells; and what
contact costs.

python benchmarks/contact.py [--docs docs]: tables, and docs/results/contact.md. About a minute and a half on one core.
"""

import argparse
import math
import pathlib
import time

import numpy as np
import pages

import pmpm
from pmpm.physics import bspline, contact

G, END = 10.0, 0.4
BASE = {"model": "neo_hookean", "density": 2000.0, "youngs_modulus": 2e7, "poisson_ratio": 0.3}
BLOCK = {"model": "neo_hookean", "density": 1000.0, "youngs_modulus": 1e6, "poisson_ratio": 0.3}
SIDE, EDGE = 0.4, 0.2  # m: of the block, and of the base beneath the foot of the slope
FRICTION = 0.3
ABOUT = """# Contact: how well bodies slide and roll

`{command}` wrote this page. A block of 0.4 m slides down a base whose surface stands at an angle to the grid, with
friction {friction}, for {end} s. From its way follows the friction that it has had, as of a rigid block: way = g t^2
(sin(a) - friction cos(a)) / 2 at an angle a. Its middle also leaves the line
along the slope, by what the surfaces sink into each other or
stand apart: in cells, at the worst of four times. At 0 degrees the axes lie along the slope, and gravity is turned by
30 degrees. At 10 degrees it should stay, which takes a friction of 0.176.

"""
SLOPES = (
    "| slope | particles per cell | cells across the block | splines | friction | way (mm) | off the line (cells) | s |\n"
    "|---|---|---|---|---|---|---|---|"
)
READING = """
What is oblique to the grid has the rough surface of its lattice of particles, of which each node sees another piece, and a
block that slides loses momentum to the steps of the other one. More particles, not finer cells, make that smaller. Why
blocks rub a little less than told elsewhere was not looked into: they are let go at once, and shake.
How far normals are off, root mean
square over {tries} flat surfaces between two lattices, each anywhere, in degrees:

"""
NORMALS = "| slope | 4 particles per cell | 9 | 16 |\n|---|---|---|---|"
ROLLING = """
A disk of radius 1.6 m on a slope of 45 degrees (the built-in scene `rolling_disk`), against a rigid one, after 1.5 s:

"""
DISKS = (
    "| friction | it | cells in the radius | way | turns by, of what a rigid one does | s |\n|---|---|---|---|---|---|"
)
COST = """
What it costs: seconds per step of disks side by side, each of a material of its own, bonded and in contact, the best of
five turns of 40 steps each, taken in turn. Each velocity field has all nodes, and their volumes.

| materials | bonded | in contact | factor |
|---|---|---|---|
"""
TRIES = 1000


def on_slope(degrees, per_cell, cells, splines):
    """(friction, way in m, largest distance from the line in cells, seconds) of a block."""
    angle, turned = math.radians(degrees or 30.0), degrees == 0
    cell = SIDE / cells
    along = np.array([1.0, 0.0] if turned else [math.cos(angle), -math.sin(angle)])
    across = np.array([0.0, 1.0] if turned else [math.sin(angle), math.cos(angle)])
    size = [2.0, 1.0 if turned else 2.0]
    foot = np.array([0.3, EDGE if turned else EDGE + 1.7 * math.tan(angle)])
    corners = [(foot, -across), (foot, -along), (foot + SIDE * along, along), (foot + SIDE * across, across)]
    inside = {"type": "box", "min": [0.0, 0.0], "max": size}
    simulation = pmpm.Simulation(
        pmpm.Scene(
            domain={
                "size": size,
                "cell_size": cell,
                "gravity": [G * math.sin(angle), -G * math.cos(angle)] if turned else [0.0, -G],
                "walls": dict.fromkeys(("x_min", "x_max", "y_min"), "stick"),
            },
            time={"end": END},
            method={"shape_function": splines},
            materials={"base": BASE, "block": BLOCK},
            contact={"friction": FRICTION},
            bodies=[
                body("base", [inside, plane([2.0, EDGE], across)], per_cell),
                body("block", [inside, *(plane(*corner) for corner in corners)], per_cell),
            ],
        )
    )
    began, off = time.perf_counter(), 0.0
    start = middle(simulation)
    for part in range(1, 5):
        simulation.run(until=END * part / 4)
        off = max(off, abs((middle(simulation) - start) @ across) / cell)
    way, free = (middle(simulation) - start) @ along, 0.5 * G * simulation.time**2
    friction = (math.sin(angle) - way / free) / math.cos(angle)
    return friction, way, off, time.perf_counter() - began


def body(material, shapes, per_cell):
    return {
        "material": material,
        "shape": {"type": "intersection", "of": shapes},
        "particles_per_cell": per_cell,
    }


def plane(point, normal):
    return {"type": "plane", "point": list(map(float, point)), "normal": list(map(float, normal))}


def middle(simulation):
    """Of the body with the second material."""
    particles = simulation.particles
    return particles.x[particles.material == 1].mean(axis=0)


def disk(friction, cell):
    """(whether it rolls, way / exact - 1, turn / exact, seconds) of the disk of the built-in scene."""
    scene = pmpm.Scene.builtin("rolling_disk", {"contact.friction": friction, "domain.cell_size": cell})
    simulation = pmpm.Simulation(scene)
    pull, weight = scene.domain.gravity[0], -scene.domain.gravity[1]
    rolls, radius = pull <= 3.0 * friction * weight, scene.bodies[1].shape.radius
    along = 2.0 / 3.0 * pull if rolls else pull - friction * weight
    spin = along / radius if rolls else 2.0 * friction * weight / radius
    start, began, turned, before = middle(simulation), time.perf_counter(), 0.0, 0.0
    while not simulation.finished:
        simulation.run(steps=50)
        turned, before = turned + turning(simulation) * (simulation.time - before), simulation.time
    exact = 0.5 * along * simulation.time**2
    way = (middle(simulation) - start)[0]
    return rolls, way / exact - 1.0, -turned / (0.5 * spin * simulation.time**2), time.perf_counter() - began


def turning(simulation):
    """Mean angular velocity of the disk, rad/s."""
    particles = simulation.particles
    here = particles.material == 1
    x, v = (values[here] - values[here].mean(axis=0) for values in (particles.x, particles.v))
    return float((x[:, 0] * v[:, 1] - x[:, 1] * v[:, 0]).sum() / (x * x).sum())


def normals_off(degrees, per_axis, random):
    """Degrees by which the normal at a node is off: root mean square over flat surfaces near it, between two lattices of
    particles, each anywhere."""
    normal = np.array([math.sin(math.radians(degrees)), math.cos(math.radians(degrees))])
    along = (np.arange(-3 * per_axis, 3 * per_axis) + 0.5) / per_axis
    lattice = np.stack(np.meshgrid(along, along, indexing="ij"), axis=-1).reshape(-1, 2)
    found = []
    for _ in range(TRIES):
        surface, gradients = random.uniform(-0.5, 0.5), []
        for side in (1.0, -1.0):
            x = lattice + random.uniform(-0.5, 0.5, 2)
            gradients.append(gradient(x[side * (x @ normal - surface) < 0.0]))
        n = contact.normal_between(*map(tuple, gradients))
        found.append(math.degrees(math.atan2(n[0] * normal[1] - n[1] * normal[0], n[0] * normal[0] + n[1] * normal[1])))
    return float(np.sqrt(np.mean(np.square(found))))


def gradient(x):
    """(2,) sum of the gradients of the quadratic spline of the node at 0, at places x (n, 2) in cells."""
    total = np.zeros(2)
    for place in x[(np.abs(x) < 1.5).all(axis=1)]:
        of_axes = []
        for u in place:
            centre = math.floor(u + 0.5)
            at = bspline.LOW_QUADRATIC - centre  # of the node at 0 in the stencil of this place
            of_axes.append((bspline.weights_quadratic(u - centre)[at], bspline.slopes_quadratic(u - centre)[at]))
        (w_x, dw_x), (w_y, dw_y) = of_axes
        total += dw_x * w_y, w_x * dw_y
    return total


def cost(materials, turns=5, steps=40):
    """Seconds per step (bonded, in contact) of so many disks of materials of their own, side by side."""
    tables = {f"m{n}": BLOCK for n in range(materials)}
    bodies = [
        {"material": name, "shape": {"type": "sphere", "center": [0.5 + n, 0.5], "radius": 0.4}}
        for n, name in enumerate(tables)
    ]
    domain = {"size": [float(materials), 1.0], "cell_size": 0.025}
    scene = pmpm.Scene(domain=domain, time={"end": 1.0}, materials=tables, bodies=bodies, contact={})
    both = [pmpm.Simulation(one) for one in (scene.model_copy(update={"contact": None}), scene)]
    best = [math.inf, math.inf]
    for _ in range(turns):
        for which, simulation in enumerate(both):
            began = time.perf_counter()
            simulation.run(steps=steps)
            best[which] = min(best[which], (time.perf_counter() - began) / steps)
    return best


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--docs", type=pathlib.Path, help="write the page here")
    options = parser.parse_args()
    lines = [SLOPES]
    cases = [(degrees, per_cell, 8, "quadratic") for degrees in (0, 10, 20, 30, 45) for per_cell in (4, 9, 16)]
    cases += [(30, per_cell, 16, "quadratic") for per_cell in (4, 9)] + [
        (30, per_cell, 8, "cubic") for per_cell in (4, 9)
    ]
    for case in cases:
        friction, way, off, took = on_slope(*case)
        degrees, per_cell, cells, splines = case
        lines.append(
            f"| {degrees} | {per_cell} | {cells} | {splines} | {friction:.3f} | {1e3 * way:.1f} | {off:.2f} | {took:.1f} |"
        )
        print(lines[-1], flush=True)
    random, normals = np.random.default_rng(1), [NORMALS]
    for degrees in (10, 20, 30, 45):
        off = (normals_off(degrees, per_axis, random) for per_axis in (2, 3, 4))
        normals.append(f"| {degrees} | {' | '.join(f'{angle:.1f}' for angle in off)} |")
        print(normals[-1], flush=True)
    disks = [DISKS]
    for friction in (0.495, 0.286):
        for cell in (0.2, 0.1):
            rolls, way, turn, took = disk(friction, cell)
            lying = "rolls" if rolls else "slips"
            disks.append(f"| {friction} | {lying} | {1.6 / cell:.0f} | {way:+.1%} | {turn:.2f} | {took:.1f} |")
            print(disks[-1], flush=True)
    costs = []
    for materials in (2, 4, 8):
        bonded, apart = cost(materials)
        costs.append(f"| {materials} | {bonded:.2e} | {apart:.2e} | {apart / bonded:.1f} |")
        print(costs[-1], flush=True)
    if options.docs:
        about = ABOUT.format(command="python benchmarks/contact.py --docs docs", friction=FRICTION, end=END)
        text = [about, *tabled(lines), READING.format(tries=TRIES), *tabled(normals), ROLLING, *tabled(disks), COST]
        pages.write(options.docs, "contact", "".join([*text, *tabled(costs)]))


def tabled(lines):
    return ["\n".join(lines), "\n"]


if __name__ == "__main__":
    main()
