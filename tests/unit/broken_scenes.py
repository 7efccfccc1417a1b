"""Scenes with one mistake each and what the message must contain: (name, TOML text, fragments)."""

from pathlib import Path

GOOD = """
title = "good"
[domain]
size = [0.6, 0.2]
cell_size = 0.0025
gravity = [0.0, -9.81]
walls = { x_min = "slip", y_min = "stick", y_max = "free", x_max = { type = "friction", coefficient = 0.4 } }
[method]
transfer = "apic"
[time]
end = 1.0
[materials.sand]
model = "drucker_prager"
density = 2650.0
youngs_modulus = 8.4e5
poisson_ratio = 0.3
friction_angle = 30.0
[materials.water]
model = "fluid"
density = 1000.0
sound_speed = 15.0
[[bodies]]
material = "sand"
shape = { type = "box", min = [0.0, 0.0], max = [0.1, 0.1] }
velocity = [0.0, 0.0]
[[bodies]]
material = "water"
shape = { type = "sphere", center = [0.3, 0.1], radius = 0.05 }
particles_per_cell = 4
pressure = "hydrostatic"
[output]
snapshot_interval = 0.02
"""

GOOD_3D = """
[domain]
size = [0.3, 0.3, 0.1]
cell_size = 0.005
gravity = [0.0, 0.0, -9.81]
[time]
end = 0.4
[materials.block]
model = "neo_hookean"
density = 1000.0
youngs_modulus = 1e4
poisson_ratio = 0.3
[[bodies]]
material = "block"
shape = { type = "cylinder", center = [0.15, 0.15, 0.05], axis = "z", radius = 0.05, height = 0.05 }
"""


def change(old, new, text=GOOD):
    """Return a good scene with one piece of text replaced."""
    assert text.count(old) == 1, f"{old!r} stands {text.count(old)} times in the scene"
    return text.replace(old, new)


def solid(old, new):
    return change(old, new, GOOD_3D)


def corotated(old, new):
    return change(old, new, solid("neo_hookean", "fixed_corotated"))


SOIL = 'model = "mohr_coulomb"\ncohesion = 1e3\nfriction_angle = 30.0\n'


def soil(keys):
    return solid('model = "neo_hookean"', keys)


def snow(keys):
    return solid('model = "neo_hookean"', 'model = "snow"\n' + keys)


INFLOW = """[[inflows]]
material = "block"
shape = { type = "box", min = [0.0, 0.0, 0.0], max = [0.1, 0.1, 0.05] }
velocity = [0, 0, 1]
particles_per_cell = 8
start = 0.1
until = 0.3
limit = 1e-3
"""


def inflow(*changes):
    """A scene whose inflow has pieces of its text replaced: old, new, old, new ..."""
    text = INFLOW
    for old, new in zip(changes[::2], changes[1::2], strict=True):
        text = change(old, new, text)
    return GOOD_3D + text


def contact(materials='["sand", "water"]', head="", more=""):
    """A scene with contact between two of its materials."""
    return GOOD + f"[contact]\n{head}\n[[contact.pairs]]\nmaterials = {materials}\nfriction = 0.2\n{more}"


def mesh(keys):
    return solid(CYLINDER, f'{{ type = "mesh", {keys} }}')


CUBE, SQUARE = (Path(__file__).parents[1] / "fuzz" / name for name in ("cube.obj", "square.obj"))
BOX = '{ type = "box", min = [0.0, 0.0], max = [0.1, 0.1] }'
DISK = '{ type = "sphere", center = [0.3, 0.1], radius = 0.05 }'
CYLINDER = '{ type = "cylinder", center = [0.15, 0.15, 0.05], axis = "z", radius = 0.05, height = 0.05 }'
DENSITY = "density = 2650.0"
END = "end = 1.0"
SIZE, CELL, GRAVITY = "size = [0.6, 0.2]", "cell_size = 0.0025", "gravity = [0.0, -9.81]"
SOUND = "sound_speed = 15.0"
ANGLE = "friction_angle = 30.0"
SNAPSHOT = "snapshot_interval = 0.02"
COUNT = "particles_per_cell = 4"

ELASTIC = 'model = "neo_hookean"\ndensity = 1000.0\nyoungs_modulus = 1e4\npoisson_ratio = 0.3'
CLAY = """model = "cam_clay"
density = 1800.0
shear_modulus = 3e6
swelling_index = 0.02
compression_index = 0.1
friction_angle = 25.0
preconsolidation_pressure = 1e5
initial_pressure = 5e4"""
GRAINS = """model = "mu_i"
density = 1500.0
youngs_modulus = 1e7
poisson_ratio = 0.3
static_friction = 0.38
dynamic_friction = 0.64
grain_diameter = 1e-3
grain_density = 2500.0"""
MUD = """model = "bingham"
density = 1500.0
bulk_modulus = 1e6
shear_modulus = 1e5
yield_stress = 50.0
viscosity = 3.0"""


def metal(more):
    """A scene of metal with these lines."""
    return solid('model = "neo_hookean"', 'model = "von_mises"\n' + more)


def other_law(text, old, new):
    """A scene of another law, whose keys `text` gives, with one piece of them replaced."""
    return solid(ELASTIC, change(old, new, text))


def clay(old, new):
    return other_law(CLAY, old, new)


def grains(old, new):
    return other_law(GRAINS, old, new)


def mud(old, new):
    return other_law(MUD, old, new)


