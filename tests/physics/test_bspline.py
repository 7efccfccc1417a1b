"""B-spline weights: the properties that transfers rely on (Steffen et al. 2008; Jiang et al. 2015 for the inertia)."""

import numpy as np
import pytest

from pmpm.physics import bspline

PLACES = np.linspace(-0.5, 0.5, 41)
OFFSETS = np.arange(bspline.NODES_QUADRATIC) - bspline.LOW_QUADRATIC


@pytest.mark.parametrize("g", PLACES)
def test_weights_sum_to_one_and_none_is_negative(g):
    w = bspline.weights_quadratic(g)
    assert abs(sum(w) - 1.0) < 1e-15
    assert min(w) >= 0.0


@pytest.mark.parametrize("g", PLACES)
def test_weighted_nodes_average_to_the_particle(g):
    assert abs(np.dot(bspline.weights_quadratic(g), OFFSETS) - g) < 1e-15


@pytest.mark.parametrize("g", PLACES)
def test_inertia_of_the_stencil_does_not_depend_on_the_particle(g):
    inertia = np.dot(bspline.weights_quadratic(g), (OFFSETS - g) ** 2)
    assert abs(inertia * bspline.INERTIA_QUADRATIC - 1.0) < 1e-14


@pytest.mark.parametrize("g", PLACES)
def test_slopes_are_the_derivative_of_the_weights(g):
    # A node's shape function grows where the particle moves: central differences are exact for a parabola.
    h = 1e-3
    above, below = bspline.weights_quadratic(g + h), bspline.weights_quadratic(g - h)
    difference = (np.array(above) - np.array(below)) / (2.0 * h)
    assert np.abs(bspline.slopes_quadratic(g) - difference).max() < 1e-12


@pytest.mark.parametrize("g", PLACES)
def test_slopes_give_the_gradient_of_a_linear_field_exactly(g):
    slopes = bspline.slopes_quadratic(g)
    assert abs(sum(slopes)) < 1e-15
    assert abs(np.dot(slopes, OFFSETS) - 1.0) < 1e-15


def test_weights_are_continuous_where_the_stencil_moves_on_by_a_node():
    left, right = bspline.weights_quadratic(0.5), bspline.weights_quadratic(-0.5)
    assert (*left, 0.0) == (0.0, *right)
    assert (*bspline.slopes_quadratic(0.5), 0.0) == (0.0, *bspline.slopes_quadratic(-0.5))
