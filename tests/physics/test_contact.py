"""Contact between velocity fields: momentum is exchanged, bodies meet where their surfaces do, Coulomb holds."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

import pmpm
from pmpm.explain import explain
from pmpm.kernels import targets
from pmpm.physics import contact, tensors2, tensors3
from pmpm.scene.contact import Contact

RUBBER = {"model": "neo_hookean", "density": 1000.0, "youngs_modulus": 1e6, "poisson_ratio": 0.3}
STIFF = {"model": "neo_hookean", "density": 2000.0, "youngs_modulus": 1e7, "poisson_ratio": 0.3}
SAND = {
    "model": "drucker_prager",
    "density": 1600.0,
    "youngs_modulus": 2e6,
    "poisson_ratio": 0.3,
    "friction_angle": 30.0,
}
G = 10.0


def simulation(bodies, friction=0.0, gravity=(0.0, 0.0), size=(2.0, 1.0), cell_size=0.05, end=1.0, walls=(), **tables):
    """Bodies (material, shape, velocity, more keys), each of a material of its own."""
    scene = pmpm.Scene(
        domain={"size": list(size), "cell_size": cell_size, "gravity": list(gravity), "walls": dict(walls)},
        time={"end": end},
        materials={f"m{n}": body[0] for n, body in enumerate(bodies)},
        bodies=[
            {"material": f"m{n}", "shape": shape, "velocity": list(velocity)} | (more[0] if more else {})
            for n, (_, shape, velocity, *more) in enumerate(bodies)
        ],
        contact={"friction": friction},
        **tables,
    )
    return pmpm.Simulation(scene)


def box(low, high):
    return {"type": "box", "min": list(low), "max": list(high)}


def ball(center, radius):
    return {"type": "sphere", "center": list(center), "radius": radius}


def of_body(s, number):
    """Mean position and velocity, and mass, of one body's particles."""
    p = s.particles
    here = p.material == number
    return SimpleNamespace(x=p.x[here].mean(axis=0), v=p.v[here].mean(axis=0), all_x=p.x[here], all_v=p.v[here])


# ---- the rule on a node -------------------------------------------------------------------------------------------------


@pytest.fixture(params=[2, 3])
def rule(request):
    """The compiled rule, of one dimension: (normal_between, momentum_gained, dim)."""
    dim = request.param
    target = targets.plain(la=tensors2 if dim == 2 else tensors3)
    return target.compile(contact.normal_between), target.compile(contact.momentum_gained), dim


def drawn(dim, seed):
    rng = np.random.default_rng(seed)
    n = rng.normal(size=dim)
    masses = 10.0 ** rng.uniform(-12, 3, 2)
    return (n / np.linalg.norm(n), *masses, *(mass * rng.normal(size=dim) for mass in masses))


@pytest.mark.parametrize("seed", range(20))
def test_bodies_approach_no_more_and_lose_at_most_coulombs_part_along_the_surface(rule, seed):
    _, gained, dim = rule
    n, mass_a, mass_b, a, b = drawn(dim, seed)
    friction = 0.3
    change = np.array(gained(tuple(a), mass_a, tuple(b), mass_b, tuple(n), friction))
    reduced = mass_a * mass_b / (mass_a + mass_b)
    closing = a / mass_a - b / mass_b
    normal, slip = closing @ n, closing - (closing @ n) * n
    if normal <= 0.0:
        assert np.abs(change).max() < 1e-12 * reduced
        return
    assert change @ n == pytest.approx(-reduced * normal, rel=1e-9)
    along = change - (change @ n) * n
    assert along == pytest.approx(
        -reduced * slip * min(1.0, friction * normal / np.linalg.norm(slip)), rel=1e-6, abs=1e-9 * reduced
    )


@pytest.mark.parametrize("seed", range(5))
def test_it_is_the_same_whichever_body_is_asked_first(rule, seed):
    between, gained, dim = rule
    n, mass_a, mass_b, a, b = drawn(dim, seed)
    one = np.array(gained(tuple(a), mass_a, tuple(b), mass_b, tuple(n), 0.4))
    other = np.array(gained(tuple(b), mass_b, tuple(a), mass_a, tuple(-n), 0.4))
    assert one == pytest.approx(-other, rel=1e-9, abs=1e-9 * min(mass_a, mass_b))
    assert np.array(between(tuple(a), tuple(b))) == pytest.approx(-np.array(between(tuple(b), tuple(a))))


