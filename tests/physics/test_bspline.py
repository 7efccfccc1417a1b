"""B-spline weights: the properties that transfers rely on (Steffen et al. 2008; Jiang et al. 2015 for the inertia)."""

import numpy as np
import pytest
from numpy.polynomial import Polynomial

from pmpm.kernels.needs import STENCILS

SPLINES = list(STENCILS.values())
PLACED = [(spline, g) for spline in SPLINES for g in np.linspace(-spline.round, 1.0 - spline.round, 41)]
IDS = [f"{spline.nodes} nodes, {g:.3f}" for spline, g in PLACED]


@pytest.mark.parametrize(("spline", "g"), PLACED, ids=IDS)
def test_weights_sum_to_one_and_none_is_negative(spline, g):
    w = spline.weights(g)
    assert len(w) == spline.nodes
    assert abs(sum(w) - 1.0) < 1e-15
    assert min(w) >= 0.0


@pytest.mark.parametrize(("spline", "g"), PLACED, ids=IDS)
def test_weighted_nodes_average_to_the_particle(spline, g):
    assert abs(np.dot(spline.weights(g), spline.offsets) - g) < 1e-15


@pytest.mark.parametrize(("spline", "g"), PLACED, ids=IDS)
def test_inertia_of_the_stencil_does_not_depend_on_the_particle_but_for_linear_splines(spline, g):
    inertia = np.dot(spline.weights(g), (np.array(spline.offsets) - g) ** 2)
    if spline is STENCILS["linear"]:
        assert abs(inertia - g * (1.0 - g)) < 1e-15
    else:
        assert abs(inertia * spline.inertia - 1.0) < 1e-14


@pytest.mark.parametrize("spline", SPLINES, ids=list(STENCILS))
def test_slopes_are_the_derivative_of_the_weights(spline):
    """As polynomials, coefficient by coefficient. A node's shape function grows where the particle moves."""
    g = Polynomial([0.0, 1.0])
    for weight, slope in zip(spline.weights(g), spline.slopes(g), strict=True):
        assert np.abs((weight.deriv() - slope).coef).max() < 1e-15


@pytest.mark.parametrize(("spline", "g"), PLACED, ids=IDS)
def test_slopes_give_the_gradient_of_a_linear_field_exactly(spline, g):
    slopes = spline.slopes(g)
    assert abs(sum(slopes)) < 1e-15
    assert abs(np.dot(slopes, spline.offsets) - 1.0) < 2e-15


@pytest.mark.parametrize("name", STENCILS)
@pytest.mark.parametrize("function", ["weights", "slopes"])
def test_they_are_continuous_where_the_stencil_moves_on_by_a_node_but_for_slopes_of_linear_splines(name, function):
    spline = STENCILS[name]
    left, right = (np.array(getattr(spline, function)(g)) for g in (1.0 - spline.round, -spline.round))
    jump = np.abs(np.append(left, 0.0) - np.append(0.0, right)).max()
    assert jump == (2.0 if (name, function) == ("linear", "slopes") else pytest.approx(0.0, abs=1e-15))
