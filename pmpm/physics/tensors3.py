"""3 x 3 tensors as flat tuples, row by row; symmetric ones as (xx, xy, xz, yy, yz, zz). Same words as tensors2."""

from pmpm.physics.rotations import givens, rotation_to_diagonal, turn_to_orthogonal
from pmpm.physics.words import EPS, HALLEY_STEPS, SWEEPS, TINY, any_of, sqrt, where

DIM = 3.0
HALF_ROOT_3 = 0.8660254037844386
# Of `principal_symmetric`: y is within 3e-5 of ROOT[0] + ROOT[1] d + ... (fitted at Chebyshev's points), which two of Newton's
# steps square to 2e-9 and 1e-17.
ROOT = (0.70713656, 0.992425, -1.80247682, 3.05971149)
NEWTON_STEPS = 2
POLAR_LIMIT = 0.3  # of x^3, for the denominator of `polar`: 16/27 where all s are equal
SMALLEST, LARGEST = 1e-2, 1e4  # of |F|^2, for `polar` without scaling


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


def moment(u, v):
    """Of a vector v at the end of an arm u: u x v."""
    return (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])


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


def symmetrize(A):
    """(A + A^T) / 2, symmetric."""
    return (A[0], 0.5 * (A[1] + A[3]), 0.5 * (A[2] + A[6]), A[4], 0.5 * (A[5] + A[7]), A[8])


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


def not_positive_definite(S):
    """Whether a symmetric S has an eigenvalue at or below zero, by Sylvester's minors; false for nan."""
    return (S[0] <= 0.0) | (S[0] * S[3] - S[1] * S[1] <= 0.0) | (det_symmetric(S) <= 0.0)


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


def rotate(c, s, u, v):
    """The pair of vectors u, v turned in their plane."""
    return (
        (c * u[0] - s * v[0], c * u[1] - s * v[1], c * u[2] - s * v[2]),
        (s * u[0] + c * v[0], s * u[1] + c * v[1], s * u[2] + c * v[2]),
    )


def jacobi_sweep(S, p, q, r):
    """(S, p, q, r, largest tangent) after one cyclic sweep of rotations on S = diag by the columns p, q, r."""
    xx, xy, xz, yy, yz, zz = S[0], S[1], S[2], S[3], S[4], S[5]
    first, c, s = rotation_to_diagonal(xx, yy, xy)
    xx, yy = xx - first * xy, yy + first * xy
    xz, yz = c * xz - s * yz, s * xz + c * yz
    p, q = rotate(c, s, p, q)
    second, c, s = rotation_to_diagonal(xx, zz, xz)
    xx, zz = xx - second * xz, zz + second * xz
    xy, yz = -s * yz, c * yz
    p, r = rotate(c, s, p, r)
    third, c, s = rotation_to_diagonal(yy, zz, yz)
    yy, zz = yy - third * yz, zz + third * yz
    xy, xz = c * xy, s * xy
    q, r = rotate(c, s, q, r)
    return (xx, xy, xz, yy, xx - xx, zz), p, q, r, max(max(abs(first), abs(second)), abs(third))


def eigen_symmetric(S):
    """(Q, s) with S = Q diag(s) Q^T, Q a rotation, any order of s: cyclic Jacobi sweeps.

    A particle whose last sweep turned by less than the root of eps is done, since convergence is quadratic.
    """
    S = (S[0], S[1], S[2], S[3], S[4], S[5])
    zero = S[0] - S[0]
    one = zero + 1.0
    p, q, r = (one, zero, zero), (zero, one, zero), (zero, zero, one)
    turned = one
    for _ in range(SWEEPS):
        moving = turned * turned > EPS
        if any_of(moving):
            T, u, v, w, t = jacobi_sweep(S, p, q, r)
            S = where_symmetric(moving, T, S)
            p, q, r = where_vector(moving, u, p), where_vector(moving, v, q), where_vector(moving, w, r)
            turned = where(moving, t, turned)
    return (p[0], q[0], r[0], p[1], q[1], r[1], p[2], q[2], r[2]), (S[0], S[3], S[5])


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


