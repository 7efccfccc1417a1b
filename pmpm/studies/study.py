"""A study from its plan to its table: run what has not been run yet, compare the levels, and say what came out."""

import contextlib
import time as clock
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from pmpm.output.files import OutputError, on_rank_zero, write_atomically
from pmpm.output.progress import Progress
from pmpm.parallel import comm as communication
from pmpm.requests import Requests, reason
from pmpm.run import OutputFailure
from pmpm.studies import orders, picture, report
from pmpm.studies.folder import PAGE, PICTURE, TABLE, StudyFolder
from pmpm.studies.plan import SPACE, Options, plan
from pmpm.studies.runs import FINISHED, Stopped, run_entry
from pmpm.studies.samples import QUANTITIES, differences

INTERVAL = 60.0  # s between lines of progress within a run, where there is no terminal


class StudyStopped(Exception):  # noqa: N818
    """A study was asked to stop; what had ended is kept. The text is for the user."""


@dataclass(frozen=True)
class Scheme:
    """What came out for one scheme: its rows, coarse first, and {quantity: orders.Estimate}, the first of which is shown."""

    label: str
    rows: tuple[dict[str, Any], ...]
    estimates: dict[str, orders.Estimate]

    @property
    def estimate(self):
        """Of the displacement."""
        return self.estimates["displacement"]

    @property
    def points(self):
        """[(seconds, error)] of the runs whose error is known, coarse first."""
        pairs = zip(self.rows, self.estimate.errors, strict=True)
        return [(row["seconds"], error) for row, error in pairs if error is not None and row["status"] == FINISHED]


@dataclass(frozen=True)
class Study:
    """The outcome of a study: schemes in the order in which they were asked for, and what is said of them."""

    path: Path
    title: str
    exact: bool
    refine: str
    schemes: tuple[Scheme, ...]
    left_out: dict[str, str]
    facts: dict[str, Any]
    apart: dict[str, tuple[str, float]] = field(default_factory=dict)

    @property
    def rows(self):
        """All rows, scheme after scheme."""
        return [row for scheme in self.schemes for row in scheme.rows]

    @property
    def sentence(self):
        """Which scheme buys most accuracy per second."""
        return orders.sentence({scheme.label: scheme.points for scheme in self.schemes})

    @property
    def text(self):
        """The table, for a terminal."""
        return report.text(self)


def study(scene, out, comm=None, *, levels=3, refine=SPACE, transfer=(), shape_function=(), precision=(), cfl=(),
          until=None, repeat=1, overwrite=False, quiet=False):  # fmt: skip
    """Refine a scene level by level in several schemes and return the Study: errors, orders and run times. Collective.

    `scene`: a Scene, or a function that returns one for cells that are 1, 2, 4 ... times as small; `out`: folder of the study,
    in which a study that was interrupted goes on; `transfer` ... `cfl`: values to compare. Raises SceneError and OutputError
    before anything is run, later OutputFailure, and StudyStopped on SIGINT and SIGTERM.
    """
    given = {"transfer": transfer, "shape_function": shape_function, "precision": precision, "cfl": cfl}
    axes = {
        name: (values,) if isinstance(values, str | float | int) else tuple(values) for name, values in given.items()
    }
    options = Options(levels=levels, refine=refine, until=until, repeat=repeat, **axes)
    return carry_out(scene, options, out, comm, overwrite, quiet)


def carry_out(scene, options, out, comm=None, overwrite=False, quiet=False, early=()):
    """`study` with its Options; `early`: signals that have come before."""
    comm = communication.adopt(comm)
    planned = plan(scene, options, comm)
    folder = StudyFolder(out, planned, comm, overwrite)
    try:
        tell = Teller(planned, comm, quiet)
        requests = Requests(comm)
        with requests.listening(early):
            rows = run_all(planned, folder, comm, tell, requests)
        # Rank 0 alone reads what is compared; what it finds is for all.
        found = on_rank_zero(comm, lambda: outcome(planned, folder, rows, comm.size))
        note = on_rank_zero(comm, lambda: write(found))
        tell.line(f"{folder.path}: {TABLE}, {PAGE}{f'; {note}' if note else f' and {PICTURE}'}")
    except OutputError as error:
        raise OutputFailure(f"{error}; runs that had ended are kept: the same command goes on from there") from error
    finally:
        folder.close()
    return found


def run_all(planned, folder, comm, tell, requests):
    """{number: row} of all runs, those of an earlier start among them. Raises StudyStopped."""
    rows = folder.rows()
    tell.beginning(rows)
    for entry in planned.entries:
        if entry.number in rows:
            continue
        tell.run(entry)
        with contextlib.suppress(Stopped):
            row, samples = run_entry(entry, planned, comm, tell.progress, requests)
            rows[entry.number] = folder.keep(row | {"ranks": comm.size, "machine": report.machine()}, samples)
            tell.done(row)
        asked = int(comm.max(np.array([requests.heard]))[0])
        if asked and len(rows) < len(planned.entries):
            raise StudyStopped(
                f"stopped on request ({reason(asked)}): {len(rows)} of {len(planned.entries)} runs have ended and are kept in "
                f"{folder.path}: the same command goes on from there"
            )
    return rows


