"""Small tensors against numpy and exact rational arithmetic, in units of the precision's eps."""

from fractions import Fraction

import numpy as np
import pytest
from flat import EPS, UPPER, WORDS, flat, flat_symmetric, full, random_rotation, symmetric

from pmpm.kernels import targets

DIMS = (2, 3)
REALS = (np.float32, np.float64)
COUNT = 2000


def matrices(kind, dim, random):
    """(COUNT, dim, dim) symmetric float64 matrices."""
    if kind == "random":
        A = random.normal(size=(COUNT, dim, dim))
        return A + A.transpose(0, 2, 1)
    Q = np.stack([random_rotation(random, dim) for _ in range(COUNT)])
    if kind == "diagonal":
        return np.stack([np.diag(s) for s in random.normal(size=(COUNT, dim))])
    values = {
        "repeated": np.tile([1.0, 1.0, -2.0][:dim], (COUNT, 1)),
        "nearly repeated": 1.0 + 1e-9 * random.normal(size=(COUNT, dim)),
        "graded": np.tile([1.0, 1e-8, 1e-16][:dim], (COUNT, 1)),
        "tiny": 1e-12 * random.normal(size=(COUNT, dim)),
        "rank one": np.tile([1.0, 0.0, 0.0][:dim], (COUNT, 1)),
        "huge": 1e12 * random.normal(size=(COUNT, dim)),
    }[kind]
    return (Q * values[:, None, :]) @ Q.transpose(0, 2, 1)


def eigen(S, real):
    """(Q (n, dim, dim), s (n, dim), S as given) in float64, computed in `real` by the array target."""
    dim = S.shape[1]
    given = tuple(S[:, i, j].astype(real) for i, j in UPPER[dim])
    with np.errstate(all="ignore"):
        Q, s = targets.arrays(real).compile(WORDS[dim].eigen_symmetric)(given)
    assert all(q.dtype == real for q in Q)
    rounded = np.stack([symmetric(row) for row in np.stack(given, -1).astype(float)])
    return np.stack(Q, -1).astype(float).reshape(-1, dim, dim), np.stack(s, -1).astype(float), rounded


KINDS = ("random", "diagonal", "repeated", "nearly repeated", "graded", "tiny", "rank one", "huge")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("dim", DIMS)
def test_eigenvectors_are_a_rotation(dim, real, kind):
    Q, _, _ = eigen(matrices(kind, dim, np.random.default_rng(1)), real)
    assert np.abs(Q.transpose(0, 2, 1) @ Q - np.eye(dim)).max() < 20.0 * np.finfo(real).eps
    assert (np.linalg.det(Q) > 0.0).all()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("dim", DIMS)
def test_eigenvectors_and_values_rebuild_the_matrix(dim, real, kind):
    Q, s, S = eigen(matrices(kind, dim, np.random.default_rng(2)), real)
    error = np.abs((Q * s[:, None, :]) @ Q.transpose(0, 2, 1) - S).max(axis=(1, 2))
    assert (error <= 20.0 * np.finfo(real).eps * np.abs(S).max(axis=(1, 2))).all()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("dim", DIMS)
def test_eigenvalues_are_those_of_numpy(dim, real, kind):
    _, s, S = eigen(matrices(kind, dim, np.random.default_rng(3)), real)
    expected = np.linalg.eigvalsh(S)
    error = np.abs(np.sort(s, axis=1) - expected).max(axis=1)
    assert (error <= 20.0 * np.finfo(real).eps * np.abs(expected).max(axis=1)).all()


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("dim", DIMS)
def test_eigenvalues_of_zero_are_zero(dim, real):
    Q, s, _ = eigen(np.zeros((1, dim, dim)), real)
    assert (s == 0.0).all()
    assert (np.eye(dim) == Q).all()


@pytest.mark.parametrize("dim", DIMS)
def test_eigenvalues_whose_squares_underflow_are_lost_only_in_absolute_size(dim):
    _, s, S = eigen(1e-25 * matrices("random", dim, np.random.default_rng(4)), np.float32)
    assert np.abs(np.sort(s, axis=1) - np.linalg.eigvalsh(S)).max() < 1e-19


def cut(kind, dim, real):
    """(principal values, the matrix with these cut to a middle range, both expected and found) by the array target."""
    S = matrices(kind, dim, np.random.default_rng(5))
    given = tuple(S[:, i, j].astype(real) for i, j in UPPER[dim])
    target, words = targets.arrays(real), WORDS[dim]
    with np.errstate(all="ignore"):
        axes, s = target.compile(words.principal_symmetric)(given)
        low, high = (np.quantile(s, q).astype(real) for q in (0.3, 0.6))
        added = target.compile(words.into_range)(s, low, high)
        result = target.compile(words.add_along)(given, axes, added)
    rounded = np.stack([symmetric(row) for row in np.stack(given, -1).astype(float)])
    values, Q = np.linalg.eigh(rounded)
    expected = (Q * np.clip(values, low, high)[:, None, :]) @ Q.transpose(0, 2, 1)
    found = np.stack([symmetric(row) for row in np.stack(result, -1).astype(float)])
    return values, np.stack(s, -1).astype(float), expected, found


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("dim", DIMS)
def test_principal_values_without_eigenvectors_are_those_of_numpy(dim, real, kind):
    expected, s, _, _ = cut(kind, dim, real)
    error = np.abs(np.sort(s, axis=1) - expected).max(axis=1)
    assert (error <= 20.0 * np.finfo(real).eps * np.abs(expected).max(axis=1)).all()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("dim", DIMS)
