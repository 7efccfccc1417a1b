"""`pmpm render`: pictures and films of a run, and what is said where none can be made."""

import sys
from pathlib import Path

import launch
import numpy as np
import pytest

import pmpm
from pmpm.cli import main
from pmpm.output import film, render, vista
from pmpm.output.files import OutputError
from pmpm.output.pictures import Surface

pytest.importorskip("matplotlib")
from matplotlib import image  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402

ELASTIC = {"model": "neo_hookean", "density": 1000.0, "youngs_modulus": 1e5, "poisson_ratio": 0.3}


def run_of(folder, dim):
    """The folder of a run of two blocks of two materials that fall, four snapshots in all."""
    low = [0.1] * dim
    scene = pmpm.Scene(
        title="Two blocks",
        domain={"size": [0.6, 0.4, 0.5][:dim], "cell_size": 0.05, "gravity": [0.0, -10.0, 0.0][:dim]},
        time={"end": 0.03},
        materials={"red": ELASTIC, "blue": ELASTIC},
        bodies=[
            {"material": "red", "shape": {"type": "box", "min": low, "max": [0.2] * dim}},
            {"material": "blue", "shape": {"type": "box", "min": [0.3, *low[1:]], "max": [0.4, *[0.2] * (dim - 1)]}},
        ],
        output={"snapshot_interval": 0.01, "fields": ["velocity", "pressure", "stress", "material"]},
    )
    file = folder / "two.toml"
    file.write_text(scene.to_toml(), encoding="utf-8")
    assert main(["run", str(file), "--out", str(folder / "two"), "--quiet"]) == 0
    return folder / "two"


@pytest.fixture(scope="module")
def flat(tmp_path_factory):
    return run_of(tmp_path_factory.mktemp("render"), 2)


@pytest.fixture(scope="module")
def solid(tmp_path_factory):
    return run_of(tmp_path_factory.mktemp("render3"), 3)


def drawn(folder, field=None, number=-1, **asked):
    """(view, figure) of a snapshot."""
    run = pmpm.load(folder)
    snapshot = run.snapshots[number]
    view = render.view_of(run.table, [snapshot], render.Asked(field, **asked))
    figure = Figure()
    render.draw(figure, view, snapshot)
    return view, figure


def test_particles_lie_where_they_are_and_have_the_colour_of_their_speed(flat):
    snapshot = pmpm.load(flat).snapshots[-1]
    view, figure = drawn(flat)
    points = figure.axes[0].collections[0]
    assert np.allclose(points.get_offsets(), snapshot.x)
    speed = np.linalg.norm(snapshot.velocity, axis=1)
    assert np.allclose(points.get_array(), speed)
    assert view.limits == pytest.approx((speed.min(), speed.max()))
    assert view.label == "speed (m/s)"
    assert figure.axes[0].get_xlim() == (0.0, 0.6)
    assert "Two blocks" in figure.axes[0].get_title()


def test_in_space_the_axis_of_gravity_stands_upright(solid):
    view, figure = drawn(solid, "pressure")
    axes = figure.axes[0]
    assert view.order == (0, 2, 1)
    assert [axes.get_xlabel(), axes.get_ylabel(), axes.get_zlabel()] == ["x (m)", "z (m)", "y (m)"]
    assert axes.get_zlim() == pytest.approx((0.0, 0.4))


def test_materials_are_told_apart_and_named(flat):
    _, figure = drawn(flat, "material")
    legend = figure.axes[0].get_legend()
    assert [text.get_text() for text in legend.get_texts()] == ["red", "blue"]


def test_of_many_particles_every_nth_is_drawn_and_larger(flat, monkeypatch):
    whole = drawn(flat)[1].axes[0].collections[0]
    monkeypatch.setattr(render, "MOST", 20)
    few = drawn(flat)[1].axes[0].collections[0]
    assert len(few.get_offsets()) == 16  # of 32 every second
    assert few.get_sizes()[0] == pytest.approx(2.0 * whole.get_sizes()[0])


