"""Pictures in space by PyVista (VTK) for `pmpm render`: off screen, by whatever OpenGL there is, in software if need be.

Whether VTK can draw on this machine is tried in a process of its own: where its drivers fail they end the process.
"""

import functools
import subprocess
import sys
from typing import Any

import numpy as np

from pmpm.output.files import one_line
from pmpm.scene.errors import SceneError

NEEDS = (
    "VTK draws off screen through EGL, OSMesa or an X server: Debian: apt install libegl1 libgl1 libosmesa6, or run it "
    "under xvfb-run (apt install xvfb)"
)
TRIAL = (
    "import pyvista as pv\n"
    "plotter = pv.Plotter(off_screen=True, window_size=(64, 64))\n"
    "plotter.add_mesh(pv.Sphere(), color='red')\n"
    "picture = plotter.screenshot(None, return_img=True)\n"
    "assert picture.std() > 1.0, 'the picture is empty'\n"
)
PATIENCE = 60  # s that the trial may take
MARGIN = 1.12  # of the view around the domain
FOOT, HEAD = 0.16, 0.07  # of the height, for the colours below and the title above
OVERLAP = 1.25  # of the distance of particles: how wide they are drawn
SIZE = (1200, 850)  # pixels
GREY, TERRAIN = "#777777", "#b8b0a0"


@functools.cache
def trouble():
    """What keeps PyVista from drawing here, in a line; None if it draws."""
    try:
        done = subprocess.run(
            [sys.executable, "-c", TRIAL],
            capture_output=True,
            text=True,
            errors="replace",
            timeout=PATIENCE,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"VTK could not be tried ({type(error).__name__}); {NEEDS}"
    if done.returncode == 0:
        return None
    lines = done.stderr.strip().splitlines()
    if any("No module named 'pyvista'" in line for line in lines):
        return "PyVista is not installed: pip install 'pmpm[viz]'"
    last = one_line(lines[-1]) if lines else f"it ended with status {done.returncode}"
    return f"VTK cannot draw here ({last}); {NEEDS}"


def require():
    """Raise SceneError with what to install where PyVista cannot draw."""
    if (reason := trouble()) is not None:
        raise SceneError(f"pmpm render: {reason}")


class Stage:
    """A window off screen in which frames of a View are drawn one after another."""

    def __init__(self, view):
        import pyvista
        import vtk

        vtk.vtkLogger.SetStderrVerbosity(vtk.vtkLogger.VERBOSITY_OFF)  # it complains of each display that is not there
        vtk.vtkObject.GlobalWarningDisplayOff()
        self.pyvista: Any = pyvista
        self.view = view
        self.size = view.pixels or SIZE
        self.plotter = self.pyvista.Plotter(off_screen=True, window_size=list(self.size))
        self.plotter.set_background("white")
        self.aim()

    def aim(self):
        """Point the camera; without perspective, so that lengths can be compared all over the picture."""
        view, camera = self.view, self.plotter.camera
        right, up, toward = view.camera
        box = np.zeros(3)
        box[: len(view.size)] = view.size
        middle = 0.5 * box
        wide, high = (np.abs(axis) @ box for axis in (right, up))
        aspect = self.size[0] / self.size[1]
        scale = 0.5 * MARGIN * max(high / (1.0 - FOOT - HEAD), wide / aspect) / view.zoom
        middle = middle - up * scale * (FOOT - HEAD)
        camera.focal_point, camera.up = tuple(middle), tuple(up)
        far = 2.0 * np.linalg.norm(box) + 4.0 * scale
        camera.position = tuple(middle + far * toward)
        camera.parallel_projection, camera.parallel_scale = True, scale
        camera.clipping_range = (1e-3 * far, 3.0 * far)
        self.pixels_per_metre = self.size[1] / (2.0 * scale)

    def frame(self, x, values, time, places):
        """(height, width, 3) bytes of particles at x (n, dim) m with values (n,), at a time in s; `places` of colliders."""
        view, plotter, height = self.view, self.plotter, self.size[1]
        plotter.clear_actors()
        plotter.scalar_bars.clear()  # else a bar with the same title is thought to be there
        letters = max(8, round(0.019 * height))
        if len(x):
            cloud = self.pyvista.PolyData(in_space(x))
            cloud[view.label] = values
            diameter = max(2.0, OVERLAP * view.spacing * self.pixels_per_metre)
            plotter.add_mesh(
                cloud, scalars=view.label, cmap=view.colours, clim=view.limits, point_size=diameter,
                render_points_as_spheres=True, show_scalar_bar=False, nan_color=GREY, reset_camera=False,
            )  # fmt: skip
            if view.materials:
                plotter.add_legend(
                    [[name, colour] for name, colour in zip(view.materials, view.material_colours, strict=True)],
                    bcolor=None, border=False, face="circle", size=(0.14, 0.03 * len(view.materials)),
                )  # fmt: skip
            else:
                plotter.add_scalar_bar(
                    f"{view.label}\n", n_labels=5, fmt="%.3g", color="black", vertical=False, width=0.5, height=0.05,
                    position_x=0.25, position_y=0.03, title_font_size=letters, label_font_size=letters,
                )  # fmt: skip
        if view.box:
            box = self.pyvista.Box(bounds=sum(((0.0, length) for length in (*view.size, 0.0)[:3]), ()))
            plotter.add_mesh(box, style="wireframe", color=GREY, line_width=1, lighting=False, reset_camera=False)
        for surface in view.surfaces:
            for points in surface.at(time, places):
                self.add(surface, points)
        plotter.add_axes(viewport=(0.0, 0.0, 0.14, 0.18))
        title = f"{view.title}    t = {time:.4g} s".strip()
        plotter.add_text(
            title, position=(0.03, 0.945), viewport=True, font_size=max(6, round(0.6 * letters)), color="black"
        )
        return plotter.screenshot(None, return_img=True)[..., :3]

    def add(self, surface, points):
        """Draw a pictures.Surface with its points (n, dim) m where they are now."""
        points = in_space(points)
        if surface.triangles is None:
            mesh = self.pyvista.lines_from_points(points)
            self.plotter.add_mesh(mesh, color="black", line_width=2, lighting=False, reset_camera=False)
        else:
            mesh = self.pyvista.PolyData.from_regular_faces(points, np.asarray(surface.triangles))
            self.plotter.add_mesh(mesh, color=TERRAIN, opacity=surface.opacity, reset_camera=False)

    def close(self):
        self.plotter.close()


def in_space(x):
    """(n, 3) from (n, dim)."""
    points = np.zeros((len(x), 3))
    points[:, : x.shape[1]] = x
    return points
