"""What a run would take is known before anything is counted; too much of it is refused, and a check never takes long."""

import time
import tracemalloc
from itertools import chain

import numpy as np
import pytest

import pmpm
from pmpm import estimate, explain, populate
from pmpm.cli import main
from pmpm.parallel.comm import Alone
from pmpm.scene import seeding
from pmpm.scene.errors import SceneError
from pmpm.scene.needs import grid_geometry, scene_needs

WATER = {"model": "fluid", "density": 1000.0, "sound_speed": 15.0}
BOX = {"type": "box", "min": [0.1, 0.1], "max": [0.9, 0.7]}
DISK = {"type": "sphere", "center": [0.5, 0.5], "radius": 0.4}
BALL = {"type": "sphere", "center": [0.5, 0.5, 0.5], "radius": 0.4}
HUGE = """
[domain]
size = [10.0, 10.0, 10.0]
cell_size = 0.01
[time]
end = 0.01
[materials.water]
model = "fluid"
density = 1000.0
sound_speed = 15.0
[[bodies]]
material = "water"
shape = { type = "sphere", center = [5.0, 5.0, 5.0], radius = 4.99 }
particles_per_cell = 27
"""


def scene(*shapes, cell_size=0.02, dim=2, periodic=(), step=None, per_cell=None, **more):
    body = {"material": "water"} | ({"particles_per_cell": per_cell} if per_cell else {})
    return pmpm.Scene(
        domain={"size": [1.0] * dim, "cell_size": cell_size, "periodic": periodic},
        time={"end": 0.01, "step": step},
        materials={"water": WATER},
        bodies=[body | {"shape": shape} for shape in shapes],
        **more,
    )


def geometry_of(made):
    return grid_geometry(made, scene_needs(made))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "huge.toml").write_text(HUGE, encoding="utf-8")
    return tmp_path


def refused(arguments, capsys):
    assert main(arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    return captured.err


# ---- particles ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "shapes",
    [
        (BOX,),
        (DISK,),
        (BALL,),
        (BOX, DISK),
        ({"type": "difference", "of": [BOX, DISK]},),
        ({"type": "union", "of": [BOX, DISK]}, {"type": "sphere", "center": [0.2, 0.2], "radius": 0.1}),
    ],
    ids=["box", "disk", "ball", "disk over box", "difference", "disk over union"],
)
def test_the_number_of_particles_is_estimated_to_two_percent(shapes):
    """4096 places that are spread evenly miss areas by less than a percent, volumes by a little more."""
    made = scene(*shapes, dim=3 if shapes == (BALL,) else 2)
    geometry = geometry_of(made)
    counted = populate.counted(made, geometry, 0, geometry.layers)[0].sum(axis=1)
    np.testing.assert_allclose(estimate.particles(made), counted, rtol=0.02)


def half_way(X):
    return np.stack([0.0 * X[:, 0] + 0.4, 0.0 * X[:, 1]], axis=1)


@pytest.mark.parametrize(
    ("body", "collider", "caught"),
    [
        ({"shape": BOX}, {"shape": DISK}, None),  # cut out
        (
            {"shape": BOX},
            {"shape": {"type": "plane", "point": [0.0, 0.1], "normal": [0.0, 1.0]}, "cut": False},
            None,
        ),  # touches
        ({"shape": BOX}, {"shape": {"type": "plane", "point": [0.3, 0.0], "normal": [1.0, 0.0]}, "cut": False}, 0.25),
        ({"shape": BOX}, {"shape": {"type": "sphere", "center": [1.0, 0.4], "radius": 0.2}, "cut": False}, 0.0512),
        (
            {"shape": BOX, "displacement": half_way},
            {"shape": {"type": "box", "min": [0.9, 0.0], "max": [2.0, 1.0]}},
            0.5,
        ),
        ({"shape": "points"}, {"shape": {"type": "box", "min": [0.0, 0.0], "max": [0.25, 1.0]}}, 0.2),
    ],
)
def test_a_body_of_which_a_part_is_caught_in_a_collider_is_told(body, collider, caught, tmp_path, capsys):
    if body["shape"] == "points":
        x = np.stack([np.linspace(0.1, 0.9, 100), np.full(100, 0.5)], axis=1)
        np.savetxt(tmp_path / "points.csv", x, delimiter=",", header="x,y", comments="")
        body = {"shape": {"type": "particles", "file": str(tmp_path / "points.csv")}}
    made = pmpm.Scene(
        domain={"size": [2.0, 1.0], "cell_size": 0.05},
        time={"end": 0.01},
        materials={"water": WATER},
        bodies=[body | {"material": "water"}],
        colliders=[collider],
    )
    lines, notes = explain.explain(made, 1).splitlines(), pmpm.Simulation(made).notes
    told = [line for line in lines if "lies inside of the collider" in line]
    assert [f"warning: {line[14:]}" for line in told] == [note for note in notes if "collider" in note]
    if caught is None:
        assert told == []
    else:
        (line,) = told
        assert "bodies[0]: about " in line
        assert "collider_0" in line
        assert float(line.split()[3]) == pytest.approx(caught, rel=0.1)
        assert ("cut = true would cut it out" in line) == (collider.get("cut") is False)


