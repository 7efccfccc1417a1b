"""The scripts in jobs/ as a user would start them: with the commands they name on PATH."""

import os
import sys
from pathlib import Path

import launch

JOBS = launch.ROOT / "jobs"


def commands(folder):
    """A folder in which `pmpm` is the one under test."""
    folder = Path(folder) / "bin"
    folder.mkdir()
    write_script(folder / "pmpm", f'exec "{sys.executable}" -m pmpm "$@"')
    return folder


def write_script(path, text):
    path.write_text(f"#!/usr/bin/env bash\n{text}\n", encoding="utf-8")
    path.chmod(0o755)


def environment(*folders):
    """What the scripts need around them, with the commands in `folders` before all others."""
    beside = [Path(launch.mpirun()).parent, Path(sys.executable).parent]
    path = os.pathsep.join(map(str, [*folders, *beside, os.environ.get("PATH", "")]))
    paths = os.pathsep.join(filter(None, [str(launch.ROOT), os.environ.get("PYTHONPATH")]))
    return launch.LAUNCHER | {"PATH": path, "PYTHONPATH": paths, "OMP_NUM_THREADS": "1"}