def cofactor(A):
    """det A A^-T, the derivative of det A."""
    return (
        A[4] * A[8] - A[5] * A[7],
        A[5] * A[6] - A[3] * A[8],
        A[3] * A[7] - A[4] * A[6],
        A[2] * A[7] - A[1] * A[8],
        A[0] * A[8] - A[2] * A[6],
        A[1] * A[6] - A[0] * A[7],
        A[1] * A[5] - A[2] * A[4],
        A[2] * A[3] - A[0] * A[5],
        A[0] * A[4] - A[1] * A[3],
    )


def norm_squared(A):
    """Sum of the squares of all entries."""
    return trace_symmetric(left_cauchy_green(A))


def where_vector(condition, u, v):
    """u where the condition holds, else v."""
    return (where(condition, u[0], v[0]), where(condition, u[1], v[1]), where(condition, u[2], v[2]))


def where_tensor(condition, A, B):
    """A where the condition holds, else B."""
    return (
        *where_vector(condition, A[:3], B[:3]),
        *where_vector(condition, A[3:6], B[3:6]),
        *where_vector(condition, A[6:], B[6:]),
    )


def product_symmetric(A, B):
    """A B^T where the result is known to be symmetric."""
    return (
        A[0] * B[0] + A[1] * B[1] + A[2] * B[2],
        A[0] * B[3] + A[1] * B[4] + A[2] * B[5],
        A[0] * B[6] + A[1] * B[7] + A[2] * B[8],
        A[3] * B[3] + A[4] * B[4] + A[5] * B[5],
        A[3] * B[6] + A[4] * B[7] + A[5] * B[8],
        A[6] * B[6] + A[7] * B[7] + A[8] * B[8],
    )


def orthogonalise(u, v, p, q):
    """(u, v, p, q, size of the turn) with u and v made orthogonal, the longer one first, and p and q turned like them."""
    cosine, sine, size = turn_to_orthogonal(dot(u, u), dot(v, v), dot(u, v))
    return *rotate(cosine, -sine, u, v), *rotate(cosine, -sine, p, q), size


def to_length_one(u):
    """u / |u| where |u| is 1 but for round-off."""
    return scale_vector(1.5 - 0.5 * dot(u, u), u)


def svd(F):
    """(U, s, V) with F = U diag(s) V^T: rotations U and V, s[0] >= s[1] >= |s[2]|, and s[2] carries the sign of det F.

    V makes the columns of F V orthogonal by one-sided Jacobi sweeps (Hestenes, J. Soc. Indust. Appl. Math. 6 (1958) 51),
    the longer ones first (de Rijk 1989); Givens rotations then read off U, which is one even where F is singular. Errors of s
    are a few eps s[0]. All is nan where an entry of F is not finite. A particle whose last sweep turned by less than the
    root of eps is done, since convergence is quadratic; the others go on alone.
    """
    size = max(max(largest_entry(F[:3]), largest_entry(F[3:6])), largest_entry(F[6:]))
    unit = where(size == 0.0, 1.0, size)
    zero = trace_symmetric(left_cauchy_green(add(F, scale(-1.0, F))))
    one = zero + 1.0
    a = (F[0] / unit + zero, F[3] / unit, F[6] / unit)
    b = (F[1] / unit + zero, F[4] / unit, F[7] / unit)
    c = (F[2] / unit + zero, F[5] / unit, F[8] / unit)
    p, q, r = (one, zero, zero), (zero, one, zero), (zero, zero, one)
    turned = one
    for _ in range(SWEEPS):
        moving = turned * turned > EPS
        if any_of(moving):
            a1, b1, p1, q1, first = orthogonalise(a, b, p, q)
            a1, c1, p1, r1, second = orthogonalise(a1, c, p1, r)
            b1, c1, q1, r1, third = orthogonalise(b1, c1, q1, r1)
            a, b, c = where_vector(moving, a1, a), where_vector(moving, b1, b), where_vector(moving, c1, c)
            p, q, r = where_vector(moving, p1, p), where_vector(moving, q1, q), where_vector(moving, r1, r)
            turned = where(moving, max(max(first, second), third), turned)
    p, q, r = to_length_one(p), to_length_one(q), to_length_one(r)
    x, y, z = (a[0], b[0], c[0]), (a[1], b[1], c[1]), (a[2], b[2], c[2])
    u, v, w = (one, zero, zero), (zero, one, zero), (zero, zero, one)
    cosine, sine = givens(x[0], y[0])
    x, y = rotate(cosine, -sine, x, y)
    u, v = rotate(cosine, -sine, u, v)
    cosine, sine = givens(x[0], z[0])
    x, z = rotate(cosine, -sine, x, z)
    u, w = rotate(cosine, -sine, u, w)
    cosine, sine = givens(y[1], z[1])
    y, z = rotate(cosine, -sine, y, z)
    v, w = rotate(cosine, -sine, v, w)
    second = min(y[1], x[0])
    third = max(min(z[2], second), -second)
    U = (u[0], v[0], w[0], u[1], v[1], w[1], u[2], v[2], w[2])
    V = (p[0], q[0], r[0], p[1], q[1], r[1], p[2], q[2], r[2])
    return U, (size * x[0], size * second, size * third), V


