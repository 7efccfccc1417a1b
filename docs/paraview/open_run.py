"""Open a run in ParaView as spheres coloured by speed: paraview --script=open_run.py, or pvpython open_run.py DIR [PNG].

In ParaView without arguments it asks nothing: it opens the run named by the environment variable PMPM_RUN, or the one in the
working folder. Needs ParaView 5.9 or later and nothing of pmpm.
"""

import os
import sys
import tomllib
from pathlib import Path

from paraview import simple

WIDER = 0.62  # radius of a sphere, in distances of particles


def spacing_and_up(folder):
    """(distance of particles in m, number of the axis of gravity, whether it is 2-D) of the run in a folder."""
    scene = tomllib.loads((folder / "scene.toml").read_text(encoding="utf-8"))
    domain = scene["domain"]
    gravity, dim = domain["gravity"], len(domain["size"])
    up = max(range(dim), key=lambda axis: abs(gravity[axis])) if any(gravity) else dim - 1
    sources = [*scene.get("bodies", ()), *scene.get("inflows", ())]
    return domain["cell_size"] / min(source["particles_per_cell"] for source in sources) ** (1.0 / dim), up, dim == 2


def toward(up, flat):
    """From where to look: in the plane from the front, in space from above and the side."""
    if flat:
        return [0.0, 0.0, 1.0]
    return [[0.5, 0.5, 1.0], [0.5, 0.5, 1.0], [0.5, -1.0, 0.5]][up]


def show(folder, picture=None):
    """Show the run in a folder; with a name for a picture, write the last moment there."""
    folder = Path(folder).resolve()  # ParaView 5.11 ends on a bare relative name
    spacing, up, flat = spacing_and_up(folder)
    reader = simple.Xdmf3ReaderS(FileName=[str(folder / "snapshots.xdmf")])
    reader.UpdatePipelineInformation()
    scene = simple.GetAnimationScene()
    scene.UpdateAnimationUsingDataTimeSteps()
    scene.GoToLast()
    view = simple.GetActiveViewOrCreate("RenderView")
    display = simple.Show(reader, view)
    display.SetRepresentationType("Point Gaussian")
    display.GaussianRadius = WIDER * spacing
    simple.ColorBy(display, ("POINTS", "velocity", "Magnitude"))
    display.RescaleTransferFunctionToDataRange(False, True)
    display.SetScalarBarVisibility(view, True)
    view.CameraFocalPoint, view.CameraPosition = [0.0, 0.0, 0.0], toward(up, flat)
    view.CameraViewUp = [1.0 if axis == up else 0.0 for axis in range(3)]
    simple.ResetCamera(view)
    simple.Render(view)
    if picture:
        simple.SaveScreenshot(str(Path(picture).resolve()), view)


show(sys.argv[1] if len(sys.argv) > 1 else os.environ.get("PMPM_RUN", "."), *sys.argv[2:3])
