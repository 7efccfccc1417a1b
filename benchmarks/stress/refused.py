"""S16: input without meaning is refused before anything runs: exit status 2 and one line that names the key."""

import contextlib
import io
import tempfile
from pathlib import Path

from pmpm import cli

from .judge import Found
from .matrix import DEFAULT, STOPPED, Case

SCENE = """
[domain]
size = [1.0, 1.0]
cell_size = 0.1
gravity = [0.0, -9.81]
[time]
end = 0.01
[materials.m]
model = "{model}"
density = 1000.0
{keys}
[[bodies]]
material = "m"
shape = {{ type = "box", min = [0.2, 0.2], max = [0.6, 0.6] }}
"""
ELASTIC = "youngs_modulus = 1e6\npoisson_ratio = 0.3"
MODELS = {
    "neo_hookean": ELASTIC,
    "drucker_prager": f"{ELASTIC}\nfriction_angle = 30.0",
    "snow": ELASTIC,
    "fluid": "sound_speed = 10.0",
}
WRONG = {
    "time.step": ("1.0", "0.0", "-1e-4", "nan", '"long"'),
    "time.cfl": ("0.0", "1.5", "nan"),
    "time.end": ("0.0", "-1.0", "inf", "1e30"),
    "domain.cell_size": ("0.0", "-0.1", "nan", "1e-300"),
    "domain.size": ("[1.0, 0.95]", "[1.0, 0.0]", "[nan, 1.0]", "[]"),
    "domain.gravity": ("[0.0]", "[0.0, inf]"),
    "bodies": ("[]",),
    "bodies.0.shape.max": ("[0.2, 0.6]", "[0.6, 2.0]", "[nan, 0.6]"),
    "bodies.0.particles_per_cell": ("0", "-4", "1.5"),
    "materials.m.density": ("0.0", "-1.0", "nan"),
    "materials.m.youngs_modulus": ("0.0", "-1e6", "inf"),
    "materials.m.poisson_ratio": ("0.5", "-1.0", "-1.5", "0.6"),
    "materials.m.friction_angle": ("90.0", "-1.0"),
    "materials.m.critical_compression": ("0.0", "1.5"),
    "materials.m.critical_stretch": ("-0.1",),
    "materials.m.hardening": ("90.0",),
    "materials.m.viscosity": ("-1.0",),
    "materials.m.sound_speed": ("0.0",),
    "method.transfer": ('"apicc"',),
    "method.integrator": ('"implicit"',),
    "method.flip_blend": ("0.5",),
    "colliders": ("[{}]",),
}
OWNERS = {
    "friction_angle": "drucker_prager", "critical_compression": "snow", "critical_stretch": "snow", "hardening": "snow",
    "viscosity": "fluid", "sound_speed": "fluid",
}  # fmt: skip
VARIANTS = tuple(f"{key}={value}" for key, values in WRONG.items() for value in values)
MISSING = 2


def refused(scheme, variant):
    key = variant.partition("=")[0]
    model = OWNERS.get(key.rpartition(".")[2], "neo_hookean")
    said = io.StringIO()
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stderr(said), contextlib.redirect_stdout(said):
        path = Path(folder) / "scene.toml"
        path.write_text(SCENE.format(model=model, keys=MODELS[model]), encoding="utf-8")
        try:
            status = cli.main(["run", str(path), "--out", f"{folder}/run", "--quiet", "--set", variant])
        except SystemExit as left:
            status = left.code
        made = (Path(folder) / "run").exists()
    text = said.getvalue().strip()
    name = key.rpartition(".")[2] if not key.startswith("bodies.0.shape") else "shape"
    found = Found(numbers={"exit status": status})
    found.claim(status == MISSING, f"exit status {status}: {text}")
    found.claim(name in text, f"the message does not name {key}: {text}")
    found.claim(len(text.splitlines()) == 1, f"the message has {len(text.splitlines())} lines: {text}")
    found.claim(not made, "left a run folder")
    if not found.wrong:
        found.message = f"refused: {text.replace(folder, '')}"
    return found


CASES = (
    Case("S16", "input", "input without meaning, from the command line", VARIANTS, refused, STOPPED, DEFAULT, quick=8),
)  # fmt: skip
