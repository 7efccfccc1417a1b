"""docs/scene_reference.md names every key that a scene file may hold, as the code has it."""

import make_scene_reference
from launch import ROOT

from pmpm.physics.materials import LAWS
from pmpm.scene.json_schema import scene_schema

PAGE = make_scene_reference.page()
DOCS = ROOT / "docs"


def test_the_page_is_what_the_code_says():
    committed = (DOCS / "scene_reference.md").read_text(encoding="utf-8")
    assert committed == PAGE, "run python docs/make_scene_reference.py"


def test_every_part_of_the_schema_has_a_section_or_a_page_of_its_own():
    for name in scene_schema()["$defs"]:
        assert f"\n## {name}\n" in PAGE or name in LAWS


def test_every_key_has_a_row_with_its_unit():
    for name, part in scene_schema()["$defs"].items():
        if name not in LAWS:
            section = PAGE.split(f"\n## {name}\n")[1].split("\n## ")[0]
            for key, told in part["properties"].items():
                (row,) = [line for line in section.splitlines() if line.startswith(f"| `{key}` ")]
                assert row.split(" | ")[2].strip() == told.get("x-unit", "")
