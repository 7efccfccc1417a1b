"""Trial strain of sand: power series near rest, eigenvalues beyond, each against arithmetic in 28 digits."""

from decimal import Decimal
from functools import cache

import numpy as np
import pytest
from flat import UPPER, WORDS, flat, flat_symmetric, of_eigenvalues, random_rotation, symmetric

from pmpm.kernels import targets
from pmpm.physics import hencky
from pmpm.physics.materials import drucker_prager as sand

DIMS = (2, 3)
REALS = (np.float32, np.float64)
SWITCH = hencky.SWITCH
BOTH = ("trial_strain", "trial_strain_by_eigenvalues")


@cache
def compiled(name, dim, real):
    return targets.scalar(real, la=WORDS[dim]).compile(getattr(hencky if hasattr(hencky, name) else sand, name))


def found(name, real, E, G):
    """The strain by a compiled function, as a float64 matrix."""
    strain = compiled(name, len(E), real)(tuple(map(real, flat_symmetric(E))), tuple(map(real, flat(G))))
    assert all(isinstance(value, (float, real)) for value in strain)
    return symmetric(strain)


def rounded(A, real):
    return np.asarray(A, real).astype(float)


def row_sum(A):
    return np.abs(A).sum(axis=1).max()


def decimals(A):
    return np.vectorize(lambda value: Decimal(float(value)), otypes=[object])(A)


def exp_of_decimals(A):
    total = term = decimals(np.eye(len(A)))
    for n in range(1, 36):
        term = term @ A / n
        total = total + term
    return total


def in_many_digits(E, G):
    """The trial strain L as Decimals: the fixed point of L + (exp(-L) b exp(-L) - I) / 2, from eigenvalues in float64."""
    one = decimals(np.eye(len(E)))
    A = one + decimals(G)
    b = A @ exp_of_decimals(2 * decimals(E)) @ A.T
    L = decimals(of_eigenvalues(b.astype(float), lambda s: 0.5 * np.log(s)))
    for _ in range(12):
        root = exp_of_decimals(-L)
        L = L + (root @ b @ root - one) / 2
    return L


def error(strain, exact):
    return float(np.abs(decimals(strain) - exact).max())


