"""Fields on nodes: what they hold of states that are known, who reads them, and that runs keep them over ranks and restarts."""

from itertools import product

import launch
import numpy as np
import pytest
from bits import contents

import pmpm
from pmpm import estimate, grid_fields
from pmpm.cli import main
from pmpm.output.files import OutputError
from pmpm.physics import bspline

CELL = 0.05
WATER = {"model": "fluid", "density": 1e3, "sound_speed": 30.0, "tension_cutoff": False}
SOLID = {"model": "neo_hookean", "density": 2e3, "youngs_modulus": 1e6, "poisson_ratio": 0.3}
SPLINES = {
    "linear": (bspline.weights_linear, 0, 0.0),
    "quadratic": (bspline.weights_quadratic, 1, 0.5),
    "cubic": (bspline.weights_cubic, 1, 0.0),
}


def still(dim=2, low=(0.0, 0.0, 0.0), high=(0.3, 0.2, 0.3), shape_function="quadratic", slab_axis=None, **domain):
    """A Simulation of a block of water, in 2-D beside a solid one; velocities and J differ from particle to particle."""
    size = [0.5, 0.4, 0.35][:dim]
    boxes = [{"type": "box", "min": low[:dim], "max": high[:dim]}]
    boxes.append({"type": "box", "min": [0.3, 0.0, 0.1][:dim], "max": [0.4, 0.3, 0.3][:dim]})
    scene = pmpm.Scene(
        domain={"size": size, "cell_size": CELL, "gravity": [0.0, -10.0, 0.0][:dim]} | domain,
        method={"shape_function": shape_function},
        time={"end": 1.0},
        materials={"water": WATER, "solid": SOLID},
        bodies=[{"material": name, "shape": box} for name, box in zip(("water", "solid"), boxes, strict=True)][
            : 4 - dim
        ],
        parallel={"slab_axis": slab_axis} if slab_axis else {},
    )
    simulation = pmpm.Simulation(scene)
    x = simulation.particles.x
    simulation.particles.v = np.sin(7.0 * x) + x[:, ::-1]
    simulation.particles.J = 1.0 + 0.01 * np.cos(20.0 * x[:, 0])  # of the water
    return simulation


def by_hand(simulation, shape_function, values):
    """(mass, mean) on the nodes of the domain, indexed by x, y, z: node by node, as the formula says, with plain numpy."""
    weights, low, rounding = SPLINES[shape_function]
    scene, dim = simulation.scene, simulation.dim
    x, m = simulation.particles.x / CELL, simulation.particles.mass
    counts = [n + ("xyz"[axis] not in scene.domain.periodic) for axis, n in enumerate(scene.cells)]
    values = values.reshape(len(m), -1)
    mass, sums = np.zeros(counts), np.zeros((*counts, values.shape[1]))
    for p in range(len(m)):
        along = []
        for axis in range(dim):
            centre = int(np.floor(x[p, axis] + rounding))
            shares = []
            for k, w in enumerate(weights(x[p, axis] - centre)):
                node = centre - low + k
                if "xyz"[axis] in scene.domain.periodic:
                    shares.append((node % scene.cells[axis], w))
                else:
                    shares.append((scene.cells[axis] - abs(scene.cells[axis] - abs(node)), w))  # walls are mirrors
            along.append(shares)
        for corner in product(*along):
            node, w = tuple(n for n, _ in corner), np.prod([w for _, w in corner])
            mass[node] += w * m[p]
            sums[node] += w * m[p] * values[p]
    with np.errstate(all="ignore"):
        return mass, sums / mass[..., None]


def by_axes(rows, dim):
    return rows.transpose(*reversed(range(dim)), *range(dim, rows.ndim))


