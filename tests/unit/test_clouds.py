"""Particles out of a file are those of the file: places, volumes, velocities and states, of tables, snapshots and meshes."""

import numpy as np
import pytest

from pmpm.scene import seeding
from pmpm.scene.clouds import quadrature
from pmpm.scene.errors import SceneError
from pmpm.scene.mesh import Particles
from pmpm.scene.needs import grid_geometry, scene_needs
from pmpm.scene.schema import Scene
from pmpm.simulation import Simulation

RUBBER = {"model": "neo_hookean", "density": 1000.0, "youngs_modulus": 1e4, "poisson_ratio": 0.3}
STEEL = RUBBER | {"density": 8000.0}


def scene(*bodies, size=(1.0, 1.0), materials=None, **more):
    made = [{"material": "a"} | body for body in bodies]
    domain = {"size": list(size), "cell_size": 0.1}
    return Scene(domain=domain, time={"end": 1.0}, materials=materials or {"a": RUBBER}, bodies=made, **more)


def points(path, **more):
    return {"type": "particles", "file": str(path)} | more


@pytest.fixture
def table(tmp_path):
    """(file, columns) of 200 particles with volumes, velocities and deformations."""
    random = np.random.default_rng(3)
    x, volume = random.uniform(0.2, 0.8, (200, 2)), random.uniform(1e-4, 2e-4, 200)
    v = random.uniform(-1.0, 1.0, (200, 2))
    F = np.eye(2).ravel() + random.uniform(-0.05, 0.05, (200, 4))
    rows = np.column_stack([x, volume, v, F])
    head = "x,y,volume,velocity_x,velocity_y,F_xx,F_xy,F_yx,F_yy"
    np.savetxt(tmp_path / "points.csv", rows, delimiter=",", header=head, comments="", fmt="%.17g")
    return tmp_path / "points.csv", (x, volume, v, F)


def in_order(simulation, *names):
    order = np.argsort(simulation.particles.id)
    return [getattr(simulation.particles, name)[order] for name in names]


def test_a_table_gives_places_volumes_velocities_and_states(table):
    path, (x, volume, v, F) = table
    tested = Simulation(scene({"shape": points(path)}))
    found = in_order(tested, "x", "volume0", "v", "F", "mass")
    assert found[0] == pytest.approx(x, abs=1e-14)
    assert found[1] == pytest.approx(volume, rel=1e-7)
    assert found[2].tolist() == v.tolist()
    assert found[3].reshape(-1, 4).tolist() == F.tolist()
    assert tested.measure()["mass"] == pytest.approx(1000.0 * volume.sum(), rel=1e-7)
    tested.run(steps=5)
    assert tested.measure()["momentum_x"] == pytest.approx(1000.0 * (volume * v[:, 0]).sum(), rel=1e-7)


def test_fields_that_are_not_wanted_are_left(table):
    path, (x, volume, v, F) = table
    tested = Simulation(scene({"shape": points(path, fields=["velocity"])}))
    found = in_order(tested, "F", "v")
    assert (found[0] == np.eye(2)).all()
    assert found[1].tolist() == v.tolist()


def test_a_velocity_of_the_body_is_added_and_turns_turn_velocities(table):
    path, (x, volume, v, F) = table
    shape = points(path, fields=["velocity"], rotate=90.0, move=[1.0, 0.0])
    tested = Simulation(scene({"shape": shape, "velocity": [10.0, 0.0]}))
    found = in_order(tested, "x", "v")
    assert found[0] == pytest.approx(np.column_stack([1.0 - x[:, 1], x[:, 0]]), abs=1e-14)
    assert found[1] == pytest.approx(np.column_stack([10.0 - v[:, 1], v[:, 0]]), abs=1e-14)


def test_scale_scales_volumes(table):
    path, (x, volume, *_) = table
    half = Particles(file=path, scale=0.5)
    assert half.volume == pytest.approx(0.25 * volume)


def test_without_volumes_particles_have_those_of_the_lattice_and_no_share(tmp_path):
    (tmp_path / "a.csv").write_text("x,y\n0.31,0.3\n0.5,0.52\n")
    made = scene({"shape": points(tmp_path / "a.csv")})
    assert not scene_needs(made).shared
    assert Simulation(made).particles.volume0.tolist() == pytest.approx([0.0025, 0.0025])


