"""Built-in scenes on more ranks than there are cores, and than most of them have room for: run one after another by one launch,
for most of the time goes into starting so many processes.

Everything is given a push, so that particles cross cuts within few steps. The disks are so fine that most of 64 ranks own
layers; elsewhere most idle, for no slab is narrower than a stencil.
"""

import json
from pathlib import Path

import bits
import launch

from pmpm.scene.schema import Scene

DRIVER = Path(__file__).parent / "drivers" / "run_several.py"
STEPS = 60
SETTINGS = {
    "chute_flow": {"inflows.0.velocity": [3.0, 0.0]},
    "colliding_disks": {
        "domain.cell_size": 0.003125, "bodies.0.velocity": [0.4, 0.4], "bodies.1.velocity": [-0.4, -0.4],
    },
    "column_collapse": {"bodies.0.velocity": [2.0, 0.0]},
    "column_collapse_3d": {"bodies.0.velocity": [2.0, 0.0, 0.0]},
    "dam_break": {"bodies.0.velocity": [2.0, 0.0]},
    "dam_break_3d": {"bodies.0.velocity": [2.0, 0.0, 0.0]},
    "jet": {"inflows.0.velocity": [0.0, -3.0]},
    "mixed_materials": {"bodies.2.velocity": [3.0, 0.0, 0.0]},
}  # fmt: skip


def run_several(names, folder, ranks=None, settings=SETTINGS, limit=600):
    """Run built-in scenes on so many ranks (None: without mpirun), each into its folder of `folder`; seconds."""
    folder.mkdir(parents=True, exist_ok=True)
    plan = []
    for name in names:
        own = settings.get(name, {})
        fields = {"output.fields": bits.all_fields(Scene.builtin(name, own))}
        plan.append([name, own | fields, str(folder / name), STEPS])
    path = folder / "plan.json"
    path.write_text(json.dumps(plan), encoding="utf-8")
    done = launch.python([DRIVER, path], ranks, limit, folder)
    assert done.status == 0, f"on {ranks or 1} ranks: {done.status}\n{done.text}"
    return done.seconds


def ranks_that_own_layers(out):
    """(ranks that own layers, all ranks) of a run."""
    edges = bits.report(out)["edges"]
    return len(set(edges)) - 1, len(edges) - 1
