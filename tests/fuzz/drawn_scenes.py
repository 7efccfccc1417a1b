"""Scenes as hypothesis draws them: good ones that hold every key, and ways to break them.

A good scene is a row of fast_and_scalar, so that its kernels are those that other tests compile, with everything else drawn
at random. A few rows may have what needs kernels of its own: loads and damping.
"""

import atexit
import copy
import math
import shutil
import tempfile
import typing
from dataclasses import dataclass
from pathlib import Path

import fast_and_scalar as agreement
import numpy as np
import tomli_w
from hypothesis import strategies as st
from pydantic import BaseModel

from pmpm.kernels.needs import TRANSFERS
from pmpm.physics.materials import LAWS, law_of
from pmpm.scene.exact import Exact
from pmpm.scene.materials import MODELS
from pmpm.scene.materials import material as make_material
from pmpm.scene.outside import checksum
from pmpm.scene.schema import NO_MEANS, Scene
from pmpm.scene.shapes import SHAPES
from pmpm.scene.watched import MAPS
from pmpm.state.fields import OUTPUT_NAMES

ROWS = [row for row in agreement.PAIRS + agreement.SINGLE if row["material"] != "breaking"]  # a file holds no functions
MESHES = {
    dim: Path(__file__).with_name(name) for dim, name in ((2, "square.obj"), (3, "cube.obj"))
}  # 2 wide, one group
POINTS = MESHES | {3: MESHES[3].with_name("points.csv")}
OWN_KERNELS = [next(row for row in ROWS if row["dim"] == dim) for dim in (2, 3)]
IN_CONTACT = next(row for row in ROWS if row["material"] == "several" and row["dim"] == 2)
ELASTIC = ("neo_hookean", "hencky", "fixed_corotated")
CELL_SIZES = (0.05, 1e-3, 20.0)
NOT_IN_EVERY_SCENE = ("displacement", "plastic_strain")
# Functions, which only Python gives.
NEVER_IN_A_FILE = (
    {("Scene", key) for key in ("body_force", "exact")}
    | {("Collider", "distance"), ("Terrain", "depth_checksum")}
    | {("Exact", key) for key in Exact.model_fields}
)
# Other ways to give the materials of law_examples: what they say differently.
OTHERWISE = {
    "fluid": ({"bulk_modulus": None, "sound_speed": 1.0}, {"bulk_modulus": None, "flow_speed": 0.1}),
    "bingham": ({"bulk_modulus": None, "sound_speed": 1.0}, {"bulk_modulus": None, "flow_speed": 0.1}),
    "drucker_prager": ({"friction_fit": "plane_strain"},),
    "cam_clay": ({"friction_angle": None, "critical_state_slope": 0.9},),
    "mu_i": ({"static_friction": None, "friction_angle": 21.0}, {"reference_inertial_number": 0.3}),
}


def between(low, high):
    return st.floats(low, high, allow_nan=False)


def vectors(low, high, dim):
    return st.lists(between(low, high), min_size=dim, max_size=dim)


def scaled(value, by):
    return [scaled(item, by) for item in value] if isinstance(value, list) else value * by


# ---- good scenes -----------------------------------------------------------------------------------------------------------


def tellings(row):
    """Numbers of the ways to say the materials of a row."""
    tables = agreement.MATERIALS[row["material"]]
    return range(1 + max(len(OTHERWISE.get(table["model"], ())) for table in tables))


