"""Several ranks write one file together: the same datasets as one rank writes, and one rank's failure is everyone's.

mpirun -n 3 python -m pytest --with-mpi tests/mpi/test_snapshots_mpi.py
"""

import errno
import os
import tempfile
from pathlib import Path

import h5py
import numpy as np
import pytest
from fake_simulation import FakeSimulation, fake_scene

from pmpm.output.datasets import default_parallel
from pmpm.output.diagnostics import Diagnostics
from pmpm.output.files import OutputError
from pmpm.output.run_directory import RunDirectory
from pmpm.output.snapshots import SnapshotWriter
from pmpm.parallel.comm import Alone, World

pytestmark = pytest.mark.mpi(min_size=2)

# Not skipped but absent where h5py is built without MPI: nothing may be skipped under mpirun, for then nobody would notice.
PARALLEL = ["pwrite", "mpio"] if h5py.get_config().mpi else ["pwrite"]
FIELDS = ("velocity", "pressure", "stress", "deformation_gradient", "material", "hencky_strain", "v_c")


@pytest.fixture
def comm():
    from mpi4py import MPI

    return World(MPI.COMM_WORLD)


@pytest.fixture
def folder(comm):
    """One empty folder, the same on all ranks."""
    with tempfile.TemporaryDirectory() as own:
        yield Path(comm.broadcast(own))
        comm.barrier()


def shares_of(kind, comm):
    return {
        "even": [1] * comm.size,
        "uneven": list(range(1, comm.size + 1)),
        "first rank empty": [0] + [1] * (comm.size - 1),
        "last rank empty": [1] * (comm.size - 1) + [0],
    }[kind]


def contents(path):
    """Everything in an HDF5 file: {name: (type, shape, bytes, attributes)}."""
    held = {}

    def look(name, item):
        told = {key: np.asarray(value).tobytes() for key, value in item.attrs.items()}
        data = (item.dtype.str, item.shape, item[...].tobytes()) if isinstance(item, h5py.Dataset) else None
        held[name] = (data, told)

    with h5py.File(path) as file:
        file.visititems(look)
    return held


def written_together(comm, folder, parallel, shares=None, count=1000, **of_scene):
    directory = RunDirectory.create(folder / f"{comm.size}_ranks", "", comm)
    simulation = FakeSimulation(fake_scene(fields=FIELDS, **of_scene), comm, count, shares)
    SnapshotWriter(directory, simulation.scene, parallel=parallel)(simulation)
    return directory.path


def written_alone(folder, count=1000, **of_scene):
    directory = RunDirectory.create(folder / "alone", "", Alone())
    simulation = FakeSimulation(fake_scene(fields=FIELDS, **of_scene), Alone(), count)
    SnapshotWriter(directory, simulation.scene)(simulation)
    return directory.path


def assert_on_all(comm, claim):
    """Assert what rank 0 found, on all ranks, so that none is left waiting."""
    assert comm.broadcast(claim)


@pytest.mark.parametrize("parallel", PARALLEL)
@pytest.mark.parametrize("shares", ["even", "uneven", "first rank empty", "last rank empty"])
@pytest.mark.parametrize("of_scene", [{"dim": 2}, {"dim": 3, "precision": "float32"}], ids=["2-D", "3-D float32"])
def test_ranks_together_write_what_one_rank_writes(comm, folder, parallel, shares, of_scene):
    together = written_together(comm, folder, parallel, shares_of(shares, comm), **of_scene)
    claim = None
    if comm.rank == 0:
        alone = written_alone(folder, **of_scene)
        claim = contents(together / "snapshots/000000.hdf") == contents(alone / "snapshots/000000.hdf")
    assert_on_all(comm, claim)


@pytest.mark.parametrize("parallel", PARALLEL)
def test_ranks_together_write_the_index_that_one_rank_writes(comm, folder, parallel):
    together = written_together(comm, folder, parallel)
    claim = None
    if comm.rank == 0:
        claim = (together / "snapshots.xdmf").read_text() == (written_alone(folder) / "snapshots.xdmf").read_text()
    assert_on_all(comm, claim)


@pytest.mark.parametrize("parallel", PARALLEL)
def test_no_particles_on_any_rank_is_legal(comm, folder, parallel):
    together = written_together(comm, folder, parallel, count=0)
    claim = None
    if comm.rank == 0:
        held = contents(together / "snapshots/000000.hdf")
        claim = held == contents(written_alone(folder, count=0) / "snapshots/000000.hdf")
        claim = claim and held["VTKHDF/Points"][0][1] == (0, 3)
    assert_on_all(comm, claim)


def test_mpi_io_is_the_way_where_h5py_has_it(comm):
    assert default_parallel(comm) == ("mpio" if h5py.get_config().mpi else "pwrite")


def test_one_ranks_full_disk_is_an_error_on_all_ranks(comm, folder, monkeypatch):
    if comm.rank == 1:

        def pwrite(descriptor, data, place):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        monkeypatch.setattr(os, "pwrite", pwrite)
    with pytest.raises(OutputError, match="rank 1: No space left"):
        written_together(comm, folder, "pwrite")
    assert_on_all(comm, not list((folder / f"{comm.size}_ranks" / "snapshots").iterdir()))


def test_a_field_of_another_type_on_one_rank_is_an_error_on_all_ranks(comm, folder):
    directory = RunDirectory.create(folder / "run", "", comm)
    simulation = FakeSimulation(fake_scene(), comm)
    if comm.rank == 1:
        simulation.all["pressure"] = simulation.all["pressure"].astype(np.float32)
    with pytest.raises(OutputError, match="pressure differs in shape or type between ranks"):
        SnapshotWriter(directory, simulation.scene)(simulation)


def test_a_refused_folder_is_refused_on_all_ranks(comm, folder):
    if comm.rank == 0:
        (folder / "thesis.tex").write_text("precious")
    with pytest.raises(OutputError, match="does not hold a run"):
        RunDirectory.create(folder, "", comm)


def test_all_ranks_know_the_folder_by_rank_zeros_path(comm, folder):
    directory = RunDirectory.create(folder / f"run{comm.rank}", "", comm)
    assert directory.path == folder / "run0"


def test_diagnostics_that_cannot_be_written_are_an_error_on_all_ranks(comm, folder):
    directory = RunDirectory.create(folder / "run", "", comm)
    if comm.rank == 0:
        (directory.path / "diagnostics.csv").mkdir()
    with pytest.raises(OutputError, match="diagnostics.csv: Is a directory"):
        Diagnostics(directory)(FakeSimulation(fake_scene(), comm))