def polar_by_svd(F):
    """U V^T of the singular value decomposition: the dear way to `polar`."""
    U, s, V = svd(F)
    return matmul(U, (V[0], V[3], V[6], V[1], V[4], V[7], V[2], V[5], V[8]))


def polar(F):
    """The rotation R nearest F, also where det F <= 0: R = U V^T of `svd`, and R^T F is symmetric.

    R is the derivative of x(F) = tr R^T F = s[0] + s[1] + s[2] (Smith, de Goes, Kim, ACM Trans. Graph. 38 (2019) 5), and x
    is the largest root of (x^2 - |F|^2)^2 = 8 det F x + 4 |cof F|^2 (Franca, Computers Math. Applic. 18 (1989) 459), so
        R = ((x^2 + |F|^2) F + 2 x cof F - 2 F F^T F) / (x^3 - |F|^2 x - 2 det F).
    The denominator is 2 (s[0] + s[1]) (s[1] + s[2]) (s[2] + s[0]). By svd where that is small, because there R turns far
    for little change of F, or where Halley's steps down from sqrt 3 |F|, which no sum exceeds, did not arrive.
    """
    b, K = left_cauchy_green(F), cofactor(F)
    I = trace_symmetric(b)
    J = F[0] * K[0] + F[1] * K[1] + F[2] * K[2]
    constant = 4.0 * norm_squared(K)
    x = sqrt(3.0 * I)
    step = x
    for _ in range(HALLEY_STEPS):
        h = x * x - I
        g, slope = h * h - (8.0 * J * x + constant), 4.0 * (h * x - 2.0 * J)
        step = g * slope / max(slope * slope - g * (4.0 * (x * x) + 2.0 * h), TINY)
        x = x - step
    cube, denominator = x * x * x, (x * x - I) * x - 2.0 * J
    unsteady = abs(step * step * step) > 0.1 * EPS * cube
    far = (denominator <= POLAR_LIMIT * cube) | unsteady | (I < SMALLEST) | (I > LARGEST)
    inverse = 1.0 / max(denominator, TINY)
    bF = matmul(full(b), F)
    f, k, m = (x * x + I) * inverse, 2.0 * x * inverse, -2.0 * inverse
    R = add(scale(f, F), add(scale(k, K), scale(m, bF)))
    if any_of(far):
        R = where_tensor(far, polar_by_svd(F), R)
    return R


