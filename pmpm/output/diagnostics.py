"""Diagnostics: the totals of the run, and what else is measured over time, as lines of a CSV file, one per call."""

from pmpm.output.files import OutputError, on_rank_zero
from pmpm.output.run_directory import DIAGNOSTICS

WHOLE = ("step", "particles", "left", "emitted")  # columns that count


class Lines:
    """Observer that appends step, time, dt and what `measure(simulation)` gives, by name, to a CSV file.

    Numbers are written so that reading them gives the same bits. Every line is on disk when the call returns. `count`: lines so
    far, those of the run that is continued among them, whose file may be another one.
    """

    def __init__(self, path, comm, measure, count=0):
        self.path, self.comm, self.measure = path, comm, measure
        self.count = count
        goes_on = on_rank_zero(self.comm, lambda: count > 0 and self.path.exists())
        self.names: list[str] = on_rank_zero(self.comm, lambda: header(self.path)) if goes_on else []

    def __call__(self, simulation):
        """Append one line. Collective; OutputError on all ranks if it cannot be written."""
        measured = self.measure(simulation)
        row = {"step": simulation.step_count, "time": simulation.time, "dt": simulation.dt} | measured

        def append():
            header = not self.names
            names = self.names or list(row)
            if sorted(names) != sorted(row):
                raise OutputError(f"{self.path} has the columns {', '.join(names)}, not {', '.join(row)}: move it away")
            self.path.parent.mkdir(exist_ok=True)
            lines = [",".join(names)] if header else []
            lines.append(",".join(as_text(name, row[name]) for name in names))
            with open(self.path, "w" if header else "a", encoding="utf-8") as file:
                file.write("\n".join(lines) + "\n")
            return names

        self.names = on_rank_zero(self.comm, append)
        self.count += 1


class Diagnostics(Lines):
    """The totals of the run, and the mean forces on colliders, as lines of DIR/diagnostics.csv."""

    def __init__(self, directory, count=0):
        super().__init__(directory.path / DIAGNOSTICS, directory.comm, totals, count)


def totals(simulation):
    """What `simulation.measure()` tells, and {force_x_NAME, ..., torque_z_NAME: N and N m} of each collider. Collective."""
    found = dict(simulation.measure())
    for name, (force, torque) in simulation.mean_forces().items():
        axes = "z" if len(torque) == 1 else "xyz"
        found |= {f"force_{axis}_{name}": value for axis, value in zip("xyz", force, strict=False)}
        found |= {f"torque_{axis}_{name}": value for axis, value in zip(axes, torque, strict=True)}
    return found


def header(path):
    with open(path, encoding="utf-8") as file:
        return file.readline().strip().split(",")


def as_text(name, value):
    return str(int(value)) if name in WHOLE else repr(float(value))
