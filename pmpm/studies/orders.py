"""What errors and differences of successive levels say: the order of convergence, the error that is left, and who is ahead.

Refined by two, the error of a scheme of order p is C h^p, and differs between levels by d = C h^p (1 - 2^-p): the order is
log2 of the ratio of successive differences, and what is left at the finest level is d / (2^p - 1) (Richardson 1911; Roache
1998, Verification and Validation in Computational Science and Engineering, chapter 5).
"""

import math
from dataclasses import dataclass

LEAST_ORDER = 0.25  # below, five times the last difference and more would be left: then nothing is known of it
MOST_ORDER = 2.0  # of the schemes here: what shrinks faster does so by chance, and less may not be left for it
ROUNDING = 1e-11  # smaller errors and differences are round-off: they have no order
CLOSE = 1.1  # run times this near to each other are called the same


@dataclass(frozen=True)
class Estimate:
    """What is known of one scheme, per level: `errors` (None: unknown), `differences` to the next level, `orders` as seen from
    a level and coarser ones; `order`: at the finest levels, None where there is none; `verdict`: one phrase."""

    errors: tuple[float | None, ...]
    differences: tuple[float | None, ...]
    orders: tuple[float | None, ...]
    order: float | None
    verdict: str

    @property
    def left(self):
        """(level, error) at the finest level with a known error, or None."""
        known = [(level, error) for level, error in enumerate(self.errors) if error is not None]
        return known[-1] if known else None


def of_errors(errors):
    """The Estimate of errors against an exact solution (None for a run that failed)."""
    orders = [None, *(order_of(a, b) for a, b in zip(errors, errors[1:], strict=False))]
    last = last_known(orders)
    if last is None:
        verdict = "too few levels for an order"
    elif last < LEAST_ORDER:
        verdict = "no order: does not converge"
    else:
        verdict = f"order {last:.2f}"
    converges = last is not None and last >= LEAST_ORDER
    return Estimate(tuple(errors), (None,) * len(errors), tuple(orders), last if converges else None, verdict)


def of_differences(differences):
    """The Estimate of differences between each level and the next one, for one level more than there are differences."""
    levels = len(differences) + 1
    shrinking = [order_of(a, b) for a, b in zip(differences, differences[1:], strict=False)]
    orders = [None, None, *shrinking][:levels]
    kept, last = (*differences, None), last_known(orders)
    unknown = (None,) * levels
    if last is None:
        return Estimate(unknown, kept, tuple(orders), None, "too few levels for an order")
    if last < LEAST_ORDER:
        return Estimate(unknown, kept, tuple(orders), None, "no order: does not converge")
    finest = max(level for level, order in enumerate(orders) if order is not None)
    errors: list[float | None] = [None] * levels
    left = differences[finest - 1] / (2.0 ** min(last, MOST_ORDER) - 1.0)
    errors[finest] = left
    for level in range(finest - 1, -1, -1):
        if differences[level] is None:
            break
        left += differences[level]
        errors[level] = left
    return Estimate(tuple(errors), kept, tuple(orders), last, f"order {last:.2f}")


def order_of(coarse, fine):
    """log2 of a ratio; None where one of the two is missing or says nothing."""
    if coarse is None or fine is None or not (ROUNDING < coarse < math.inf and ROUNDING < fine < math.inf):
        return None
    return math.log2(coarse / fine)


def last_known(values):
    return next((value for value in reversed(values) if value is not None), None)


# ---- who is ahead ----------------------------------------------------------------------------------------------------------


def seconds_to(points, error):
    """Run time (s) at which a scheme reaches an error, on straight lines in logarithms through its (seconds, error); None if it
    does not. Nothing is known beyond its finest and coarsest runs: a scheme that begins better has its coarsest run's time."""
    before = None
    for seconds, reached in points:
        if reached <= error:
            if before is None or before[1] <= reached or reached <= 0.0:
                return seconds
            part = math.log(before[1] / error) / math.log(before[1] / reached)
            return before[0] * (seconds / before[0]) ** part
        before = (seconds, reached)
    return None


def targets(points_of):
    """Round errors between the best and the worst that were reached: 1, 2 and 5 of each power of ten, largest first."""
    reached = [error for points in points_of.values() for _, error in points if 0.0 < error < math.inf]
    if not reached:
        return []
    powers = range(math.floor(math.log10(min(reached))), math.ceil(math.log10(max(reached))) + 1)
    found = [step * 10.0**power for power in powers for step in (1, 2, 5)]
    return sorted((e for e in found if min(reached) <= e <= max(reached)), reverse=True) or [max(reached)]


def winners(points_of):
    """[(error, {scheme: seconds} fastest first)] for each target that any scheme reaches."""
    found = []
    for error in targets(points_of):
        times = {scheme: seconds_to(points, error) for scheme, points in points_of.items()}
        ordered = sorted((seconds, scheme) for scheme, seconds in times.items() if seconds is not None)
        if ordered:
            found.append((error, {scheme: seconds for seconds, scheme in ordered}))
    return found


def sentence(points_of):
    """Which scheme buys most accuracy per second; `points_of`: {scheme: [(seconds, error), coarse first]}."""
    if not any(points_of.values()):
        return "No error is known for any scheme: nothing can be said of accuracy per second."
    reached = winners(points_of)
    said = [first_of(times) for _, times in reached]
    parts, start = [], 0
    for end in range(1, len(said) + 1):
        if end == len(said) or said[end] != said[start]:
            parts.append((said[start], reached[start][0], reached[end - 1][0]))
            start = end
    ahead = [ahead_text(*part) for part in parts]
    error, times = reached[-1]
    closing = ", ".join(f"{scheme} {seconds:.3g} s" for scheme, seconds in times.items())
    missed = [scheme for scheme in points_of if scheme not in times]
    closing += f"; {', '.join(missed)} {'does' if len(missed) == 1 else 'do'} not" if missed else ""
    return f"Most accuracy per second: {'; '.join(ahead)}. An error of {error:.2g} is reached after {closing}."


def first_of(times):
    """Schemes that come first, those that are as good as level with the first among them."""
    best = min(times.values())
    return tuple(scheme for scheme, seconds in times.items() if seconds <= CLOSE * best)


def ahead_text(schemes, largest, smallest):
    who = " and ".join(sorted(schemes)) + (" alike" if len(schemes) > 1 else "")
    return f"{who} at {f'errors of {largest:.2g} to {smallest:.2g}' if smallest < largest else f'an error of {largest:.2g}'}"
