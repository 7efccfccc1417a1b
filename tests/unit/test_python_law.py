"""A law of your own: the same bits as a built-in one, a record of what was run, and clear words about what cannot be one."""

import functools
import math
import os
import pickle
import re
import subprocess
import sys

import numpy as np
import pytest
from launch import ROOT

import pmpm
from pmpm.kernels import targets
from pmpm.physics import tensors2, tensors3
from pmpm.physics import tensors2 as la
from pmpm.physics.materials import neo_hookean, python_law
from pmpm.physics.words import log, where
from pmpm.scene.errors import NotBuilt
from pmpm.scene.materials import material

ROW = 1e-10  # called like a word of the kernels; it stays this number all the same
MU, LAM, DENSITY = 4e3, 6e3, 1000.0
RUBBER = {"density": DENSITY, "mu": MU, "lam": LAM}
SPEED = math.sqrt((LAM + 2.0 * MU) / DENSITY)


def rubber(F, mu, lam):
    """The built-in neo-Hookean solid, once more."""
    return la.scale_plus_diagonal(mu, la.left_cauchy_green(F), lam * log(max(la.det(F), ROW)) - mu)


def with_pressure(F, mu, lam=LAM):
    """A law of two dimensions that tells the stress out of the plane."""
    b, pressure = la.left_cauchy_green(F), lam * math.log(max(la.det(F), ROW))
    return mu * (b[0] - 1.0) + pressure, mu * b[1], mu * (b[2] - 1.0) + pressure, pressure


def scene(law, dim=2, precision="float64", time=None, **output):
    low, high = [0.0] * dim, [0.1] * dim
    return pmpm.Scene(
        domain={"size": [0.6] + [0.2] * (dim - 1), "cell_size": 0.02, "gravity": [0.0] * (dim - 1) + [-9.81]},
        method={"precision": precision},
        time=time or {"end": 0.1, "step": 5e-4},
        materials={"rubber": law},
        bodies=[
            {
                "material": "rubber",
                "shape": {"type": "box", "min": low, "max": high},
                "velocity": [-1.0] + [0.0] * (dim - 1),
            }
        ],
        output=output,
    )


def built_in():
    poisson = LAM / (2.0 * (LAM + MU))
    return {
        "model": "neo_hookean",
        "density": DENSITY,
        "youngs_modulus": 2.0 * MU * (1.0 + poisson),
        "poisson_ratio": poisson,
    }


def refusal(law, kind=pmpm.SceneError, **more):
    with pytest.raises(kind) as raised:
        scene(law, **more)
    return str(raised.value)


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("dim", [2, 3])
def test_neo_hookean_written_once_more_gives_the_same_bits(dim, precision):
    numbers = neo_hookean.parameters(built_in(), dim)
    laws = ({"model": rubber, "density": DENSITY, "mu": numbers[0], "lam": numbers[1]}, built_in())
    own, theirs = (pmpm.Simulation(scene(law, dim, precision)) for law in laws)
    for simulation in (own, theirs):
        simulation.run(steps=20)
    assert own.particles.J.min() < 0.95  # the wall has compressed it
    for name in ("x", "v", "C", "F"):
        assert np.array_equal(getattr(own.particles, name), getattr(theirs.particles, name))
    stress = [simulation.fields(["stress"])["stress"] for simulation in (own, theirs)]
    seen = [0, 1, 3] if dim == 2 else range(6)
    assert np.array_equal(stress[0][:, seen], stress[1][:, seen])


def test_what_a_function_does_not_tell_is_not_a_number():
    simulation = pmpm.Simulation(scene({"model": rubber, **RUBBER}))
    simulation.run(steps=3)
    totals = simulation.measure()
    assert math.isnan(totals["strain"])
    assert math.isnan(totals["dissipated"])
    assert math.isfinite(totals["kinetic"])
    assert np.isnan(simulation.fields(["pressure"])["pressure"]).all()


def test_a_fourth_number_is_the_stress_out_of_the_plane():
    own, theirs = (
        pmpm.Simulation(scene(law)) for law in ({"model": with_pressure, "density": DENSITY, "mu": MU}, built_in())
    )
    for simulation in (own, theirs):
        simulation.run(steps=10)
    found, expected = (simulation.fields(["stress"])["stress"] for simulation in (own, theirs))
    assert np.ptp(expected[:, 2]) > 1.0
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-6)


