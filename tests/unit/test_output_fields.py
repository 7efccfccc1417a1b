"""Fields that follow from what particles carry: strains, volume, displacement."""

import numpy as np
import pytest

import pmpm

SOLID = {"density": 1e3, "youngs_modulus": 1e6, "poisson_ratio": 0.25}
METAL = SOLID | {"model": "von_mises", "yield_stress": 1e4, "hardening_modulus": 1e5}
ROCK = SOLID | {
    "model": "mohr_coulomb",
    "cohesion": 1e4,
    "friction_angle": 30.0,
    "residual_cohesion": 0.0,
    "softening_strain": 0.1,
}
NAMES = ["strain", "von_mises_strain", "volume", "J"]


def resting(dim, *materials, **more):
    """A Simulation of one block of each material."""
    names = [str(number) for number in range(len(materials))]
    boxes = [{"type": "box", "min": [2.0 + 3.0 * n] + [2.0] * (dim - 1), "max": [4.0 + 3.0 * n] + [4.0] * (dim - 1)}
             for n in range(len(materials))]  # fmt: skip
    scene = pmpm.Scene(
        **{
            "domain": {"size": [8.0] * dim, "cell_size": 1.0},
            "time": {"end": 1.0},
            "materials": dict(zip(names, materials, strict=True)),
            "bodies": [{"material": name, "shape": box} for name, box in zip(names, boxes, strict=True)],
        }
        | more
    )
    return pmpm.Simulation(scene)


def rotation(dim, angle=0.7):
    turn = np.eye(dim)
    turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return turn


def entries(E):
    """xx yy zz xy yz xz of a (dim, dim) tensor."""
    full = np.zeros((3, 3))
    full[: len(E), : len(E)] = E
    return full[[0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2]]


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("model", ["neo_hookean", "fixed_corotated"])
def test_the_strain_of_a_deformation_is_half_the_logarithm_of_b(model, dim):
    """F = R U S: principal stretches along axes that R turns, whatever S turned before."""
    simulation = resting(dim, SOLID | {"model": model})
    stretches = np.array([1.3, 0.8, 1.1])[:dim]
    R = rotation(dim)
    F = R @ np.diag(stretches) @ rotation(dim, -2.0)
    simulation.particles.F = np.tile(F, (simulation.rows(), 1, 1))
    found = simulation.fields(NAMES)
    E = R @ np.diag(np.log(stretches)) @ R.T
    assert found["strain"] == pytest.approx(np.tile(entries(E), (simulation.rows(), 1)), abs=1e-14)
    full = np.diag([*np.log(stretches), 0.0][:3])
    deviator = full - np.trace(full) / 3.0 * np.eye(3)
    assert found["von_mises_strain"] == pytest.approx(np.sqrt(2.0 / 3.0) * np.linalg.norm(deviator), rel=1e-12)
    assert found["volume"] == pytest.approx(simulation.particles.volume0 * np.prod(stretches), rel=1e-14)


@pytest.mark.parametrize("dim", [2, 3])
def test_the_strain_of_a_law_that_keeps_one_is_the_one_it_keeps(dim):
    simulation = resting(dim, SOLID | {"model": "hencky"}, METAL)
    E = np.array([[0.01, 0.02, 0.05], [0.02, 0.03, 0.06], [0.05, 0.06, 0.04]])
    plane = E[:dim, :dim][np.triu_indices(dim)]
    kept = simulation.particles.hencky_strain
    simulation.particles.hencky_strain = np.where(np.isnan(kept), kept, plane)
    solid = np.append(plane, 0.04) if dim == 2 else plane
    kept = simulation.particles.elastic_strain
    simulation.particles.elastic_strain = np.where(np.isnan(kept), kept, solid)
    found = simulation.fields(["strain", "material"])
    for material, zz in ((0, 0.0 if dim == 2 else 0.04), (1, 0.04)):
        expected = entries(E[:dim, :dim])
        expected[2] = zz
        assert found["strain"][found["material"] == material] == pytest.approx(
            np.tile(expected, (4**dim, 1)), rel=1e-14
        )


def test_a_bar_that_keeps_its_volume_is_strained_by_its_own_logarithm():
    simulation = resting(3, SOLID | {"model": "neo_hookean"})
    F = np.diag([1.2, 1.2**-0.5, 1.2**-0.5])
    simulation.particles.F = np.tile(F, (simulation.rows(), 1, 1))
    assert simulation.fields(NAMES)["von_mises_strain"] == pytest.approx(np.log(1.2), rel=1e-12)


def test_a_liquid_has_a_volume_and_no_strain():
    simulation = resting(2, {"model": "fluid", "density": 1e3, "sound_speed": 10.0})
    simulation.particles.J = np.full(simulation.rows(), 0.9)
    found = simulation.fields(NAMES)
    assert np.isnan(found["strain"]).all()
    assert np.isnan(found["von_mises_strain"]).all()
    assert found["volume"] == pytest.approx(0.9 * 0.25, rel=1e-14)


@pytest.mark.parametrize(("law", "state"), [(METAL, "alpha"), (ROCK, "e_p")])
def test_the_plastic_strain_is_the_one_the_law_accumulates(law, state):
    simulation = resting(2, SOLID | {"model": "neo_hookean"}, law)
    kept = getattr(simulation.particles, state)
    setattr(simulation.particles, state, np.where(np.isnan(kept), kept, 0.07))
    found = simulation.fields(["plastic_strain", "material"])
    assert found["plastic_strain"][found["material"] == 1] == pytest.approx(0.07)
    assert np.isnan(found["plastic_strain"][found["material"] == 0]).all()


def at_rest(X, t):
    return 0.0 * X


def test_the_displacement_is_the_way_from_the_reference_also_across_the_end_of_a_periodic_axis():
    body = {"material": "0", "shape": {"type": "box", "min": [5.0, 2.0], "max": [7.0, 4.0]}, "velocity": [4.0, 0.5]}
    domain = {"size": [8.0, 8.0], "cell_size": 1.0, "periodic": ["x"]}
    simulation = resting(
        2, SOLID | {"model": "neo_hookean"}, domain=domain, bodies=[body], exact={"displacement": at_rest},
        output={"fields": ["displacement"]},
    )  # fmt: skip
    simulation.run(until=0.6)
    assert simulation.particles.x[:, 0].min() < 2.0
    moved = simulation.fields(["displacement"])["displacement"]
    assert moved == pytest.approx(np.tile([4.0 * simulation.time, 0.5 * simulation.time], (len(moved), 1)), rel=1e-9)


def test_vectors_in_a_snapshot_have_three_columns_there_and_two_for_the_reader(tmp_path):
    from pmpm.output.snapshots import write_snapshot

    simulation = resting(2, SOLID | {"model": "neo_hookean"}, exact={"displacement": at_rest})
    names = ["velocity", "displacement", "strain", "volume"]
    write_snapshot(simulation.comm, tmp_path / "0.hdf", simulation, simulation.scene, names, "pwrite")
    from pmpm.output.reader import Snapshot, reading

    snapshot = Snapshot(tmp_path / "0.hdf")
    with reading(snapshot.path) as file:
        assert file["VTKHDF/PointData/displacement"].shape == (16, 3)
        assert file["VTKHDF/PointData/displacement"].attrs["unit"].decode() == "m"
        assert file["VTKHDF/PointData/volume"].attrs["unit"].decode() == "m3"
    assert snapshot.displacement.shape == snapshot.velocity.shape == (16, 2)
    assert snapshot.strain.shape == (16, 6)
