"""A short list of combinations that holds every pair of values of any two factors."""

import itertools


def pairs_of(row):
    """All pairs ((factor, value), (factor, value)) in a row {factor: value}."""
    return set(itertools.combinations(row.items(), 2))


def full_product(factors):
    """All rows {factor: value} of `factors` {name: values}, in order."""
    return [dict(zip(factors, values, strict=True)) for values in itertools.product(*factors.values())]


def every_pair(factors):
    """Rows of the full product that hold every pair of values: time and again the first one with the most new pairs."""
    rows = full_product(factors)
    missing = set().union(*map(pairs_of, rows))
    chosen = []
    while missing:
        best = max(rows, key=lambda row: len(missing & pairs_of(row)))
        missing -= pairs_of(best)
        chosen.append(best)
    return chosen
