"""Probes, gauges and maps: what they measure of states that are known, and that runs keep them over ranks and restarts."""

import math

import launch
import numpy as np
import pytest

import pmpm
from pmpm import maps, sampling
from pmpm.cli import main
from pmpm.kernels.needs import STENCILS
from pmpm.output import plot
from pmpm.output.files import OutputError

WATER = {"model": "fluid", "density": 1e3, "sound_speed": 30.0, "tension_cutoff": False}
CELL = 0.05


def still(
    dim=2, low=(0.0, 0.0, 0.0), high=(0.5, 0.4, 0.5), gravity=None, shape_function="quadratic", body=None, **domain
):
    """A Simulation of a block of water without pressure: fallen into place, not moving yet."""
    size = [0.8, 0.9, 0.5][:dim]
    scene = pmpm.Scene(
        domain={"size": size, "cell_size": CELL, "gravity": gravity or [0.0, -10.0, 0.0][:dim]} | domain,
        time={"end": 1.0},
        materials={"water": WATER},
        bodies=[{"material": "water", "shape": {"type": "box", "min": low[:dim], "max": high[:dim]}} | (body or {})],
    )
    return pmpm.Simulation(scene)


def surface(simulation, position, axis=1):
    return sampling.surface(simulation, np.array(position), axis)


@pytest.mark.parametrize("shape_function", ["linear", "quadratic", "cubic"])
def test_the_spline_of_a_place_is_the_one_of_a_node(shape_function):
    """The spline and its whole-cell shifts sum up to 1 and have the known middle; Steffen et al. (2008)."""
    stencil = STENCILS[shape_function]
    distance = np.linspace(-0.5, 0.5, 11)
    sums = sum(sampling.spline(stencil, distance + whole) for whole in range(-3, 4))
    assert sums == pytest.approx(1.0, abs=1e-15)
    assert sampling.spline(stencil, np.array([0.0, 3.0])) == pytest.approx(
        [{"linear": 1.0, "quadratic": 0.75, "cubic": 2.0 / 3.0}[shape_function], 0.0]
    )


@pytest.mark.parametrize("dim", [2, 3])
def test_a_probe_in_a_body_reads_its_velocity_pressure_and_density(dim):
    """Of a velocity that is linear in space the value at the point; the pressure of a fluid compressed to J = 0.99."""
    simulation = still(dim, body={"velocity": [1.0, 2.0, 3.0][:dim]})
    x, J = simulation.particles.x, 0.99
    simulation.particles.v = x * 4.0 + np.array([1.0, 2.0, 3.0])[:dim]
    simulation.particles.J = np.full(len(x), J)
    point = np.array([0.23, 0.21, 0.26])[:dim]
    found = sampling.at_point(simulation, point)
    expected = 4.0 * point + np.array([1.0, 2.0, 3.0])[:dim]
    assert [found[f"velocity_{axis}"] for axis in "xyz"[:dim]] == pytest.approx(expected, rel=0.01)
    assert found["density"] == pytest.approx(1e3 / J, rel=1e-12)
    pressures = simulation.fields(["pressure"])["pressure"]
    assert found["pressure"] == pytest.approx(pressures[0], rel=1e-12)
    assert found["fill"] == pytest.approx(J, rel=0.01)


@pytest.mark.parametrize(("wall", "mirrored"), [("slip", True), ("open", False), ("free", False)])
def test_material_at_a_face_has_an_image_beyond_it_only_where_a_wall_holds_it(wall, mirrored):
    """At the face half of what a place reaches lies beyond it."""
    simulation = still(walls={"x_min": wall})
    found = sampling.at_point(simulation, np.array([0.0, 0.2]))
    assert found["fill"] == pytest.approx(1.0 if mirrored else 0.5, abs=0.02)


def test_a_probe_out_of_reach_of_all_material_has_no_value():
    found = sampling.at_point(still(), np.array([0.75, 0.85]))
    assert found.pop("fill") == 0.0
    assert all(math.isnan(value) for value in found.values())


