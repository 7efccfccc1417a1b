"""Checkpoint files: what is kept, which damage is found, and what a hostile file can do."""

import json
import os
import shutil

import h5py
import numpy as np
import pytest
import several_laws
from xxhash import xxh3_64

from pmpm.output import checkpoints, manifests
from pmpm.output.checkpoints import CheckpointWriter
from pmpm.output.files import OutputError
from pmpm.output.manifests import complaint_about, newest_good, read_manifest, write_manifest
from pmpm.output.reader import Snapshot, describe
from pmpm.output.run_directory import RunDirectory
from pmpm.parallel.comm import Alone
from pmpm.scene.errors import SceneError
from pmpm.simulation import Simulation

ALONE = Alone()


@pytest.fixture(scope="module")
def simulation():
    simulation = Simulation(several_laws.tall())
    simulation.run(steps=10)
    return simulation


@pytest.fixture(scope="module")
def good(simulation, tmp_path_factory):
    """A good checkpoint, not to be changed."""
    path = tmp_path_factory.mktemp("good") / "000000.hdf"
    simulation.save(path)
    return path


@pytest.fixture
def copy(good, tmp_path):
    """A copy of it, for damage."""
    for path in (good, good.with_suffix(".json")):
        shutil.copy(path, tmp_path)
    return tmp_path / good.name


@pytest.fixture
def directory(tmp_path):
    return RunDirectory.create(tmp_path / "run", "", ALONE)


def written(simulation, directory, count, keep=2, bad=()):
    """A run's folder of checkpoints after `count` of them."""
    writer = CheckpointWriter(directory, keep, bad=bad)
    for _ in range(count):
        simulation.step()
        writer(simulation)
    return directory.path / "checkpoints"


def names(folder):
    return sorted(os.listdir(folder))


# ---- what is written -----------------------------------------------------------------------------------------------------


def test_a_checkpoint_is_a_snapshot_with_the_same_positions_and_velocities(simulation, good):
    snapshot, particles = Snapshot(good), simulation.particles
    assert snapshot.x.tobytes() == particles.x.tobytes()
    assert snapshot.velocity.tobytes() == particles.v.tobytes()
    assert snapshot.id.tobytes() == particles.id.tobytes()
    assert (snapshot.step, snapshot.time) == (10, simulation.time)


def test_a_checkpoint_opens_in_paraview(simulation, good):
    from vtkmodules.vtkIOHDF import vtkHDFReader

    reader = vtkHDFReader()
    reader.SetFileName(str(good))
    reader.Update()
    held = reader.GetOutput()
    assert held.GetNumberOfPoints() == held.GetNumberOfCells() == simulation.rows()


def test_info_shows_the_state_of_each_law(good):
    text = describe(good)
    assert all(f"{law}/{field}" in text for law, field in [("fluid", "J"), ("drucker_prager", "v_c"), ("fluid", "C")])


def test_every_number_of_a_particle_is_in_the_file(simulation, good):
    with h5py.File(good) as file:
        for label, layout in zip(("fluid", "drucker_prager"), simulation.layouts, strict=True):
            kept = {*file[f"pmpm/{label}"], *file[f"restart/{label}"]}
            assert kept >= {field.name for field in layout.fields if field.name not in ("x", "v")} | {"place"}


def test_every_byte_is_under_a_checksum(good):
    """Ranges of datasets, and all the rest under one: none lies in two ranges, and none in neither."""
    held = read_manifest(good)
    data = good.read_bytes()
    rest = bytearray(data)
    for ranges in held["datasets"].values():
        for first, nbytes, said in ranges:
            assert xxh3_64(data[first : first + nbytes]).intdigest() == said
            rest[first : first + nbytes] = b"\xff" * nbytes
    between, place = b"", 0
    for first, nbytes, _ in sorted(r for ranges in held["datasets"].values() for r in ranges):
        between, place = between + data[place:first], first + nbytes
    assert xxh3_64(between + data[place:]).intdigest() == held["rest"]
    assert len(between + data[place:]) + sum(r[1] for ranges in held["datasets"].values() for r in ranges) == len(data)


@pytest.mark.parametrize("keep", [1, 3])
def test_at_most_so_many_are_kept(simulation, directory, keep):
    folder = written(simulation, directory, 5, keep)
    assert names(folder) == [f"{n:06d}.{end}" for n in range(5 - keep, 5) for end in ("hdf", "json")]