def test_a_checkpoint_of_another_run_is_a_beginning(tmp_path):
    first = Simulation(
        scene(
            {
                "shape": {"type": "sphere", "center": [0.5, 0.5], "radius": 0.3},
                "velocity": [0.1, -0.2],
                "seeding": "quadrature",
            }
        )
    )
    first.run(steps=20)
    first.save(tmp_path / "a.hdf")
    second = Simulation(scene({"shape": points(tmp_path / "a.hdf")}))
    one, other = first.measure(), second.measure()
    assert {name: other[name] for name in ("particles", "mass", "momentum_x")} == pytest.approx(
        {name: one[name] for name in ("particles", "mass", "momentum_x")}, rel=1e-12
    )
    assert other["strain"] == pytest.approx(one["strain"], rel=1e-9)


BRICK = np.array([[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0], [0, 0, 3], [2, 0, 3], [2, 1, 3], [0, 1, 3]], float)
CELLS = {
    "tetra": ([[0, 1, 3, 4]], 1.0),
    "pyramid": ([[0, 1, 2, 3, 4]], 2.0),
    "wedge": ([[0, 1, 3, 4, 5, 7]], 3.0),
    "hexahedron": ([[0, 1, 2, 3, 4, 5, 6, 7]], 6.0),
}


@pytest.mark.parametrize("kind", CELLS)
def test_quadrature_points_have_the_volume_and_the_centroid_of_a_cell(kind):
    corners, volume = CELLS[kind]
    x, weights = quadrature(kind, BRICK[corners])
    assert weights.sum() == pytest.approx(volume, rel=1e-12)
    assert weights.min() > 0.0
    centroid = {"pyramid": [0.75, 0.375, 0.75], "wedge": [2 / 3, 1 / 3, 1.5], "hexahedron": [1, 0.5, 1.5]}
    expected = centroid.get(kind, BRICK[corners[0]].mean(axis=0))
    assert weights @ x / volume == pytest.approx(expected, rel=1e-12)


def test_quadrature_points_of_tetrahedra_have_their_inertia():
    """Integral of x^2 over the tetrahedron with legs 2, 1, 3: abc a^2 / 60."""
    x, weights = quadrature("tetra", BRICK[[[0, 1, 3, 4]]])
    assert weights @ x**2 == pytest.approx(np.array([4.0, 1.0, 9.0]) * 6.0 / 60.0, rel=1e-12)


def test_groups_of_a_mesh_are_bodies_of_different_materials(tmp_path):
    meshio = pytest.importorskip("meshio")
    nodes = np.concatenate([BRICK, BRICK[4:] + [0, 0, 3]]) * 0.1 + 0.2
    cells = np.array([[0, 1, 2, 3, 4, 5, 6, 7], [4, 5, 6, 7, 8, 9, 10, 11]])
    mesh = meshio.Mesh(nodes, [("hexahedron", cells)], cell_sets={"core": [np.array([0])], "rim": [np.array([1])]})
    meshio.write(tmp_path / "two.inp", mesh)
    bodies = [
        {"shape": points(tmp_path / "two.inp", group="core")},
        {"material": "b", "shape": points(tmp_path / "two.inp", group="rim")},
    ]
    tested = Simulation(scene(*bodies, size=(1.0, 1.0, 1.0), materials={"a": RUBBER, "b": STEEL}))
    assert tested.measure()["mass"] == pytest.approx(0.006 * (1000.0 + 8000.0), rel=1e-7)
    material, mass = tested.particles.material, tested.particles.mass
    assert sorted(set(np.round(np.bincount(material.astype(int), mass), 9))) == [6.0, 48.0]


