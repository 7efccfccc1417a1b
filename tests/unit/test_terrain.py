"""Height maps: what is read from files, where ground and layers are, and what is refused."""

import numpy as np
import pytest

import pmpm
from pmpm.explain import explain
from pmpm.scene.errors import SceneError
from pmpm.scene.terrain import Terrain

X, Y = np.meshgrid(np.arange(5) * 2.0, np.arange(4) * 2.0)  # rows along y
TILTED = 1.0 + 0.25 * X + 0.5 * Y


def terrain(path, values=TILTED, **keys):
    np.save(path / "map.npy", values)
    return Terrain(file=str(path / "map.npy"), **({"spacing": 2.0} | keys))


def test_a_tilted_map_is_a_plane(tmp_path):
    ground = terrain(tmp_path, origin=[1.0, 1.0, 0.5])
    points = np.random.default_rng(1).uniform([1.0, 1.0, 0.0], [9.0, 7.0, 6.0], (200, 3))
    above = points[:, 2] - (1.5 + 0.25 * (points[:, 0] - 1.0) + 0.5 * (points[:, 1] - 1.0))
    assert ground.signed_distance(points) == pytest.approx(above / np.sqrt(1.0 + 0.25**2 + 0.5**2))
    assert np.array_equal(ground.contains(points), above <= 0.0)
    assert ground.normals(points)[0] == pytest.approx(np.array([-0.25, -0.5, 1.0]) / np.sqrt(1.3125))


def test_ground_is_level_beyond_its_map(tmp_path):
    ground = terrain(tmp_path)
    beyond = np.array([[-3.0, 3.0, 2.5], [9.0, 9.0, 6.0]])
    assert ground.signed_distance(beyond)[1] == pytest.approx(6.0 - TILTED.max())
    assert ground.normals(beyond)[1] == pytest.approx([0.0, 0.0, 1.0])


def test_between_samples_heights_are_bilinear(tmp_path):
    ground = terrain(tmp_path, X * Y)
    assert ground.above(np.array([[1.0, 1.0, 0.0]]))[0] == pytest.approx([-1.0])


def test_a_profile_is_the_ground_of_a_flat_scene(tmp_path):
    ground = terrain(tmp_path, np.array([0.0, 1.0, 0.0]))
    assert ground.dim == 2
    assert ground.signed_distance(np.array([[1.0, 0.5], [3.0, 1.5]])) == pytest.approx([0.0, 1.0 / np.sqrt(1.25)])


@pytest.mark.parametrize(("origin", "up"), [(5.0, 0.0), ([5.0], 0.0), ([5.0, 0.25], 0.25)])
def test_the_origin_of_a_profile_is_a_number_or_two(origin, up, tmp_path):
    ground = terrain(tmp_path, np.array([0.0, 1.0, 0.0]), origin=origin)
    assert ground.corner().tolist() == [5.0, up]
    assert ground.above(np.array([[6.0, 1.0]]))[0] == pytest.approx([0.5 - up])
    assert Terrain.model_validate(ground.model_dump()) == ground


@pytest.mark.parametrize(
    ("origin", "words"),
    [
        ([5.0], "origin = [5.0] must have 2 or 3 numbers for a map of 2 axes"),
        (5.0, "origin = [5.0] must have 2 or 3 numbers"),
        ([], "must be a list of one, two or three numbers"),
        ([0.0] * 4, "must be a list of one, two or three numbers"),
        ("west", "must be a number"),
    ],
)
def test_an_origin_that_does_not_fit_the_map_is_refused(origin, words, tmp_path):
    with pytest.raises(SceneError) as raised:
        terrain(tmp_path, origin=origin)
    assert words in str(raised.value)


def test_a_layer_lies_on_the_ground(tmp_path):
    layer = terrain(tmp_path, depth=0.5)
    below, inside, above = layer.contains(np.array([[2.0, 2.0, z] for z in (2.4, 2.9, 3.1)]))
    assert (below, inside, above) == (False, True, False)
    low, high = layer.bounds()
    assert low == pytest.approx([0.0, 0.0, 1.0])
    assert high == pytest.approx([8.0, 6.0, TILTED.max() + 0.5])


