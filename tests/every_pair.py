"""A short list of combinations that holds every pair of values of any two factors."""

import itertools


def pairs_of(row):
    """All pairs ((factor, value), (factor, value)) in a row {factor: value}."""
    return set(itertools.combinations(row.items(), 2))


def full_product(factors, allowed=lambda row: True):
    """All allowed rows {factor: value} of `factors` {name: values}, in order."""
    rows = [dict(zip(factors, values, strict=True)) for values in itertools.product(*factors.values())]
    return [row for row in rows if allowed(row)]


def every_pair(factors, allowed=lambda row: True):
    """Rows, as far as allowed, that hold every pair of values: time and again the first one with the most new pairs."""
    rows = full_product(factors, allowed)
    missing = set().union(*map(pairs_of, rows))
    chosen = []
    while missing:
        best = max(rows, key=lambda row: len(missing & pairs_of(row)))
        missing -= pairs_of(best)
        chosen.append(best)
    return chosen
