"""What a scene has watched besides its particles: probes at points, gauges along lines and across sections, maps of columns."""

import math
from collections.abc import Iterator
from typing import Annotated, Any

from pydantic import Field

from pmpm.scene.messages import Problem, known_text
from pmpm.scene.part import Part
from pmpm.scene.shapes import AXES, wrong_length
from pmpm.scene.values import choice, label, vector

GAUGES = ("surface", "section")
MAPS = ("max_depth", "max_speed", "deposit")
MOST_COLUMNS = 1 << 26  # of a map, which every rank holds


class Probe(Part):
    """A point at which velocity, pressure and density of the material around it are noted."""

    name: Annotated[str, label()] = Field(description="of its file, probes/<name>.csv")
    position: Annotated[tuple[float, ...], vector("m")] = Field(description="where it is (m)")


class Gauge(Part):
    """A line at which the free surface is noted, or a plane through which the flow is."""

    name: Annotated[str, label()] = Field(description="of its file, gauges/<name>.csv")
    type: Annotated[str, choice(GAUGES)] = Field(default="surface", description=f"one of {', '.join(GAUGES)}")
    position: Annotated[tuple[float, ...], vector("m")] = Field(description="a point on the line or in the plane (m)")
    axis: Annotated[str | None, choice(AXES)] = Field(
        default=None,
        description="along which the line goes, that of the most gravity if not given; or to which the plane is normal",
    )


def upright(gravity: tuple[float, ...]) -> int | None:
    """Return the number of the axis with the most gravity, the first of equals; None without gravity."""
    return max(range(len(gravity)), key=lambda axis: abs(gravity[axis])) if any(gravity) else None


def wrong_watched(output: Any, domain: Any) -> Iterator[Problem]:
    """Yield what is wrong with the probes, gauges and maps of an Output in a Domain."""
    for key in ("probes", "gauges"):
        seen: dict[str, int] = {}
        for index, item in enumerate(getattr(output, key)):
            here = ("output", key, index)
            first = seen.setdefault(
                item.name.lower(), index
            )  # files of one name in capitals are one file to some systems
            if first != index:
                yield Problem((*here, "name"), f"is the name of {key}[{first}] already", item.name)
            yield from wrong_position(item.position, domain, (*here, "position"))
            if key == "gauges":
                yield from wrong_axis(item, domain, here)
    for index, name in enumerate(output.maps):
        here = ("output", "maps", index)
        if name not in MAPS:
            yield Problem(here, f"is not a known map; {known_text(name, MAPS, 'maps')}", name)
        elif upright(domain.gravity) is None:
            yield Problem(here, "needs gravity: a map has a column along it, and domain.gravity is zero", name)
        elif math.prod(domain.cells) // domain.cells[upright(domain.gravity)] > MOST_COLUMNS:
            yield Problem(here, f"has more columns of cells than a map may have, {MOST_COLUMNS}", name)


def wrong_position(position: tuple[float, ...], domain: Any, here: tuple) -> Iterator[Problem]:
    problems = list(wrong_length("position", position, domain.dim))
    if problems:
        yield from (Problem((*here[:-1], *problem.path), problem.text, problem.value) for problem in problems)
        return
    for axis, (place, size) in enumerate(zip(position, domain.size, strict=True)):
        if not 0.0 <= place <= size:
            yield Problem((*here, axis), f"m must lie in the domain, from 0 to {size:g} m along {AXES[axis]}", place)


def wrong_axis(gauge: Gauge, domain: Any, here: tuple) -> Iterator[Problem]:
    axes = AXES[: domain.dim]
    if gauge.axis is not None and gauge.axis not in axes:
        yield Problem((*here, "axis"), f"must be one of {', '.join(axes)} in a {domain.dim}-D scene", gauge.axis)
    elif gauge.axis is None and gauge.type == "section":
        yield Problem((*here, "axis"), "must be given: the axis to which the section is normal")
    elif gauge.axis is None and upright(domain.gravity) is None:
        yield Problem((*here, "axis"), "must be given: without gravity, the axis along which the line goes")
    elif gauge.type == "surface":
        axis = upright(domain.gravity) if gauge.axis is None else AXES.index(gauge.axis)
        if axis is not None and AXES[axis] in domain.periodic:
            yield Problem(
                (*here, "axis"), "must not be one along which the domain repeats: there is no surface", AXES[axis]
            )
