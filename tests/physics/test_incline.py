"""A block on an inclined plane with Coulomb friction: cases and gates of benchmarks/cases/incline.py."""

import pytest
from cases import incline

CELLS = 4


@pytest.mark.parametrize(
    ("wall", "coefficient"), [(incline.friction(15.0), incline.COEFFICIENT), ("slip", 0.0), ("separate", 0.0)]
)
def test_a_block_slides_as_coulomb_says(wall, coefficient):
    way, exact, gained, a = incline.slid(wall, CELLS, 0.25, coefficient, speed=1.0)
    assert way == pytest.approx(exact, rel=1e-3)  # measured 4e-4 with friction, dt / t of symplectic Euler without
    assert gained == pytest.approx(a, rel=1e-6)


@pytest.mark.parametrize("wall", [incline.friction(30.0), "stick"])
def test_a_block_that_is_laid_down_stays_where_friction_holds_it(wall):
    later, whole = incline.stuck(wall, CELLS, 0.25)
    assert abs(later) < 1e-3  # cells; measured 8e-5
    assert abs(whole) < 1e-3  # measured 4e-4


def test_the_damping_with_which_a_block_is_laid_down_does_not_hold_it():
    later, _ = incline.stuck(incline.friction(20.0), CELLS, 0.25)
    assert later > 0.01
