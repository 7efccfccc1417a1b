"""Singular value and polar decomposition: against numpy, in units of the precision's eps, special matrices and lanes.

Convention: F = U diag(s) V^T with rotations U and V; s falls in magnitude, and only the last may be below zero.
"""

import functools
import itertools
import math

import numpy as np
import pytest
from flat import WORDS, flat, full

from pmpm.kernels import targets
from pmpm.kernels.lane_loops import FIELD_TUPLES, put
from pmpm.physics import tensors2 as la

DIMS = (2, 3)
REALS = (np.float32, np.float64)
COUNT = 1000
on_each = [pytest.mark.parametrize("real", REALS), pytest.mark.parametrize("dim", DIMS)]


def on_each_case(test):
    for mark in on_each:
        test = mark(test)
    return test


def entries(F, real):
    """Matrices (n, dim, dim) as the flat tuple of arrays that the physics takes."""
    return tuple(np.ascontiguousarray(column, real) for column in F.reshape(len(F), -1).T)


def matrices(A):
    """A flat tuple of arrays as float64 matrices (n, dim, dim)."""
    dim = math.isqrt(len(A))
    return np.stack(A, -1).astype(float).reshape(-1, dim, dim)


def decompose(F, real):
    """(U, s, V, R, F as rounded) in float64, computed in `real` by the array target."""
    given, la, target = entries(F, real), WORDS[F.shape[1]], targets.arrays(real)
    with np.errstate(all="ignore"):
        U, s, V = target.compile(la.svd)(given)
        R = target.compile(la.polar)(given)
    assert all(values.dtype == real for values in (*U, *s, *V, *R))
    return matrices(U), np.stack(s, -1).astype(float), matrices(V), matrices(R), matrices(given)


def transposed(A):
    return A.transpose(0, 2, 1)


def random_rotations(random, dim, count=COUNT):
    Q, R = np.linalg.qr(random.normal(size=(count, dim, dim)))
    Q = Q * np.sign(np.einsum("nii->ni", R))[:, None, :]
    Q[:, :, 0] *= np.sign(np.linalg.det(Q))[:, None]
    return Q


def of_singular_values(random, s):
    return (random_rotations(random, len(s)) * np.asarray(s)) @ transposed(random_rotations(random, len(s)))


GAPS = {
    "equal": (1.0, 1.0, 1.0),
    "first two equal": (1.0, 1.0, 0.3),
    "last two equal": (1.0, 0.3, 0.3),
    "gap of 1e-8": (1.0, 1.0 - 1e-8, 1.0 - 2e-8),
    "gap of 1e-16": (1.0, 1.0 - 1e-16, 1.0 - 2e-16),
    "turned inside out": (2.0, 1.0, -0.5),
    "a reflection": (1.0, 1.0, -1.0),
    "rank 1": (1.0, 0.0, 0.0),
    "rank 2": (1.0, 0.5, 0.0),
    "graded": (1.0, 1e-8, 1e-16),
    "condition 1e6": (1e3, 1.0, 1e-3),
}
SPECIAL = (
    "zero", "the identity", "minus the identity", "diagonal", "graded and diagonal", "vanishing", "nilpotent", "permutations",
    "entries -1, 0, 1", "near the identity", "near a rotation",
)  # fmt: skip
KINDS = (*SPECIAL, *GAPS)