# ---- the time step ----


def test_the_wave_speed_at_rest_is_found_from_the_function():
    for dim in (2, 3):
        assert scene({"model": rubber, **RUBBER}, dim).materials["rubber"].sound_speed == pytest.approx(SPEED, rel=1e-8)


def test_a_wave_speed_below_that_at_rest_is_refused():
    message = refusal({"model": rubber, **RUBBER, "sound_speed": 0.9 * SPEED})
    assert "materials.rubber.sound_speed = " in message
    assert f"must be at least {SPEED:.6g} m/s" in message


def test_a_greater_wave_speed_shortens_the_step():
    steps = []
    for speed in (SPEED, 2.0 * SPEED):
        law = {"model": rubber, **RUBBER, "sound_speed": speed}
        steps.append(pmpm.Simulation(scene(law, time={"end": 0.1, "cfl": 0.01})).dt)
    assert steps[0] == pytest.approx(2.0 * steps[1])


@pytest.mark.parametrize("tensors", [tensors2, tensors3])
def test_the_wave_speed_bounds_that_of_neo_hookean_at_large_strain(tensors):
    own = targets.plain(la=tensors).compile(python_law.wave_speed_squared)
    theirs = targets.plain(la=tensors).compile(neo_hookean.wave_speed_squared)
    dim, rng, strained = int(tensors.DIM), np.random.default_rng(3), 0
    for _ in range(500):
        F = tuple((np.eye(dim) * rng.uniform(0.3, 3.0) + 0.5 * rng.standard_normal((dim, dim))).ravel())
        if tensors.det(F) > 0.01:
            strained += 1
            mu, lam = rng.uniform(1.0, 5.0, 2)
            assert own(F, (lam + 2.0 * mu, mu, lam), 1.0) >= theirs(F, (mu, lam), 1.0) * (1.0 - 1e-12)
    assert strained > 300


def no_shear(F, stiffness):
    return la.isotropic(stiffness * (la.det(F) - la.det(F)))


def test_a_law_without_stiffness_at_rest_needs_a_wave_speed():
    law = {"model": no_shear, "density": DENSITY, "stiffness": 1e4}
    assert "materials.rubber.sound_speed is missing" in refusal(law)
    assert scene(law | {"sound_speed": 3.0}).materials["rubber"].sound_speed == 3.0


# ---- what is compiled, and when ----


def edited(constant):
    """The same function of the same module, with another constant in it."""
    space = {"__name__": __name__, "la": la}
    exec(f"def law(F, mu):\n    return la.scale_plus_diagonal(mu, la.left_cauchy_green(F), -{constant} * mu)", space)
    return space["law"]


def test_an_edited_constant_is_compiled_anew_and_recorded():
    names, records = [], []
    for constant in ("1.0", "1.0", "1.25"):
        choices = {"user_stress": edited(constant), "la": tensors2}
        names.append(targets.scalar(np.float64, **choices).entry(python_law.kirchhoff_stress).py_func.__qualname__)
        records.append(
            re.search(r"python:law:\w+", scene({"model": edited(constant), "density": 1.0, "mu": 1.0}).to_toml())[0]
        )
    assert names[0] == names[1] != names[2]
    assert records[0] == records[1] != records[2]


NOTEBOOK = """
import pmpm
from pmpm.physics import tensors2 as la
def cell(F, mu):
    return la.scale_plus_diagonal(mu, la.left_cauchy_green(F), -mu)
simulation = pmpm.Simulation(pmpm.Scene(
    domain={"size": [0.4, 0.4], "cell_size": 0.1}, time={"end": 0.1},
    materials={"rubber": {"model": cell, "density": 1e3, "mu": 1e4}},
    bodies=[{"material": "rubber", "shape": {"type": "box", "min": [0.1, 0.1], "max": [0.2, 0.2]}}],
))
simulation.run(steps=2)
report = simulation.report()
print(report["kernels_compiled"], report["kernels_loaded"])
"""


