"""Progress: what a person watching the run sees, a live bar on a terminal and plain lines elsewhere."""

import sys
import time
from typing import Any, NamedTuple

LINE_INTERVAL = 5.0
BAR_INTERVAL = 0.1
NEVER = float("inf")


class Mark(NamedTuple):
    """Where the run stood at a wall-clock time (s)."""

    wall: float
    step: int
    time: float


class Progress:
    """Observer, called after every step, that says how far the run is: rank 0 speaks, the others are silent.

    `end` is the simulated time in s at which the run ends. On a terminal there is one live bar; elsewhere one line at
    the first call, one every `interval` seconds of wall clock, and one at the end. The lines also go into log.txt of
    `directory` (a RunDirectory), if one is given, and there also when `quiet` keeps the screen empty. A screen that is gone
    (terminal closed, reader of a pipe ended, disk of a redirection full) ends what is said there, not the run.
    """

    def __init__(
        self, end, comm, directory=None, quiet=False, interval=LINE_INTERVAL, stream=None, clock=time.perf_counter
    ):
        self.end, self.comm, self.directory = end, comm, directory
        self.interval, self.clock = interval, clock
        self.stream: Any = sys.stderr if stream is None else stream  # None again for a process without one
        self.quiet = quiet or self.stream is None
        self.on_terminal = comm.rank == 0 and not self.quiet and self.stream.isatty()
        self.particles: int | None = None
        self.bar: Any = None
        self.due = self.line_due = -NEVER
        self.is_over = False

    def __call__(self, simulation):
        """Say what is due. The first call is collective, the later ones only look at the clock."""
        now = self.clock()
        if now < self.due and (simulation.time < self.end or self.is_over):
            return
        if self.particles is None:
            self.start(simulation, now)
        if self.comm.rank != 0 or self.is_over:
            self.due, self.is_over = NEVER, True
        elif simulation.time >= self.end:
            self.finish(simulation)
        else:
            self.show(simulation, now)

    def stage(self, message):
        """Say what is done outside the steps, such as "compiling kernels ...". Not collective."""
        if self.comm.rank == 0:
            self.write(message)
            self.record(message)

    def finish(self, simulation):
        """Say the last line, with the rates of the whole run, and close the bar; once only. Not collective."""
        if self.is_over or self.comm.rank != 0:
            return
        self.is_over, self.due = True, NEVER
        if self.particles is None:
            return
        now = self.clock()
        line = f"{self.line(simulation, now, self.began)}, took {duration(now - self.began.wall)}"
        if self.bar is not None:
            self.move_bar(simulation, line)
            self.to_screen(lambda: self.bar.close())
        else:
            self.write(line)
        self.record(line)

    def start(self, simulation, now):
        self.particles = self.comm.offsets(simulation.rows())[1]
        self.began = self.last = Mark(now, simulation.step_count, simulation.time)
        if self.on_terminal:
            from tqdm import tqdm

            bar_format = "{percentage:3.0f} %|{bar:16}| {desc}"
            self.to_screen(lambda: self.begin_bar(tqdm, bar_format))

    def show(self, simulation, now):
        line = self.line(simulation, now, self.last) + self.left(simulation, now)
        if self.bar is not None:
            self.move_bar(simulation, line)
        if now >= self.line_due:
            if self.bar is None:
                self.write(line)
            self.record(line)
            self.line_due = now + self.interval
            self.last = Mark(now, simulation.step_count, simulation.time)
        self.due = self.line_due if self.bar is None else now + BAR_INTERVAL

    def line(self, simulation, now, since):
        """How far the run is, and its speed from the mark `since` to `now`."""
        text = f"t = {simulation.time:.6g} of {self.end:.6g} s ({100.0 * self.share(simulation):.0f} %)"
        text += f", step {simulation.step_count}, dt {simulation.dt:.3g} s"
        wall, steps = now - since.wall, simulation.step_count - since.step
        if wall > 0 and steps > 0:
            text += f", {steps / wall:.4g} steps/s, {self.particles * steps / wall:.3g} particle-steps/s"
        return text

    def share(self, simulation):
        return min(simulation.time / self.end, 1.0) if self.end > 0 else 1.0

    def left(self, simulation, now):
        """The time left at the speed since the last line; nothing where that is not known."""
        done, wall = simulation.time - self.last.time, now - self.last.wall
        if not (done > 0 and wall > 0):
            return ""
        return f", {duration((self.end - simulation.time) / done * wall)} left"

    def begin_bar(self, tqdm, bar_format):
        self.bar = tqdm(total=self.end, file=self.stream, bar_format=bar_format, dynamic_ncols=True, mininterval=0)

    def move_bar(self, simulation, line):
        self.bar.n = min(simulation.time, self.end)
        self.to_screen(lambda: self.bar.set_description_str(line, refresh=True))

    def write(self, line):
        if self.bar is not None:
            self.to_screen(lambda: self.bar.write(line, file=self.stream))
        else:
            self.to_screen(lambda: print(line, file=self.stream, flush=True))

    def to_screen(self, action):
        """Do something on the screen, as long as there is one."""
        if self.quiet:
            return
        try:
            action()
        except (OSError, ValueError):  # ValueError: of a stream that Python has closed
            self.quiet = True

    def record(self, line):
        if self.directory is not None:
            self.directory.log(line)


def duration(seconds):
    """Seconds as a person says them: 12 s, 3 min 5 s, 2 h 4 min, 3 d 1 h."""
    seconds = round(seconds)
    if seconds < 60:
        return f"{seconds} s"
    if seconds < 3600:
        return f"{seconds // 60} min {seconds % 60} s"
    if seconds < 86400:
        return f"{seconds // 3600} h {seconds % 3600 // 60} min"
    return f"{seconds // 86400} d {seconds % 86400 // 3600} h"
