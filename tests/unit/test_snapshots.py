"""Snapshots are read back by VTK, in both of their roles, and are whole or not there."""

import errno
import os
import time
from xml.etree import ElementTree

import h5py
import numpy as np
import pytest
from fake_simulation import SAND, FakeSimulation, fake_scene

from pmpm.output import snapshots
from pmpm.output.files import OutputError
from pmpm.output.run_directory import RunDirectory
from pmpm.output.snapshots import SnapshotWriter
from pmpm.parallel.comm import Alone

vtk = pytest.importorskip("vtk")
from vtk.util.numpy_support import vtk_to_numpy  # noqa: E402


@pytest.fixture
def directory(tmp_path):
    return RunDirectory.create(tmp_path / "run", "", Alone())


def write(directory, times=(0.3,), **of_scene):
    """Write one snapshot at each time; returns the simulation as it was at the last one."""
    simulation = FakeSimulation(fake_scene(**of_scene))
    writer = SnapshotWriter(directory, simulation.scene)
    for simulation.time in times:
        simulation.all["x"] += 0.01
        writer(simulation)
    return simulation


def first_file(directory):
    return directory.path / "snapshots" / "000000.hdf"


def read_vtkhdf(path):
    reader = vtk.vtkHDFReader()
    assert reader.CanReadFile(str(path))
    reader.SetFileName(str(path))
    reader.Update()
    return reader.GetOutput()


def read_index(path, step):
    reader = vtk.vtkXdmfReader()
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    information = reader.GetOutputInformation(0)
    times = [
        information.Get(vtk.vtkStreamingDemandDrivenPipeline.TIME_STEPS(), k)
        for k in range(information.Length(vtk.vtkStreamingDemandDrivenPipeline.TIME_STEPS()))
    ]
    reader.UpdateTimeStep(times[step])
    return times, reader.GetOutputDataObject(0)


def array(grid, name):
    return vtk_to_numpy(grid.GetPointData().GetArray(name))


def test_vtk_reads_back_positions_and_one_vertex_per_particle(directory):
    simulation = write(directory)
    grid = read_vtkhdf(first_file(directory))
    np.testing.assert_array_equal(vtk_to_numpy(grid.GetPoints().GetData()), simulation.all["x"])
    assert grid.GetNumberOfCells() == simulation.count
    assert all(
        grid.GetCell(k).GetPointId(0) == k and grid.GetCellType(k) == vtk.VTK_VERTEX for k in range(simulation.count)
    )


@pytest.mark.parametrize("name", ["id", "velocity", "pressure", "stress", "material"])
def test_vtk_reads_back_every_field_bit_for_bit(directory, name):
    simulation = write(directory)
    np.testing.assert_array_equal(array(read_vtkhdf(first_file(directory)), name), simulation.all[name])


def test_in_two_dimensions_vectors_get_a_third_component_of_zero(directory):
    simulation = write(directory, dim=2)
    grid = read_vtkhdf(first_file(directory))
    for read, held in (
        (vtk_to_numpy(grid.GetPoints().GetData()), simulation.all["x"]),
        (array(grid, "velocity"), simulation.all["velocity"]),
    ):
        np.testing.assert_array_equal(read, np.pad(held, ((0, 0), (0, 1))))


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_positions_are_written_in_the_precision_of_the_scene(directory, precision):
    write(directory, precision=precision)
    with h5py.File(first_file(directory)) as file:
        assert file["VTKHDF/Points"].dtype == precision


@pytest.mark.parametrize("step", [0, 2])
def test_vtk_reads_the_index_at_each_time(directory, step):
    times = (0.0, 0.1 + 0.2, 2.0 / 3.0)
    simulation = write(directory, times)
    read_times, grid = read_index(directory.path / "snapshots.xdmf", step)
    assert read_times == list(times)
    np.testing.assert_allclose(
        vtk_to_numpy(grid.GetPoints().GetData()), simulation.all["x"] - 0.01 * (2 - step), rtol=0, atol=1e-15
    )
    assert grid.GetNumberOfCells() == simulation.count
    np.testing.assert_array_equal(array(grid, "velocity"), simulation.all["velocity"])


def test_every_dataset_the_index_names_exists_with_that_shape_and_type(directory):
    write(directory, times=(0.0, 1.0), fields=("velocity", "stress", "deformation_gradient", "material", "v_c"))
    items = list(ElementTree.parse(directory.path / "snapshots.xdmf").iter("DataItem"))
    assert len(items) == 2 * (2 + 6)
    for item in items:
        name, _, inside = item.text.partition(":/")
        with h5py.File(directory.path / name) as file:
            dataset = file[inside]
            assert item.get("Dimensions") == " ".join(map(str, dataset.shape))
            kind = {"Float": "f", "Int": "i"}[item.get("NumberType")]
            assert dataset.dtype == np.dtype(f"<{kind}{item.get('Precision')}")


def test_a_title_with_markup_leaves_the_index_readable(directory):
    write(directory, title='a < b & "c"')
    root = ElementTree.parse(directory.path / "snapshots.xdmf")
    assert root.find("Domain/Grid").get("Name") == 'a < b & "c"'


