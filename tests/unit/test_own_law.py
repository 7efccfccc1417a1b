"""Laws of one's own with a state: what a particle keeps, how it advances, where it is written, and what is refused."""

import math
import pickle
import re

import h5py
import numpy as np
import own_laws
import pytest
from launch import ROOT

import pmpm
from pmpm.parallel.comm import Alone
from pmpm.physics import tensors2 as la
from pmpm.physics.words import where
from pmpm.run import run_scene
from pmpm.scene.errors import NotBuilt
from pmpm.scene.materials import material
from pmpm.timestep import WAVE

MU, LAM = 4e3, 6e3


def rubber(F, mu, lam):
    return la.scale_plus_diagonal(mu, la.left_cauchy_green(F), lam * (la.det(F) - 1.0) - mu)


def ageing(F, age, mu, lam):
    return la.scale_plus_diagonal(1.0 / (1.0 + age), rubber(F, mu, lam), 0.0)


def grow_old(F, G, dt, age):
    return la.add(F, la.matmul(G, F)), age + dt


def stay(F, G, dt):
    return la.add(F, la.matmul(G, F))


def never(F, mu):
    return F[0] < mu


def sound(F, mu, lam, density):
    return (2.0 * mu + 2.0 * lam) / density


AGEING = pmpm.Law(ageing, advance=grow_old, state={"age": 0.5})
KEYS = {"density": 1000.0, "mu": MU, "lam": LAM}


def scene(law, dim=2, **more):
    low, high = [0.0] * dim, [0.1] * dim
    return pmpm.Scene(
        domain={"size": [0.4] + [0.2] * (dim - 1), "cell_size": 0.02},
        time={"end": 0.01, "step": 5e-4},
        materials={"stuff": KEYS | {"model": law} | more},
        bodies=[{"material": "stuff", "shape": {"type": "box", "min": low, "max": high}}],
        output={"fields": ["J", *(["age"] if law is AGEING else [])], "snapshot_interval": 0.01},
    )


def refusal(law, **more):
    with pytest.raises(pmpm.SceneError) as raised:
        scene(law, **more)
    assert not isinstance(raised.value, NotBuilt)
    return str(raised.value)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_state_variable_starts_at_rest_and_advances(dim):
    simulation = pmpm.Simulation(scene(AGEING, dim))
    assert (simulation.particles.age == 0.5).all()
    simulation.run(steps=4)
    np.testing.assert_allclose(simulation.particles.age, 0.5 + 4 * 5e-4, rtol=1e-14)


def test_what_damage_takes_of_the_stored_energy_is_dissipated():
    """Of a body that comes to rest at a wall and breaks: energy is lost, and what is measured is finite."""
    simulation = pmpm.Simulation(own_laws.scene())
    simulation.run(steps=60)
    assert simulation.particles.damage.max() > 0.5
    assert simulation.measure()["dissipated"] > 0.05 * simulation.first_energy


def test_damage_never_heals():
    simulation = pmpm.Simulation(own_laws.scene())
    seen = np.zeros(simulation.rows())
    for _ in range(6):
        simulation.run(steps=10)
        now = simulation.particles.damage[np.argsort(simulation.particles.id)]
        assert (now >= seen).all()
        seen = now


def test_a_tuple_is_a_state_variable_of_several_numbers():
    simulation = pmpm.Simulation(own_laws.scene())
    simulation.run(steps=3)
    most = simulation.particles.most
    assert most.shape == (simulation.rows(), 2)
    np.testing.assert_allclose(most[:, 1], simulation.time, rtol=1e-14)


def test_state_variables_are_written_to_snapshots(tmp_path):
    simulation = run_scene(scene(AGEING), tmp_path / "run", Alone(), quiet=True)
    with h5py.File(sorted((tmp_path / "run" / "snapshots").iterdir())[-1]) as file:
        age = file["pmpm/python:ageing/age"][...]
        assert np.array_equal(file["VTKHDF/PointData/age"][...], age)
    np.testing.assert_allclose(age, 0.5 + simulation.time, rtol=1e-13)


def test_a_state_variable_that_is_not_a_number_stops_the_run():
    def sick(F, G, dt, age):
        return la.add(F, la.matmul(G, F)), where(age > 0.501, math.nan, age + dt)

    simulation = pmpm.Simulation(scene(pmpm.Law(rubber, advance=sick, state={"age": 0.5})))
    with pytest.raises(pmpm.NumericalFailure, match=r"no longer valid: .*age = \[nan\]"):
        simulation.run(steps=10)


def test_a_state_that_the_law_calls_invalid_stops_the_run():
    def young(F, age):
        return age < 0.501

    simulation = pmpm.Simulation(scene(pmpm.Law(rubber, advance=grow_old, state={"age": 0.5}, valid=young)))
    with pytest.raises(pmpm.NumericalFailure, match=r"no longer valid: .*age = \[0.501"):
        simulation.run(steps=10)


def test_the_wave_speed_of_a_law_sets_the_step():
    law = pmpm.Law(rubber, wave_speed=sound)
    assert pmpm.Simulation(scene(law)).fastest()[WAVE] == pytest.approx(((2.0 * MU + 2.0 * LAM) / 1000.0) ** 2)
    assert "has a wave_speed function that gives" in refusal(law, density=1e6)
    assert "does not go with the wave_speed function of rubber" in refusal(law, sound_speed=99.0)


