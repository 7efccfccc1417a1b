"""Ground from a height map: the solid below it, or a layer of some depth on it. Heights are along the last axis."""

import functools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from pmpm.scene.messages import Problem, Problems
from pmpm.scene.outside import OutsideFile, check_path, checksum
from pmpm.scene.surfaces import measures
from pmpm.scene.values import (
    check_number,
    check_numbers,
    checked,
    choice,
    either,
    number,
    number_told,
    plain,
    text,
    vector_told,
)

KINDS = (".npy", ".npz", ".asc", ".tif", ".tiff")
LEAST_COVERED = 1e-3  # of the domain, along an axis: less is a map in other units
HEIGHTS = ("elevation", "height", "z", "depth")  # names of arrays in .npz files, the first that is there


class Unreadable(ValueError):  # noqa: N818
    """A file is no height map; the text says why."""


@dataclass(frozen=True)
class HeightMap:
    """Heights (m) at the corners of a regular mesh: (nx,) in 2-D or (nx, ny), x and y growing; `spacing` (m) per axis."""

    heights: np.ndarray
    spacing: tuple[float, ...]

    @property
    def size(self) -> np.ndarray:
        """Extent along each axis, m."""
        return np.array(self.spacing) * (np.array(self.heights.shape) - 1)

    def at(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return heights (n,) and slopes (n, dim - 1) at places (n, dim - 1), m from the first sample.

        Bilinear between samples; level beyond the map's edge.
        """
        with np.errstate(over="ignore"):  # spacings so small that everything lies beyond
            cells = places / np.array(self.spacing)
        last = np.array(self.heights.shape) - 1
        inside = np.clip(cells, 0.0, last)
        first = np.minimum(inside.astype(np.int64), np.maximum(last - 1, 0))
        t = inside - first
        beyond = cells != inside
        if self.heights.ndim == 1:
            low, high = self.heights[first[:, 0]], self.heights[first[:, 0] + 1]
            slopes = ((high - low) / self.spacing[0])[:, None]
            return low + t[:, 0] * (high - low), np.where(beyond, 0.0, slopes)
        i, j = first.T
        corner = [[self.heights[i + a, j + b] for b in (0, 1)] for a in (0, 1)]
        along_y = [side[0] + t[:, 1] * (side[1] - side[0]) for side in corner]
        rises = [side[1] - side[0] for side in corner]
        slopes = np.stack(
            [
                (along_y[1] - along_y[0]) / self.spacing[0],
                (rises[0] + t[:, 0] * (rises[1] - rises[0])) / self.spacing[1],
            ],
            axis=1,
        )
        return along_y[0] + t[:, 0] * (along_y[1] - along_y[0]), np.where(beyond, 0.0, slopes)


def depth_of(value: Any) -> Any:
    """Accept a depth above zero (m), or the path of a map of depths."""
    return check_path(value) if isinstance(value, str | Path) else check_number("m", above=0.0)(value)


LENGTH = number_told("m", above=0.0)
PLACE = either(number_told("m"), vector_told("m") | {"minItems": 1})
SPACING = either(LENGTH, {"type": "array", "items": LENGTH, "minItems": 1, "maxItems": 2})


class Terrain(OutsideFile):
    """The solid ground below a height map (a profile in 2-D), or with `depth` the layer that lies on it."""

    type: Literal["terrain"] = "terrain"
    spacing: Annotated[tuple[float, ...] | None, checked(lambda value: lengths(value), SPACING)] = Field(
        default=None,
        description="between samples: one number, or one along x and one along y; .asc and .tif tell it (m)",
    )
    origin: Annotated[tuple[float, ...] | None, checked(lambda value: place(value), PLACE)] = Field(
        default=None,
        description="where in the domain the map's corner of least x and y lies, and with a last number what is added to "
        "heights; of a profile along x one number, or two; zeros if not given (m)",
    )
    first_row: Annotated[str | None, choice(("south", "north"))] = Field(
        default=None,
        description="at which end of y a file's first row is: north for .asc and .tif, else south if not given",
    )
    variable: Annotated[str | None, text()] = Field(default=None, description="name of the array in a .npz file")
    depth: Annotated[float | str | None, checked(depth_of, either({"type": "string"}, LENGTH))] = Field(
        default=None, description="of a layer on the ground: a number (m), or the path of a map of the same samples"
    )
    depth_checksum: Annotated[str | None, text()] = Field(default=None, description="of a map of depths, filled in")
    least_depth: Annotated[float, number("m", at_least=0.0)] = Field(
        default=0.0, description="where a map of depths is not deeper there is no layer (m)"
    )

    @model_validator(mode="after")
    def read(self) -> "Terrain":
        """Read the maps once, so that what is wrong with them is told now."""
        ground = self.read_for("file", self.ground)
        if isinstance(self.depth, str):
            found = checksum(self.depth)
            if self.depth_checksum not in (None, found):
                changed = f"is not the file it was: its checksum is {found}, not {self.depth_checksum}"
                raise Problems(Problem(("depth",), changed, self.depth))
            object.__setattr__(self, "depth_checksum", found)
            layer = self.read_for("depth", self.layer)
            if layer.heights.shape != ground.heights.shape:
                shapes = " and ".join("x".join(map(str, m.heights.shape)) for m in (layer, ground))
                raise Problems(Problem(("depth",), f"has other samples than the ground: {shapes}", self.depth))
            if not (layer.heights > self.least_depth).any():
                raise Problems(Problem(("depth",), f"is nowhere more than {self.least_depth} m deep", self.depth))
        dim = ground.heights.ndim + 1
        if self.origin is not None and len(self.origin) not in (dim - 1, dim):
            fits = f"must have {dim - 1} or {dim} numbers for a map of {dim - 1} axes"
            raise Problems(Problem(("origin",), fits, list(self.origin)))
        return self

    def read_for(self, key: str, read: Callable[[], HeightMap]) -> HeightMap:
        """Return what is read, or raise Problems that name the key."""
        try:
            return read()
        except Unreadable as complaint:
            raise Problems(Problem((key,), str(complaint), getattr(self, key))) from None

    def ground(self) -> HeightMap:
        """Return the heights of the ground. Raises Unreadable."""
        return height_map(self.file, self.checksum, self.spacing, self.first_row, self.variable)

    def layer(self) -> HeightMap:
        """Return a map of depths, without the ones that are too small. Raises Unreadable."""
        assert isinstance(self.depth, str)
        spacing = self.ground().spacing if Path(self.depth).suffix in (".npy", ".npz") else None
        return height_map(self.depth, self.depth_checksum, spacing, self.first_row, None)

    @property
    def dim(self) -> int:
        """Dimensions of the space that the ground lies in."""
        return self.ground().heights.ndim + 1

    def corner(self) -> np.ndarray:
        """Return where the map begins, and what is added to heights, (dim,) m."""
        corner = np.zeros(self.dim)
        if self.origin is not None:
            corner[: len(self.origin)] = self.origin
        return corner

    def above(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return how high above the ground points (n, dim) are, (n,) m, and the slopes of the ground there, (n, dim - 1)."""
        corner = self.corner()
        height, slopes = self.ground().at(points[:, :-1] - corner[:-1])
        return points[:, -1] - corner[-1] - height, slopes

    def depths(self, points: np.ndarray) -> np.ndarray:
        """Return the depth of the layer at points (n, dim), (n,) m; none beyond the map."""
        places = points[:, :-1] - self.corner()[:-1]
        here = np.all((places >= 0.0) & (places <= self.ground().size), axis=1)
        depth = self.layer().at(places)[0] if isinstance(self.depth, str) else np.full(len(points), self.depth)
        return np.where(here & (depth > self.least_depth), depth, -np.inf)

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Say which of the points (n, dim), m, lie inside: bool (n,)."""
        above, _ = self.above(points)
        if self.depth is None:
            return above <= 0.0
        return (above > 0.0) & (above <= self.depths(points))

    def signed_distance(self, points: np.ndarray) -> np.ndarray:
        """Return about how far points (n, dim), m, are from the surface, (n,) m: exact in sign, negative inside."""
        above, slopes = self.above(points)
        distance = above / np.sqrt(1.0 + np.sum(slopes * slopes, axis=1))
        if self.depth is None:
            return distance
        return np.maximum(-distance, distance - np.where(above > 0.0, self.depths(points), 0.0))

    def normals(self, points: np.ndarray) -> np.ndarray:
        """Return unit normals (n, dim) out of the ground, out of a layer upwards or downwards, as its nearer side is."""
        above, slopes = self.above(points)
        normals = np.concatenate([-slopes, np.ones((len(points), 1))], axis=1)
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        if self.depth is not None:
            normals[above < 0.5 * np.maximum(self.depths(points), 0.0)] *= -1.0
        return normals

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the corners (low, high) of the surrounding box, (dim,) each, m; the ground goes on beyond its map."""
        ground, corner = self.ground(), self.corner()
        if self.depth is None:
            high = np.full(self.dim, np.inf)
            high[-1] = corner[-1] + ground.heights.max()
            return np.full(self.dim, -np.inf), high
        depth = self.layer().heights if isinstance(self.depth, str) else np.full(ground.heights.shape, self.depth)
        held = widened(depth > self.least_depth)
        found = [
            np.flatnonzero(held.any(axis=tuple(a for a in range(held.ndim) if a != axis))) for axis in range(held.ndim)
        ]
        low = [numbers[0] * step for numbers, step in zip(found, ground.spacing, strict=True)]
        high_ends = [numbers[-1] * step for numbers, step in zip(found, ground.spacing, strict=True)]
        bottom, top = ground.heights[held].min(), (ground.heights + np.maximum(depth, 0.0))[held].max()
        return corner + np.array([*low, bottom]), corner + np.array([*high_ends, top])

    def told(self) -> str:
        """One line about the map."""
        ground = self.ground()
        samples, low, high = "x".join(map(str, ground.heights.shape)), ground.heights.min(), ground.heights.max()
        base = self.corner()[-1]
        return f"{samples} heights, {measures(ground.size)} m, from {base + low:.6g} to {base + high:.6g} m"

    def misses(self, size: tuple[float, ...]) -> list[Problem]:
        """List the axes along which the map lies nowhere under a domain of this size (m)."""
        low = self.corner()[:-1]
        return [
            Problem(
                ("origin",),
                f"m puts the map from {low[axis]:.6g} to {low[axis] + extent:.6g} m along {'xyz'[axis]}, the domain goes "
                f"from 0 to {size[axis]:.6g} m: is `spacing` in metres?",
                None if self.origin is None else list(self.origin),
            )
            for axis, extent in enumerate(self.ground().size)
            if not (low[axis] < size[axis] and low[axis] + extent > 0.0) or extent < LEAST_COVERED * size[axis]
        ]

    def misfits(self, dim: int) -> list[Problem]:
        """List what does not fit a scene of `dim` dimensions."""
        if self.dim == dim:
            return []
        return [Problem(("file",), f"is a map of {self.dim - 1} axes, for {self.dim} dimensions, not {dim}", self.file)]


def place(value: Any) -> tuple[float, ...]:
    """Accept one number, or a list of one to three."""
    value = plain(value)
    return check_numbers("m", 1)(value) if isinstance(value, list | tuple) else (check_number("m")(value),)


def lengths(value: Any) -> tuple[float, ...]:
    """Accept one length above zero, or two."""
    if isinstance(value, list | tuple):
        if len(value) not in (1, 2):
            raise Problems(Problem((), "must be one or two numbers > 0 m", value))
        return tuple(check_number("m", above=0.0)(item) for item in value)
    return (check_number("m", above=0.0)(value),)


def widened(held: np.ndarray) -> np.ndarray:
    """Mark the neighbours of marked samples, too: between them depths are interpolated."""
    for axis in range(held.ndim):
        grown = held.copy()
        index: list[Any] = [slice(None)] * held.ndim
        for here, there in ((slice(1, None), slice(None, -1)), (slice(None, -1), slice(1, None))):
            to, frm = list(index), list(index)
            to[axis], frm[axis] = here, there
            grown[tuple(to)] |= held[tuple(frm)]
        held = grown
    return held


# ---- files -----------------------------------------------------------------------------------------------------------------


@functools.lru_cache(maxsize=8)
def height_map(
    path: str, _checksum: str | None, spacing: tuple[float, ...] | None, first_row: str | None, variable: str | None
) -> HeightMap:
    """Read a height map; the checksum stands for what is in the file. Raises Unreadable."""
    kind = Path(path).suffix.lower()
    if kind not in KINDS:
        raise Unreadable(f"is no height map: known are {', '.join(KINDS)}")
    if variable is not None and kind != ".npz":
        raise Unreadable("is no .npz file: only these have a variable to choose")
    own: tuple[float, ...] | None = None
    try:
        if kind == ".asc":
            values, own = read_asc(path)
        elif kind in (".tif", ".tiff"):
            values, own = read_tif(path)
        else:
            values = read_numpy(path, variable)
    except (OSError, ValueError, KeyError, IndexError, EOFError) as error:
        if isinstance(error, Unreadable):
            raise
        raise Unreadable(f"cannot be read as {kind}: {error}") from None
    if own is not None and spacing is not None:
        raise Unreadable(f"tells its spacing itself, {own[0]:g} m: leave `spacing` out")
    spacing = own or spacing
    if spacing is None:
        raise Unreadable("does not tell the distance between samples: give `spacing` (m)")
    return arranged(values, spacing, first_row or ("south" if own is None else "north"))


def arranged(values: np.ndarray, spacing: tuple[float, ...], first_row: str) -> HeightMap:
    """Turn rows along y into heights[x, y] with y growing; refuse what is no map."""
    if values.ndim not in (1, 2) or min(values.shape) < 2 or not np.issubdtype(values.dtype, np.number):
        raise Unreadable(f"is no map: an array {values.shape} of {values.dtype}, not one or two axes of numbers")
    heights = np.array(values, np.float64)
    missing = int(np.count_nonzero(~np.isfinite(heights)))
    if missing:
        raise Unreadable(f"has {missing} of {heights.size} samples without a height: fill them first")
    if heights.ndim == 2:
        heights = (heights[::-1] if first_row == "north" else heights).T
    heights = np.ascontiguousarray(heights)
    heights.flags.writeable = False
    return HeightMap(heights, spacing * heights.ndim if len(spacing) == 1 else spacing[: heights.ndim])


def read_numpy(path: str, variable: str | None) -> np.ndarray:
    """Read an array, or one of several by name."""
    found = np.load(path, allow_pickle=False)
    if isinstance(found, np.ndarray):
        return found
    with found:
        names = [variable] if variable is not None else [name for name in HEIGHTS if name in found.files]
        if not names or names[0] not in found.files:
            raise Unreadable(f"holds {', '.join(found.files)}: give one of them as `variable`")
        return found[names[0]]


def read_asc(path: str) -> tuple[np.ndarray, tuple[float, ...]]:
    """Read an ESRI ASCII grid: six lines of key and value, then rows from north to south."""
    with open(path, encoding="ascii") as file:
        words = file.read().split()
    head: dict[str, float] = {}
    while len(words) > 2 * len(head) + 1 and words[2 * len(head)][0].isalpha():
        key = words[2 * len(head)].lower()
        if key in head:
            raise Unreadable(f"gives {key} twice")
        head[key] = float(words[2 * len(head) + 1])
    needed = ("ncols", "nrows", "cellsize")
    absent = [key for key in needed if key not in head]
    if absent:
        raise Unreadable(f"has no {absent[0]} at its head: no ESRI ASCII grid")
    if head["cellsize"] <= 0.0:
        raise Unreadable(f"has cellsize = {head['cellsize']:g}: must be > 0 m")
    values = np.array(words[2 * len(head) :], np.float64)
    rows, columns = int(head["nrows"]), int(head["ncols"])
    if values.size != rows * columns:
        raise Unreadable(f"has {values.size} heights, not nrows x ncols = {rows * columns}")
    values[values == head.get("nodata_value", np.nan)] = np.nan
    return values.reshape(rows, columns), (head["cellsize"],)


def read_tif(path: str) -> tuple[np.ndarray, tuple[float, ...]]:
    """Read the first band of a GeoTIFF whose unit is the metre."""
    try:
        import tifffile
    except ImportError:
        raise Unreadable("needs tifffile to be read: pip install 'pmpm[terrain]'") from None
    with tifffile.TiffFile(path) as file:
        page: Any = file.pages[0]
        values, scale = page.asarray(), page.tags.get("ModelPixelScaleTag")
        missing = page.tags.get("GDAL_NODATA")
        size = None if scale is None else tuple(float(length) for length in scale.value[:2])
        absent = None if missing is None else float(missing.value)
    if size is None:
        raise Unreadable("does not tell the size of its pixels (ModelPixelScaleTag): no GeoTIFF")
    values = np.array(values, np.float64)
    if absent is not None:
        values[values == absent] = np.nan
    return values, size
