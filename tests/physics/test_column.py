"""A column under its own weight comes to rest where the static solution is: cases and gates of benchmarks/cases/column.py."""

import numpy as np
import pytest
from cases import column

# Of an independent integration of the laws' energies, to seven digits.
HEIGHTS = {
    ("STIFF", "neo_hookean"): 9.651447,
    ("STIFF", "fixed_corotated"): 9.635629,
    ("STIFF", "hencky"): 9.659863,
    ("SOFT", "neo_hookean"): 4.259399,
    ("SOFT", "fixed_corotated"): 4.089071,
    ("SOFT", "hencky"): 4.316717,
    ("SEVERE", "neo_hookean"): 16.169594,
    ("SEVERE", "hencky"): 24.059646,
}


@pytest.mark.parametrize(("name", "model"), HEIGHTS)
def test_the_exact_height_is_that_of_an_independent_integration(name, model):
    assert getattr(column, name)[model].height == pytest.approx(HEIGHTS[name, model], abs=2e-6)


def test_no_stretch_carries_more_than_a_fixed_corotated_solid_can():
    assert np.isnan(column.SEVERE["fixed_corotated"].height)


@pytest.mark.parametrize("shape_function", ["quadratic", "cubic"])
def test_a_column_settles_under_its_weight_by_what_theory_says(shape_function):
    # Linear splines do not: particles cross cells on the way, and the column breaks up or is off by 17 %.
    found = column.settled(column.STIFF["neo_hookean"], 16, shape_function=shape_function)
    assert abs(found["height"]) < 2e-4  # measured 3e-5 and 9e-5
    assert found["e_y"] < 1e-3  # measured 7e-4 and 6e-4


@pytest.mark.parametrize("model", column.SOLIDS)
def test_a_column_that_shrinks_by_a_seventh_has_its_height(model):
    found = column.settled(column.SOFT[model], 16)
    assert abs(found["height"]) < 2e-3  # measured 4e-4 to 5e-4
    assert found["e_y"] < 4e-3  # measured 1.4e-3 to 1.5e-3
    assert found["kinetic"] < 1e-12


def test_cubic_splines_find_the_stress_of_a_column_better():
    # The quadrature of internal forces is more exact for smoother splines: measured 0.8 % against 2.8 %.
    plain, smooth = (
        column.settled(column.SOFT["neo_hookean"], 16, shape_function=shape) for shape in ("quadratic", "cubic")
    )
    assert smooth["stress"] < 0.5 * plain["stress"]


def test_heights_and_stresses_converge_while_particles_stay_in_their_cells():
    coarse, fine = (column.settled(column.FAINT, cells) for cells in (16, 32))
    assert np.log2(coarse["e_y"] / fine["e_y"]) > 1.7  # measured 2.05
    assert np.log2(coarse["stress"] / fine["stress"]) > 1.0  # measured 1.5


def test_the_static_solution_stays():
    found = column.settled(column.SOFT["neo_hookean"], 16, from_rest=True)
    assert found["e_y"] < 4e-3  # measured 1.2e-3


def test_water_at_rest_has_the_pressure_of_what_lies_above():
    found = column.settled(column.WATER, 16)
    assert found["stress"] < 0.01  # measured 0.5 %
    assert found["kinetic"] < 1e-6


def test_a_column_without_equilibrium_collapses_to_numbers_and_the_run_says_so():
    lowest, speed, finite, told = column.collapsed(column.SEVERE["fixed_corotated"], 16)
    assert finite
    assert told
    assert lowest < 0.01  # measured 0.001
    assert speed < 1e-6