def test_a_film_has_a_frame_for_each_snapshot_with_the_same_colours(flat, tmp_path, capsys):
    file = tmp_path / "film.gif"
    assert main(["render", str(flat), "--out", str(file)]) == 0
    assert "4 frames" in capsys.readouterr().out
    from PIL import Image

    with Image.open(file) as film:
        assert film.n_frames == 4
    snapshots = pmpm.load(flat).snapshots
    low, high = render.range_of(snapshots, "velocity")
    assert low == 0.0
    assert high == pytest.approx(max(np.linalg.norm(snapshot.velocity, axis=1).max() for snapshot in snapshots))
    assert [path.name for path in tmp_path.iterdir()] == [file.name]


@pytest.mark.parametrize("folder", ["flat", "solid"])
def test_a_picture_of_the_last_snapshot_is_left_in_the_folder(folder, request):
    folder = request.getfixturevalue(folder)
    assert main(["render", str(folder), "--quiet"]) == 0
    picture = image.imread(folder / "render.png")
    assert picture.shape[0] > 300
    assert len(np.unique(picture.reshape(-1, picture.shape[2]), axis=0)) > 50


@pytest.mark.parametrize(
    ("values", "limits"),
    [([2.0, 2.0], (2.0, 4.0)), ([0.0], (0.0, 1.0)), ([np.nan], (0.0, 1.0)), ([1.0, np.nan, 3.0], (1.0, 3.0))],
)
def test_colours_can_be_told_apart_whatever_the_values(values, limits, monkeypatch):
    monkeypatch.setattr(render, "scalars", lambda snapshot, field: np.array(values))
    assert render.range_of([None], "x") == limits


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["{run}", "--field", "colour"], "holds no field colour; it holds id, material, pressure, stress, velocity"),
        (["{run}", "--field", "stress"], "a tensor has no colour"),
        (["{run}", "--snapshot", "9"], "no snapshot 9: they are 0 to 3"),
        (["{run}", "--out", "x.jpeg"], "must end with one of .png"),
        (["{run}", "--out", "/proc/none/x.png"], "--out /proc/none/x.png"),
        (["{run}", "--out", "/proc/none/x.gif"], "--out /proc/none/x.gif"),
        (["nowhere"], "nowhere does not exist"),
        (["{run}", "--zoom", "0"], "--zoom 0: must be greater than 0"),
        (["{run}", "--range", "2", "-1e-3"], "--range 2 -0.001: the second number must be greater than the first"),
        (["{run}", "--size", "10", "100000"], "--size 10 100000: each must be 100 to 8000 pixels"),
        (["{run}", "--colors", "virdis"], "--colors virdis: is no colour map of matplotlib; did you mean viridis"),
        (["{run}", "--view", "x"], "--view x: is for runs in space"),
        (["{run}", "--with", "pyvista", "--out", "x.pdf"], "--with pyvista: draws .png and films, not .pdf"),
    ],
)
def test_what_cannot_be_rendered_is_told_with_status_2(arguments, complaint, flat, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["render", *(argument.format(run=flat) for argument in arguments)]) == 2
    assert complaint in capsys.readouterr().err
    assert list(Path().iterdir()) == []