def test_principal_values_are_cut_off_without_eigenvectors(dim, real, kind):
    """20 eps of the largest, also where values are equal and their axes mean nothing."""
    values, _, expected, found = cut(kind, dim, real)
    error = np.abs(found - expected).max(axis=(1, 2))
    assert (error <= 20.0 * np.finfo(real).eps * np.abs(values).max(axis=1)).all()


@pytest.mark.parametrize("real", REALS)
def test_principal_values_without_eigenvectors_fall_in_three_dimensions(real):
    for kind in KINDS:
        _, s, _, _ = cut(kind, 3, real)
        assert (np.diff(s, axis=1) <= 0.0).all()


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("dim", DIMS)
def test_adding_nothing_along_the_axes_changes_no_bit(dim, real):
    S = matrices("random", dim, np.random.default_rng(6))
    given = tuple(S[:, i, j].astype(real) for i, j in UPPER[dim])
    target, words = targets.arrays(real), WORDS[dim]
    axes, s = target.compile(words.principal_symmetric)(given)
    result = target.compile(words.add_along)(given, axes, tuple(real(0.0) * value for value in s))
    np.testing.assert_array_equal(np.stack(result), np.stack(given))


def exact_product(A, B):
    return [[sum((a * b for a, b in zip(row, column, strict=True)), Fraction(0)) for column in zip(*B, strict=True)]
            for row in A]  # fmt: skip


def exact_congruence(G, H):
    """(I + G)(I + H)(I + G)^T - I without rounding until the end."""
    dim = len(G)
    one = np.eye(dim)
    B = [[Fraction(one[i, j]) + Fraction(G[i, j]) for j in range(dim)] for i in range(dim)]
    A = [[Fraction(one[i, j]) + Fraction(H[i, j]) for j in range(dim)] for i in range(dim)]
    C = exact_product(exact_product(B, A), [list(row) for row in zip(*B, strict=True)])
    return np.array([[float(C[i][j] - Fraction(one[i, j])) for j in range(dim)] for i in range(dim)])


@pytest.mark.parametrize("size", [1e-14, 1e-7, 0.3])
@pytest.mark.parametrize("dim", DIMS)
def test_congruence_keeps_all_digits_of_small_increments(dim, size):
    random = np.random.default_rng(5)
    for _ in range(20):
        G = size * random.normal(size=(dim, dim))
        H = size * random.normal(size=(dim, dim))
        H = H + H.T
        found = symmetric(WORDS[dim].congruence(flat(G), flat_symmetric(H)))
        assert np.abs(found - exact_congruence(G, H)).max() <= 10.0 * EPS * (np.abs(G).max() + np.abs(H).max())


@pytest.mark.parametrize("dim", DIMS)
def test_row_sum_bound_is_never_below_the_largest_eigenvalue(dim):
    for S in matrices("random", dim, np.random.default_rng(6))[:500]:
        assert WORDS[dim].row_sum_bound(flat_symmetric(S)) >= np.abs(np.linalg.eigvalsh(S)).max() * (1.0 - 4.0 * EPS)


@pytest.mark.parametrize("dim", DIMS)
def test_row_sum_bound_is_the_largest_entry_of_a_diagonal_matrix(dim):
    for S in matrices("diagonal", dim, np.random.default_rng(7))[:100]:
        assert WORDS[dim].row_sum_bound(flat_symmetric(S)) == np.abs(S).max()