def test_every_dataset_is_contiguous(directory):
    write(directory, fields=("velocity", "v_c"))
    layouts = {}
    with h5py.File(first_file(directory)) as file:
        file.visititems(
            lambda name, item: (
                layouts.update({name: item.id.get_create_plist().get_layout()})
                if isinstance(item, h5py.Dataset)
                else None
            )
        )
    assert set(layouts.values()) == {h5py.h5d.CONTIGUOUS}
    assert "pmpm/drucker_prager/v_c" in layouts


def test_a_laws_own_state_is_stored_over_its_particles_only(directory):
    simulation = write(directory, fields=("hencky_strain", "v_c"))
    is_sand = simulation.all["material"] == SAND
    with h5py.File(first_file(directory)) as file:
        for name in ("hencky_strain", "v_c"):
            np.testing.assert_array_equal(file[f"pmpm/drucker_prager/{name}"], simulation.all[name][is_sand])
            np.testing.assert_array_equal(file[f"VTKHDF/PointData/{name}"], simulation.all[name])


def test_the_file_says_what_it_is(directory):
    simulation = write(directory, title="Säule")
    with h5py.File(first_file(directory)) as file:
        told = dict(file["pmpm"].attrs)
        unit = file["VTKHDF/PointData/pressure"].attrs["unit"]
    assert [name.decode() for name in told.pop("materials")] == ["water", "sand"]
    assert {name: getattr(value, "decode", lambda value=value: value)() for name, value in told.items()} == {
        "format_version": 1,
        "time": 0.3,
        "step": 7,
        "dt": simulation.dt,
        "title": "Säule",
        "dim": 3,
        "precision": "float64",
    }
    assert unit == b"Pa"


def test_a_snapshot_without_particles_is_legal(directory):
    simulation = FakeSimulation(fake_scene(fields=("velocity", "v_c")), count=0)
    SnapshotWriter(directory, simulation.scene)(simulation)
    assert read_vtkhdf(first_file(directory)).GetNumberOfPoints() == 0


def test_a_snapshot_without_particles_does_not_spoil_the_index(directory):
    empty, simulation = FakeSimulation(fake_scene(), count=0), FakeSimulation(fake_scene())
    writer = SnapshotWriter(directory, simulation.scene)
    empty.time = 0.0
    writer(empty)
    writer(simulation)
    times, grid = read_index(directory.path / "snapshots.xdmf", 0)
    assert (times, grid.GetNumberOfPoints()) == ([simulation.time], simulation.count)


def test_the_same_particles_give_the_same_file_byte_for_byte_at_any_time_of_day(tmp_path):
    files = []
    for name in ("a", "b"):
        time.sleep(1.1)  # HDF5 would record whole seconds
        directory = RunDirectory.create(tmp_path / name, "", Alone())
        write(directory)
        files.append(first_file(directory).read_bytes())
    assert files[0] == files[1]


def test_short_writes_are_continued(directory, monkeypatch):
    whole = os.pwrite
    monkeypatch.setattr(os, "pwrite", lambda fd, data, place: whole(fd, data[:100], place))
    simulation = write(directory)
    np.testing.assert_array_equal(array(read_vtkhdf(first_file(directory)), "stress"), simulation.all["stress"])


def fail_after(calls, monkeypatch):
    whole, left = os.pwrite, [calls]

    def pwrite(fd, data, place):
        left[0] -= 1
        if left[0] < 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return whole(fd, data, place)

    monkeypatch.setattr(os, "pwrite", pwrite)


def test_a_full_disk_is_an_error_that_names_the_snapshot(directory, monkeypatch):
    fail_after(3, monkeypatch)
    with pytest.raises(OutputError, match=r"000000\.hdf.*No space left"):
        write(directory)


def test_a_failed_snapshot_leaves_no_file_and_no_line_in_the_index(directory, monkeypatch):
    simulation = FakeSimulation(fake_scene())
    writer = SnapshotWriter(directory, simulation.scene)
    writer(simulation)
    before = (directory.path / "snapshots.xdmf").read_text()
    fail_after(3, monkeypatch)
    with pytest.raises(OutputError):
        writer(simulation)
    assert [entry.name for entry in (directory.path / "snapshots").iterdir()] == ["000000.hdf"]
    assert (directory.path / "snapshots.xdmf").read_text() == before


def test_the_index_names_a_snapshot_only_when_that_is_in_place(directory, monkeypatch):
    seen = []

    def look(path, text):
        seen.extend((directory.path / "snapshots" / f"{k:06d}.hdf").exists() for k in range(text.count("<Time")))

    monkeypatch.setattr(snapshots, "write_atomically", look)
    write(directory, times=(0.0, 1.0))
    assert seen == [True, True, True]


def test_a_field_with_missing_rows_is_refused(directory):
    simulation = FakeSimulation(fake_scene())
    simulation.all["pressure"] = simulation.all["pressure"][:-1]
    with pytest.raises(OutputError, match="pressure has 39 rows for 40 particles"):
        SnapshotWriter(directory, simulation.scene)(simulation)