def test_normals_of_a_layer_point_away_from_it_on_both_sides(tmp_path):
    layer = terrain(tmp_path, depth=0.5)
    below, above = layer.normals(np.array([[2.0, 2.0, 2.4], [2.0, 2.0, 3.1]]))
    assert below[2] < 0.0 < above[2]


def test_a_map_of_depths_says_where_there_is_a_layer(tmp_path):
    depth = np.zeros_like(TILTED)
    depth[1, 2] = 1.0
    np.save(tmp_path / "depth.npy", depth)
    layer = terrain(tmp_path, depth=str(tmp_path / "depth.npy"))
    ground = 1.0 + 0.25 * 4.0 + 0.5 * 2.0
    points = np.array([[4.0, 2.0, ground + 0.9], [4.0, 2.0, ground + 1.1], [0.5, 0.5, 1.0 + 0.4]])
    assert layer.contains(points).tolist() == [True, False, False]
    low, high = layer.bounds()
    assert low[:2] == pytest.approx([2.0, 0.0])
    assert high[:2] == pytest.approx([6.0, 4.0])


def asc(path, head, values):
    path.write_text(head + "\n".join(" ".join(map(str, row)) for row in values), encoding="ascii")
    return Terrain(file=str(path))


HEAD = "ncols 5\nnrows 4\nxllcorner 100.0\nyllcorner 200.0\ncellsize 2.0\nNODATA_value -9999\n"


def test_an_esri_grid_begins_in_the_north(tmp_path):
    points = np.random.default_rng(2).uniform([0.0, 0.0, 0.0], [8.0, 6.0, 6.0], (50, 3))
    north_first = asc(tmp_path / "map.asc", HEAD, TILTED[::-1])
    assert north_first.signed_distance(points) == pytest.approx(terrain(tmp_path).signed_distance(points))


def test_a_geotiff_tells_its_spacing(tmp_path):
    tifffile = pytest.importorskip("tifffile")
    scale = (33550, "d", 3, (2.0, 2.0, 0.0), True)
    tifffile.imwrite(tmp_path / "map.tif", TILTED[::-1].astype(np.float32), extratags=[scale])
    points = np.random.default_rng(2).uniform([0.0, 0.0, 0.0], [8.0, 6.0, 6.0], (50, 3))
    ground = Terrain(file=str(tmp_path / "map.tif"))
    assert ground.signed_distance(points) == pytest.approx(terrain(tmp_path).signed_distance(points))


