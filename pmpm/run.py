"""One run from scene to finished folder: the simulation with the built-in outputs attached to it."""

from pmpm import restart
from pmpm.failure import NumericalFailure
from pmpm.output import checkpoints, run_directory
from pmpm.output.diagnostics import Diagnostics
from pmpm.output.files import OutputError, on_rank_zero
from pmpm.output.progress import Progress
from pmpm.output.run_directory import GRID_INDEX, MAPS
from pmpm.output.snapshots import SnapshotWriter, write_failed
from pmpm.requests import Requests, reason
from pmpm.simulation import Simulation
from pmpm.watching import CHECKPOINT, STOP


class Once:
    """Calls an output at most once per step, so that the last state is written whatever the interval.

    `step`: for which it has been called before a restart, if so.
    """

    def __init__(self, call, step=None):
        self.call, self.step = call, step

    def __call__(self, simulation):
        if self.step != simulation.step_count:
            self.step = simulation.step_count
            self.call(simulation)


class OutputFailure(Exception):  # noqa: N818
    """A run that had begun has stopped because something could not be written; the text is for the user."""


def run_scene(
    scene,
    out,
    comm,
    until=None,
    steps=None,
    overwrite=False,
    quiet=False,
    origin=None,
    deadline=None,
    early=(),
    threads=1,
    backend="cpu",
):
    """Run a scene into the folder `out` and return the Simulation. Collective.

    `origin`: a restart.Origin to go on from; `deadline`: when to stop by time.time(); `early`: signals that have come before;
    `threads`: per rank; `backend`: cpu or cuda. The run stops early on SIGTERM, SIGINT and SIGUSR1 too, with a checkpoint.
    Raises SceneError or OutputError before anything is written, NumericalFailure and OutputFailure after the folder has been
    closed.
    """
    folder = on_rank_zero(comm, lambda: restart.check_folder(out, overwrite, origin))
    progress = Progress(scene.time.end, comm, quiet=quiet)
    requests = Requests(comm, deadline, scene.output.checkpoint_wall_interval)
    with requests.listening(early):
        if origin is None:
            simulation = Simulation(scene, comm, progress.stage, threads=threads, backend=backend)
        else:
            simulation = Simulation.go_on(origin, scene, comm, progress.stage, threads, backend)
        directory = open_folder(folder, simulation, origin, overwrite)
        progress.directory = directory
        status, report, outputs = "failed", {}, None
        try:
            outputs = Outputs(simulation, directory, progress, requests, origin)
            outputs.run(until, steps)
            status, report = end_status(simulation), simulation.report()
        except NumericalFailure as failure:
            text = f"{failure}{outputs.keep_failed(failure) if outputs else ''}"
            directory.log(text)
            report = {"failure": text} | simulation.report()
            raise NumericalFailure(text) from failure
        except OutputError as error:
            text = f"{error}; {outputs.newest_text()}" if outputs else str(error)
            directory.log(text)
            report = {"failure": text}
            raise OutputFailure(text) from error
        finally:
            directory.finish(status, report)
    return simulation


def open_folder(folder, simulation, origin, overwrite):
    """The RunDirectory of a run that begins, or goes on in its own folder or in a new one."""
    scene, comm = simulation.scene.to_toml(), simulation.comm
    if origin is None:
        return run_directory.RunDirectory.create(folder, scene, comm, overwrite)
    beginning = {"checkpoint": str(origin.path), "step": simulation.step_count, "time": simulation.time}
    if folder == origin.run:
        return run_directory.RunDirectory.resume(
            folder, scene, comm, beginning, simulation.outputs, origin.newer, origin.beside
        )
    return run_directory.RunDirectory.create(folder, scene, comm, overwrite, beginning)


def end_status(simulation):
    if simulation.finished:
        return "finished"
    return f"stopped on request: {reason(simulation.asked)}" if simulation.asked >= STOP else "stopped early"


def series_of(simulation, directory):
    """What writes the probes and gauges of a scene; None without any."""
    if not (simulation.scene.output.probes or simulation.scene.output.gauges):
        return None
    from pmpm.series import Series

    return Series(simulation, directory)


def maps_of(simulation, origin):
    """The Maps that a scene asks for; None without any."""
    if not simulation.scene.output.maps:
        return None
    from pmpm.maps import continued

    return continued(simulation, simulation.scene.output.maps, origin and origin.path)


def grids_of(simulation, directory, origin):
    """The GridWriter of a scene that asks for fields on nodes, else None."""
    output, first = simulation.scene.output, simulation.outputs.get("snapshots", 0)
    if output.grid_fields:
        from pmpm.grid_fields import of_nodes
        from pmpm.output.grids import GridWriter

        return GridWriter(directory, simulation.scene, of_nodes, first)
    if origin:
        drop_from_index(directory, simulation.scene.title)
    return None


def drop_from_index(directory, title):
    """Leave out of the index of fields on nodes what a restart has cut off, where the scene asks for no more of them."""
    if on_rank_zero(directory.comm, lambda: (directory.path / GRID_INDEX).exists()):
        from pmpm.output.grids import rewrite_index

        rewrite_index(directory, title)