def test_a_film_that_nobody_can_make_names_the_program(flat, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(film, "ffmpeg", lambda: None)
    assert main(["render", str(flat), "--out", str(tmp_path / "x.mp4")]) == 2
    assert "apt install ffmpeg" in capsys.readouterr().err


def test_without_matplotlib_it_says_what_to_install(flat, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    assert main(["render", str(flat)]) == 2
    assert "pip install 'pmpm[viz]'" in capsys.readouterr().err


def test_a_run_with_python_functions_is_drawn_too(flat, tmp_path):
    """Its scene cannot be made again from the file alone."""
    (tmp_path / "run").mkdir()
    for path in flat.rglob("*.*"):
        if path.is_file() and path.suffix in (".toml", ".json", ".csv", ".hdf"):
            (tmp_path / "run" / path.relative_to(flat)).parent.mkdir(exist_ok=True)
            (tmp_path / "run" / path.relative_to(flat)).write_bytes(path.read_bytes())
    scene = tmp_path / "run" / "scene.toml"
    scene.write_text('body_force = "python:push:0123456789ab"\n' + scene.read_text(encoding="utf-8"), encoding="utf-8")
    with pytest.raises(pmpm.SceneError, match="Python function"):
        _ = pmpm.load(tmp_path / "run").scene
    for command in ("plot", "render"):
        assert main([command, str(tmp_path / "run")]) == 0
        assert (tmp_path / "run" / f"{command}.png").exists()


def test_a_scene_file_that_cannot_be_read_is_named(flat, tmp_path, capsys):
    (tmp_path / "run.json").write_bytes((flat / "run.json").read_bytes())
    (tmp_path / "snapshots").mkdir()
    (tmp_path / "snapshots" / "000000.hdf").write_bytes((flat / "snapshots" / "000000.hdf").read_bytes())
    assert main(["render", str(tmp_path)]) == 2
    assert "scene.toml cannot be read" in capsys.readouterr().err
    (tmp_path / "scene.toml").write_text("[domain]\nsize = [1.0, 1.0]", encoding="utf-8")
    assert main(["render", str(tmp_path)]) == 2
    assert "scene.toml is damaged" in capsys.readouterr().err


# ---- cameras ----


@pytest.mark.parametrize("order", [(0, 1, 2), (0, 2, 1), (1, 2, 0)])
@pytest.mark.parametrize("name", ["iso", "x", "-x", "y", "-y", "z", "-z", "30,140", "-20,10"])
def test_cameras_are_right_handed_and_look_from_where_they_are_asked_to(name, order):
    (right, up, toward), _ = render.camera_of(name, order)
    assert np.cross(right, up) == pytest.approx(toward)
    assert [np.linalg.norm(axis) for axis in (right, up, toward)] == pytest.approx([1.0] * 3)
    if name[-1] in "xyz":
        assert toward == pytest.approx(np.eye(3)["xyz".index(name[-1])] * (-1.0 if name[0] == "-" else 1.0))
    else:
        assert up[order[2]] > 0.5  # upright
    if name == "iso":
        assert right[order[0]] > 0.5


@pytest.mark.parametrize("name", ["", "w", "iso2", "1", "1,2,3", "100,0", "nan,0", "x,y"])
def test_a_view_that_is_none_is_refused(name):
    with pytest.raises(OutputError, match="must be iso, x, y, z"):
        render.camera_of(name, (0, 1, 2))


def test_the_axes_of_a_picture_in_space_are_not_mirrored(solid):
    """x, z, y is a left-handed order: its second axis runs backwards, as in PyVista's pictures."""
    assert drawn(solid)[1].axes[0].get_ylim() == pytest.approx((0.5, 0.0))


def test_zoom_shows_the_middle_larger(flat):
    _, figure = drawn(flat, zoom=2.0)
    assert figure.axes[0].get_xlim() == pytest.approx((0.15, 0.45))
    size = drawn(flat)[1].axes[0].collections[0].get_sizes()[0]
    assert figure.axes[0].collections[0].get_sizes()[0] == pytest.approx(4.0 * size)


def test_range_colours_and_size_are_the_ones_asked_for(flat, tmp_path):
    view, figure = drawn(flat, "pressure", limits=(-5.0, 7.0), colours="coolwarm")
    points = figure.axes[0].collections[0]
    assert (points.norm.vmin, points.norm.vmax, points.get_cmap().name) == (-5.0, 7.0, "coolwarm")
    file = tmp_path / "x.png"
    arguments = ["--range", "-1e-2", "3", "--colors", "plasma", "--size", "640", "480"]
    assert main(["render", str(flat), "--out", str(file), *arguments]) == 0
    assert image.imread(file).shape[:2] == (480, 640)


# ---- PyVista ----

draws = pytest.mark.usefixtures("vtk_draws")
SQUARE = Surface(
    np.array([[0.0, 0.3, 0.0], [0.6, 0.3, 0.0], [0.6, 0.3, 0.5], [0.0, 0.3, 0.5]]), np.array([[0, 1, 2], [0, 2, 3]])
)
LINE = Surface(np.array([[0.0, 0.3], [0.6, 0.3]]))


@pytest.fixture(scope="module")
def vtk_draws():
    """Nothing, where VTK draws; elsewhere the test is left out."""
    if (reason := vista.trouble()) is not None:
        pytest.skip(reason)


def frame(folder, field="velocity", **asked):
    """A picture by PyVista, (height, width, 3) bytes."""
    run = pmpm.load(folder)
    chosen = [run.snapshots[-1]]
    view = render.view_of(run.table, chosen, render.Asked(field, pixels=(400, 300), **asked))
    (picture,) = render.frames("pyvista", Figure, view, chosen)
    return picture


def coloured(picture):
    """How many pixels are neither grey nor white."""
    spread = picture[40:240].astype(int)
    return int((spread.max(axis=2) - spread.min(axis=2) > 40).sum())


@draws
@pytest.mark.parametrize("folder", ["flat", "solid"])
def test_pyvista_draws_particles_as_large_as_they_are(folder, request):
    folder = request.getfixturevalue(folder)
    view = "z"
    picture, larger = frame(folder, view=view), frame(folder, view=view, zoom=1.5)
    assert picture.shape == (300, 400, 3)
    # Metres per pixel, of 0.6 x 0.4 m seen along z, in which two blocks are of 0.1 x 0.1 m.
    scale = 2.0 * 0.5 * vista.MARGIN * max(0.4 / (1.0 - vista.FOOT - vista.HEAD), 0.6 / (400 / 300)) / 300
    assert coloured(picture) * scale**2 == pytest.approx(0.02, rel=0.25)
    assert coloured(larger) == pytest.approx(2.25 * coloured(picture), rel=0.15)


@draws
def test_pyvista_shows_the_domain_and_the_materials_unless_told_not_to(flat):
    assert (frame(flat, box=False) != frame(flat)).any()
    with_legend = frame(flat, "material")
    assert len(np.unique(with_legend[:150, 200:].reshape(-1, 3), axis=0)) > 10


@draws
@pytest.mark.parametrize(("folder", "surface"), [("flat", LINE), ("solid", SQUARE)])
def test_a_surface_in_the_way_is_drawn_by_both(folder, surface, request):
    folder = request.getfixturevalue(folder)
    assert (frame(folder, surfaces=(surface,)) != frame(folder)).sum() > 300
    axes, plain_axes = (drawn(folder, surfaces=s)[1].axes[0] for s in ((surface,), ()))
    assert len(axes.collections) + len(axes.lines) == len(plain_axes.collections) + len(plain_axes.lines) + 1


@draws
@pytest.mark.parametrize("kind", ["gif", "mp4"])
def test_pyvista_makes_films(kind, solid, tmp_path, capsys):
    if kind == "mp4" and film.ffmpeg() is None:
        pytest.skip("no ffmpeg")
    file = tmp_path / f"film.{kind}"
    assert main(["render", str(solid), "--out", str(file), "--size", "301", "201", "--quiet"]) == 0
    assert "4 frames, drawn by PyVista" in capsys.readouterr().out
    assert [path.name for path in tmp_path.iterdir()] == [file.name]
    if kind == "gif":
        from PIL import Image

        with Image.open(file) as made:
            assert (made.n_frames, made.size) == (4, (301, 201))
    else:
        assert file.read_bytes()[4:8] == b"ftyp"


@pytest.mark.parametrize(
    ("trial", "told"),
    [
        ("import os; os.abort()", "VTK cannot draw here (it ended with status -6); VTK draws off screen through EGL"),
        ("raise OSError('libGL.so.1: cannot open')", "libGL.so.1: cannot open); VTK draws off screen through EGL"),
        (
            "raise ModuleNotFoundError(\"No module named 'pyvista'\")",
            "PyVista is not installed: pip install 'pmpm[viz]'",
        ),
    ],
)
def test_where_vtk_cannot_draw_matplotlib_does_and_the_reason_is_told(
    trial, told, solid, tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(vista, "TRIAL", trial)
    vista.trouble.cache_clear()
    try:
        assert main(["render", str(solid), "--out", str(tmp_path / "x.png")]) == 0
        out = capsys.readouterr().out
        assert "drawn by matplotlib (" in out
        assert told in out
        assert main(["render", str(solid), "--with", "pyvista", "--out", str(tmp_path / "y.png")]) == 2
        assert told in capsys.readouterr().err
        assert not (tmp_path / "y.png").exists()
    finally:
        vista.trouble.cache_clear()


def test_a_picture_in_the_plane_does_not_load_vtk(flat, tmp_path):
    code = f"import sys\nfrom pmpm.cli import main\nassert main(['render', {str(flat)!r}, '--out', 'x.png']) == 0\n"
    code += "assert not {'vtk', 'vtkmodules', 'pyvista'} & set(sys.modules)"
    done = launch.python(["-c", code], None, 120, tmp_path)
    assert done.status == 0, done.text
