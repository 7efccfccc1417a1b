"""Error against run time: which scheme, spline, precision, step and particle number reaches an error soonest, beside peers.

    python benchmarks/work_precision.py [--quick] [--docs docs] [--out FOLDER] [--peers] [--cases NAME ...] [--rounds N]

Needs one core that nothing else runs on, 4 GB and the extra `viz`; with --peers Taichi and Warp (the extra `bench`), which
solve the same cases on the same core in turns, and KratosMultiphysics, KratosMPMApplication and
KratosLinearSolversApplication, if they are there. It says first about how long it will take: over an hour in full, under 10
minutes with --quick, compiling included. Each run is a line of FOLDER/rows.jsonl as soon as it is done; the same command goes
on where it was stopped. With --docs it writes results/work_precision.md, results/work_precision.csv and
pictures/work_precision*.png there.

Errors and times come from different runs of a point: the first takes the error and warms up, the others (5; --quick: 3), a
round over all points each, are timed with nobody watching. Seconds are those of stepping: `Simulation.stretch` of pmpm, the
loop over steps of a peer. Exits with 1 where a peer does not have pmpm's error with the same scheme, or where a peer reaches
an error sooner than pmpm and no reason stands in REASONS.
"""

import argparse
import importlib.util
import json
import math
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import machine
import precision_cases
import precision_plan
import work_precision_page as page
from contest import Child, ContestantError
from precision_found import Found
from precision_plan import Point, plan
from stages import Progress

HERE = Path(__file__).resolve().parent
ERROR_ROUND = 0
CALL = "a call"  # key of the rows that say how long each call of this benchmark took
# A peer's error beside pmpm's with the same scheme, grid, step and precision may differ by what rounding positions in each step
# adds up to as a random walk, relative to the largest RMS displacement, times this for what else is rounded.
ROUNDED = 4.0
LAST_PLACE = {"float64": 2.0**-53, "float32": 2.0**-24}
PACKAGES = ("numba", "numpy", "mpi4py", "taichi", "warp-lang", "KratosMultiphysics", "KratosMPMApplication")
PEER_PACKAGES = {"taichi": "taichi", "warp": "warp", "kratos": "KratosMultiphysics"}
STARTUPS = (
    Point("waves 2-D", 32),
    Point("waves 2-D", 32, precision="float32"),
    Point("waves 3-D", 8),
    Point("waves 2-D", 32, code="taichi", precision="float32"),
    Point("waves 3-D", 8, code="taichi", precision="float32"),
    Point("waves 2-D", 32, code="warp", precision="float32"),
    Point("waves 3-D", 8, code="warp", precision="float32"),
)
# Why a peer reaches an error sooner than pmpm: (case, error, peer) -> reason.
REASONS: dict[tuple[str, float, str], str] = {}


# ---- rows ------------------------------------------------------------------------------------------------------------------


class Rows:
    """What is known so far: one JSON line per run in a file, which a later call goes on with."""

    def __init__(self, folder, setting):
        folder.mkdir(parents=True, exist_ok=True)
        self.path, first = folder / "rows.jsonl", folder / "setting.json"
        if first.exists() and json.loads(first.read_text(encoding="utf-8")) != setting:
            raise SystemExit(
                f"{first} is of another machine or state of the code: take another --out, or remove {folder}"
            )
        first.write_text(json.dumps(setting, indent=1), encoding="utf-8")
        lines = self.path.read_text(encoding="utf-8").splitlines() if self.path.exists() else []
        whole = [line for line in lines if line.endswith("}")]  # all but one, if a call was killed while it wrote
        self.path.write_text("".join(f"{line}\n" for line in whole), encoding="utf-8")
        rows = map(json.loads, whole)
        self.known = {(row["key"], row["round"]): row for row in rows}

    def __contains__(self, place):
        return place in self.known

    def add(self, key, number, found):
        row = {"key": key, "round": number, **found}
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")
        self.known[key, number] = row
        return row

    def error_row(self, point):
        return self.known.get((point.key, ERROR_ROUND))

    def timed(self, point):
        """Seconds of each timed run."""
        numbers = sorted(number for key, number in self.known if key == point.key and number > ERROR_ROUND)
        rows = [self.known[point.key, number] for number in numbers]
        return [row["seconds"] for row in rows if "seconds" in row]


