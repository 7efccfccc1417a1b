"""What pictures show of the colliders of a scene: lines in the plane, triangles in space."""

import math
from typing import Any

import numpy as np
from pydantic import ValidationError

from pmpm.output.pictures import Surface
from pmpm.scene.recorded import PREFIX

AROUND = 0.02  # of the domain, to which what has no end is drawn beyond it
DRIVERS = ("velocity", "angular_velocity")  # keys that may be functions of time
FLAT, DEEP = 400, 96  # samples along an axis of the distance that an outline is drawn by
GROUND = 200  # of a height map, along the longer axis


def outlines(scene):
    """Surfaces of the colliders of a scene (see reader.Run.table), as far as a file tells them; those that functions shape and
    those whose own file is gone are left out, and in space all but ground and meshes need PyVista. Where those
    are that functions move only snapshots tell."""
    found = []
    for table in scene.get("colliders", ()):
        driven = [key for key in DRIVERS if str(table.get(key, "")).startswith(PREFIX)]
        collider = read({key: value for key, value in table.items() if key not in driven})
        if collider is not None:
            domain = scene["domain"]
            repeats = ("xyz"[axis] in domain.get("periodic", ()) for axis in range(len(domain["size"])))
            periods = tuple(a if repeated else math.inf for a, repeated in zip(domain["size"], repeats, strict=True))
            found += surfaces(collider, tuple(domain["size"]), periods, bool(driven))
    return tuple(found)


def read(table):
    """The Collider of a table, or None where a function tells what it is, or its file cannot be read."""
    from pmpm.scene.colliders import Collider

    try:
        return Collider.model_validate(table)
    except ValidationError:
        return None


def surfaces(collider, size, periods, driven):
    """Surfaces of one collider in a domain of this size and these periods (m). `driven`: a function moves it."""
    dim, shape = len(size), collider.shape
    moves = collider.moves or driven
    how: dict[str, Any] = {"name": collider.name, "pivot": collider.center(size, periods)}
    how["periods"] = collider.repeats(periods)
    how["place"] = lambda time: None if driven else collider.placed(time, dim)
    if dim == 3 and shape.type == "terrain" and shape.depth is None:
        points, corners = ground(shape, size)
        return [Surface(points, corners, 1.0, **how)]
    if dim == 3 and shape.type == "mesh":
        elements = shape.surface.elements
        return [Surface(elements.reshape(-1, 3), np.arange(3 * len(elements)).reshape(-1, 3), **how)]
    low, high = window(collider, size, moves)
    if not np.all(low < high):
        return []
    return lines(shape, low, high, how) if dim == 2 else triangles(shape, low, high, how)


def window(collider, size, moves):
    """Corners of the box in which an outline is looked for: that of the collider, not far beyond the domain."""
    margin = (1.0 if moves else AROUND) * max(size)
    low, high = collider.bounds(len(size))
    low, high = np.maximum(low, -margin), np.minimum(high, np.array(size) + margin)
    seam = 0.01 * float(np.max(high - low))
    return low - seam, high + seam


def sampled(shape, low, high, most):
    """(coordinates of samples along each axis, signed distance at all of them)."""
    step = float(np.max(high - low)) / most
    axes = [np.linspace(a, b, max(2, math.ceil((b - a) / step))) for a, b in zip(low, high, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    return axes, shape.signed_distance(points.reshape(-1, len(axes))).reshape(points.shape[:-1])


def lines(shape, low, high, how):
    """Surfaces of a shape in the plane."""
    from contourpy import contour_generator

    (x, y), distance = sampled(shape, low, high, FLAT)
    found: list[Any] = list(contour_generator(x, y, distance.T).lines(0.0))
    return [Surface(line, **how) for line in found]


def triangles(shape, low, high, how):
    """The same in space, by VTK; nothing where it is not installed."""
    try:
        import pyvista
    except ImportError:
        return []
    axes, distance = sampled(shape, low, high, DEEP)
    mesh = pyvista.RectilinearGrid(*axes)
    mesh["distance"] = distance.ravel(order="F")
    found = mesh.contour([0.0], scalars="distance").triangulate()
    if not found.n_points:
        return []
    return [Surface(np.asarray(found.points), found.faces.reshape(-1, 4)[:, 1:], **how)]


def ground(terrain, size):
    """(points, triangles) of a height map as far as it lies under the domain."""
    step = max(max(size[:2]) / GROUND, *[0.5 * s for s in terrain.ground().spacing])
    x, y = (np.linspace(0.0, length, max(2, math.ceil(length / step) + 1)) for length in size[:2])
    places = np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2)
    below, _ = terrain.above(np.column_stack([places, np.zeros(len(places))]))
    corner = (np.arange(len(x) - 1)[:, None] * len(y) + np.arange(len(y) - 1)).reshape(-1)
    first = np.stack([corner, corner + len(y), corner + len(y) + 1], axis=1)
    second = np.stack([corner, corner + len(y) + 1, corner + 1], axis=1)
    return np.column_stack([places, -below]), np.concatenate([first, second])
