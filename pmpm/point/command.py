"""`pmpm point`: from the options of the command line to a material and a path, and to what is shown."""

import csv
import math

import numpy as np
from pydantic import ValidationError

from pmpm.output.pictures import figure_class
from pmpm.physics.materials import LAWS
from pmpm.physics.materials.examples import EXAMPLES
from pmpm.point import report
from pmpm.point.driver import Point, Record, drive, follow
from pmpm.point.paths import NONE, PATHS, REQUIRED, courses
from pmpm.scene import files
from pmpm.scene.errors import SceneError
from pmpm.scene.materials import MODELS
from pmpm.scene.messages import known_text, problems_in, scene_error, value_text
from pmpm.scene.schema import Scene

DEFAULT_PATH = "uniaxial_strain"
RATE, STEPS, DIMENSION = 1.0, 200, 3
LARGEST_STRAIN, MOST_STEPS, MOST_CYCLES = 10.0, 100_000, 10_000
LARGEST_INCREMENT = 0.5  # an entry of a file of increments: steps of a simulation are far smaller


def point(options):
    """(text for the screen, failure or None). Raises SceneError for what is wrong with the options."""
    model, keys, dim, typical = chosen_material(options)
    course = chosen_course(options, typical)
    if options.plot:
        figure_class("--plot")  # before all the work
    particle = Point(model, keys, dim)
    record, path = run(particle, course, dim)
    lines = [headline(options, model, keys, dim), course_text(course, dim)]
    if options.out:
        report.write_csv(record, options.out)
        lines.append(f"{record.rows} rows in {options.out}")
    else:
        lines += ["", report.table_text(record, course["rows"])]
    if options.plot and record.rows:
        name = "increments" if path is None else course["path"].replace("_", " ")
        report.draw(record, path, f"{model}: {name}", options.plot)
    return "\n".join(lines), record.failure


def run(particle, course, dim) -> tuple[Record, object]:
    """(record, the path or None) of a point on its course."""
    if course["increments"]:
        increments, times = read_increments(course["increments"], dim)
        return follow(particle, increments, times, course["rate"], course["pressure"]), None
    path = PATHS[course["path"]]
    strains = courses(course["strain"], course["steps"], course["cycles"], course["two_way"])
    return drive(particle, path, strains, course["rate"], course["pressure"]), path


def typical_run(model, dim=DIMENSION, **changes):
    """(record, path, course) of the example of a model on its typical path; for documentation and tests."""
    course = completed({**EXAMPLES[model].path, **changes})
    record, path = run(Point(model, complete_keys(model, {}), dim), course, dim)
    return record, path, course


# ---- the material ----


def chosen_material(options):
    """(model, keys, dimension, typical path) from MATERIAL, --scene, --material and --set."""
    settings = dict(files.parse_setting(text) for text in options.set)
    scene, name = options.scene, options.material
    if options.what is None and scene is None:
        raise SceneError(f"point: give a model, or SCENE:MATERIAL, or --scene and --material; {models_text('')}")
    if options.what is not None and (scene is not None or name is not None):
        raise SceneError(f"point {options.what}: give either MATERIAL or --scene and --material, not both")
    if options.what is not None and options.what not in LAWS and ":" in options.what:
        scene, _, name = options.what.rpartition(":")
    if scene is not None:
        return scene_material(scene, name, settings, options.dimension)
    model = options.what
    if model in LAWS:
        example = EXAMPLES.get(model)
        return model, complete_keys(model, settings), options.dimension or DIMENSION, example.path if example else {}
    if model in files.builtin_scenes() or model.endswith(".toml"):
        raise SceneError(f"point {model}: is a scene; name one of its materials: {model}:NAME")
    raise SceneError(f"point {model}: is no material model; {models_text(model)}, or SCENE:MATERIAL")


def models_text(name):
    return known_text(name, LAWS, "models are")


