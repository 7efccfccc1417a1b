"""Tell two runs apart, byte for byte: of scenes from the command line by their files, of simulations by their particles."""

import json
from pathlib import Path

import h5py
import launch
import numpy as np

from pmpm.physics.materials import LAWS
from pmpm.scene.schema import Scene
from pmpm.state.fields import OUTPUT_NAMES


def all_fields(scene):
    """Names of everything that a scene can write: the common fields and the state of its laws."""
    used = [scene.materials[body.material] for body in scene.sources]
    states = [field.name for material in used for field in LAWS[material.model].state_fields(material.parameters)]
    return [name for name in dict.fromkeys((*OUTPUT_NAMES, *states)) if scene.field_kept_by_nobody(name) is None]


def arguments_of(settings):
    return [text for key, value in settings.items() for text in ("--set", f"{key}={as_toml(value)}")]


def as_toml(value):
    return json.dumps(value) if isinstance(value, list) else value


def run(name, out, ranks=None, settings=None, options=(), limit=300, program=("-m", "pmpm")):
    """Run a built-in scene (a name) or a Scene into the folder `out`, all fields written; the finished process."""
    out = Path(out)
    out.parent.mkdir(parents=True, exist_ok=True)
    if isinstance(name, Scene):
        path = out.parent / f"{out.name}.toml"
        path.write_text(name.to_toml(), encoding="utf-8")
        scene, name = name, path
    else:
        scene = Scene.builtin(name)
    settings = {"output.fields": all_fields(scene)} | (settings or {})
    command = [*program, "run", name, "--out", out, *options, *arguments_of(settings)]
    done = launch.python(command, ranks, limit, out.parent)
    assert done.status == 0, f"{' '.join(map(str, command))} on {ranks or 1} ranks: {done.status}\n{done.text}"
    return done


def report(out):
    return json.loads((Path(out) / "run.json").read_text(encoding="utf-8"))["report"]


def contents(path):
    """Everything in an HDF5 file: {name: (type, shape, bytes)}; attributes as `name@key`."""
    held = {}

    def look(name, item):
        for key, value in item.attrs.items():
            held[f"{name}@{key}"] = (None, None, np.asarray(value).tobytes())
        if isinstance(item, h5py.Dataset):
            held[name] = (item.dtype.str, item.shape, item[...].tobytes())

    with h5py.File(path) as file:
        look("", file)
        file.visititems(look)
    return held


def differences(out, other):
    """What differs between two runs: every dataset and attribute of every snapshot, the index, and the diagnostics."""
    out, other = Path(out), Path(other)
    found = []
    names = sorted(path.name for path in (out / "snapshots").iterdir())
    if names != sorted(path.name for path in (other / "snapshots").iterdir()):
        return ["which snapshots there are"]
    for name in names:
        one, two = contents(out / "snapshots" / name), contents(other / "snapshots" / name)
        found += [f"{name}: {key}" for key in sorted(one.keys() | two.keys()) if one.get(key) != two.get(key)]
    for name in ("diagnostics.csv", "snapshots.xdmf"):
        if (out / name).read_bytes() != (other / name).read_bytes():
            found.append(name)
    return found


def datasets(out):
    """How many datasets the snapshots of a run hold."""
    return sum(
        sum(1 for kind, _, _ in contents(path).values() if kind is not None)
        for path in (Path(out) / "snapshots").iterdir()
    )


def crossings(out):
    """Particles that went over each cut between ranks that held particles' layers, in either direction."""
    told = report(out)
    sent, edges = np.array(told["sent"]), told["edges"]
    cuts = [rank for rank in range(1, len(sent)) if edges[rank] < edges[-1]]
    return [int(sent[:rank, rank:].sum() + sent[rank:, :rank].sum()) for rank in cuts]


def last_points(out):
    """(n, 3) positions in the last snapshot, in m."""
    with h5py.File(sorted((Path(out) / "snapshots").iterdir())[-1]) as file:
        return file["VTKHDF/Points"][...]


def state_bits(simulation):
    """Everything the particles carry, of all ranks in the one global order of each law, and the simulation's numbers."""
    held, record = simulation.state().populations, simulation.state().record
    own = [(p.rows(slice(None)), p.id[p.lanes], p.segment_table()) for p in held]
    everyone = simulation.comm.gather(own)
    return [
        [b"".join(rank[law][part].tobytes() for rank in everyone) for part in range(3)] for law in range(len(own))
    ], record