@st.composite
def scenes(draw, row=None, telling=0):
    """The table of a scene that pmpm must take and run; `telling`: which of the ways to say its materials."""
    row = draw(st.sampled_from(ROWS)) if row is None else row
    own_kernels = row in OWN_KERNELS
    dim, (usual_cells, periodic) = row["dim"], agreement.arrangement(row)
    h = draw(st.sampled_from(CELL_SIZES))
    long = max(range(dim), key=lambda axis: usual_cells[axis])
    cells = [draw(st.integers(14, 18) if axis == long else st.integers(8, 10)) for axis in range(dim)]
    gravity = draw(gravities(dim, h))
    materials = {
        draw(st.sampled_from(("sand", "α", "a b", "material-1"))) + str(number): draw(material(table, telling))
        for number, table in enumerate(agreement.MATERIALS[row["material"]])
    }
    names = list(materials)
    bodies = [
        draw(body(name, materials[name], cells, long, half, h, gravity, own_kernels))
        for half, name in enumerate((names * 2)[: draw(st.integers(max(1, min(2, len(names))), 2))])
    ]
    table = {
        "title": draw(st.sampled_from(("", "Säule", "雪崩 ❄", "a" * 300, "'\"\\ {} %s"))),
        "domain": draw(domain(row, cells, periodic, h, gravity)),
        "method": draw(method(row, own_kernels)),
        "time": draw(time(h)),
        "materials": materials,
        "bodies": bodies,
        "output": draw(output(materials, h, cells, periodic, gravity)),
    }
    if own_kernels:
        table["loads"] = draw(st.lists(load(bodies, dim), min_size=1, max_size=2))
    if draw(st.booleans()):
        table["motions"] = [draw(motion(cells, h)) for _ in range(draw(st.integers(0, 2)))]
    if draw(st.booleans()):
        table["colliders"] = [draw(collider(cells, h, number)) for number in range(draw(st.integers(0, 2)))]
    if draw(st.booleans()):
        table["inflows"] = [draw(inflow(names, cells, h)) for _ in range(draw(st.integers(0, 2)))]
        if table["inflows"]:
            table.pop("colliders", None)  # which must not lie in an inflow
        if table["inflows"] and draw(st.booleans()):
            del table["bodies"]
            table.pop("loads", None)
    if row == IN_CONTACT and "bodies" in table:
        table["contact"] = draw(contact(names))
    if draw(st.booleans()):
        table["guard"] = {"keep_copy": draw(st.booleans()), "interval": draw(st.sampled_from((1, 2, 100)))}
        table["guard"]["energy_gain"] = draw(st.sampled_from((0.0, 0.5, 1e300)))
        table["parallel"] = {"balance": draw(st.booleans()), "slab_axis": draw(maybe(st.just("xyz"[long])))}
    return pruned(table)


def pruned(value):
    """A table without the keys that are None."""
    if isinstance(value, dict):
        return {key: pruned(item) for key, item in value.items() if item is not None}
    return [pruned(item) for item in value] if isinstance(value, list) else value


def maybe(strategy):
    return st.none() | strategy


@st.composite
def gravities(draw, dim, h):
    """None, zero, along one axis or askew; so weak that a few cells of material carry their weight."""
    strength = 0.01 / h
    along = st.tuples(st.integers(0, dim - 1), st.sampled_from((-strength, strength)))
    kind = draw(st.sampled_from(("none", "zero", "along", "along", "askew")))
    if kind == "none":
        return None
    if kind == "zero":
        return [0] * dim
    if kind == "askew":
        return draw(vectors(-strength, strength, dim))
    axis, value = draw(along)
    return [value if number == axis else 0.0 for number in range(dim)]


@st.composite
def domain(draw, row, cells, periodic, h, gravity):
    long = max(range(row["dim"]), key=lambda axis: cells[axis])
    kinds = agreement.WALLS[row["dim"], row["precision"]]
    walls = {}
    for axis in "xyz"[: row["dim"]]:
        for end in ("min", "max"):
            if axis not in periodic:
                # Of the axis of slabs, for of others G2P would be compiled once more.
                walls[f"{axis}_{end}"] = draw(wall(kinds, row["dim"], ("open",) if axis == "xyz"[long] else ()))
    return {
        "size": [count * h for count in cells],
        "cell_size": h,
        "gravity": gravity,
        "walls": walls,
        "periodic": list(periodic) if periodic or draw(st.booleans()) else None,
    }


@st.composite
def wall(draw, kinds, dim, opened):
    kind = draw(st.sampled_from((*kinds, "free", *opened)))
    table = dict(kind) if isinstance(kind, dict) else {"type": kind}
    if kind in ("free", "open") or draw(st.booleans()):
        return draw(st.sampled_from((table, kind)))
    return table | {"velocity": draw(vectors(-0.01, 0.01, dim))}


@st.composite
def method(draw, row, own_kernels):
    table = {key: row[key] for key in agreement.METHOD}
    if TRANSFERS[row["transfer"]].blends:
        table["flip_blend"] = draw(maybe(st.sampled_from((0, 1, 0.5, 0.99))))
    if own_kernels:
        table["damping"] = draw(between(0.0, 10.0))
    return table | {"integrator": draw(maybe(st.just("explicit")))}