def test_a_law_of_one_function_is_that_function():
    assert scene(pmpm.Law(rubber)) == scene(rubber)


def test_defaults_may_stand_in_any_of_the_functions():
    assert material(own_laws.MATERIAL).strength == 1e3


def test_a_law_is_recorded_by_name_and_by_a_hash_over_all_its_functions_and_its_state():
    laws = (
        AGEING,
        pmpm.Law(ageing, advance=grow_old, state={"age": 0.25}),
        pmpm.Law(ageing, advance=lambda_free(2.0), state={"age": 0.5}),
    )
    records = [re.search(r'model = "(python:ageing:\w{12})"', scene(law).to_toml())[1] for law in laws]
    assert len(set(records)) == 3


def lambda_free(factor):
    """grow_old at another pace."""
    space = {"la": la, "__name__": __name__}
    exec(f"def grow_old(F, G, dt, age):\n    return la.add(F, la.matmul(G, F)), age + {factor} * dt", space)
    return space["grow_old"]


def test_a_material_with_a_law_survives_pickling():
    own = material(own_laws.MATERIAL)
    assert pickle.loads(pickle.dumps(own)) == own


def flat(F, G, dt, age):
    return (*la.add(F, la.matmul(G, F)), age)


def constant(F, G, dt, age):
    return la.identity_plus((0.0, 0.0, 0.0, 0.0)), age


def branching(F, G, dt, age):
    return la.add(F, la.matmul(G, F)), (age + dt if age > 0.1 else age)


def whole(F, G, dt, age):
    return la.add(F, la.matmul(G, F)), 2 * age


def pair(F, mu, lam):
    return mu, lam


def loose(F):
    return F[0]


def ageless(F, G, dt, age):
    return la.add(F, la.matmul(G, F))


def law(**more):
    return pmpm.Law(**({"stress": ageing, "advance": grow_old, "state": {"age": 0.5}} | more))


BAD = [
    ("state without advance", law(advance=None), "must have an advance function: without it the state (age) never"),
    ("list as state", law(state=["age"]), "must have its state as a table"),
    ("text at rest", law(state={"age": "old"}), "must have a finite number, or a tuple of them, for age at rest"),
    ("nan at rest", law(state={"age": math.nan}), "for age at rest, not nan"),
    ("taken name", law(state={"age": 0.5, "velocity": 0.0}), "must not call a state variable velocity: the name is taken"),
    ("no name", law(state={"my age": 0.5}), "must not call a state variable 'my age'"),
    ("keyword", law(state={"lambda": 0.5}), "must not call a state variable 'lambda'"),
    ("too many", law(state={"age": (0.0,) * 9}), "keeps 13 numbers in 2-D, 4 of F and 9 of its state; kernels know up to 12"),
    ("flat", law(advance=flat), "has flat for advance, which must return (F, age)"),
    ("F missing", law(advance=ageless), "must return (F, age)"),
    ("constant F", law(advance=constant), "must make F from the F and G of the particle"),
    ("if", law(advance=branching), "branching for advance, which must not use if, and, or"),
    ("whole number", law(advance=whole), "whole for advance, which mixes the whole number 2 with reals"),
    ("lambda", law(energy=lambda F: 0.0), "must be a plain function made by def"),
    ("energy of two", law(energy=pair), "pair for energy, which must return one number, not a tuple"),
    ("valid with parameters", law(valid=never), "must have a valid function of F and state variables only, not of mu"),
    ("valid without a comparison", law(valid=loose), "must return a comparison"),
    ("step in stress", law(stress=stay, state={}), "must not take G in stress"),
    ("name", law(name="two words"), "a law whose name must be a word"),
]  # fmt: skip


@pytest.mark.parametrize(("own", "fragment"), [case[1:] for case in BAD], ids=[case[0] for case in BAD])
def test_what_cannot_be_a_law_with_a_state_is_told_in_one_line(own, fragment):
    message = refusal(own)
    assert message.startswith("scene: materials.stuff.model = ")
    assert fragment in message
    assert "\n" not in message
    assert "0x" not in message


def test_two_laws_cannot_keep_different_things_under_one_name():
    both = {name: KEYS | {"model": law(state={"age": rest}, stress=rubber, advance=own)} for name, rest, own in (
        ("young", 0.5, grow_old), ("old", (0.5, 0.5), same_pair)
    )}  # fmt: skip
    with pytest.raises(pmpm.SceneError, match="materials.old.model keeps 2 numbers as age, another law of the scene 1"):
        pmpm.Scene(
            domain={"size": [0.4, 0.2], "cell_size": 0.02},
            time={"end": 0.01},
            materials=both,
            bodies=[{"material": "old", "shape": {"type": "box", "min": [0, 0], "max": [0.1, 0.1]}}],
        )


def same_pair(F, G, dt, age):
    return la.add(F, la.matmul(G, F)), age


def test_the_example_of_a_law_with_a_state_in_the_documentation_runs():
    text = (ROOT / "docs" / "scene.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"```python\n(.*?)```", text[text.index("### A law with a state") :], re.DOTALL)
    space = {"__name__": "example"}
    exec(example, space)
    simulation = space["simulation"]
    assert simulation.finished
    assert 0.01 < simulation.particles.damage.max() < 1.0