def test_a_number_is_never_used_again(simulation, directory):
    folder = written(simulation, directory, 3)
    for name in names(folder):
        if name != "000002.json":
            (folder / name).unlink()
    assert "000003.json" in names(written(simulation, directory, 1))


def test_damaged_ones_do_not_count_among_those_kept(simulation, directory):
    folder = written(simulation, directory, 2)
    (folder / "000001.hdf").write_bytes(b"")
    written(simulation, directory, 1, bad=[1])
    assert {"000000.json", "000002.json"} <= set(names(folder))


def test_what_an_ended_process_left_goes_with_the_next_checkpoint(simulation, directory):
    folder = written(simulation, directory, 1)
    for name in (".000001.hdf.unfinished", "000002.hdf", ".000003.json.unfinished"):
        (folder / name).write_bytes(b"half")
    written(simulation, directory, 1)
    assert names(folder) == ["000000.hdf", "000000.json", "000004.hdf", "000004.json"]


def test_a_failed_write_leaves_the_older_ones_and_no_half_file(simulation, directory, monkeypatch):
    folder = written(simulation, directory, 2)
    before = {name: (folder / name).read_bytes() for name in names(folder)}

    def full(descriptor, data, place):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "pwrite", full)
    simulation.step()
    with pytest.raises(OutputError, match="000002.hdf cannot be written: No space left on device"):
        CheckpointWriter(directory, 2)(simulation)
    assert {name: (folder / name).read_bytes() for name in names(folder)} == before


