"""A body out of a mesh is what the surface encloses, told by mesh formulas, whatever small defects and file format it has."""

import math

import numpy as np
import pytest
from test_imports import modules_after

from pmpm.scene.errors import SceneError
from pmpm.scene.mesh import Mesh
from pmpm.scene.mesh_files import read_mesh
from pmpm.scene.schema import Scene
from pmpm.scene.shapes import Difference, Sphere
from pmpm.scene.surfaces import closed_surface, normals, welded

POINTS = np.random.default_rng(5).uniform(-1.3, 1.3, (4000, 3))


def ball(rings=24, radius=1.0, center=(0.0, 0.0, 0.0)):
    """(points, triangles) of a sphere of rings and poles, seen from outside counter-clockwise."""
    theta = np.linspace(0.0, np.pi, rings + 1)[1:-1]
    phi = np.arange(2 * rings) * np.pi / rings
    around = np.stack(
        [
            np.outer(np.sin(theta), np.cos(phi)),
            np.outer(np.sin(theta), np.sin(phi)),
            np.outer(np.cos(theta), 1.0 + 0 * phi),
        ],
        -1,
    )
    points = np.concatenate([around.reshape(-1, 3), [[0, 0, 1], [0, 0, -1]]])
    count, n = len(points), 2 * rings
    triangles = []
    for j in range(n):
        k = (j + 1) % n
        triangles += [[count - 2, j, k], [count - 1, (rings - 2) * n + k, (rings - 2) * n + j]]
        for i in range(rings - 2):
            a, b, c, d = i * n + j, i * n + k, (i + 1) * n + j, (i + 1) * n + k
            triangles += [[a, c, d], [a, d, b]]
    return radius * points + center, np.array(triangles)


def ring(large=0.9, small=0.3, around=40, across=20):
    """(points, triangles) of a torus."""
    u, v = np.meshgrid(np.arange(around) * 2 * np.pi / around, np.arange(across) * 2 * np.pi / across, indexing="ij")
    far = large + small * np.cos(v)
    points = np.stack([far * np.cos(u), far * np.sin(u), small * np.sin(v)], -1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(around), np.arange(across), indexing="ij")
    at = lambda i, j: (i % around * across + j % across).ravel()  # noqa: E731
    a, b, c, d = at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)
    return points, np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)])


def box(low=(-1.0, -1.0, -1.0), high=(1.0, 1.0, 1.0)):
    corners = np.array([[x, y, z] for z in (0, 1) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))])
    quads = ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7))
    triangles = [t for q in quads for t in ([q[0], q[1], q[2]], [q[0], q[2], q[3]])]
    return np.where(corners == 1, high, low).astype(float), np.array(triangles)


def both(one, two):
    return np.concatenate([one[0], two[0]]), np.concatenate([one[1], two[1] + len(one[0])])


def exact_winding(elements, point):
    from pmpm.scene.surfaces import winding_of

    return winding_of(elements, point)


SURFACES = {"ball": ball(), "ring": ring(), "box": box()}


@pytest.fixture(params=SURFACES)
def clean(request):
    points, corners = SURFACES[request.param]
    return closed_surface(points, corners)


# ---- inside and outside ------------------------------------------------------------------------------------------------------


def test_inside_is_where_the_solid_angle_is_the_whole_sphere(clean):
    expected = [exact_winding(clean.elements, point) > 0.5 for point in POINTS[:500]]
    assert (clean.contains(POINTS[:500]) == expected).all()


def test_winding_numbers_from_afar_are_right_to_a_tenth(clean):
    expected = [exact_winding(clean.elements, point) for point in POINTS[:500]]
    assert np.abs(clean.winding_numbers(POINTS[:500]) - expected).max() < 0.1


def test_the_share_of_points_inside_is_the_volume(clean):
    n = 60
    places = np.stack(np.meshgrid(*[(np.arange(n) + 0.37) / n * 2.6 - 1.3] * 3, indexing="ij"), -1).reshape(-1, 3)
    assert clean.contains(places).mean() * 2.6**3 == pytest.approx(clean.volume, rel=0.01)


def test_a_point_is_told_the_same_alone_and_among_others(clean):
    together = clean.contains(POINTS)
    fresh = closed_surface(clean.elements.reshape(-1, 3), np.arange(3 * len(clean.elements)).reshape(-1, 3))
    backwards = fresh.contains(POINTS[::-1])[::-1]
    assert (together == backwards).all()
    assert all(clean.contains(POINTS[n : n + 1])[0] == together[n] for n in range(0, 4000, 400))


