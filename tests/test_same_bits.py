"""The promise of the slabs: any number of ranks and threads writes the same bits as one process alone, to the last file.

Scenes run from the command line, as users run them; every dataset of every snapshot and the text of the diagnostics are
compared. tests/by_hand/same_bits_all.py runs the built-in scenes as they are, on up to seven ranks.
"""

from pathlib import Path

import bits
import launch
import numpy as np
import pytest
import several_laws

PLAIN_SUM = Path(__file__).parent / "drivers" / "plain_sum.py"

# What keeps this file within a few minutes on two cores: coarser cells, so that runs are short but go from start to end.
# The collapse in 3-D, thousands of steps of the costliest law even so, stops when the heap has begun to spread; it is given
# a push, for else nothing crosses its middle, where the cut of two ranks lies. Of mixed_materials a third, until all of it
# is in contact. Scenes that bring no other part of pmpm are left to the runs by hand.
# The flows are faster, so that something leaves before long.
SHORTER = {
    "chute_flow": ({"domain.cell_size": 0.01, "time.end": 0.22, "inflows.0.velocity": [3.0, 0.0]}, []),
    "colliding_disks": ({}, []),
    "column_collapse": ({"domain.cell_size": 0.005}, []),
    "column_collapse_3d": ({"domain.cell_size": 0.01, "bodies.0.velocity": [0.3, 0.0, 0.0]}, ["--until", "0.08"]),
    "dam_break": ({"domain.cell_size": 0.0028575}, []),
    "dam_break_3d": ({"domain.cell_size": 0.00714375}, []),
    "jet": ({"domain.cell_size": 0.005, "time.end": 0.08, "inflows.0.velocity": [0.0, -3.0]}, []),
    "mixed_materials": ({"domain.cell_size": 0.032}, ["--until", "0.2"]),
}
RANKS = [2, 3]


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    """A function that runs a scene on one process, once in this file for the same scene; it gives the folder."""
    done = {}

    def run(label, *arguments, **keywords):
        if label not in done:
            done[label] = tmp_path_factory.mktemp("alone") / "run"
            bits.run(*arguments[:1], done[label], None, *arguments[1:], **keywords)
        return done[label]

    return run


@pytest.mark.parametrize("ranks", RANKS)
@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("name", SHORTER)
def test_built_in_scene_gives_the_same_bits_on_any_rank_count(name, precision, ranks, alone, tmp_path):
    settings, options = SHORTER[name]
    options = [*options, "--precision", precision]
    one = alone((name, precision), name, settings, options)
    bits.run(name, tmp_path / "run", ranks, settings, options)
    assert bits.differences(one, tmp_path / "run") == []
    # Equality would be cheap if nothing ever went over a cut.
    crossings = bits.crossings(tmp_path / "run")
    assert len(crossings) == ranks - 1
    assert min(crossings) > 0
    assert bits.report(tmp_path / "run")["ranks"] == ranks


FRICTION = {"friction": 0.4}
OTHER_SCENES = {
    "several laws, periodic slab axis, 2-D, float32": several_laws.flat(precision="float32"),
    "several laws, periodic slab axis, 2-D, float64": several_laws.flat(),
    "several laws, periodic slab axis, 3-D, float64": several_laws.deep(),
    "slabs across y": several_laws.tall(),
    "contact, periodic slab axis, 2-D": several_laws.flat(contact=FRICTION),
    "contact, periodic slab axis, 3-D, float32": several_laws.deep(precision="float32", contact=FRICTION),
}


@pytest.mark.parametrize(("ranks", "threads"), [(2, 1), (3, 2), (None, 3)])
@pytest.mark.parametrize("label", OTHER_SCENES)
def test_several_laws_give_the_same_bits_on_any_number_of_ranks_and_threads(label, ranks, threads, alone, tmp_path):
    one = alone(label, OTHER_SCENES[label])
    bits.run(OTHER_SCENES[label], tmp_path / "run", ranks, options=["--threads", threads])
    assert bits.differences(one, tmp_path / "run") == []
    assert min(bits.crossings(tmp_path / "run"), default=1) > 0
    assert bits.report(tmp_path / "run")["threads"] == threads