@functools.cache
def kind_of_matrices(kind, dim):
    """(n, dim, dim) in float64."""
    random = np.random.default_rng(1)
    one, shift = np.eye(dim), np.eye(dim, k=1)
    if kind in GAPS:
        values = GAPS[kind] if dim == 3 else (GAPS[kind][0], GAPS[kind][-1])
        return of_singular_values(random, values)
    return {
        "zero": np.zeros((1, dim, dim)),
        "the identity": one[None],
        "minus the identity": -one[None],
        "diagonal": np.stack([np.diag(s) for s in itertools.product((1.0, -1.0, 2.0, -0.25, 0.0), repeat=dim)]),
        "graded and diagonal": np.stack([np.diag(s) for s in itertools.permutations((1.0, -1e-8, 1e-16)[:dim])]),
        # Columns whose squares underflow beside one whose square does not.
        "vanishing": np.stack(
            [
                (one + 0.3 * shift.T) * s
                for tiny in (1e-30, 1e-200)
                for s in itertools.permutations((1.0, -tiny, 0.1 * tiny)[:dim])
            ]
        ),
        "nilpotent": np.stack([shift, shift.T, shift + 3.0 * shift @ shift, 1e-9 * shift]),
        "permutations": np.stack([one[list(order)] for order in itertools.permutations(range(dim))]),
        "entries -1, 0, 1": np.array(list(itertools.product((-1.0, 0.0, 1.0), repeat=dim * dim))).reshape(-1, dim, dim),
        "near the identity": one + 1e-3 * random.normal(size=(COUNT, dim, dim)),
        "near a rotation": random_rotations(random, dim) + 1e-9 * random.normal(size=(COUNT, dim, dim)),
    }[kind]


def check(F, real, least=0.0):
    """That F decomposes as promised, in units of eps; `least`: the spacing of the smallest numbers."""
    U, s, V, R, F = decompose(F, real)
    eps, dim = float(np.finfo(real).eps), F.shape[1]
    one, size = np.eye(dim), np.abs(F).max(axis=(1, 2))
    for Q in (U, V):
        assert np.abs(transposed(Q) @ Q - one).max() <= 10.0 * eps
        assert (np.linalg.det(Q) > 0.0).all()
    # Beside the switch to svd, R is a sum of terms three times its size.
    assert np.abs(transposed(R) @ R - one).max() <= 30.0 * eps
    assert (np.linalg.det(R) > 0.0).all()
    assert (s[:, :-1] >= np.abs(s[:, 1:])).all()
    room = eps * size + least
    assert (np.abs((U * s[:, None, :]) @ transposed(V) - F).max(axis=(1, 2)) <= 20.0 * room).all()
    stretch = transposed(R) @ F
    assert (np.abs(stretch - transposed(stretch)).max(axis=(1, 2)) <= 40.0 * room).all()
    trace = np.trace(stretch, axis1=1, axis2=2)
    assert (np.abs(trace - s.sum(axis=1)) <= 60.0 * room).all()  # no rotation has a larger one: R is the nearest
    expected = np.linalg.svd(F)[1]
    expected[:, -1] = np.copysign(expected[:, -1], s[:, -1])
    assert (np.abs(s - expected).max(axis=1) <= 20.0 * (eps * expected[:, 0] + least)).all()
    told = np.abs(expected[:, -1]) > 20.0 * (eps * expected[:, 0] + least)
    unit = F[told] / size[told, None, None]  # numpy's own determinant does not know subnormal numbers
    assert (np.sign(s[told, -1]) == np.linalg.slogdet(unit)[0]).all()


# ---- against numpy ------------------------------------------------------------------------------------------------------


@on_each_case
def test_a_million_random_matrices_decompose_as_promised(dim, real):
    random = np.random.default_rng(2)
    for _ in range(10):
        check(random.normal(size=(100_000, dim, dim)), real)


@pytest.mark.parametrize("kind", KINDS)
@on_each_case
def test_special_matrices_decompose_as_promised(dim, real, kind):
    check(kind_of_matrices(kind, dim), real)


@pytest.mark.parametrize(
    ("real", "scale"),
    [(np.float64, 1e20), (np.float64, 1e150), (np.float64, 1e300), (np.float32, 1e18), (np.float32, 1e35)],
)
@pytest.mark.parametrize("dim", DIMS)
def test_scale_does_not_matter_where_squares_overflow_or_underflow(dim, real, scale):
    random = np.random.default_rng(3)
    F = np.concatenate(
        [random.normal(size=(COUNT, dim, dim)), kind_of_matrices("graded", dim), kind_of_matrices("rank 2", dim)]
    )
    check(scale * F, real, float(np.finfo(real).smallest_subnormal))
    check(F / scale, real, float(np.finfo(real).smallest_subnormal))


@on_each_case
def test_subnormal_matrices_lose_only_what_they_have_lost(dim, real):
    least = float(np.finfo(real).smallest_subnormal)
    for size in (1.0, 2.0, 10.0, 1000.0):
        check(size * least * np.random.default_rng(4).uniform(-1.0, 1.0, (COUNT, dim, dim)), real, least)


