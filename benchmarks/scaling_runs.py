"""Starts ranks, each on cores of its own, and reads what a run left behind: the hands of benchmarks/scaling.py."""

import json
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import scaling_model

from pmpm.parallel.slabs import Slabs
from pmpm.scene.errors import SceneError

ROOT = Path(__file__).resolve().parent.parent
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
# What is spent in the phases of run.json, by a word in their names; the first that fits counts.
KIND_OF_PHASE = (
    ("compile", None),
    ("wait", "waiting"),
    ("halo", "communication"),
    ("regroup", "regroup"),
    ("", "compute"),
)
KINDS = ("compute", "communication", "waiting", "regroup")


class RunError(Exception):
    """A run failed, or left nothing that can be read; the text says why, in one line."""


# ---- starting --------------------------------------------------------------------------------------------------------------


def launcher():
    """Words that start ranks, before -n: LAUNCH; the mpirun beside this Python, which belongs to its mpi4py; srun in a Slurm
    job; the mpirun on PATH. Raises RunError where there is none."""
    told, beside = os.environ.get("LAUNCH"), Path(sys.executable).with_name("mpirun")
    if told:
        return told.split()
    if beside.is_file():
        return [str(beside)]
    if "SLURM_JOB_ID" in os.environ and shutil.which("srun"):
        return ["srun", "--exact", "--cpu-bind=cores"]
    found = shutil.which("mpirun")
    if not found:
        raise RunError(
            "no mpirun beside this Python nor on PATH: pip install 'pmpm[mpi]', or name a launcher in LAUNCH"
        )
    return [found]


def cores():
    """Numbers of the cores this process may use, one hardware thread of each first."""

    def place_among_siblings(core):
        try:
            text = Path(f"/sys/devices/system/cpu/cpu{core}/topology/thread_siblings_list").read_text()
        except OSError:
            return 0
        return sum(first < core for first in numbers(text))

    return sorted(os.sched_getaffinity(0), key=lambda core: (place_among_siblings(core), core))


def numbers(text):
    """Every number of a list like 0-2,64."""
    ends = [list(map(int, part.split("-"))) for part in text.split(",")]
    return [number for end in ends for number in range(end[0], end[-1] + 1)]


def can_pin(units):
    """Whether so many ranks or threads get cores of their own by `taskset`: all on this host, and no LAUNCH places them."""
    hosts = os.environ.get("SLURM_JOB_NUM_NODES", "1")
    elsewhere = "LAUNCH" in os.environ or "PBS_NODEFILE" in os.environ or hosts != "1" or launcher()[0] == "srun"
    return not elsewhere and shutil.which("taskset") is not None and units <= len(cores())


def start_words(program, ranks, threads=1):
    """The command that runs `program` (words) on so many ranks, each pinned to `threads` cores of its own where that can be."""
    if not can_pin(ranks * threads):
        return [*launcher(), "-n", str(ranks), *program]
    mine = cores()
    words = launcher()
    for rank in range(ranks):
        own = ",".join(map(str, mine[rank * threads : (rank + 1) * threads]))
        words += [*([":"] if rank else []), "-n", "1", "taskset", "-c", own, *program]
    return words


def surroundings():
    """The environment of a run: this pmpm, one thread in every library."""
    paths = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    return os.environ | ONE_THREAD | {"PYTHONPATH": paths}


def run(scene, folder, ranks, steps, settings, threads=1):
    """`pmpm run` into a folder; returns the Run. Raises RunError with the last line that it said."""
    program = [
        sys.executable,
        "-m",
        "pmpm",
        "run",
        scene,
        "--out",
        folder,
        "--overwrite",
        "--quiet",
        "--walltime",
        "none",
    ]
    program += ["--steps", steps, *(word for setting in settings for word in ("--set", setting))]
    program += ["--threads", threads] if threads > 1 else []
    words = start_words(list(map(str, program)), ranks, threads)
    done = subprocess.run(words, env=surroundings(), stdin=subprocess.DEVNULL, capture_output=True, text=True)
    if done.returncode:
        said = [line for line in (done.stderr + done.stdout).splitlines() if line.strip()]
        told = next((line for line in said if line.startswith("pmpm: ")), said[-1] if said else "")
        raise RunError(f"{ranks} ranks ended with status {done.returncode}: {told}")
    return read(folder, threads)


