"""Places at the ends of the domain: a little beyond walls, and around periodic axes."""

import numpy as np
import pytest

import pmpm

DX = 0.1


@pytest.mark.parametrize("shape", ["quadratic", "cubic"])
@pytest.mark.parametrize("end", [0, 1])
def test_a_regroup_keeps_particles_a_little_beyond_the_ends_of_the_domain(shape, end):
    """The slab axis is the one whose homes count layers: a home beyond them would be nobody's."""
    size = [1.2, 0.8]
    simulation = pmpm.Simulation(
        pmpm.Scene(
            domain={"size": size, "cell_size": DX},
            method={"shape_function": shape},
            time={"end": 1.0},
            materials={"water": {"model": "fluid", "density": 1000.0, "sound_speed": 10.0}},
            bodies=[{"material": "water", "shape": {"type": "box", "min": [0.0, 0.0], "max": size}}],
        )
    )
    before = simulation.particles.x
    ids = simulation.particles.id
    population, places = simulation.populations[0], simulation.needs.places
    shift = places.from_cells(0.7) * (1 if end else -1)  # the outermost lie a quarter of a cell inside
    population.places[:, :2] += shift
    moved = simulation.particles.x
    assert np.abs(moved - before - (0.7 if end else -0.7) * DX).max() < 1e-14
    simulation.regroup()
    order, as_before = np.argsort(simulation.particles.id), np.argsort(ids)
    assert (simulation.particles.x[order] == moved[as_before]).all()
    simulation.lay_out()
    simulation.scatter(0.0, "p2g")
    assert simulation.patch.nodes[0, :, 3].sum() == pytest.approx(simulation.measure()["mass"], rel=1e-12)


def water(size, low, high, periodic, precision="float64", velocity=(0.0, 0.0)):
    return pmpm.Simulation(
        pmpm.Scene(
            domain={"size": size, "cell_size": DX, "periodic": periodic},
            method={"precision": precision},
            time={"end": 1.0},
            materials={"water": {"model": "fluid", "density": 1000.0, "sound_speed": 10.0}},
            bodies=[
                {
                    "material": "water",
                    "shape": {"type": "box", "min": low, "max": high},
                    "velocity": velocity,
                    "particles_per_cell": 1,
                }
            ],
        )
    )


@pytest.mark.parametrize("far", [0.0, 1.0, -3.0, 1000.0], ids=["inside", "next", "before", "far"])
def test_assigned_positions_are_taken_around_periodic_axes(far):
    """Also those in the last half cell, whose nearest node is the first one again."""
    size = np.array([2.0, 1.0])
    simulation = water(size.tolist(), [0.0, 0.0], size.tolist(), ["x", "y"])
    ids, x = simulation.particles.id, (simulation.particles.x + [0.48 * DX, 0.48 * DX]) % size
    simulation.particles.x = x + far * size
    assert simulation.rows() == 200
    order, before = np.argsort(simulation.particles.id), np.argsort(ids)
    apart = (simulation.particles.x[order] - x[before]) / size
    assert np.abs(apart - np.rint(apart)).max() < 1e-12 * (1.0 + abs(far))
    simulation.step()
    assert simulation.measure()["mass"] == pytest.approx(1000.0 * size.prod(), rel=1e-12)


@pytest.mark.parametrize("loops", ["lanes", "scalar"])
def test_a_wide_periodic_axis_is_no_reason_to_sort(loops, monkeypatch):
    """In float32 places 220 cells apart have no difference that fits into their integers."""
    monkeypatch.setenv("PMPM_LOOPS", loops)
    simulation = water([20.0, 19.9], [1.0, 1.0], [1.4, 18.9], ["y"], "float32", velocity=(0.0, 0.01))
    for _ in range(15):
        simulation.step()
    assert simulation.regroups == 0