@st.composite
def time(draw, h):
    table = {"end": draw(st.sampled_from((h, 10.0 * h, 100 * h))), "ramp": draw(maybe(between(0.0, 10.0)))}
    kind = draw(st.sampled_from(("", "cfl", "step")))
    if kind == "cfl":
        table["cfl"] = draw(between(0.01, 0.9))
    elif kind == "step":
        table["step"] = h * draw(st.sampled_from((1e-3, 1e-4)))
        table["force_step"] = draw(st.booleans())
    if kind != "step" and draw(st.booleans()):
        table["smallest_step"] = draw(st.sampled_from((1e-300, 1e-12)))
    return table


@st.composite
def material(draw, table, telling):
    """A material of law_examples, perhaps in other words, a little heavier or lighter."""
    ways = ({}, *OTHERWISE.get(table["model"], ()))
    changed = table | ways[telling % len(ways)]
    return pruned(changed | {"density": draw(st.sampled_from((1000, 1000.0, 1300.0)))})


@st.composite
def shape(draw, cells, long, half, dim):
    """A shape, in cells, in one half of the long axis: at least 0.4 cells from all walls, at least 1.5 wide."""
    low = [cells[long] / 2.0 * half if axis == long else 0.0 for axis in range(dim)]
    high = [cells[long] / 2.0 * (half + 1) if axis == long else float(cells[axis]) for axis in range(dim)]
    center = [draw(between(a + 3.1, b - 3.1)) for a, b in zip(low, high, strict=True)]
    ball = {"type": "sphere", "center": center, "radius": draw(between(1.5, 2.5))}
    widths = draw(vectors(0.8, 2.5, dim))
    box = {
        "type": "box",
        "min": [x - w for x, w in zip(center, widths, strict=True)],
        "max": [x + w for x, w in zip(center, widths, strict=True)],
    }
    kinds = {
        "box": box,
        "sphere": ball,
        "union": {"type": "union", "of": [ball, box]},
        "intersection": {"type": "intersection", "of": [box, ball]},
        "difference": {"type": "difference", "of": [box, {"type": "sphere", "center": box["max"], "radius": 0.7}]},
        "mesh": draw(mesh(dim, center)),
    }
    if dim == 3:
        axis = draw(st.sampled_from(("x", "y", "z")) | st.just([1.0, -2.0, 0.5]))
        height = draw(between(1.5, 3.0))
        kinds["cylinder"] = {"type": "cylinder", "center": center, "axis": axis, "radius": 1.6, "height": height}
    return kinds[draw(st.sampled_from(sorted(kinds)))]


@st.composite
def points(draw, cells, long, half):
    """A few particles out of a file: of the cells of the square, in space those of a table."""
    dim = len(cells)
    table = draw(mesh(dim, [cells[axis] * (0.25 + 0.5 * half if axis == long else 0.5) for axis in range(dim)]))
    fields = draw(maybe(st.just([]) if dim == 2 else st.sampled_from(([], ["velocity"]))))
    table |= {
        "type": "particles",
        "file": str(POINTS[dim]),
        "fields": fields,
        "checksum": draw(maybe(st.just(checksum(str(POINTS[dim]))))),
    }
    return table if dim == 2 else table | {"group": None}


@st.composite
def mesh(draw, dim, center):
    """A cube or square out of a file, turned as it likes; it is 2 wide there, and its middle at the origin."""
    path = str(MESHES[dim])
    return {
        "type": "mesh",
        "file": path,
        "checksum": draw(maybe(st.just(checksum(path)))),
        "group": draw(maybe(st.just("all"))),
        "scale": draw(between(0.8, 1.5) | vectors(0.8, 1.5, dim)),
        "rotate": draw(maybe(vectors(-180.0, 180.0, 3) if dim == 3 else between(-180.0, 180.0))),
        "move": center,
    }


def in_metres(table, h):
    """A shape given in cells, in metres."""
    lengths = ("min", "max", "center", "radius", "height", "start", "end", "point", "scale", "move")
    return {
        key: scaled(value, h) if key in lengths else [in_metres(s, h) for s in value] if key == "of" else value
        for key, value in table.items()
    }


