"""Codes that are timed in turns: each a child process that waits, runs n steps when it is told to, and answers.

The child's side is `serve`, the parent's `Child`. One JSON line each way. While one child runs the others sleep, so that
slow phases of a shared machine hit all alike. A contestant is an object with

- `particles`, `facts()`: how many it moves, and what the tables say about it;
- `start(fast)`: back to the start of its workload; `step()`: one whole step, finished on return;
- `phases()`: dict of seconds so far by phase; `sorts()`: how often it has sorted so far;
- `positions()`: (n, dim) in the order of the workload, None on ranks other than 0.
"""

import contextlib
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
NAP = 0.002  # s between looks for a message: ranks that wait inside MPI would burn a core that another code is timed on


def pin(cores):
    """Bind every thread of this process to these cores."""
    for thread in os.listdir("/proc/self/task"):
        os.sched_setaffinity(int(thread), cores)


def serve(build, cores, comm=None):
    """Build a contestant, pin it and obey the parent until it closes the pipe. `build()` returns the contestant."""

    def answer(message):
        if comm is None or comm.rank == 0:
            print(json.dumps(message), flush=True)

    try:
        contestant = build()
        pin(cores)
        answer({"particles": contestant.particles, **contestant.facts()})
        for command in commands(comm):
            answer(obey(contestant, command, comm))
    except Exception as error:
        answer({"failed": f"{type(error).__name__}: {error}"})
        raise


def commands(comm):
    """What the parent says, on every rank; sleeps while there is nothing."""
    if comm is None or comm.rank == 0:
        for line in sys.stdin:
            command = json.loads(line)
            for other in range(1, 1 if comm is None else comm.size):
                comm.send(command, other)
            yield command
        for other in range(1, 1 if comm is None else comm.size):
            comm.send(None, other)
        return
    while True:
        while not comm.iprobe(source=0):
            time.sleep(NAP)
        command = comm.recv(source=0)
        if command is None:
            return
        yield command


def obey(contestant, command, comm):
    if command["do"] == "start":
        contestant.start(command["fast"])
        return {}
    if command["do"] == "positions":
        x = contestant.positions()
        if x is not None:
            np.save(command["path"], x)
        return {}
    before, sorted_before = dict(contestant.phases()), contestant.sorts()
    if comm is not None:
        comm.Barrier()
    seconds = []
    for _ in range(command["steps"]):
        began = time.perf_counter()
        contestant.step()
        seconds.append(time.perf_counter() - began)
    phases = {name: value - before.get(name, 0.0) for name, value in contestant.phases().items()}
    return {"seconds": seconds, "phases": phases, "sorts": contestant.sorts() - sorted_before}


class ContestantError(Exception):
    """A contestant could not be built or broke down; the text says why."""


class Child:
    """One contestant in a process of its own. `ask` raises ContestantError where it has failed."""

    def __init__(self, module, arguments, cores, ranks=1, environment=None):
        # A library that wants more threads than it is given cores would time the scheduler.
        one_thread = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
        path = os.pathsep.join([str(HERE), *filter(None, [os.environ.get("PYTHONPATH")])])
        command = [sys.executable, "-m", module, *map(str, arguments), "--cores", *map(str, cores)]
        if ranks > 1:
            beside = Path(sys.executable).with_name("mpiexec")
            command = [str(beside) if beside.exists() else "mpiexec", "-n", str(ranks), *command]
        self.errors = tempfile.TemporaryFile("w+")  # noqa: SIM115 - closed in `end`
        self.process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self.errors,
            text=True,
            env={**os.environ, **one_thread, "PYTHONPATH": path, **(environment or {})},
        )

    def read(self):
        """The next answer; what libraries print is passed over."""
        line = next((line for line in self.process.stdout if line.startswith("{")), "")
        message = json.loads(line) if line else {"failed": self.last_words()}
        if "failed" in message:
            raise ContestantError(message["failed"])
        return message

    def ask(self, **command):
        self.tell(**command)
        return self.read()

    def tell(self, **command):
        """Say what to do, and do not wait for the answer."""
        try:
            self.process.stdin.write(json.dumps(command) + "\n")
            self.process.stdin.flush()
        except BrokenPipeError:
            raise ContestantError(self.last_words()) from None

    def last_words(self):
        self.process.wait()
        self.errors.seek(0)
        lines = self.errors.read().split("\n")
        return next((line for line in reversed(lines) if line.strip()), f"exit status {self.process.returncode}")

    def end(self):
        """Let it finish; a child that does not is stopped."""
        with contextlib.suppress(BrokenPipeError):
            self.process.stdin.close()
        try:
            self.process.wait(timeout=20)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self.process.stdout.close()
        self.errors.close()