@pytest.mark.parametrize(
    ("dim", "shape_function", "slab_axis", "periodic"),
    [(2, "linear", "x", []), (2, "quadratic", "y", ["x"]), (2, "cubic", "y", ["y"]), (3, "quadratic", "x", ["z"])],
)  # fmt: skip
def test_nodes_hold_the_means_by_mass_and_spline(dim, shape_function, slab_axis, periodic):
    low = (0.12, 0.0, 0.0) if "y" not in periodic else (0.0, 0.0, 0.0)
    simulation = still(dim, low, shape_function=shape_function, slab_axis=slab_axis, periodic=periodic)
    found = grid_fields.of_nodes(simulation, ["velocity", "mass", "J"])
    v = simulation.particles.v
    mass, velocity = by_hand(simulation, shape_function, v)
    np.testing.assert_allclose(by_axes(found["mass"], dim), mass, rtol=1e-11, atol=0)
    assert np.array_equal(np.isnan(found["velocity"][..., 0]), found["mass"] == 0.0)
    np.testing.assert_allclose(by_axes(found["velocity"], dim)[..., :dim], velocity, rtol=1e-9, atol=1e-12)
    assert found["velocity"].shape[-1] == 3
    _, J = by_hand(simulation, shape_function, simulation.fields(["J"])["J"])
    np.testing.assert_allclose(by_axes(found["J"], dim), J[..., 0], rtol=1e-11, atol=0)
    assert found["mass"].sum() == pytest.approx(simulation.measure()["mass"], rel=1e-12)


@pytest.mark.parametrize(("wall", "at_face"), [("slip", [1000.0, 1000.0]), ("free", [500.0, 984.375])])
def test_density_is_that_of_the_material_up_to_a_wall_that_holds_it(wall, at_face):
    """Half of what a node on a free end reaches lies beyond it, and 1/64 of the next one's: two particles along a cell."""
    simulation = still(walls={"x_min": wall})
    density = grid_fields.of_nodes(simulation, ["density"])["density"]
    assert density[1, :4] == pytest.approx([*at_face, 1000.0, 1000.0], rel=1e-12)
    assert density[0, 2] == pytest.approx(1000.0, rel=1e-12)
    assert density[8, 0] == 0.0


def test_particles_that_have_no_such_field_do_not_count():
    """The deformation gradient of the solid alone, where water is beside it; its stress counts with that of the water."""
    simulation = still()
    found = grid_fields.of_nodes(simulation, ["deformation_gradient", "pressure", "mass"])
    assert np.nanmax(np.abs(found["deformation_gradient"] - np.eye(3).ravel())) < 1e-14
    assert np.isnan(found["deformation_gradient"][2, 2]).all()
    assert np.isfinite(found["pressure"][2, 2])
    _, pressure = by_hand(simulation, "quadratic", simulation.fields(["pressure"])["pressure"])
    np.testing.assert_allclose(found["pressure"].T, pressure[..., 0], rtol=1e-9, atol=1e-9)


SCENE = """
[domain]
size = [0.8, 0.4, 0.3]
cell_size = 0.05
gravity = [0.0, -10.0, 0.0]
periodic = ["x"]
[time]
end = 0.03
[materials.water]
model = "fluid"
density = 1000.0
sound_speed = 30.0
tension_cutoff = false
[[bodies]]
material = "water"
shape = { type = "box", min = [0.0, 0.0, 0.0], max = [0.6, 0.3, 0.3] }
velocity = [3.0, 0.0, 0.0]
[output]
snapshot_interval = 0.01
grid_fields = ["velocity", "density", "stress", "J"]
"""
PLAIN = SCENE[: SCENE.index("grid_fields")]


@pytest.fixture(scope="module")
def through(tmp_path_factory):
    """The folder of a run that was never interrupted, and its scene file beside it."""
    folder = tmp_path_factory.mktemp("grid")
    (folder / "scene.toml").write_text(SCENE, encoding="utf-8")
    assert main(["run", str(folder / "scene.toml"), "--out", str(folder / "run"), "--quiet"]) == 0
    return folder / "run"


def grids(run):
    """Everything that a run has left on nodes."""
    files = {path.name: contents(path) for path in sorted((run / "grid").iterdir())}
    return files | {"index": (run / "grid.xdmf").read_text(encoding="utf-8")}


def test_python_reads_them_beside_each_snapshot(through):
    run = pmpm.load(through)
    assert [grid.time for grid in run.grids] == [snapshot.time for snapshot in run.snapshots]
    last = run.grids[-1]
    assert last.fields == ["J", "density", "stress", "velocity"]
    assert last.velocity.shape == (16, 9, 7, 3)
    assert last.J.shape == (16, 9, 7)
    assert [len(x) for x in last.x] == [16, 9, 7]
    assert last.x[1][-1] == pytest.approx(0.4)
    with pytest.raises(AttributeError, match="holds no 'speed' on nodes; it holds J, density"):
        _ = last.speed


