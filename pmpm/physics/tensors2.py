"""2 x 2 tensors (plane strain) as flat tuples, row by row; symmetric ones as (xx, xy, yy). Same words as tensors3."""

from pmpm.physics.rotations import givens, rotation_to_diagonal, turn_to_orthogonal
from pmpm.physics.words import TINY, any_of, sqrt, where

DIM = 2.0
POLAR_LIMIT = 0.05  # of |F|^2, for (s[0] + s[1])^2
SMALLEST, LARGEST = 1e-6, 1e6  # of |F|^2, for `polar` without scaling


def det(A):
    return A[0] * A[3] - A[1] * A[2]


def trace(A):
    return A[0] + A[3]


def scale(a, A):
    return (a * A[0], a * A[1], a * A[2], a * A[3])


def scale_vector(a, u):
    return (a * u[0], a * u[1])


def add_scaled_vector(u, a, v):
    """u + a v."""
    return (u[0] + a * v[0], u[1] + a * v[1])


def outer(u, v):
    """u v^T."""
    return (u[0] * v[0], u[0] * v[1], u[1] * v[0], u[1] * v[1])


def add_outer(A, u, v):
    """A + u v^T."""
    return (A[0] + u[0] * v[0], A[1] + u[0] * v[1], A[2] + u[1] * v[0], A[3] + u[1] * v[1])


def apply(A, u):
    """A u."""
    return (A[0] * u[0] + A[1] * u[1], A[2] * u[0] + A[3] * u[1])


def apply_symmetric(S, u):
    """S u for a symmetric S."""
    return (S[0] * u[0] + S[1] * u[1], S[1] * u[0] + S[2] * u[1])


def dot(u, v):
    return u[0] * v[0] + u[1] * v[1]


def moment(u, v):
    """Of a vector v at the end of an arm u, as a tuple of one number."""
    return (u[0] * v[1] - u[1] * v[0],)


def largest_entry(u):
    """max |u_i| of a vector."""
    return max(abs(u[0]), abs(u[1]))


def within(u, limit):
    """Whether every |u_i| is at most `limit`; false for nan, which `largest_entry` may hide."""
    return (abs(u[0]) <= limit) & (abs(u[1]) <= limit)


def identity_plus(G):
    return (1.0 + G[0], G[1], G[2], 1.0 + G[3])


def add_diagonal(A, d):
    """A + d I."""
    return (A[0] + d, A[1], A[2], A[3] + d)


def matmul(A, B):
    return (
        A[0] * B[0] + A[1] * B[2],
        A[0] * B[1] + A[1] * B[3],
        A[2] * B[0] + A[3] * B[2],
        A[2] * B[1] + A[3] * B[3],
    )


def add(A, B):
    return (A[0] + B[0], A[1] + B[1], A[2] + B[2], A[3] + B[3])


def left_cauchy_green(F):
    """b = F F^T, symmetric."""
    return (F[0] * F[0] + F[1] * F[1], F[0] * F[2] + F[1] * F[3], F[2] * F[2] + F[3] * F[3])


def symmetrize(A):
    """(A + A^T) / 2, symmetric."""
    return (A[0], 0.5 * (A[1] + A[2]), A[3])


def isotropic(d):
    """d I, symmetric."""
    zero = d - d
    return (d, zero, d)


def scale_plus_diagonal(a, S, d):
    """a S + d I for a symmetric S."""
    return (a * S[0] + d, a * S[1], a * S[2] + d)


def full(S):
    """All entries of a symmetric S, row by row."""
    return (S[0], S[1], S[1], S[2])


def where_symmetric(condition, A, B):
    """A where the condition holds, else B, both symmetric."""
    return (where(condition, A[0], B[0]), where(condition, A[1], B[1]), where(condition, A[2], B[2]))


def add_symmetric(A, B):
    return (A[0] + B[0], A[1] + B[1], A[2] + B[2])


def product_commuting(A, B):
    """A B for symmetric matrices that commute, so that the product is symmetric too."""
    return (A[0] * B[0] + A[1] * B[1], A[0] * B[1] + A[1] * B[2], A[1] * B[1] + A[2] * B[2])


def det_symmetric(S):
    return S[0] * S[2] - S[1] * S[1]


def adjugate_symmetric(S):
    """det S S^-1."""
    return (S[2], -S[1], S[0])


def not_positive_definite(S):
    """Whether a symmetric S has an eigenvalue at or below zero, by Sylvester's minors; false for nan."""
    return (S[0] <= 0.0) | (det_symmetric(S) <= 0.0)