@on_each_case
def test_small_singular_values_of_graded_diagonal_matrices_keep_their_digits(dim, real):
    values = np.array([1.0, 1e-8, 1e-16][:dim])
    for order in itertools.permutations(range(dim)):
        _, s, _, _, _ = decompose(np.diag(values[list(order)])[None], real)
        assert (
            np.abs(s[0] - values.astype(real)).max() == 0.0
            or np.abs(s[0] / values - 1.0).max() < 4.0 * np.finfo(real).eps
        )


@pytest.mark.parametrize("dim", DIMS)
def test_simple_matrices_decompose_exactly(dim):
    la, one = WORDS[dim], np.eye(dim)
    for size in (0.0, 1.0, 3.0, 49.0):
        U, s, V = la.svd(flat(size * one))
        assert s == (size,) * dim
        assert (full(U) == one).all()
        assert (full(V) == one).all()
    reflection = np.diag([1.0] * (dim - 1) + [-1.0])
    assert la.svd(flat(reflection))[1] == (1.0,) * (dim - 1) + (-1.0,)
    assert la.svd(flat(-one))[1] == (1.0,) * (dim - 1) + ((-1.0) ** dim,)
    assert (full(la.polar(flat(one))) == one).all()


# ---- polar decomposition ------------------------------------------------------------------------------------------------


@on_each_case
def test_both_ways_to_the_rotation_agree_where_they_meet(dim, real):
    """To 12 eps, over 400 000 matrices, of which more than a third take the quick way and differ at all."""
    random, la, target = np.random.default_rng(5), WORDS[dim], targets.arrays(real)
    quick = 0
    for spread in (0.2, 0.4, 0.7, 1.0):
        given = entries(np.eye(dim) + spread * random.normal(size=(100_000, dim, dim)), real)
        with np.errstate(all="ignore"):
            R, careful = matrices(target.compile(la.polar)(given)), matrices(target.compile(la.polar_by_svd)(given))
        apart = np.abs(R - careful).max(axis=(1, 2))
        assert apart.max() <= 12.0 * np.finfo(real).eps
        quick += (apart > 0.0).sum()
    assert quick > 120_000


@on_each_case
def test_the_rotation_of_a_rotation_is_itself(dim, real):
    _, _, _, R, F = decompose(random_rotations(np.random.default_rng(6), dim, 100_000), real)
    assert np.abs(R - F).max() <= 5.0 * np.finfo(real).eps


@on_each_case
def test_the_rotation_goes_on_evenly_through_singular_and_inverted_matrices(dim, real):
    """diag(1, 0.5, t) between fixed rotations: the same R for t from 0.4 to -0.4, also next to 0."""
    random = np.random.default_rng(7)
    eps = float(np.finfo(real).eps)
    t = np.concatenate([np.linspace(-0.4, 0.4, 201), 10.0 ** -np.arange(1.0, 40.0), -(10.0 ** -np.arange(1.0, 40.0))])
    A, B = random_rotations(random, dim, 1)[0], random_rotations(random, dim, 1)[0]
    s = np.stack([np.ones_like(t), np.full_like(t, 0.5), t][-dim:], -1)
    U, _, V, R, _ = decompose((A * s[:, None, :]) @ B.T, real)
    # The round-off of F turns R by eps / (s_i + s_j), at most eps / 0.1.
    assert np.abs(R - A @ B.T).max() <= 30.0 * eps
    assert np.abs(U @ transposed(V) - A @ B.T).max() <= 30.0 * eps