@pytest.mark.parametrize(
    ("name", "keys", "words"),
    [
        ("map.npy", {}, ["does not tell the distance between samples", "spacing"]),
        ("map.npy", {"spacing": 2.0, "variable": "z"}, ["is no .npz file"]),
        ("map.txt", {"spacing": 2.0}, ["is no height map", ".npy, .npz, .asc"]),
        ("holes.npy", {"spacing": 2.0}, ["1 of 20 samples without a height"]),
        ("cube.npy", {"spacing": 2.0}, ["is no map"]),
        ("broken.npy", {"spacing": 2.0}, ["cannot be read as .npy"]),
        ("nowhere.npy", {"spacing": 2.0}, ["no such file"]),
        ("maps.npz", {"spacing": 2.0}, ["holds a, b", "variable"]),
        ("map.asc", {"spacing": 2.0}, ["tells its spacing itself"]),
        ("short.asc", {}, ["19 heights, not nrows x ncols = 20"]),
        ("map.npy", {"spacing": 2.0, "depth": "small.npy"}, ["depth", "other samples"]),
        ("map.npy", {"spacing": 2.0, "depth": "zero.npy"}, ["depth", "nowhere more than"]),
        ("map.npy", {"spacing": 2.0, "checksum": "abc"}, ["is not the file it was"]),
        ("map.npy", {"spacing": 2.0, "origin": [0.0, 0.0], "first_row": "west"}, ["first_row", "south"]),
        ("map.npy", {"spacing": -1.0}, ["spacing", "> 0"]),
    ],
)
def test_what_is_no_map_is_refused(name, keys, words, tmp_path):
    np.save(tmp_path / "map.npy", TILTED)
    holes = TILTED.copy()
    holes[1, 1] = np.nan
    np.save(tmp_path / "holes.npy", holes)
    np.save(tmp_path / "cube.npy", np.zeros((2, 2, 2)))
    np.save(tmp_path / "small.npy", np.ones((2, 2)))
    np.save(tmp_path / "zero.npy", np.zeros_like(TILTED))
    np.savez(tmp_path / "maps.npz", a=TILTED, b=TILTED)
    (tmp_path / "map.txt").write_text("1 2 3")
    (tmp_path / "broken.npy").write_bytes((tmp_path / "map.npy").read_bytes()[:100])
    rows = "\n".join(" ".join(map(str, row)) for row in TILTED)
    (tmp_path / "map.asc").write_text(HEAD + rows)
    (tmp_path / "short.asc").write_text(HEAD + rows[: rows.rindex(" ")])
    keys = {key: str(tmp_path / value) if str(value).endswith(".npy") else value for key, value in keys.items()}
    with pytest.raises(SceneError) as raised:
        Terrain(file=str(tmp_path / name), **keys)
    assert all(word in str(raised.value) for word in words), raised.value


SCENE = """
[domain]
size = [8.0, 6.0, 6.0]
cell_size = 0.5
[time]
end = 1.0
[materials.a]
model = "neo_hookean"
density = 1.0
youngs_modulus = 1.0
poisson_ratio = 0.3
[[bodies]]
material = "a"
shape = { type = "terrain", file = "map.npy", spacing = 2.0, depth = 0.5 }
[[colliders]]
shape = { type = "terrain", file = "map.npy", spacing = 2.0 }
"""


def test_paths_count_from_the_scene_and_are_known_again_by_their_checksum(tmp_path, monkeypatch):
    (tmp_path / "here").mkdir()
    np.save(tmp_path / "here" / "map.npy", 0.5 * TILTED)
    (tmp_path / "here" / "scene.toml").write_text(SCENE)
    monkeypatch.chdir(tmp_path)
    scene = pmpm.Scene.from_toml("here/scene.toml")
    assert pmpm.Scene.from_text(scene.to_toml()) == scene
    np.save(tmp_path / "here" / "map.npy", 0.4 * TILTED)
    with pytest.raises(SceneError, match="is not the file it was"):
        pmpm.Scene.from_text(scene.to_toml())


@pytest.mark.parametrize(("key", "value"), [("spacing", 0.0008), ("origin", [-100.0, 0.0])])
def test_a_map_that_lies_nowhere_under_the_domain_is_refused(key, value, tmp_path):
    np.save(tmp_path / "map.npy", 0.5 * TILTED)
    (tmp_path / "scene.toml").write_text(SCENE)
    with pytest.raises(SceneError, match=r"colliders\[0\].shape.origin.*puts the map from.*along x.*metres"):
        pmpm.Scene.from_toml(tmp_path / "scene.toml", {f"colliders.0.shape.{key}": value})


def test_a_map_does_not_fit_a_scene_of_another_dimension(tmp_path):
    np.save(tmp_path / "map.npy", TILTED[0])
    (tmp_path / "scene.toml").write_text(SCENE)
    with pytest.raises(SceneError, match=r"is a map of 1 axes, for 2 dimensions, not 3"):
        pmpm.Scene.from_toml(tmp_path / "scene.toml")


def test_check_tells_of_the_ground(tmp_path):
    np.save(tmp_path / "map.npy", 0.5 * TILTED)
    (tmp_path / "scene.toml").write_text(SCENE)
    told = explain(pmpm.Scene.from_toml(tmp_path / "scene.toml"), 1)
    assert "colliders[0].shape: 5x4 heights, 8 x 6 m, from 0.5 to 3 m" in told