def test_where_colliders_cut_nothing_is_tried(monkeypatch):
    monkeypatch.setattr(estimate, "places_in", None)
    made = scene(BOX, colliders=[{"shape": DISK}])
    assert estimate.caught(made) == estimate.caught(scene(BOX)) == []


@pytest.mark.parametrize("periodic", [(), ("x",), ("y",)])
def test_places_are_tried_in_pieces_with_the_same_particles_in_the_same_order(periodic, monkeypatch):
    made = scene(BOX, DISK, periodic=periodic, per_cell=5)
    geometry, around = geometry_of(made), seeding.surroundings(made)
    groups = [(3, 20), (20, 21), (21, 40)]
    bodies = range(len(made.bodies))
    whole = [list(seeding.seed(made, geometry, number, groups, around)) for number in bodies]
    monkeypatch.setattr(seeding, "PLACES", 7)
    pieces = [list(seeding.seed(made, geometry, number, groups, around)) for number in bodies]
    for one, other in zip(chain(*whole), chain(*pieces), strict=True):
        assert all(np.array_equal(getattr(one, name), getattr(other, name)) for name in ("node", "offset", "id"))


@pytest.mark.parametrize("periodic", [(), ("x",), ("y",)])
def test_groups_of_layers_are_seeded_with_the_same_particles_in_the_same_order(periodic):
    """Within a layer; layer 0 of a periodic axis holds half of the last cells."""
    made = scene(BOX, DISK, periodic=periodic, per_cell=5)
    geometry, around = geometry_of(made), seeding.surroundings(made)
    slab, layers = geometry.axes[0], geometry.layers
    for number in range(len(made.bodies)):
        (whole,) = seeding.seed(made, geometry, number, [(0, layers)], around)
        whole = whole.take(np.argsort(whole.node[:, slab], kind="stable"))
        groups = [(layer, layer + 1) for layer in range(layers)]
        found = seeding.joined(list(seeding.seed(made, geometry, number, groups, around)), 2)
        assert all(np.array_equal(getattr(whole, name), getattr(found, name)) for name in ("node", "offset", "id"))


def test_a_plane_of_millions_of_cells_is_seeded_in_little_memory():
    """4 million cells with 8 places each: 32 million places of 24 bytes, four times over, if it were in one piece."""
    made = pmpm.Scene(
        domain={"size": [2.1, 2.0, 2.0], "cell_size": 0.001},
        time={"end": 0.01},
        materials={"water": WATER},
        bodies=[{"material": "water", "shape": {"type": "sphere", "center": [1.0, 1.0, 1.0], "radius": 0.99}}],
    )
    tracemalloc.start()
    pieces = seeding.seed_planes(made, geometry_of(made), 0, 1000, 1001, seeding.surroundings(made))
    for _ in range(4):
        next(pieces)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 100e6


def test_a_check_of_ten_billion_particles_tells_about_how_many_at_once(folder, capsys):
    """27 (4 pi / 3) 499^3 = 1.405e10."""
    began = time.monotonic()
    assert main(["check", "huge.toml"]) == 0
    assert time.monotonic() - began < 20.0
    text = capsys.readouterr().out
    assert "about 1.4e+10 in 1 bodies" in text or "about 1.41e+10 in 1 bodies" in text
    assert "more than this machine has" in text


