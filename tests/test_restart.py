"""A simulation that was saved and read back goes on as if nothing had happened, bit for bit.

Here on one process, for each law, scheme and spline; tests/mpi/test_restart_mpi.py changes the number of ranks, and
tests/test_kills.py ends processes at any moment.
"""

from pathlib import Path

import fast_and_scalar
import numpy as np
import own_laws
import pytest
import several_laws

from pmpm.output.files import OutputError
from pmpm.scene.errors import SceneError
from pmpm.scene.schema import Scene
from pmpm.simulation import Simulation

BEFORE, AFTER = 21, 40


def bits_of(simulation):
    """Everything that a simulation carries: the particles in their blocks' order, and its own numbers."""
    state = simulation.state()
    return [
        (p.rows(slice(None)).tobytes(), p.id[p.lanes].tobytes(), p.segments.tobytes(), p.layer_start.tobytes())
        for p in state.populations
    ], state.record


def interrupted(scene, path, before=BEFORE, after=AFTER, read=None):
    """(simulation that ran through, simulation that was saved on the way, read back, and ran on)."""
    through = Simulation(scene)
    through.run(steps=before)
    through.save(path)
    through.run(steps=after)
    resumed = Simulation.restart(path, read)
    assert (resumed.step_count, resumed.rows()) == (before, through.rows())
    resumed.run(steps=after)
    return through, resumed


ROWS = fast_and_scalar.PAIRS + fast_and_scalar.SINGLE


@pytest.mark.parametrize("row", ROWS, ids=fast_and_scalar.label)
def test_every_law_and_scheme_goes_on_bit_for_bit(row, tmp_path):
    steps = (3, 4) if row["shape_function"] == "linear" else (BEFORE, AFTER)
    scene = fast_and_scalar.scene(row)
    through, resumed = interrupted(scene, tmp_path / "a.hdf", *steps, scene)
    assert bits_of(resumed) == bits_of(through)


@pytest.mark.parametrize("friction", [0.4, 0.1])
def test_contact_goes_on_bit_for_bit_and_may_take_another_friction(friction, tmp_path):
    scene, read = (several_laws.flat(contact={"friction": told}) for told in (0.4, friction))
    through, resumed = interrupted(scene, tmp_path / "a.hdf", read=read)
    assert (bits_of(resumed) == bits_of(through)) == (friction == 0.4)


@pytest.mark.parametrize(("before", "after"), [({}, None), (None, {}), ({}, {"together": [["water", "rubber"]]})])
def test_what_is_bonded_cannot_change_at_a_restart(before, after, tmp_path):
    Simulation(several_laws.flat(contact=before)).save(tmp_path / "a.hdf")
    with pytest.raises(SceneError, match="contact"):
        Simulation.restart(tmp_path / "a.hdf", several_laws.flat(contact=after))


@pytest.mark.parametrize("name", ["flat", "deep", "tall"])
@pytest.mark.parametrize("before", [1, 2, 9, 60])
def test_a_restart_at_any_step_meets_the_next_regroups_and_counts_as_the_run_would(name, before, tmp_path):
    """Reductions and counts on their way, the drift since the last regroup, and the order in it are part of what is kept."""
    through, resumed = interrupted(getattr(several_laws, name)(), tmp_path / "a.hdf", before, 150)
    assert resumed.regroups > 1 + (before == 60)
    assert bits_of(resumed) == bits_of(through)
    assert resumed.measure() == through.measure()


def test_a_restart_of_a_restart_goes_on_bit_for_bit(tmp_path):
    scene = several_laws.flat()
    through = Simulation(scene)
    through.run(steps=100)
    resumed = Simulation(scene)
    for part in range(10):
        resumed.run(steps=10)
        resumed.save(tmp_path / f"{part}.hdf")
        resumed = Simulation.restart(tmp_path / f"{part}.hdf")
    assert bits_of(resumed) == bits_of(through)


def test_a_law_of_ones_own_keeps_its_state(tmp_path):
    scene = Scene(
        domain={"size": [1.0, 0.5], "cell_size": 0.05, "gravity": [0.0, -30.0]},
        time={"end": 10.0},
        materials={"rubber": own_laws.MATERIAL},
        bodies=[several_laws.block("rubber", [0.1, 0.1], [0.6, 0.4], [1.0, -2.0], 4)],
    )
    through, resumed = interrupted(scene, tmp_path / "a.hdf", 80, 80, scene)
    assert through.particles.damage.max() > 0.0
    assert bits_of(resumed) == bits_of(through)


def test_a_scene_with_functions_must_be_given(tmp_path):
    scene = several_laws.flat().model_copy(update={"body_force": lambda x, X, t: (0.0, -t)})
    simulation = Simulation(scene)
    simulation.save(tmp_path / "a.hdf")
    with pytest.raises(SceneError, match="body_force.*is a Python function, which a file does not hold"):
        Simulation.restart(tmp_path / "a.hdf")