def test_without_gradients_there_is_no_direction_and_nothing_happens(rule):
    between, gained, dim = rule
    n = between((0.5,) * dim, (0.5,) * dim)
    assert n == (0.0,) * dim
    assert gained((1.0,) * dim, 1.0, (-1.0,) * dim, 1.0, n, 0.5) == (0.0,) * dim


# ---- where bodies meet --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("shape_function", ["quadratic", "cubic", "linear"])
@pytest.mark.parametrize("offset", [0.0, 0.3])
def test_bodies_meet_where_their_surfaces_do(shape_function, offset):
    """Two blocks that approach change nothing of each other while there is a gap, though they share nodes; offsets are of the
    surface from a node, in cells."""
    dx = 0.05

    def speed_lost(gap):
        moved = [{"displacement": [(offset + gap) * dx, 0.0]} for gap in (0.0, gap)]
        bodies = [(RUBBER, box([0.25, 0.25], [1.0, 0.75]), [0.0, 0.0], moved[0]),
                  (RUBBER, box([1.0, 0.25], [1.75, 0.75]), [-1.0, 0.0], moved[1])]  # fmt: skip
        s = simulation(bodies, method={"shape_function": shape_function})
        s.step()
        return np.abs(of_body(s, 0).all_v).max()

    assert speed_lost(0.01) == 0.0
    assert speed_lost(0.0) > 0.01


def test_what_approaches_stops_at_the_surface_and_not_before():
    """A block falls onto another: beneath it the two surfaces are as far apart as their particles are from them."""
    bodies = [(STIFF, box([0.0, 0.0], [2.0, 0.3]), [0.0, 0.0]), (RUBBER, box([0.5, 0.42], [1.0, 0.8]), [0.0, -0.5])]
    s = simulation(bodies, gravity=(0.0, -G), end=1.5, walls={"y_min": "stick"}, method={"damping": 8.0})
    s.run()
    above, below = of_body(s, 1), of_body(s, 0)
    middle = np.abs(above.all_x[:, 0] - 0.75) < 0.15
    beneath = np.abs(below.all_x[:, 0] - 0.75) < 0.15
    gap = above.all_x[middle][:, 1].min() - below.all_x[beneath][:, 1].max()
    assert gap / 0.05 == pytest.approx(0.5, abs=0.02)  # half a cell: two quarters; measured 0.498
    assert np.abs(above.v).max() < 1e-2


def test_beside_a_wall_bodies_meet_as_anywhere_else():
    """A block that reaches from wall to wall is pushed into another: all of the surface pushes alike."""
    walls = {"y_min": "slip", "y_max": "slip"}
    bodies = [(RUBBER, box([0.2, 0.0], [1.0, 0.5]), [1.0, 0.0]), (RUBBER, box([1.0, 0.0], [1.8, 0.5]), [0.0, 0.0])]
    s = simulation(bodies, size=(2.0, 0.5), end=0.004, walls=walls)
    s.run()
    hit = of_body(s, 1)
    column = hit.all_x[:, 0] < 1.05
    assert hit.all_v[column, 0].min() > 0.3
    assert np.ptp(hit.all_v[column][:, 0].reshape(2, -1), axis=1).max() < 1e-9
    assert np.abs(hit.all_v[:, 1]).max() < 1e-9


# ---- momentum, friction, energy -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("transfer", ["apic", "mls", "flip"])
def test_what_one_body_loses_the_other_gains(transfer):
    bodies = [(RUBBER, ball([0.7, 0.5], 0.2), [2.0, 0.3]), (STIFF, ball([1.3, 0.55], 0.2), [-2.0, 0.0])]
    s = simulation(bodies, friction=0.3, end=0.2, method={"transfer": transfer}, walls=dict.fromkeys(
        ("x_min", "x_max", "y_min", "y_max"), "free"))  # fmt: skip
    before = s.measure()
    s.run()
    after = s.measure()
    assert np.abs(momentum_of(after) - momentum_of(before)).max() < 1e-12 * 2.0 * before["mass"]
    assert of_body(s, 0).v[0] < -1.0  # it has bounced
    assert free_energy(after) < free_energy(before)


def momentum_of(measured):
    return np.array([measured[f"momentum_{axis}"] for axis in "xy"])


