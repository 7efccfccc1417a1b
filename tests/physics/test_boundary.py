"""Wall rules on the momentum of one node: stick p = 0; slip no normal motion; separate may leave, may not enter;
friction separate with Coulomb's law. And the images of a mirror, against its definition."""

import numpy as np
import pytest
from flat import in_dimension, random_rotation

from pmpm.physics import boundary

COEFFICIENT = 0.4
CASES = [(dim, seed) for dim in (2, 3) for seed in range(6)]


def scene_of(dim, seed):
    """(normal into the material, a unit tangent) in a random direction."""
    Q = random_rotation(np.random.default_rng(seed), dim)
    return Q[:, 0], Q[:, 1]


def after(rule, p, n, coefficient=COEFFICIENT, pressed=0.0):
    return np.array(in_dimension(rule, len(p))(tuple(map(float, p)), tuple(map(float, n)), coefficient, pressed))


def image(rule, p, n):
    return np.array(in_dimension(rule, len(p))(tuple(map(float, p)), tuple(map(float, n))))


@pytest.mark.parametrize(("dim", "seed"), CASES)
def test_stick_stops_all_motion(dim, seed):
    n, t = scene_of(dim, seed)
    assert (after(boundary.wall_stick, 3.0 * t + n, n) == 0.0).all()


@pytest.mark.parametrize("normal_speed", [-2.0, 2.0])
@pytest.mark.parametrize(("dim", "seed"), CASES)
def test_slip_removes_normal_motion_either_way_and_no_other(dim, seed, normal_speed):
    n, t = scene_of(dim, seed)
    v = after(boundary.wall_slip, 3.0 * t + normal_speed * n, n)
    assert np.abs(v - 3.0 * t).max() < 1e-14


@pytest.mark.parametrize(("dim", "seed"), CASES)
def test_separate_holds_what_enters_without_friction(dim, seed):
    n, t = scene_of(dim, seed)
    assert np.abs(after(boundary.wall_separate, 3.0 * t - 2.0 * n, n) - 3.0 * t).max() < 1e-14


@pytest.mark.parametrize("rule", [boundary.wall_separate, boundary.wall_friction])
@pytest.mark.parametrize(("dim", "seed"), CASES)
def test_what_leaves_is_not_touched(dim, seed, rule):
    n, t = scene_of(dim, seed)
    v = 3.0 * t + 2.0 * n
    assert np.abs(after(rule, v, n) - v).max() < 1e-14


@pytest.mark.parametrize(("dim", "seed"), CASES)
def test_sliding_loses_the_coefficient_times_the_stopped_speed(dim, seed):
    # Coulomb: the tangential impulse is at most mu times the normal one, against the motion: 3 - 0.4 * 2.
    n, t = scene_of(dim, seed)
    assert np.abs(after(boundary.wall_friction, 3.0 * t - 2.0 * n, n) - 2.2 * t).max() < 1e-14


@pytest.mark.parametrize(("dim", "seed"), CASES)
def test_friction_sticks_within_the_cone(dim, seed):
    n, t = scene_of(dim, seed)
    assert np.abs(after(boundary.wall_friction, 0.79 * t - 2.0 * n, n)).max() < 1e-15


@pytest.mark.parametrize("dim", [2, 3])
def test_friction_without_coefficient_is_separate(dim):
    n, t = scene_of(dim, 7)
    for v in (3.0 * t - 2.0 * n, 3.0 * t + 2.0 * n):
        difference = after(boundary.wall_friction, v, n, 0.0) - after(boundary.wall_separate, v, n)
        assert np.abs(difference).max() < 1e-14


@pytest.mark.parametrize("dim", [2, 3])
def test_friction_on_motion_straight_into_the_wall_stops_it(dim):
    n, _ = scene_of(dim, 8)
    assert np.abs(after(boundary.wall_friction, -2.0 * n, n)).max() < 1e-15


@pytest.mark.parametrize(
    "rule", [getattr(boundary, f"wall_{name}") for name in ("stick", "slip", "separate", "friction")]
)
@pytest.mark.parametrize("dim", [2, 3])
def test_a_node_at_rest_stays_at_rest(dim, rule):
    n, _ = scene_of(dim, 9)
    assert (after(rule, np.zeros(dim), n) == 0.0).all()


@pytest.mark.parametrize(
    "rule", [getattr(boundary, f"wall_{name}") for name in ("stick", "slip", "separate", "friction")]
)
@pytest.mark.parametrize("normal_speed", [-2.0, 2.0])
def test_applying_a_rule_twice_changes_nothing_more(rule, normal_speed):
    n, t = scene_of(3, 10)
    once = after(rule, 3.0 * t + normal_speed * n, n)
    assert np.abs(after(rule, once, n) - once).max() < 1e-14


@pytest.mark.parametrize(("dim", "seed"), CASES)
def test_friction_counts_what_presses_elsewhere(dim, seed):
    # Coulomb on 2 stopped here and 1.5 taken by the mirror: 3 - 0.4 * 3.5.
    n, t = scene_of(dim, seed)
    p = after(boundary.wall_friction, 3.0 * t - 2.0 * n, n, pressed=1.5)
    assert np.abs(p - 1.6 * t).max() < 1e-14


@pytest.mark.parametrize(("dim", "seed"), CASES)
def test_a_mirror_turns_normal_motion_round_and_a_sticking_one_all_motion(dim, seed):
    n, t = scene_of(dim, seed)
    p = 3.0 * t - 2.0 * n
    assert np.abs(image(boundary.image_mirrored, p, n) - 3.0 * t - 2.0 * n).max() < 1e-14
    assert (image(boundary.image_reversed, p, n) == -p).all()


@pytest.mark.parametrize("rule", [boundary.image_mirrored, boundary.image_reversed])
@pytest.mark.parametrize(("dim", "seed"), CASES)
def test_the_image_of_the_image_is_the_thing_itself(dim, seed, rule):
    n, t = scene_of(dim, seed)
    p = 3.0 * t - 2.0 * n
    assert np.abs(image(rule, image(rule, p, n), n) - p).max() < 1e-14


@pytest.mark.parametrize(("dim", "seed"), CASES)
def test_the_mirrors_impulse_is_the_normal_momentum_that_is_missing_afterwards(dim, seed):
    n, t = scene_of(dim, seed)
    beyond, mass_beyond, inner, mass_inner = 0.3 * t - 0.7 * n, 0.2, 2.0 * t + 0.5 * n, 1.1
    v = (inner + image(boundary.image_mirrored, beyond, n)) / (mass_inner + mass_beyond)
    left = mass_inner * v + mass_beyond * image(boundary.image_mirrored, v, n)
    taken = in_dimension(boundary.mirror_impulse, dim)(
        tuple(map(float, beyond)), mass_beyond, tuple(map(float, inner)), mass_inner, tuple(map(float, n))
    )
    assert taken == pytest.approx((beyond + inner - left) @ n, abs=1e-14)
    assert abs((beyond + inner - left) @ t) < 1e-14
