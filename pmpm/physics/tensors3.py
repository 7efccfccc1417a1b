"""3 x 3 tensors as flat tuples, row by row; symmetric ones as (xx, xy, xz, yy, yz, zz). Same words as tensors2."""

from pmpm.physics.words import SWEEPS, TINY, sqrt, where

DIM = 3.0


def det(A):
    return A[0] * (A[4] * A[8] - A[5] * A[7]) - A[1] * (A[3] * A[8] - A[5] * A[6]) + A[2] * (A[3] * A[7] - A[4] * A[6])


def trace(A):
    return A[0] + A[4] + A[8]


def scale(a, A):
    return (a * A[0], a * A[1], a * A[2], a * A[3], a * A[4], a * A[5], a * A[6], a * A[7], a * A[8])


def scale_vector(a, u):
    return (a * u[0], a * u[1], a * u[2])


def add_scaled_vector(u, a, v):
    """u + a v."""
    return (u[0] + a * v[0], u[1] + a * v[1], u[2] + a * v[2])


def outer(u, v):
    """u v^T."""
    return (
        u[0] * v[0],
        u[0] * v[1],
        u[0] * v[2],
        u[1] * v[0],
        u[1] * v[1],
        u[1] * v[2],
        u[2] * v[0],
        u[2] * v[1],
        u[2] * v[2],
    )


def add_outer(A, u, v):
    """A + u v^T."""
    return (
        A[0] + u[0] * v[0],
        A[1] + u[0] * v[1],
        A[2] + u[0] * v[2],
        A[3] + u[1] * v[0],
        A[4] + u[1] * v[1],
        A[5] + u[1] * v[2],
        A[6] + u[2] * v[0],
        A[7] + u[2] * v[1],
        A[8] + u[2] * v[2],
    )


def apply(A, u):
    """A u."""
    return (
        A[0] * u[0] + A[1] * u[1] + A[2] * u[2],
        A[3] * u[0] + A[4] * u[1] + A[5] * u[2],
        A[6] * u[0] + A[7] * u[1] + A[8] * u[2],
    )


def apply_symmetric(S, u):
    """S u for a symmetric S."""
    return (
        S[0] * u[0] + S[1] * u[1] + S[2] * u[2],
        S[1] * u[0] + S[3] * u[1] + S[4] * u[2],
        S[2] * u[0] + S[4] * u[1] + S[5] * u[2],
    )


def dot(u, v):
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


def largest_entry(u):
    """max |u_i| of a vector."""
    return max(max(abs(u[0]), abs(u[1])), abs(u[2]))


def within(u, limit):
    """Whether every |u_i| is at most `limit`; false for nan, which `largest_entry` may hide."""
    return (abs(u[0]) <= limit) & (abs(u[1]) <= limit) & (abs(u[2]) <= limit)


def identity_plus(G):
    return (1.0 + G[0], G[1], G[2], G[3], 1.0 + G[4], G[5], G[6], G[7], 1.0 + G[8])


def add_diagonal(A, d):
    """A + d I."""
    return (A[0] + d, A[1], A[2], A[3], A[4] + d, A[5], A[6], A[7], A[8] + d)


def matmul(A, B):
    return (
        A[0] * B[0] + A[1] * B[3] + A[2] * B[6],
        A[0] * B[1] + A[1] * B[4] + A[2] * B[7],
        A[0] * B[2] + A[1] * B[5] + A[2] * B[8],
        A[3] * B[0] + A[4] * B[3] + A[5] * B[6],
        A[3] * B[1] + A[4] * B[4] + A[5] * B[7],
        A[3] * B[2] + A[4] * B[5] + A[5] * B[8],
        A[6] * B[0] + A[7] * B[3] + A[8] * B[6],
        A[6] * B[1] + A[7] * B[4] + A[8] * B[7],
        A[6] * B[2] + A[7] * B[5] + A[8] * B[8],
    )


def add(A, B):
    return (
        A[0] + B[0],
        A[1] + B[1],
        A[2] + B[2],
        A[3] + B[3],
        A[4] + B[4],
        A[5] + B[5],
        A[6] + B[6],
        A[7] + B[7],
        A[8] + B[8],
    )


def left_cauchy_green(F):
    """b = F F^T, symmetric."""
    return (
        F[0] * F[0] + F[1] * F[1] + F[2] * F[2],
        F[0] * F[3] + F[1] * F[4] + F[2] * F[5],
        F[0] * F[6] + F[1] * F[7] + F[2] * F[8],
        F[3] * F[3] + F[4] * F[4] + F[5] * F[5],
        F[3] * F[6] + F[4] * F[7] + F[5] * F[8],
        F[6] * F[6] + F[7] * F[7] + F[8] * F[8],
    )


def isotropic(d):
    """d I, symmetric."""
    zero = d - d
    return (d, zero, zero, d, zero, d)


