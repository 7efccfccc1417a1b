"""Reads what the paths on standard input name, each as `pmpm info` and as pmpm.load do, and prints a line of JSON on each.

In a process of its own, for a library may crash where it reads damaged files. Run it with the folder tests in PYTHONPATH.
"""

import contextlib
import json
import sys
import traceback
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "fuzz"))

import verdict

import pmpm
from pmpm.output.files import OutputError
from pmpm.scene.errors import SceneError


def look_at_everything(path):
    """Ask a run, or a snapshot, for all it has."""
    from pmpm.output.reader import Snapshot

    if path.is_file():
        snapshots = [Snapshot(path)]
    else:
        run = pmpm.load(path)
        for name in ("status", "record", "scene", "diagnostics"):
            with contextlib.suppress(OutputError, SceneError):
                getattr(run, name)
        snapshots = list(run.snapshots)
    for snapshot in snapshots:
        for name in ("attributes", "time", "step", "x", "fields", "laws", "velocity", "pressure", "id", "nothing"):
            with contextlib.suppress(OutputError, AttributeError):
                getattr(snapshot, name)
        with contextlib.suppress(OutputError, KeyError):
            snapshot.law_field("drucker_prager", "v_c")


for line in sys.stdin:
    path = Path(json.loads(line))
    found = verdict.complaints(verdict.run(["info", path]), (0, 2))
    try:
        with verdict.limits(verdict.SECONDS):
            look_at_everything(path)
    except (OutputError, SceneError):
        pass
    except BaseException:
        found.append(traceback.format_exc())
    print(json.dumps(found), flush=True)