def test_distance_is_that_to_the_nearest_triangle():
    points, corners = box()
    tested = closed_surface(points, corners)
    inside = np.abs(POINTS).max(axis=1) <= 1.0
    out = np.maximum(np.abs(POINTS) - 1.0, 0.0)
    expected = np.where(inside, np.abs(POINTS).max(axis=1) - 1.0, np.sqrt((out * out).sum(axis=1)))
    assert tested.signed_distance(POINTS) == pytest.approx(expected, abs=1e-14)


def test_distance_does_not_depend_on_the_points_before(clean):
    together = clean.signed_distance(POINTS)
    assert all(clean.signed_distance(POINTS[n : n + 1])[0] == together[n] for n in range(0, 4000, 100))
    assert (clean.signed_distance(POINTS[::-1])[::-1] == together).all()


def test_distance_is_negative_inside(clean):
    assert ((clean.signed_distance(POINTS) < 0.0) == clean.contains(POINTS)).all()


# ---- sizes -------------------------------------------------------------------------------------------------------------------


def test_volume_centroid_and_second_moment_of_a_box_are_the_textbooks():
    tested = closed_surface(*box((1.0, 2.0, 3.0), (1.5, 3.0, 5.0)))
    assert tested.volume == pytest.approx(1.0, rel=1e-14)
    assert tested.area == pytest.approx(2 * (0.5 + 2.0 + 1.0), rel=1e-14)
    assert tested.centroid == pytest.approx([1.25, 2.5, 4.0], rel=1e-14)
    assert tested.second_moment == pytest.approx(np.diag([0.25, 1.0, 4.0]) / 12.0, abs=1e-14)


def test_volume_of_a_torus_is_pappus():
    assert closed_surface(*ring(around=200, across=100)).volume == pytest.approx(2 * math.pi**2 * 0.9 * 0.09, rel=2e-3)


def test_area_and_moments_of_a_polygon_are_the_textbooks():
    points = np.array([[1.0, 1.0], [3.0, 1.0], [3.0, 2.0], [1.0, 2.0]])
    tested = closed_surface(points, np.array([[0, 1], [1, 2], [2, 3], [3, 0]]))
    assert (tested.volume, tested.area) == pytest.approx((2.0, 6.0))
    assert tested.centroid == pytest.approx([2.0, 1.5])
    assert tested.second_moment == pytest.approx(np.diag([2.0 * 4.0, 2.0 * 1.0]) / 12.0)


# ---- defects -----------------------------------------------------------------------------------------------------------------


def damaged(points, corners, seed=0):
    """The same surface as it comes out of bad tools: corners apart, triangles turned, repeated, empty and missing."""
    rng = np.random.default_rng(seed)
    corners = corners.copy()
    turned = rng.random(len(corners)) < 0.1
    corners[turned] = corners[turned][:, ::-1]
    corners = np.concatenate([corners, corners[rng.integers(len(corners), size=15)], [[0, 0, 1], [5, 7, 5]]])
    corners = np.delete(corners, [100, 101, 500], axis=0)
    soup = points[corners].reshape(-1, 3)
    return soup + 1e-9 * rng.standard_normal(soup.shape), np.arange(len(soup)).reshape(-1, 3)


def test_small_defects_change_nothing_but_next_to_them():
    points, corners = ball()
    tested, whole = closed_surface(*damaged(points, corners)), closed_surface(points, corners)
    assert tested.volume == pytest.approx(whole.volume, rel=1e-3)
    assert np.count_nonzero(tested.contains(POINTS) != whole.contains(POINTS)) <= 2
    assert np.abs(tested.winding_numbers(POINTS) - np.round(tested.winding_numbers(POINTS))).max() < 0.1


def test_what_was_mended_is_counted():
    mended = closed_surface(*damaged(*ball())).mended
    assert (mended.empty, mended.repeated > 0, mended.turned > 50, mended.turned_pieces) == (2, True, True, 0)
    assert 1 <= mended.holes <= 3
    assert 0.0 < mended.open_part < 0.01


def test_a_surface_that_looks_inward_is_turned():
    points, corners = ring()
    tested = closed_surface(points, corners[:, ::-1])
    assert tested.mended.turned_pieces == 1
    assert tested.volume == closed_surface(points, corners).volume


def test_a_cavity_stays_one():
    points, corners = both(ball(), (ball(radius=0.5)[0], ball()[1][:, ::-1]))
    tested = closed_surface(points, corners)
    assert tested.volume == pytest.approx(7.0 / 8.0 * closed_surface(*ball()).volume)
    assert not tested.contains(np.zeros((1, 3)))[0]


