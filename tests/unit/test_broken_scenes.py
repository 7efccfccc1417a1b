"""Every mistake in a scene file is told in a line that names file, key, value and what is allowed."""

import pytest
from broken_scenes import BROKEN, GOOD, GOOD_3D, NOT_BUILT, change

from pmpm.scene.errors import NotBuilt, SceneError
from pmpm.scene.files import parse_setting
from pmpm.scene.schema import Scene


def table(cases):
    return pytest.mark.parametrize(("toml", "fragments"), [case[1:] for case in cases], ids=[case[0] for case in cases])


def complaint(toml, kind=SceneError, **more):
    with pytest.raises(kind) as raised:
        Scene.from_text(toml, "column.toml", **more)
    return str(raised.value)


@pytest.mark.parametrize("toml", [GOOD, GOOD_3D], ids=["2-D", "3-D"])
def test_scenes_that_the_mistakes_start_from_are_good(toml):
    assert Scene.from_text(toml).bodies


@table(BROKEN)
def test_message_names_key_value_and_what_is_allowed(toml, fragments):
    message = complaint(toml)
    assert [fragment for fragment in fragments if fragment not in message] == [], message


@table(BROKEN)
def test_every_line_of_a_message_begins_with_the_file(toml, fragments):
    assert all(line.startswith("column.toml: ") for line in complaint(toml).split("\n"))


@table(BROKEN)
def test_message_speaks_no_pydantic(toml, fragments):
    message = complaint(toml).lower()
    assert not [word for word in ("pydantic", "kind:", "validat", "input_value") if word in message]


@table(NOT_BUILT)
def test_what_is_promised_is_refused_as_not_built(toml, fragments):
    complaint(toml, NotBuilt)


@table([case for case in BROKEN if case not in NOT_BUILT])
def test_a_mistake_is_not_excused_as_not_built(toml, fragments):
    with pytest.raises(SceneError) as raised:
        Scene.from_text(toml)
    assert not isinstance(raised.value, NotBuilt)


def test_several_mistakes_stand_on_a_line_each():
    message = complaint(change("end = 1.0", "end = -1.0", change("density = 2650.0", "density = -2650.0")))
    assert len(message.split("\n")) == 2


def test_more_than_five_mistakes_are_counted():
    bodies = "".join('[[bodies]]\nmaterial = "sand"\nshape = { type = "blob" }\n' for _ in range(9))
    toml = GOOD[: GOOD.index("[[bodies]]")] + bodies
    assert complaint(toml).split("\n")[5:] == ["column.toml: and 4 more"]


def test_a_mistake_beside_something_not_built_is_a_mistake():
    toml = change("end = 1.0", "end = -1.0", change('"apic"', '"apic"\nintegrator = "implicit"'))
    with pytest.raises(SceneError, match="time.end") as raised:
        Scene.from_text(toml)
    assert not isinstance(raised.value, NotBuilt)


def test_a_long_value_is_cut_short():
    assert len(complaint(change('"apic"', f'"{"a" * 1000}"'))) < 200


def test_a_setting_of_several_lines_is_told_in_one():
    with pytest.raises(SceneError) as raised:
        parse_setting('=type = "union"\n\n[[v.of]]')
    assert "\n" not in str(raised.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(SceneError, match="nowhere.toml: no such file"):
        Scene.from_toml(tmp_path / "nowhere.toml")


def test_a_directory_is_no_scene_file(tmp_path):
    with pytest.raises(SceneError, match="is a directory"):
        Scene.from_toml(tmp_path)


def test_a_file_that_is_not_utf8_is_told_with_the_place(tmp_path):
    (tmp_path / "latin.toml").write_bytes(b'title = "S\xe4ule"')
    with pytest.raises(SceneError, match=r"latin.toml: is not UTF-8 text: byte 0xe4 at 10"):
        Scene.from_toml(tmp_path / "latin.toml")


def test_an_endlessly_nested_file_is_refused():
    assert "nested too deeply" in complaint("title = " + "[" * 100_000)


def test_python_keywords_are_checked_like_a_file():
    with pytest.raises(SceneError, match=r"^scene: time.end = -1 must be a number > 0 s$"):
        Scene(
            domain={"size": [1, 1], "cell_size": 0.1},
            time={"end": -1},
            materials={"a": {"model": "neo_hookean", "density": 1, "youngs_modulus": 1, "poisson_ratio": 0}},
            bodies=[{"material": "a", "shape": {"type": "box", "min": [0, 0], "max": [1, 1]}}],
        )
