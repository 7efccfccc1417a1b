"""Run built-in scenes one after another on the ranks of one launch: python run_several.py PLAN, a JSON list of
[scene, settings, folder, steps]."""

import json
import sys
from pathlib import Path

from pmpm.parallel.comm import from_launcher
from pmpm.run import run_scene
from pmpm.scene.schema import Scene

comm = from_launcher()
for name, settings, out, steps in json.loads(Path(sys.argv[1]).read_text(encoding="utf-8")):
    run_scene(Scene.builtin(name, settings), out, comm, steps=steps, quiet=True)