# ---- running ---------------------------------------------------------------------------------------------------------------


class Codes:
    """A child process per code and precision, started when first asked and again if it has died."""

    def __init__(self, core, folder):
        self.core, self.children = core, {}
        self.environment = {
            "WARP_CACHE_PATH": str(folder / "warp_cache"),
            "TI_OFFLINE_CACHE_FILE_PATH": str(folder / "taichi_cache"),
        }

    def run(self, point, observe):
        name = point.code, point.precision if point.code != "pmpm" else ""
        if name not in self.children:
            self.children[name] = Child("precision_child", [point.code], [self.core], environment=self.environment)
        try:
            return self.children[name].ask(point=point.table, observe=observe)
        except ContestantError as error:
            self.children.pop(name).end()
            return {"stopped": f"the process ended: {error}"}

    def close(self):
        for child in self.children.values():
            child.end()


def places(wanted):
    """(point, round) in the order in which they are run: rounds outermost, so that a slow minute hits few runs of a point."""
    most = max(wanted.values(), default=0)
    return [
        (p, n) for n in range(ERROR_ROUND, most + 1) for p, rounds in wanted.items() if n <= max(rounds, ERROR_ROUND)
    ]


def estimate(todo, known_kernels):
    """About how many seconds these runs take, on one core of a machine like that of docs/results/kernels.md."""
    total, compiled = 0.0, set(known_kernels)
    for point, _ in todo:
        particles, steps = precision_cases.particles(point), precision_cases.expected_steps(point)
        total += precision_plan.seconds_of(point, particles, steps) + precision_plan.TO_BUILD[point.code]
        kernels = precision_plan.kernels_of(point)
        if kernels not in compiled:
            compiled.add(kernels)
            total += precision_plan.TO_COMPILE[point.code, precision_cases.dim(point.case)]
    return total


def measure(wanted, rows, codes):
    todo = [(point, number) for point, number in places(wanted) if (point.key, number) not in rows]
    done = [point for point in wanted if (point.key, ERROR_ROUND) in rows]
    expected = estimate(todo, map(precision_plan.kernels_of, done))
    print(f"{len(todo)} runs of {len(wanted)} points, about {expected / 60.0:.0f} minutes", flush=True)
    progress = Progress(len(todo))
    for point, number in todo:
        first = rows.error_row(point)
        if number > ERROR_ROUND and first is not None and "stopped" in first:
            found = {"stopped": first["stopped"]}
        else:
            found = codes.run(point, observe=number == ERROR_ROUND)
        row = rows.add(point.key, number, found)
        progress.tell(f"round {number}: {point.key}: {told(row)}")


def told(row):
    if "stopped" in row:
        return f"stopped: {row['stopped']}"
    seconds = "" if row["seconds"] is None else f"{row['seconds']:.3g} s, "
    error = f", e_u {row['e_u']:.3g}" if "e_u" in row else ""
    return f"{seconds}{row['steps']} steps{error}"


def measure_startups(rows, peers, core):
    """Each code in a process of its own, with an empty folder for what it compiles, and once more with what is there then."""
    for point in STARTUPS:
        if point.code != "pmpm" and (not peers or importlib.util.find_spec(point.code) is None):
            continue
        key = f"start-up: {point.key}"
        if (key, 0) in rows:
            continue
        with tempfile.TemporaryDirectory() as folder:
            print(f"start-up of {point.key}", flush=True)
            cold, cached = (startup(point, core, folder) for _ in range(2))
        rows.add(key, 0, {"cold": cold["seconds"], "cached": cached["seconds"], "rss": cached["rss"]})


