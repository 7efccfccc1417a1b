"""What a run asks Slurm about the end of its job, with a squeue that only pretends."""

import time

import pytest

from pmpm import requests


@pytest.fixture
def squeue(tmp_path, monkeypatch):
    """A squeue that says that two minutes are left and writes down what it was asked."""
    path = tmp_path / "squeue"
    path.write_text(f'#!/bin/sh\necho "$@" >> {tmp_path}/asked\necho 2:00\n')
    path.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/bin:/usr/bin")
    monkeypatch.setenv("SLURM_JOB_ID", "17")
    for name in ("SLURM_JOB_END_TIME", "SLURM_ARRAY_JOB_ID", "SLURM_ARRAY_TASK_ID"):
        monkeypatch.delenv(name, raising=False)
    return tmp_path / "asked"


def test_a_run_in_a_slurm_job_ends_with_it(squeue):
    assert requests.deadline_of(None, 0.0) == pytest.approx(time.time() + 120.0, abs=10.0)


def test_only_the_timekeeper_asks_slurm(squeue):
    assert requests.deadline_of(None, 0.0, rank=1) is None
    assert not squeue.exists()


def test_a_task_of_an_array_asks_for_itself_alone(squeue, monkeypatch):
    """The number of one of the tasks is that of the array: asked for it, squeue gives a line for each task."""
    monkeypatch.setenv("SLURM_ARRAY_JOB_ID", "17")
    monkeypatch.setenv("SLURM_ARRAY_TASK_ID", "3")
    requests.deadline_of(None, 0.0)
    assert squeue.read_text() == "-h -j 17_3 -o %L\n"