def write_maps(path, comm, arrays):
    from pmpm.maps import write

    write(path, comm, arrays)


class Outputs:
    """All that watches a run: progress, snapshots, diagnostics, checkpoints, the copy kept for a failure, and requests."""

    def __init__(self, simulation, directory, progress, requests, origin):
        self.simulation, self.directory, self.requests, self.origin = simulation, directory, requests, origin
        scene, before = simulation.scene, simulation.outputs
        self.progress = progress
        self.snapshots = SnapshotWriter(directory, scene, first=before.get("snapshots", 0))
        self.diagnostics = Diagnostics(directory, before.get("diagnostics", 0))
        # In another folder, where a run branches off, the first state is not a second one.
        at = before if origin and directory.path == origin.run else {}
        self.grids = grids_of(simulation, directory, origin)
        self.last_snapshot = Once(self.shown, at.get("snapshot_step"))
        self.series, self.maps = series_of(simulation, directory), maps_of(simulation, origin)
        self.last_diagnostics = Once(self.measured, at.get("diagnostics_step"))
        bad = [number for number, _ in origin.complaints] if origin else []
        self.checkpoints = checkpoints.CheckpointWriter(
            directory, scene.output.checkpoint_keep, self.counts, bad=bad, beside=self.beside
        )
        self.copy = None
        for note in (*(origin.notes(simulation) if origin else ()), *simulation.notes):
            progress.stage(note)

    def counts(self):
        """How much there is of what is counted, and after which step the last one came, as a checkpoint holds it."""
        steps = {"snapshot_step": self.last_snapshot.step, "diagnostics_step": self.last_diagnostics.step}
        known = {name: step for name, step in steps.items() if step is not None}
        lines = self.series.counts() if self.series else {}
        return {"snapshots": self.snapshots.count, "diagnostics": self.diagnostics.count} | known | lines

    def shown(self, simulation):
        number = self.snapshots.count
        if self.grids:  # first: what the snapshots' index lists is whole
            self.grids(simulation, number)
        self.snapshots(simulation)

    def measured(self, simulation):
        self.diagnostics(simulation)
        if self.series:
            self.series(simulation)

    def run(self, until, steps):
        """Run the simulation with everything attached, and write what belongs to its end."""
        simulation, begins = self.simulation, self.origin is None
        output, guard = simulation.scene.output, simulation.scene.guard
        snapshots, diagnostics = self.last_snapshot, self.last_diagnostics
        simulation.every(snapshots, seconds=output.snapshot_interval, at_start=begins, name="snapshots")
        simulation.every(diagnostics, seconds=output.diagnostics_interval, at_start=begins, name="diagnostics")
        simulation.every(self.progress, steps=1, at_start=True)
        if self.maps:
            simulation.every(self.maps, steps=1, at_start=begins)
        if output.checkpoint_interval is not None:
            simulation.every(self.write_checkpoint, seconds=output.checkpoint_interval, name="checkpoints")
        if guard.keep_copy:
            simulation.every(self.keep_copy, steps=guard.interval, at_start=True)
        simulation.every(self.answer, steps=1)
        simulation.run(until=until, steps=steps)
        if not simulation.finished or output.checkpoint_at_end:
            self.write_checkpoint(simulation)
        if simulation.finished or simulation.asked < STOP:
            snapshots(simulation)
            diagnostics(simulation)
            self.write_maps(simulation)
        self.progress.finish(simulation)
        for note in simulation.closing_notes:
            self.progress.stage(note)

    def answer(self, simulation):
        """Do what all ranks have agreed on, and pass on what this rank is asked for."""
        if simulation.asked == CHECKPOINT:
            self.write_checkpoint(simulation)
            simulation.answered()
        self.requests(simulation)

    def write_checkpoint(self, simulation):
        self.checkpoints(simulation)
        self.write_maps(simulation)
        self.requests.wrote_checkpoint(self.checkpoints.longest)

    def write_maps(self, simulation):
        if self.maps:
            write_maps(self.directory.path / MAPS, simulation.comm, self.maps.arrays(simulation))

    def beside(self, simulation):
        """What a checkpoint holds besides what the simulation needs."""
        return self.maps.datasets(simulation) if self.maps else {}

    def keep_copy(self, simulation):
        self.copy = simulation.state(self.counts()).copy(), self.beside(simulation)

    def keep_failed(self, failure):
        """Write the state that failed, and the copy kept before; returns what to say of them."""
        told = []
        try:
            told.append(f"its state is in {write_failed(self.directory, self.simulation, str(failure))}")
            if self.copy is not None:
                self.checkpoints.write(self.simulation, *self.copy)
        except OutputError as error:
            told.append(str(error))
        return "; " + "; ".join([*told, self.newest_text()])

    def newest_text(self):
        newest = self.checkpoints.newest or (self.origin and self.origin.path)
        return f"the newest good checkpoint is {newest}" if newest else "there is no checkpoint"