def test_a_second_process_finds_the_kernels_of_a_function_without_a_file_or_from_another_module(tmp_path):
    """Of a function typed in, as in a notebook; in the first process it is in a module that the second one lacks."""
    environment = os.environ | {"PMPM_CACHE_DIR": str(tmp_path)}
    counts = []
    for module in ("elsewhere", "__main__"):
        name = f"import sys\n__name__ = {module!r}\nsys.modules[__name__] = sys.modules['__main__']\n"
        done = subprocess.run(
            [sys.executable, "-c", name + NOTEBOOK], env=environment, capture_output=True, text=True, timeout=240
        )
        assert done.returncode == 0, done.stderr
        counts.append(tuple(map(int, done.stdout.split())))
    (compiled, none), (again, loaded) = counts
    assert compiled > 0
    assert (none, again, loaded) == (0, 0, compiled)


# ---- the record ----


def test_a_function_is_recorded_by_name_and_hash_and_its_wave_speed_filled_in():
    text = scene({"model": with_pressure, "density": DENSITY, "mu": MU}).to_toml()
    assert re.search(r'^model = "python:with_pressure:[0-9a-f]{12}"$', text, re.MULTILINE)
    assert f"lam = {LAM}" in text
    assert re.search(r"^sound_speed = 3\.741", text, re.MULTILINE)


def test_a_scene_file_with_a_function_is_refused_and_names_it(tmp_path):
    (tmp_path / "scene.toml").write_text(scene({"model": rubber, **RUBBER}).to_toml(), encoding="utf-8")
    with pytest.raises(
        pmpm.SceneError, match="is a Python function, which a file does not hold: give rubber"
    ) as raised:
        pmpm.Scene.from_toml(tmp_path / "scene.toml")
    assert not isinstance(raised.value, NotBuilt)