@st.composite
def body(draw, name, table, cells, long, half, h, gravity, own_kernels):
    dim, law = len(cells), LAWS[table["model"]]
    count = draw(maybe(st.sampled_from((3, 4, 5) if dim == 2 else (4, 6, 8))))
    seedings = ["jittered", "poisson_disk", *(["lattice"] if count in (None, 2**dim) else [])]
    seedings += ["quadrature"] if own_kernels and count in (None, 2**dim) else []
    filled = draw(st.sampled_from((True,) * 5 + (False,)))
    made = {
        "material": name,
        "shape": in_metres(draw(shape(cells, long, half, dim) if filled else points(cells, long, half)), h),
        "particles_per_cell": count,
        "seeding": draw(maybe(st.sampled_from(seedings))),
        "velocity": draw(maybe(vectors(-0.2, 0.2, dim) | st.just([0] * dim))),
        "displacement": draw(maybe(vectors(-0.3 * h, 0.3 * h, dim))),
    }
    if made["shape"]["type"] == "particles":
        made["seeding"] = None
    starts = ["", "", "deformation"]
    if gravity is not None and sum(value != 0.0 for value in gravity) == 1:
        starts += ["hydrostatic"] * 3 if hasattr(law, "hydrostatic_state") else []
        starts += ["geostatic"] * 3 if table["model"] in ELASTIC else []
    kind = draw(st.sampled_from(starts))
    if kind == "deformation":
        noise = draw(st.lists(vectors(-0.02, 0.02, dim), min_size=dim, max_size=dim))
        made["deformation"] = [[noise[i][j] + (i == j) for j in range(dim)] for i in range(dim)]
    elif kind == "geostatic":
        axis = next(axis for axis in range(dim) if gravity[axis])
        surface = cells[axis] * h if gravity[axis] < 0.0 else 0
        made["stress"] = {
            "type": "geostatic",
            "k0": draw(maybe(between(0.3, 1.0))),
            "surcharge": draw(maybe(between(0.0, 5.0))),
            "depth_from": draw(maybe(st.just(surface))),
        }
    else:
        made["pressure"] = kind or draw(maybe(st.just("zero")))
    return made


@st.composite
def load(draw, bodies, dim):
    kind = draw(st.sampled_from(("force", "acceleration")))
    everywhere = {"type": "box", "min": [-1e6] * dim, "max": [1e6] * dim}
    shapes = [everywhere if body["shape"]["type"] == "particles" else body["shape"] for body in bodies]
    return {"shape": copy.deepcopy(draw(st.sampled_from(shapes))), kind: draw(vectors(-0.01, 0.01, dim))}


@st.composite
def contact(draw, names):
    """Between the first two of some materials, of which bodies may have no others."""
    pair = {"materials": names[:2], "friction": draw(between(0.0, 2.0))}
    return {
        "friction": draw(between(0.0, 1.0)),
        "together": draw(st.sampled_from(([], [names[1:]]))),
        "pairs": [pair],
    }


@st.composite
def motion(draw, cells, h):
    low = [draw(between(-1.0, count - 2.0)) for count in cells]
    return {
        "shape": {"type": "box", "min": scaled(low, h), "max": [(x + 2.0) * h for x in low]},
        "velocity": draw(vectors(-0.1, 0.1, len(cells))),
        "moves": draw(maybe(st.booleans())),
    }


