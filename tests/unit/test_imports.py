"""What is absent costs nothing: no import for what a command or scene does not use."""

import json
import subprocess
import sys

import pytest

HEAVY = ("numba", "mpi4py", "h5py", "meshio", "matplotlib", "pydantic", "numpy")
WATCHERS = (
    "pmpm.sampling",
    "pmpm.series",
    "pmpm.maps",
    "pmpm.grid_fields",
    "pmpm.output.grids",
)  # of scenes with probes, gauges, maps and fields on nodes
WAYS = (
    "pmpm.collision",
    "pmpm.flow",
    "pmpm.scene.mesh_files",
    "pmpm.kernels.surfaces",
)  # of scenes with colliders, flows, meshes
ALONE_ABSENT = ("mpi4py", "numba.cuda", "meshio", "matplotlib", "vtk", "pyvista", "tifffile", "tqdm", *WATCHERS, *WAYS)


def modules_after(code, folder):
    """Names of the modules that are loaded after running `code` in a fresh Python."""
    program = f"import json, sys\n{code}\nprint(json.dumps(sorted(sys.modules)), file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", program], cwd=folder, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr
    return set(json.loads(done.stderr.splitlines()[-1]))


def test_importing_pmpm_loads_nothing_heavy(tmp_path):
    assert modules_after("import pmpm", tmp_path).isdisjoint(HEAVY)


@pytest.mark.parametrize("arguments", [["--help"], ["run", "--help"], ["point", "--help"], ["study", "--help"]])
def test_help_loads_nothing_heavy(tmp_path, arguments):
    code = f"from pmpm.cli import main\ntry: main({arguments!r})\nexcept SystemExit: pass"
    assert modules_after(code, tmp_path).isdisjoint(set(HEAVY) - {"numpy"})


def test_one_rank_of_dam_break_loads_neither_mpi_nor_cuda_nor_meshes(tmp_path):
    code = "from pmpm.cli import main\nassert main(['run', 'dam_break', '--steps', '2', '--quiet']) == 0"
    loaded = modules_after(code, tmp_path)
    assert loaded.isdisjoint(ALONE_ABSENT)
    assert {"numba", "h5py"} <= loaded


@pytest.mark.parametrize("command", ["scenes", "schema"])
def test_telling_of_scenes_needs_no_kernels(tmp_path, command):
    assert "numba" not in modules_after(f"from pmpm.cli import main\nmain([{command!r}])", tmp_path)


def test_a_driven_point_needs_no_kernels_no_mpi_and_no_pictures(tmp_path):
    code = "from pmpm.cli import main\nassert main(['point', 'drucker_prager', '--steps', '5']) == 0"
    assert modules_after(code, tmp_path).isdisjoint({"numba", "mpi4py", "matplotlib"})