def test_a_second_piece_that_looks_inward_is_turned():
    apart = ball(radius=0.3, center=(3.0, 0.0, 0.0))
    tested = closed_surface(*both(ball(), (apart[0], apart[1][:, ::-1])))
    assert tested.contains(np.array([[3.0, 0.0, 0.0], [0.0, 0.0, 0.0], [2.0, 0.0, 0.0]])).tolist() == [
        True,
        True,
        False,
    ]


def test_pieces_that_overlap_are_joined():
    tested = closed_surface(*both(ball(), ball(center=(0.5, 0.0, 0.0))))
    expected = [(np.linalg.norm(p) < 1.0) | (np.linalg.norm(p - [0.5, 0, 0]) < 1.0) for p in POINTS]
    assert (tested.contains(POINTS) != expected).mean() < 0.01


def test_a_wall_inside_a_body_is_left_out():
    left = box(high=(0.0, 1.0, 1.0))
    tested = closed_surface(*both(left, (left[0] * [-1.0, 1.0, 1.0], left[1][:, ::-1])))
    assert tested.mended.repeated == 4
    assert tested.volume == pytest.approx(8.0)
    assert tested.contains(np.zeros((1, 3)))[0]


def test_a_surface_drawn_on_both_sides_is_one():
    points, corners = ball()
    tested = closed_surface(points, np.concatenate([corners, corners[:, ::-1]]))
    assert tested.volume == pytest.approx(closed_surface(points, corners).volume)


def test_points_that_lie_together_across_the_cells_of_a_grid_are_one():
    steps = np.linspace(0.0, 1.0, 1001)[:, None] * [1.0, 0.0, 0.0]
    points = np.stack([steps, steps + 1e-12], axis=1).reshape(-1, 3)
    _, corners = welded(points, np.arange(2001)[:, None] + [0, 1, 1], 1e-6)
    assert len(np.unique(corners)) == 1001


def test_an_open_surface_is_refused_with_what_is_missing(tmp_path):
    points, corners = ball()
    write_obj(tmp_path / "bowl.obj", points, corners[points[corners][:, :, 2].mean(axis=1) < 0.5])
    with pytest.raises(
        SceneError, match=r"bowl.obj.* is open: 48 edges .* around 1 hole, the largest 1.7.* m across; 25.0%"
    ):
        Mesh(file=tmp_path / "bowl.obj")


def test_a_tube_is_refused_though_its_ends_make_up_for_each_other(tmp_path):
    points, corners = ball()
    write_obj(tmp_path / "tube.obj", points, corners[np.abs(points[corners][:, :, 2].mean(axis=1)) < 0.5])
    with pytest.raises(SceneError, match="around 2 holes"):
        Mesh(file=tmp_path / "tube.obj")


def test_an_open_line_is_refused():
    points = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    with pytest.raises(Exception, match="1 gap in its lines, the largest 1 m wide; 33.3%"):
        closed_surface(points, np.array([[0, 1], [1, 2], [2, 3]]))


# ---- files -------------------------------------------------------------------------------------------------------------------


def write_obj(path, points, corners):
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in points.tolist()] + [
        f"f {a} {b} {c}" for a, b, c in (corners + 1).tolist()
    ]
    path.write_text("\n".join(lines) + "\n")


def poly_data(points, corners):
    vtk = pytest.importorskip("vtk")
    from vtk.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray

    found, cells = vtk.vtkPolyData(), vtk.vtkCellArray()
    places = vtk.vtkPoints()
    places.SetDataTypeToDouble()
    places.SetData(numpy_to_vtk(np.ascontiguousarray(points), deep=True))
    rows = np.pad(corners, ((0, 0), (1, 0)), constant_values=3).astype(np.int64)
    cells.SetCells(len(corners), numpy_to_vtkIdTypeArray(rows.ravel(), deep=True))
    found.SetPoints(places)
    found.SetPolys(cells)
    return found


@pytest.mark.parametrize("mode", ["Ascii", "Binary", "Appended"])
@pytest.mark.parametrize("packed", [True, False])
@pytest.mark.parametrize("encoded", [True, False])
def test_vtp_files_of_vtk_are_read_to_the_bit(tmp_path, mode, packed, encoded):
    data = poly_data(*ring())
    import vtk

    writer = vtk.vtkXMLPolyDataWriter()
    getattr(writer, f"SetDataModeTo{mode}")()
    writer.SetEncodeAppendedData(encoded)
    writer.SetBlockSize(4096)
    if not packed:
        writer.SetCompressorTypeToNone()
    writer.SetFileName(str(tmp_path / "ring.vtp"))
    writer.SetInputData(data)
    assert writer.Write()
    mesh = read_mesh(str(tmp_path / "ring.vtp"))
    assert mesh.points.tolist() == ring()[0].tolist()
    assert mesh.blocks[0].corners.tolist() == ring()[1].tolist()


