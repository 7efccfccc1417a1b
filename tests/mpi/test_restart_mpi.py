"""A checkpoint of any number of ranks goes on, on any other number, with the bits of one process that never stopped."""

import h5py
import numpy as np
import pytest
import several_laws
from bits import state_bits as bits
from mpi4py import MPI
from test_drive_mpi import scene as driven

from pmpm.output import checkpoints, manifests
from pmpm.output.files import OutputError
from pmpm.parallel.comm import World
from pmpm.simulation import Simulation

pytestmark = pytest.mark.mpi(min_size=2)

COMM = World(MPI.COMM_WORLD)
SCENES = {"flat": several_laws.flat, "deep": several_laws.deep, "tall": several_laws.tall, "driven": driven}
BEFORE, AFTER = 37, 60


@pytest.fixture
def path(tmp_path):
    return COMM.broadcast(tmp_path) / "a.hdf"


def run_on(comm, path, scene):
    """What `bits` says after the steps behind a checkpoint, on the ranks of `comm`."""
    simulation = Simulation.restart(path, scene, comm)
    simulation.run(steps=AFTER)
    return bits(simulation)


@pytest.mark.parametrize("name", SCENES)
def test_a_checkpoint_of_several_ranks_goes_on_with_the_bits_of_one_that_never_stopped(name, path):
    scene = SCENES[name]()
    alone, together = Simulation(scene), Simulation(scene, COMM)
    alone.run(steps=BEFORE + AFTER)
    together.run(steps=BEFORE)
    together.save(path)
    assert run_on(COMM, path, scene) == bits(alone)
    assert run_on(None, path, scene) == bits(alone)
    if COMM.size > 2:
        few = MPI.COMM_WORLD.Split(COMM.rank == COMM.size - 1)
        assert run_on(few, path, scene) == bits(alone)
        few.Free()


@pytest.mark.parametrize("name", SCENES)
def test_a_checkpoint_of_one_process_goes_on_with_its_bits_on_several_ranks(name, path):
    scene = SCENES[name]()
    alone = Simulation(scene)
    alone.run(steps=BEFORE)
    if COMM.rank == 0:
        alone.save(path)
    COMM.barrier()
    alone.run(steps=AFTER)
    assert run_on(COMM, path, scene) == bits(alone)


OTHER_AXIS = {"flat": "y", "deep": "x", "tall": "x"}


def by_id(simulation):
    """What particles carry, of all ranks, in the order of their ids."""
    rows = {
        name: np.concatenate(simulation.comm.gather(getattr(simulation.particles, name)))
        for name in ("id", "x", "v", "C", "stress", "density")
    }
    order = np.argsort(rows["id"])
    return {name: values[order].tobytes() for name, values in rows.items()}


@pytest.mark.parametrize("name", OTHER_AXIS)
def test_a_checkpoint_goes_on_when_it_is_cut_across_another_axis(name, path):
    """Not with the same bits as before, for sums have another order, but the same on any ranks."""
    scene = SCENES[name]()
    turned = scene.model_copy(update={"parallel": scene.parallel.model_copy(update={"slab_axis": OTHER_AXIS[name]})})
    before = Simulation(scene, COMM)
    assert before.geometry.axes[0] != "xyz".index(OTHER_AXIS[name])
    before.run(steps=BEFORE)
    before.save(path)
    before.regroup()  # which takes those beyond a periodic end to the other one
    simulation = Simulation.restart(path, turned, COMM)
    assert simulation.geometry.axes[0] == "xyz".index(OTHER_AXIS[name])
    assert by_id(simulation) == by_id(before)
    assert run_on(COMM, path, turned) == run_on(None, path, turned)
    before.run(steps=AFTER)
    simulation.run(steps=AFTER)
    assert simulation.time == pytest.approx(before.time, rel=1e-9)


def test_a_copy_is_of_the_particles_that_each_rank_had_then(path):
    scene = several_laws.flat()
    alone, together = Simulation(scene), Simulation(scene, COMM)
    alone.run(steps=BEFORE + AFTER)
    together.run(steps=BEFORE)
    copy, before = together.state().copy(), together.rows()
    together.run(steps=100)
    assert any(COMM.gather(together.rows() != before))
    pieces, attributes = together.datasets(copy)
    checkpoints.write_checkpoint(COMM, path, pieces, attributes, "pwrite")
    assert run_on(COMM, path, scene) == bits(alone)


def test_cuts_in_other_places_write_a_checkpoint_with_the_same_bits(path):
    simulation = Simulation(several_laws.flat(), COMM)
    simulation.run(steps=BEFORE)
    simulation.save(path)
    edges = list(simulation.slabs.edges)
    simulation.regroup([edges[0], *(edge + 3 for edge in edges[1:-1]), edges[-1]])
    regrouped = Simulation.restart(path, None, COMM)
    regrouped.regroup()
    assert bits(regrouped)[0] == bits(simulation)[0]


def test_each_byte_of_a_rank_is_under_a_checksum_of_that_rank(path):
    simulation = Simulation(several_laws.flat(), COMM)
    simulation.save(path)
    held = manifests.read_manifest(path)
    assert len(held["datasets"]["VTKHDF/Points"]) == COMM.size
    assert (
        sum(nbytes for _, nbytes, _ in held["datasets"]["VTKHDF/Points"])
        == 24 * COMM.sum(np.array([simulation.rows()]))[0]
    )


def test_contents_that_one_rank_alone_finds_wrong_stop_all_ranks_with_one_message(path):
    """The last particle, which the last rank reads, does not lie where its layer is; the checksums are right."""
    Simulation(several_laws.tall(), COMM).save(path)
    if COMM.rank == 0:
        held = manifests.read_manifest(path)
        with h5py.File(path, "r+") as file:
            file["restart/fluid/place"][-1] += 3 << 52
        manifests.write_manifest(path, [{}], held)
    COMM.barrier()
    with pytest.raises(OutputError, match="is not where its layer is") as raised:
        Simulation.restart(path, None, COMM)
    assert COMM.gather(str(raised.value)) == [str(raised.value)] * COMM.size


@pytest.mark.parametrize("part", [0.1, 0.5, 0.9])
def test_damage_is_found_by_all_ranks_with_one_message(part, path):
    Simulation(several_laws.flat(), COMM).save(path)
    if COMM.rank == 0:
        with open(path, "r+b") as file:
            file.seek(int(part * path.stat().st_size))
            byte = file.read(1)[0]
            file.seek(-1, 1)
            file.write(bytes([byte ^ 16]))
    COMM.barrier()
    with pytest.raises(OutputError, match="is damaged") as raised:
        Simulation.restart(path, None, COMM)
    assert COMM.gather(str(raised.value)) == [str(raised.value)] * COMM.size
