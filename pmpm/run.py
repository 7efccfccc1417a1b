"""One run from scene to finished folder: the simulation with the built-in outputs attached to it."""

from pmpm.failure import NumericalFailure
from pmpm.output import run_directory
from pmpm.output.diagnostics import Diagnostics
from pmpm.output.files import on_rank_zero
from pmpm.output.progress import Progress
from pmpm.output.snapshots import SnapshotWriter
from pmpm.simulation import Simulation


class Once:
    """Calls an output at most once per step, so that the last state is written whatever the interval."""

    def __init__(self, call):
        self.call, self.step = call, None

    def __call__(self, simulation):
        if self.step != simulation.step_count:
            self.step = simulation.step_count
            self.call(simulation)


def run_scene(scene, out, comm, until=None, steps=None, overwrite=False, quiet=False):
    """Run a scene into the folder `out` and return the Simulation. Collective.

    Raises SceneError or OutputError before anything is written, NumericalFailure after the folder has been closed.
    """
    on_rank_zero(comm, lambda: run_directory.check_new(out, overwrite))
    progress = Progress(scene.time.end, comm, quiet=quiet)
    simulation = Simulation(scene, comm, tell=progress.stage)
    directory = run_directory.RunDirectory.create(out, scene.to_toml(), comm, overwrite)
    progress.directory = directory
    status, report = "failed", {}
    try:
        for note in simulation.notes:
            progress.stage(note)
        snapshots, diagnostics = Once(SnapshotWriter(directory, scene)), Once(Diagnostics(directory))
        simulation.every(snapshots, seconds=scene.output.snapshot_interval, at_start=True)
        simulation.every(diagnostics, seconds=scene.output.diagnostics_interval, at_start=True)
        simulation.every(progress, steps=1, at_start=True)
        simulation.run(until=until, steps=steps)
        snapshots(simulation)
        diagnostics(simulation)
        progress.finish(simulation)
        status = "finished" if simulation.finished else "stopped early"
        report = simulation.report()
    except NumericalFailure as failure:
        directory.log(str(failure))
        report = {"failure": str(failure)} | simulation.report()
        raise
    finally:
        directory.finish(status, report)
    return simulation
