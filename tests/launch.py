"""Start one process, or several ranks under mpirun, with a time limit after which nothing of it is left running."""

import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
# Open MPI refuses root, and more ranks than cores, unless told; MPICH does not read these.
LAUNCHER = {
    "OMPI_ALLOW_RUN_AS_ROOT": "1",
    "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
    "OMPI_MCA_rmaps_base_oversubscribe": "1",
    "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",
}


@dataclass(frozen=True)
class Finished:
    """How a command ended: `status` is None if it ran into the limit; `text` is what all its processes printed."""

    status: int | None
    text: str
    seconds: float


def mpirun():
    """The launcher, with its options: PMPM_TEST_MPIRUN, else the mpirun that stands beside this Python, for it is the one that
    mpi4py was installed with; else the one on PATH."""
    told = os.environ.get("PMPM_TEST_MPIRUN")
    beside = Path(sys.executable).parent / "mpirun"
    found = told or (str(beside) if beside.is_file() else shutil.which("mpirun"))
    assert found, "no mpirun beside this Python nor on PATH: pip install 'pmpm[mpi]'"
    return found.split() if told else [found]


def python(arguments, ranks=None, limit=120, folder=None, **environment):
    """Run `python *arguments` on `ranks` ranks (None: without mpirun) for at most `limit` seconds."""
    command = [sys.executable, *map(str, arguments)]
    if ranks is not None:
        command = [*mpirun(), "-n", str(ranks), *command]
    paths = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    started = time.monotonic()
    process = subprocess.Popen(
        command,
        cwd=folder,
        env=os.environ | LAUNCHER | {"PYTHONPATH": paths, "OMP_NUM_THREADS": "1"} | environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        start_new_session=True,
    )
    try:
        text, _ = process.communicate(timeout=limit)
        status = process.returncode
    except subprocess.TimeoutExpired:
        text, status = end(process), None
    except BaseException:
        end(process)
        raise
    return Finished(status, text, time.monotonic() - started)


def end(process):
    """End a command and all it started, first politely so that mpirun can end ranks that left its group; what it said."""
    for number in (signal.SIGTERM, signal.SIGKILL):
        try:
            os.killpg(process.pid, number)
            return process.communicate(timeout=5)[0]
        except subprocess.TimeoutExpired:
            continue
        except ProcessLookupError:
            break
    return process.communicate()[0]
