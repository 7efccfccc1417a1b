"""Contact: which materials are bonded where they touch, and which slide on each other or part, with how much friction."""

import itertools
from collections.abc import Iterator, Mapping
from typing import Annotated, Any

from pydantic import Field

from pmpm.scene.messages import Problem, Problems, known_text
from pmpm.scene.part import Part
from pmpm.scene.values import Checked, names, number, tables

FRICTION = number(at_least=0.0)


def check_groups(value: Any) -> Any:
    if not isinstance(value, list | tuple):
        raise Problems(Problem((), 'must be a list of groups like [["sand", "clay"]]', value))
    return tuple(value)


class Pair(Part):
    """Two materials with friction of their own."""

    materials: Annotated[tuple[str, ...], names(least=2, most=2)] = Field(description="names of the two materials")
    friction: Annotated[float, FRICTION] = Field(description="coefficient of Coulomb friction between them")


class Contact(Part):
    """Contact between bodies of different materials: they slide on each other and part, instead of being bonded."""

    friction: Annotated[float, FRICTION] = Field(
        default=0.0, description="coefficient of Coulomb friction between materials without one of their own"
    )
    together: Annotated[
        tuple[Annotated[tuple[str, ...], names(least=2)], ...], Checked(check_groups, told=lambda inner: inner)
    ] = Field(default=(), description="groups of materials that are bonded to each other")
    pairs: Annotated[tuple[Pair, ...], tables("pair", least=0)] = Field(
        default=(), description="one table [[contact.pairs]] for each two materials with friction of their own"
    )

    def velocity_fields(self, materials: tuple[str, ...]) -> dict[str, int]:
        """Return the number of the velocity field of each of these materials: each its own, but for those that are bonded."""
        fields: dict[str, int] = {}
        for material in materials:
            bonded = self.field_of(material, fields)
            fields[material] = len(set(fields.values())) if bonded is None else bonded
        return fields

    def field_of(self, material: str, fields: Mapping[str, int]) -> int | None:
        """Return the velocity field that a material shares with one of these, None if with none."""
        bonded = [other for group in self.together if material in group for other in group]
        return next((fields[other] for other in (material, *bonded) if other in fields), None)

    def frictions(self, fields: Mapping[str, int]) -> dict[tuple[int, int], float]:
        """Return the coefficient of friction between each two of these velocity fields."""
        found = dict.fromkeys(itertools.combinations(sorted(set(fields.values())), 2), self.friction)
        for pair in self.pairs:
            one, other = (self.field_of(material, fields) for material in pair.materials)
            if one is not None and other is not None:
                found[min(one, other), max(one, other)] = pair.friction
        return found

    def wrong_contact(self, known: Mapping[str, Any], used: tuple[str, ...]) -> Iterator[Problem]:
        """Yield what does not fit a scene with the `known` materials, of which bodies and inflows have those `used`."""
        named: list[tuple[tuple[str | int, ...], str]]
        named = [(("together", i, j), name) for i, group in enumerate(self.together) for j, name in enumerate(group)]
        named += [
            (("pairs", i, "materials", j), name) for i, p in enumerate(self.pairs) for j, name in enumerate(p.materials)
        ]
        unknown = [(path, name) for path, name in named if name not in known]
        for path, name in unknown:
            yield Problem(path, f"is not a material of this scene; {known_text(name, known, 'materials')}", name)
        grouped = [name for group in self.together for name in group]
        for path, name in named:
            if path[0] == "together" and grouped.count(name) > 1:
                yield Problem(path, "stands in two groups: put them into one", name)
        if unknown or len(set(grouped)) < len(grouped):
            return
        everyone = self.velocity_fields(tuple(known))
        told: dict[tuple[int, ...], Pair] = {}
        for index, pair in enumerate(self.pairs):
            between = tuple(sorted(everyone[name] for name in pair.materials))
            if between[0] == between[1]:
                yield Problem(("pairs", index, "materials"), "are bonded by contact.together", list(pair.materials))
            elif told.setdefault(between, pair).friction != pair.friction:
                text = f"has friction {told[between].friction} already, by {' and '.join(told[between].materials)}"
                yield Problem(("pairs", index, "friction"), text, pair.friction)
        if used and len(set(self.velocity_fields(used).values())) < 2:
            bonded = " and ".join(dict.fromkeys(used))
            text = f"needs bodies of two materials that are not bonded; this scene has {bonded}"
            yield Problem((), text)