def free_energy(measured):
    return measured["kinetic"] + measured["strain"]


def test_a_sliding_block_stops_where_coulomb_says():
    """v^2 / (2 mu g) on a level base, whatever the block's own deformation."""
    mu, v = 0.4, 1.2
    bodies = [(STIFF, box([0.0, 0.0], [2.0, 0.3]), [0.0, 0.0]), (RUBBER, box([0.2, 0.3], [0.7, 0.6]), [v, 0.0])]
    s = simulation(bodies, mu, (0.0, -G), end=0.4, walls={"y_min": "stick"})
    start = of_body(s, 1).x[0]
    s.run()
    assert of_body(s, 1).x[0] - start == pytest.approx(v**2 / (2 * mu * G), rel=0.005)  # measured 0.1 %
    assert abs(of_body(s, 1).v[0]) < 0.03 * v  # what is left shakes


@pytest.mark.parametrize(("mu", "slope"), [(0.3, 30.0), (0.3, 10.0), (0.0, 20.0)])
def test_on_an_incline_a_block_slides_or_stays(mu, slope):
    """g (sin - mu cos) beyond the angle of friction, nothing below it."""
    angle = math.radians(slope)
    bodies = [(STIFF, box([0.0, 0.0], [2.0, 0.3]), [0.0, 0.0]), (RUBBER, box([0.2, 0.3], [0.7, 0.6]), [0.0, 0.0])]
    s = simulation(bodies, mu, (G * math.sin(angle), -G * math.cos(angle)), end=0.4, walls={
        "y_min": "stick", "x_min": "stick", "x_max": "stick"})  # fmt: skip
    start = of_body(s, 1).x[0]
    s.run()
    pull = max(G * (math.sin(angle) - mu * math.cos(angle)), 0.0)
    free = 0.5 * G * math.sin(angle) * s.time**2
    assert of_body(s, 1).x[0] - start == pytest.approx(
        0.5 * pull * s.time**2, abs=0.01 * free
    )  # measured 0.7, 0.7, 0.1 %


def test_materials_that_are_together_are_bonded():
    """Of three blocks side by side the first two stay one when the third slides off."""
    angle = math.radians(40.0)
    floor = (STIFF, box([0.0, 0.0], [2.0, 0.3]), [0.0, 0.0])
    left = (RUBBER, box([0.2, 0.3], [0.5, 0.6]), [0.0, 0.0])
    right = (RUBBER, box([0.5, 0.3], [0.8, 0.6]), [0.0, 0.0])
    scene = pmpm.Scene(
        domain={"size": [2.0, 1.0], "cell_size": 0.05, "gravity": [G * math.sin(angle), -G * math.cos(angle)],
                "walls": {"y_min": "stick", "x_min": "stick", "x_max": "stick"}},
        time={"end": 0.3},
        materials={f"m{n}": body[0] for n, body in enumerate((floor, left, right))},
        bodies=[{"material": f"m{n}", "shape": body[1]} for n, body in enumerate((floor, left, right))],
        contact={"together": [["m0", "m1"]], "pairs": [{"materials": ["m2", "m1"], "friction": 0.1}]},
    )  # fmt: skip
    s = pmpm.Simulation(scene)
    s.run()
    assert of_body(s, 1).v[0] < 0.05
    assert of_body(s, 2).v[0] == pytest.approx(G * s.time * (math.sin(angle) - 0.1 * math.cos(angle)), rel=0.02)


def test_friction_told_of_a_material_holds_for_all_that_are_bonded_to_it():
    """Also where no body is of the material that is named."""
    told = Contact(friction=0.1, together=[["sand", "clay"]], pairs=[{"materials": ["steel", "clay"], "friction": 0.5}])
    fields = told.velocity_fields(("sand", "steel", "wood"))
    assert fields == {"sand": 0, "steel": 1, "wood": 2}
    assert told.frictions(fields) == {(0, 1): 0.5, (0, 2): 0.1, (1, 2): 0.1}


def test_check_tells_who_is_bonded_to_whom():
    tables = {f"m{n}": RUBBER for n in range(3)}
    bodies = [{"material": name, "shape": ball([0.2 + 0.3 * n, 0.5], 0.1)} for n, name in enumerate(tables)]
    scene = pmpm.Scene(domain={"size": [1.0, 1.0], "cell_size": 0.05}, time={"end": 1.0}, materials=tables, bodies=bodies,
                       contact={"together": [["m2", "m0"]]})  # fmt: skip
    assert "contact       between m0 with m2 and m1" in explain(scene, 1).splitlines()
    assert not [
        line for line in explain(scene.model_copy(update={"contact": None}), 1).splitlines() if "between" in line
    ]