@pytest.mark.parametrize("x", [0.0, 0.01, 0.25])
@pytest.mark.parametrize("dim", [2, 3])
def test_the_surface_is_where_the_block_ends_also_at_walls(dim, x):
    found = surface(still(dim), [x, 0.0, 0.0][:dim])
    assert found["height"] == pytest.approx(0.4, abs=0.01 * CELL)
    assert found["depth"] == pytest.approx(0.4, rel=0.01)


@pytest.mark.parametrize("high", [0.4, 0.9])
def test_a_lid_ends_the_height_and_the_next_block_below_does_not(high):
    assert surface(still(high=(0.5, high)), [0.2, 0.0])["height"] == pytest.approx(high, abs=0.01 * CELL)


def test_the_surface_is_on_the_side_against_gravity():
    simulation = still(low=(0.0, 0.5), high=(0.5, 0.9), gravity=[0.0, 10.0])
    assert surface(simulation, [0.2, 0.0])["height"] == pytest.approx(0.5, abs=0.01 * CELL)


def test_a_line_beside_the_block_has_no_surface():
    found = surface(still(), [0.7, 0.0])
    assert math.isnan(found["height"])
    assert found["depth"] == 0.0


def test_a_line_at_the_end_of_a_periodic_axis_sees_what_is_across_it():
    simulation = still(high=(0.8, 0.4), periodic=["x"])
    at_end, inside = (surface(simulation, [x, 0.0]) for x in (0.0, 0.4))
    assert at_end["depth"] == pytest.approx(inside["depth"], rel=1e-9)
    assert at_end["height"] == pytest.approx(inside["height"], abs=1e-9)


def test_what_has_come_apart_fills_no_more_than_at_rest():
    simulation = still()
    simulation.particles.J = np.full(simulation.rows(), 3.0)
    assert surface(simulation, [0.2, 0.0])["depth"] == pytest.approx(0.4, rel=0.01)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_section_of_a_moving_block_has_its_discharge(dim):
    width = 1.0 if dim == 2 else 0.5
    simulation = still(dim, body={"velocity": [2.0, 0.0, 0.0][:dim]})
    found = sampling.section(simulation, np.array([0.25, 0.0, 0.0])[:dim], 0)
    assert found["area"] == pytest.approx(0.4 * width, rel=0.01)
    assert found["discharge"] == pytest.approx(2.0 * found["area"], rel=1e-12)
    assert found["mass_flux"] == pytest.approx(1e3 * found["discharge"], rel=1e-12)
    assert sampling.section(simulation, np.array([0.7, 0.0, 0.0])[:dim], 0) == dict.fromkeys(found, 0.0)


@pytest.mark.parametrize("up", [1, 2])
def test_a_map_of_depths_holds_the_volume_column_by_column(up):
    gravity = [0.0, 0.0, 0.0]
    gravity[up] = -10.0
    simulation = still(3, gravity=gravity)
    found = maps.Maps(simulation, ["max_depth", "deposit"]).arrays(simulation)
    assert found["deposit"].shape == ((16, 10) if up == 1 else (16, 18))
    assert found["deposit"].sum() * CELL**2 == pytest.approx(0.5 * 0.4 * 0.5, rel=1e-9)
    assert found["deposit"][2:8, 2:6] == pytest.approx(0.4 if up == 1 else 0.5, rel=1e-9)
    assert found["deposit"][12:].max() == 0.0
    assert np.array_equal(found["max_depth"], found["deposit"])
    assert found["x"] == pytest.approx((np.arange(16) + 0.5) * CELL)


def test_a_block_that_flies_leaves_its_depth_and_speed_in_every_column_it_passes():
    simulation = still(low=(0.1, 0.3), high=(0.2, 0.5), body={"velocity": [4.0, 0.0]}, gravity=[0.0, -1e-3])
    watch = maps.Maps(simulation, ["max_depth", "max_speed", "deposit"])
    simulation.every(watch, steps=1, at_start=True)
    simulation.run(until=0.1)
    found = watch.arrays(simulation)
    passed, now = slice(2, 12), found["deposit"] > 0.0
    assert found["max_speed"][passed] == pytest.approx(4.0, rel=0.02)
    assert (found["max_depth"][3:11] > 0.15).all()
    assert found["max_speed"][:1].max() == 0.0
    assert (np.flatnonzero(now).min(), np.flatnonzero(now).max()) in [(9, 12), (10, 12), (9, 11), (10, 11)]


