"""A scene is one thing, whether it is written in a file, in Python or set on top, and it is complete."""

import pickle
import subprocess
import sys
import tomllib

import numpy as np
import pytest
from broken_scenes import GOOD, GOOD_3D, change

from pmpm.scene import files
from pmpm.scene.errors import NotBuilt, SceneError
from pmpm.scene.schema import Body, Domain, Scene, Time, Wall

BUILTIN = (
    "cantilever",
    "chute_flow",
    "colliding_disks",
    "column_collapse",
    "column_collapse_3d",
    "dam_break",
    "dam_break_3d",
    "dam_break_obstacle",
    "hopper",
    "jet",
    "landslide",
    "mixed_materials",
    "mud_slump",
    "plough",
    "rolling_disk",
    "rotating_drum",
    "sliding_block",
    "slope_failure",
    "snowballs",
    "taylor_bar",
)


@pytest.fixture
def good():
    return Scene.from_text(GOOD)


@pytest.fixture
def good_3d():
    return Scene.from_text(GOOD_3D)


def refusal(**more):
    with pytest.raises(SceneError) as raised:
        Scene.from_text(GOOD, "column.toml", **more)
    return str(raised.value)


def test_the_built_in_scenes_are_these():
    assert tuple(files.builtin_scenes()) == BUILTIN


@pytest.mark.parametrize("name", BUILTIN)
def test_a_built_in_scene_has_a_title_and_is_read(name):
    assert Scene.builtin(name).title


@pytest.mark.parametrize("name", BUILTIN)
def test_a_built_in_scene_names_its_source(name):
    assert "# Source: " in files.builtin_scenes()[name].read_text()


@pytest.mark.parametrize("name", BUILTIN)
def test_a_built_in_scene_has_cells_for_seven_ranks(name):
    assert max(Scene.builtin(name).cells) >= 40


def test_the_dam_break_has_the_measures_of_martin_and_moyce():
    # Phil. Trans. R. Soc. A 244, 312: a = 1 1/8 inch, column a wide and 2a high.
    (water,) = Scene.builtin("dam_break").bodies
    assert np.allclose(water.shape.max, [1.125 * 0.0254, 2 * 1.125 * 0.0254], rtol=1e-12)


def test_a_built_in_scene_takes_overrides():
    assert Scene.builtin("dam_break", {"time.end": 0.5}).time.end == 0.5


def test_an_unknown_built_in_scene_names_the_nearest_one():
    with pytest.raises(SceneError, match="did you mean dam_break?"):
        Scene.builtin("dambreak")


def test_a_directory_does_not_hide_the_built_in_scene(tmp_path, monkeypatch):
    (tmp_path / "dam_break").mkdir()
    monkeypatch.chdir(tmp_path)
    assert files.find_scene("dam_break") == files.builtin_scenes()["dam_break"]


def test_a_file_is_found_before_a_built_in_scene(tmp_path, monkeypatch):
    (tmp_path / "dam_break").write_text(GOOD)
    monkeypatch.chdir(tmp_path)
    assert Scene.from_toml(files.find_scene("dam_break")).title == "good"


def test_a_scene_that_is_nowhere_names_the_nearest_built_in_one():
    with pytest.raises(SceneError, match="dam_breka: no such file, nor a built-in scene; did you mean dam_break?"):
        files.find_scene("dam_breka")


@pytest.mark.parametrize("name", BUILTIN)
def test_a_written_scene_reads_back_equal(name):
    scene = Scene.builtin(name)
    assert Scene.from_text(scene.to_toml()) == scene


@pytest.mark.parametrize("name", BUILTIN)
def test_writing_a_scene_twice_gives_the_same_text(name):
    text = Scene.builtin(name).to_toml()
    assert Scene.from_text(text).to_toml() == text


def test_walls_periodic_axes_and_a_fixed_step_read_back_equal():
    text = change(
        "[time]\nend = 0.4",
        'periodic = ["x"]\nwalls.y_min = {type="friction", coefficient=0.3}\n[time]\nend = 1\nstep = 1e-5',
        GOOD_3D,
    )
    scene = Scene.from_text(text)
    assert Scene.from_text(scene.to_toml()) == scene


def test_nested_shapes_read_back_equal():
    hole = '{ type = "union", of = [{ type = "sphere", center = [0, 0], radius = 0.05 }] }'
    box = '{ type = "box", min = [0.0, 0.0], max = [0.1, 0.1] }'
    scene = Scene.from_text(change(box, f'{{ type = "difference", of = [{box}, {hole}] }}'))
    assert Scene.from_text(scene.to_toml()) == scene


