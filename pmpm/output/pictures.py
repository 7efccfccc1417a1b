"""How pictures look, and what to install for them: matplotlib is an extra, imported when something is drawn."""

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pmpm.output.files import unfinished_name
from pmpm.scene.errors import SceneError

INSTALL = "pip install 'pmpm[viz]'"


@dataclass(frozen=True)
class Surface:
    """What stands in the way of material, for pictures: points (n, dim) in m; triangles (m, 3) of them in space, or None for a
    line through all points, in the plane as a rule. `place`: (rotation, shift) at a time (s), if it may move."""

    points: np.ndarray
    triangles: np.ndarray | None = None
    opacity: float = 0.6
    name: str | None = None  # of a collider, by which snapshots tell where it is
    place: Callable[[float], tuple[np.ndarray, np.ndarray] | None] | None = None
    pivot: np.ndarray | None = None
    periods: tuple[float, ...] = ()  # m, after which it is there again, along the first axes; infinite for never

    def at(self, time, places):
        """The points at a time (s), and those of its images in the domain: where `places` tell, {name: (rotation, shift)}, else
        where `place` does; none where nobody knows."""
        points = np.asarray(self.points)
        if self.place is not None:
            placed = places[self.name] if self.name in places else self.place(time)
            if placed is None:
                return []
            turn, shift = placed
            points = (points - self.pivot) @ turn.T + self.pivot + shift
        return (
            [points + way for way in itertools.product(*map(ways, points.T, self.periods))]
            if self.periods
            else [points]
        )


def ways(x, period):
    """By which whole periods (m) coordinates (n,), m, move so that some lie between 0 and a period."""
    if not math.isfinite(period):
        return (0.0,)
    slack = 1e-9 * period
    first, last = math.ceil((slack - x.max()) / period), math.floor((period - slack - x.min()) / period)
    return tuple(number * period for number in range(first, last + 1))


def figure_class(asker):
    """matplotlib's Figure. Raises SceneError with what to install where matplotlib is missing."""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise SceneError(f"{asker} needs matplotlib, which is not installed: {INSTALL}") from None
    return Figure


def plain(axes, which="major"):
    """Axes with a faint grid and no frame on the sides without numbers."""
    axes.grid(which=which, color="#dddddd", lw=0.5)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def save(figure, file):
    """Write a picture, of the kind that the file's name ends with, whole or not at all."""
    unfinished = unfinished_name(file)
    try:
        figure.savefig(unfinished, format=file.suffix[1:] or "png")
        unfinished.replace(file)
    finally:
        unfinished.unlink(missing_ok=True)