def vtk_index(path, time):
    vtk = pytest.importorskip("vtk")
    reader = vtk.vtkXdmfReader()
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    reader.UpdateTimeStep(time)
    return reader.GetOutputDataObject(0)


def vtk_file(path):
    vtk = pytest.importorskip("vtk")
    reader = vtk.vtkHDFReader()
    assert reader.CanReadFile(str(path))
    reader.SetFileName(str(path))
    reader.Update()
    return reader.GetOutput()


def differences(image, grid, names):
    """Names of the fields of which VTK has something else: all nodes by their number, some by their place."""
    support = pytest.importorskip("vtk.util.numpy_support")
    dim, found = len(grid.x), []
    for name in names:
        held, array = getattr(grid, name), image.GetPointData().GetArray(name)
        told = support.vtk_to_numpy(array).reshape(*reversed(image.GetDimensions()), -1)[..., : held[(0,) * dim].size]
        same = np.array_equal(by_axes(told, 3).reshape(held.shape), held, equal_nan=True)
        for node in product(*([0, 3, len(x) - 1] for x in grid.x)):
            place = [x[n] for x, n in zip(grid.x, node, strict=True)] + [0.0] * (3 - dim)
            value = np.array(array.GetTuple(image.FindPoint(place)))[: held[node].size]
            same &= np.array_equal(value, np.ravel(held[node]), equal_nan=True)
        found += [] if same else [name]
    return found


@pytest.mark.parametrize("way", ["index", "file"])
def test_vtk_reads_a_uniform_grid_with_every_node_in_its_place(through, way):
    grid = pmpm.load(through).grids[-1]
    image = vtk_index(through / "grid.xdmf", grid.time) if way == "index" else vtk_file(grid.path)
    assert image.GetClassName() in ("vtkImageData", "vtkUniformGrid")
    assert image.GetDimensions() == (16, 9, 7)
    # Readers of the index sort the entries of tensors in ways of their own.
    assert differences(image, grid, ["velocity", "density", "J", *(["stress"] if way == "file" else [])]) == []


@pytest.mark.parametrize("slab_axis", ["x", "y"])
def test_in_the_plane_vtk_reads_one_plane_of_nodes(tmp_path, slab_axis):
    scene = still(slab_axis=slab_axis).scene
    table = scene.to_toml().replace("[output]", '[output]\ngrid_fields = ["velocity", "pressure", "F"]')
    (tmp_path / "a.toml").write_text(table, encoding="utf-8")
    assert main(["run", str(tmp_path / "a.toml"), "--out", str(tmp_path / "run"), "--quiet", "--steps", "3"]) == 0
    grid = pmpm.load(tmp_path / "run").grids[-1]
    image = vtk_index(tmp_path / "run" / "grid.xdmf", grid.time)
    assert image.GetDimensions() == (11, 9, 1)
    assert differences(image, grid, ["velocity", "pressure"]) == []
    # XDMF knows no 2 x 2 tensor; VTK would take the axes of the grid for its rows and columns.
    assert grid.F.shape == (11, 9, 4)
    assert image.GetPointData().GetArray("F") is None


def run(arguments, ranks, folder):
    if ranks is None:
        assert main([str(word) for word in arguments]) == 0
        return
    done = launch.python(["-m", "pmpm", *arguments], ranks, 120, folder)
    assert done.status == 0, done.text


@pytest.mark.parametrize(("before", "after"), [(None, 2), (2, None)])
def test_a_restart_goes_on_with_them(before, after, through, tmp_path):
    out, scene = tmp_path / "run", through.parent / "scene.toml"
    run(["run", scene, "--out", out, "--quiet", "--until", 0.015], before, tmp_path)
    (out / "grid" / "000009.hdf").write_bytes(b"of a stretch that was cut off")
    run(["run", "--restart", out, "--quiet"], after, tmp_path)
    assert len(pmpm.load(out).grids) == len(pmpm.load(out).snapshots)
    assert grids(out)["000000.hdf"] == grids(through)["000000.hdf"]
    last = sorted(path.name for path in (out / "grid").iterdir())[-1]
    assert grids(out)[last] == grids(through)["000003.hdf"]
    assert grids(out)["index"].count("<Time") == len(pmpm.load(out).grids)


