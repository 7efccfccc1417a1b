"""Runs the command line in this process, under limits of time and memory, and says what is wrong with how it ended."""

import contextlib
import io
import resource
import signal
import traceback
import warnings
from dataclasses import dataclass
from pathlib import Path

from pmpm.cli import main

SECONDS = 30  # of the processor, a thousand times what an example takes: whoever needs more hangs
COMPILING = 240  # where kernels may have to be compiled first
WAITING = 10  # times as long by the clock, for those who wait for something
MEMORY = 2 << 30  # bytes beyond what the process had
MOST_LINES = 7  # of a message: five complaints, a count of the others, and a line that a text of ours may add


class TookTooLong(BaseException):
    """Not an Exception, so that nobody takes it for one of the input."""


@dataclass(frozen=True)
class Outcome:
    """How a command ended: exit status (None: it crashed), what it printed, what it was warned of, its traceback."""

    status: int | None
    out: str
    err: str
    warned: tuple[str, ...]
    crash: str


@contextlib.contextmanager
def limits(seconds):
    """Let nothing in here take longer, nor more memory than there was and MEMORY on top."""

    def too_long(*_):
        raise TookTooLong(f"longer than {seconds} s of the processor, or {WAITING * seconds} s by the clock")

    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    held = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    clocks = {signal.SIGPROF: (signal.ITIMER_PROF, seconds), signal.SIGALRM: (signal.ITIMER_REAL, WAITING * seconds)}
    before = {number: signal.signal(number, too_long) for number in clocks}
    resource.setrlimit(resource.RLIMIT_AS, (held + MEMORY, hard))
    for clock, most in clocks.values():
        signal.setitimer(clock, most)
    try:
        yield
    finally:
        for number, (clock, _) in clocks.items():
            signal.setitimer(clock, 0)
            signal.signal(number, before[number])
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def run(arguments, seconds=SECONDS):
    """The Outcome of `pmpm ARGUMENTS`."""
    out, err, status, crash = io.StringIO(), io.StringIO(), None, ""
    with (
        warnings.catch_warnings(record=True) as warned,
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        warnings.simplefilter("always")
        try:
            with limits(seconds):
                status = main([str(argument) for argument in arguments])
        except SystemExit as end:  # argparse's way
            status = end.code
        except BaseException:
            crash = traceback.format_exc()
    told = tuple(f"{w.category.__name__}: {w.message} ({w.filename}:{w.lineno})" for w in warned)
    return Outcome(status, out.getvalue(), err.getvalue(), told, crash)


def complaints(outcome, allowed):
    """What is wrong with an outcome, as texts: its status must be in `allowed`, its message one that a user can read."""
    found = [outcome.crash] if outcome.crash else []
    found += [f"warning: {text}" for text in outcome.warned]
    lines = outcome.err.splitlines()
    if outcome.status not in allowed:
        found.append(f"status {outcome.status}: {outcome.err[:500]}")
    if "Traceback" in outcome.err or "Traceback" in outcome.out:
        found.append(f"a traceback: {outcome.err}{outcome.out}")
    if outcome.status in (1, 2) and not (lines and any(line.startswith(("pmpm: ", "pmpm ")) for line in lines)):
        found.append(f"no message: {outcome.err!r}")
    if outcome.status == 2 and outcome.out:
        found.append(f"refused, and said on standard output: {outcome.out[:200]!r}")
    if outcome.status == 0 and lines:
        found.append(f"accepted, and said on standard error: {outcome.err[:200]!r}")
    if outcome.status == 1 and "stopped: " not in outcome.err:
        found.append(f"failed without a reason: {outcome.err[:500]!r}")
    # argparse shows the usage before its one line.
    if (
        outcome.status == 2
        and not outcome.err.startswith("usage:")
        and (len(lines) > MOST_LINES or len(outcome.err) > 5000)
    ):
        found.append(f"a message of {len(lines)} lines and {len(outcome.err)} characters: {outcome.err[:300]!r}")
    return found