def driven():
    """Walls and a region that move, a load, a ramp and damping."""
    return Scene(
        domain={
            "size": [1.2, 0.6],
            "cell_size": 0.05,
            "gravity": [0.0, -3.0],
            "walls": {"x_max": {"type": "slip", "velocity": [0.0, 0.1]}},
        },
        method={"transfer": "flip", "damping": 0.5},
        time={"end": 10.0, "ramp": 0.05},
        materials={"rubber": several_laws.MATERIALS["rubber"]},
        bodies=[several_laws.block("rubber", [0.1, 0.0], [1.0, 0.3], [1.0, 0.0], 4)],
        loads=[{"shape": {"type": "box", "min": [0.4, 0.1], "max": [0.8, 0.2]}, "force": [20.0, 60.0]}],
        motions=[{"shape": {"type": "box", "min": [0.2, 0.25], "max": [0.9, 0.5]}, "velocity": [0.4, -0.2]}],
        colliders=[{"shape": PADDLE, "surface": "stick", "velocity": [-0.2, 0.0], "angular_velocity": 90.0}],
    )


PADDLE = {"type": "box", "min": [0.9, 0.05], "max": [1.1, 0.15]}


def test_what_drives_from_outside_goes_on_where_it_was(tmp_path):
    through, resumed = interrupted(driven(), tmp_path / "a.hdf", 60, 60)
    assert resumed.drive.regions[0].travelled.any()
    assert bits_of(resumed) == bits_of(through)
    one, other = through.drive.obstacles[0].state(through.comm), resumed.drive.obstacles[0].state(resumed.comm)
    assert all(one["impulse"])
    assert one == other


def test_lanes_that_hold_no_particle_have_no_part_in_the_next_regroup(tmp_path):
    """What fills up a block lies where its last particle was at the regroup, after a restart where it was at the checkpoint."""
    through = Simulation(several_laws.flat())
    while not (through.control.drift > 0.9 and through.control.regroup_step < through.step_count - 3):
        through.step()
    through.save(tmp_path / "a.hdf")
    resumed = Simulation.restart(tmp_path / "a.hdf")
    for simulation in (through, resumed):
        simulation.particles.v = -simulation.particles.v
        simulation.run(steps=12)
    assert resumed.control.drift < 0.9
    assert bits_of(resumed) == bits_of(through)


def test_saving_changes_nothing(tmp_path):
    saved, plain = Simulation(several_laws.flat()), Simulation(several_laws.flat())
    for _ in range(20):
        saved.run(steps=5)
        saved.save(tmp_path / "a.hdf")
    plain.run(steps=100)
    assert bits_of(saved) == bits_of(plain)


@pytest.mark.parametrize(("first", "second", "bound"), [("float64", "float32", 2e-6), ("float32", "float64", 2e-6)])
def test_another_precision_goes_on_as_near_as_the_coarser_one_can(first, second, bound, tmp_path):
    """No particle moves by more than the rounding of its place, 2^-25 of a cell, and what 20 steps make of the rest."""
    through = Simulation(several_laws.flat(precision=first))
    through.run(steps=BEFORE)
    through.save(tmp_path / "a.hdf")
    read = several_laws.flat(precision=second)
    resumed = Simulation.restart(tmp_path / "a.hdf", read)
    through.run(steps=20)
    resumed.run(steps=20)
    assert resumed.real == np.dtype(second).type
    one, two = (s.particles.x[np.argsort(s.particles.id)] for s in (through, resumed))
    assert 0.0 < np.abs(one - two).max() < bound


# ---- changes of the scene ----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    path = tmp_path_factory.mktemp("saved") / "a.hdf"
    simulation = Simulation(driven())
    simulation.run(steps=30)
    simulation.save(path)
    return path


def changed(**tables):
    """The driven scene with some keys of its tables changed."""
    told = driven().model_dump(exclude_none=True)
    for table, keys in tables.items():
        told[table] = told[table] | keys if isinstance(keys, dict) else keys
    return Scene(**told)


def test_a_later_end_and_other_outputs_change_no_bit(saved):
    plain = Simulation.restart(saved)
    later = Simulation.restart(
        saved, changed(time={"end": 20.0}, output={"snapshot_interval": 0.5, "checkpoint_keep": 7})
    )
    plain.run(steps=20)
    later.run(steps=20)
    assert bits_of(later)[0] == bits_of(plain)[0]


@pytest.mark.parametrize(
    "tables",
    [
        {"domain": {"gravity": [0.0, -6.0]}},
        {"domain": {"walls": {"y_min": "stick"}}},
        {"method": {"damping": 3.0}},
        {"method": {"flip_blend": 0.5}},
        {"materials": {"rubber": several_laws.MATERIALS["rubber"] | {"youngs_modulus": 4e5}}},
    ],
    ids=lambda tables: next(iter(next(iter(tables.values())))),
)
def test_what_drives_the_particles_may_change_and_acts_from_then_on(saved, tables):
    plain, other = Simulation.restart(saved), Simulation.restart(saved, changed(**tables))
    assert bits_of(other)[0] == bits_of(plain)[0]
    plain.run(steps=5)
    other.run(steps=5)
    assert bits_of(other)[0] != bits_of(plain)[0]