class Teller:
    """What a person who watches the study sees: a line when a run begins and one when it ends; rank 0 speaks."""

    def __init__(self, planned, comm, quiet):
        self.planned, self.comm = planned, comm
        self.speaker = Progress(0.0, comm, quiet=quiet)

    def line(self, text):
        self.speaker.stage(text)

    def beginning(self, rows):
        """Say how much there is to do."""
        planned = self.planned
        total = len(planned.entries)
        for label, why in planned.left_out.items():
            self.line(f"left out: {label}: {why}")
        self.line(f"{total} runs, about {planned.particle_steps:.2g} particle-steps")
        if rows:
            self.line(f"{len(rows)} of them have ended before and are not repeated")

    def run(self, entry):
        """Say which run begins."""
        scene = entry.scene
        step = f"cfl {scene.time.cfl:g}" if scene.time.step is None else f"step {scene.time.step:g} s"
        self.line(
            f"[{entry.number + 1}/{len(self.planned.entries)}] {entry.scheme}, cells of {scene.domain.cell_size:g} m, "
            f"{step}: about {entry.estimated_particles:.3g} particles, {entry.estimated_steps:.3g} steps"
        )

    def progress(self, simulation):
        """An observer for one run: a live bar on a terminal."""
        if self.speaker.on_terminal:
            return Progress(simulation.scene.time.end, self.comm)
        return Lines(self)

    def done(self, row):
        if row["status"] != FINISHED:
            self.line(f"    failed: {row['cause']}")
        else:
            start = row["compile_seconds"] + row["startup_seconds"]
            self.line(f"    {row['steps']} steps in {row['seconds']:.3g} s, after a start of {start:.2g} s")


class Lines:
    """Observer, called after every step, that says now and then how far a run is."""

    def __init__(self, teller):
        self.teller, self.due = teller, clock.monotonic() + INTERVAL

    def __call__(self, simulation):
        if clock.monotonic() >= self.due:
            self.due += INTERVAL
            self.teller.line(
                f"    t = {simulation.time:.6g} s of {simulation.scene.time.end:g} s, step {simulation.step_count}"
            )

    def finish(self, simulation):
        """Say nothing: the study has a line of its own for the end of a run."""


# ---- what came out ---------------------------------------------------------------------------------------------------------


def outcome(planned, folder, rows, ranks):
    """The Study of all rows."""
    exact = planned.base.exact is not None
    schemes = []
    for label in planned.schemes:
        own = tuple(rows[entry.number] for entry in planned.entries if entry.scheme == label)
        estimates = exact_estimates(own) if exact else own_estimates(own, folder, planned)
        schemes.append(Scheme(label, own, estimates))
    title = planned.base.title or "a scene without a title"
    apart = {} if exact else finest_apart(schemes, folder, planned)
    facts = report.facts(planned, rows, ranks)
    return Study(folder.path, title, exact, planned.options.refine, tuple(schemes), planned.left_out, facts, apart)


def exact_estimates(rows):
    """{quantity: Estimate} of errors against the exact solution."""
    names = [key.removeprefix("error_") for row in rows for key in row if key.startswith("error_")]
    names = list(dict.fromkeys(name for name in names if not name.endswith("_end"))) or ["displacement"]
    return {name: orders.of_errors([row.get(f"error_{name}") for row in rows]) for name in names}


def own_estimates(rows, folder, planned):
    """{quantity: Estimate} of the differences between successive levels, the largest over time."""
    found: dict[str, list[float | None]] = {name: [] for name in QUANTITIES}
    for coarse, fine in zip(rows, rows[1:], strict=False):
        largest = compared(coarse, fine, folder, planned)
        for name in QUANTITIES:
            found[name].append(largest and largest[name])
    return {name: orders.of_differences(values) for name, values in found.items()}


def compared(coarse, fine, folder, planned):
    """{quantity: largest difference over time} between two runs; None where one of them failed."""
    if not (coarse["status"] == fine["status"] == FINISHED):
        return None
    domain = planned.base.domain
    lengths = [size if axis in domain.periodic else 0.0 for axis, size in zip("xyz", domain.size, strict=False)]
    between = differences(folder.samples(coarse["number"]), folder.samples(fine["number"]), np.array(lengths))
    return {name: float(values.max()) for name, values in between.items()}


def finest_apart(schemes, folder, planned):
    """{scheme: (that with the smallest error left, difference of displacements between the finest runs of both)}."""
    ended = [scheme for scheme in schemes if scheme.rows[-1]["status"] == FINISHED]
    known = [scheme for scheme in ended if scheme.estimate.left]
    if not known:
        return {}
    best = min(known, key=lambda scheme: scheme.estimate.left[1])
    others = [scheme for scheme in ended if scheme is not best]
    return {
        other.label: (best.label, compared(other.rows[-1], best.rows[-1], folder, planned)["displacement"])
        for other in others
    }


def write(found):
    """Write tables and picture; returns None, or why there is no picture."""
    write_atomically(found.path / TABLE, report.csv_text(found))
    note = picture.draw(found, found.path / PICTURE)
    write_atomically(found.path / PAGE, report.page(found, None if note else PICTURE))
    return note
