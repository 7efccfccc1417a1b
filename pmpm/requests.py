"""What is asked of a run from outside while it runs: signals to any rank, and the clock on the wall of rank 0.

A rank only notes it; `Simulation.ask` lets all ranks agree, so that all stop, or write, after the same step.
"""

import atexit
import contextlib
import os
import re
import signal
import subprocess
import threading
import time as clock

from pmpm.scene.errors import SceneError
from pmpm.watching import CHECKPOINT, OUT_OF_TIME, SIGNALLED

STOPPING = (signal.SIGTERM, signal.SIGINT, signal.SIGUSR1)
CHECKPOINTING = signal.SIGUSR2
FORMS = "HH:MM, HH:MM:SS or D-HH:MM:SS"
FIRST_BANDWIDTH = 1e8  # bytes/s, a slow disk, for the checkpoint that no earlier one tells of
MARGIN_STEPS, MARGIN_CHECKPOINTS, MARGIN_SECONDS = 6, 2, 2.0  # what is left of the wall time when a run stops


class Requests:
    """Observer, called after every step, that passes on what this rank has been asked for.

    `deadline`: when the wall time is over, on time.time()'s clock, or None; `interval`: s by the clock between checkpoints,
    0 for none. Clocks are rank 0's alone.
    """

    def __init__(self, comm, deadline=None, interval=0.0):
        self.is_timekeeper = comm.rank == 0
        self.deadline, self.interval = deadline, interval
        self.pending = 0
        self.heard = 0  # signals that ask to stop, whether a simulation has been asked or has ended before
        self.last_checkpoint = clock.monotonic()
        self.last_step: float | None = None  # before the first step lie reading and compiling
        self.longest_step = 0.0
        self.longest_checkpoint: float | None = None

    @contextlib.contextmanager
    def listening(self, early=()):
        """Take signals as requests meanwhile, after those that came `early`; a second SIGINT ends the process at once."""
        if threading.current_thread() is not threading.main_thread():
            yield self
            return
        before = {number: signal.signal(number, self.note) for number in (*STOPPING, CHECKPOINTING)}
        try:
            for number in early:
                self.note(number, None)
            yield self
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    def note(self, number, frame):
        if number == signal.SIGINT:
            signal.signal(signal.SIGINT, signal.SIG_DFL)
        asked = CHECKPOINT if number == CHECKPOINTING else SIGNALLED + number
        self.pending = max(self.pending, asked)
        self.heard = max(self.heard, asked if asked > CHECKPOINT else 0)

    def __call__(self, simulation):
        if self.is_timekeeper:
            self.look_at_clock(simulation)
        if self.pending:
            simulation.ask(self.pending)
            self.pending = 0

    def look_at_clock(self, simulation):
        now = clock.monotonic()
        if self.last_step is not None:
            self.longest_step = max(self.longest_step, now - self.last_step)
        self.last_step = now
        if self.deadline is not None and clock.time() + self.margin(simulation) >= self.deadline:
            self.pending = max(self.pending, OUT_OF_TIME)
            self.deadline = None
        elif self.interval > 0.0 and now - self.last_checkpoint >= self.interval:
            self.pending = max(self.pending, CHECKPOINT)
            self.last_checkpoint = now

    def margin(self, simulation):
        """Seconds that it takes to stop: the steps until all ranks agree, and a checkpoint."""
        if self.longest_checkpoint is None:
            self.longest_checkpoint = simulation.comm.size * simulation.nbytes / FIRST_BANDWIDTH
        return MARGIN_SECONDS + MARGIN_STEPS * self.longest_step + MARGIN_CHECKPOINTS * self.longest_checkpoint

    def wrote_checkpoint(self, seconds):
        """Take note of a checkpoint just written, whoever asked for it."""
        self.longest_checkpoint = seconds
        self.last_checkpoint = self.last_step = clock.monotonic()


@contextlib.contextmanager
def keeping_signals():
    """Keep what comes while a run is not listening yet: yields the list of the signals, for `listening`."""
    early: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield early
        return

    def keep(number, frame):
        if number == signal.SIGINT:
            signal.signal(signal.SIGINT, signal.SIG_DFL)
        early.append(number)

    before = {number: signal.signal(number, keep) for number in (*STOPPING, CHECKPOINTING)}
    atexit.register(stop_listening)
    try:
        yield early
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def stop_listening():
    """Let no signal change the exit status of a run that is over: it takes MPI a while to say good-bye."""
    for number in (*STOPPING, CHECKPOINTING):
        signal.signal(number, signal.SIG_IGN)


def reason(asked):
    """What made a run stop, as a person says it."""
    return signal.Signals(asked - SIGNALLED).name if asked >= SIGNALLED else "out of wall time"


def deadline_of(walltime, began, rank=0):
    """When a run must be over, on time.time()'s clock, or None: of --walltime, which counts from `began`, else of Slurm.

    Slurm is asked by rank 0 alone, the timekeeper: it does not bear the questions of a thousand ranks at once.
    """
    if walltime is not None:
        return None if walltime == "none" else began + seconds_of(walltime)
    return slurm_end() if rank == 0 else None


def seconds_of(text):
    """Seconds of a wall time as batch systems write it. Raises SceneError."""
    match = re.fullmatch(r"(?:(\d{1,4})-)?(\d{1,5}):(\d{2})(?::(\d{2}))?", text)
    if not match or int(match[3]) > 59 or int(match[4] or 0) > 59:
        raise SceneError(f"--walltime {text}: must be {FORMS}, or none")
    total = in_seconds(*match.groups())
    if total == 0:
        raise SceneError(f"--walltime {text}: must be longer than nothing")
    return total


def slurm_end():
    """When the Slurm job around this process ends, on time.time()'s clock; None without one, or if Slurm does not say."""
    job = os.environ.get("SLURM_JOB_ID", "")
    if not job.isdigit():
        return None
    given = os.environ.get("SLURM_JOB_END_TIME", "")
    if given.isdigit():
        return float(given)
    if "SLURM_ARRAY_TASK_ID" in os.environ:  # one task of an array has the number of the whole array for its own
        job = f"{os.environ.get('SLURM_ARRAY_JOB_ID', job)}_{os.environ['SLURM_ARRAY_TASK_ID']}"
    try:
        asked = subprocess.run(
            ["squeue", "-h", "-j", job, "-o", "%L"], capture_output=True, text=True, timeout=20, check=True
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return left_of_slurm(asked.stdout.strip(), clock.time())


def left_of_slurm(text, now):
    """The end of a job that squeue says has `text` left: [D-][HH:]MM:SS."""
    match = re.fullmatch(r"(?:(\d+)-)?(?:(\d+):)?(\d+):(\d+)", text)
    return now + in_seconds(*match.groups()) if match else None


def in_seconds(days, hours, minutes, seconds):
    """Seconds of the parts of a time as texts, None for nothing."""
    return ((int(days or 0) * 24 + int(hours or 0)) * 60 + int(minutes or 0)) * 60 + int(seconds or 0)
