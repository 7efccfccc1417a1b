"""Small lively scenes run with the fast kernels and with the scalar ones, and how far the two have come apart.

Factors and their values come from the solver itself where it lists them; what it gains fails
tests/test_fast_and_scalar.py until a scene here has it.
"""

import itertools
import os
import re
from unittest import mock

import every_pair
import numpy as np
from law_examples import EXAMPLES

from pmpm.kernels.needs import TRANSFERS
from pmpm.scene.errors import SceneError
from pmpm.scene.schema import Method, Scene
from pmpm.simulation import Simulation

STEPS = 60
LINEAR_STEPS = (
    8  # of linear splines, whose free surfaces turn unstable: round-off grows tenfold every few steps from then on
)
BOUND = 500.0  # eps; 53 measured, see docs/results/fast_and_scalar.md
METHOD = ("shape_function", "transfer", "precision", "f_bar")
CELL = 0.05
# Laws meet methods in their stress and their step alone, so two of them, and three together, meet all methods, in every
# pair of values; the others meet one. In this order the laws of `several` have the kernels that other rows compile already.
GENERAL = {name: (EXAMPLES[name],) for name in ("fluid", "neo_hookean")}
GENERAL["several"] = tuple(EXAMPLES[name] for name in ("fluid", "neo_hookean", "drucker_prager"))
OTHERS = {name: (table,) for name, table in EXAMPLES.items() if name not in GENERAL}
MATERIALS = GENERAL | OTHERS
# Per dimension: cells along x, y, z and periodic axes. Each axis is cut into slabs in one of them.
ARRANGEMENTS = {
    2: (((20, 9), ""), ((9, 20), "x"), ((9, 20), "y")),
    3: (((18, 8, 8), ""), ((8, 18, 8), "z"), ((8, 7, 18), "xz")),
}
FRICTION = {"type": "friction", "coefficient": 0.3}
# Each kind takes seconds to compile, for each dimension and precision.
WALLS = {
    (2, "float32"): ("separate", FRICTION),
    (2, "float64"): (FRICTION, "slip"),
    (3, "float32"): ("stick", "separate"),
    (3, "float64"): (FRICTION, "separate"),
}


def built_words(key):
    """The words that a scene takes for method.`key`, out of its own complaint about another one."""
    try:
        Method(**{key: "?"})
    except SceneError as complaint:
        return re.search(r"known are: (.+)", str(complaint))[1].split(", ")
    raise AssertionError(f"method.{key} takes any word")


def allowed(row):
    """Whether a scene may combine these values: linear splines have no MLS."""
    return not (row["shape_function"] == "linear" and TRANSFERS[row["transfer"]].mls)


FACTORS = {
    "material": list(GENERAL),
    "dim": list(ARRANGEMENTS),
    **{key: built_words(key) for key in METHOD if key != "f_bar"},
    "f_bar": [False, True],
}
PAIRS = every_pair.every_pair(FACTORS, allowed)
PLAIN = {"shape_function": "quadratic", "transfer": "apic", "f_bar": False}
SINGLE = [
    {"material": name, "dim": dim, **PLAIN, "precision": precision}
    for name, (dim, precision) in zip(
        OTHERS, itertools.cycle(itertools.product(ARRANGEMENTS, FACTORS["precision"])), strict=False
    )
]
ALL = every_pair.full_product(FACTORS, allowed) + [
    {"material": name, "dim": dim, **PLAIN, "precision": precision}
    for name in OTHERS
    for dim, precision in itertools.product(ARRANGEMENTS, FACTORS["precision"])
]


def arrangement(row):
    """Cells and periodic axes of a row: in turn, so that the few kinds of kernels in PAIRS meet all of them."""
    choices = ARRANGEMENTS[row["dim"]]
    rows = [other for other in PAIRS + SINGLE + ALL if other["dim"] == row["dim"]]
    kinds = list(dict.fromkeys(map(kernels_of, rows)))
    return choices[kinds.index(kernels_of(row)) % len(choices)]


def kernels_of(row):
    """All values but the material, so that laws together have the kernels that they have alone."""
    return tuple(row[factor] for factor in FACTORS if factor != "material")


def label(row):
    return " ".join(map(str, row.values()))