LAWS = [
    ("no yield stress", metal(""), ["materials.block.yield_stress is missing", "(Pa)"]),
    ("yield stress zero", metal("yield_stress = 0.0"), ["block.yield_stress = 0.0", "> 0 Pa"]),
    ("softening", metal("yield_stress = 1e3\nhardening_modulus = -1e3"), ["hardening_modulus = -1000.0", ">= 0 Pa"]),
    ("stiffness twice", change(SOUND, SOUND + "\nflow_speed = 1.0"), ["materials.water", "exactly one of sound_speed"]),
    ("flow at rest", change(SOUND, "flow_speed = 0.0"), ["materials.water.flow_speed = 0.0", "> 0 m/s"]),
    ("viscosity below zero", change(SOUND, SOUND + "\nviscosity = -1.0"), ["water.viscosity = -1.0", ">= 0 Pa s"]),
    (
        "cut-off in Pa",
        change(SOUND, SOUND + "\ntension_cutoff = -1e5"),
        ["tension_cutoff = -100000.0", "true or false"],
    ),
    (
        "clay that swells",
        clay("compression_index = 0.1", "compression_index = 0.02"),
        ["compression_index = 0.02", "above"],
    ),
    (
        "clay of nothing",
        clay("initial_pressure = 5e4", ""),
        ["materials.block", "initial_pressure or attraction > 0 Pa"],
    ),
    (
        "clay pressed",
        clay("initial_pressure = 5e4", "initial_pressure = 2e5"),
        ["preconsolidation_pressure = 100000 Pa"],
    ),
    (
        "clay with two slopes",
        clay("swelling", "critical_state_slope = 1.2\nswelling"),
        ["exactly one of critical_state_slope"],
    ),
    ("no swelling", clay("swelling_index = 0.02", "swelling_index = 0"), ["block.swelling_index = 0 ", "> 0"]),
    (
        "friction twice",
        grains("static", "friction_angle = 20.0\nstatic"),
        ["exactly one of static_friction and friction_angle"],
    ),
    ("friction that falls", grains("0.64", "0.3"), ["dynamic_friction = 0.3", "at least the static friction, 0.38"]),
    (
        "grains that overlap",
        grains("grain_density = 2500.0", "grain_density = 1400.0"),
        ["at most grain_density = 1400 kg/m3"],
    ),
    ("grains of no size", grains("1e-3", "0.0"), ["block.grain_diameter = 0.0", "> 0 m"]),
    ("mud without stiffness", mud("bulk_modulus = 1e6", ""), ["materials.block", "exactly one of sound_speed"]),
    ("flow index", mud("viscosity", "flow_index = 0.01\nviscosity"), ["block.flow_index = 0.01", ">= 0.1 and <= 10"]),
    (
        "index of nothing",
        mud("viscosity = 3.0", "viscosity = 0.0\nflow_index = 0.5"),
        ["flow_index = 0.5", "leave flow_index out"],
    ),
    ("yield below zero", mud("yield_stress = 50.0", "yield_stress = -1.0"), ["block.yield_stress = -1.0", ">= 0 Pa"]),
]