@st.composite
def collider(draw, cells, h, number):
    """Small or below everything, so that bodies keep particles."""
    dim = len(cells)
    center = [draw(between(0.0, float(count))) for count in cells]
    up = [0.0] * (dim - 1) + [1.0]
    low = [x - 0.8 for x in center]
    ground = {"first_row": "south", "spacing": [4.0 * h] * draw(st.integers(1, 2)), "variable": "z"}
    ground |= {"origin": [0.0] * (dim - 1) + [0.1 * h], "checksum": GROUND_CHECKSUMS[dim]}
    shapes = [
        {"type": "sphere", "center": center, "radius": 1.0},
        {"type": "capsule", "start": center, "end": [x + 0.5 for x in center], "radius": 0.7},
        {"type": "box", "min": low, "max": [x + 0.8 for x in center]},
        {"type": "plane", "point": [0.3] * dim, "normal": up},
        {"type": "terrain", "file": GROUNDS[dim]} | ground,
        {"type": "terrain", "file": GROUNDS[dim]} | ground | {"depth": 0.5 * h, "least_depth": 0.0},
    ]  # fmt: skip
    slow, kind = vectors(-0.05, 0.05, dim), draw(st.sampled_from(("velocity", "path", "rests")))
    times = sorted(draw(st.sets(st.integers(0, 10), min_size=1, max_size=3)))
    return {
        "name": draw(maybe(st.just(f"thing_{number}"))),
        "shape": in_metres(draw(st.sampled_from(shapes)), h),
        "surface": draw(
            maybe(st.sampled_from(("stick", "slip", "separate", {"type": "friction", "coefficient": 0.4})))
        ),
        "cut": draw(maybe(st.booleans())),
        "pivot": draw(maybe(st.just(scaled(center, h)))),
        "angular_velocity": draw(maybe(between(-5.0, 5.0) if dim == 2 else vectors(-5.0, 5.0, 3))),
        "velocity": draw(slow) if kind == "velocity" else None,
        "path": {"times": times, "displacements": [scaled(draw(slow), h) for _ in times]} if kind == "path" else None,
    }


def write_maps():
    """{dimensions: (path of a height map of which next to nothing stands out, its checksum)}."""
    folder = Path(tempfile.mkdtemp())
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    for dim in (2, 3):
        np.savez(folder / f"{dim}.npz", z=np.full((3,) * (dim - 1), 0.0))
    paths = {dim: str(folder / f"{dim}.npz") for dim in (2, 3)}
    return paths, {dim: checksum(path) for dim, path in paths.items()}


GROUNDS, GROUND_CHECKSUMS = write_maps()


@st.composite
def inflow(draw, names, cells, h):
    dim, end = len(cells), 1e-3
    low = [draw(between(0.0, count - 4.0)) for count in cells]
    high = [x + draw(between(2.5, 4.0)) for x in low]
    middle = [0.5 * (a + b) for a, b in zip(low, high, strict=True)]
    box, ball = {"type": "box", "min": low, "max": high}, {"type": "sphere", "center": middle, "radius": 1.1}
    return {
        "material": draw(st.sampled_from(names)),
        "shape": in_metres(draw(st.sampled_from((box, ball))), h),
        "velocity": draw(vectors(-0.1, 0.1, dim) | st.just([0] * dim)),
        "particles_per_cell": draw(maybe(st.sampled_from((1, 4) if dim == 2 else (1, 8)))),
        "start": draw(maybe(st.sampled_from((0, end * h)))),
        "until": draw(maybe(st.sampled_from((2.0 * end * h, 1e9)))),
        "limit": draw(maybe(st.sampled_from((h**dim, 1e9 * h**dim)))),
    }


@st.composite
def output(draw, materials, h, cells, periodic, gravity):
    made = [make_material(table) for table in materials.values()]
    states = {field.name for m in made for field in law_of(m.model).state_fields(m.parameters)} - set(OUTPUT_NAMES)
    common = [name for name in OUTPUT_NAMES if name not in NOT_IN_EVERY_SCENE]
    nodal = [name for name in common if name not in NO_MEANS]
    falls = gravity is not None and any(gravity)
    walled = [axis for axis in "xyz"[: len(cells)] if axis not in periodic]
    place = st.tuples(*(between(0.0, count * h) for count in cells)).map(list)
    probe = st.fixed_dictionaries({"name": st.sampled_from(("a", "B-2", "0_")), "position": place})
    section = {"type": st.just("section"), "axis": st.sampled_from("xyz"[: len(cells)])}
    line = {"type": maybe(st.just("surface")), "axis": st.sampled_from(walled)}
    gauge = probe.flatmap(
        lambda told: (st.fixed_dictionaries(section) | st.fixed_dictionaries(line)).map(lambda more: told | more)
    )
    return {
        "probes": draw(maybe(st.lists(probe, max_size=2, unique_by=lambda told: told["name"]))),
        "gauges": draw(maybe(st.lists(gauge, max_size=2, unique_by=lambda told: told["name"]))),
        "maps": draw(maybe(st.lists(st.sampled_from(MAPS), unique=True))) if falls else None,
        "grid_fields": draw(
            maybe(st.lists(st.sampled_from(("mass", *nodal, *sorted(states))), unique=True, max_size=3))
        ),
        "snapshot_interval": draw(maybe(st.sampled_from((h * 1e-3, h, 1e9)))),
        "diagnostics_interval": draw(maybe(st.sampled_from((h * 1e-3, h, 1e9)))),
        "fields": draw(maybe(st.lists(st.sampled_from((*common, *sorted(states))), unique=True, max_size=4))),
        "checkpoint_interval": draw(maybe(st.sampled_from((h * 1e-2, h)))),
        "checkpoint_wall_interval": draw(maybe(st.sampled_from((0, 60)))),
        "checkpoint_keep": draw(maybe(st.integers(1, 3))),
        "checkpoint_at_end": draw(maybe(st.booleans())),
    }


