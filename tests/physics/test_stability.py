"""Claims of the stability matrix that take no time: benchmarks/stability.py holds all of it, and the cases used here."""

import numpy as np
import pytest
from stress import inverted, lonely, refused, snow_crush, solids, units
from stress.judge import COMPLETE, PARTICLE, Found, Watch, follow, incomplete
from stress.matrix import FAILED, STOPPED, SURVIVES, Scheme
from stress.scenes import box, simulation, solid

APIC, MLS = Scheme("apic", "quadratic"), Scheme("mls", "cubic")
MESSAGE = "step 3, t = 0.1 s, rank 0: particle 7 of material m at (0, 0) m: its state is no longer valid: J = -1"


@pytest.mark.parametrize(("scheme", "law"), [(APIC, "solid"), (MLS, "fluid")], ids=str)
def test_noise_of_a_lone_particle_does_not_grow_in_ten_thousand_steps(scheme, law):
    # Sun, Shinar, Schroeder (2020): a swing of volume against affine velocity. Measured: 1.4e-11 from 1.3e-11.
    found = lonely.single(scheme, f"{law}, 1e-8 from a node")
    assert (found.verdict, found.steps) == (SURVIVES, 10_000)
    assert found.numbers["largest |J - 1|"] < 2e-11


@pytest.mark.parametrize("state", ["stretched", "compressed"])
def test_lone_particles_that_swing_by_a_third_of_their_volume_gain_no_energy(state):
    # Steps that follow each swing, two steps late, pump: the energy of these grew fivefold in a hundred steps.
    found = lonely.dust(Scheme("mls", "quadratic"), f"solid, {state}")
    assert (found.verdict, found.steps) == (SURVIVES, 10_000)


def test_two_particles_fly_straight_through_cells_to_round_off():
    found = lonely.flying(APIC, "solid, two")
    assert found.verdict == SURVIVES
    assert found.numbers["change of v"] < 1e-15  # measured 2e-16


@pytest.mark.parametrize("unit", ["mm-N-s", "M*1e-6", "T*1e+6"])
@pytest.mark.parametrize("scene", units.SCENES)
def test_a_scene_in_other_units_gives_the_same_answer(scene, unit):
    found = units.scaled(APIC, f"{scene}, {unit}")
    assert found.verdict == SURVIVES, found.wrong
    assert found.numbers["difference"] < 1e-10


@pytest.mark.parametrize("cfl", [0.4, 0.9])
@pytest.mark.parametrize("scheme", [APIC, MLS], ids=str)
def test_a_spinning_disk_keeps_its_energy_at_steps_up_to_nine_tenths_of_the_bound(scheme, cfl):
    run, _ = solids.spinning_disk(scheme, solid(), 0.025, spin=10.0, time={"cfl": cfl})
    found = follow(run, steps=400)
    assert found.verdict == SURVIVES, found.wrong
    assert found.energy <= 1.05


def test_energy_from_nowhere_is_noticed_where_the_step_is_far_beyond_the_bound():
    run, _ = solids.spinning_disk(APIC, solid(), 0.025, spin=10.0)
    run.control.cfl = 3.0
    found = follow(run, steps=400, least=1)
    assert "energy from nowhere" in found.wrong


def test_a_law_without_meaning_for_inverted_particles_stops_in_the_first_step_and_names_one():
    found = inverted.refused_by_law(APIC, "neo_hookean")
    assert found.verdict == STOPPED
    assert found.message.startswith("step 1,")
    assert PARTICLE.search(found.message)


@pytest.mark.parametrize("key", ["materials.m.poisson_ratio=0.5", "time.step=nan", "bodies=[]"])
def test_input_without_meaning_is_refused_by_its_key(key):
    assert refused.refused(APIC, key).verdict == STOPPED


def test_hardening_beyond_what_numbers_hold_is_refused():
    with pytest.raises(Exception, match="hardening = 90"):
        snow_crush.crush(APIC, "xi=90")


# ---- the judge itself ----------------------------------------------------------------------------------------------------


def block():
    return simulation(APIC, [1.6, 1.6], 0.1, [box([0.4, 0.4], [0.8, 0.8], velocity=[1.0, 0.0])], solid())


def spoiled(name, value):
    """What the judge holds against a block one of whose particles has been spoiled behind pmpm's back."""
    run = block()
    watch = Watch(run)
    values = np.array(getattr(run.particles, name))
    values[3] = value
    population, layout = run.populations[0], run.layouts[0]
    population.set_rows(layout.where(name), values.reshape(len(values), -1))
    watch.look()
    watch.compare_energy()
    return watch.found


@pytest.mark.parametrize(
    ("name", "value", "wrong"),
    [
        ("v", np.nan, "a state is not a number"),
        ("F", [[-1.0, 0.0], [0.0, 1.0]], "J <= 0"),
        ("v", 1e3, "energy from nowhere"),
    ],
)
def test_the_judge_notices_a_spoiled_particle(name, value, wrong):
    assert wrong in spoiled(name, value).wrong


def test_the_judge_takes_only_messages_that_name_step_and_particle():
    assert COMPLETE.search(MESSAGE)
    assert Found(message=MESSAGE).verdict == STOPPED
    assert Found(message=MESSAGE.replace("rank 0: ", "")).verdict == FAILED
    assert incomplete("something went wrong")
