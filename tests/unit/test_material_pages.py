"""docs/materials says what the laws say, and docs/theory.md points at what exists."""

import ast
import re

import make_materials
import pytest
from launch import ROOT

from pmpm.physics.materials import LAWS
from pmpm.physics.materials.examples import EXAMPLES

PAGES = make_materials.pages()
POINTER = re.compile(r"`(pmpm/[\w/]+\.py):(\w+(?:\.\w+)?)`")
THEORY = (ROOT / "docs" / "theory.md").read_text(encoding="utf-8")
LARGEST_PICTURE = 60_000  # bytes


@pytest.mark.parametrize("name", PAGES)
def test_the_page_is_what_the_code_says(name):
    file = ROOT / "docs" / "materials" / name
    assert file.exists(), "run python docs/make_materials.py"
    assert file.read_text(encoding="utf-8") == PAGES[name], "run python docs/make_materials.py"


def test_no_page_is_left_of_a_law_that_is_gone():
    assert {file.name for file in (ROOT / "docs" / "materials").glob("*.md")} == set(PAGES)


@pytest.mark.parametrize("model", [model for model in LAWS if model in EXAMPLES])
def test_a_law_with_an_example_has_a_small_picture(model):
    assert 0 < (ROOT / "docs" / "materials" / f"{model}.png").stat().st_size < LARGEST_PICTURE


def defined(file):
    """Names of the functions and classes of a module, methods as Class.method."""
    names = set()
    for node in ast.parse((ROOT / file).read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        if isinstance(node, ast.ClassDef):
            names |= {f"{node.name}.{inner.name}" for inner in node.body if isinstance(inner, ast.FunctionDef)}
    return names


@pytest.mark.parametrize(("file", "name"), sorted(set(POINTER.findall(THEORY))))
def test_the_theory_points_at_functions_that_exist(file, name):
    assert (ROOT / file).exists()
    assert name in defined(file)


def test_every_pointer_of_the_theory_has_the_form_that_is_tested():
    assert len(re.findall(r"pmpm/[\w/]+\.py:", THEORY)) == len(POINTER.findall(THEORY)) > 0