# ---- damage --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("part", range(16))
def test_a_file_cut_short_is_not_good(copy, part):
    os.truncate(copy, part * copy.stat().st_size // 16)
    assert "damaged" in complaint_about(copy, ALONE)


@pytest.mark.parametrize("part", range(16))
def test_a_manifest_cut_short_is_not_good(copy, part):
    manifest = copy.with_suffix(".json")
    os.truncate(manifest, part * manifest.stat().st_size // 16)
    assert "damaged" in complaint_about(copy, ALONE)


def test_any_flipped_bit_is_found(copy):
    """200 places spread over the file by a fixed generator, and 50 over the manifest."""
    random = np.random.default_rng(5)
    for path, count in ((copy, 200), (copy.with_suffix(".json"), 50)):
        data = path.read_bytes()
        for place, bit in zip(random.integers(len(data), size=count), random.integers(8, size=count), strict=True):
            flipped = bytearray(data)
            flipped[place] ^= 1 << int(bit)
            path.write_bytes(flipped)
            assert complaint_about(copy, ALONE), f"bit {bit} of byte {place} of {path.name}"
        path.write_bytes(data)
    assert complaint_about(copy, ALONE) is None


def test_the_newest_good_one_is_taken_and_nothing_is_touched(simulation, directory):
    folder = written(simulation, directory, 4, keep=4)
    os.truncate(folder / "000003.hdf", 1000)
    (folder / "000002.json").unlink()
    (folder / "000004.hdf").write_bytes(b"")
    before = {name: (folder / name).read_bytes() for name in names(folder)}
    path, complaints = newest_good(folder, ALONE)
    assert path == folder / "000001.hdf"
    assert [number for number, _ in complaints] == [3]
    assert {name: (folder / name).read_bytes() for name in names(folder)} == before


def test_a_file_without_manifest_is_none(copy):
    copy.with_suffix(".json").unlink()
    assert "is no finished checkpoint: it has no manifest 000000.json" in complaint_about(copy, ALONE)


@pytest.mark.parametrize("key", ["format_version", "snapshot_version"])
def test_another_version_is_refused_by_name(copy, key):
    sign(copy, {key: 2})
    assert "has checkpoint format_version" in complaint_about(copy, ALONE)
    assert "2" in complaint_about(copy, ALONE)


# ---- hostile files: signed like good ones -------------------------------------------------------------------------------


def sign(path, changes):
    """Change what a manifest says, with a right checksum."""
    manifest = path.with_suffix(".json")
    held = json.loads(manifest.read_text()) | changes
    held.pop("manifest")
    manifest.write_text(json.dumps(held | {"manifest": xxh3_64(manifests.canonical(held)).intdigest()}))


@pytest.mark.parametrize(
    "changes",
    [
        {"datasets": {"a": [[0, 1 << 60, 0]]}},
        {"datasets": {"a": [[-5, 3, 0]]}},
        {"datasets": {"a": [[5, 10, 0], [6, 10, 0]]}},
        {"datasets": {"a": [["0", 3, 0]]}},
        {"datasets": {"a": [[0.5, 3, 0]]}},
        {"datasets": {"a": 7}},
        {"datasets": []},
        {"bytes": -1},
        {"bytes": True},
        {"precision": "float16"},
        {"time": "soon"},
    ],
)
def test_a_manifest_that_says_what_none_says_is_refused(copy, changes):
    sign(copy, changes)
    assert complaint_about(copy, ALONE)


def replaced(path, name, rows):
    """Put other rows into a dataset, and sign the file anew."""
    with h5py.File(path, "r+") as file:
        del file[name]
        if rows is not None:
            file.create_dataset(name, data=rows)
    write_manifest(path, [{}], json.loads(path.with_suffix(".json").read_text()))


def held(path, name):
    with h5py.File(path) as file:
        return file[name][...]


def with_value(rows, index, value):
    rows = rows.copy()
    rows[index] = value
    return rows


SEGMENTS, PLACE = "restart/fluid/segments", "restart/fluid/place"
HOSTILE = {
    "a count below zero": (SEGMENTS, lambda rows: with_value(rows, (0, 1), -5)),
    "a count too large": (SEGMENTS, lambda rows: with_value(rows, (0, 1), 1 << 62)),
    "a layer out of the domain": (SEGMENTS, lambda rows: with_value(rows, (-1, 0), 1 << 40)),
    "layers out of order": (SEGMENTS, lambda rows: rows[::-1]),
    "a body that is none": (SEGMENTS, lambda rows: with_value(rows, (0, 2), 999)),
    "a base out of the domain": (SEGMENTS, lambda rows: with_value(rows, (0, 4), 5000)),
    "segments of another shape": (SEGMENTS, lambda rows: rows[:, :4]),
    "segments as reals": (SEGMENTS, lambda rows: rows.astype(float)),
    "no segments": (SEGMENTS, lambda rows: None),
    "a place far away": (PLACE, lambda rows: with_value(rows, (0, 0), 1 << 62)),
    "a place outside the domain": (PLACE, lambda rows: with_value(rows, (0, 1), -(100 << 52))),
    "a place beyond its layer": (PLACE, lambda rows: with_value(rows, 0, 2 << 52)),
    "places too few": (PLACE, lambda rows: rows[:-1]),
    "places of the wrong type": (PLACE, lambda rows: rows.astype(np.int32)),
    "ids too few": ("VTKHDF/PointData/id", lambda rows: rows[:-1]),
    "ids as text": ("VTKHDF/PointData/id", lambda rows: np.array([b"x"] * len(rows))),
    "velocities of one column": ("VTKHDF/PointData/velocity", lambda rows: rows[:, 0]),
    "a state of another shape": ("pmpm/fluid/J", lambda rows: np.stack([rows, rows])),
    "no state": ("pmpm/fluid/J", lambda rows: None),
    "a record that is no JSON": ("restart/record", lambda rows: rows[:-1]),
    "a record that is empty": ("restart/record", lambda rows: rows[:0]),
    "a deep record": ("restart/record", lambda rows: np.frombuffer(b"[" * 100_000, np.uint8)),
    "a scene that is no TOML": ("restart/scene", lambda rows: np.frombuffer(b"= 3", np.uint8)),
    "a scene that is no text": ("restart/scene", lambda rows: np.frombuffer(b"\xff\xfe\xff", np.uint8)),
    "another scene": ("restart/scene", lambda rows: np.frombuffer(several_laws.flat().to_toml().encode(), np.uint8)),
    "no scene": ("restart/scene", lambda rows: None),
}


@pytest.mark.parametrize("what", HOSTILE)
def test_a_hostile_file_is_refused_with_a_message(copy, what):
    name, change = HOSTILE[what]
    replaced(copy, name, change(held(copy, name)))
    assert complaint_about(copy, ALONE) is None  # its bytes are what its manifest says
    with pytest.raises((OutputError, SceneError)):
        Simulation.restart(copy)


RECORDS = {
    "time": -1.0,
    "step_count": 1.5,
    "dt": "short",
    "regroups": -3,
    "travelled": [[1.0, 2.0]],
    "control": {},
    "outputs": {"snapshots": -1},
    "counts": {"snapshots": [0.1]},
}


@pytest.mark.parametrize("key", RECORDS)
def test_numbers_that_cannot_be_are_refused(copy, key):
    record = json.loads(held(copy, "restart/record").tobytes()) | {key: RECORDS[key]}
    replaced(copy, "restart/record", np.frombuffer(json.dumps(record).encode(), np.uint8))
    with pytest.raises(OutputError, match="is damaged"):
        Simulation.restart(copy)


def test_a_file_that_points_to_another_one_is_refused(copy, tmp_path):
    """Neither external data nor a link out of the file is followed."""
    secret = tmp_path / "secret"
    secret.write_bytes(b"x" * 8000)
    shape = held(copy, "pmpm/fluid/J").shape
    with h5py.File(copy, "r+") as file:
        del file["pmpm/fluid/J"]
        file.create_dataset("pmpm/fluid/J", shape, float, external=[(str(secret), 0, h5py.h5f.UNLIMITED)])
    write_manifest(copy, [{}], json.loads(copy.with_suffix(".json").read_text()))
    with pytest.raises(OutputError, match="holds no dataset pmpm/fluid/J"):
        Simulation.restart(copy)


def test_a_random_file_with_a_right_manifest_ends_with_a_message(copy):
    """100 files with up to 30 changed bytes each, signed: HDF5 itself meets them."""
    data, random = copy.read_bytes(), np.random.default_rng(11)
    for _ in range(100):
        changed = bytearray(data)
        for place in random.integers(0, 12000, size=random.integers(1, 30)):  # where HDF5 keeps its own
            changed[place] = random.integers(256)
        copy.write_bytes(changed)
        resign(copy)
        try:
            resumed = Simulation.restart(copy)
        except (OutputError, SceneError):
            continue
        assert resumed.rows() > 0


def resign(path):
    """Give a file of any bytes a manifest with the right checksum."""
    data = path.read_bytes()
    sign(path, {"datasets": {}, "bytes": len(data), "rest": xxh3_64(data).intdigest()})


# ---- saving over what is there -------------------------------------------------------------------------------------------


def test_a_save_that_fails_leaves_the_checkpoint_that_was_there(tmp_path, monkeypatch):
    path = tmp_path / "here.hdf"
    simulation = Simulation(several_laws.flat())
    simulation.save(path)
    before = {entry.name: entry.read_bytes() for entry in tmp_path.iterdir()}
    simulation.run(steps=2)

    def full(file, manifest, told):
        raise OSError(28, "No space left on device", str(file))

    monkeypatch.setattr(checkpoints, "write_manifest", full)
    with pytest.raises(OutputError, match="here.hdf: No space left"):
        simulation.save(path)
    assert {entry.name: entry.read_bytes() for entry in tmp_path.iterdir()} == before


def test_a_save_takes_the_place_of_an_older_checkpoint(tmp_path):
    simulation = Simulation(several_laws.flat())
    for steps in (1, 2):
        simulation.run(steps=1)
        simulation.save(tmp_path / "here.hdf")
        assert Simulation.restart(tmp_path / "here.hdf").step_count == steps
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["here.hdf", "here.json"]


@pytest.mark.parametrize("text", ["{}", "", "my own"])
def test_a_save_overwrites_no_json_file_that_is_no_manifest(text, tmp_path):
    (tmp_path / "here.json").write_text(text)
    with pytest.raises(OutputError, match="here.json is no manifest of a checkpoint"):
        Simulation(several_laws.flat()).save(tmp_path / "here.hdf")
    assert [entry.name for entry in tmp_path.iterdir()] == ["here.json"]
    assert (tmp_path / "here.json").read_text() == text


def test_a_save_to_a_folder_or_into_none_is_refused(tmp_path):
    (tmp_path / "here.hdf").mkdir()
    simulation = Simulation(several_laws.flat())
    with pytest.raises(OutputError, match="here.hdf is a folder"):
        simulation.save(tmp_path / "here.hdf")
    with pytest.raises(OutputError, match="gone/here.hdf cannot be written: No such file or directory"):
        simulation.save(tmp_path / "gone" / "here.hdf")
