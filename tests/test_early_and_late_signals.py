"""Signals that come when a run does not step yet, or has just ended."""

import signal

import launch
import pytest
import several_laws

from pmpm.output import manifests

# Runs the command line and sends itself a signal while the scene is being read, or when Python ends.
EARLY = """\
import os, sys
from pmpm import cli
where = cli.where_to_begin
def read(*arguments):
    os.kill(os.getpid(), {number})
    return where(*arguments)
cli.where_to_begin = read
sys.exit(cli.main(sys.argv[1:]))
"""
LATE = """\
import atexit, os, sys
from pmpm import cli
atexit.register(lambda: os.kill(os.getpid(), {number}))
status = cli.main(sys.argv[1:])
sys.exit(status)
"""


def run(program, number, folder):
    scene = folder / "drop.toml"
    scene.write_text(several_laws.short().to_toml(), encoding="utf-8")
    text = program.format(number=int(number))
    return launch.python(["-c", text, "run", scene, "--out", folder / "run", "--quiet"], folder=folder)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGUSR1])
def test_a_signal_that_comes_before_the_first_step_stops_the_run_with_a_checkpoint(number, tmp_path):
    done = run(EARLY, number, tmp_path)
    assert done.status == 3, done.text
    assert len(manifests.numbers(tmp_path / "run" / "checkpoints")) == 1


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGUSR1])
def test_a_signal_that_comes_when_the_run_is_over_does_not_change_its_status(number, tmp_path):
    done = run(LATE, number, tmp_path)
    assert done.status == 0, done.text