FILES = [("a.stl", {"binary": True}), ("a.stl", {"binary": False}), ("a.ply", {}), ("a.vtu", {}), ("a.off", {})]


@pytest.mark.parametrize(("name", "more"), FILES)
def test_files_of_meshio_hold_the_same_body(tmp_path, name, more):
    meshio = pytest.importorskip("meshio")
    points, corners = ring()
    meshio.write(tmp_path / name, meshio.Mesh(points, [("triangle", corners)]), **more)
    assert Mesh(file=tmp_path / name).surface.volume == pytest.approx(closed_surface(points, corners).volume, rel=1e-6)


def test_a_mesh_of_volumes_is_the_surface_around_it_or_around_one_group(tmp_path):
    meshio = pytest.importorskip("meshio")
    corners, _ = box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    points = np.concatenate([corners, corners[4:] + [0, 0, 1]])
    cells = np.array([[0, 1, 2, 3, 4, 5, 6, 7], [4, 5, 6, 7, 8, 9, 10, 11]])
    mesh = meshio.Mesh(points, [("hexahedron", cells)], cell_data={"layer": [np.array([1, 2])]})
    meshio.write(tmp_path / "two.vtu", mesh)
    assert Mesh(file=tmp_path / "two.vtu").surface.volume == pytest.approx(2.0)
    upper = Mesh(file=tmp_path / "two.vtu", group="layer=2")
    assert upper.bounds()[0].tolist() == [0.0, 0.0, 1.0]


def test_polygons_are_read_from_csv(tmp_path):
    (tmp_path / "frame.csv").write_text("x,y\n0,0\n4,0\n4,4\n0,4\n\n1,1\n1,3\n3,3\n3,1\n1,1\n")
    frame = Mesh(file=tmp_path / "frame.csv")
    assert frame.surface.volume == pytest.approx(12.0)
    assert frame.contains(np.array([[0.5, 0.5], [2.0, 2.0], [5.0, 1.0]])).tolist() == [True, False, False]


def test_scale_comes_before_turns_and_turns_about_x_y_z_before_the_move(tmp_path):
    write_obj(tmp_path / "box.obj", *box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)))
    placed = Mesh(file=tmp_path / "box.obj", scale=[1.0, 2.0, 3.0], rotate=[90.0, 0.0, 90.0], move=[10.0, 0.0, 0.0])
    # About x: (x, y, z) -> (x, -z, y), (1, 2, 3) -> (1, -3, 2); about z: (x, y, z) -> (-y, x, z).
    assert placed.placed(np.array([[1.0, 1.0, 1.0]])).tolist() == [[13.0, 1.0, 2.0]]
    assert [corner.tolist() for corner in placed.bounds()] == [[10.0, 0.0, 0.0], [13.0, 1.0, 2.0]]


def test_a_mesh_stands_in_other_shapes(tmp_path):
    write_obj(tmp_path / "ball.obj", *ball())
    shell = Difference(of=[Mesh(file=tmp_path / "ball.obj"), Sphere(center=[0, 0, 0], radius=0.5)])
    assert shell.contains(np.array([[0.0, 0.0, 0.0], [0.7, 0.0, 0.0], [1.2, 0.0, 0.0]])).tolist() == [
        False,
        True,
        False,
    ]


# ---- scenes ------------------------------------------------------------------------------------------------------------------


def scene_table(path):
    return {
        "domain": {"size": [2.4, 2.4, 0.8], "cell_size": 0.1},
        "time": {"end": 1.0},
        "materials": {"a": {"model": "neo_hookean", "density": 1e3, "youngs_modulus": 1e4, "poisson_ratio": 0.3}},
        "bodies": [{"material": "a", "shape": {"type": "mesh", "file": str(path), "move": [1.2, 1.2, 0.4]}}],
    }


@pytest.fixture
def scene(tmp_path):
    write_obj(tmp_path / "ring.obj", *ring())
    return Scene(**scene_table(tmp_path / "ring.obj"))


def test_a_scene_with_a_mesh_reads_back_equal(scene):
    scene.bodies[0].shape.contains(POINTS)
    again = Scene.from_text(scene.to_toml())
    assert again == scene
    assert again.bodies[0].shape.checksum