def scale_plus_diagonal(a, S, d):
    """a S + d I for a symmetric S."""
    return (a * S[0] + d, a * S[1], a * S[2], a * S[3] + d, a * S[4], a * S[5] + d)


def full(S):
    """All entries of a symmetric S, row by row."""
    return (S[0], S[1], S[2], S[1], S[3], S[4], S[2], S[4], S[5])


def where_symmetric(condition, A, B):
    """A where the condition holds, else B, both symmetric."""
    return (
        where(condition, A[0], B[0]),
        where(condition, A[1], B[1]),
        where(condition, A[2], B[2]),
        where(condition, A[3], B[3]),
        where(condition, A[4], B[4]),
        where(condition, A[5], B[5]),
    )


def add_symmetric(A, B):
    return (A[0] + B[0], A[1] + B[1], A[2] + B[2], A[3] + B[3], A[4] + B[4], A[5] + B[5])


def product_commuting(A, B):
    """A B for symmetric matrices that commute, so that the product is symmetric too."""
    return (
        A[0] * B[0] + A[1] * B[1] + A[2] * B[2],
        A[0] * B[1] + A[1] * B[3] + A[2] * B[4],
        A[0] * B[2] + A[1] * B[4] + A[2] * B[5],
        A[1] * B[1] + A[3] * B[3] + A[4] * B[4],
        A[1] * B[2] + A[3] * B[4] + A[4] * B[5],
        A[2] * B[2] + A[4] * B[4] + A[5] * B[5],
    )


def adjugate_symmetric(S):
    """det S S^-1."""
    return (
        S[3] * S[5] - S[4] * S[4],
        S[2] * S[4] - S[1] * S[5],
        S[1] * S[4] - S[2] * S[3],
        S[0] * S[5] - S[2] * S[2],
        S[1] * S[2] - S[0] * S[4],
        S[0] * S[3] - S[1] * S[1],
    )


def det_symmetric(S):
    A = adjugate_symmetric(S)
    return S[0] * A[0] + S[1] * A[1] + S[2] * A[2]


def inverse_symmetric(S):
    """S^-1 of a positive definite S; for any other S it means nothing, but divides by no zero."""
    return scale_plus_diagonal(1.0 / max(det_symmetric(S), TINY), adjugate_symmetric(S), 0.0)


def polynomial(coefficients, S):
    """... + c2 S^2 + c1 S + c0 I for a symmetric S and (..., c2, c1, c0).

    Horner's scheme on a I + b S + c S^2: Cayley and Hamilton's S^3 = tr S S^2 - tr adj S S + det S I brings each product
    with S back to that form, for three multiplications in place of a product of matrices.
    """
    first, second, third = trace_symmetric(S), trace_symmetric(adjugate_symmetric(S)), det_symmetric(S)
    a = b = c = first - first
    for coefficient in coefficients:
        a, b, c = coefficient + c * third, a - c * second, b + c * first
    P, Q = scale_plus_diagonal(b, S, a), product_commuting(S, S)
    return (P[0] + c * Q[0], P[1] + c * Q[1], P[2] + c * Q[2], P[3] + c * Q[3], P[4] + c * Q[4], P[5] + c * Q[5])


def trace_symmetric(S):
    return S[0] + S[3] + S[5]


def norm_symmetric(S):
    """Frobenius norm of a symmetric S."""
    off_diagonal = S[1] * S[1] + S[2] * S[2] + S[4] * S[4]
    return sqrt(S[0] * S[0] + S[3] * S[3] + S[5] * S[5] + 2.0 * off_diagonal)


def row_sum_bound(S):
    """Largest row sum of |S|: an upper bound of its largest eigenvalue (Gershgorin), exact where S is diagonal."""
    x = abs(S[0]) + abs(S[1]) + abs(S[2])
    y = abs(S[1]) + abs(S[3]) + abs(S[4])
    return max(max(x, y), abs(S[2]) + abs(S[4]) + abs(S[5]))


def congruence(G, H):
    """(I + G)(I + H)(I + G)^T - I for a symmetric H, without cancellation for small G and H.

    With K = G + G H it is H + K + K^T + K G^T.
    """
    K = add(G, matmul(G, full(H)))
    return (
        H[0] + (K[0] + K[0]) + (K[0] * G[0] + K[1] * G[1] + K[2] * G[2]),
        H[1] + (K[1] + K[3]) + (K[0] * G[3] + K[1] * G[4] + K[2] * G[5]),
        H[2] + (K[2] + K[6]) + (K[0] * G[6] + K[1] * G[7] + K[2] * G[8]),
        H[3] + (K[4] + K[4]) + (K[3] * G[3] + K[4] * G[4] + K[5] * G[5]),
        H[4] + (K[5] + K[7]) + (K[3] * G[6] + K[4] * G[7] + K[5] * G[8]),
        H[5] + (K[8] + K[8]) + (K[6] * G[6] + K[7] * G[7] + K[8] * G[8]),
    )