def inverse_symmetric(S):
    """S^-1 of a positive definite S; for any other S it means nothing, but divides by no zero."""
    return scale_plus_diagonal(1.0 / max(det_symmetric(S), TINY), adjugate_symmetric(S), 0.0)


def polynomial(coefficients, S):
    """... + c2 S^2 + c1 S + c0 I for a symmetric S and (..., c2, c1, c0).

    Horner's scheme on a I + b S: Cayley and Hamilton's S^2 = tr S S - det S I brings each product with S back to that form.
    """
    first, second = trace_symmetric(S), det_symmetric(S)
    a = b = first - first
    for coefficient in coefficients:
        a, b = coefficient - b * second, a + b * first
    return scale_plus_diagonal(b, S, a)


def trace_symmetric(S):
    return S[0] + S[2]


def norm_symmetric(S):
    """Frobenius norm of a symmetric S."""
    return sqrt(S[0] * S[0] + 2.0 * (S[1] * S[1]) + S[2] * S[2])


def row_sum_bound(S):
    """Largest row sum of |S|: an upper bound of its largest eigenvalue (Gershgorin), exact where S is diagonal."""
    return max(abs(S[0]) + abs(S[1]), abs(S[1]) + abs(S[2]))


def congruence(G, H):
    """(I + G)(I + H)(I + G)^T - I for a symmetric H, without cancellation for small G and H.

    With K = G + G H it is H + K + K^T + K G^T.
    """
    K = add(G, matmul(G, full(H)))
    return (
        H[0] + (K[0] + K[0]) + (K[0] * G[0] + K[1] * G[1]),
        H[1] + (K[1] + K[2]) + (K[0] * G[2] + K[1] * G[3]),
        H[2] + (K[3] + K[3]) + (K[2] * G[2] + K[3] * G[3]),
    )


def eigen_symmetric(S):
    """(Q, s) with S = Q diag(s) Q^T, Q a rotation. One Jacobi rotation is exact in two dimensions."""
    t, cosine, sine = rotation_to_diagonal(S[0], S[2], S[1])
    return (cosine, sine, -sine, cosine), (S[0] - t * S[1], S[2] + t * S[1])


def spectral(Q, t):
    """Q diag(t) Q^T, symmetric."""
    a, b = Q[0] * t[0], Q[1] * t[1]
    return (a * Q[0] + b * Q[1], a * Q[2] + b * Q[3], Q[2] * t[0] * Q[2] + Q[3] * t[1] * Q[3])


def each(function, t):
    """`function` of each principal value."""
    return (function(t[0]), function(t[1]))


def cofactor(A):
    """det A A^-T, the derivative of det A."""
    return (A[3], -A[2], -A[1], A[0])


def norm_squared(A):
    """Sum of the squares of all entries."""
    return A[0] * A[0] + A[1] * A[1] + A[2] * A[2] + A[3] * A[3]


def where_tensor(condition, A, B):
    """A where the condition holds, else B."""
    return (
        where(condition, A[0], B[0]),
        where(condition, A[1], B[1]),
        where(condition, A[2], B[2]),
        where(condition, A[3], B[3]),
    )


def product_symmetric(A, B):
    """A B^T where the result is known to be symmetric."""
    return (A[0] * B[0] + A[1] * B[1], A[0] * B[2] + A[1] * B[3], A[2] * B[2] + A[3] * B[3])


def svd(F):
    """(U, s, V) with F = U diag(s) V^T: rotations U and V, s[0] >= |s[1]|, and s[1] carries the sign of det F.

    V makes the columns of F V orthogonal (Hestenes 1958), in closed form; a Givens rotation reads off U, which is one even
    where F is singular. Errors of s are a few eps s[0]. All is nan where an entry of F is not finite.
    """
    size = max(max(abs(F[0]), abs(F[1])), max(abs(F[2]), abs(F[3])))
    unit = where(size == 0.0, 1.0, size)
    zero = (F[0] - F[0]) + (F[1] - F[1]) + (F[2] - F[2]) + (F[3] - F[3])
    a, b, c, d = F[0] / unit + zero, F[1] / unit + zero, F[2] / unit + zero, F[3] / unit + zero
    cosine, sine, t = turn_to_orthogonal(a * a + c * c, b * b + d * d, a * b + c * d)
    a, b, c, d = cosine * a + sine * b, cosine * b - sine * a, cosine * c + sine * d, cosine * d - sine * c
    p, q = givens(a, c)
    first = p * a + q * c
    second = max(min(p * d - q * b, first), -first)
    return (p, -q, q, p), (size * first, size * second), (cosine, -sine, sine, cosine)