def words_and_numpy(la, dim, random):
    """(word, what it gives, what numpy gives) on random arguments."""
    A, B = random.normal(size=(2, dim, dim))
    u, v = random.normal(size=(2, dim))
    S = A + A.T
    a, d = 1.7, -0.3
    fA, fB, fS, fu, fv = flat(A), flat(B), flat_symmetric(S), tuple(map(float, u)), tuple(map(float, v))
    Q = random_rotation(random, dim)
    state = (*fS, 5.0)
    P = A @ A.T + np.eye(dim)
    return {
        "det": (la.det(fA), np.linalg.det(A)),
        "trace": (la.trace(fA), np.trace(A)),
        "scale": (full(la.scale(a, fA)), a * A),
        "scale_vector": (la.scale_vector(a, fu), a * u),
        "add_scaled_vector": (la.add_scaled_vector(fu, a, fv), u + a * v),
        "add_outer": (full(la.add_outer(fA, fu, fv)), A + np.outer(u, v)),
        "apply": (la.apply(fA, fu), A @ u),
        "apply_symmetric": (la.apply_symmetric(fS, fu), S @ u),
        "dot": (la.dot(fu, fv), u @ v),
        "largest_entry": (la.largest_entry(fu), np.abs(u).max()),
        "identity_plus": (full(la.identity_plus(fA)), np.eye(dim) + A),
        "matmul": (full(la.matmul(fA, fB)), A @ B),
        "add": (full(la.add(fA, fB)), A + B),
        "left_cauchy_green": (symmetric(la.left_cauchy_green(fA)), A @ A.T),
        "cofactor": (full(la.cofactor(fA)), np.linalg.det(A) * np.linalg.inv(A).T),
        "norm_squared": (la.norm_squared(fA), np.sum(A * A)),
        "product_symmetric": (symmetric(la.product_symmetric(fA, flat(2.0 * A))), 2.0 * A @ A.T),
        "isotropic": (symmetric(la.isotropic(d)), d * np.eye(dim)),
        "scale_plus_diagonal": (symmetric(la.scale_plus_diagonal(a, fS, d)), a * S + d * np.eye(dim)),
        "trace_symmetric": (la.trace_symmetric(fS), np.trace(S)),
        "det_symmetric": (la.det_symmetric(fS), np.linalg.det(S)),
        "adjugate_symmetric": (symmetric(la.adjugate_symmetric(fS)), np.linalg.det(S) * np.linalg.inv(S)),
        "inverse_symmetric": (symmetric(la.inverse_symmetric(flat_symmetric(P))), np.linalg.inv(P)),
        "product_commuting": (symmetric(la.product_commuting(fS, flat_symmetric(S @ S))), S @ S @ S),
        "polynomial": (
            symmetric(la.polynomial((0.1, -0.2, 0.3, 0.4, 0.5), fS)),
            0.1 * S @ S @ S @ S - 0.2 * S @ S @ S + 0.3 * S @ S + 0.4 * S + 0.5 * np.eye(dim),
        ),
        "where_symmetric": (la.where_symmetric(True, fS, flat_symmetric(P)), fS),
        "where_symmetric, else": (la.where_symmetric(False, fS, flat_symmetric(P)), flat_symmetric(P)),
        "where_tensor": (full(la.where_tensor(True, fA, fB)), A),
        "where_tensor, else": (full(la.where_tensor(False, fA, fB)), B),
        "norm_symmetric": (la.norm_symmetric(fS), np.linalg.norm(S)),
        "spectral": (symmetric(la.spectral(flat(Q), fu)), Q @ np.diag(u) @ Q.T),
        "each": (la.each(np.exp, fu), np.exp(u)),
        "symmetric_part": (la.symmetric_part(state), fS),
        "after_symmetric": (la.after_symmetric(state), 5.0),
    }


@pytest.mark.parametrize("dim", DIMS)
def test_every_word_means_what_numpy_means(dim):
    random = np.random.default_rng(8)
    for _ in range(20):
        for word, (found, expected) in words_and_numpy(WORDS[dim], dim, random).items():
            assert np.abs(np.subtract(found, expected)).max() < 1e-13, word


def test_both_dimensions_have_the_same_words():
    def public(la):
        return {name for name, value in vars(la).items() if callable(value) and value.__module__ == la.__name__}

    parts_of_sweeps = {
        "rotate",
        "jacobi_sweep",
        "orthogonalise",
        "to_length_one",
        "where_vector",
    }
    assert public(WORDS[3]) - public(WORDS[2]) == parts_of_sweeps
    assert public(WORDS[2]) <= public(WORDS[3])


def test_words_of_the_plane_agree_with_space_on_block_matrices():
    two, three = WORDS[2], WORDS[3]
    random = np.random.default_rng(9)

    def block(A):
        B = np.zeros((3, 3))
        B[:2, :2] = A
        return B

    for _ in range(50):
        G, H = random.normal(size=(2, 2, 2))
        S = H + H.T
        plane, space = (
            two.congruence(flat(G), flat_symmetric(S)),
            three.congruence(flat(block(G)), flat_symmetric(block(S))),
        )
        assert np.abs(block(symmetric(plane)) - symmetric(space)).max() < 1e-13
        plane, space = two.left_cauchy_green(flat(G)), three.left_cauchy_green(flat(block(G)))
        assert np.abs(block(symmetric(plane)) - symmetric(space)).max() < 1e-14
        _, s = two.eigen_symmetric(flat_symmetric(S))
        _, t = three.eigen_symmetric(flat_symmetric(block(S)))
        assert np.abs(np.sort([*s, 0.0]) - np.sort(t)).max() < 1e-14 * np.abs(S).max() * 2.0
        assert two.norm_symmetric(flat_symmetric(S)) == pytest.approx(
            three.norm_symmetric(flat_symmetric(block(S))), 1e-15
        )
        assert two.row_sum_bound(flat_symmetric(S)) == three.row_sum_bound(flat_symmetric(block(S)))


@pytest.mark.parametrize("dim", DIMS)
def test_within_is_false_for_nan_in_any_place(dim):
    for place in range(dim):
        u = [0.0] * dim
        u[place] = float("nan")
        assert not WORDS[dim].within(tuple(u), 1.0)
        u[place] = 1.0
        assert WORDS[dim].within(tuple(u), 1.0)
        u[place] = -1.0000001
        assert not WORDS[dim].within(tuple(u), 1.0)
