"""What is given for ParaView: VTK reads the index over time, and the script that opens a run calls what ParaView has.

ParaView itself is not among what tests install: its module is stood in for by one that notes what is asked of it.
"""

import runpy
import sys
from types import ModuleType
from unittest.mock import MagicMock

import numpy as np
import pytest
from launch import ROOT

import pmpm
from pmpm.cli import main

SCRIPT = ROOT / "docs" / "paraview" / "open_run.py"


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("paraview")
    solid = {"model": "neo_hookean", "density": 1000.0, "youngs_modulus": 1e5, "poisson_ratio": 0.3}
    scene = pmpm.Scene(
        domain={"size": [0.6, 0.4, 0.5], "cell_size": 0.05, "gravity": [0.0, -10.0, 0.0]},
        time={"end": 0.02},
        materials={"m": solid},
        bodies=[{"material": "m", "shape": {"type": "box", "min": [0.1, 0.1, 0.1], "max": [0.2, 0.2, 0.2]}}],
        output={"snapshot_interval": 0.01, "fields": ["velocity", "volume", "strain"]},
    )
    (folder / "a.toml").write_text(scene.to_toml(), encoding="utf-8")
    assert main(["run", str(folder / "a.toml"), "--out", str(folder / "run"), "--quiet"]) == 0
    return folder / "run"


def test_pyvista_reads_the_index_over_time(run):
    pyvista = pytest.importorskip("pyvista")
    reader = pyvista.get_reader(str(run / "snapshots.xdmf"))
    snapshots = pmpm.load(run).snapshots
    assert reader.time_values == pytest.approx([snapshot.time for snapshot in snapshots])
    reader.set_active_time_value(reader.time_values[-1])
    mesh = reader.read()
    assert np.array_equal(mesh.points, snapshots[-1].x)
    assert np.array_equal(mesh["velocity"], snapshots[-1].velocity)
    assert np.array_equal(mesh["volume"], snapshots[-1].volume)


def test_vtk_reads_tensors_of_a_snapshot_in_their_order(run):
    vtk_hdf = pytest.importorskip("vtkmodules.vtkIOHDF")
    numpy_support = pytest.importorskip("vtkmodules.util.numpy_support")
    snapshot = pmpm.load(run).snapshots[-1]
    reader = vtk_hdf.vtkHDFReader()
    reader.SetFileName(str(snapshot.path))
    reader.Update()
    strain = reader.GetOutput().GetPointData().GetArray("strain")
    assert [strain.GetNumberOfComponents(), strain.GetNumberOfTuples()] == [6, len(snapshot.x)]
    assert np.array_equal(numpy_support.vtk_to_numpy(strain), snapshot.strain)


def test_the_script_opens_the_index_by_its_full_path_with_spheres_as_wide_as_particles(run, tmp_path, monkeypatch):
    simple = MagicMock()
    paraview = ModuleType("paraview")
    paraview.simple = simple  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "paraview", paraview)
    monkeypatch.chdir(run.parent)
    monkeypatch.setattr(sys, "argv", [str(SCRIPT), "run", str(tmp_path / "a.png")])
    runpy.run_path(str(SCRIPT))
    simple.Xdmf3ReaderS.assert_called_once_with(FileName=[str(run / "snapshots.xdmf")])
    view = simple.GetActiveViewOrCreate.return_value
    assert view.CameraViewUp == [0.0, 1.0, 0.0]
    assert view.CameraPosition == [0.5, 0.5, 1.0]  # not along what is up
    assert simple.Show.return_value.GaussianRadius == pytest.approx(0.62 * 0.025)
    simple.SaveScreenshot.assert_called_once_with(str(tmp_path / "a.png"), view)