# ---- reading ---------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Run:
    """What run.json says of a run. `shares`: of its seconds, by KINDS, means over ranks; `halo`, `theory`: (messages, bytes)
    that all ranks sent per step, and would with every node of the shared planes occupied; None where that is not known."""

    name: str
    ranks: int
    threads: int
    hosts: int
    particles: int
    steps: int
    seconds: float
    shares: dict
    imbalance: float
    halo: tuple | None
    theory: tuple | None

    @property
    def rate(self):
        """Particle-steps per second."""
        return self.particles * self.steps / self.seconds

    @property
    def rate_per_core(self):
        return self.rate / self.ranks / self.threads


def read(folder, threads=1):
    """The Run in a folder. Raises RunError if it does not hold one."""
    path = Path(folder) / "run.json"
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise RunError(f"{path} cannot be read: {error}") from None
    report = record.get("report") or {}
    stretch = report.get("stretch", {})
    if not stretch.get("steps"):
        raise RunError(f"{path}: the run is {record.get('status', 'unknown')} and tells of no steps")
    return Run(
        name=Path(folder).name,
        ranks=report["ranks"],
        threads=report.get("threads", threads),
        hosts=len(record["hosts"]),
        particles=report["particles"],
        steps=stretch["steps"],
        seconds=stretch["seconds"],
        shares=shares(report["seconds_per_phase"], stretch["seconds"]),
        imbalance=report.get("balance", {}).get("imbalance", 1.0),
        halo=sent_per_step(report.get("halo"), stretch["steps"]),
        theory=theory(Path(folder), report),
    )


def kind_of(phase):
    return next(kind for word, kind in KIND_OF_PHASE if word in phase)


def shares(phases, seconds):
    """{kind: share of seconds}: means over ranks of the phases of each kind."""
    found = dict.fromkeys(KINDS, 0.0)
    for phase, spread in phases.items():
        kind = kind_of(phase)
        if kind is not None:
            found[kind] += spread["mean"] / seconds
    return found


def sent_per_step(halo, steps):
    """(messages, bytes) of all ranks per step; `halo`: what each rank has sent in all, or None."""
    if not halo:
        return None
    ranks = halo if isinstance(halo, list) else [halo]
    return tuple(sum(rank[what] for rank in ranks) / steps for what in ("messages", "bytes"))


def theory(folder, report):
    """(messages, bytes) per step of all ranks for dense planes, from the scene beside run.json and the last cuts."""
    from pmpm.scene.needs import grid_geometry, scene_needs
    from pmpm.scene.schema import Scene

    try:
        scene = Scene.from_toml(folder / "scene.toml")
        needs = scene_needs(scene)
        geometry = grid_geometry(scene, needs)
        stencil, (slab_axis, *others) = geometry.stencil, geometry.axes
        periodic, edges = geometry.periodic[slab_axis], tuple(report["edges"])
        slabs = Slabs(geometry.layers, periodic, stencil.reach_low, stencil.reach_high, edges)
    except (SceneError, KeyError, ValueError):  # a scene with Python functions, a record of another version
        return None
    plane = tuple(1 if axis < 0 else geometry.extent(axis) for axis in others)
    exchanges = scaling_model.halo_exchanges(needs.scheme.blends, needs.f_bar)
    real_bytes = 4 if needs.precision == "float32" else 8
    messages = scaling_model.halo_messages(slabs, exchanges)
    size = scaling_model.halo_bytes(slabs, plane, real_bytes, exchanges)
    return int(messages.sum()), int(size.sum())
