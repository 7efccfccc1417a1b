"""The textbook in plain scalar Python: one particle, one node. No numba, no MPI, no numpy.

Authors' rules, so that one source compiles for scalars, SIMD lanes, CUDA and numpy arrays: decimal points on reals; `where`,
`min`, `max` instead of `if`; both sides of a `where` safe; no early return, data-dependent loop, closure or `x**2`; tuples of
fixed length. `if CAPITALS:` is allowed: such names are constants of the scene and the branch is removed before typing.

So is `if any_of(condition):` around a dear computation that few particles need. Before it every particle has a result; inside
it, that result is overwritten by `where(condition, dear, result)`, so that no particle's value depends on its neighbours.
"""
