"""The physics' flat tuples as numpy matrices and back, and random tensors that the tests share."""

from functools import cache

import numpy as np

from pmpm.kernels import targets
from pmpm.physics import tensors2, tensors3

WORDS = {2: tensors2, 3: tensors3}
UPPER = {2: ((0, 0), (0, 1), (1, 1)), 3: ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))}
EPS = float(np.finfo(float).eps)


def full(A):
    """Flat tuple, row by row -> matrix."""
    dim = 2 if len(A) == 4 else 3
    return np.array(A, float).reshape(dim, dim)


def symmetric(S):
    """Flat symmetric tuple -> matrix."""
    dim = 2 if len(S) == 3 else 3
    A = np.empty((dim, dim))
    for value, (i, j) in zip(S, UPPER[dim], strict=True):
        A[i, j] = A[j, i] = value
    return A


def flat(A):
    """Matrix -> flat tuple of floats, row by row."""
    return tuple(map(float, np.ravel(A)))


def flat_symmetric(A):
    """Symmetric matrix -> flat tuple of floats."""
    return tuple(float(A[i, j]) for i, j in UPPER[len(A)])


@cache
def in_dimension(function, dim, **choices):
    """`function` of the physics in plain Python with the tensor words of this dimension."""
    return targets.plain(la=WORDS[dim], **choices).compile(function)


def random_rotation(random, dim):
    Q, R = np.linalg.qr(random.normal(size=(dim, dim)))
    Q *= np.sign(np.diag(R))
    if np.linalg.det(Q) < 0.0:
        Q[:, 0] *= -1.0
    return Q


def random_stretch(random, dim, largest):
    """Symmetric positive definite with principal logarithms between -largest and largest."""
    Q = random_rotation(random, dim)
    return Q @ np.diag(np.exp(random.uniform(-largest, largest, dim))) @ Q.T


def of_eigenvalues(S, function):
    """function(S) for a symmetric matrix, by numpy's eigenvectors."""
    s, Q = np.linalg.eigh(S)
    return (Q * function(s)) @ Q.T
