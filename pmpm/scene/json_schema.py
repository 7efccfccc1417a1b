"""The scene file as a JSON schema (draft 7), made from the parts that check it: for editors and docs/scene_reference.md.

It says what one key may hold, not what several keys mean together; `x-unit` is the unit of a value and `x-python` marks keys
that only a scene from Python has. Neither is a word of JSON schema: validators pass over them.
"""

import json
from typing import Any

from pmpm.scene.schema import Scene

DRAFT = "http://json-schema.org/draft-07/schema#"  # the newest that editors of TOML know well


def schema_text() -> str:
    """Return the text of docs/scene.schema.json."""
    return json.dumps(scene_schema(), indent=1, ensure_ascii=False)


def scene_schema() -> dict[str, Any]:
    """Return the JSON schema of a scene file."""
    told = Scene.model_json_schema()
    parts = {name: tidy(part) for name, part in told.pop("$defs").items()}
    head = {"$schema": DRAFT, "title": "pmpm scene", "description": "A run of pmpm: SI units, angles in degrees."}
    return name_kinds(tidy(told) | head | {"$defs": parts}, parts)


def name_kinds(told: Any, parts: dict[str, Any]) -> Any:
    """Say of each choice of tables which word tells them apart, and what follows from it: a wrong word or key
    is then called wrong, in place of all of its table."""
    if isinstance(told, list):
        return [name_kinds(inner, parts) for inner in told]
    if not isinstance(told, dict):
        return told
    told = {word: name_kinds(value, parts) for word, value in told.items()}
    tables = [parts.get(choice.get("$ref", "").rpartition("/")[2], {}) for choice in told.get("oneOf", ())]
    words = [{k: v["const"] for k, v in table.get("properties", {}).items() if "const" in v} for table in tables]
    for key in sorted(set.intersection(*map(set, words)))[:1] if words else ():
        # Of if and then editors of TOML know no keys to propose: these they take from the choice, which refuses nothing.
        choices = told.pop("oneOf")
        told["anyOf"] = [*choices, {"type": "object"}]
        told |= {"type": "object", "properties": {key: {"enum": [word[key] for word in words]}}, "required": [key]}
        told |= chain(key, [(word[key], choice) for word, choice in zip(words, choices, strict=True)])
    return told


def chain(key: str, choices: list[tuple[str, Any]]) -> dict[str, Any]:
    """If the key is the first word, then the first table, else the same of the others."""
    if not choices:
        return {}
    (word, table), *others = choices
    is_word = {"properties": {key: {"const": word}}, "required": [key]}
    return {"if": is_word, "then": table} | ({"else": chain(key, others)} if others else {})


def tidy(told: dict[str, Any]) -> dict[str, Any]:
    """Return what pydantic tells without what TOML has no word for, and as draft 7 spells it."""
    kept = {word: tidy_value(word, value) for word, value in told.items() if word != "title"}
    if kept.get("default", 0) is None or isinstance(kept.get("default"), dict):
        del kept["default"]
    if "const" in kept:
        kept.pop("enum", None)  # which older versions of pydantic add
    if "properties" in kept:
        # A word that tells tables apart must stand in the file, though Python fills it in.
        words = [key for key, value in kept["properties"].items() if "const" in value]
        kept["required"] = list(dict.fromkeys((*words, *kept.get("required", ()))))
        for word in words:
            kept["properties"][word].pop("default", None)
    if not kept.get("required", True):
        del kept["required"]
    choices = [choice for choice in kept.get("anyOf", ()) if choice != {"type": "null"}]
    if len(choices) == 1:
        del kept["anyOf"]
        kept = choices[0] | kept
    elif choices:
        kept["anyOf"] = choices
    if "$ref" in kept and len(kept) > 1:
        # Beside a reference, draft 7 hears nothing else.
        kept.pop("default", None)
        kept = {"allOf": [{"$ref": kept.pop("$ref")}], **kept}
    return kept


def tidy_value(word: str, value: Any) -> Any:
    if word == "properties":
        return {key: tidy(part) for key, part in value.items()}
    if word == "description":
        return " ".join(value.split())
    if word in ("anyOf", "oneOf", "allOf"):
        return [tidy(part) for part in value]
    return tidy(value) if word in ("items", "additionalProperties", "not") and isinstance(value, dict) else value