def beside_a_wall(shape, face, across, twin):
    """(positions, velocities, F) after 5 steps of a body that has passed a slip wall by 0.45 cells; with `twin` there is no
    wall, but the body's mirror image."""
    axis, at_max = "xy".index(face[0]), face.endswith("max")
    length, inside = (2.4 if twin else 1.2), (-1.0 if at_max else 1.0)
    wall = 1.2 if twin or at_max else 0.0

    def along(first, second):
        return [first, second] if axis == 0 else [second, first]

    def box(side):
        low, high = sorted((wall, wall + side * 0.6))
        shape = {"type": "box", "min": along(low, 0.2), "max": along(high, 0.6)}
        return {"material": "rubber", "shape": shape, "particles_per_cell": 4}

    simulation = pmpm.Simulation(
        pmpm.Scene(
            domain={"size": along(length, across), "cell_size": DX, "walls": {} if twin else {face: "slip"}},
            method={"shape_function": shape},
            time={"end": 1.0, "step": 0.004},
            materials={
                "rubber": {"model": "neo_hookean", "density": 1000.0, "youngs_modulus": 1e4, "poisson_ratio": 0.3}
            },
            bodies=[box(inside), box(-inside)] if twin else [box(inside)],
        )
    )
    x = simulation.particles.x
    own = inside * (x[:, axis] - wall) > 0.0
    ids = np.sort(simulation.particles.id[own])
    if twin:
        x[:, axis] -= np.where(own, 0.7, -0.7) * inside * DX  # the first row of particles lies at a quarter of a cell
        simulation.particles.x = x
    else:
        simulation.populations[0].places[:, axis] -= int(inside) * simulation.needs.places.from_cells(0.7)
        simulation.regroup()
    x = simulation.particles.x
    depth = inside * (x[:, axis] - wall)
    v = np.zeros_like(x)
    v[:, axis] = -0.3 * inside * np.sin(2.0 * depth)
    v[:, 1 - axis] = 0.2 * np.cos(3.0 * depth) * np.sin(5.0 * x[:, 1 - axis])
    simulation.particles.v = v
    simulation.run(steps=5)
    order = np.argsort(simulation.particles.id)
    order = order[np.isin(simulation.particles.id[order], ids)]
    assert (inside * (simulation.particles.x[order, axis] - wall)).min() < -0.4 * DX
    x = simulation.particles.x[order]
    x[:, axis] -= wall
    return x, simulation.particles.v[order], simulation.particles.F[order]


@pytest.mark.parametrize("across", [0.8, 1.6], ids=["across slabs", "along slabs"])
@pytest.mark.parametrize("face", ["x_min", "x_max", "y_max"])
@pytest.mark.parametrize("shape", ["linear", "quadratic", "cubic"])
def test_what_has_passed_a_slip_wall_a_little_meets_its_mirror_image(shape, face, across):
    """Cubic splines reach a second node beyond the wall then."""
    walled, twinned = (beside_a_wall(shape, face, across, twin) for twin in (False, True))
    for name, one, two in zip(("x", "v", "F"), walled, twinned, strict=True):
        assert np.abs(one - two).max() < 1e-13, name


@pytest.mark.parametrize("shape", ["linear", "quadratic", "cubic"])
def test_next_to_no_mass_beside_an_edge_is_not_thrown_back(shape):
    """Where another wall has mirrored the nodes on this one and inside of it, and let go of the one beyond, next to
    nothing is there, of any velocity. A linear spline reaches beyond a wall without the inner node: it is mirrored."""
    simulation = pmpm.Simulation(
        pmpm.Scene(
            domain={"size": [1.2, 1.2], "cell_size": DX, "walls": {"y_min": "slip"}},
            method={"shape_function": shape},
            time={"end": 1.0},
            materials={"water": {"model": "fluid", "density": 1000.0, "sound_speed": 10.0}},
            bodies=[{"material": "water", "shape": {"type": "sphere", "center": [0.6, 0.6], "radius": 0.2}}],
        )
    )
    met, nodes = np.arange(1 + 2 * simulation.needs.stencil.beyond)[None], np.zeros((8, 4))
    _, beyond, inside, *_ = met[0]
    nodes[beyond] = 0.0, -1e-8, 0.0, 1e-12
    simulation.kernels.walls["slip"](nodes, met, 0, 1, np.array([0.0, 1.0]), 0.0, np.zeros(2))
    assert not nodes[beyond].any()
    assert nodes[inside].any() == (shape == "linear")