def rotation_to_diagonal(a, b, c):
    """(tangent, cosine, sine) of the Jacobi rotation that removes the off-diagonal c between diagonal entries a and b."""
    difference, twice = b - a, 2.0 * c
    root = sqrt(difference * difference + twice * twice) + TINY
    t = twice / (difference + where(difference < 0.0, -root, root))
    cosine = 1.0 / sqrt(1.0 + t * t)
    return t, cosine, t * cosine


def rotate(c, s, u, v):
    """The pair of vectors u, v turned in their plane."""
    return (
        (c * u[0] - s * v[0], c * u[1] - s * v[1], c * u[2] - s * v[2]),
        (s * u[0] + c * v[0], s * u[1] + c * v[1], s * u[2] + c * v[2]),
    )


def eigen_symmetric(S):
    """(Q, s) with S = Q diag(s) Q^T, Q a rotation: cyclic Jacobi with a fixed number of sweeps, any order of s."""
    xx, xy, xz, yy, yz, zz = S[0], S[1], S[2], S[3], S[4], S[5]
    zero = xx - xx
    one = zero + 1.0
    p, q, r = (one, zero, zero), (zero, one, zero), (zero, zero, one)
    for _ in range(SWEEPS):
        t, c, s = rotation_to_diagonal(xx, yy, xy)
        xx, yy = xx - t * xy, yy + t * xy
        xy = zero
        xz, yz = c * xz - s * yz, s * xz + c * yz
        p, q = rotate(c, s, p, q)
        t, c, s = rotation_to_diagonal(xx, zz, xz)
        xx, zz = xx - t * xz, zz + t * xz
        xz = zero
        xy, yz = c * xy - s * yz, s * xy + c * yz
        p, r = rotate(c, s, p, r)
        t, c, s = rotation_to_diagonal(yy, zz, yz)
        yy, zz = yy - t * yz, zz + t * yz
        yz = zero
        xy, xz = c * xy - s * xz, s * xy + c * xz
        q, r = rotate(c, s, q, r)
    return (p[0], q[0], r[0], p[1], q[1], r[1], p[2], q[2], r[2]), (xx, yy, zz)


def spectral(Q, t):
    """Q diag(t) Q^T, symmetric."""
    a, b, c = Q[0] * t[0], Q[1] * t[1], Q[2] * t[2]
    d, e, f = Q[3] * t[0], Q[4] * t[1], Q[5] * t[2]
    return (
        a * Q[0] + b * Q[1] + c * Q[2],
        a * Q[3] + b * Q[4] + c * Q[5],
        a * Q[6] + b * Q[7] + c * Q[8],
        d * Q[3] + e * Q[4] + f * Q[5],
        d * Q[6] + e * Q[7] + f * Q[8],
        Q[6] * t[0] * Q[6] + Q[7] * t[1] * Q[7] + Q[8] * t[2] * Q[8],
    )


def each(function, t):
    """`function` of each principal value."""
    return (function(t[0]), function(t[1]), function(t[2]))


def tensor_part(state):
    """The tensor that a particle's state begins with."""
    return state[:9]


def after_tensor(state):
    """The numbers that follow a tensor in a particle's state."""
    return state[9:]


def symmetric_part(state):
    """The symmetric tensor that a particle's state begins with."""
    return (state[0], state[1], state[2], state[3], state[4], state[5])


def after_symmetric(state):
    """The scalar that follows a symmetric tensor in a particle's state."""
    return state[6]


# A solid tensor is a symmetric one with all of its diagonal: in 2-D (xx, xy, yy, zz), in 3-D the same as symmetric.


def solid_part(state):
    """The solid tensor that a particle's state begins with."""
    return (state[0], state[1], state[2], state[3], state[4], state[5])


def after_solid(state):
    """The numbers that follow a solid tensor in a particle's state."""
    return state[6:]


def in_plane(E):
    """The part of a solid tensor along the axes of the scene."""
    return (E[0], E[1], E[2], E[3], E[4], E[5])


def out_of_plane(E):
    """The last entry of the diagonal: along z, in 2-D out of the plane."""
    return E[5]


def with_out_of_plane(S, value):
    """A solid tensor: a symmetric S and, in 2-D, its entry out of the plane."""
    return S


def trace_solid(E):
    return trace_symmetric(E)


def norm_solid(E):
    """Frobenius norm of a solid tensor."""
    return norm_symmetric(E)


def scale_plus_diagonal_solid(a, E, d):
    """a E + d I for a solid E."""
    return scale_plus_diagonal(a, E, d)


def eigen_solid(E):
    """(Q, (s, s, s)) of a solid tensor: `eigen_symmetric` in the plane; in 2-D the third value lies along z."""
    return eigen_symmetric(E)


def spectral_solid(Q, t):
    """The solid tensor with the principal values t along the axes that `eigen_solid` found."""
    return spectral(Q, t)
