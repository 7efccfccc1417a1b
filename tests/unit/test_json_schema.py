"""The JSON schema of scene files says what the code that reads them says, as far as one key at a time can be judged."""

import json
import re
import tomllib

import jsonschema
import pytest
from broken_scenes import BROKEN, GOOD, GOOD_3D, change
from launch import ROOT

from pmpm.cli import main
from pmpm.physics.materials import LAWS
from pmpm.scene import files
from pmpm.scene.errors import SceneError
from pmpm.scene.json_schema import scene_schema, schema_text
from pmpm.scene.schema import Scene

SCHEMA = scene_schema()
VALIDATOR = jsonschema.Draft7Validator(SCHEMA)
# What a look at single keys shows: of messages that say so, the schema must refuse the scene, too.
ONE_KEY = re.compile(
    r"is not a known key|is missing: |must be a (finite )?number [<>]|must be a list|must be true or false|"
    r"is not known; |must be a table|must be a whole number|is not a known face"
)
# ... but not where it follows from another key (a key of z in 2-D), or where JSON schema has no word for it.
BEYOND = re.compile(
    r"= (nan|inf)|an integer of|in this 2-D|stress\.k0 is missing|faces: x_min, x_max, y_min, y_max$", re.M
)


def refused(text):
    return not VALIDATOR.is_valid(tomllib.loads(text))


def complaint(text):
    try:
        Scene.from_text(text)
    except SceneError as error:
        return str(error)
    return ""


def test_the_schema_is_a_schema():
    jsonschema.Draft7Validator.check_schema(SCHEMA)


def test_the_committed_schema_is_what_the_code_says():
    assert (ROOT / "docs" / "scene.schema.json").read_text(encoding="utf-8") == schema_text() + "\n"


def test_the_command_prints_the_schema(capsys):
    assert main(["schema"]) == 0
    assert json.loads(capsys.readouterr().out) == SCHEMA


@pytest.mark.parametrize("name", files.builtin_scenes())
def test_a_built_in_scene_fits_the_schema(name):
    VALIDATOR.validate(tomllib.loads(files.builtin_scenes()[name].read_text(encoding="utf-8")))


@pytest.mark.parametrize("text", [GOOD, GOOD_3D])
def test_a_scene_with_all_defaults_filled_in_fits_the_schema(text):
    VALIDATOR.validate(tomllib.loads(Scene.from_text(text).to_toml()))


@pytest.mark.parametrize(("name", "text"), [(name, text) for name, text, _ in BROKEN], ids=[b[0] for b in BROKEN])
def test_what_one_key_gets_wrong_is_refused_by_the_schema(name, text):
    try:
        tomllib.loads(text)
    except ValueError:
        return  # no TOML: editors say so without a schema
    said = complaint(text)
    if ONE_KEY.search(said) and not BEYOND.search(said):
        assert refused(text), said


def test_many_broken_scenes_have_one_wrong_key():
    """Else the test above would be cheap to pass; the others break what more than one key says."""
    kinds = [ONE_KEY.search(complaint(text)) for _, text, _ in BROKEN]
    assert sum(kind is not None for kind in kinds) > 100


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("cell_size = 0.0025", "cell_sise = 0.0025"),
        ("cell_size = 0.0025", 'cell_size = "0.0025"'),
        ("cell_size = 0.0025", "cell_size = 0"),
        ("size = [0.6, 0.2]", "size = [0.6]"),
        ('transfer = "apic"', 'transfer = "apicc"'),
        ('model = "fluid"', 'model = "flude"'),
        ('type = "box", ', ""),
        ('model = "fluid"', ""),
        ('x_min = "slip"', 'x_min = "friction"'),
        ('y_min = "stick"', 'y_mni = "stick"'),
        ("[output]", "[outputs]"),
        ("snapshot_interval = 0.02", 'fields = ["sped"]'),
    ],
)
def test_a_slip_of_the_pen_is_refused(old, new):
    assert not refused(GOOD)
    assert refused(change(old, new))


def test_a_wrong_word_is_called_wrong_by_itself():
    table = tomllib.loads(change('model = "fluid"', 'model = "flude"'))
    said = [error.message for error in VALIDATOR.iter_errors(table)]
    assert any(message.startswith("'flude' is not one of ['neo_hookean', ") for message in said)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("density = 2650.0", "densty = 2650.0", ["'densty' was unexpected", "'density' is a required property"]),
        ("youngs_modulus = 8.4e5", "youngs_modulus = -1.0", ["-1.0 is less than or equal to the minimum of 0"]),
        ("max = [0.1, 0.1]", "maxx = [0.1, 0.1]", ["'maxx' was unexpected", "'max' is a required property"]),
        (
            '{ type = "sphere", center',
            '{ type = "union", of = [{ type = "box", min = [0.0, 0.0] }], center',
            ["('center', 'radius' were unexpected)", "'max' is a required property"],
        ),
    ],
)
def test_a_wrong_key_of_a_material_or_a_shape_is_called_wrong_by_itself(old, new, words):
    said = [error.message for error in VALIDATOR.iter_errors(tomllib.loads(change(old, new)))]
    assert len(said) == len(words)  # and nothing of tables that fit none of those there are
    assert all(any(word in text for text in said) for word in words)


def test_editors_find_all_tables_in_the_choices():
    """They propose the keys of what stands in anyOf, and know nothing of if and then."""
    for told, parts in (
        (SCHEMA["properties"]["materials"]["additionalProperties"], list(LAWS)),
        (SCHEMA["$defs"]["Body"]["properties"]["shape"], ["Box", "Sphere"]),
    ):
        offered = [choice.get("$ref", "").rpartition("/")[2] for choice in told["anyOf"]]
        assert set(parts) <= set(offered)
        assert "oneOf" not in told


def test_functions_are_known_as_keys_of_python_alone():
    assert SCHEMA["properties"]["body_force"]["x-python"]
    assert refused('body_force = "python:b:0"\n' + GOOD)


def test_every_law_has_a_table_with_its_keys_units_and_bounds():
    for model, law in LAWS.items():
        keys = SCHEMA["$defs"][model]["properties"]
        assert list(keys) == ["model", *(key.name for key in law.KEYS)]
        for key in law.KEYS:
            assert keys[key.name].get("x-unit", "-") == key.unit
            assert keys[key.name].get("exclusiveMinimum") == key.above


def test_every_key_says_what_it_means():
    silent = [
        f"{part}.{key}"
        for part, table in SCHEMA["$defs"].items()
        for key, told in table["properties"].items()
        if not told.get("description") and "const" not in told
    ]
    assert silent == []
