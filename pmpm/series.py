"""Probes and gauges of a run as lines of CSV files, one file each, beside the diagnostics and at the same times."""

from pmpm import sampling
from pmpm.output.diagnostics import Lines
from pmpm.output.run_directory import SERIES


class Series:
    """Observer that appends a line to DIR/probes/<name>.csv and DIR/gauges/<name>.csv for each probe and gauge of the scene."""

    def __init__(self, simulation, directory):
        scene, before = simulation.scene, simulation.outputs
        self.before = {key: count for key, count in before.items() if key.partition("/")[0] in SERIES}
        measures = {f"probes/{probe.name}": sampling.probe(probe.position) for probe in scene.output.probes}
        measures |= {f"gauges/{gauge.name}": sampling.gauge(gauge, scene) for gauge in scene.output.gauges}
        self.lines = {
            key: Lines(directory.path / f"{key}.csv", directory.comm, measure, before.get(key, 0))
            for key, measure in measures.items()
        }

    def __call__(self, simulation):
        """Append one line to each. Collective; OutputError on all ranks if one cannot be written."""
        for lines in self.lines.values():
            lines(simulation)

    def counts(self):
        """Lines of each file so far, for a checkpoint: also of those that an earlier stretch of the run has left."""
        return self.before | {key: lines.count for key, lines in self.lines.items()}