def startup(point, core, folder):
    # A peer takes its particles from pmpm, whose kernels are not to be compiled for that.
    caches = {"pmpm": "PMPM_CACHE_DIR", "warp": "WARP_CACHE_PATH", "taichi": "TI_OFFLINE_CACHE_FILE_PATH"}
    command = [sys.executable, str(HERE / "precision_child.py"), point.code, "--cores", str(core)]
    environment = {**os.environ, caches[point.code]: folder, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        [*command, "--startup", json.dumps(point.table)], check=True, capture_output=True, text=True, env=environment
    )
    return json.loads(done.stdout.strip().splitlines()[-1])


# ---- verdicts ---------------------------------------------------------------------------------------------------------------


def disagreements(wanted, rows):
    """One line per peer's run whose error is not that of the same scheme in pmpm, and how many pairs were compared."""
    lines, compared = [], 0
    for point in wanted:
        if point.code == "pmpm" or point.code not in ("taichi", "warp"):
            continue
        twin = Point(point.case, point.cells, precision=point.precision, cfl=point.cfl)
        mine, theirs = rows.error_row(twin), rows.error_row(point)
        if not mine or not theirs or "e_u" not in mine or "e_u" not in theirs:
            continue
        compared += 1
        walk = math.sqrt(theirs["steps"]) * LAST_PLACE[point.precision] * theirs["farthest"] / theirs["reference"]
        if abs(theirs["e_u"] - mine["e_u"]) > ROUNDED * walk:
            lines.append(f"{point.key}: e_u {theirs['e_u']:.9g}, pmpm with the same scheme {mine['e_u']:.9g}")
    return lines, compared


def beaten(claims):
    """One line per error that a peer reaches sooner than pmpm, for which no reason is stated."""
    return [
        f"{claim.case}, e_u {claim.level:g}: {claim.peer} in {claim.theirs:.3g} s, pmpm in {claim.mine:.3g} s"
        for claim in claims
        if claim.lost and (claim.case, claim.level, claim.peer) not in REASONS
    ]


# ---- the machine ------------------------------------------------------------------------------------------------------------


def setting():
    return {"processor": machine.processor(), "versions": machine.versions(PACKAGES), "commit": machine.commit()}


def main():
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--quick", action="store_true", help="small sizes and three rounds")
    options.add_argument("--docs", type=Path, help="write page and pictures here")
    options.add_argument(
        "--out", type=Path, help="folder of the rows (runs/work_precision, with --quick runs/work_precision_quick)"
    )
    options.add_argument("--peers", action="store_true", help="run Taichi, Warp and Kratos beside pmpm")
    options.add_argument("--cases", nargs="+", choices=list(precision_plan.SIZES), help="only these")
    options.add_argument("--rounds", type=int, help="timed runs of each point")
    given = options.parse_args()
    core = min(os.sched_getaffinity(0))
    began = time.perf_counter()
    absent = {code for code, package in PEER_PACKAGES.items() if importlib.util.find_spec(package) is None}
    wanted = plan(given.quick, given.peers, given.cases, given.rounds)
    wanted = {point: rounds for point, rounds in wanted.items() if point.code not in absent}
    out = given.out or Path("runs", "work_precision_quick" if given.quick else "work_precision")
    rows = Rows(out, setting() | {"quick": given.quick})
    codes = Codes(core, out.resolve())
    try:
        measure(wanted, rows, codes)
        measure_startups(rows, given.peers, core)
    finally:
        codes.close()
        rows.add(CALL, time.time(), {"spent": time.perf_counter() - began})
    minutes = sum(row["spent"] for (key, _), row in rows.known.items() if key == CALL) / 60.0
    found = Found(wanted, rows, setting(), given.quick, minutes, absent if given.peers else None)
    lines, compared = disagreements(wanted, rows)
    failed = [f"a peer's error differs: {line}" for line in lines]
    failed += [f"a peer is sooner: {line}" for line in beaten(found.claims())]
    print(page.tables(found, REASONS))
    if given.docs:
        page.write(given.docs, found, REASONS, compared, failed)
    print("\n".join(f"FAILED: {line}" for line in failed) or "all musts hold")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