def direction(random, dim, n):
    """A symmetric matrix with row sums up to 1: general, isotropic, uniaxial and shear, of both signs in turn."""
    A = random.normal(size=(dim, dim))
    shear = np.zeros((dim, dim))
    shear[0, 1] = shear[1, 0] = 1.0
    S = (A + A.T, np.eye(dim), np.diag([1.0, 0.0, 0.0][:dim]), shear)[n // 2 % 4] * (-1.0) ** n
    return S / row_sum(S)


def pairs(random, dim, real, size, count=16):
    """(E, G) whose E and trial strain both have row sums of about `size`, rounded to the precision."""
    for n in range(count):
        E = size * direction(random, dim, n)
        yield rounded(E, real), rounded(0.01 * size * random.normal(size=(dim, dim)), real)


def at_the_switch(random, dim, real, count=32):
    """(E, G) a millionth inside the switch, by turns in E, with a motion that takes a little away, and in the result."""
    inside = (1.0 - 1e-6) * SWITCH
    for n in range(count):
        S = inside * direction(random, dim, n // 2)
        if n % 2 == 0:
            yield rounded(S, real), rounded(of_eigenvalues(-0.1 * S, np.expm1), real)
        else:
            stretch = of_eigenvalues(S, lambda s: np.exp(np.arctanh(s)))  # I + G from rest: tanh of the result is S
            yield np.zeros((dim, dim)), rounded(stretch @ random_rotation(random, dim) - np.eye(dim), real)


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("dim", DIMS)
def test_series_and_eigenvalues_agree_at_the_switch(dim, real):
    """A particle that passes the switch must not jump by more than round-off."""
    differ = 0
    for E, G in at_the_switch(np.random.default_rng(1), dim, real):
        tanh_of_result = of_eigenvalues(symmetric(flat_symmetric(in_many_digits(E, G))), np.tanh)
        assert max(row_sum(E), row_sum(tanh_of_result)) == pytest.approx(SWITCH, rel=3e-6)
        series, eigenvalues = (found(name, real, E, G) for name in BOTH)
        assert np.abs(series - eigenvalues).max() < 10.0 * np.finfo(real).eps * SWITCH
        differ += (series != eigenvalues).any()
    assert differ > 16  # of 32: what was compared came from two ways


@pytest.mark.parametrize("size", [1e-7, 1e-5, 1e-3, 0.01, 0.1, 0.2, 0.3, 0.4, 0.49])
@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("dim", DIMS)
def test_series_are_off_by_a_few_eps_of_the_strain(dim, real, size):
    """Three or less were measured; a logarithm of b itself would be off by eps / size."""
    for E, G in pairs(np.random.default_rng(2), dim, real, size):
        assert error(found("trial_strain", real, E, G), in_many_digits(E, G)) < 4.0 * np.finfo(real).eps * size


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("dim", DIMS)
def test_a_rotation_costs_the_series_no_digits_but_those_of_its_own_rounding(dim, real):
    """I + G in the precision is orthogonal to eps, which b inherits, whatever the strain."""
    random = np.random.default_rng(3)
    for E, _ in pairs(random, dim, real, 0.2):
        G = rounded(random_rotation(random, dim) - np.eye(dim), real)
        assert error(found("trial_strain", real, E, G), in_many_digits(E, G)) < 6.0 * np.finfo(real).eps


@pytest.mark.parametrize("size", [0.51, 0.7, 1.0])
@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("dim", DIMS)
def test_beyond_the_switch_eigenvalues_are_as_good(dim, real, size):
    """b holds the small stretches beside the large ones, exp(2 size) apart from 1: so many eps are its own round-off."""
    for E, G in pairs(np.random.default_rng(4), dim, real, size):
        strain = found("trial_strain", real, E, G)
        assert (strain == found("trial_strain_by_eigenvalues", real, E, G)).all()
        assert error(strain, in_many_digits(E, G)) < 4.0 * np.finfo(real).eps * np.exp(2.0 * size) * size


@pytest.mark.parametrize("dim", DIMS)
def test_a_step_from_rest_far_beyond_the_switch_is_its_logarithm(dim):
    """E alone does not tell: here it is zero."""
    for stretch in (0.1, 3.0, 100.0):
        strain = found("trial_strain", np.float64, np.zeros((dim, dim)), (stretch - 1.0) * np.eye(dim))
        assert strain == pytest.approx(np.log(stretch) * np.eye(dim), rel=1e-12)


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("dim", DIMS)
def test_no_motion_is_so_violent_that_it_passes_for_near(dim, real):
    """A large b has an inverse of which round-off or overflow leaves nothing, and the bound that rests on it is small then."""
    random = np.random.default_rng(6)
    for size in np.geomspace(10.0, 1e12, 60):
        E, G = 0.1 * direction(random, dim, 0), size * random.normal(size=(dim, dim))
        np.testing.assert_array_equal(*(found(name, real, E, G) for name in BOTH))


def laws(dim, real):
    """advance and valid of each target."""
    yield compiled("advance", dim, real), compiled("valid", dim, real)
    for words in (targets.plain(la=WORDS[dim]), targets.arrays(real, la=WORDS[dim])):
        yield words.compile(sand.advance), words.compile(sand.valid)


@pytest.mark.parametrize("size", [0.0, 0.1, 0.6])
@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("dim", DIMS)
def test_a_nan_in_strain_or_motion_is_never_hidden(dim, real, size):
    """Neither of comparisons, which a nan fails, nor of maxima, which may drop it."""
    state = np.append(size * np.ones(len(UPPER[dim])), 0.0).astype(real)
    G = np.zeros(dim * dim, real)
    params = (real(1.0), real(1.0), real(0.5))
    for advance, valid in laws(dim, real):
        assert valid(advance(tuple(state), tuple(G), real(1.0), params))
        for place in range(len(state) - 1 + len(G)):
            spoilt = np.concatenate([state[:-1], G])
            spoilt[place] = np.nan
            strain, motion = tuple(spoilt[: len(state) - 1]), tuple(spoilt[len(state) - 1 :])
            with np.errstate(invalid="ignore"):
                assert not valid(advance((*strain, real(0.0)), motion, real(1.0), params))


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("dim", DIMS)
def test_a_particle_is_the_same_bits_alone_and_beside_far_ones(dim, real):
    """Runs on several ranks group particles differently."""
    random, step = np.random.default_rng(5), targets.arrays(real, la=WORDS[dim]).compile(hencky.trial_strain)
    sizes = np.geomspace(1e-6, 2.0, 40)
    E = np.array([flat_symmetric(size * direction(random, dim, n)) for n, size in enumerate(sizes)], real)
    G = np.array([flat(0.1 * size * random.normal(size=(dim, dim))) for size in sizes], real)
    together = np.stack(step(tuple(E.T), tuple(G.T)), -1)
    alone = np.concatenate(
        [np.stack(step(tuple(e[:, None]), tuple(g[:, None])), -1) for e, g in zip(E, G, strict=True)]
    )
    assert together.dtype == real
    assert together.tobytes() == alone.tobytes()
    near = sizes < 0.3
    assert (together[near] == np.stack(step(tuple(E[near].T), tuple(G[near].T)), -1)).all()


@pytest.mark.parametrize("dim", DIMS)
def test_series_of_particles_that_do_not_need_them_divide_by_no_zero(dim):
    """Both sides of a `where` are computed: in plain Python a division by zero would end the run."""
    singular = targets.plain().compile(WORDS[dim].inverse_symmetric)((0.0,) * len(UPPER[dim]))
    assert np.isfinite(singular).all()