def into_range(t, low, high):
    """What brings each principal value to between `low` and `high`: exactly zero where it is there."""
    return (
        min(max(t[0], low), high) - t[0],
        min(max(t[1], low), high) - t[1],
        min(max(t[2], low), high) - t[2],
    )


def sum_of(t):
    """The trace, of principal values."""
    return t[0] + t[1] + t[2]


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


def where_solid(condition, A, B):
    """A where the condition holds, else B, both solid."""
    return where_symmetric(condition, A, B)


def add_solid(A, B):
    return add_symmetric(A, B)


def det_solid(E):
    return det_symmetric(E)


def eigen_solid(E):
    """(Q, (s, s, s)) of a solid tensor: `eigen_symmetric` in the plane; in 2-D the third value lies along z."""
    return eigen_symmetric(E)


def spectral_solid(Q, t):
    """The solid tensor with the principal values t along the axes that `eigen_solid` found."""
    return spectral(Q, t)


# ---- isotropic functions without eigenvectors ----


def principal_symmetric(S):
    """(what `add_along` needs besides, the principal values in falling order) of a symmetric S: a tenth of `eigen_symmetric`.

    Of n = dev S / |dev S| the value farthest from zero, y, is a root of y^3 - y/2 - |det n|, simple and therefore exact to
    round-off. The gap between the other two is sqrt(3) |S'| over the cubic's slope at y, with S' the part of dev n^2 that is
    orthogonal to n: by Vandermonde's determinant 3 |S'|^2 is the discriminant, and nothing cancels where the two are equal.
    """
    mean = trace_symmetric(S) / 3.0
    D = scale_plus_diagonal(1.0, S, -mean)
    norm = norm_symmetric(D)
    n = scale_plus_diagonal(1.0 / max(norm, TINY), D, 0.0)
    square = product_commuting(n, n)
    det_n = det_symmetric(n)
    d = abs(det_n)
    y = ROOT[0] + d * (ROOT[1] + d * (ROOT[2] + d * ROOT[3]))
    for _ in range(NEWTON_STEPS):
        y = y - ((y * y - 0.5) * y - d) / (3.0 * (y * y) - 0.5)
    across = add_symmetric(scale_plus_diagonal(1.0, square, -1.0 / 3.0), scale_plus_diagonal(-3.0 * det_n, n, 0.0))
    half_gap = HALF_ROOT_3 * norm_symmetric(across) / (3.0 * (y * y) - 0.5)
    positive = det_n > 0.0
    half = where(positive, -0.5, 0.5) * y
    upper, lower = half + half_gap, half - half_gap
    first, second, third = where(positive, y, upper), where(positive, upper, lower), where(positive, lower, -y)
    values = (mean + norm * first, mean + norm * second, mean + norm * third)
    return (norm, n, square, first, second, third), values


def add_along(S, axes, added):
    """S with `added` to the principal values that `principal_symmetric` found, along their axes.

    It must keep the order of the values and bring none farther from another: then Newton's interpolation by divided
    differences, which are bounded, is exact to round-off also where values are equal. What adds zero changes no bit.
    """
    norm, n, square, first, second, third = axes
    between = max(min((added[0] - added[1]) / max(first - second, TINY), 0.0), -norm)
    beyond = max(min((added[1] - added[2]) / max(second - third, TINY), 0.0), -norm)
    c = (between - beyond) / max(first - third, TINY)
    b = between + c * third
    a = added[0] - between * first + c * (first * second)
    P = scale_plus_diagonal(b, n, a)
    return (
        S[0] + (P[0] + c * square[0]),
        S[1] + (P[1] + c * square[1]),
        S[2] + (P[2] + c * square[2]),
        S[3] + (P[3] + c * square[3]),
        S[4] + (P[4] + c * square[4]),
        S[5] + (P[5] + c * square[5]),
    )


def principal_solid(E):
    return principal_symmetric(E)


def add_along_solid(E, axes, added):
    return add_along(E, axes, added)
