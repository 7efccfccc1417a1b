"""No text of a scene reaches the file system or is executed; --out and the scene's own path may be anything."""

import ast
import os
from pathlib import Path
from xml.etree import ElementTree

import drawn_scenes as drawn
import pytest
import verdict

import pmpm

SCENE = """
title = {title}
[domain]
size = [0.2, 0.2]
cell_size = 0.02
[time]
end = 0.01
[materials.{name}]
model = "fluid"
density = 1000.0
sound_speed = 15.0
[[bodies]]
material = {name}
shape = {{ type = "box", min = [0.05, 0.05], max = [0.15, 0.15] }}
"""
HOSTILE = (
    "../../outside", "/tmp/outside", "..", "~/outside", "$(touch outside)", "`touch outside`", "; touch outside #",
    "| touch outside", "__import__('os').system('touch outside')", "{0.__class__.__init__.__globals__}", "%(outside)s %n",
    "snapshots/000000.hdf", "python:outside:0123456789ab", "<!ENTITY x SYSTEM 'outside'>", "\\u202eoutside", "a\\nb",
    "\\u0000outside", "\\u001b[2Joutside",
)  # fmt: skip
PATH_WORDS = ("path", "file", "folder", "directory", "dir", "out", "url", "command", "import", "module")
FORBIDDEN_CALLS = ("eval", "exec", "compile", "__import__", "input")
FORBIDDEN_MODULES = ("pickle", "cPickle", "dill", "marshal", "shelve", "yaml", "joblib")
FORBIDDEN_ATTRIBUTES = ("system", "popen")


@pytest.fixture
def here(tmp_path, monkeypatch):
    """The working folder, deep enough that .. and ../.. are seen, with a good scene in it."""
    folder = tmp_path / "above" / "here"
    folder.mkdir(parents=True)
    monkeypatch.chdir(folder)
    write("drop.toml")
    return folder


def write(path, title="a drop", name="water"):
    Path(path).write_text(SCENE.format(title=f'"{title}"', name=f'"{name}"'), encoding="utf-8")


def tree(folder):
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


def ends(arguments, *allowed):
    """The Outcome of a command that must end with one of these statuses, and as it should."""
    outcome = verdict.run(arguments, verdict.COMPILING)
    assert verdict.complaints(outcome, allowed) == []
    return outcome


def ran(scene, *more):
    return ends(["run", scene, "--quiet", "--steps", "1", *more], 0, 2)


# ---- what a scene says --------------------------------------------------------------------------------


def test_no_key_of_a_scene_names_a_file_but_those_of_maps_and_meshes_that_are_read():
    naming = {(table, key) for table, key in drawn.all_keys() if set(key.lower().split("_")) & set(PATH_WORDS)}
    motion = {("Collider", "path")}  # times and places
    assert naming - motion == {("Terrain", "file"), ("Mesh", "file"), ("Particles", "file")}


@pytest.mark.parametrize("place", ["title", "name"])
@pytest.mark.parametrize("text", HOSTILE)
def test_a_run_writes_only_into_its_folder_whatever_its_scene_says(here, place, text):
    write("hostile.toml", **{place: text})
    before = tree(here.parent.parent)
    ran("hostile.toml", "--out", "out")
    ends(["check", "hostile.toml"], 0, 2)
    if Path("out").exists():
        ends(["info", "out"], 0)
        ElementTree.parse("out/snapshots.xdmf")  # what ParaView opens
    strangers = tree(here.parent.parent) - before
    assert {name for name in strangers if not name.startswith("above/here/out")} == set()


@pytest.mark.parametrize("text", HOSTILE)
def test_a_text_in_the_place_of_a_function_is_refused(here, text):
    setting = f"bodies.0.velocity='{text}'" if "'" not in text else f'bodies.0.velocity="{text}"'
    assert "bodies[0].velocity" in ends(["check", "drop.toml", "--set", setting], 2).err
    assert tree(here) == {"drop.toml"}