# ---- which keys are in a scene ---------------------------------------------------------------------------------------------


def parts_in(annotation):
    """The classes of tables that a type may hold."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [part for argument in typing.get_args(annotation) for part in parts_in(argument)]


def parts_of(model):
    """{key: classes of the tables that may stand there} of a table."""
    if model in SHAPES.values():
        return {"of": list(SHAPES.values())} if "of" in model.model_fields else {}
    found = {key: parts_in(field.annotation) for key, field in model.model_fields.items()}
    if model is Scene:
        found["materials"] = list(MODELS.values())
    return {key: classes for key, classes in found.items() if classes}


def all_keys():
    """{(table, key)} of the whole schema, as far as a file can hold them."""
    found, todo = set(), [Scene]
    while todo:
        model = todo.pop()
        own = {(model.__name__, key) for key in model.model_fields}
        if not own <= found:
            found |= own
            todo += [part for classes in parts_of(model).values() for part in classes]
    return found - NEVER_IN_A_FILE


def keys_of(table, model=Scene):
    """{(table, key)} that a scene's table holds, as far as the schema knows them."""
    found = set()
    for key, classes in parts_of(model).items():
        for item in tables_in(table.get(key)):
            part = next((c for c in classes if fits(c, item)), None)
            found |= keys_of(item, part) if part else set()
    return found | {(model.__name__, key) for key in table if key in model.model_fields}


def tables_in(value):
    """The tables in the place of a key: one, a list of them, or one for each name; a wall's short form is its type."""
    if isinstance(value, list):
        return [item for item in value if isinstance(item, dict)]
    if isinstance(value, dict) and value and all(isinstance(item, dict | str) for item in value.values()):
        named = [{"type": item} if isinstance(item, str) else item for item in value.values()]
        if not {"type", "size", "end", "transfer"} & set(value):
            return named
    return [value] if isinstance(value, dict) else []


def fits(model, table):
    """Whether a table is one of this class, as its type or its model says where there are several."""
    for key in ("type", "model"):
        words = typing.get_args(model.model_fields[key].annotation) if key in model.model_fields else ()
        if words and table.get(key) not in words:
            return False
    return True


# ---- what breaks them ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Raw:
    """A value as it stands in the file."""

    text: str


def nested(depth, inner, wrap):
    for _ in range(depth):
        inner = wrap(inner)
    return inner