def scene(row, in_space=(6, 8, 5)):
    """Two bodies, three if of several laws, that hit the walls of opposite corners or cross the ends of periodic axes.
    in_space: particles per cell of each in 3-D."""
    dim, (cells, periodic) = row["dim"], arrangement(row)
    long = np.arange(dim) == np.argmax(cells)
    size, velocity = np.array(cells), np.array([0.25, 0.2, 0.15])[:dim]
    middle = np.where(long, 7.5, 3.0)
    shapes = (
        (
            {"type": "box", "min": [0.5] * dim, "max": np.where(long, 5.5, 4.5)},
            -velocity,
            5 if dim == 2 else in_space[0],
        ),
        ({"type": "sphere", "center": size - 2.6, "radius": 2.2}, velocity, 4 if dim == 2 else in_space[1]),
        ({"type": "box", "min": middle - 2.0, "max": middle + 2.0}, -1.5 * velocity, 3 if dim == 2 else in_space[2]),
    )
    laws = MATERIALS[row["material"]]
    # Bodies of one law differ in what they weigh.
    materials = {f"{i}": laws[i] if i < len(laws) else laws[0] | {"density": 1300.0} for i in range(max(2, len(laws)))}
    walls = {
        f"{axis}_{end}": WALLS[dim, row["precision"]][place % 2]
        for place, axis in enumerate("xyz"[:dim])
        for end in ("min", "max")
        if axis not in periodic
    }
    return Scene(
        domain={
            "size": (size * CELL).tolist(),
            "cell_size": CELL,
            "gravity": [-0.2, -0.6, -0.3][:dim],
            "periodic": list(periodic),
            "walls": walls,
        },
        method={key: row[key] for key in METHOD},
        time={"end": 100.0, "cfl": 0.6},
        materials=materials,
        bodies=[
            {"material": name, "shape": in_metres(shape), "velocity": velocity.tolist(), "particles_per_cell": per_cell}
            for name, (shape, velocity, per_cell) in zip(materials, shapes, strict=False)
        ],
    )


def in_contact(row):
    """The same with contact between all of its materials."""
    return Scene(**(scene(row).model_dump(exclude_none=True) | {"contact": {"friction": 0.2}}))


def in_metres(shape):
    return {key: value if key == "type" else (np.array(value) * CELL).tolist() for key, value in shape.items()}


def run(scene, loops, comm=None):
    """A simulation of the scene after its steps with "lanes" or "scalar" loops. Collective."""
    with mock.patch.dict(os.environ, PMPM_LOOPS=loops):
        simulation = Simulation(scene, comm)
    simulation.run(steps=LINEAR_STEPS if scene.method.shape_function == "linear" else STEPS)
    return simulation


def by_id(simulation):
    """[{name: rows}] per law, of all ranks and in the order of the ids: node and part of a cell, v, C and the state."""
    found = []
    for population, layout in zip(simulation.populations, simulation.layouts, strict=True):
        node, part = population.cells(simulation.geometry.axes)
        own = {"id": population.id[population.lanes], "node": node, "part": part}
        own |= {field.name: population.rows(layout.where(field.name)) for field in layout.fields if field.name != "x"}
        rows = {name: np.concatenate(simulation.comm.gather(values)) for name, values in own.items()}
        order = np.argsort(rows["id"])
        found.append({name: values[order] for name, values in rows.items()})
    return found


def distances(simulation, other):
    """{name: largest difference, in eps of what it is measured by}. Collective.

    Positions are measured by a cell, v, C and divergence by the largest one of the law, state variables by 1: they are
    strains or near 1.
    """
    eps, geometry, found = float(np.finfo(simulation.real).eps), simulation.geometry, {}
    period = np.where(geometry.periodic, geometry.cells, 2**40)
    for one, two in zip(by_id(simulation), by_id(other), strict=True):
        assert np.array_equal(one.pop("id"), two.pop("id"))
        nodes, part = one.pop("node") - two.pop("node"), one.pop("part") - two.pop("part")
        apart = {"x": np.abs((nodes + period // 2) % period - period // 2 + part)}
        for name, rows in one.items():
            a, b = rows.astype(float), two[name].astype(float)
            apart[name] = np.abs(a - b) / (np.abs(a).max() if name in ("v", "C", "divergence") else 1.0)
        for name, difference in apart.items():
            found[name] = float(np.maximum(found.get(name, 0.0), difference.max() / eps))  # nan stays
    return found
