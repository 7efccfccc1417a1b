"""Make the ground of the built-in scene `landslide`: python docs/make_landslide_ground.py, with matplotlib and scipy installed.

The elevation is a piece of the Jacksboro fault (Tennessee, 36.5 N 84.2 W), 3 arc-seconds, from the sample data that matplotlib
ships (jacksboro_fault_dem.npz), interpolated to 25 m by cubic splines. What slides is made up: a cap of an ellipsoid.
"""

from pathlib import Path

import numpy as np

ROWS, COLUMNS = slice(298, 330), slice(214, 264)  # of the whole map, from the north and from the west
METRES = 111_320.0  # of a degree of latitude
LATITUDE = 36.46
SPACING = 25.0  # m
CENTER, HALF_AXES, DEPTH = (860.0, 1830.0), (230.0, 330.0), 45.0  # m: of the release along x and y
OUT = Path(__file__).parents[1] / "pmpm" / "scene" / "builtin"


def ground():
    """(ny, nx) elevation in m, rows from south to north, SPACING apart; lowest point 0."""
    from matplotlib.cbook import get_sample_data
    from scipy.interpolate import RectBivariateSpline

    with get_sample_data("jacksboro_fault_dem.npz") as data:
        rows = data["elevation"][ROWS, COLUMNS][::-1].astype(float)
        dy, dx = float(data["dy"]) * METRES, float(data["dx"]) * METRES * np.cos(np.radians(LATITUDE))
    y, x = (np.arange(n) * step for n, step in zip(rows.shape, (dy, dx), strict=True))
    spline = RectBivariateSpline(y, x, rows)
    heights = spline(np.arange(0.0, y[-1], SPACING), np.arange(0.0, x[-1], SPACING))
    return heights - heights.min()


def release(shape):
    """(ny, nx) depth in m of what slides."""
    y, x = (np.arange(n) * SPACING for n in shape)
    square = ((x - CENTER[0]) / HALF_AXES[0]) ** 2 + (((y - CENTER[1]) / HALF_AXES[1]) ** 2)[:, None]
    return DEPTH * np.maximum(1.0 - square, 0.0)


def main():
    heights = ground()
    np.savez_compressed(OUT / "landslide_ground.npz", elevation=np.round(heights, 1).astype(np.float32))
    np.savez_compressed(OUT / "landslide_release.npz", depth=np.round(release(heights.shape), 1).astype(np.float32))


if __name__ == "__main__":
    main()