# ---- what is no number --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@on_each_case
def test_a_matrix_that_is_not_finite_gives_nan_throughout(dim, real, bad):
    F = np.random.default_rng(8).normal(size=(dim * dim + 1, dim, dim))
    F.reshape(len(F), -1)[range(dim * dim), range(dim * dim)] = bad
    given, la, target = entries(F, real), WORDS[dim], targets.arrays(real)
    with np.errstate(all="ignore"):
        U, s, V = target.compile(la.svd)(given)
        R = target.compile(la.polar)(given)
    results = np.stack((*U, *s, *V, *R))
    assert np.isnan(results[:, :-1]).all()
    assert np.isfinite(results[:, -1]).all()


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("dim", DIMS)
def test_plain_python_raises_no_error_for_numbers_that_are_not_finite(dim, bad):
    for place in range(dim * dim):
        F = [1.0] * (dim * dim)
        F[place] = bad
        U, s, V = WORDS[dim].svd(tuple(F))
        assert np.isnan((*U, *s, *V, *WORDS[dim].polar(tuple(F)))).all()


# ---- lanes --------------------------------------------------------------------------------------------------------------

load_tensor = SIZE = None


def decompose_blocks(values, out):
    for k in range(len(values) // (16 * SIZE)):
        F = load_tensor(values, 16 * SIZE * k)
        U, s, V = la.svd(F)
        results = U + s + V + la.polar(F)
        put(out, 16 * len(results) * k, results)


@functools.cache
def compiled(dim, real):
    size = dim * dim
    return targets.lanes(real, la=WORDS[dim], load_tensor=FIELD_TUPLES[size], SIZE=size).compile(decompose_blocks)


def on_lanes(F, real):
    """Rows U, s, V, R of matrices (n, dim, dim), n a multiple of 16."""
    dim = F.shape[1]
    rows = np.ascontiguousarray(F.reshape(-1, 16, dim * dim).swapaxes(1, 2), real).reshape(-1)
    out = np.zeros(len(F) * (3 * dim * dim + dim), real)
    compiled(dim, real)(rows, out)
    return out.reshape(-1, 3 * dim * dim + dim, 16).swapaxes(1, 2).reshape(len(F), -1)


def mixed_matrices(dim):
    """Blocks in which quick and careful ways, early and late ends of the sweeps meet."""
    kinds = [kind_of_matrices(kind, dim) for kind in KINDS]
    every = np.concatenate([F[:: max(len(F) // 20, 1)][:20] for F in kinds])
    every = np.concatenate([every, np.random.default_rng(9).normal(size=(200, dim, dim))])
    return np.random.default_rng(10).permutation(every)[: len(every) // 16 * 16]


@on_each_case
def test_lanes_decompose_as_arrays_do(dim, real):
    F = mixed_matrices(dim)
    rows, eps = on_lanes(F, real).astype(float), float(np.finfo(real).eps)
    size = dim * dim
    U, s, V, R = (
        rows[:, :size],
        rows[:, size : size + dim],
        rows[:, size + dim : 2 * size + dim],
        rows[:, 2 * size + dim :],
    )
    U, V, R = (A.reshape(-1, dim, dim) for A in (U, V, R))
    _, expected, _, rotation, F = decompose(F, real)
    largest = np.maximum(expected[:, :1], np.finfo(real).tiny)
    for Q in (U, V):
        assert np.abs(transposed(Q) @ Q - np.eye(dim)).max() <= 10.0 * eps
    assert np.abs((s - expected) / largest).max() <= 20.0 * eps
    assert (np.abs((U * s[:, None, :]) @ transposed(V) - F).max(axis=(1, 2)) <= 20.0 * eps * largest[:, 0]).all()
    steady = (expected[:, -2] + expected[:, -1]) > 0.2 * largest[:, 0]  # elsewhere R follows the round-off of F
    assert np.abs(R - rotation)[steady].max() <= 20.0 * eps


@on_each_case
def test_a_matrix_on_lanes_gives_the_same_bits_whatever_its_neighbours(dim, real):
    F = mixed_matrices(dim)
    before = on_lanes(F, real)
    order = np.random.default_rng(11).permutation(len(F))
    np.testing.assert_array_equal(on_lanes(F[order], real), before[order])
    alone = np.repeat(F, 16, axis=0)
    np.testing.assert_array_equal(on_lanes(alone, real)[::16], before)
    for neighbour in (0.0, math.nan):
        kept = np.arange(len(F)) % 16 == np.arange(len(F)) // 16 % 16
        beside = np.where(kept[:, None, None], F, neighbour)
        np.testing.assert_array_equal(on_lanes(beside, real)[kept], before[kept])
