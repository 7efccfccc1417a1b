"""The arithmetic of benchmarks/work_precision.py: Pareto fronts, time to reach an error, ranks with their spread, orders."""

import math
import statistics


def pareto(points):
    """Those of (cost, error, label) that no other beats in one and equals in the other, by rising cost."""
    front, least = [], math.inf
    for point in sorted(points, key=lambda point: point[:2]):
        if point[1] < least:
            front.append(point)
            least = point[1]
    return front


def cost_to_reach(series, level):
    """(cost, exact) at which a series of (cost, error), from coarse to fine, first gets down to `level`; None if it does not.

    Between two runs the cost is interpolated in logarithms. `exact` is False where the coarsest run is below the level already:
    then the cost is that of this run, and a bound from above.
    """
    if not series:
        return None
    if series[0][1] <= level:
        return series[0][0], False
    found = []
    for (cost, error), (finer_cost, finer_error) in zip(series, series[1:], strict=False):
        if finer_error <= level < error:
            part = math.log(error / level) / math.log(error / finer_error)
            found.append(cost * (finer_cost / cost) ** part)
    return (min(found), True) if found else None


def ranks(times):
    """dict label -> (rank, best rank, worst rank) from dict label -> times, one per round; by median, 1 is the fastest.

    A label's best rank counts only those before it whose slowest round is faster than its own fastest, its worst rank all whose
    fastest round is not slower than its own slowest: what overlapping bars leave open.
    """
    by_median = sorted(times, key=lambda label: statistics.median(times[label]))
    found = {}
    for place, label in enumerate(by_median, 1):
        low, high = min(times[label]), max(times[label])
        others = [values for other, values in times.items() if other != label]
        surely_before = sum(max(values) < low for values in others)
        perhaps_before = sum(min(values) <= high for values in others)
        found[label] = place, 1 + surely_before, 1 + perhaps_before
    return found


def order(cells, errors):
    """Observed order between the two finest runs of a series; None without two of them."""
    pairs = sorted(zip(cells, errors, strict=True))
    if len(pairs) < 2:
        return None
    (coarse, large), (fine, small) = pairs[-2:]
    return math.log(large / small) / math.log(fine / coarse)
