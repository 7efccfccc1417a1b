"""Where particles are put in a body, and what each stands for: a lattice, random or spread places, shares of cut cells."""

import math

import meshes
import numpy as np
import pytest

from pmpm.scene import seeding
from pmpm.scene.needs import grid_geometry, scene_needs
from pmpm.scene.schema import Scene
from pmpm.simulation import Simulation

RUBBER = {"model": "neo_hookean", "density": 1000.0, "youngs_modulus": 1e4, "poisson_ratio": 0.3}
PUBLIC = ("torus", "icosahedron", "superquadric", "cone", "trefoil", "torus, damaged")


def scene(*shapes, size=(1.0, 1.0), kind="quadrature", **more):
    bodies = [{"material": "a", "shape": shape, "seeding": kind} for shape in shapes]
    return Scene(
        **{
            "domain": {"size": list(size), "cell_size": 0.05, "gravity": [0.0] * (len(size) - 1) + [-1.0]},
            "time": {"end": 1.0},
            "materials": {"a": RUBBER},
            "bodies": bodies,
        }
        | more
    )


def seeds_of(scene, number=0, first=0, last=None):
    geometry, around = grid_geometry(scene, scene_needs(scene)), seeding.surroundings(scene)
    last = geometry.layers if last is None else last
    found = seeding.seed_planes(scene, geometry, number, first, last, around)
    return seeding.joined([seeds for _, seeds in found], scene.dim)


DISK = {"type": "sphere", "center": [0.41, 0.53], "radius": 0.3}
BALL = {"type": "sphere", "center": [0.41, 0.53, 0.5], "radius": 0.3}


# ---- quadrature --------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    pytest.importorskip("vtk")
    return meshes.public_meshes(tmp_path_factory.mktemp("meshes"))


@pytest.mark.parametrize("name", PUBLIC)
def test_particles_have_volume_centroid_and_inertia_of_a_public_mesh_to_a_thousandth(name, files):
    made = meshes.scene_of(files[name], 18, "quadrature")
    volume, centroid, inertia = meshes.misses(made, meshes.seeded(made))
    assert volume < 1e-3
    assert centroid < 1e-3
    assert inertia < 1e-3


@pytest.mark.parametrize(("shape", "exact"), [(DISK, math.pi * 0.09), (BALL, 4.0 / 3.0 * math.pi * 0.027)])
def test_shares_sum_to_the_volume_of_a_ball(shape, exact):
    made = scene(shape, size=(1.0,) * len(shape["center"]))
    volume, centroid, _ = meshes.moments(made, seeds_of(made))
    assert volume == pytest.approx(exact, rel=5e-4)
    assert centroid == pytest.approx(shape["center"], abs=1e-4)


def test_particles_of_cells_that_nothing_cuts_are_those_of_the_lattice():
    whole, lattice = (seeds_of(scene(DISK, kind=kind)) for kind in ("quadrature", "lattice"))
    inner = whole.share == 1.0
    same = np.isin(lattice.id, whole.id[inner])
    assert inner.sum() > 300
    assert (np.sort(whole.id[inner]) == np.sort(lattice.id[same])).all()
    order = np.argsort(whole.id[inner]), np.argsort(lattice.id[same])
    assert (whole.offset[inner][order[0]] == lattice.offset[same][order[1]]).all()


def test_bodies_that_overlap_share_cells_without_a_gap():
    other = DISK | {"center": [0.6, 0.5]}
    made = scene(DISK, other)
    parts = [meshes.moments(made, seeds_of(made, number))[0] for number in (0, 1)]
    union = scene({"type": "union", "of": [DISK, other]})
    assert sum(parts) == pytest.approx(meshes.moments(union, seeds_of(union))[0], rel=1e-3)


@pytest.mark.parametrize("kind", seeding.SEEDINGS)
def test_ranks_that_seed_a_part_each_seed_the_whole(kind):
    made = scene(BALL, size=(1.0, 1.0, 1.0), kind=kind)
    whole = seeds_of(made)
    parts = seeding.joined([seeds_of(made, 0, a, b) for a, b in ((0, 6), (6, 11), (11, 13), (13, 21))], 3)
    one, other = np.argsort(whole.id), np.argsort(parts.id)
    assert (whole.id[one] == parts.id[other]).all()
    assert (whole.offset[one] == parts.offset[other]).all()
    assert (whole.share is None) == (kind != "quadrature")
    if kind == "quadrature":
        assert (whole.share[one] == parts.share[other]).all()