@pytest.mark.parametrize("ranks", RANKS)
def test_ranks_without_particles_change_nothing(ranks, alone, tmp_path):
    one = alone("corner", several_laws.corner())
    bits.run(several_laws.corner(), tmp_path / "run", ranks)
    assert bits.differences(one, tmp_path / "run") == []


def test_ranks_beyond_the_room_of_the_domain_idle_with_one_warning(alone, tmp_path):
    one = alone("short", several_laws.short())
    done = bits.run(several_laws.short(), tmp_path / "run", 4)
    assert bits.differences(one, tmp_path / "run") == []
    assert done.text.count("warning") == 1, done.text
    assert "2 of 4 ranks stay idle" in done.text
    assert bits.report(tmp_path / "run")["edges"].count(13) == 3


@pytest.mark.parametrize("scene", ["dam_break", several_laws.flat()], ids=["walls", "periodic"])
def test_a_plain_sum_at_the_cuts_does_not_give_the_same_bits(scene, tmp_path):
    """The control: were it to pass, the comparisons above could not fail."""
    settings, options = SHORTER["dam_break"][0] if scene == "dam_break" else {}, ["--steps", "300"]
    bits.run(scene, tmp_path / "ordered", 2, settings, options)
    bits.run(scene, tmp_path / "plain", 2, settings, options, program=[PLAIN_SUM])
    found = bits.differences(tmp_path / "ordered", tmp_path / "plain")
    assert [name for name in found if name.endswith("PointData/velocity")], found


def test_a_plain_sum_at_the_cuts_is_as_good_a_sum(tmp_path):
    """The control is not broken otherwise: it differs from the ordered sum by rounding alone."""
    for out, program in (("ordered", ("-m", "pmpm")), ("plain", [PLAIN_SUM])):
        bits.run(several_laws.flat(), tmp_path / out, 2, options=["--steps", "10"], program=program)
    x, other = (bits.last_points(tmp_path / out) for out in ("ordered", "plain"))
    assert 0 < np.abs(x - other).max() < 1e-12


def test_the_driver_of_the_control_without_its_change_gives_the_same_bits(tmp_path):
    """What differs in the control is the sum, not that a driver starts the run."""
    settings, options = SHORTER["dam_break"][0], ["--steps", "300"]
    bits.run("dam_break", tmp_path / "command", None, settings, options)
    bits.run("dam_break", tmp_path / "driver", None, settings, options, program=[PLAIN_SUM])
    assert bits.differences(tmp_path / "command", tmp_path / "driver") == []


def test_a_difference_in_one_bit_is_a_difference(tmp_path):
    import h5py

    for out in ("one", "two"):
        bits.run(several_laws.short(), tmp_path / out, options=["--steps", "3"])
    assert bits.differences(tmp_path / "one", tmp_path / "two") == []
    with h5py.File(sorted((tmp_path / "two" / "snapshots").iterdir())[-1], "r+") as file:
        J = file["VTKHDF/PointData/J"]
        J[5] = np.nextafter(J[5], 2.0)
    assert len(bits.differences(tmp_path / "one", tmp_path / "two")) == 1


def test_all_fields_of_a_scene_are_compared(alone):
    one = alone("tall", several_laws.tall())
    names = set(bits.contents(sorted((one / "snapshots").iterdir())[-1]))
    wanted = [
        "Points",
        *(f"PointData/{name}" for name in ("id", "stress", "deformation_gradient", "hencky_strain", "J")),
    ]
    assert {f"VTKHDF/{name}" for name in wanted} <= names


def test_one_rank_under_mpirun_is_one_process_alone(alone, tmp_path):
    one = alone("short", several_laws.short())
    bits.run(several_laws.short(), tmp_path / "run", 1)
    assert bits.differences(one, tmp_path / "run") == []


def test_a_command_that_exceeds_its_limit_leaves_nothing_running(tmp_path):
    script = "import os, time; open(f'{os.getpid()}', 'w').close(); time.sleep(60)"
    done = launch.python(["-c", script], 2, 3, tmp_path)
    assert done.status is None
    assert done.seconds < 20
    assert [name.name for name in tmp_path.iterdir() if Path(f"/proc/{name.name}").exists()] == []
