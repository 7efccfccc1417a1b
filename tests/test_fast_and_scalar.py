"""The fast kernels compute what the readable ones do: after some steps they are apart by the growth of round-off alone.

Every pair of values of material, dimension, shape function, transfer and precision is in some row here;
tests/by_hand/fast_and_scalar_all.py runs all combinations, tests/mpi/test_fast_and_scalar_mpi.py several ranks.
"""

import itertools

import fast_and_scalar as agreement
import numpy as np
import pytest

from pmpm.physics.materials import LAWS
from pmpm.scene.schema import Method


@pytest.mark.parametrize("row", agreement.PAIRS + agreement.SINGLE, ids=agreement.label)
def test_fast_and_scalar_kernels_agree_to_round_off_after_some_steps(row):
    scene = agreement.scene(row)
    fast, scalar = (agreement.run(scene, loops) for loops in ("lanes", "scalar"))
    apart = agreement.distances(fast, scalar)
    assert {name: distance for name, distance in apart.items() if not distance <= agreement.BOUND} == {}
    # It would be cheap to agree at rest, or for two simulations of one kind.
    assert apart["v"] > 0.0
    if row["shape_function"] != "linear":
        assert np.ptp(fast.particles.J) > 0.02
        assert fast.regroups > 0


@pytest.mark.parametrize(("dim", "precision"), [(2, "float32"), (3, "float64")])
def test_fast_and_scalar_kernels_agree_where_bodies_touch(dim, precision):
    row = {"material": "several", "dim": dim, **agreement.PLAIN, "precision": precision}
    scene = agreement.in_contact(row)
    fast, scalar, bonded = (agreement.run(*run) for run in (
        (scene, "lanes"), (scene, "scalar"), (agreement.scene(row), "lanes")))  # fmt: skip
    assert max(agreement.distances(fast, scalar).values()) <= agreement.BOUND
    assert agreement.distances(fast, bonded)["v"] > 1e3 * agreement.BOUND  # they have touched


def test_rows_hold_every_pair_of_values_that_is_allowed():
    possible = agreement.every_pair.full_product(agreement.FACTORS, agreement.allowed)
    for one, other in itertools.combinations(agreement.FACTORS, 2):
        assert {(row[one], row[other]) for row in agreement.PAIRS} == {(row[one], row[other]) for row in possible}


def test_rows_cut_slabs_and_repeat_along_all_axes():
    for dim, arrangements in agreement.ARRANGEMENTS.items():
        met = {agreement.arrangement(row) for row in agreement.PAIRS + agreement.SINGLE if row["dim"] == dim}
        assert met == set(arrangements)


def test_every_built_in_law_and_every_switch_of_it_is_in_a_material():
    materials = [table for tables in agreement.MATERIALS.values() for table in tables]
    for name, law in LAWS.items():
        own = [table for table in materials if table["model"] == name]
        assert own, name
        for key in law.KEYS:
            if isinstance(key.default, bool):
                assert {table.get(key.name, key.default) for table in own} == {True, False}, key.name


def test_every_material_is_in_a_row():
    assert {row["material"] for row in agreement.PAIRS + agreement.SINGLE} == set(agreement.MATERIALS)


def test_every_key_of_the_method_that_has_a_choice_is_a_factor():
    numbers = {"flip_blend", "damping"}
    assert set(agreement.METHOD) == set(Method.model_fields) - {"integrator"} - numbers
    assert agreement.built_words("integrator") == ["explicit"]