def test_a_stiffer_material_takes_shorter_steps_from_the_first_one_on(saved):
    stiffer = changed(materials={"rubber": several_laws.MATERIALS["rubber"] | {"youngs_modulus": 4e7}})
    other = Simulation.restart(saved, stiffer)
    before = other.dt
    other.step()
    assert other.dt < 0.06 * before  # waves are 20 times as fast


@pytest.mark.parametrize(
    ("tables", "named"),
    [
        ({"domain": {"cell_size": 0.025}}, "domain.cell_size = 0.025 cannot change at a restart .it is 0.05"),
        ({"domain": {"size": [1.2, 0.9]}}, r"domain.size = \[1.2, 0.9\] cannot change"),
        ({"method": {"transfer": "aflip"}}, 'method.transfer = "aflip" cannot change'),
        ({"method": {"shape_function": "cubic"}}, "method.shape_function"),
        ({"method": {"f_bar": True}}, "method.f_bar = true cannot change"),
        ({"materials": {"rubber": several_laws.MATERIALS["rubber"] | {"density": 1.0}}}, "materials.rubber.density"),
        ({"materials": {"rubber": several_laws.MATERIALS["water"]}}, "materials.rubber.model"),
        ({"loads": []}, r"loads\[0\]"),
        ({"motions": []}, r"motions\[0\]"),
        ({"bodies": [several_laws.ball("rubber", [0.5, 0.2], 0.1, [1.0, 0.0], 4)]}, r"bodies\[0\].shape"),
        ({"time": {"end": 1e-4}}, "time.end = 0.0001 s lies before the checkpoint"),
        ({"time": {"cfl": None, "step": 1.0}}, "time.step = 1.0 s is longer than the stable step"),
    ],
)
def test_what_a_run_cannot_take_is_refused_by_name(saved, tables, named):
    with pytest.raises(SceneError, match=named):
        Simulation.restart(saved, changed(**tables))


def test_a_switch_that_needs_another_field_is_refused(tmp_path):
    simulation = Simulation(several_laws.flat(transfer="flip"))
    simulation.save(tmp_path / "a.hdf")
    told = several_laws.flat(transfer="flip").model_dump(exclude_none=True)
    told["materials"]["water"]["viscosity"] = 1.0  # FLIP keeps no C but for viscosity
    with pytest.raises(OutputError, match="particles of fluid hold J, this scene asks for C, J"):
        Simulation.restart(tmp_path / "a.hdf", Scene(**told))


def with_outside_files(folder, **more):
    """A layer of sand on ground, and a box and a mesh in one collider, of files in a folder."""
    folder.mkdir()
    np.save(folder / "ground.npy", np.full(5, 0.2))
    np.save(folder / "depth.npy", np.full(5, 0.1))
    (folder / "square.obj").write_bytes((Path(__file__).parent / "fuzz" / "square.obj").read_bytes())
    return files_in(folder, **more)


def files_in(folder, **more):
    ground = {"type": "terrain", "file": str(folder / "ground.npy"), "spacing": 0.25}
    square = {"type": "mesh", "file": str(folder / "square.obj"), "scale": 0.05, "move": [0.5, 0.5]}
    box = {"type": "box", "min": [0.5, 0.5], "max": [0.7, 0.6]}
    return Scene(
        **{
            "domain": {"size": [1.0, 1.0], "cell_size": 0.05, "gravity": [0.0, -9.81], "walls": {"x_max": "open"}},
            "time": {"end": 1.0},
            "materials": {"rubber": several_laws.MATERIALS["rubber"]},
            "bodies": [{"material": "rubber", "shape": ground | {"depth": str(folder / "depth.npy")}}],
            "colliders": [
                {"shape": ground},
                {"shape": {"type": "union", "of": [square, box]}, "velocity": [0.0, -1.0]},
            ],
        }
        | more
    )


def test_files_of_a_scene_may_lie_elsewhere_at_a_restart_and_not_a_bit_changes(tmp_path):
    simulation = Simulation(with_outside_files(tmp_path / "before"))
    simulation.run(steps=5)
    simulation.save(tmp_path / "a.hdf")
    simulation.run(steps=5)
    (tmp_path / "before").rename(tmp_path / "after")
    again = Simulation.restart(tmp_path / "a.hdf", files_in(tmp_path / "after"))
    again.run(steps=5)
    assert bits_of(again) == bits_of(simulation)


def test_an_open_face_cannot_be_closed_at_a_restart(tmp_path):
    Simulation(with_outside_files(tmp_path / "files")).save(tmp_path / "a.hdf")
    domain = {"size": [1.0, 1.0], "cell_size": 0.05, "gravity": [0.0, -9.81], "walls": {"x_max": "slip"}}
    with pytest.raises(SceneError, match='domain.walls.x_max = "slip" cannot change at a restart .it is "open"'):
        Simulation.restart(tmp_path / "a.hdf", files_in(tmp_path / "files", domain=domain))