def test_a_scene_survives_pickling(good):
    assert pickle.loads(pickle.dumps(good)) == good


def test_python_keywords_are_the_keys_of_the_file(good):
    assert Scene(**tomllib.loads(GOOD)) == good


def test_parts_may_be_built_one_by_one(good):
    table = tomllib.loads(GOOD)
    bodies = [Body(**body) for body in table.pop("bodies")]
    assert (
        Scene(**table | {"domain": Domain(**table["domain"]), "time": Time(**table["time"]), "bodies": bodies}) == good
    )


def test_numpy_values_are_numbers_like_others(good):
    table = tomllib.loads(GOOD)
    table["domain"] |= {"size": np.array([0.6, 0.2]), "cell_size": np.float64(0.0025)}
    table["bodies"][1]["particles_per_cell"] = np.int64(4)
    assert Scene(**table) == good


def test_none_says_the_same_as_leaving_a_key_out(good):
    table = tomllib.loads(GOOD)
    table["bodies"][0]["particles_per_cell"] = table["materials"]["sand"]["cohesion"] = table["method"] = None
    assert Scene(**table) == good


def test_a_scene_leaves_the_tables_it_is_made_from_alone():
    table = tomllib.loads(GOOD)
    Scene(**table)
    assert table == tomllib.loads(GOOD)


def test_a_body_keeps_its_gaps_when_a_scene_fills_in_its_own():
    body = Body(**tomllib.loads(GOOD)["bodies"][0])
    Scene(**tomllib.loads(GOOD) | {"bodies": [body]})
    assert body.particles_per_cell is None


def test_a_function_for_a_number_is_not_built():
    table = tomllib.loads(GOOD)
    table["time"]["end"] = lambda x: x
    with pytest.raises(NotBuilt, match=r"time.end"):
        Scene(**table)


def test_a_scene_is_frozen(good):
    with pytest.raises(ValueError, match="frozen"):
        good.time.end = 2.0


def test_cells_are_whole_though_the_quotient_is_not():
    assert Scene.builtin("column_collapse").cells == (240, 80)  # 0.6 / 0.0025 = 239.99999999999997


def test_a_byte_order_mark_is_no_mistake(tmp_path):
    (tmp_path / "scene.toml").write_bytes(b"\xef\xbb\xbf" + GOOD.replace("\n", "\r\n").encode())
    assert Scene.from_toml(tmp_path / "scene.toml").title == "good"


def test_walls_not_given_are_separate(good_3d):
    assert {wall.type for wall in good_3d.domain.walls.values()} == {"separate"}


def test_a_friction_wall_has_its_coefficient(good):
    assert good.domain.wall("x_max") == Wall(type="friction", coefficient=0.4)


def test_a_periodic_axis_has_no_walls():
    scene = Scene.from_text(change("[time]", 'periodic = ["y"]\n[time]', GOOD_3D))
    assert sorted(scene.domain.walls) == ["x_max", "x_min", "z_max", "z_min"]


def test_gravity_not_given_is_zero():
    scene = Scene.from_text(change("gravity = [0.0, 0.0, -9.81]", "", GOOD_3D))
    assert scene.domain.gravity == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(("text", "count"), [(GOOD, 4), (GOOD_3D, 8)], ids=["2-D", "3-D"])
def test_a_full_cell_holds_two_particles_along_each_axis_by_default(text, count):
    assert Scene.from_text(text).bodies[0].particles_per_cell == count


def test_velocity_not_given_is_zero(good_3d):
    assert good_3d.bodies[0].velocity == (0.0, 0.0, 0.0)


def test_intervals_not_given_are_parts_of_the_end(good_3d):
    assert (good_3d.output.snapshot_interval, good_3d.output.diagnostics_interval) == (0.4 / 50, 0.4 / 200)


def test_cfl_not_given_is_filled_in(good):
    assert (good.time.cfl, good.time.step) == (0.4, None)


def test_a_fixed_step_leaves_cfl_out():
    scene = Scene.from_text(change("end = 1.0", "end = 1.0\nstep = 1e-5"))
    assert (scene.time.cfl, scene.time.step) == (None, 1e-5)


def test_keys_of_a_law_are_attributes_of_the_material(good):
    assert good.materials["sand"].friction_angle == 30.0


def test_parameters_of_a_material_name_every_key_of_its_law(good):
    assert good.materials["water"].parameters == {
        "density": 1000.0,
        "sound_speed": 15.0,
        "bulk_modulus": None,
        "flow_speed": None,
        "gamma": 7.0,
        "viscosity": 0.0,
        "tension_cutoff": True,
    }