def test_thousands_of_bodies_are_checked_in_seconds():
    """2000 disks took 36 s when each of them asked all the others anew where they lie."""
    chance = np.random.default_rng(0)
    disks = [
        {"type": "sphere", "center": place.tolist(), "radius": 0.003} for place in chance.uniform(0.1, 0.9, (1000, 2))
    ]
    made, began = scene(*disks, cell_size=0.002), time.process_time()
    explain.rehearse(made, geometry_of(made))
    assert time.process_time() - began < 10.0


# ---- memory ---------------------------------------------------------------------------------------------------


def test_a_run_beyond_the_memory_is_refused_and_writes_nothing(folder, capsys):
    message = refused(["run", "huge.toml"], capsys)
    for part in (
        "e+10 particles",
        "TB",
        "per rank on 1 ranks",
        "available",
        "cell_size",
        "particles_per_cell",
        "machines",
    ):
        assert part in message
    assert [path.name for path in folder.iterdir()] == ["huge.toml"]


def test_the_limit_of_the_environment_is_the_one_that_counts(monkeypatch):
    made = scene(BOX)
    monkeypatch.setenv("PMPM_MEMORY_LIMIT", "100000")
    with pytest.raises(SceneError, match=r"0.1 MB available"):
        pmpm.Simulation(made)
    monkeypatch.setenv("PMPM_MEMORY_LIMIT", str(10**18))
    assert estimate.available_memory() == 1e18


@pytest.mark.parametrize("limit", ["1GB", "-1", "0", "1e9", "nan", " "])
def test_a_limit_that_is_no_number_of_bytes_is_named(limit, monkeypatch):
    monkeypatch.setenv("PMPM_MEMORY_LIMIT", limit)
    with pytest.raises(SceneError, match="PMPM_MEMORY_LIMIT"):
        pmpm.Simulation(scene(BOX))


class Several(Alone):
    """Ranks on hosts, of which this is one: `gather` gives what each host has available."""

    def __init__(self, available):
        self.size, self.available = len(available), available

    def gather(self, value):
        return list(self.available)


@pytest.mark.parametrize(
    ("available", "fits"),
    [
        ([("a", 1.1)], True),
        ([("a", 0.9)], False),
        ([("a", 1.1), ("a", 1.1)], True),
        ([("a", 0.9), ("a", 0.9)], False),
        ([("a", 0.6), ("b", 0.6)], True),
        ([("a", 2.0), ("b", 0.4)], False),
    ],
    ids=str,
)
def test_ranks_on_one_machine_share_its_memory(available, fits):
    made = scene(BOX)
    needs, geometry = scene_needs(made), geometry_of(made)
    taken = estimate.memory(made, needs, geometry, estimate.particles(made))
    total = taken.filling + taken.grid
    comm = Several([(host, share * total) for host, share in available])
    if fits:
        estimate.refuse_memory(made, needs, geometry, comm)
    else:
        with pytest.raises(SceneError, match="does not fit into memory"):
            estimate.refuse_memory(made, needs, geometry, comm)


def test_the_grid_is_that_of_the_material_and_not_of_the_domain():
    """A thousand cells in a domain a thousand times as large: what grows are planes to work in and tables, not nodes."""
    near, far = (scene(BOX, cell_size=cell) for cell in (0.01, 0.001))
    sizes = [estimate.grid_bytes(scene_needs(one), geometry_of(one), 1000.0) for one in (near, far)]
    assert sizes[1] < 10 * sizes[0]  # the nodes of the whole domain would be a hundred times as many


def test_flip_and_f_bar_take_their_grids_besides():
    """FLIP keeps one more of them, F-bar two."""
    made = {
        name: scene(BOX, method=method)
        for name, method in {"apic": {}, "flip": {"transfer": "flip"}, "f_bar": {"f_bar": True}}.items()
    }
    size = {name: estimate.grid_bytes(scene_needs(one), geometry_of(one), 100.0) for name, one in made.items()}
    grid = size["flip"] - size["apic"]
    assert grid > 0.5 * size["apic"]
    assert size["f_bar"] - size["apic"] == pytest.approx(2.0 * grid)


