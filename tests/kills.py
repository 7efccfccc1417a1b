"""Kill one rank of three at a random moment, restart on one to four ranks, and compare with a run that nobody disturbed."""

import os
import random
import shutil
import signal
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path

import bits
import launch
import several_laws

from pmpm.output import manifests
from pmpm.output.run_directory import read_status

DRIVER = Path(__file__).parent / "drivers" / "kill_one_rank.py"
RANKS = 3
LIMIT = 150  # s, for what takes about five


@dataclass(frozen=True)
class Kill:
    """Which rank dies, at which moment (see the driver; "outside": by this process, at any time), how far into the run, as a
    share of its steps, writes, checkpoints or time, after which share of the bytes, and on how many ranks the run goes on."""

    rank: int
    moment: str
    when: float
    share: float
    again_on: int


@dataclass(frozen=True)
class Whole:
    """A run that nobody disturbed on three ranks: its folder, and how much of each there was."""

    folder: Path
    counts: dict


def kills(count):
    """The first `count` of a fixed sequence: of five, two in the middle of a write, one of them of rank 0's last file now and
    then, two anywhere between the steps, one from outside at any time."""
    generator = random.Random(2026)
    found = []
    for number in range(count):
        moment = ("write", "step", "write", "outside", "step")[number % 5]
        moment = "rename" if number % 10 == 7 else moment
        rank = 0 if moment == "rename" else generator.randrange(RANKS)
        found.append(Kill(rank, moment, generator.random(), generator.random(), generator.randrange(1, 5)))
    return found


def scene():
    """Three laws on a periodic slab axis, so that every rank always has something; a checkpoint every 50 steps or so."""
    told = several_laws.flat(end=0.12).model_dump(exclude_none=True)
    told["output"] |= {"checkpoint_interval": 0.01, "snapshot_interval": 0.012}
    return type(several_laws.flat())(**told)


def command(victim=-1, moment="never", number=0, share=0.0):
    """The run under the driver, which writes everything that a scene can write."""
    fields = bits.arguments_of({"output.fields": bits.all_fields(scene())})
    return [DRIVER, victim, moment, number, share, "--", "run", "scene.toml", "--out", "run", "--quiet", *fields]


def undisturbed(folder):
    """The Whole run, in a folder of its own."""
    folder = Path(folder)
    (folder / "scene.toml").write_text(scene().to_toml(), encoding="utf-8")
    done = launch.python(command(), RANKS, LIMIT, folder)
    assert done.status == 0, done.text
    writes = [int((folder / f"writes.{rank}").read_text()) for rank in range(RANKS)]
    written = max(manifests.numbers(folder / "run" / "checkpoints")) + 1
    counts = {"step": bits.report(folder / "run")["steps"], "rename": written, "write": min(writes)}
    counts["line"] = text_of(folder / "run" / "diagnostics.csv").count("\n")
    return Whole(folder / "run", counts)


def attempt(kill, whole, folder):
    """Run, kill, restart; returns (numbers of the checkpoints that were left, differences from the undisturbed run)."""
    folder = Path(folder)
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    (folder / "scene.toml").write_text(scene().to_toml(), encoding="utf-8")
    if kill.moment == "outside":
        outside = threading.Thread(target=kill_from_outside, args=(folder, kill, whole.counts["line"]))
        outside.start()
        done = launch.python(command(), RANKS, LIMIT, folder)
        outside.join()
    else:
        number = 1 + int(kill.when * whole.counts[kill.moment])
        done = launch.python(command(kill.rank, kill.moment, number, kill.share), RANKS, LIMIT, folder)
    assert done.status not in (0, None), f"{kill}: status {done.status}, it should have died\n{done.text}"
    wait_until_gone(folder / "run")
    left = manifests.numbers(folder / "run" / "checkpoints")
    again = ["-m", "pmpm", *command()[6:], "--restart", "run"]
    done = launch.python(again, kill.again_on, LIMIT, folder)
    assert done.status == 0, f"{kill}: restart ended with {done.status}\n{done.text}"
    return left, bits.differences(whole.folder, folder / "run")


def kill_from_outside(folder, kill, lines):
    """Wait until the run has come so far, told by its diagnostics, and a moment longer; before its first line the moment is
    up to the seconds that Python needs to start."""
    began, target = time.monotonic(), int(0.95 * kill.when * lines)
    while time.monotonic() - began < LIMIT and (
        not text_of(folder / f"pid.{kill.rank}") or text_of(folder / "run" / "diagnostics.csv").count("\n") < target
    ):
        time.sleep(0.001)
    time.sleep(kill.share * (0.01 if target else 1.0))
    try:
        os.kill(int(text_of(folder / f"pid.{kill.rank}")), signal.SIGKILL)
    except ProcessLookupError:
        print(f"{kill}: too late", file=sys.stderr)


def text_of(path):
    try:
        return path.read_text()
    except FileNotFoundError:
        return ""


def wait_until_gone(run):
    """Wait until the process that wrote a run is surely gone."""
    began = time.monotonic()
    while (run / "run.json").exists() and read_status(run) == "running" and time.monotonic() - began < 20:
        time.sleep(0.05)