def test_state_of_a_law_in_the_scene_is_a_field():
    scene = Scene.from_text(change("snapshot_interval = 0.02", 'fields = ["v_c", "speed"]'))
    assert scene.output.fields == ("v_c", "speed")


OVERRIDES = [
    ("time.end", 0.5, lambda scene: scene.time.end, 0.5),
    ("method.precision", "float32", lambda scene: scene.method.precision, "float32"),
    ("output.diagnostics_interval", 0.1, lambda scene: scene.output.diagnostics_interval, 0.1),
    ("bodies.0.velocity", [1, 2], lambda scene: scene.bodies[0].velocity, (1.0, 2.0)),
    ("bodies[1].shape.radius", 0.04, lambda scene: scene.bodies[1].shape.radius, 0.04),
    ("bodies.0.velocity.1", 3, lambda scene: scene.bodies[0].velocity, (0.0, 3.0)),
    ("domain.walls.x_max.coefficient", 0.1, lambda scene: scene.domain.wall("x_max").coefficient, 0.1),
    ('materials."sand".density', 2000, lambda scene: scene.materials["sand"].density, 2000.0),
]


@pytest.mark.parametrize(("key", "value", "read", "expected"), OVERRIDES, ids=[case[0] for case in OVERRIDES])
def test_an_override_replaces_one_value(key, value, read, expected):
    assert read(Scene.from_text(GOOD, overrides={key: value})) == expected


def test_an_override_leaves_the_rest_alone(good):
    assert Scene.from_text(GOOD, overrides={"time.end": good.time.end}) == good


def test_an_override_makes_a_table_the_file_lacks():
    assert Scene.from_text(GOOD_3D, overrides={"method.transfer": "mls"}).method.transfer == "mls"


def test_a_wrong_override_says_that_it_was_set_on_top_of_the_file():
    assert refusal(overrides={"time.end": -1}) == (
        "column.toml: time.end = -1 must be a number > 0 s (set on top of the file)"
    )


def test_a_mistake_in_the_file_is_not_blamed_on_an_override():
    with pytest.raises(SceneError) as raised:
        Scene.from_text(change("end = 1.0", "end = -1.0"), overrides={"method.transfer": "mls"})
    assert "on top" not in str(raised.value)


def test_an_unknown_key_in_an_override_names_the_nearest_one():
    assert "did you mean end?" in refusal(overrides={"time.ende": 1})


def test_an_override_beyond_a_list_names_the_range():
    assert "2 must be an index from 0 to 1" in refusal(overrides={"bodies.2.velocity": [0, 0]})


def test_an_override_by_name_in_a_list_names_the_range():
    assert "sand must be an index from 0 to 1" in refusal(overrides={"bodies.sand.velocity": [0, 0]})


def test_an_override_below_a_number_is_refused():
    assert "time.end is no table" in refusal(overrides={"time.end.x": 1})


@pytest.mark.parametrize("key", ["", "a b", "time..end", "=", "time.end\nx"])
def test_what_is_no_key_cannot_be_overridden(key):
    with pytest.raises(SceneError, match="is not a dotted key"):
        Scene.from_text(GOOD, overrides={key: 1})


SETTINGS = [
    ("time.end=0.5", ("time.end", 0.5)),
    ("bodies.0.velocity=[1, 0]", ("bodies.0.velocity", [1, 0])),
    ("method.transfer=mls", ("method.transfer", "mls")),
    ('title = "a = b"', ("title", "a = b")),
    ("title=a=b", ("title", "a=b")),
    ("title=", ("title", "")),
    ("materials.sand.volume_correction=false", ("materials.sand.volume_correction", False)),
    ("title=1\ntime = 2", ("title", "1\ntime = 2")),
]


@pytest.mark.parametrize(("text", "expected"), SETTINGS, ids=[case[0] for case in SETTINGS])
def test_a_setting_is_a_toml_value_or_else_text(text, expected):
    assert files.parse_setting(text) == expected


@pytest.mark.parametrize("text", ["time.end", "=3", ""])
def test_a_setting_without_key_or_value_is_refused_with_an_example(text):
    with pytest.raises(SceneError, match="--set time.end=0.5"):
        files.parse_setting(text)


def test_a_part_alone_complains_in_one_line_too():
    with pytest.raises(SceneError, match=r"^domain: cell_size = -1 must be a number > 0 m$"):
        Domain(size=[1, 1], cell_size=-1)


def test_files_and_settings_need_no_pydantic():
    code = "import sys, pmpm.scene.files, pmpm.scene.errors; sys.exit('pydantic' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