def test_a_particle_that_is_no_number_spoils_no_map():
    simulation = still()
    watch = maps.Maps(simulation, ["max_speed"])
    v = simulation.particles.v
    v[3] = np.nan
    simulation.populations[0].set_rows(simulation.layouts[0].where("v"), v)
    assert np.isfinite(watch.arrays(simulation)["max_speed"]).all()


SCENE = """
[domain]
size = [0.8, 0.4, 0.3]
cell_size = 0.05
gravity = [0.0, -10.0, 0.0]
[time]
end = 0.06
[materials.water]
model = "fluid"
density = 1000.0
sound_speed = 30.0
tension_cutoff = false
[[bodies]]
material = "water"
shape = { type = "box", min = [0.0, 0.0, 0.0], max = [0.3, 0.3, 0.3] }
velocity = [3.0, 0.0, 0.0]
[output]
diagnostics_interval = 0.01
maps = ["max_depth", "max_speed", "deposit"]
[[output.probes]]
name = "in_front"
position = [0.4, 0.1, 0.1]
[[output.gauges]]
name = "line"
position = [0.31, 0.0, 0.12]
[[output.gauges]]
name = "door"
type = "section"
position = [0.4, 0.1, 0.1]
axis = "x"
""" + "".join(f'[[output.probes]]\nname = "near_{n}"\nposition = [0.{n}, 0.13, 0.1]\n' for n in range(2, 6))
FILES = (
    "probes/in_front.csv",
    *(f"probes/near_{n}.csv" for n in range(2, 6)),
    "gauges/line.csv",
    "gauges/door.csv",
    "maps.npz",
)


@pytest.fixture(scope="module")
def through(tmp_path_factory):
    """The folder of a run that was never interrupted, and its scene file beside it."""
    folder = tmp_path_factory.mktemp("watched")
    (folder / "scene.toml").write_text(SCENE, encoding="utf-8")
    assert main(["run", str(folder / "scene.toml"), "--out", str(folder / "run"), "--quiet"]) == 0
    return folder / "run"


def contents(run):
    return {name: (run / name).read_bytes() for name in FILES}


def test_a_run_leaves_a_line_of_each_at_every_line_of_diagnostics(through):
    run = pmpm.load(through)
    assert set(run.probes) == {"in_front", "near_2", "near_3", "near_4", "near_5"}  # one lies near the cut of two ranks
    assert set(run.gauges) == {"line", "door"}
    times = run.diagnostics["time"]
    for series in (run.probes["in_front"], run.gauges["line"], run.gauges["door"]):
        assert np.array_equal(series["time"], times)
    assert np.isnan(run.probes["in_front"]["velocity_x"][0])
    assert run.probes["in_front"]["velocity_x"][-1] == pytest.approx(3.0, rel=0.1)
    assert run.gauges["door"]["discharge"][0] == pytest.approx(0.0, abs=1e-12)
    assert run.gauges["door"]["discharge"][-1] > 0.1
    assert run.maps["max_speed"].shape == (16, 6)
    assert float(run.maps["time"]) == times[-1]


@pytest.mark.parametrize(("before", "after"), [(None, 2), (2, None)])
def test_an_interrupted_run_on_other_ranks_before_and_after_has_the_same_bytes(before, after, through, tmp_path):
    out, scene = tmp_path / "run", through.parent / "scene.toml"
    done = launch.python(["-m", "pmpm", "run", scene, "--out", out, "--quiet", "--until", 0.025], before, 120, tmp_path)
    assert done.status == 0, done.text
    assert pmpm.load(out).record["report"]["ranks"] == (before or 1)
    for name in FILES[:-1]:  # what came after the checkpoint, before the run was killed
        with open(out / name, "a", encoding="utf-8") as file:
            file.write("99,0.02,0.001\n")
    done = launch.python(["-m", "pmpm", "run", "--restart", out, "--quiet"], after, 120, tmp_path)
    assert done.status == 0, done.text
    assert contents(out) == contents(through)


