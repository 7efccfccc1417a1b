"""Write docs/scene_reference.md and docs/scene.schema.json: every key of a scene file, from the code that checks it.

    python docs/make_scene_reference.py

Run it after a change to a key; tests/unit/test_scene_reference.py and test_json_schema.py compare both files with the code.
"""

from pathlib import Path

from pmpm.physics.materials import LAWS
from pmpm.scene.json_schema import scene_schema, schema_text
from pmpm.scene.messages import value_text

DOCS = Path(__file__).parent
HEAD = """# All keys of a scene file

`python docs/make_scene_reference.py` wrote this page from the code that checks a scene. What the keys mean together, and why
one would set them, is told in [the scene file](scene.md); a key that is not here is refused with the nearest one that is.
SI units, angles in degrees. In Python the same keys are keyword arguments of `pmpm.Scene`.

## In an editor

`pmpm schema` prints the same as a JSON schema, [scene.schema.json](scene.schema.json). Editors that know it complete keys and
words, show what a key means and its unit, and underline what is wrong before anything is run: Even Better TOML (VS Code),
Taplo (its language server in any editor, and `taplo lint` on the command line) and others. Put it beside your scenes

```sh
pmpm schema > scene.schema.json
```

and name it in the first line of a scene:

```toml
#:schema ./scene.schema.json
title = "A scene of mine"
```

It judges one key at a time. What keys mean together (that a body lies in the domain, that its material exists) is what
`pmpm check` finds.

"""
ROW = "| key | type | unit | allowed | default | meaning |\n| --- | --- | --- | --- | --- | --- |"
CHOICES = ("anyOf", "allOf")
MOST_LINKS = 3
KINDS = {"number": "number", "integer": "whole number", "string": "text", "boolean": "true or false"}


def page():
    """The text of docs/scene_reference.md."""
    schema = scene_schema()
    places = places_of(schema)
    sections = [section("The whole file", schema, ())]
    sections += [section(name, schema["$defs"][name], where) for name, where in places.items() if name not in LAWS]
    return HEAD + "\n".join(sections)


def places_of(schema):
    """{part of the schema: places in the file at which it stands}, in the order in which a reader meets them."""
    places = {}

    def visit(told, where):
        for name, place in references(told, where):
            known = name in places
            places.setdefault(name, []).append(place)
            if not known:
                visit(schema["$defs"][name], place)

    visit(schema, "")
    return places


def references(told, where):
    """Yield (part, place) of what a part of the schema refers to, straight or in lists, choices and tables of names."""
    if "$ref" in told:
        yield told["$ref"].rpartition("/")[2], where
    for key, inner in told.get("properties", {}).items() if not alike(told) else ():
        yield from references(inner, f"{where}.{key}" if where else key)
    if alike(told):
        yield from references(next(iter(told["properties"].values())), f"{where}.NAME")
    for word in ("items", "additionalProperties"):
        if isinstance(told.get(word), dict):
            yield from references(told[word], where + ("[]" if word == "items" else ".NAME"))
    for word in CHOICES:
        for inner in told.get(word, ()):
            yield from references(inner, where)


def alike(told):
    """Whether a table takes the same under each of its names, as that of walls."""
    inner = list(told.get("properties", {}).values())
    return len(inner) > 1 and all(one == inner[0] for one in inner)


def section(name, told, where):
    """The heading, the places and the table of one part."""
    lines = [f"## {name}", ""]
    about = [cell(told["description"])] if where and "description" in told else []
    if where:
        here = [place for place in where if not place.endswith(".of[]")]
        more = ", or inside another shape" if len(here) < len(where) else ""
        about.append(f"Stands at {', '.join(f'`{place}`' for place in dict.fromkeys(here))}{more}.")
    lines += [" ".join(about), ""] if about else []
    lines += [ROW, *(row(key, inner, key in told.get("required", ())) for key, inner in told["properties"].items()), ""]
    return "\n".join(lines)


def row(key, told, required):
    default = "required" if required else value_text(told["default"]) if "default" in told else ""
    default = "" if told.get("x-python") and not required else default
    unit = told.get("x-unit", "")
    meaning = told.get("description", "which kind it is" if "const" in told else "")
    meaning = meaning.removesuffix(f"({unit})").rstrip() if unit else meaning
    return f"| `{key}` | {kind(told)} | {unit} | {allowed(told)} | {code(default)} | {cell(meaning)} |"


def code(default):
    return default if default in ("", "required") else f"`{default}`"


def kind(told):
    """What kind of value it is, with links to the parts that it is made of."""
    if told.get("x-python"):
        return "function, from Python"
    if "const" in told or "enum" in told:
        return "word"
    parts = [name for name, _ in references({word: told[word] for word in CHOICES if word in told}, "")]
    if parts or "$ref" in told:
        words = "word or " if "anyOf" in told and "if" not in told else ""
        return words + "table: " + links(parts or [told["$ref"].rpartition("/")[2]])
    if told.get("type") == "array":
        return list_kind(told)
    if told.get("type") == "object":
        inner = told.get("additionalProperties") or next(iter(told["properties"].values()))
        laws = [name for name, _ in references(inner, "")]
        return "table of names, each " + (
            "a table: [the laws](materials/README.md)" if set(laws) & set(LAWS) else kind(inner)
        )
    if "anyOf" in told:
        return " or ".join(kind(choice) for choice in told["anyOf"])
    return KINDS.get(told.get("type"), "value")


def list_kind(told):
    items, low, high = told.get("items", {}), told.get("minItems", 0), told.get("maxItems")
    if items.get("type") == "array":
        words = items.get("items", {}).get("type") == "string"
        return (
            "square matrix of 2 or 3 rows" if "anyOf" in told else f"list of lists of {'words' if words else 'numbers'}"
        )
    if items.get("type") == "number" or not items:
        return (
            "numbers"
            if high is None
            else f"{low} numbers"
            if low == high
            else f"{low} {'or' if high == low + 1 else 'to'} {high} numbers"
        )
    return "list of words" if "enum" in items else "list: " + kind(items).removeprefix("table: ")


def links(names):
    linked = [f"[{name}](#{name.lower().replace(' ', '-')})" for name in names]
    return f"one of {linked[0]} to {linked[-1]}" if len(names) > MOST_LINKS else ", ".join(linked)


def allowed(told):
    """Bounds and words."""
    if told.get("type") == "array":
        return allowed(told.get("items", {}))
    words = told.get("enum", ())
    for choice in told.get("anyOf", ()):
        words = [*words, *choice.get("enum", ())]
    if "if" in told:
        return "; ".join(f"`{key}`: {allowed(inner)}" for key, inner in told.get("properties", {}).items())
    if told.get("type") == "object" and "properties" in told:
        faces = f"keys {', '.join(f'`{key}`' for key in told['properties'])}"
        return f"{faces}; {allowed(next(iter(told['properties'].values())))}"
    if words:
        return ", ".join(f"`{value_text(word)}`" for word in words)
    if "const" in told:
        return f"`{value_text(told['const'])}`"
    signs = {"exclusiveMinimum": "> ", "minimum": ">= ", "exclusiveMaximum": "< ", "maximum": "<= "}
    return " and ".join(f"{sign}{told[word]:.10g}" for word, sign in signs.items() if word in told)


def cell(text):
    """Text that stands in a table as it is."""
    return text.replace("|", r"\|").replace("_", r"\_").replace("*", r"\*")


def main():
    (DOCS / "scene_reference.md").write_text(page(), encoding="utf-8")
    (DOCS / "scene.schema.json").write_text(schema_text() + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