def test_more_places_than_numbers_for_them_are_refused():
    """4096 places in each of 7e3 x 7e3 x 1e8 cells are 2.0e19, 64-bit numbers end at 9.2e18."""
    text = HUGE.replace("10.0, 10.0, 10.0", "7e3, 7e3, 1e8").replace("cell_size = 0.01", "cell_size = 1.0")
    many = text.replace("particles_per_cell = 27", "particles_per_cell = 4096")
    made = pmpm.Scene.from_text(many)
    with pytest.raises(SceneError, match="can be numbered"):
        geometry_of(made)


# ---- steps ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", ["run", "check"])
@pytest.mark.parametrize(
    ("setting", "key"),
    [("time.end=1e12", "time.end"), ("time.step=1e-17", "time.step"), ("time.step=1e-300", "time.step")],
)
def test_a_run_without_end_is_refused(folder, capsys, command, setting, key):
    message = refused([command, "huge.toml", "--set", "domain.cell_size=1.0", "--set", setting], capsys)
    assert f"{key} = " in message
    assert "at most 1e+11" in message


def test_a_run_that_starts_too_stiff_to_end_is_refused():
    """Water pressed to a thousandth of its volume: waves run 1000^4 times as fast as at rest, with gamma 7."""
    body = {"deformation": [[0.03, 0.0], [0.0, 0.03]]}
    made = pmpm.Scene(
        domain={"size": [1.0, 1.0], "cell_size": 0.02},
        time={"end": 1.0},
        materials={"water": WATER},
        bodies=[{"material": "water", "shape": BOX, **body}],
    )
    with pytest.raises(SceneError, match="time.end = 1.0 s is too far"):
        pmpm.Simulation(made)


# ---- a check refuses what a run refuses -----------------------------------------------------------------------

AWAY = {"type": "box", "min": [0.92, 0.9], "max": [0.98, 0.98]}
THIN = {"type": "box", "min": [0.501, 0.1], "max": [0.509, 0.9]}
REFUSED = {
    "a load on nothing": ({"loads": [{"shape": AWAY, "force": [1.0, 0.0]}]}, r"loads\[0\].shape holds no particle"),
    "a motion of nothing": (
        {"motions": [{"shape": THIN, "velocity": [0.0, 0.1]}]},
        r"motions\[0\].shape holds no node",
    ),
    "a step that is too long": ({"step": 0.005}, r"time.step = 0.005 s is longer than the stable step"),
}


@pytest.mark.parametrize("name", REFUSED)
@pytest.mark.parametrize("door", [pmpm.Simulation, lambda made: explain.explain(made, 1)], ids=["run", "check"])
def test_a_check_refuses_what_a_run_refuses(door, name):
    more, message = REFUSED[name]
    with pytest.raises(SceneError, match=message):
        door(scene(BOX, **more))


@pytest.mark.parametrize("door", [pmpm.Simulation, lambda made: explain.explain(made, 1)], ids=["run", "check"])
def test_a_check_refuses_a_body_that_starts_outside(door):
    made = pmpm.Scene(
        domain={"size": [1.0, 1.0], "cell_size": 0.02},
        time={"end": 0.01},
        materials={"water": WATER},
        bodies=[{"material": "water", "shape": BOX, "displacement": [0.2, 0.0]}],
    )
    with pytest.raises(SceneError, match=r"bodies\[0\].displacement takes particle \d+ from .* out of the domain"):
        door(made)


def test_a_region_that_comes_in_later_is_taken():
    outside = {"type": "box", "min": [-0.3, 0.1], "max": [-0.25, 0.9]}
    assert pmpm.Simulation(scene(BOX, motions=[{"shape": outside, "velocity": [1.0, 0.0]}])).rows() > 0


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_a_mass_that_is_rounded_to_nothing_is_refused(precision):
    """Kernels take denormal numbers as zero: a mass of 1e-45 kg is none in float32."""
    tiny = WATER | {"density": 1e-41 if precision == "float32" else 1e-310}
    with pytest.raises(SceneError, match=f"beyond the range of {precision}"):
        pmpm.Simulation(
            pmpm.Scene(
                domain={"size": [1.0, 1.0], "cell_size": 0.02},
                method={"precision": precision},
                time={"end": 0.01},
                materials={"water": tiny},
                bodies=[{"material": "water", "shape": BOX}],
            )
        )