def test_ranks_that_seed_a_part_each_seed_the_whole(scene):
    from pmpm.scene import seeding
    from pmpm.scene.needs import grid_geometry, scene_needs

    geometry = grid_geometry(scene, scene_needs(scene))
    around = seeding.surroundings(scene)

    def seeds(first, last):
        return seeding.joined([s for _, s in seeding.seed_planes(scene, geometry, 0, first, last, around)], 3)

    whole = seeds(0, geometry.layers)
    cuts = [0, 7, 11, 18, geometry.layers]
    parts = [seeds(a, b) for a, b in zip(cuts, cuts[1:], strict=False)]
    # Each part as the rank would have it: the surface read anew, its grid unlooked at.
    assert sorted(whole.id) == sorted(np.concatenate([part.id for part in parts]))
    order = np.argsort(whole.id), np.argsort(np.concatenate([part.id for part in parts]))
    assert (whole.offset[order[0]] == np.concatenate([part.offset for part in parts])[order[1]]).all()


def test_check_tells_the_size_of_a_mesh(scene):
    from pmpm.explain import explain

    assert "bodies[0].shape: 1600 triangles, 2.4 x 2.4 x 0.6 m, volume 1.5" in explain(scene, 1)


def test_a_mended_mesh_is_told_in_the_log(tmp_path):
    from pmpm.simulation import Simulation

    points, corners = ring()
    write_obj(tmp_path / "ring.obj", points, corners[1:])
    notes = Simulation(Scene(**scene_table(tmp_path / "ring.obj"))).notes
    assert any("ring.obj was mended: 1 holes closed, the largest 0.1" in note for note in notes)


def test_a_scene_without_a_mesh_loads_nothing_of_meshes(tmp_path):
    code = "from pmpm.cli import main\nassert main(['check', 'dam_break']) == 0"
    loaded = modules_after(code, tmp_path)
    assert loaded.isdisjoint({"meshio", "pmpm.scene.mesh_files", "pmpm.kernels.surfaces", "xml.etree.ElementTree"})


def test_a_file_for_meshio_without_it_names_the_extra(tmp_path, monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "meshio", None)
    (tmp_path / "a.stl").write_text("solid\nendsolid\n")
    with pytest.raises(SceneError, match=r"pip install 'pmpm\[mesh\]'"):
        Mesh(file=tmp_path / "a.stl")


def test_a_ply_that_is_cut_off_ends(tmp_path):
    (tmp_path / "a.ply").write_text("ply\nformat ascii 1.0\nelement vertex 3\n")
    with pytest.raises(SceneError, match="cannot be read: it has no end_header"):
        Mesh(file=tmp_path / "a.ply")


def test_a_reader_that_finds_no_end_is_stopped(tmp_path, monkeypatch):
    meshio = pytest.importorskip("meshio")
    from pmpm.scene import mesh_files

    def read(path, kind):
        while True:
            pass

    monkeypatch.setattr(meshio, "read", read)
    monkeypatch.setattr(mesh_files, "PATIENCE", 0.1)
    (tmp_path / "a.stl").write_text("solid")
    with pytest.raises(SceneError, match="no end was found in 0 s; is it cut off"):
        Mesh(file=tmp_path / "a.stl")


@pytest.mark.parametrize("name", ["ring.obj", "ring.vtp", "frame.csv", "ring.stl"])
def test_damaged_files_are_read_or_told(name, tmp_path):
    if name.endswith("obj"):
        write_obj(tmp_path / name, *ring(around=8, across=6))
    elif name.endswith("csv"):
        (tmp_path / name).write_text("x,y\n0,0\n4,0\n4,4\n0,4\n\n1,1\n1,3\n3,3\n3,1\n1,1\n")
    else:
        vtk = pytest.importorskip("vtk")
        writer = vtk.vtkXMLPolyDataWriter() if name.endswith("vtp") else vtk.vtkSTLWriter()
        writer.SetFileName(str(tmp_path / name))
        writer.SetInputData(poly_data(*ring(around=8, across=6)))
        assert writer.Write()
    whole, random = (tmp_path / name).read_bytes(), np.random.default_rng(1)
    told = []
    for _ in range(60):
        content = bytearray(whole[: random.integers(len(whole)) if random.random() < 0.3 else len(whole)])
        for place in random.integers(max(len(content), 1), size=random.integers(1, 6)):
            content[place : place + random.integers(3)] = bytes(random.integers(0, 256, 1, dtype=np.uint8))
        (tmp_path / name).write_bytes(content)
        try:
            Mesh(file=tmp_path / name)
        except SceneError as complaint:
            told.append(len(str(complaint)))
    assert len(told) > 5
    assert max(told) < 600


def test_normals_are_as_long_as_the_area():
    points, corners = box()
    assert np.linalg.norm(normals(points[corners]), axis=1) == pytest.approx(np.full(12, 2.0))