@pytest.mark.parametrize("kind", seeding.SEEDINGS)
def test_ids_tell_where_particles_came_from(kind):
    made = scene(DISK, kind=kind)
    seeds = seeds_of(made)
    _, cell, place = seeding.places_of(made, seeds.id)
    assert cell + place == pytest.approx(seeds.node + seeds.offset, abs=1e-12)


# ---- spread places -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("count", "dim"), [(4, 2), (8, 3), (5, 2)])
def test_no_two_particles_of_a_poisson_disk_seeding_are_close(count, dim):
    """Spacing 1 is that of a lattice of as many; random places come as close as 0.02."""
    cells = np.stack(np.meshgrid(*[np.arange(8 if dim == 2 else 5)] * dim, indexing="ij"), -1).reshape(-1, dim)
    body = scene(DISK, kind="poisson_disk").bodies[0].model_copy(update={"particles_per_cell": count})
    places = (cells[:, None, :] + seeding.places_in_cells(body, 0, cells)).reshape(-1, dim)
    apart = np.linalg.norm(places[:, None, :] - places, axis=2)
    np.fill_diagonal(apart, np.inf)
    assert apart.min() * count ** (1.0 / dim) > 0.4


def test_a_poisson_disk_seeding_has_as_many_in_each_cell_and_no_rows():
    tile = seeding.spread_tile(4, 2)
    assert tile.shape == (16, 16, 4, 2)
    assert ((tile >= 0.0) & (tile < 1.0)).all()
    assert len(np.unique(tile[..., 0])) == tile[..., 0].size


# ---- in a run ----------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def cut():
    return Simulation(scene(DISK))


def test_mass_is_that_of_the_shares(cut):
    assert cut.measure()["mass"] == pytest.approx(1000.0 * math.pi * 0.09, rel=5e-4)
    assert cut.particles.mass.sum() == pytest.approx(cut.measure()["mass"], rel=1e-12)
    assert cut.particles.volume0 == pytest.approx(cut.particles.mass / 1000.0)


def test_a_body_of_shares_falls_as_one():
    tested = Simulation(scene(DISK, size=(1.0, 1.0)))
    tested.run(steps=10)
    found = tested.measure()
    assert found["momentum_y"] == pytest.approx(-found["mass"] * tested.time, rel=1e-12)
    assert tested.particles.v[:, 1] == pytest.approx(np.full(tested.rows(), -tested.time), rel=1e-9)
    assert found["strain"] < 1e-12 * found["kinetic"]


def test_a_force_on_shares_is_the_force():
    load = {"shape": DISK, "force": [7.0, 0.0]}
    still = {"size": [1.0, 1.0], "cell_size": 0.05}
    tested = Simulation(scene(DISK, domain=still, loads=[load]))
    tested.run(steps=5)
    assert tested.measure()["momentum_x"] == pytest.approx(7.0 * tested.time, rel=1e-12)


@pytest.mark.parametrize(
    "method", [{}, {"transfer": "mls", "precision": "float32"}, {"transfer": "flip", "f_bar": True}]
)
def test_lanes_and_scalar_loops_agree_on_shares(method, monkeypatch):
    found = {}
    for loops in ("lanes", "scalar"):
        monkeypatch.setenv("PMPM_LOOPS", loops)
        tested = Simulation(scene(DISK | {"center": [0.41, 0.305]}, method=method))
        tested.run(steps=15)
        order = np.argsort(tested.particles.id)
        found[loops] = tested.particles.v[order], tested.measure()
    eps = float(np.finfo(found["lanes"][0].dtype).eps)
    size = np.abs(found["lanes"][0]).max()
    assert np.abs(found["lanes"][0] - found["scalar"][0]).max() < 300 * eps * size
    assert found["lanes"][1]["mass"] == found["scalar"][1]["mass"]
    assert found["lanes"][1]["kinetic"] == pytest.approx(found["scalar"][1]["kinetic"], rel=300 * eps)


def test_energies_that_the_guard_sums_are_those_of_the_shares(cut):
    found, energies = cut.measure(), np.sum(cut.energies(), axis=0)
    assert energies == pytest.approx([found["kinetic"], found["strain"], found["potential"]], rel=1e-9, abs=1e-9)


def test_shares_survive_a_restart_bit_for_bit(tmp_path):
    through = Simulation(scene(DISK))
    through.run(steps=7)
    through.save(tmp_path / "a.hdf")
    through.run(steps=9)
    resumed = Simulation.restart(tmp_path / "a.hdf")
    resumed.run(steps=9)
    assert through.measure() == resumed.measure()
    assert through.particles.share.tobytes() == resumed.particles.share.tobytes()
    assert through.particles.x.tobytes() == resumed.particles.x.tobytes()