BROKEN = [
    *LAWS,
    ("no TOML at all", "time = = 3", ["not valid TOML", "line 1"]),
    ("number without end", change(END, "end = " + "9" * 5000), ["holds a number that cannot be read"]),
    (
        "title that clears the screen",
        'title = "\\u001b[2J"\n' + change('title = "good"\n', ""),
        ["title", "no control characters"],
    ),
    (
        "material with a bell",
        change("[materials.water]", '[materials."a\\u0007"]'),
        ["materials", "no control characters"],
    ),
    ("unclosed list", change(SIZE, "size = [0.6, 0.2"), ["not valid TOML", "line 5"]),
    ("key given twice", change(END, "end = 1.0\nend = 2.0"), ["not valid TOML", "line 12"]),
    ("empty file", "", ["domain is missing", "time is missing", "materials is missing", "bodies is missing"]),
    ("unknown table", change("[output]", "[outputs]"), ["outputs is not a known key", "did you mean output?"]),
    ("unknown key in domain", change("cell_size", "cell_sise"), ["domain.cell_sise", "did you mean cell_size?"]),
    ("unknown key in time", change(END, "end = 1.0\nclf = 0.4"), ["time.clf", "did you mean cfl?"]),
    ("unknown key in body", change("velocity =", "velocty ="), ["bodies[0].velocty", "did you mean velocity?"]),
    ("unknown key in box", change("max = [0.1, 0.1]", "maximum = [0.1, 0.1]"), ["bodies[0].shape.maximum", "max?"]),
    (
        "unknown key in law",
        change(ANGLE, "friction_angel = 30.0"),
        ["materials.sand.friction_angel", "friction_angle?"],
    ),
    ("unknown key in output", change(SNAPSHOT, "snapshot_intervall = 1.0"), ["output.snapshot_intervall", "interval?"]),
    ("key of another law", change(SOUND, SOUND + "\nyoungs_modulus = 1.0"), ["materials.water.youngs_modulus"]),
    ("missing end", change(END, ""), ["time.end is missing", "(s)"]),
    ("missing cell size", change(CELL, ""), ["domain.cell_size is missing", "(m)"]),
    ("missing density", change(DENSITY, ""), ["materials.sand.density is missing", "kg/m3"]),
    ("missing radius", change(", radius = 0.05", ""), ["bodies[1].shape.radius is missing", "(m)"]),
    ("missing model", change('model = "fluid"', ""), ["materials.water.model is missing", "drucker_prager"]),
    ("missing type", change('type = "box", ', ""), ["bodies[0].shape.type is missing", "sphere"]),
    ("missing friction", change(", coefficient = 0.4", ""), ["domain.walls.x_max", "must give the coefficient"]),
    ("empty bodies", GOOD_3D[: GOOD_3D.index("[[bodies]]")].replace("[domain]", "bodies = []\n[domain]"), ["one body"]),
    (
        "bodies as a table",
        solid("[[bodies]]", "[bodies]"),
        ["bodies = {", "must be a list with one table for each body"],
    ),
    ("no materials", solid("[materials.block]", "[materials]\n[ignored]"), ["ignored is not a known key"]),
    ("material as a number", solid("[domain]", "materials.air = 1.2\n[domain]"), ["materials.air = 1.2", "a table"]),
    (
        "domain as a number",
        "domain = 3\n" + GOOD_3D[GOOD_3D.index("[time]") :],
        ["domain = 3 must be a table", "cell_size"],
    ),
    ("negative cell size", change(CELL, "cell_size = -0.0025"), ["domain.cell_size = -0.0025", "> 0 m"]),
    ("zero cell size", change(CELL, "cell_size = 0"), ["domain.cell_size = 0 ", "> 0 m"]),
    ("cell size as text", change(CELL, 'cell_size = "0.0025"'), ['domain.cell_size = "0.0025" must be a number']),
    ("cell size as a list", change(CELL, "cell_size = [0.1, 0.1]"), ["domain.cell_size = [0.1, 0.1] must be a number"]),
    ("cell larger than domain", change(CELL, "cell_size = 0.4"), ["domain.cell_size = 0.4", "size[1] = 0.2 m"]),
    ("broken cells", change(SIZE, "size = [0.601, 0.2]"), ["domain.size[0] = 0.601", "0.6 m (240", "0.6025 m (241"]),
    ("tiny cells", change(CELL, "cell_size = 1e-300"), ["domain.cell_size = 1e-300", "too small", "2147483648 cells"]),
    ("too many in a plane", solid("cell_size = 0.005", "cell_size = 1e-7"), ["cell_size = 1e-07", "in a plane"]),
    ("one number of size", change(SIZE, "size = [0.6]"), ["domain.size = [0.6]", "two or three numbers"]),
    ("size as a number", change(SIZE, "size = 0.6"), ["domain.size = 0.6", "two or three numbers"]),
    ("negative size", change(SIZE, "size = [0.6, -0.2]"), ["domain.size[1] = -0.2", "> 0 m"]),
    ("gravity in 3-D", change(GRAVITY, "gravity = [0, 0, -9.81]"), ["domain.gravity = [0.0, 0.0, -9.81]", "2 numbers"]),
    ("gravity nan", change(GRAVITY, "gravity = [0.0, nan]"), ["domain.gravity[1] = nan", "finite number in m/s2"]),
    ("gravity true", change(GRAVITY, "gravity = [true, 0]"), ["domain.gravity[0] = true", "must be a number"]),
    ("unknown wall", change('x_min = "slip"', 'x_min = "slipp"'), ['walls.x_min = "slipp"', "did you mean slip?"]),
    ("unknown wall in a table", change('type = "friction"', 'type = "rough"'), ['walls.x_max.type = "rough"', "stick"]),
    ("unknown face", change("y_max", "z_max"), ["domain.walls.z_max", "faces: x_min, x_max, y_min, y_max"]),
    ("negative friction", change("coefficient = 0.4", "coefficient = -0.4"), ["x_max.coefficient = -0.4", ">= 0"]),
    ("friction of a slip wall", change('type = "friction"', 'type = "slip"'), ["coefficient = 0.4", "friction wall"]),
    ("wall as a number", change('x_min = "slip"', "x_min = 3"), ["domain.walls.x_min = 3 must be a table"]),
    ("walls as a text", solid("[time]", 'walls = "slip"\n[time]'), ['domain.walls = "slip"', "x_min"]),
    ("unknown axis", change(SIZE, SIZE + '\nperiodic = ["z"]'), ['domain.periodic[0] = "z"', "2-D", "x, y"]),
    ("axis twice", solid("[time]", 'periodic = ["x", "x"]\n[time]'), ['domain.periodic[1] = "x" is named twice']),
    ("wall on a periodic axis", change(SIZE, SIZE + '\nperiodic = ["x"]'), ["domain.walls.x_min", "periodic along x"]),
    ("periodic as text", change(SIZE, SIZE + '\nperiodic = "x"'), ['domain.periodic = "x"', "list of names"]),
    ("end zero", change(END, "end = 0.0"), ["time.end = 0.0", "> 0 s"]),
    ("end infinite", change(END, "end = inf"), ["time.end = inf", "finite number > 0 s"]),
    ("end as a date", change(END, "end = 2024-01-01"), ["time.end = ", "must be a number > 0 s"]),
    ("end too long", change(END, "end = 1" + "0" * 400), ["time.end", "finite number > 0 s"]),
    ("cfl above one", change(END, "end = 1.0\ncfl = 1.5"), ["time.cfl = 1.5", "> 0 and <= 1"]),
    ("negative step", change(END, "end = 1.0\nstep = -1e-5"), ["time.step = -1e-05", "> 0 s"]),
    ("step and cfl", change(END, "end = 1.0\nstep = 1e-5\ncfl = 0.3"), ["time.step = 1e-05", "cfl = 0.3", "one"]),
    ("unknown transfer", change('"apic"', '"apicc"'), ['method.transfer = "apicc"', "did you mean apic?"]),
    ("precision", change('"apic"', '"apic"\nprecision = "double"'), ['method.precision = "double"', "float64"]),
    ("blend of apic", change('"apic"', '"apic"\nflip_blend = 0.99'), ["method.flip_blend = 0.99", "flip and aflip"]),
    ("blend of two", change('"apic"', '"flip"\nflip_blend = 2'), ["method.flip_blend = 2", ">= 0 and <= 1"]),
    ("linear mls", change('"apic"', '"mls"\nshape_function = "linear"'), ['transfer = "mls"', "quadratic or cubic"]),
    ("negative damping", change('"apic"', '"apic"\ndamping = -1'), ["method.damping = -1", ">= 0 1/s"]),
    ("f-bar as a number", change('"apic"', '"apic"\nf_bar = 1'), ["method.f_bar = 1", "true or false"]),
    ("negative ramp", change(END, "end = 1.0\nramp = -1"), ["time.ramp = -1", ">= 0 s"]),
    ("wall velocity in 3-D", change('"friction"', '"friction", velocity = [0, 0, 1]'), ["x_max.velocity", "2 numbers"]),
    (
        "velocity of a free wall",
        change('x_min = "slip"', 'x_min = { type = "free", velocity = [0, 1] }'),
        ["not to free"],
    ),
    (
        "wall velocity of a file",
        change('"friction"', '"friction", velocity = "python:f:1"'),
        ["give f here, from Python"],
    ),
    (
        "open wall in motion",
        change('"slip"', '{ type = "open", velocity = [1, 0] }'),
        ["x_min.velocity", "not to open"],
    ),
    ("unknown key of an inflow", inflow("start", "begin"), ["inflows[0].begin is not a known key", "start, until"]),
    ("inflow of what", inflow('"block"', '"blok"'), ['inflows[0].material = "blok"', "block?"]),
    ("inflow in 2-D", inflow("[0, 0, 1]", "[0, 1]"), ["inflows[0].velocity", "3 numbers"]),
    (
        "random inflow",
        inflow("cell = 8", "cell = 9"),
        ["inflows[0].particles_per_cell = 9", "perfect cube", "8 and 27"],
    ),
    ("inflow that ends first", inflow("until = 0.3", "until = 0.05"), ["inflows[0].until = 0.05", "> start = 0.1 s"]),
    (
        "inflow after the end",
        inflow("until = 0.3", "", "start = 0.1", "start = 0.5"),
        ["inflows[0].start = 0.5", "< 0.4 s"],
    ),
    ("inflow of nothing", inflow("limit = 1e-3", "limit = 0"), ["inflows[0].limit = 0", "> 0 m3"]),
    ("thin inflow", inflow("0.05]", "0.005]"), ["inflows[0].shape", "0.005 m along z", "2 cells = 0.01 m"]),
    ("inflow outside", inflow("0.05]", "0.2]"), ["inflows[0].shape", "out of the domain", "0.2 m along z"]),
    ("inflow along nothing", inflow("velocity = [0, 0, 1]", ""), ["inflows[0].velocity is missing"]),
    ("contact with whom", contact('["sand", "watr"]'), ['contact.pairs[0].materials[1] = "watr"', "water?"]),
    ("contact with one", contact('["sand"]'), ["contact.pairs[0].materials", "2 names"]),
    ("contact with itself", contact('["sand", "sand"]'), ["contact.pairs[0].materials[1]", "named twice"]),
    ("contact of the bonded", contact(head='together = [["sand", "water"]]'), ["contact.pairs[0].materials", "bonded"]),
    (
        "contact of nobody",
        GOOD + '[contact]\ntogether = [["sand", "water"]]\n',
        ["contact", "two materials", "sand and water"],
    ),
    (
        "bonded twice",
        contact(head='together = [["sand", "water"], ["water", "sand"]]'),
        ["contact.together[0][0]", "two groups"],
    ),
    ("bonded to nobody", contact(head='together = [["sad", "water"]]'), ['contact.together[0][0] = "sad"', "sand?"]),
    ("bonded to itself", contact(head='together = [["sand"]]'), ["contact.together[0]", "at least 2 names"]),
    ("groups that are none", contact(head='together = "sand"'), ["contact.together", "list of groups"]),
    ("groups of none", contact(head='together = ["sand"]'), ["contact.together[0]", "list of names"]),
    ("negative friction in contact", contact(head="friction = -0.1"), ["contact.friction = -0.1", ">= 0"]),
    (
        "two frictions",
        contact(more='[[contact.pairs]]\nmaterials = ["water", "sand"]\nfriction = 0.1\n'),
        ["contact.pairs[1].friction = 0.1", "0.2 already", "sand and water"],
    ),
    ("unknown key of contact", contact(head="frictoin = 0.1"), ["contact.frictoin", "friction?"]),
    ("load without a force", GOOD + f"[[loads]]\nshape = {BOX}\n", ["loads[0]", "exactly one of force"]),
    ("load with both", GOOD + f"[[loads]]\nshape = {BOX}\nforce = [1, 0]\nacceleration = [1, 0]\n", ["not both"]),
    ("load in 3-D", GOOD + f"[[loads]]\nshape = {BOX}\nforce = [1, 0, 0]\n", ["loads[0].force", "2 numbers"]),
    ("motion without a velocity", GOOD + f"[[motions]]\nshape = {BOX}\n", ["motions[0].velocity is missing"]),
    ("motion in 3-D", GOOD + f"[[motions]]\nshape = {BOX}\nvelocity = [0, 0, 0]\n", ["motions[0].velocity", "2"]),
    ("body force as text", 'body_force = "gravity"\n' + GOOD, ['body_force = "gravity"', "plain function"]),
    ("body force of a file", 'body_force = "python:b:0"\n' + GOOD, ["body_force", "give b here, from Python"]),
    ("unknown model", change('"fluid"', '"flude"'), ['materials.water.model = "flude"', "did you mean fluid?"]),
    ("poisson half", change("ratio = 0.3", "ratio = 0.5"), ["materials.sand.poisson_ratio = 0.5", "> -1 and < 0.5"]),
    ("poisson below", change("ratio = 0.3", "ratio = -1.5"), ["materials.sand.poisson_ratio = -1.5", "> -1 and < 0.5"]),
    ("no stiffness", change("modulus = 8.4e5", "modulus = 0"), ["materials.sand.youngs_modulus = 0 ", "> 0 Pa"]),
    ("no density", change(DENSITY, "density = 0.0"), ["materials.sand.density = 0.0", "> 0 kg/m3"]),
    (
        "corotated, poisson half",
        corotated("ratio = 0.3", "ratio = 0.5"),
        ["block.poisson_ratio = 0.5", "> -1 and < 0.5"],
    ),
    ("corotated, soft", corotated("modulus = 1e4", "modulus = -1e4"), ["block.youngs_modulus = -10000.0", "> 0 Pa"]),
    ("corotated, no modulus", corotated("youngs_modulus = 1e4", ""), ["block.youngs_modulus is missing", "(Pa)"]),
    ("corotated, light", corotated("density = 1000.0", "density = nan"), ["block.density = nan", "> 0 kg/m3"]),
    ("corotated, friction", corotated("[[bodies]]", "friction_angle = 3.0\n[[bodies]]"), ["block.friction_angle"]),
    ("corotated, misspelt", solid("neo_hookean", "fixed_corotatd"), ['model = "fixed_corotatd"', "fixed_corotated?"]),
    ("steep friction", change(ANGLE, "friction_angle = 90.0"), ["sand.friction_angle = 90.0", ">= 0 and < 90 deg"]),
    (
        "soft rubber",
        solid("youngs_modulus = 1e4", "youngs_modulus = -1e4"),
        ["block.youngs_modulus = -10000.0", "> 0 Pa"],
    ),
    ("incompressible rubber", solid("ratio = 0.3", "ratio = 0.5"), ["materials.block.poisson_ratio = 0.5", "< 0.5"]),
    (
        "rubber without stiffness",
        solid("youngs_modulus = 1e4\n", ""),
        ["materials.block.youngs_modulus is missing", "Pa"],
    ),
    ("rubber that yields", solid("ratio = 0.3", "ratio = 0.3\nyield_stress = 1.0"), ["materials.block.yield_stress"]),
    ("friction fit", change(ANGLE, ANGLE + '\nfriction_fit = "plane"'), ['friction_fit = "plane"', "plane_strain?"]),
    ("flag as a number", change(ANGLE, ANGLE + "\nvolume_correction = 1"), ["volume_correction = 1", "true or false"]),
    ("negative cohesion", change(ANGLE, ANGLE + "\ncohesion = -5.0"), ["materials.sand.cohesion = -5.0", ">= 0 Pa"]),
    (
        "dilatancy of 90 degrees",
        change(ANGLE, ANGLE + "\ndilatancy_angle = 90.0"),
        ["materials.sand.dilatancy_angle = 90.0", ">= 0 and < 90 deg"],
    ),
    (
        "dilatancy above friction",
        change(ANGLE, ANGLE + "\ndilatancy_angle = 31.0"),
        ["materials.sand", "dilatancy_angle = 31 deg", "at most friction_angle = 30 deg", "give energy"],
    ),
    (
        "incompressible hencky",
        solid("poisson_ratio = 0.3", "poisson_ratio = 0.5").replace("neo_hookean", "hencky"),
        ["materials.block.poisson_ratio = 0.5", "> -1 and < 0.5"],
    ),
    (
        "hencky without stiffness",
        solid("youngs_modulus = 1e4", "youngs_modulus = -1e4").replace("neo_hookean", "hencky"),
        ["materials.block.youngs_modulus = -1", "> 0 Pa"],
    ),
    (
        "hencky with a yield stress",
        solid("poisson_ratio = 0.3", "poisson_ratio = 0.3\nyield_stress = 1.0").replace("neo_hookean", "hencky"),
        ["materials.block.yield_stress is not a known key"],
    ),
    (
        "soil without cohesion",
        soil(SOIL.replace("cohesion = 1e3\n", "")),
        ["materials.block.cohesion is missing", "(Pa)"],
    ),
    ("steep soil", soil(SOIL.replace("30.0", "90.0")), ["materials.block.friction_angle = 90.0", ">= 0 and < 90 deg"]),
    (
        "soil that dilates too much",
        soil(SOIL + "dilatancy_angle = 35.0"),
        ["materials.block", "dilatancy_angle = 35 deg", "at most friction_angle = 30 deg", "give energy"],
    ),
    (
        "softened soil that dilates too much",
        soil(SOIL + "dilatancy_angle = 20.0\nresidual_friction_angle = 15.0\nsoftening_strain = 0.1"),
        ["dilatancy_angle = 20 deg", "at most residual_friction_angle = 15 deg"],
    ),
    (
        "softening without strain",
        soil(SOIL + "residual_cohesion = 10.0"),
        ["materials.block", "residual_cohesion = 10 needs softening_strain"],
    ),
    (
        "softening to nothing",
        soil(SOIL + "softening_strain = 0.1"),
        ["materials.block", "softening_strain = 0.1 needs residual_cohesion (Pa) or residual_friction_angle (deg)"],
    ),
    (
        "no softening strain",
        soil(SOIL + "residual_cohesion = 10.0\nsoftening_strain = 0.0"),
        ["materials.block.softening_strain = 0.0", "> 0"],
    ),
    (
        "hardening cohesion",
        soil(SOIL + "residual_cohesion = 2e3\nsoftening_strain = 0.1"),
        ["materials.block", "residual_cohesion = 2000 Pa", "at most cohesion = 1000 Pa"],
    ),
    (
        "hardening friction",
        soil(SOIL + "residual_friction_angle = 40.0\nsoftening_strain = 0.1"),
        ["materials.block", "residual_friction_angle = 40 deg", "at most friction_angle = 30 deg"],
    ),
    (
        "snow without limit in compression",
        snow("critical_compression = 1.0"),
        ["materials.block.critical_compression = 1.0", "> 0 and <= 0.3"],
    ),
    (
        "snow that never stretches",
        snow("critical_stretch = 0.0"),
        ["materials.block.critical_stretch = 0.0", "> 0 and <= 0.3"],
    ),
    ("snow too hard", snow("hardening = 100.0"), ["materials.block.hardening = 100.0", ">= 0 and <= 50"]),
    (
        "snow capped below fresh snow",
        snow("largest_hardening = 0.5"),
        ["materials.block.largest_hardening = 0.5", ">= 1"],
    ),
    (
        "snow with a cap of no hardening",
        snow("hardening = 0.0\nlargest_hardening = 5.0"),
        ["materials.block", "largest_hardening = 5 has nothing to cap", "hardening = 0"],
    ),
    ("no stiffness of fluid", change(SOUND, ""), ["materials.water", "exactly one of sound_speed"]),
    ("two of fluid", change(SOUND, SOUND + "\nbulk_modulus = 1e5"), ["materials.water", "exactly one of sound_speed"]),
    ("unknown material", change('material = "sand"', 'material = "sind"'), ['bodies[0].material = "sind"', "sand?"]),
    ("material by number", change('material = "sand"', "material = 0"), ["bodies[0].material = 0", "in quotes"]),
    ("unknown shape", change('"box"', '"bocks"'), ['bodies[0].shape.type = "bocks"', "did you mean box?"]),
    ("shape as text", change(BOX, '"box"'), ['bodies[0].shape = "box"', "must be a table with a type"]),
    ("negative radius", change("radius = 0.05", "radius = -0.05"), ["bodies[1].shape.radius = -0.05", "> 0 m"]),
    ("empty box", change("max = [0.1, 0.1]", "max = [0.0, 0.1]"), ["bodies[0].shape.max[0] = 0.0", "> min[0] = 0.0 m"]),
    ("box of 3 in 2-D", change(BOX, BOX.replace("]", ", 0.0]", 1)), ["bodies[0].shape.max", "3 numbers like min"]),
    ("3-D disk in 2-D", change("[0.3, 0.1]", "[0.3, 0.1, 0.0]"), ["bodies[1].shape.center", "2 numbers"]),
    ("cylinder in 2-D", change(DISK, CYLINDER), ['bodies[1].shape.type = "cylinder"', "3-D only"]),
    ("axis", solid('axis = "z"', 'axis = "w"'), ['bodies[0].shape.axis = "w"', "x, y, z"]),
    ("axis zero", solid('axis = "z"', "axis = [0, 0, 0]"), ["bodies[0].shape.axis = [0, 0, 0]", "not all zero"]),
    ("nothing to join", change(BOX, '{ type = "union", of = [] }'), ["bodies[0].shape.of", "at least one shape"]),
    ("mistake within", change(DISK, f'{{ type = "union", of = [{DISK[:-6]}0 }}] }}'), ["bodies[1].shape.of[0].radius"]),
    (
        "no overlap",
        change(
            BOX, f'{{ type = "intersection", of = [{BOX}, {{ type = "box", min = [0.2, 0.0], max = [0.3, 0.1] }}] }}'
        ),
        ["bodies[0].shape.of is empty"],
    ),
    ("outside", change("[0.3, 0.1]", "[0.3, 0.16]"), ["bodies[1].shape", "0.11 to 0.21 m along y", "0 to 0.2 m"]),
    ("no mesh file", mesh('file = "nowhere.stl"'), ['shape.file = "nowhere.stl" no such file']),
    ("mesh without file", mesh("scale = 1.0"), ["bodies[0].shape.file is missing"]),
    ("no mesh", mesh(f'file = "{__file__}"'), ["shape.file", "cannot be read"]),
    (
        "3-D mesh",
        change(BOX, f'{{ type = "mesh", file = "{CUBE}" }}'),
        ["shape.file", "is 3-D: a 2-D scene needs polygons"],
    ),
    ("flat mesh", mesh(f'file = "{SQUARE}"'), ["shape.file", "is flat: a 3-D scene needs a surface"]),
    (
        "large mesh",
        mesh(f'file = "{CUBE}"'),
        ["from -1 to 1 m along x", "2 x 2 x 2 m large: scale = 0.05 and move = [0.15, 0.15"],
    ),
    ("mesh scale", mesh(f'file = "{CUBE}", scale = -1'), ["shape.scale = -1 must be a number > 0"]),
    ("mesh of two scales", mesh(f'file = "{CUBE}", scale = [1, 2]'), ["shape.scale = [1.0, 2.0] must have 3 numbers"]),
    ("mesh turned once", mesh(f'file = "{CUBE}", rotate = 90'), ["shape.rotate = 90.0 must be three angles"]),
    ("mesh group", mesh(f'file = "{CUBE}", group = "al"'), ["shape.file", "has no group al; did you mean all?"]),
    ("other mesh", mesh(f'file = "{CUBE}", checksum = "0"'), ["shape.file", "is not the file it was"]),
    ("endless mesh", mesh(f'file = "{CUBE}", scale = 1e300'), ["shape.file", "reaches 1e+300 m"]),
    ("unknown seeding", change(COUNT, 'seeding = "latice"'), ['bodies[1].seeding = "latice"', "did you mean lattice?"]),
    (
        "lattice of five",
        change(COUNT, 'particles_per_cell = 5\nseeding = "lattice"'),
        ["bodies[1].particles_per_cell = 5 fits no lattice", "the nearest that do are 4 and 9"],
    ),
    (
        "quadrature of seven",
        solid("height = 0.05 }", 'height = 0.05 }\nparticles_per_cell = 7\nseeding = "quadrature"'),
        ["particles_per_cell = 7 fits no lattice", "1 and 8"],
    ),
    ("no particles", change(COUNT, "particles_per_cell = 0"), ["bodies[1].particles_per_cell = 0", "from 1 to 4096"]),
    ("many particles", change(COUNT, "particles_per_cell = 4097"), ["particles_per_cell = 4097", "from 1 to 4096"]),
    ("broken particles", change(COUNT, "particles_per_cell = 4.5"), ["particles_per_cell = 4.5", "whole number"]),
    ("true particles", change(COUNT, "particles_per_cell = true"), ["particles_per_cell = true", "whole number"]),
    ("velocity in 3-D", change("velocity = [0.0, 0.0]", "velocity = [0, 0, 0]"), ["bodies[0].velocity", "2 numbers"]),
    ("pressure of sand", change("velocity = [0.0, 0.0]", 'pressure = "hydrostatic"'), ["bodies[0].pressure", "fluid"]),
    ("pressure without gravity", change(GRAVITY, ""), ['bodies[1].pressure = "hydrostatic"', "needs gravity"]),
    ("oblique gravity", change(GRAVITY, "gravity = [1.0, -9.81]"), ["bodies[1].pressure", "[1.0, -9.81] m/s2"]),
    (
        "function in a file",
        change("velocity = [0.0, 0.0]", 'velocity = "python:swirl:0123456789ab"'),
        ["bodies[0].velocity", "is a Python function, which a file does not hold: give swirl"],
    ),
    (
        "displacement in 3-D",
        change("velocity = [0.0, 0.0]", "displacement = [0, 0, 0]"),
        ["bodies[0].displacement = [0.0, 0.0, 0.0]", "2 numbers"],
    ),
    (
        "displacement of words",
        change("velocity = [0.0, 0.0]", 'displacement = ["up", 0]'),
        ['bodies[0].displacement[0] = "up"', "must be a number in m"],
    ),
    (
        "deformation by a number",
        change("velocity = [0.0, 0.0]", "deformation = 1.1"),
        ["bodies[0].deformation = 1.1", "square matrix"],
    ),
    (
        "ragged deformation",
        change("velocity = [0.0, 0.0]", "deformation = [[1, 0], [0, 1, 0]]"),
        ["bodies[0].deformation", "2 numbers in each of its 2 rows"],
    ),
    (
        "deformation in 3-D",
        change("velocity = [0.0, 0.0]", "deformation = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]"),
        ["bodies[0].deformation", "2 x 2 matrix"],
    ),
    (
        "broken deformation",
        change("velocity = [0.0, 0.0]", "deformation = [[1, nan], [0, 1]]"),
        ["bodies[0].deformation[0][1] = nan", "finite number"],
    ),
    (
        "inverted deformation",
        change("velocity = [0.0, 0.0]", "deformation = [[1, 2], [1, 1]]"),
        ["bodies[0].deformation", "no state of drucker_prager", "det F = -1;"],
    ),
    (
        "two starts",
        change("velocity = [0.0, 0.0]", 'deformation = [[1, 0], [0, 1]]\nstress = { type = "geostatic" }'),
        ["bodies[0].deformation excludes stress"],
    ),
    (
        "stress without a type",
        change("velocity = [0.0, 0.0]", "stress = { k0 = 0.5 }"),
        ["bodies[0].stress.type is missing"],
    ),
    (
        "unknown stress",
        change("velocity = [0.0, 0.0]", 'stress = { type = "static" }'),
        ['bodies[0].stress.type = "static"', "geostatic?"],
    ),
    (
        "negative k0",
        change("velocity = [0.0, 0.0]", 'stress = { type = "geostatic", k0 = -0.5 }'),
        ["bodies[0].stress.k0 = -0.5", ">= 0"],
    ),
    (
        "suction as surcharge",
        change("velocity = [0.0, 0.0]", 'stress = { type = "geostatic", surcharge = -5.0 }'),
        ["bodies[0].stress.surcharge = -5.0", ">= 0 Pa"],
    ),
    (
        "depth from words",
        change("velocity = [0.0, 0.0]", 'stress = { type = "geostatic", depth_from = "top" }'),
        ['bodies[0].stress.depth_from = "top"', "number in m"],
    ),
    (
        "misspelt k0",
        change("velocity = [0.0, 0.0]", 'stress = { type = "geostatic", K0 = 0.5 }'),
        ["bodies[0].stress.K0", "did you mean k0?"],
    ),
    (
        "stress beyond yield",
        change("velocity = [0.0, 0.0]", 'stress = { type = "geostatic", k0 = 0.2 }'),
        ["bodies[0].stress is outside the yield surface of drucker_prager", "depth of 0.00625 m"],
    ),
    (
        "stress across gravity",
        change(
            GRAVITY, "gravity = [1.0, -9.81]", change('pressure = "hydrostatic"', 'stress = { type = "geostatic" }')
        ),
        ["bodies[1].stress needs gravity along exactly one axis"],
    ),
    ("unknown pressure", change('"hydrostatic"', '"static"'), ['bodies[1].pressure = "static"', "hydrostatic?"]),
    ("interval zero", change(SNAPSHOT, "snapshot_interval = 0"), ["output.snapshot_interval = 0 ", "> 0 s"]),
    (
        "unknown field",
        change(SNAPSHOT, 'fields = ["velocity", "presure"]'),
        ['output.fields[1] = "presure"', "pressure?"],
    ),
    ("field twice", change(SNAPSHOT, 'fields = ["J", "J"]'), ['output.fields[1] = "J"', "twice"]),
    ("state of another law", solid("[time]", '[output]\nfields = ["v_c"]\n[time]'), ['output.fields[0] = "v_c"']),
    (
        "no time between checkpoints",
        change(SNAPSHOT, "checkpoint_interval = 0.0"),
        ["output.checkpoint_interval = 0.0 must be a number > 0"],
    ),
    (
        "checkpoints every minus a minute",
        change(SNAPSHOT, "checkpoint_wall_interval = -60.0"),
        ["output.checkpoint_wall_interval = -60.0 must be a number", ">= 0"],
    ),
    (
        "no checkpoint kept",
        change(SNAPSHOT, "checkpoint_keep = 0"),
        ["output.checkpoint_keep = 0 must be a whole number from 1 to 1000000"],
    ),
    (
        "a checkpoint at the end of what",
        change(SNAPSHOT, 'checkpoint_at_end = "run"'),
        ['output.checkpoint_at_end = "run" must be true or false'],
    ),
    (
        "displacement of particles that carry no reference",
        change(SNAPSHOT, 'fields = ["displacement"]'),
        ['output.fields[0] = "displacement" is known only where particles carry their reference position'],
    ),
    (
        "plastic strain that no law keeps",
        change(SNAPSHOT, 'fields = ["plastic_strain"]'),
        ['output.fields[0] = "plastic_strain" is kept by no law of this scene: von_mises'],
    ),
    (
        "probe outside",
        GOOD + '[[output.probes]]\nname = "a"\nposition = [0.7, 0.1]\n',
        ["output.probes[0].position[0] = 0.7 m must lie in the domain, from 0 to 0.6 m along x"],
    ),
    (
        "probe in space",
        GOOD + '[[output.probes]]\nname = "a"\nposition = [0.1, 0.1, 0.1]\n',
        ["output.probes[0].position = [0.1, 0.1, 0.1] must have 2 numbers"],
    ),
    (
        "probe without a place",
        GOOD + '[[output.probes]]\nname = "a"\n',
        ["output.probes[0].position is missing: where it is (m)"],
    ),
    (
        "probe named as a path",
        GOOD + '[[output.probes]]\nname = "../a"\nposition = [0.1, 0.1]\n',
        ['output.probes[0].name = "../a" must be a name of 1 to 64 letters'],
    ),
    (
        "two probes of one name",
        GOOD + '[[output.probes]]\nname = "a"\nposition = [0.1, 0.1]\n' * 2,
        ['output.probes[1].name = "a" is the name of probes[0] already'],
    ),
    (
        "unknown gauge",
        GOOD + '[[output.gauges]]\nname = "a"\ntype = "plane"\nposition = [0.1, 0.1]\n',
        ['output.gauges[0].type = "plane" is not known', "surface, section"],
    ),
    (
        "section without axis",
        GOOD + '[[output.gauges]]\nname = "a"\ntype = "section"\nposition = [0.1, 0.1]\n',
        ["output.gauges[0].axis must be given: the axis to which the section is normal"],
    ),
    (
        "section across an axis that is not there",
        GOOD + '[[output.gauges]]\nname = "a"\ntype = "section"\naxis = "z"\nposition = [0.1, 0.1]\n',
        ['output.gauges[0].axis = "z" must be one of x, y in a 2-D scene'],
    ),
    (
        "gauge without gravity",
        change(GRAVITY, "", change('pressure = "hydrostatic"', ""))
        + '[[output.gauges]]\nname = "a"\nposition = [0.1, 0.1]\n',
        ["output.gauges[0].axis must be given: without gravity"],
    ),
    (
        "unknown map",
        change(SNAPSHOT, 'maps = ["depth"]'),
        ['output.maps[0] = "depth" is not a known map', "max_depth?"],
    ),
    (
        "unknown field on nodes",
        change(SNAPSHOT, 'grid_fields = ["mass", "densty"]'),
        ['output.grid_fields[1] = "densty" is not a known field', "density?"],
    ),
    (
        "ids on nodes",
        change(SNAPSHOT, 'grid_fields = ["id"]'),
        ['output.grid_fields[0] = "id" has no mean over particles', "fields on nodes: mass, velocity"],
    ),
    (
        "displacements on nodes that nobody keeps",
        change(SNAPSHOT, 'grid_fields = ["displacement"]'),
        ['output.grid_fields[0] = "displacement" is known only where particles carry their reference position'],
    ),
    (
        "field on nodes twice",
        change(SNAPSHOT, 'grid_fields = ["J", "J"]'),
        ['output.grid_fields[1] = "J" is named twice'],
    ),
    (
        "map without gravity",
        change(GRAVITY, "", change('pressure = "hydrostatic"', "", change(SNAPSHOT, 'maps = ["deposit"]'))),
        ['output.maps[0] = "deposit" needs gravity'],
    ),
    ("copy as word", GOOD + '[guard]\nkeep_copy = "yes"\n', ["guard.keep_copy", "true or false"]),
    ("no steps between copies", GOOD + "[guard]\ninterval = 0\n", ["guard.interval = 0 must be a whole number"]),
    (
        "no such slab axis",
        GOOD + '[parallel]\nslab_axis = "w"\n',
        ['parallel.slab_axis = "w"', "x, y, z"],
    ),
    (
        "slabs across an axis that is not there",
        GOOD + '[parallel]\nslab_axis = "z"\n',
        ['parallel.slab_axis = "z" must be one of x, y in a 2-D scene'],
    ),
    (
        "a collider in an inflow",
        GOOD_3D + INFLOW + '[[colliders]]\nshape = { type = "sphere", center = [0.1, 0.1, 0.05], radius = 0.03 }\n',
        ["inflows[0].shape lies in the collider collider_0, 0."],
    ),
    ("a collider of nothing", GOOD + "[[colliders]]\n", ["colliders[0] must give a shape", "not none"]),
    (
        "a collider's surface",
        GOOD + f'[[colliders]]\nshape = {BOX}\nsurface = "rough"\n',
        ['colliders[0].surface = "rough"', "stick, slip, separate, friction"],
    ),
    (
        "rubbing without a coefficient",
        GOOD + f'[[colliders]]\nshape = {BOX}\nsurface = "friction"\n',
        ["colliders[0].surface", "must give the coefficient"],
    ),
    (
        "a collider that turns in space",
        GOOD + f"[[colliders]]\nshape = {BOX}\nangular_velocity = [0.0, 0.0, 90.0]\n",
        ["colliders[0].angular_velocity", "must be one number in 2-D (deg/s)"],
    ),
    (
        "two colliders of a name",
        GOOD + 2 * f'[[colliders]]\nname = "a"\nshape = {BOX}\n',
        ['colliders[1].name = "a" is the name of another collider'],
    ),
    (
        "a name that heads no column",
        GOOD + f'[[colliders]]\nname = "a,b"\nshape = {BOX}\n',
        ["colliders[0].name", "letters, digits"],
    ),
    (
        "a path back in time",
        GOOD + f"[[colliders]]\nshape = {BOX}\npath = {{ times = [1.0, 0.5], displacements = [[0, 0], [1, 0]] }}\n",
        ["colliders[0].path.times[1] = 0.5 s must be later", "1.0 s"],
    ),
    (
        "a path and a velocity",
        GOOD
        + f"[[colliders]]\nshape = {BOX}\nvelocity = [1, 0]\npath = {{ times = [1.0], displacements = [[0, 0]] }}\n",
        ["colliders[0].path excludes a velocity"],
    ),
    (
        "a plane without a normal",
        GOOD + '[[colliders]]\nshape = { type = "plane", point = [0, 0], normal = [0, 0] }\n',
        ["colliders[0].shape.normal", "must not be zero"],
    ),
    (
        "a body without an end",
        change(BOX, '{ type = "plane", point = [0.1, 0.1], normal = [0, 1] }'),
        ["bodies[0].shape reaches out of the domain", "from -inf to inf m"],
    ),
    (
        "a terrain of no file",
        GOOD + '[[colliders]]\nshape = { type = "terrain", file = "nowhere.npy", spacing = 1.0 }\n',
        ['colliders[0].shape.file = "nowhere.npy"', "no such file"],
    ),
    ("balance as number", GOOD + "[parallel]\nbalance = 1\n", ["parallel.balance", "true or false"]),
    ("title as number", change('title = "good"', "title = 3"), ["title = 3", "text in quotes"]),
]

NOT_BUILT = [
    (
        "implicit steps",
        change('"apic"', '"apic"\nintegrator = "implicit"'),
        ['method.integrator = "implicit" is not built yet', "explicit"],
    ),
]
BROKEN += NOT_BUILT