def complete_keys(model, settings):
    """Keys of the example of a model with `settings` on top, checked, defaults filled in. Raises SceneError.

    Of two keys that exclude each other the given one stays.
    """
    law = LAWS[model]
    known = {key.name for key in law.KEYS}
    example = EXAMPLES.get(model)
    table = {key: value for key, value in (example.keys if example else {}).items() if key in known}
    merged = table | settings
    for key in law.KEYS:
        if key.optional and key.name in table and key.name not in settings and conflicts(model, merged):
            without = {name: value for name, value in merged.items() if name != key.name}
            merged = merged if conflicts(model, without) else without
    try:
        return MODELS[model].model_validate({"model": model} | merged).parameters
    except ValidationError as error:
        raise scene_error(error.errors(include_url=False), model) from None


def conflicts(model, keys):
    """Whether a law says that keys do not fit together; anything else that is wrong with them is found elsewhere."""
    try:
        MODELS[model].model_validate({"model": model} | keys)
    except ValidationError as error:
        return any("fit together" in problem.text for problem in problems_in(error.errors(include_url=False)))
    return False


def scene_material(scene_name, name, settings, dimension):
    """A material of a scene file or built-in scene; `settings` change its keys."""
    path = files.find_scene(scene_name)
    text = files.read_text(path)
    tables = files.parse_toml(text, str(path)).get("materials")
    names = list(tables) if isinstance(tables, dict) else []
    if name is None and len(names) == 1:
        name = names[0]
    if name not in names:
        what = "needs --material" if name is None else f"--material {name}: is not one of the scene"
        raise SceneError(f"{path}: {what}; {known_text(name or '', names, 'its materials are')}")
    scene = Scene.from_text(
        text, str(path), {f'materials."{name}".{key}': value for key, value in settings.items()}, path.parent
    )
    material = scene.materials[name]
    dim = dimension or scene.dim
    return material.model, material.complete(dim).parameters, dim, {}


# ---- the path ----


def completed(given):
    """A course with what is not given filled in from its path."""
    path = PATHS[given.get("path") or DEFAULT_PATH]
    defaults = {
        "path": DEFAULT_PATH,
        "strain": path.strain,
        "rate": RATE,
        "steps": STEPS,
        "cycles": 0,
        "two_way": False,
    }
    defaults |= {"pressure": None, "increments": None, "rows": 21}
    return defaults | {name: value for name, value in given.items() if value is not None}


def chosen_course(options, typical):
    """Path, strain, rate ... of the options, of the material's typical path where no other is asked for."""
    names = ("path", "strain", "rate", "steps", "cycles", "pressure", "increments", "rows")
    given = {name: getattr(options, name) for name in names if getattr(options, name) is not None}
    if options.two_way:
        given["two_way"] = True
    check_word(given.get("path"))
    if "increments" in given:
        for name in ("path", "strain", "steps", "cycles", "two_way"):
            if name in given:
                raise SceneError(
                    f"--{name.replace('_', '-')}: is not for --increments, whose file says all of the path"
                )
        return checked_for_all(completed(given))
    if "path" not in given:
        given = typical | given
    course = completed(given)
    path = PATHS[course["path"]]
    check("strain", course["strain"], "a number from -10 to 10, not 0", 0.0 < abs(course["strain"]) <= LARGEST_STRAIN)
    check("steps", course["steps"], f"a whole number from 1 to {MOST_STEPS}", 1 <= course["steps"] <= MOST_STEPS)
    check("cycles", course["cycles"], f"a whole number from 1 to {MOST_CYCLES}", 0 <= course["cycles"] <= MOST_CYCLES)
    if options.cycles is not None:
        check("cycles", options.cycles, f"a whole number from 1 to {MOST_CYCLES}", options.cycles >= 1)
    if course["two_way"] and not course["cycles"]:
        raise SceneError("--two-way: is for --cycles")
    check_held_pressure(course, path)
    return checked_for_all(course)


def check_word(name):
    if name is not None and name not in PATHS:
        raise SceneError(f"--path {name}: is not known; {known_text(name, PATHS, 'paths are')}")


