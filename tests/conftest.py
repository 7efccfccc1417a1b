"""Which tests run where, and what becomes of the other ranks when one rank fails a test.

Standing here, it also lets tests of all folders import what they share from this one.
"""

import os
import sys
import tempfile
from pathlib import Path

import pytest

FOR_SEVERAL_RANKS = Path(__file__).parent / "mpi"


def world():
    """The communicator of all ranks, None where this process has not loaded MPI."""
    return getattr(sys.modules.get("mpi4py.MPI"), "COMM_WORLD", None)


def with_mpi(config):
    return config.getoption("--with-mpi", False)


@pytest.hookimpl(tryfirst=True)
def pytest_configure(config):
    """Let rank 0 speak for all: what ranks print at once comes out mixed. Each rank gets temporary folders of its own: pytest
    removes old ones at its end, and warns when another process is removing the same."""
    if with_mpi(config):
        from mpi4py import MPI

        own = Path(tempfile.gettempdir(), f"pytest-of-rank-{MPI.COMM_WORLD.rank}")
        own.mkdir(exist_ok=True)
        os.environ["PYTEST_DEBUG_TEMPROOT"] = str(own)
        if MPI.COMM_WORLD.rank > 0:
            sys.stdout = open(os.devnull, "w")  # noqa: SIM115


def pytest_report_header(config):
    return f"world of {world().size} ranks" if with_mpi(config) else None


def pytest_ignore_collect(collection_path, config):
    """Tests for several ranks are no part of a plain process: test_under_mpirun starts them under mpirun."""
    return True if collection_path == FOR_SEVERAL_RANKS and not with_mpi(config) else None


def pytest_runtest_logreport(report):
    end_all_ranks(report)


def pytest_collectreport(report):
    end_all_ranks(report)


def end_all_ranks(report):
    """At the first failure say what failed on this rank and end all of them: the others may be waiting for it."""
    everyone = world()
    if not report.failed or everyone is None or everyone.size == 1:
        return
    print(f"rank {everyone.rank} failed {report.nodeid}\n{report.longreprtext}", file=sys.__stderr__, flush=True)
    everyone.Abort(1)