def polar_by_svd(F):
    """U V^T of the singular value decomposition: the dear way to `polar`."""
    U, s, V = svd(F)
    return matmul(U, (V[0], V[2], V[1], V[3]))


def polar(F):
    """The rotation R nearest F, also where det F <= 0: R = U V^T of `svd`, and R^T F is symmetric.

    F + cof F is a multiple of R, by s[0] + s[1]. By svd where that is small: there R turns far for little change of F.
    """
    x, y = F[0] + F[3], F[2] - F[1]
    square, whole = x * x + y * y, norm_squared(F)
    far = (square <= POLAR_LIMIT * whole) | (whole < SMALLEST) | (whole > LARGEST)
    inverse = 1.0 / sqrt(max(square, TINY))
    x, y = x * inverse, y * inverse
    R = (x, -y, y, x)
    if any_of(far):
        R = where_tensor(far, polar_by_svd(F), R)
    return R


def into_range(t, low, high):
    """What brings each principal value to between `low` and `high`: exactly zero where it is there."""
    return (min(max(t[0], low), high) - t[0], min(max(t[1], low), high) - t[1])


def sum_of(t):
    """The trace, of principal values."""
    return t[0] + t[1]


def tensor_part(state):
    """The tensor that a particle's state begins with."""
    return state[:4]


def after_tensor(state):
    """The numbers that follow a tensor in a particle's state."""
    return state[4:]


def symmetric_part(state):
    """The symmetric tensor that a particle's state begins with."""
    return (state[0], state[1], state[2])


def after_symmetric(state):
    """The scalar that follows a symmetric tensor in a particle's state."""
    return state[3]


# A solid tensor is a symmetric one with all of its diagonal: in 2-D (xx, xy, yy, zz), in 3-D the same as symmetric.


def solid_part(state):
    """The solid tensor that a particle's state begins with."""
    return (state[0], state[1], state[2], state[3])


def after_solid(state):
    """The numbers that follow a solid tensor in a particle's state."""
    return state[4:]


def in_plane(E):
    """The part of a solid tensor along the axes of the scene."""
    return (E[0], E[1], E[2])


def out_of_plane(E):
    """The last entry of the diagonal: along z, in 2-D out of the plane."""
    return E[3]


def with_out_of_plane(S, value):
    """A solid tensor: a symmetric S and, in 2-D, its entry out of the plane."""
    return S + (value,)


def trace_solid(E):
    return E[0] + E[2] + E[3]


def norm_solid(E):
    """Frobenius norm of a solid tensor."""
    return sqrt(E[0] * E[0] + E[2] * E[2] + E[3] * E[3] + 2.0 * (E[1] * E[1]))


def scale_plus_diagonal_solid(a, E, d):
    """a E + d I for a solid E."""
    return (a * E[0] + d, a * E[1], a * E[2] + d, a * E[3] + d)


def where_solid(condition, A, B):
    """A where the condition holds, else B, both solid."""
    return where_symmetric(condition, A, B) + (where(condition, A[3], B[3]),)


def add_solid(A, B):
    return (A[0] + B[0], A[1] + B[1], A[2] + B[2], A[3] + B[3])


def det_solid(E):
    return (E[0] * E[2] - E[1] * E[1]) * E[3]


def eigen_solid(E):
    """(Q, (s, s, s)) of a solid tensor: `eigen_symmetric` in the plane; in 2-D the third value lies along z."""
    Q, s = eigen_symmetric(E)
    return Q, s + (E[3],)


def spectral_solid(Q, t):
    """The solid tensor with the principal values t along the axes that `eigen_solid` found."""
    return spectral(Q, t) + (t[2],)


def principal_symmetric(S):
    """(what `add_along` needs besides, the principal values) of a symmetric S."""
    return eigen_symmetric(S)


def add_along(S, axes, added):
    """S with `added` to the principal values that `principal_symmetric` found, along their axes."""
    return add_symmetric(S, spectral(axes, added))


def principal_solid(E):
    """The same of a solid tensor; the third value lies along z."""
    return eigen_solid(E)


def add_along_solid(E, axes, added):
    return add_solid(E, spectral_solid(axes, added))
