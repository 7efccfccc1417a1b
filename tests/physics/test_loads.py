"""Cantilevers, colliding blocks, heaps of sand: small sizes of benchmarks/cases."""

import pytest
from cases import blocks, cantilever, pile

# Bisshopp and Drucker (1945): deflection and shortening over L.
ELASTICA = {0.25: (0.08275, 0.00412), 1.0: (0.30172, 0.05643)}


@pytest.mark.parametrize("alpha", ELASTICA)
def test_the_elastica_is_that_of_bisshopp_and_drucker(alpha):
    assert cantilever.elastica(alpha) == pytest.approx(ELASTICA[alpha], abs=6e-6)


def test_two_equal_blocks_collide_without_momentum():
    found = blocks.collided()
    assert found["first"] == 0.0
    assert found["momentum"] < 1e-13  # of sum m |v|; measured 3e-16
    assert found["centre"] < 1e-13
    assert found["contact"] < 0.9  # they have met


@pytest.mark.parametrize(("slope", "flows"), [(28.0, False), (36.0, True)])
def test_a_heap_stays_below_its_angle_of_friction_and_flows_above(slope, flows):
    *_, way, _ = pile.settled(slope, 20, 0.25)
    assert (way > 2.0 * pile.STAYS) == flows
    assert (way < pile.STAYS) == (not flows)
