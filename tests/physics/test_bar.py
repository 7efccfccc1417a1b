"""A bar that rings and a wave that is filtered: what transfers take from motion; scenes stand in benchmarks/cases/bar.py."""

import math

import pytest
from cases import bar


@pytest.mark.parametrize("spline", ["quadratic", "cubic"])
def test_pic_takes_from_a_wave_what_the_second_moment_of_its_spline_says(spline):
    # exp(-D k^2) in each step, D = dx^2 / 4 or dx^2 / 3; the next term of the filter is (k dx)^4, 3e-4 at 32 cells.
    assert bar.lost(bar.wave(32, "pic", spline)) == pytest.approx(bar.law(32, spline), rel=1e-3)


@pytest.mark.parametrize("transfer", ["apic", "mls", "flip"])
def test_other_transfers_take_fifty_times_less_from_a_wave(transfer):
    # Measured: a 269th with an affine field, nothing by FLIP.
    assert 50.0 * bar.lost(bar.wave(32, transfer)) < bar.law(32, "quadratic")


def test_pic_takes_half_as_much_from_a_bar_that_rings():
    # Its velocity is filtered, its displacement is not.
    found = bar.ring(bar.ringing(26, 2.0, "pic"))
    expected = 0.5 * found.steps_per_period * bar.D["quadratic"] * (bar.FIXED * bar.LENGTH / 26) ** 2
    assert -math.log(1.0 - found.decay) == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("transfer", ["apic", "mls", "flip"])
def test_a_bar_rings_on(transfer):
    found = bar.ring(bar.ringing(26, 4.0, transfer))
    assert abs(found.frequency) < 0.002  # measured 0.05 % (apic), 0.1 % (flip)
    assert abs(found.decay) < 0.001