WORDS = (
    "", " ", "x" * 100_000, "\u0000", "\u001b[2J", "\u202e", "ü𝕏", "nan", "true", "../../../../../tmp/pwned",
    "/etc/passwd",
    "__import__('os').system('touch pwned')", "python:velocity:0123456789ab", "python:", "python",
    "{0.__class__}", "%n%s", "quadratic",
    "separate", "friction", "x", "xyz", "stick", "x_min", "sand", "drucker_prager", "fluid", "python_law",
    "box", "union", "mesh", str(MESHES[2]), str(MESHES[3]), __file__,
)  # fmt: skip
NUMBERS = (
    0, -1, 1, 2, 0.0, -0.0, 0.5, 1e300, -1e300, 1e-300, 5e-324, -5e-324, 1e-45, 1e39, 1e18, 1e10, -1e10, 2**31,
    2**53, 2**63, -(2**63),
    2**64, 10**300, 10**400, 1.7976931348623157e308, 2.2250738585072014e-308, 0.1 + 0.2, math.pi,
)  # fmt: skip
RAW = tuple(
    map(
        Raw,
        ("nan", "-nan", "inf", "-inf", "1e400", "-1e400", "1e-400", "9" * 100_000, "-" + "9" * 5000,
    "0x" + "f" * 30_000,
         "0b1", "1_000", "1979-05-27T07:32:00Z", "1979-05-27T07:32:00.999999-07:00", "1979-05-27", "07:32:00",
    "[" * 3000,
         "{ a = " * 3000, "'''", '"""', "[[1]]", "{}", "1.0.0", "1 2", "null", "None", "# nothing", "",
    "\\u0000", "\ud7ff"),
    )
)  # fmt: skip
LISTS = (
    [], [[]], [[], []], [1], [1.0, 2.0], [1, 2, 3], [1, 2, 3, 4], [0.0] * 2, [0.0] * 3, [1e300] * 2,
    [1e-300] * 3, [-1.0, -1.0],
    [1.0, "a"], [True, False], [1.0] * 1000, ["x"], ["x", "x"], ["velocity", "velocity"], [{}], [{}, {}],
    [[1.0, 0.0], [0.0, 1.0]],
    [[0.0, 0.0], [0.0, 0.0]], [[1e300, 0.0], [0.0, 1e300]], [[1.0], [0.0, 1.0]], nested(60, 1.0, lambda inner: [inner]),
    nested(150, 1.0, lambda inner: [inner]),
)  # fmt: skip
BALL = {"type": "sphere", "center": [0.3, 0.3], "radius": 0.1}
NO_SHAPES = nested(50, {}, lambda inner: {"type": "union", "of": [inner]})
MANY_SHAPES = nested(100, BALL, lambda inner: {"type": "union", "of": [inner]})
TABLES = (
    {}, {"a": 1}, {"type": "box"}, {"type": "union", "of": []}, {"type": "geostatic"}, {"type": "friction"},
    {"": 1}, {"x" * 1000: {}},
    {"type": "sphere", "center": [0.1, 0.1], "radius": 1e300}, {"type": "sphere", "center": [0.1, 0.1],
    "radius": 1e-300},
    {"type": "box", "min": [0.0, 0.0], "max": [1e308, 1e308]}, {"type": "box", "min": [-1e308, 0.0],
    "max": [1e308, 1.0]},
    {"type": ["box"]}, {"model": ["fluid"]}, {"model": "fluid"}, {"model": {}}, {"type": None.__class__.__name__},
    {"type": "cylinder", "center": [0.4, 0.4, 0.4], "axis": [1e-300, 0.0, 0.0], "radius": 0.1, "height": 0.1},
    {"type": "cylinder", "center": [0.4, 0.4, 0.4], "axis": [1e300, 1e300, 0.0], "radius": 0.1, "height": 0.1},
    {"type": "difference", "of": [{"type": "box", "min": [0.0, 0.0], "max": [0.2, 0.2]}] * 2},
    NO_SHAPES, MANY_SHAPES,
    nested(40, {}, lambda inner: {"a": inner}),
)  # fmt: skip
SCALARS = st.one_of(
    st.sampled_from(NUMBERS), st.sampled_from(RAW), st.sampled_from(WORDS), st.booleans(), st.floats(),
    st.integers(), st.text(max_size=20)
)  # fmt: skip
BAD = st.one_of(SCALARS, st.sampled_from(LISTS), st.sampled_from(TABLES), st.lists(SCALARS, max_size=4))
UNKNOWN = st.sampled_from(
    ("cell_sizes", "Size", "", "é", "walls ", "__class__", "__init__", "model_fields", "model_config", "self",
    "of", "colliders", "x" * 500)
) | st.text(max_size=10)  # fmt: skip


def places(table, path=()):
    """Paths of all keys and entries in a table, at any depth."""
    items = table.items() if isinstance(table, dict) else enumerate(table) if isinstance(table, list) else ()
    for key, value in items:
        yield (*path, key)
        yield from places(value, (*path, key))


def holder(table, path):
    for key in path[:-1]:
        table = table[key]
    return table