def check(name, value, allowed, is_allowed):
    if not is_allowed:
        raise SceneError(f"--{name} {value:g}: must be {allowed}")


def checked_for_all(course):
    """The course, if what holds for all paths holds."""
    check("rate", course["rate"], "a number > 0 1/s", 0.0 < course["rate"] < math.inf)
    check("rows", course["rows"], "a whole number >= 2", course["rows"] >= 2)
    if course["pressure"] is not None:
        check("pressure", course["pressure"], "a number >= 0 Pa", 0.0 <= course["pressure"] < math.inf)
    return course


def check_held_pressure(course, path):
    pressure, name = course["pressure"], course["path"]
    if path.pressure == REQUIRED and not pressure:
        raise SceneError(f"--path {name}: needs --pressure, the pressure that is held, a number > 0 Pa")
    if path.pressure == NONE and pressure:
        raise SceneError(
            f"--pressure {pressure:g}: is not for {name}, which has no stress across; did you mean triaxial?"
        )


def read_increments(file, dim):
    """([G], [dt] or None) from a CSV file: a head with dt (s) and entries xx, xy ... of G = dt grad v, and a row per step."""
    rows = list(csv.reader(files.read_text(file).splitlines()))
    rows = [[text.strip() for text in row] for row in rows if any(text.strip() for text in row)]
    if len(rows) < 2:
        raise SceneError(f"{file}: holds no increments: a head such as dt,xx,xy and a row per step are needed")
    entries = [a + b for a in "xyz"[:dim] for b in "xyz"[:dim]]
    head, known = rows[0], ["dt", *entries]
    for name in head:
        if name not in known:
            raise SceneError(
                f"{file}: {value_text(name)} is not a column in {dim}-D; {known_text(name, known, 'columns are')}"
            )
    if len(set(head)) < len(head):
        raise SceneError(f"{file}: a column is named twice in {', '.join(head)}")
    increments, times = [], []
    for number, row in enumerate(rows[1:], 1):
        if len(row) != len(head):
            raise SceneError(f"{file}: row {number} has {len(row)} numbers, the head {len(head)} names")
        values = {name: entry(file, number, name, text) for name, text in zip(head, row, strict=True)}
        increments.append(np.array([values.get(name, 0.0) for name in entries]).reshape(dim, dim))
        times.append(values.get("dt", 0.0))
    return increments, times if "dt" in head else None


def entry(file, number, name, text):
    """One number of a file of increments. Raises SceneError."""
    bound = math.inf if name == "dt" else LARGEST_INCREMENT
    allowed = "a number > 0 s" if name == "dt" else f"a number from -{bound:g} to {bound:g}"
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or abs(value) > bound or name == "dt" and value <= 0.0:
        raise SceneError(f"{file}: row {number}: {name} = {value_text(text)} must be {allowed}")
    return value


# ---- what is said ----


def headline(options, model, keys, dim):
    given = ", ".join(f"{name} = {short_text(value)}" for name, value in keys.items() if value is not None)
    example = EXAMPLES.get(model) if options.what == model and not options.set else None
    return f"{model}{f' ({example.name})' if example else ''}, {dim}-D{' plane strain' if dim == 2 else ''}: {given}"


def short_text(value):
    """A value as TOML, numbers without needless zeros."""
    return f"{value:g}" if isinstance(value, float) else value_text(value)


def course_text(course, dim):
    """One line on the path."""
    if course["increments"]:
        text = f"increments of {course['increments']}"
    else:
        path = PATHS[course["path"]]
        text = f"{course['path']}: {path.meaning}; to {course['strain']:g} in {course['steps']} steps"
        if course["cycles"]:
            plural = "s" if course["cycles"] > 1 else ""
            text += f", {course['cycles']} cycle{plural}{' both ways' if course['two_way'] else ''}"
    pressure = course["pressure"]
    if pressure:
        text += f", first pressure {pressure:g} Pa{' (mean of xx and yy)' if dim == 2 else ''}"
    return f"{text}, rate {course['rate']:g} 1/s"
