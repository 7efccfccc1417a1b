"""Wall rules on the velocity of one node: stick v = 0; slip no normal motion; separate may leave, may not enter;
friction separate with Coulomb's law."""

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


def after(rule, v, n, coefficient=COEFFICIENT):
    return np.array(in_dimension(rule, len(v))(tuple(map(float, v)), tuple(map(float, n)), coefficient))


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
