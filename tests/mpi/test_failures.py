"""A particle that fails on one rank stops all ranks within a few steps, with the message that one rank alone would give."""

import re

import numpy as np
import pytest
import several_laws
from mpi4py import MPI

from pmpm.parallel.comm import World
from pmpm.scene.schema import Scene
from pmpm.simulation import NumericalFailure, Simulation
from pmpm.timestep import LAG

pytestmark = pytest.mark.mpi(min_size=2)

COMM = World(MPI.COMM_WORLD)
BEFORE = 30
MESSAGE = re.compile(
    r"step (?P<step>\d+), t = (?P<time>\S+) s, rank (?P<rank>\d+): particle (?P<id>\d+) of material (?P<material>\w+) "
    r"at \((?P<position>.*?)\) m: (?P<cause>.*)"
)
SCENES = {"flat": several_laws.flat, "deep": several_laws.deep, "tall": several_laws.tall}


def victims(scene):
    """Ids of some particles that rank 1 holds after the steps before, in the middle of its share and at its ends."""
    simulation = Simulation(scene, COMM)
    simulation.run(steps=BEFORE)
    ids = simulation.particles.id
    return COMM.gather(ids[[0, len(ids) // 2, len(ids) - 1]].tolist() if len(ids) else [])[1]


def spoil(simulation, field, ids, value):
    """Give the particles with these ids, wherever they are, a value of a field."""
    spoiled = getattr(simulation.particles, field)
    spoiled[np.isin(simulation.particles.id, ids)] = value
    setattr(simulation.particles, field, spoiled)


def failure_after(comm, scene, field, ids, value):
    """(message of the failure, steps taken after the particles were spoilt)."""
    simulation = Simulation(scene, comm)
    simulation.run(steps=BEFORE)
    spoil(simulation, field, ids, value)
    with pytest.raises(NumericalFailure) as raised:
        simulation.run(steps=50)
    return str(raised.value), simulation.step_count - BEFORE


def same_but_for_the_rank(text, other):
    return re.sub(r"rank \d+", "rank", text) == re.sub(r"rank \d+", "rank", other)


@pytest.fixture(params=SCENES)
def scene(request):
    return SCENES[request.param]()


def test_a_velocity_that_is_not_a_number_stops_all_ranks_within_the_lag(scene):
    _, steps = failure_after(COMM, scene, "v", victims(scene), np.nan)
    assert COMM.gather(steps) == [LAG] * COMM.size


def test_all_ranks_raise_the_same_message(scene):
    text, _ = failure_after(COMM, scene, "v", victims(scene), np.nan)
    assert COMM.gather(text) == [text] * COMM.size


@pytest.mark.parametrize("field", ["v", "C"])
def test_message_is_the_one_that_one_rank_gives(scene, field):
    """Also where several particles around a cut fail in the same step."""
    ids = victims(scene)
    together, _ = failure_after(COMM, scene, field, ids, np.nan)
    alone, _ = failure_after(None, scene, field, ids, np.nan)
    assert same_but_for_the_rank(together, alone), f"{together}\n{alone}"


def test_message_is_the_one_of_one_rank_also_where_a_rank_meets_later_particles_first():
    """The first four layers after a cut wait for the halo: around a particle of the fifth, the later ones fail first."""
    scene = several_laws.flat()
    simulation = Simulation(scene, COMM)
    simulation.run(steps=BEFORE)
    layer = np.floor(simulation.particles.x[:, 0] / scene.domain.cell_size + 0.5) - simulation.first_layer
    ids = COMM.gather(simulation.particles.id[layer == 4][:1].tolist())[1]
    together, _ = failure_after(COMM, scene, "v", ids, np.nan)
    alone, _ = failure_after(None, scene, "v", ids, np.nan)
    assert ids
    assert same_but_for_the_rank(together, alone), f"{together}\n{alone}"


def test_message_names_step_time_rank_particle_position_and_material(scene):
    named = MESSAGE.fullmatch(failure_after(COMM, scene, "v", victims(scene)[1:2], np.nan)[0]).groupdict()
    simulation = Simulation(scene, COMM)
    simulation.run(steps=BEFORE)
    own = simulation.particles
    x, material = own.x[own.id == int(named["id"])], own.material[own.id == int(named["id"])]
    found = COMM.gather((x.round(9).tolist(), [simulation.material_names[number] for number in material]))
    where, what = found[int(named["rank"])]
    assert (int(named["step"]), named["time"]) == (BEFORE + 1, f"{simulation.time:.6g}")
    assert [f"{value:.6g}" for value in where[0]] == named["position"].split(", ")
    assert what == [named["material"]]
    assert "not a number" in named["cause"]


def test_a_spin_that_no_step_is_short_enough_for_stops_all_ranks_with_the_message_of_one(scene):
    ids = victims(scene)
    together, steps = failure_after(COMM, scene, "C", ids, 1e9)
    alone, _ = failure_after(None, scene, "C", ids, 1e9)
    assert COMM.gather(steps) == [LAG] * COMM.size
    assert "particles are strained at a rate of" in together, together
    assert same_but_for_the_rank(together, alone), f"{together}\n{alone}"


@pytest.mark.parametrize("wrong", [-1.0, np.nan])
def test_a_state_that_is_not_valid_stops_all_ranks_with_the_message_of_one(wrong):
    scene = several_laws.tall()
    simulation = Simulation(scene, COMM)
    simulation.run(steps=BEFORE)
    own = simulation.particles
    water = own.id[own.material == simulation.material_names.index("water")]
    ids = [name for rank in COMM.gather(water.tolist()) for name in rank][-1:]
    together, steps = failure_after(COMM, scene, "J", ids, wrong)
    alone, _ = failure_after(None, scene, "J", ids, wrong)
    assert COMM.gather(steps) == [LAG] * COMM.size
    assert same_but_for_the_rank(together, alone), f"{together}\n{alone}"


def leaving(face):
    """A ball that flies out through a free face, every other face being a wall."""
    axis, away = "xyz".index(face[0]), 1.0 if face.endswith("max") else -1.0
    velocity, center = [0.0, 0.0], [0.5, 0.3]
    velocity[axis], center[axis] = 5.0 * away, [1.0, 0.6][axis] * (0.5 + 0.2 * away)
    return Scene(
        domain={"size": [1.0, 0.6], "cell_size": 0.02, "gravity": [0.0, 0.0], "walls": {face: "free"}},
        time={"end": 0.2},
        method={"transfer": "mls"},
        materials={"rubber": several_laws.MATERIALS["rubber"]},
        bodies=[several_laws.ball("rubber", center, 0.08, velocity, 4)],
    )


@pytest.mark.parametrize("face", ["x_min", "x_max", "y_min", "y_max"])
def test_leaving_through_a_free_face_stops_all_ranks_with_the_message_of_one(face):
    texts = []
    for comm in (COMM, None):
        simulation = Simulation(leaving(face), comm)
        with pytest.raises(NumericalFailure, match="left the domain") as raised:
            simulation.run()
        texts.append(str(raised.value))
    assert COMM.gather(texts[0]) == [texts[0]] * COMM.size
    assert MESSAGE.fullmatch(texts[0])
    assert same_but_for_the_rank(*texts), texts


def test_failure_is_found_before_anything_is_written_of_it(scene):
    simulation = Simulation(scene, COMM)
    seen = []
    simulation.every(lambda run: seen.append(bool(np.isfinite(run.particles.v).all())), steps=2)
    simulation.run(steps=BEFORE)
    spoil(simulation, "v", victims(scene), np.nan)
    with pytest.raises(NumericalFailure):
        simulation.run()
    assert all(seen)
