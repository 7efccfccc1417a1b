"""What a run left behind and something damaged since: it is described, or named as damaged, and nothing crashes."""

import json
import os
import random
import shutil
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from pmpm.cli import main

TESTS = Path(__file__).parents[1]
SNAPSHOT = "snapshots/000001.hdf"
SCENE = """
title = "a drop"
[domain]
size = [0.2, 0.2]
cell_size = 0.02
[time]
end = 0.01
[materials.sand]
model = "drucker_prager"
density = 1000.0
youngs_modulus = 1e5
poisson_ratio = 0.3
friction_angle = 30.0
[[bodies]]
material = "sand"
shape = { type = "box", min = [0.0, 0.0], max = [0.1, 0.1] }
[output]
snapshot_interval = 1e-4
diagnostics_interval = 1e-4
fields = ["velocity", "pressure", "stress", "v_c"]
"""
OTHER_VALUES = (
    None, True, -1, 0, 1.5, 10**30, "", "x", [], [1], {}, {"pid": 10**30}, {"a": {"b": []}}, "9" * 10_000, [[]] * 3
)  # fmt: skip
TEXTS = {
    "run.json": ("", "null", "[]", "{}", '"pmpm run"', '{"format": "pmpm run"}', "[" * 100_000, '{"status": ' * 10_000,
                 "9" * 10_000, '{"format": "pmpm run", "status": "running"}', '{"format": "pmpm run", "status": null}', "NaN"),
    "run.lock": ("", "null", "[]", '{"host": 1, "pid": 1e400}', '{"pid": ' + "9" * 30 + "}", "[" * 100_000, '{"pid": "x"}'),
    "scene.toml": ("", "title = 1", "title = [", "[[title]]", "x = " + "[" * 3000, "\0", "title = " + "9" * 5000,
                   "a" * 100_000),
    "diagnostics.csv": ("", "\n", "step\n", "step,time\n1\n", "step,time\n1,2,3\n", "time\nx\n",
                        "step,time\n" + "9" * 30 + ",1\n", "step,step\n1,2\n", ",,\n,,\n", '"step\n1\n',
                        "step,time\n1.5,2\n", "time\n1e999\n", "a,b\n\0,\0\n",
                        "x" * 200_000 + "\n1\n", "step\n" * 3, "time\n" + "nan\n" * 3),
    "snapshots/000000.hdf": ("", "hello", "\x89HDF\r\n\x1a\n", "\x89HDF\r\n\x1a\n" + "\0" * 4000),
}  # fmt: skip


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A short run of sand, as it should be."""
    folder = tmp_path_factory.mktemp("whole")
    (folder / "sand.toml").write_text(SCENE, encoding="utf-8")
    arguments = ["run", str(folder / "sand.toml"), "--out", str(folder / "run"), "--quiet", "--steps", "3"]
    assert main(arguments) == 0
    return folder / "run"


@pytest.fixture
def copies(run, tmp_path):
    """A function that makes one more copy of the run, and returns its folder."""
    made = []

    def copy():
        made.append(tmp_path / f"{len(made):04d}")
        shutil.copytree(run, made[-1])
        return made[-1]

    return copy


def problems(paths):
    """[(path, what was wrong)] of what is read at these paths, in a process that may crash."""
    found, paths = [], list(paths)
    while paths:
        done = read_in_a_process(paths)
        found += [(str(path), text) for path, texts in zip(paths, done, strict=False) for text in texts]
        if len(done) < len(paths):
            found.append((str(paths[len(done)]), "the process crashed"))
        paths = paths[len(done) + 1 :]
    return found


def read_in_a_process(paths):
    lines = "".join(json.dumps(str(path)) + "\n" for path in paths)
    path = os.pathsep.join([str(TESTS), os.environ.get("PYTHONPATH", "")])
    finished = subprocess.run(
        [sys.executable, TESTS / "drivers" / "describe_files.py"],
        input=lines,
        capture_output=True,
        text=True,
        env=os.environ | {"PYTHONPATH": path},
    )
    return [json.loads(line) for line in finished.stdout.splitlines()]


def flipped(content, chance, bits):
    content = bytearray(content)
    for _ in range(bits):
        content[chance.randrange(len(content))] ^= 1 << chance.randrange(8)
    return bytes(content)


def overwritten(content, chance):
    first = chance.randrange(len(content))
    length = chance.randrange(1, 200)
    filling = bytes([chance.choice((0, 255, chance.randrange(256)))]) * length
    return content[:first] + filling + content[first + length :]


def damaged_bytes(content, seed):
    """A file with bits flipped, cut off, or with a piece overwritten; most often near its beginning, where HDF5 has tables."""
    chance = random.Random(seed)
    kind = seed % 4
    if kind == 0:
        return content[: chance.randrange(len(content))]
    if kind == 1:
        return overwritten(content, chance)
    head = chance.choice((96, 800, 4000, len(content)))
    return flipped(content[:head], chance, chance.choice((1, 1, 5, 50))) + content[head:]


def test_a_snapshot_with_damaged_bytes_is_described_or_refused(run, tmp_path):
    content, made = (run / SNAPSHOT).read_bytes(), []
    for seed in range(200):
        made.append(tmp_path / f"{seed}.hdf")
        made[-1].write_bytes(damaged_bytes(content, seed))
    assert problems(made) == []


def others(name):
    """Other things that may stand under the name of a dataset or group, as functions of the file."""
    return {
        "nothing": lambda file: None,
        "group": lambda file: file.create_group(name),
        "text": lambda file: file.create_dataset(name, data="hello"),
        "texts": lambda file: file.create_dataset(name, data=["a", "b"], dtype=h5py.string_dtype()),
        "number": lambda file: file.create_dataset(name, data=1.0),
        "no rows": lambda file: file.create_dataset(name, data=np.zeros((0, 3))),
        "few rows": lambda file: file.create_dataset(name, data=np.zeros((2, 3))),
        "whole numbers": lambda file: file.create_dataset(name, data=np.zeros(100, np.int8)),
        "pairs": lambda file: file.create_dataset(name, data=np.zeros(100, [("a", "f4"), ("b", "i8")])),
        "complex": lambda file: file.create_dataset(name, data=np.zeros(100, complex)),
        "references": lambda file: file.create_dataset(name, data=[file.ref] * 2, dtype=h5py.ref_dtype),
        "lists": lambda file: file.create_dataset(name, shape=100, dtype=h5py.vlen_dtype(np.float64)),
        "empty": lambda file: file.create_dataset(name, data=h5py.Empty("f8")),
        "cube": lambda file: file.create_dataset(name, data=np.zeros((4, 3, 2))),
        "endless": lambda file: file.create_dataset(name, shape=(2**40, 3), dtype="f8", chunks=(1024, 3)),
        "loop": lambda file: file.__setitem__(name, h5py.SoftLink("/" + name)),
        "elsewhere": lambda file: file.__setitem__(name, h5py.ExternalLink("/nowhere.hdf", "/x")),
        "type": lambda file: file.__setitem__(name, np.dtype("f8")),
    }


def test_a_snapshot_with_something_else_under_a_name_is_described_or_refused(run, tmp_path):
    names, made = [], []
    with h5py.File(run / SNAPSHOT) as file:
        file.visit(names.append)
    for name in ("VTKHDF", "pmpm", "VTKHDF/Points", "VTKHDF/PointData", *names[::4], "pmpm/drucker_prager/v_c"):
        for kind, put in others(name).items():
            made.append(tmp_path / f"{len(made)} {kind}.hdf")
            shutil.copy(run / SNAPSHOT, made[-1])
            with h5py.File(made[-1], "r+") as file:
                del file[name]
                put(file)
    assert problems(made) == []


def test_a_snapshot_with_other_attributes_is_described_or_refused(run, tmp_path):
    values = (
        "x",
        b"\xff\xfe",
        1,
        -1,
        1e300,
        float("nan"),
        [1.0, 2.0],
        ["a", "b"],
        h5py.Empty("f8"),
        np.zeros((2, 2)),
        2**62,
        None,
    )
    made = []
    for name in ("format_version", "time", "step", "dt", "title", "dim", "precision", "materials"):
        for value in (*values, None):
            made.append(tmp_path / f"{len(made)}.hdf")
            shutil.copy(run / SNAPSHOT, made[-1])
            with h5py.File(made[-1], "r+") as file:
                del file["pmpm"].attrs[name]
                if value is not None:
                    file["pmpm"].attrs[name] = value
    assert problems(made) == []


def test_a_run_with_damaged_texts_is_described_or_refused(run, copies):
    made = []
    for name in ("run.json", "scene.toml", "diagnostics.csv"):
        content = (run / name).read_bytes()
        for seed in range(12):
            made.append(copies())
            (made[-1] / name).write_bytes(damaged_bytes(content, seed))
    assert problems(made) == []


def test_a_run_with_other_texts_is_described_or_refused(copies):
    made = []
    for name, texts in TEXTS.items():
        for text in texts:
            made.append(copies())
            if name == "run.lock":  # nobody reads it when the run is finished
                record = (made[-1] / "run.json").read_text(encoding="utf-8")
                (made[-1] / "run.json").write_text(record.replace("stopped early", "running"), encoding="utf-8")
            (made[-1] / name).write_bytes(text.encode("latin-1"))
    assert problems(made) == []


@pytest.mark.parametrize("command", ["plot", "render"])
def test_a_run_with_other_texts_is_drawn_or_refused(command, run, copies):
    record, whole = json.loads((run / "run.json").read_text(encoding="utf-8")), copies()
    phases = [json.dumps(record | {"report": {"seconds_per_phase": value}}) for value in OTHER_VALUES]
    cell = (run / "scene.toml").read_text(encoding="utf-8")
    sizes = [cell.replace("cell_size = 0.02", f"cell_size = {value}") for value in ("0.0", '"x"', "nan", "[]", "1e400")]
    texts = TEXTS | {"run.json": (*TEXTS["run.json"], *phases), "scene.toml": (*TEXTS["scene.toml"], *sizes)}
    for name, variants in texts.items():
        before = (whole / name).read_bytes() if (whole / name).exists() else None
        for text in variants:
            (whole / name).write_bytes(text.encode("latin-1"))
            assert main([command, str(whole)]) in (0, 2), (name, text[:60])
        if before is None:
            (whole / name).unlink()
        else:
            (whole / name).write_bytes(before)


def test_a_run_with_other_words_in_its_record_is_described_or_refused(run, copies):
    record, made = json.loads((run / "run.json").read_text(encoding="utf-8")), []
    for key in record:
        for value in OTHER_VALUES[:: 1 if key in ("status", "hosts", "versions") else 5]:
            made.append(copies())
            (made[-1] / "run.json").write_text(json.dumps(record | {key: value}), encoding="utf-8")
    assert problems(made) == []


def folder(path):
    path.mkdir()


def loop(path):
    path.symlink_to(path.name)


@pytest.mark.parametrize(
    "put", [folder, loop, lambda path: path.symlink_to("nowhere")], ids=("folder", "loop", "nowhere")
)
def test_a_run_with_no_file_where_one_should_be_is_described_or_refused(copies, put):
    made = []
    for name in ("run.json", "run.lock", "scene.toml", "diagnostics.csv", "snapshots", SNAPSHOT):
        made.append(copies())
        place = made[-1] / name
        shutil.rmtree(place) if place.is_dir() else place.unlink(missing_ok=True)
        put(place)
    assert problems(made) == []
