"""Diagnostics: the totals of the run as lines of a CSV file, one per call."""

from pmpm.output.files import on_rank_zero
from pmpm.output.run_directory import DIAGNOSTICS

WHOLE = ("step", "particles", "left", "emitted")  # columns that count


class Diagnostics:
    """Observer that appends step, time, dt, `simulation.measure()` and the mean forces on colliders to DIR/diagnostics.csv.

    Numbers are written so that reading them gives the same bits. Every line is on disk when the call returns. `count`: lines so
    far, those of the run that is continued among them, whose file may be another one.
    """

    def __init__(self, directory, count=0):
        self.path, self.comm = directory.path / DIAGNOSTICS, directory.comm
        self.count = count
        goes_on = on_rank_zero(self.comm, lambda: count > 0 and self.path.exists())
        self.names: list[str] = on_rank_zero(self.comm, lambda: header(self.path)) if goes_on else []

    def __call__(self, simulation):
        """Append one line. Collective; OutputError on all ranks if it cannot be written."""
        measured = simulation.measure()
        row = {"step": simulation.step_count, "time": simulation.time, "dt": simulation.dt} | measured
        for name, (force, torque) in simulation.mean_forces().items():
            row |= {f"force_{axis}_{name}": value for axis, value in zip("xyz", force, strict=False)}
            row |= {
                f"torque_{axis}_{name}": value
                for axis, value in zip("z" if len(torque) == 1 else "xyz", torque, strict=True)
            }

        def append():
            header = not self.names
            names = self.names or list(row)
            lines = [",".join(names)] if header else []
            lines.append(",".join(as_text(name, row[name]) for name in names))
            with open(self.path, "w" if header else "a", encoding="utf-8") as file:
                file.write("\n".join(lines) + "\n")
            return names

        self.names = on_rank_zero(self.comm, append)
        self.count += 1


def header(path):
    with open(path, encoding="utf-8") as file:
        return file.readline().strip().split(",")


def as_text(name, value):
    return str(int(value)) if name in WHOLE else repr(float(value))