def test_a_scene_that_asks_for_none_does_and_writes_nothing_for_them(through, tmp_path):
    (tmp_path / "scene.toml").write_text(PLAIN, encoding="utf-8")
    assert main(["run", str(tmp_path / "scene.toml"), "--out", str(tmp_path / "run"), "--quiet"]) == 0
    assert {path.name for path in (tmp_path / "run").iterdir()}.isdisjoint({"grid", "grid.xdmf"})
    assert "grid_fields" not in (tmp_path / "run" / "scene.toml").read_text(encoding="utf-8")
    for path in (tmp_path / "run" / "snapshots").iterdir():
        assert contents(path) == contents(through / "snapshots" / path.name)
    assert (tmp_path / "run" / "diagnostics.csv").read_bytes() == (through / "diagnostics.csv").read_bytes()


def test_a_restart_that_asks_for_no_more_leaves_in_the_index_what_is_there(through, tmp_path):
    out, plain = tmp_path / "run", tmp_path / "plain.toml"
    assert main(["run", str(through.parent / "scene.toml"), "--out", str(out), "--quiet", "--until", "0.015"]) == 0
    held = len(pmpm.load(out).grids)
    (out / "grid" / "000008.hdf").write_bytes(b"of a stretch that was cut off")
    plain.write_text(PLAIN, encoding="utf-8")
    assert main(["run", str(plain), "--restart", str(out), "--quiet"]) == 0
    assert len(pmpm.load(out).snapshots) > len(pmpm.load(out).grids)
    assert grids(out)["index"].count("<Time") == len(pmpm.load(out).grids) <= held


def test_another_run_in_the_folder_takes_them_away(through, tmp_path):
    out, plain = tmp_path / "run", tmp_path / "plain.toml"
    assert main(["run", str(through.parent / "scene.toml"), "--out", str(out), "--quiet", "--steps", "1"]) == 0
    plain.write_text(PLAIN, encoding="utf-8")
    assert main(["run", str(plain), "--out", str(out), "--quiet", "--steps", "1", "--overwrite"]) == 0
    assert not (out / "grid").exists()
    assert not (out / "grid.xdmf").exists()


def test_a_damaged_file_is_named(through, tmp_path):
    whole = (through / "grid" / "000001.hdf").read_bytes()
    other = (through / "snapshots" / "000001.hdf").read_bytes()
    for name, data, told in (
        ("cut", whole[:3000], "cannot be read as a grid"),
        ("none", b"", "cannot be read as a grid"),
        ("other", other, "is an HDF5 file but not a grid of pmpm"),
    ):
        (tmp_path / f"{name}.hdf").write_bytes(data)
        with pytest.raises(OutputError, match=f"{name}.hdf {told}"):
            _ = pmpm.output.reader.GridFields(tmp_path / f"{name}.hdf").velocity


def test_info_and_check_tell_of_them(through, capsys):
    assert main(["info", str(through)]) == 0
    text = capsys.readouterr().out
    assert f"grid fields   4, J, density, stress, velocity; open {through / 'grid.xdmf'} in ParaView" in text
    assert main(["info", str(through / "grid" / "000001.hdf")]) == 0
    text = capsys.readouterr().out
    assert "nodes         16 x 9 x 7, 0.05 m apart" in text
    assert "  stress               float64 x 6  Pa" in text
    assert main(["check", str(through.parent / "scene.toml")]) == 0
    file = (3 + 1 + 6 + 1) * 8 * 16 * 9 * 7
    assert (
        f"grid fields   velocity, density, stress, J on 16 x 9 x 7 nodes, {file / 1e6:.1f} MB"
        in capsys.readouterr().out
    )
    held = (through / "grid" / "000001.hdf").stat().st_size
    assert file < held < file + 20_000
    scene = pmpm.Scene.from_toml(through.parent / "scene.toml")
    assert estimate.grid_fields(scene).file == file