def test_the_command_line_ends_with_2_for_a_scene_with_a_function(tmp_path):
    (tmp_path / "scene.toml").write_text(scene({"model": rubber, **RUBBER}).to_toml(), encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-m", "pmpm", "check", "scene.toml"], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1


def test_the_function_given_on_top_of_the_record_makes_the_same_scene(tmp_path):
    own = scene({"model": rubber, **RUBBER})
    (tmp_path / "scene.toml").write_text(own.to_toml(), encoding="utf-8")
    assert pmpm.Scene.from_toml(tmp_path / "scene.toml", {"materials.rubber.model": rubber}) == own


def test_a_material_with_a_function_survives_pickling():
    own = material({"model": rubber, **RUBBER})
    assert pickle.loads(pickle.dumps(own)) == own


# ---- what cannot be a law ----


def bare(body, arguments="F, mu", **names):
    space = {"__name__": __name__, "la": la, "log": log, "where": where, "math": math, "np": np} | names
    exec(f"def law({arguments}):\n    {body}", space)
    return space["law"]


def closing():
    factor = 2.0

    def law(F, mu):
        return la.isotropic(factor * mu)

    return law


def helper_with_comprehension():
    return bare("return help(F, mu)", help=bare("return tuple([mu for x in F])"))


STRESS = "return la.scale_plus_diagonal(mu, la.left_cauchy_green(F), -mu)"
BAD = [
    ("closure", closing(), "model = law must not close over variables (factor)"),
    ("lambda", lambda F, mu: F, "not a lambda"),
    ("partial", functools.partial(rubber, mu=1.0), "not a partial"),
    ("built in", math.sin, "not a builtin_function_or_method"),
    ("class", dict, "not a type"),
    ("star arguments", bare(STRESS, "F, mu, *more"), "without * and **"),
    ("keyword only", bare(STRESS, "F, *, mu"), "without * and **"),
    ("nothing to take", bare("return (0.0, 0.0, 0.0)", ""), "must take F"),
    ("F with a default", bare(STRESS, "F=1.0, mu=1.0"), "must take F without a default"),
    ("default", bare(STRESS, "F, mu='soft'"), "must have a finite number as default of mu"),
    ("default none", bare(STRESS, "F, mu=None"), "must have a finite number as default of mu"),
    ("default nan", bare(STRESS, "F, mu=math.nan"), "must have a finite number as default of mu"),
    ("taken name", bare(STRESS.replace("mu", "copy"), "F, copy"), "must not call a parameter copy"),
    ("recursion", (lambda f: f.__globals__.update(law=f) or f)(bare("return law(F, mu)")), "calls itself"),
    ("comprehension below", helper_with_comprehension(), "calls law, which must not hold a comprehension"),
    ("power", bare("return la.isotropic(mu * F[0]**2)"), "must not use **: write x * x"),
    ("list", bare("return la.isotropic(mu * table[0])", table=[1.0]), "uses table (list)"),
    ("numpy", bare("return la.isotropic(mu * np.log(F[0]))"), "uses np (module)"),
    ("two numbers", bare("return (mu, mu)"), "must return (xx, xy, yy) or (xx, xy, yy, zz) in 2-D, not a tuple of 2"),
    ("3-D in 2-D", bare("return (mu, mu, mu, mu, mu, mu)"), "in 2-D, not a tuple of 6"),
    ("list of numbers", bare("return [mu, mu, mu]"), "not a list"),
    ("nothing returned", bare("pass"), "not a NoneType"),
    ("not finite", bare("return la.isotropic(mu * math.inf)"), "must return finite numbers, not inf, at F = (1, 0, 0, 1)"),
    ("whole number", bare("return (0, 0.0, mu)"), "must return reals such as 0.0, not 0,"),
    ("exception", bare("return la.isotropic(mu * log(F[0] - 1.0))"), "fails in 2-D at F = (1, 0, 0, 1): ValueError"),
    ("whole factor", bare("return la.isotropic(2 * mu * F[0])"), "mixes the whole number 2 with reals: write 2.0"),
    ("division by zero", bare("return la.isotropic(mu / (F[0] - 1.0))"), "must return finite numbers, not inf"),
    ("if", bare("return la.isotropic(mu if F[0] > 1.0 else 0.0)"), "must not use if, and, or"),
    ("and", bare("return la.isotropic(where(F[0] > 0.0 and F[3] > 0.0, mu, 0.0))"), "must not use if, and, or"),
    ("tangent", bare("return la.isotropic(mu * math.tan(F[1]))"), "calls a function that kernels do not know"),
    ("three in max", bare("return la.isotropic(max(mu, F[0], F[3]))"), "two numbers at a time"),
]  # fmt: skip


@pytest.mark.filterwarnings("ignore:Passing more than 2 positional")
@pytest.mark.parametrize(("law", "fragment"), [case[1:] for case in BAD], ids=[case[0] for case in BAD])
def test_what_cannot_be_a_law_is_told_in_one_line(law, fragment):
    message = refusal({"model": law, "density": DENSITY, "mu": MU})
    assert message.startswith("scene: materials.rubber.model = ")
    assert fragment in message
    assert "\n" not in message
    assert "0x" not in message


def test_the_parameters_of_a_function_are_keys_like_others():
    assert "materials.rubber.lamm is not a known key; did you mean lam?" in refusal(
        {"model": rubber, **RUBBER, "lamm": 1}
    )
    assert "materials.rubber.lam is missing" in refusal({"model": rubber, "density": DENSITY, "mu": MU})
    assert "materials.rubber.density is missing" in refusal({"model": rubber, "mu": MU, "lam": LAM})
    assert 'materials.rubber.mu = "soft" must be a number' in refusal({"model": rubber, **RUBBER, "mu": "soft"})


def test_a_parameter_called_density_is_the_density_of_the_material():
    law = bare("return la.isotropic(density * 9.0 * log(la.det(F)))", "F, density")
    assert scene({"model": law, "density": DENSITY}).materials["rubber"].sound_speed == pytest.approx(3.0, rel=1e-8)


# ---- the example in the documentation ----


def test_the_example_in_the_documentation_runs():
    text = (ROOT / "docs" / "scene.md").read_text(encoding="utf-8")
    example, *_ = re.findall(r"```python\n(.*?)```", text[text.index("## A law of your own") :], re.DOTALL)
    space = {"__name__": "example"}
    exec(example, space)
    simulation = space["simulation"]
    assert simulation.finished
    assert np.isfinite(simulation.fields(["pressure"])["pressure"]).all()
    assert simulation.measure()["kinetic"] > 0.0
