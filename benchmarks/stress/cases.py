"""All cases of the matrix, row by row."""

from . import extremes, impacts, inverted, lonely, long_runs, places, ranks, refused, snow_crush, solids, steps, units

FAMILIES = (solids, steps, inverted, snow_crush, impacts, lonely, places, ranks, units, long_runs, extremes, refused)
CASES = tuple(sorted((case for family in FAMILIES for case in family.CASES), key=lambda case: int(case.row[1:])))
