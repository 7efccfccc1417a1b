"""The workloads of benchmarks/kernels.py ask the same of pmpm as of the codes beside it."""

import numpy as np
import pytest
import workloads
from flat import flat_symmetric, in_dimension, symmetric

from pmpm.physics.materials import drucker_prager, fluid

KEYS = {
    "density": workloads.DENSITY,
    "youngs_modulus": workloads.YOUNGS_MODULUS,
    "poisson_ratio": workloads.POISSON_RATIO,
    "friction_angle": workloads.FRICTION_ANGLE,
}


def test_the_constants_written_into_the_peers_are_those_of_the_laws():
    expected = workloads.MU, workloads.LAM, workloads.SLOPE
    assert drucker_prager.parameters(KEYS, 3) == pytest.approx(expected, rel=1e-14)


def test_sand_starts_where_the_return_map_changes_nothing():
    start = workloads.start(workloads.Workload("W2", cells=8))
    advance = in_dimension(drucker_prager.advance, 3, VOLUME_CORRECTION=True)
    params = drucker_prager.parameters(KEYS, 3)
    assert 0.2 < np.mean(start.v_c > 0.0) < 0.8  # both at the tip and on the cone
    for strain, v_c in zip(start.strain, start.v_c, strict=True):
        *advanced, kept = advance((*flat_symmetric(strain), float(v_c)), (0.0,) * 9, 1.0, params)
        assert symmetric(tuple(advanced)) == pytest.approx(strain, abs=1e-14)
        assert kept == pytest.approx(v_c, abs=1e-14)


def test_the_water_of_the_peers_is_tait_with_exponent_one():
    stress = in_dimension(fluid.kirchhoff_stress, 3)
    for J in (0.9, 0.99, 1.0, 1.01):
        peers = min(workloads.BULK_MODULUS * (J - 1.0), 0.0)
        assert stress((J,), (workloads.BULK_MODULUS, 1.0, 0.0))[0] == pytest.approx(peers, abs=1e-10)


@pytest.mark.parametrize("dim", [2, 3])
def test_the_fast_block_stays_below_the_limit_of_motion(dim):
    workload = workloads.Workload("W1", cells=8, dim=dim)
    cells = np.linalg.norm(workloads.start(workload, fast=True).v, axis=1) * workloads.STEP / workload.cell_size
    assert cells.max() == pytest.approx(workloads.FAST, rel=1e-6)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_longer_workload_is_one_block_after_the_other(dim):
    """Twice the particles at the same density: half of them in either half, by the law of large numbers."""
    one, two = (workloads.Workload("W3", cells=8, dim=dim, length=length) for length in (1, 2))
    start = workloads.start(two)
    middle = (two.first_cell + two.block_cells) * two.cell_size
    assert len(start.x) == two.particles == 2 * one.particles
    assert np.mean(start.x[:, 0] < middle) == pytest.approx(0.5, abs=3.0 * 0.5 / np.sqrt(two.particles))
    assert one.domain_shape == (one.domain_cells,) * dim
    assert two.domain_shape[0] - two.block_shape[0] == one.domain_shape[0] - one.block_shape[0]