# ---- where it is, and where it goes --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "out",
    ["a b", "ü𝕏", "a\nb", "--help", "-", "*", "out/", "./out", "a/b/c", ".hidden", "$HOME", "x" * 200, "'\"", "%s{}"],
)
def test_an_odd_name_for_the_folder_is_a_name(here, out):
    ran("drop.toml", f"--out={out}")
    assert (here / out / "run.json").is_file()


@pytest.mark.parametrize(
    "out",
    ["x" * 300, "x/" * 2100, "drop.toml", "drop.toml/x", ".", "..", "/", "/dev/null", "/proc/x", "loop", "loop/x"],
)
def test_a_folder_that_cannot_be_is_refused(here, out):
    Path("loop").symlink_to("loop")
    before = tree(here.parent.parent)
    assert ran("drop.toml", f"--out={out}").status == 2
    assert tree(here.parent.parent) == before


@pytest.mark.parametrize("scene", ["../drop.toml", "../here/drop.toml", "./drop.toml"])
def test_a_scene_from_elsewhere_runs_into_this_folder(here, scene):
    write("../drop.toml")
    ran(scene)
    assert tree(here.parent) - {"here", "drop.toml", "here/drop.toml"} == {
        f"here/{name}" for name in ("drop", *(f"drop/{name}" for name in tree(here / "drop")))
    }


@pytest.mark.parametrize(
    "scene",
    ["...toml", "..", ".", "/", "", "x" * 300, "x" * 5000, "a/" * 3000, "loop", "loop/x", "drop.toml/x", "nowhere"],
)
@pytest.mark.parametrize("command", ["run", "check"])
def test_a_scene_that_is_no_file_is_refused(here, command, scene):
    Path("loop").symlink_to("loop")
    ends([command, scene], 2)


def test_a_scene_whose_name_leaves_no_name_for_the_folder_stays_where_it_is(here):
    write("...toml")
    before = tree(here.parent.parent)
    assert ran("...toml").status == 2
    assert tree(here.parent.parent) == before


def test_a_scene_file_without_end_is_refused(here):
    assert "longer than 16 MB" in ends(["check", "/dev/zero"], 2).err


def test_a_pipe_that_nobody_writes_to_is_refused_after_a_while(here, monkeypatch):
    monkeypatch.setattr("pmpm.scene.files.PATIENCE", 0.2)
    os.mkfifo("pipe")
    assert "nothing came" in ends(["check", "pipe"], 2).err


def test_a_scene_comes_out_of_a_pipe(here):
    reading, writing = os.pipe()
    os.write(writing, Path("drop.toml").read_bytes())
    os.close(writing)
    ends(["check", f"/dev/fd/{reading}"], 0)
    os.close(reading)


@pytest.mark.parametrize("path", ["x" * 300, "x" * 5000, "loop", "drop.toml", ".", "/dev/null", "/dev/zero", "nowhere"])
def test_what_is_no_run_is_not_described(here, path):
    Path("loop").symlink_to("loop")
    ends(["info", path], 2)


# ---- what pmpm is made of --------------------------------------------------------------------------------


def calls_and_imports(path):
    """Names of what a file calls by a bare name, or lets a shell do, and of the modules that it imports."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            yield node.func.id
        elif isinstance(node, ast.Call) and any(keyword.arg == "shell" for keyword in node.keywords):
            yield "shell"
        elif isinstance(node, ast.Attribute) and node.attr in FORBIDDEN_ATTRIBUTES:
            yield node.attr
        elif isinstance(node, ast.Import):
            yield from (f"import {alias.name.split('.')[0]}" for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield f"import {(node.module or '').split('.')[0]}"


def test_pmpm_neither_evaluates_text_nor_loads_objects():
    """The one text that is executed is of names of the arguments of functions, which Python has read before."""
    forbidden = {"shell", *FORBIDDEN_CALLS, *FORBIDDEN_ATTRIBUTES, *(f"import {name}" for name in FORBIDDEN_MODULES)}
    files = list(Path(pmpm.__file__).parent.rglob("*.py"))
    assert len(files) > 50
    found = {path.name: set(calls_and_imports(path)) & forbidden for path in files}
    assert {name: names for name, names in found.items() if names} == {"own_law.py": {"exec"}}
