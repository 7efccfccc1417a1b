"""Rows of the grid are long enough for whatever the kernels read and write of them."""

import pytest

from pmpm.kernels.needs import STENCILS
from pmpm.kernels.places import PADDING
from pmpm.state.grid import Geometry

CELLS = 11


@pytest.mark.parametrize("periodic", [False, True])
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("name", STENCILS)
def test_rows_of_four_nodes_stay_within_a_row_wherever_a_particle_may_be(name, dim, periodic):
    """The farthest is half a cell beyond a wall, or a padding beyond the end of a periodic axis; boxes are taken in fours."""
    stencil = STENCILS[name]
    geometry = Geometry((CELLS,) * dim, (periodic,) * dim, 0.1, (0, 1, 2) if dim == 3 else (0, -1, 1), stencil)
    farthest = CELLS - stencil.round + 63 / 64 if periodic else CELLS + 0.5
    centre = int(farthest + stencil.round)
    first_node = centre - stencil.low + stencil.reach_low
    assert first_node == centre + PADDING
    rounded_up = first_node + 4 + 3  # the end of a box that begins at any node, in steps of four
    assert rounded_up <= geometry.plane_shape[1]
    assert first_node + stencil.nodes <= geometry.plane_shape[0] or dim == 2
