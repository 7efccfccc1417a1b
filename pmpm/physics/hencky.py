"""Hencky (logarithmic) strain E = 1/2 ln b of solids: how it advances with a step, and the stress it makes.

The laws that keep the elastic strain E in place of F take their trial state from here and then return it to their yield
surface. A "solid" strain also holds the out-of-plane entry in 2-D, where plastic flow can strain elastically along z although
the total strain there is zero.
"""

from pmpm.physics import tensors2 as la
from pmpm.physics.words import ATANH_OVER_ROOT, EXPM1_OF_TWICE, NAN, any_of, expm1, log1p, where

SWITCH = 0.5  # the power series of `words` have terms for arguments up to here
LARGEST_H = 4.0  # rows of b - I up to SWITCH in X sum up to 2 sqrt(3) at most; X means nothing where b is huge
SMALLEST = -0.9999999  # b - 1 below it only keeps the logarithm finite until `valid` stops the run
LARGEST = 10.0  # no solid is strained elastically by e^10
NEVER = 1e30  # a strain where a surface ends that has no end: finite in float32, too


def twice_expm1(e):
    """exp(2 e) - 1."""
    return expm1(2.0 * e)


def half_log1p(h):
    """1/2 ln(1 + h)."""
    return 0.5 * log1p(max(h, SMALLEST))


def trial_strain(E, G):
    """1/2 ln((I + G) exp(2 E) (I + G)^T), by way of b - I, so that small strains keep their digits.

    By power series, in 3-D a tenth of the work of eigenvalues, where no row of E and of X, the hyperbolic tangent of the
    result, sums up to more than SWITCH: rows, because they bound eigenvalues and cost no root. Both ways agree there to
    10 eps. A nan compares as near, and the series keep it.
    """
    H = la.congruence(G, la.polynomial(EXPM1_OF_TWICE, E))
    X = la.product_commuting(H, la.inverse_symmetric(la.scale_plus_diagonal(1.0, H, 2.0)))
    trial = atanh(X)
    far = (la.row_sum_bound(E) > SWITCH) | (la.row_sum_bound(H) > LARGEST_H) | (la.row_sum_bound(X) > SWITCH)
    if any_of(far):
        trial = la.where_symmetric(far, trial_strain_by_eigenvalues(E, G), trial)
    return trial


def atanh(X):
    """X + X^3/3 + X^5/5 + ... of a symmetric X: 1/2 ln b, where X = (b - I) (b + I)^-1.

    N. J. Higham, Functions of Matrices (2008), chapter 11.
    """
    return la.product_commuting(X, la.polynomial(ATANH_OVER_ROOT, la.product_commuting(X, X)))


def trial_strain_by_eigenvalues(E, G):
    """The trial strain at any size: the dear way."""
    Q, e = la.eigen_symmetric(E)
    Q, h = la.eigen_symmetric(la.congruence(G, la.spectral(Q, la.each(twice_expm1, e))))
    return la.spectral(Q, la.each(half_log1p, h))


def trial_strain_solid(E, G):
    """The trial strain with its out-of-plane entry, which motion in the plane does not change."""
    return la.with_out_of_plane(trial_strain(la.in_plane(E), G), la.out_of_plane(E))


def kept_if_forward(G):
    """1 where det(I + G) > 0, else nan: a step that turns a particle inside out is found by `valid`."""
    return where(la.det(la.identity_plus(G)) > 0.0, 1.0, NAN)


def strain_of(F):
    """E = 1/2 ln(F F^T) of a particle that is elastically deformed by F; nan where det F <= 0."""
    minus_G = la.identity_plus(la.scale(-1.0, F))
    zero = la.isotropic(minus_G[0] - minus_G[0])
    Q, h = la.eigen_symmetric(la.congruence(la.scale(-1.0, minus_G), zero))
    return la.scale_plus_diagonal(where(la.det(F) > 0.0, 1.0, NAN), la.spectral(Q, la.each(half_log1p, h)), 0.0)


def strain_of_solid(F):
    return la.with_out_of_plane(strain_of(F), la.det(F) - la.det(F))


def stress(E, mu, lam):
    """tau = 2 mu E + lam tr E I of a solid strain, its part in the plane."""
    return la.scale_plus_diagonal(2.0 * mu, la.in_plane(E), lam * la.trace_solid(E))


def out_of_plane_stress(E, mu, lam):
    return 2.0 * mu * la.out_of_plane(E) + lam * la.trace_solid(E)


def energy(E, mu, lam):
    """psi = mu |E|^2 + lam/2 (tr E)^2 of a solid strain."""
    norm, trace = la.norm_solid(E), la.trace_solid(E)
    return mu * norm * norm + 0.5 * lam * trace * trace


def wave_modulus(E, mu, lam):
    """Upper bound of lam + 2 mu - 2 mu ln F - lam ln J, Pa: density times the spatial P-wave speed squared along an axis.

    It bounds the waves along other axes too while no elastic strain is beyond 1; at 2, shear waves exceed it by 12 %.
    """
    return lam + 2.0 * mu + 2.0 * mu * la.row_sum_bound(la.in_plane(E)) + max(-lam * la.trace_solid(E), 0.0)