@st.composite
def broken(draw, least=1, most=3):
    """The table of a scene with something wrong at a few places, most likely."""
    table = copy.deepcopy(draw(scenes()))
    for _ in range(draw(st.integers(least, most))):
        path = draw(st.sampled_from(list(places(table))))
        where, key = holder(table, path), path[-1]
        kind = draw(st.sampled_from(("replace", "replace", "replace", "scale", "delete", "add", "wrap", "repeat")))
        if kind == "delete":
            del where[key]
        elif kind == "add" and isinstance(where, dict):
            where[draw(UNKNOWN)] = draw(BAD)
        elif kind == "wrap":
            where[key] = draw(st.sampled_from(([where[key]], {"a": where[key]})))
        elif kind == "repeat" and isinstance(where[key], list):
            where[key] = where[key] * draw(st.integers(0, 40))
        elif kind == "scale" and isinstance(where[key], int | float):
            where[key] = where[key] * draw(st.sampled_from((-1.0, 0.0, 1e3, 1e-3, 1e20, 1e-20, 1e200, 1e-200)))
        else:
            where[key] = draw(BAD)
    return table


@st.composite
def extreme(draw):
    """A good scene and its table with one or two numbers made larger or smaller beyond all measure,
    or turned around."""
    good = draw(scenes())
    table = copy.deepcopy(good)
    numbers = [path for path in places(table) if type(holder(table, path)[path[-1]]) in (int, float)]
    for path in draw(st.lists(st.sampled_from(numbers), min_size=1, max_size=2, unique=True)):
        where, key = holder(table, path), path[-1]
        factor = draw(st.sampled_from((-1.0, 1.0, 1.0))) * 10.0 ** draw(st.integers(-40, 40) | st.integers(-4, 4))
        where[key] = draw(st.sampled_from((where[key] * factor, where[key] * factor, factor)))
    return good, table


@st.composite
def damaged(draw):
    """The bytes of a scene file with a few of them changed, lost, doubled, or put elsewhere."""
    content = toml_text(draw(scenes())).encode("utf-8")
    for _ in range(draw(st.integers(1, 4))):
        first = draw(st.integers(0, len(content)))
        last = min(len(content), first + draw(st.sampled_from((0, 1, 1, 2, 10, 100, 10_000))))
        piece = content[first:last]
        other = draw(
            st.sampled_from(
                (
                    b"",
                    piece * 2,
                    piece[::-1],
                    b"\0",
                    b"\xff",
                    b"\xef\xbb\xbf",
                    b"=",
                    b"[",
                    b"\n",
                    b'"',
                    b"#",
                    b"\r",
                    b"{",
                )
            )
            | st.binary(max_size=8)
        )
        content = content[:first] + other + content[last:]
    return content


def toml_text(table):
    """The text of a scene file; values that TOML has not come out as they are."""
    raws = []

    def marked(value):
        if isinstance(value, Raw):
            raws.append(value.text)
            return f"@raw {len(raws) - 1}@"
        if isinstance(value, dict):
            return {key: marked(item) for key, item in value.items()}
        return [marked(item) for item in value] if isinstance(value, list | tuple) else value

    text = tomli_w.dumps(marked(table))
    for number, raw in enumerate(raws):
        text = text.replace(f'"@raw {number}@"', raw)
    return text


def literal(value):
    """A value as it stands after `--set key=`."""
    return toml_text({"v": [value]})[len("v = [") :].strip().removesuffix("]").strip().removesuffix(",")


def dotted(path):
    """A path as `--set` takes it, with names in quotes where they need them."""
    return ".".join(
        name
        if str(name).replace("_", "").isalnum() and str(name).isascii()
        else tomli_w.dumps({"v": str(name)})[4:].strip()
        for name in map(str, path)
    )


@st.composite
def settings(draw, table):
    """A text for `--set`: a key of the table, or one that it has not, and a value that does not fit, most likely."""
    path = draw(st.sampled_from(list(places(table))))
    if draw(st.integers(0, 4)) == 0:
        path = (*path, draw(UNKNOWN))
    key = draw(
        st.just(dotted(path))
        | st.sampled_from(("", ".", "a..b", "[0]", "bodies[0].velocity", "bodies.9.velocity", "title.x.y"))
    )
    return key + draw(st.sampled_from(("=", "=", "=", "=", " = ", ""))) + literal(draw(BAD))
