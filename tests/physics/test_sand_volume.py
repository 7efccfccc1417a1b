"""Sand that is dilated again and again: the expectation and its gates stand in benchmarks/sand_volume.py, a finer run."""

import numpy as np
import pytest
import sand_volume

CELL_SIZE, CYCLES, SIZE = 0.01, 2, (0.04, 0.1)  # m; a bed of 4 by 10 cells


def heights(corrected):
    """(mean, surface) over the bed's height at the start and after each cycle."""
    return sand_volume.tossed(corrected, CELL_SIZE, CYCLES, lambda line: None, SIZE)[:, :2]


@pytest.fixture(scope="module")
def corrected():
    return heights(True)


@pytest.fixture(scope="module")
def uncorrected():
    return heights(False)


def test_with_volume_correction_sand_that_was_tossed_has_its_volume_again(corrected):
    assert np.abs(corrected / corrected[0] - 1.0).max() < 0.01


def test_without_volume_correction_a_grain_stays_where_it_turned(uncorrected):
    """V^2 / 2g higher at the surface and V^2 / 6g on average, less what landing compresses and the grid smears."""
    gain = sand_volume.TOSS**2 / (2.0 * sand_volume.GRAVITY * SIZE[1])
    for cycle in range(1, CYCLES + 1):
        mean, surface = uncorrected[cycle] - uncorrected[cycle - 1]
        assert surface == pytest.approx(gain, rel=0.15)
        assert mean == pytest.approx(2.0 / 3.0 * gain, rel=0.15)


def test_the_gates_tell_the_two_apart(corrected, uncorrected):
    assert sand_volume.complaints({True: corrected, False: uncorrected}) == []
    assert len(sand_volume.complaints({True: uncorrected, False: corrected})) == 2