@pytest.mark.parametrize(("heavy", "light"), [(1e5, 1.0), (1e3, 1e3)])
@pytest.mark.parametrize(("hard", "soft"), [(1e9, 1e5), (1e6, 1e6)])
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_extreme_pairs_stay_bounded(heavy, light, hard, soft, precision):
    """A heavy hard ball hits a light soft block against a wall: no energy comes out of nothing, nobody is lost."""
    ball_of = RUBBER | {"density": heavy, "youngs_modulus": hard}
    block_of = RUBBER | {"density": light, "youngs_modulus": soft}
    wave = math.sqrt(max(hard / heavy, soft / light))
    bodies = [
        (ball_of, ball([0.4, 0.5], 0.15), [0.05 * wave, 0.0]),
        (block_of, box([0.6, 0.2], [1.0, 0.8]), [0.0, 0.0]),
    ]
    s = simulation(bodies, 0.5, size=(1.0, 1.0), end=4.0 / wave, method={"precision": precision})
    before = free_energy(s.measure())
    for _ in range(300):
        s.step()
        if s.finished:
            break
    assert free_energy(s.measure()) < before  # measured 0.99997 of it at most
    assert np.isfinite(s.particles.x).all()


@pytest.mark.parametrize("cell", [1e-10, 1e3])
def test_contact_knows_no_length_of_its_own(cell):
    """Blocks of any size part alike, in float32 too, whose smallest numbers are not far from the momenta of small cells."""
    bounced = []
    for scale in (cell, 0.05):
        bodies = [(RUBBER, box(*(np.array([[2, 3], [6, 7]]) * scale)), [2.0, 0.3]),
                  (RUBBER, box(*(np.array([[6, 3], [10, 7]]) * scale)), [-1.0, 0.0])]  # fmt: skip
        size = (12 * scale, 10 * scale)
        s = simulation(bodies, 0.3, size=size, cell_size=scale, end=0.5 * scale, method={"precision": "float32"})
        s.run()
        bounced.append(np.array([of_body(s, number).v for number in (0, 1)]))
    assert bounced[0] == pytest.approx(bounced[1], abs=1e-3)
    assert bounced[0][0, 0] < bounced[0][1, 0]


def test_sand_on_a_plate_that_rises_moves_with_it():
    """A motion meets every velocity field; it imposes its velocity on the plate alone, for there is no sand in its region."""
    bodies = [(STIFF, box([0.0, 0.1], [0.4, 0.3]), [0.0, 0.0]), (SAND, box([0.0, 0.3], [0.4, 0.5]), [0.0, 0.0])]
    told = {"motions": [{"shape": box([0.0, 0.1], [0.4, 0.2]), "velocity": [0.0, 0.2]}]}
    s = simulation(bodies, 0.5, (0.0, -G), size=(0.4, 1.0), end=0.3, **told)
    s.run()
    sand, plate = of_body(s, 1), of_body(s, 0)
    assert sand.x[1] - 0.4 == pytest.approx(plate.x[1] - 0.2, abs=0.1 * 0.05)
    assert sand.all_x[:, 1].min() - plate.all_x[:, 1].max() == pytest.approx(0.025, abs=0.1 * 0.05)


# ---- what it costs where nobody asks for it ---------------------------------------------------------------------------------


def test_a_scene_without_contact_has_one_velocity_field_and_none_of_its_kernels():
    scene = pmpm.Scene(
        domain={"size": [1.0, 1.0], "cell_size": 0.1},
        time={"end": 1.0},
        materials={"a": RUBBER, "b": STIFF},
        bodies=[{"material": name, "shape": ball([x, 0.5], 0.2)} for name, x in zip("ab", (0.3, 0.7), strict=True)],
    )
    s = pmpm.Simulation(scene)
    s.step()
    assert s.patch.fields == 1
    assert s.patch.volumes is s.patch.nodes
    assert s.kernels.p2g_volumes == ()
    assert not s.kernels.touch.signatures
    assert "contact" not in scene.to_toml()
