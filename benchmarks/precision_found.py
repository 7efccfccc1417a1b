"""What the rows of benchmarks/work_precision.py say: errors, times, who is soonest at an error, beside peers."""

import statistics
from dataclasses import dataclass, replace

import precision_cases
from precision_arithmetic import cost_to_reach
from precision_plan import COMMON, PEER_CASES, Point

LEVELS = (1e-1, 3e-2, 1e-2, 3e-3)
CODES_OF_PEERS = ("taichi", "warp", "kratos")  # with which the schemes of peers begin


@dataclass(frozen=True)
class Run:
    """A point that came to its end: error, and seconds of each timed run (none where times were not asked for)."""

    point: Point
    row: dict
    error: float
    times: tuple

    @property
    def seconds(self):
        return statistics.median(self.times)

    @property
    def particle_steps(self):
        return self.row["particles"] * self.row["steps"]

    @property
    def ns(self):
        return 1e9 * self.seconds / self.particle_steps


@dataclass(frozen=True)
class Claim:
    """Who is sooner at an error: the fastest of pmpm's options or a peer; None: the peer does not get there."""

    case: str
    level: float
    peer: str
    mine: float | None
    option: str
    theirs: float | None

    @property
    def lost(self):
        return self.theirs is not None and (self.mine is None or self.theirs < self.mine)


class Found:
    """All that a call of the benchmark knows, and what follows from it."""

    def __init__(self, wanted, rows, setting, quick, minutes, absent):
        self.wanted, self.rows, self.setting, self.quick, self.minutes = wanted, rows, setting, quick, minutes
        self.absent = absent  # peers that are not installed; None: peers were not asked for
        self.runs = {point: run for point in wanted if (run := self.run(point)) is not None}

    @property
    def cases(self):
        return list(dict.fromkeys(point.case for point in self.wanted))

    # ---- runs and series ----

    def run(self, point):
        row = self.rows.error_row(point)
        if row is None or "stopped" in row:
            return None
        error = row.get("e_u")
        if point.case == "sand":
            error = self.sand_error(point, row)
        return error and Run(point, row, error, tuple(self.rows.timed(point)))

    def sand_error(self, point, row):
        finest = max(p.cells for p in self.wanted if p.case == "sand" and p.scheme == point.scheme)
        reference = self.rows.error_row(replace(point, cells=finest))
        if point.cells == finest or reference is None or "quantiles" not in reference:
            return None
        return precision_cases.sand_error(row["quantiles"], reference["quantiles"])

    def series(self, case):
        """dict (scheme, cfl) -> timed runs from coarse to fine."""
        found = {}
        for run in sorted(self.runs.values(), key=lambda run: run.point.cells):
            if run.point.case == case and run.times:
                found.setdefault((run.point.scheme, run.point.cfl), []).append(run)
        return found

    def reached(self, case, level, number=None):
        """dict (scheme, cfl) -> (seconds, exact) to a level of error; with `number`: in that round."""
        found = {}
        for label, runs in self.series(case).items():
            costs = [(run.seconds if number is None else run.times[number % len(run.times)], run.error) for run in runs]
            found[label] = cost_to_reach(costs, level)
        return found

    def best(self, case, level, number=None, common=False):
        """dict scheme -> (seconds, exact, cfl) at its best step, or at the common one; without those that do not get there."""
        found = {}
        for (scheme, cfl), reached in self.reached(case, level, number).items():
            if reached is None or (common and cfl != COMMON):
                continue
            if scheme not in found or reached[0] < found[scheme][0]:
                found[scheme] = (*reached, cfl)
        return found

    def rounds(self, case):
        return max((len(run.times) for run in self.runs.values() if run.point.case == case), default=0)

    def claims(self):
        """A Claim for each case that peers solve, each level and each peer that was run."""
        found = []
        for case in [case for case in self.cases if case in PEER_CASES]:
            peers = list(dict.fromkeys(p.code for p in self.wanted if p.case == case and p.code != "pmpm"))
            for level in LEVELS:
                best = self.best(case, level)
                mine = [(v[0], f"{s}, cfl {v[2]:g}") for s, v in best.items() if not s.startswith(CODES_OF_PEERS)]
                own = min(mine, default=(None, "-"))
                for peer in peers:
                    theirs = min((v[0] for s, v in best.items() if s.startswith(peer)), default=None)
                    found.append(Claim(case, level, peer, *own, theirs))
        return found
