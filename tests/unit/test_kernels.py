"""What the compiled kernels hold, and when they are compiled again."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import pmpm
from pmpm.kernels import targets
from pmpm.physics import tensors2, tensors3
from pmpm.physics.materials import drucker_prager, fluid, neo_hookean

PACKAGE = Path(pmpm.__file__).parent
WATER = {"model": "fluid", "density": 1000.0, "sound_speed": 15.0}
RUBBER = {"model": "neo_hookean", "density": 1000.0, "youngs_modulus": 1e4, "poisson_ratio": 0.3}
SAND = RUBBER | {"model": "drucker_prager", "friction_angle": 30.0}


def box(low, high):
    return {"type": "box", "min": low, "max": high}


def scene(materials, precision="float64", transfer="apic", dim=2):
    """A box of each material, side by side."""
    bodies = [
        {"material": name, "shape": box([0.2 * i] + [0.0] * (dim - 1), [0.2 * i + 0.1] + [0.1] * (dim - 1))}
        for i, name in enumerate(materials)
    ]
    return pmpm.Scene(
        domain={"size": [0.8] + [0.2] * (dim - 1), "cell_size": 0.02, "gravity": [0.0] * (dim - 1) + [-9.81]},
        method={"precision": precision, "transfer": transfer},
        time={"end": 0.1},
        materials=materials,
        bodies=bodies,
    )


def compiled(simulation, names=("p2g 0", "g2p 0")):
    """LLVM text of entry kernels after optimisation, by name."""
    entries = simulation.kernels.entries
    return {name: "\n".join(map(entries[name].inspect_llvm, entries[name].signatures)) for name in names}


@pytest.fixture
def uncached(tmp_path, monkeypatch):
    """Kernels compiled in this process: those loaded from the cache keep no LLVM text."""
    monkeypatch.setenv("PMPM_CACHE_DIR", str(tmp_path))


def test_dam_break_holds_no_root_no_decomposition_and_no_deformation_gradient(uncached):
    simulation = pmpm.Simulation(pmpm.Scene.builtin("dam_break"))
    assert [field.name for field in simulation.layouts[0].fields] == ["x", "v", "C", "J"]
    text = compiled(simulation)
    assert "exp" in text["p2g 0"]  # the equation of state is there, so the search below looks at the right text
    for name in ("p2g 0", "g2p 0"):
        assert not re.search(r"sqrt|expm1|log1p", text[name])  # what eigenvalues and Hencky strains cannot do without


def test_colliding_disks_keep_no_plastic_state(uncached):
    simulation = pmpm.Simulation(pmpm.Scene.builtin("colliding_disks"))
    assert [field.name for field in simulation.layouts[0].fields] == ["x", "v", "C", "F"]
    text = compiled(simulation)
    assert "log" in text["p2g 0"]
    assert not any(re.search(r"sqrt|expm1|log1p", text[name]) for name in ("p2g 0", "g2p 0"))


def test_the_search_for_roots_finds_them_where_they_are(uncached):
    text = compiled(pmpm.Simulation(scene({"sand": SAND})))
    assert re.search(r"sqrt", text["g2p 0"])
    assert re.search(r"expm1", text["g2p 0"])


def test_mls_computes_no_weight_gradients(uncached):
    """The quadratic slopes are the only place where a distance is multiplied by -2."""
    apic, mls = (
        compiled(pmpm.Simulation(scene({"water": WATER}, transfer=t)), ["p2g 0"])["p2g 0"] for t in ("apic", "mls")
    )
    minus_two = re.compile(r"-2\.0+e\+00")
    assert minus_two.search(apic)
    assert not minus_two.search(mls)


@pytest.mark.parametrize("dim", [2, 3])
def test_float32_kernels_hold_no_double_arithmetic(uncached, dim):
    simulation = pmpm.Simulation(scene({"water": WATER, "rubber": RUBBER, "sand": SAND}, "float32", dim=dim))
    double = re.compile(r"\bf(add|sub|mul|div|cmp)\b[^\n]*\bdouble\b")
    for name, text in compiled(simulation, simulation.kernels.entries).items():
        assert "float" in text
        assert not double.search(text), name


def test_the_search_for_double_arithmetic_finds_it_in_float64(uncached):
    text = compiled(pmpm.Simulation(scene({"water": WATER})))
    assert all(re.search(r"\bf(add|mul)\b[^\n]*\bdouble\b", text[name]) for name in ("p2g 0", "g2p 0"))


@pytest.mark.parametrize(("la", "count"), [(tensors2, 4), (tensors3, 9)], ids=["2-D", "3-D"])
@pytest.mark.parametrize("model", [neo_hookean, fluid, drucker_prager], ids=lambda law: law.__name__.split(".")[-1])
def test_plain_python_numpy_and_numba_agree(model, la, count):
    """One source: the same law as plain Python, over numpy arrays and compiled, to round-off of exp and log."""
    rng = np.random.default_rng(1)
    size = {neo_hookean: count, fluid: 1, drucker_prager: {4: 4, 9: 7}[count]}[model]
    rest = (
        np.eye(round(count**0.5)).ravel() if model is neo_hookean else np.ones(1) if model is fluid else np.zeros(size)
    )
    states = rest + 0.05 * rng.standard_normal((20, size))
    gradients = 0.05 * rng.standard_normal((20, count))
    params = {neo_hookean: (400.0, 300.0), fluid: (2e3, 7.0), drucker_prager: (400.0, 300.0, 0.6)}[model]

    plain = targets.plain(la=la, law=model).compile(advance_then_stress)
    compiled_update = targets.scalar(np.float64, la=la, law=model).compile(advance_then_stress)
    over_arrays = targets.arrays(np.float64, la=la, law=model).compile(advance_then_stress)(
        tuple(states.T), tuple(gradients.T), params
    )
    for k in range(len(states)):
        expected = plain(tuple(states[k]), tuple(gradients[k]), params)
        for other in (compiled_update(tuple(states[k]), tuple(gradients[k]), params), [c[k] for c in over_arrays]):
            np.testing.assert_allclose(other, expected, rtol=1e-11, atol=1e-11 * 400.0)


law = neo_hookean  # replaced by each target


def advance_then_stress(state, G, params):
    advanced = law.advance(state, G, params)
    return advanced + law.kirchhoff_stress(advanced, params)


def run(folder, package, cache, out):
    """Run the scene of `folder` in a fresh process with its own copy of the package; returns its report."""
    environment = os.environ | {"PYTHONPATH": str(package.parent), "PMPM_CACHE_DIR": str(cache)}
    command = [sys.executable, "-m", "pmpm", "run", "both.toml", "--steps", "2", "--quiet", "--out", out]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr
    return json.loads((folder / out / "run.json").read_text())["report"]


def test_a_second_start_compiles_nothing_and_an_edit_only_what_uses_it(tmp_path):
    """Of a scene of water and rubber, editing rubber's law compiles its P2G and its G2P again, nothing else."""
    package, cache = tmp_path / "copy" / "pmpm", tmp_path / "cache"
    shutil.copytree(PACKAGE, package, ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "both.toml").write_text(scene({"water": WATER, "rubber": RUBBER}).to_toml(), encoding="utf-8")

    first = run(tmp_path, package, cache, "first")
    kernels = first["kernels_compiled"]
    assert kernels == 9  # P2G and G2P of two laws, fold, gravity, division by mass, separating wall and its image
    assert first["kernels_loaded"] == 0

    second = run(tmp_path, package, cache, "second")
    assert (second["kernels_compiled"], second["kernels_loaded"]) == (0, kernels)

    source = package / "physics" / "materials" / "neo_hookean.py"
    text = source.read_text()
    edited = text.replace("return la.add(F, la.matmul(G, F))", "return la.add(F, la.scale(1.5, la.matmul(G, F)))")
    assert edited != text
    source.write_text(edited)
    third = run(tmp_path, package, cache, "third")
    assert (third["kernels_compiled"], third["kernels_loaded"]) == (1, kernels - 1)  # advance() is used by G2P alone

    edited = edited.replace(
        "lam * log(max(la.det(F), SMALLEST)) - mu)", "lam * log(max(la.det(F), SMALLEST)) - 1.0 * mu)"
    )
    source.write_text(edited)
    fourth = run(tmp_path, package, cache, "fourth")
    assert (fourth["kernels_compiled"], fourth["kernels_loaded"]) == (1, kernels - 1)  # the stress by P2G alone

    source.write_text(edited.replace("SMALLEST = 1e-10", "SMALLEST = 1e-11"))
    fifth = run(tmp_path, package, cache, "fifth")
    assert (fifth["kernels_compiled"], fifth["kernels_loaded"]) == (2, kernels - 2)  # both use this constant


def test_a_function_that_closes_over_variables_is_refused():
    factor = 2.0

    def doubled(x):
        return factor * x

    with pytest.raises(TypeError, match="doubled must not close over variables"):
        targets.plain().compile(doubled)


def test_compiled_kernels_lie_outside_the_package(tmp_path):
    """Left behind beside the source, they would make an uninstalled package look like an empty one."""
    package = tmp_path / "copy" / "pmpm"
    shutil.copytree(PACKAGE, package, ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "both.toml").write_text(scene({"water": WATER}).to_toml(), encoding="utf-8")
    environment = os.environ | {"PYTHONPATH": str(package.parent), "XDG_CACHE_HOME": str(tmp_path / "cache")}
    environment.pop("PMPM_CACHE_DIR", None)
    command = [sys.executable, "-m", "pmpm", "run", "both.toml", "--steps", "2", "--quiet"]
    subprocess.run(command, cwd=tmp_path, env=environment, check=True, timeout=240)
    assert list((tmp_path / "cache" / "pmpm").rglob("*.nbi"))
    assert not list(package.rglob("*.nbi"))