def test_ranks_that_seed_a_part_each_seed_the_whole(table):
    made = scene({"shape": {"type": "box", "min": [0.1, 0.1], "max": [0.2, 0.2]}}, {"shape": points(table[0])})
    geometry, around = grid_geometry(made, scene_needs(made)), seeding.surroundings(made)

    def seeds(first, last):
        return seeding.joined([s for _, s in seeding.seed_planes(made, geometry, 1, first, last, around)], 2)

    whole, parts = seeds(0, geometry.layers), seeding.joined([seeds(0, 4), seeds(4, 6), seeds(6, geometry.layers)], 2)
    assert len(whole.id) == 200
    assert [(whole.id == parts.id).all(), (whole.offset == parts.offset).all(), (whole.share == parts.share).all()] == [
        True
    ] * 3
    body, cell, place = seeding.places_of(made, whole.id)
    assert (body == 1).all()
    assert (cell + place) * 0.1 == pytest.approx(table[1][0][whole.id - whole.id.min()], abs=1e-14)


def test_a_scene_with_particles_reads_back_equal(table):
    made = scene({"shape": points(table[0])})
    assert Scene.from_text(made.to_toml()) == made


BROKEN = {
    "no places": ("a,b\n1,2\n", {}, "must begin with a row of names with x and y"),
    "no numbers": ("x,y\n1,b\n", {}, "cannot be read as .csv: ValueError"),
    "nan": ("x,y\n0.5,nan\n0.4,0.3\n", {}, "has a position that is no finite number, of particle 0 of 2"),
    "volume": ("x,y,volume\n0.5,0.5,1e-4\n0.4,0.3,-1\n", {}, "has a volume of -1, of particle 1; volumes must be > 0"),
    "size": ("x,y,F_xx,F_xy\n0.5,0.5,1,0\n0.4,0.3,1,0\n", {}, "has 2 numbers for F of a particle, not 4"),
    "state": ("x,y,F_0,F_1,F_2,F_3\n0.5,0.5,-1,0,0,1\n0.4,0.3,1,0,0,1\n", {}, "holds no state of neo_hookean for particle 0"),
    "turned": ("x,y,F_0,F_1,F_2,F_3\n0.5,0.5,1,0,0,1\n0.4,0.3,1,0,0,1\n", {"rotate": 1.0}, "turns places and velocities"),
    "field": ("x,y\n0.5,0.5\n0.4,0.3\n", {"fields": ["velocty"]}, "shape.fields[0] = \"velocty\" is not in the file"),
    "outside": ("x,y\n0.5,0.5\n1.4,0.3\n", {}, "reaches out of the domain: from 0.5 to 1.4 m along x"),
    "space": ("x,y,z\n0.5,0.5,0\n0.4,0.3,1\n", {}, "has particles in space, the scene is 2-D"),
}  # fmt: skip


@pytest.mark.parametrize("name", BROKEN)
def test_a_file_that_does_not_fit_is_told(name, tmp_path):
    text, more, message = BROKEN[name]
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(SceneError) as raised:
        scene({"shape": points(tmp_path / "a.csv", **more)})
    assert message in str(raised.value)


def test_particles_are_no_region(table):
    shape = points(table[0])
    with pytest.raises(SceneError, match="can only be the whole shape of a body"):
        scene({"shape": {"type": "union", "of": [shape]}})
    with pytest.raises(SceneError, match=r"loads\[0\].shape.type = .* can only be"):
        scene({"shape": shape}, loads=[{"shape": shape, "force": [1.0, 0.0]}])


def test_a_state_told_twice_is_refused(table):
    with pytest.raises(SceneError, match=r"shape.fields says in which state .* and so does deformation"):
        scene({"shape": points(table[0]), "deformation": [[1.1, 0.0], [0.0, 1.0]]})


@pytest.mark.parametrize("splines", ["linear", "quadratic", "cubic"])
def test_a_particle_on_the_far_wall_belongs_to_the_last_node_inside(splines, tmp_path):
    (tmp_path / "a.csv").write_text("x,y\n1.0,1.0\n0.95,0.95\n")
    made = scene({"shape": points(tmp_path / "a.csv")}, method={"shape_function": splines})
    geometry = grid_geometry(made, scene_needs(made))
    found = [s for _, s in seeding.seed_planes(made, geometry, 0, 0, geometry.layers, seeding.surroundings(made))]
    nodes = seeding.joined(found, 2).node
    assert len(nodes) == 2
    assert (nodes < [geometry.homes(axis) for axis in (0, 1)]).all()