def test_what_is_watched_changes_no_bit_of_the_run(through, tmp_path):
    plain = SCENE[: SCENE.index("maps =")]
    (tmp_path / "scene.toml").write_text(plain, encoding="utf-8")
    assert main(["run", str(tmp_path / "scene.toml"), "--out", str(tmp_path / "run"), "--quiet"]) == 0
    assert (tmp_path / "run" / "diagnostics.csv").read_bytes() == (through / "diagnostics.csv").read_bytes()
    assert {path.name for path in (tmp_path / "run").iterdir()}.isdisjoint({"probes", "gauges", "maps.npz"})
    assert "maps" not in (tmp_path / "run" / "scene.toml").read_text(encoding="utf-8")


def test_a_probe_that_comes_at_a_restart_begins_there(through, tmp_path):
    out, scene = tmp_path / "run", tmp_path / "more.toml"
    assert main(["run", str(through.parent / "scene.toml"), "--out", str(out), "--quiet", "--until", "0.025"]) == 0
    more = SCENE + '[[output.probes]]\nname = "late"\nposition = [0.1, 0.1, 0.1]\n'
    scene.write_text(more, encoding="utf-8")
    assert main(["run", str(scene), "--restart", str(out), "--quiet"]) == 0
    times = pmpm.load(out).probes["late"]["time"]
    assert len(times) == 4
    assert times[0] >= 0.03
    assert contents(out) == contents(through)


def test_another_run_in_the_folder_takes_them_away(through, tmp_path):
    out = tmp_path / "run"
    assert main(["run", str(through.parent / "scene.toml"), "--out", str(out), "--quiet", "--steps", "1"]) == 0
    (out / "probes" / "mine.csv").write_text("not of a run\n", encoding="utf-8")
    plain = tmp_path / "plain.toml"
    plain.write_text(SCENE[: SCENE.index("maps =")], encoding="utf-8")
    assert main(["run", str(plain), "--out", str(out), "--quiet", "--steps", "1", "--overwrite"]) == 0
    assert not (out / "gauges").exists()
    assert not (out / "maps.npz").exists()
    assert [path.name for path in (out / "probes").iterdir()] == ["mine.csv"]


def test_damaged_maps_are_named(through, tmp_path):
    (tmp_path / "run.json").write_bytes((through / "run.json").read_bytes())
    (tmp_path / "maps.npz").write_bytes((through / "maps.npz").read_bytes()[:100])
    with pytest.raises(OutputError, match="maps.npz is damaged"):
        _ = pmpm.load(tmp_path).maps


def test_plot_draws_what_was_watched(through, tmp_path, capsys):
    pytest.importorskip("matplotlib")
    panels = {panel.title: panel for panel in plot.panels_of(pmpm.load(through))}
    run = pmpm.load(through)
    (_, times, heights), *_ = panels["height of the surface at gauges"].lines
    assert np.array_equal(heights, run.gauges["line"]["height"], equal_nan=True)
    assert [label for label, *_ in panels["discharge at gauges"].lines] == ["door"]
    assert len(panels["speed at probes"].lines) == len(panels["pressure at probes"].lines) == 5
    image, names, ends = panels["depth at the end"].image
    assert np.array_equal(image, run.maps["deposit"])
    assert (names, ends) == (["x", "z"], pytest.approx([0.0, 0.8, 0.0, 0.3]))
    assert main(["plot", str(through), "--out", str(tmp_path / "x.png")]) == 0
    assert "largest depth, largest speed in a column, depth at the end" in capsys.readouterr().out


def test_info_names_what_was_watched(through, capsys):
    assert main(["info", str(through)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "gauges        door, line" in lines
    assert "maps          max_depth, max_speed, deposit" in lines


def test_maps_of_a_run_in_the_plane_are_lines():
    simulation = still()
    (panel,) = plot.map_panels(maps.Maps(simulation, ["deposit"]).arrays(simulation))
    ((_, x, depth),) = panel.lines
    assert panel.along == "x (m)"
    assert depth[2:8] == pytest.approx(0.4)
    assert x[0] == 0.5 * CELL
