"""What the compiled kernels hold, and when they are compiled again."""

import functools
import gc
import json
import math
import os
import platform
import re
import shutil
import struct
import subprocess
import sys
from collections import Counter
from contextlib import nullcontext
from pathlib import Path
from types import FunctionType

import law_examples
import llvmlite.binding
import numba
import numpy as np
import pytest
from llvm_text import arithmetic_in

import pmpm
from pmpm.kernels import targets
from pmpm.kernels.build import LAYING_OUT, OUT_OF_BLOCKS, PER_CONTACT, PER_CUT, PER_OPEN, PER_PLACES, PER_SCENE, SORTING
from pmpm.physics import hencky
from pmpm.physics.materials import neo_hookean
from pmpm.physics.words import ATANH_OVER_ROOT, EXPM1_OF_TWICE

PACKAGE = Path(pmpm.__file__).parent
WATER = {"model": "fluid", "density": 1000.0, "sound_speed": 15.0}
RUBBER = {"model": "neo_hookean", "density": 1000.0, "youngs_modulus": 1e4, "poisson_ratio": 0.3}
SAND = RUBBER | {"model": "drucker_prager", "friction_angle": 30.0}


def box(low, high):
    return {"type": "box", "min": low, "max": high}


def scene(materials, precision="float64", transfer="apic", dim=2, periodic=(), f_bar=False, **keys):
    """A box of each material, side by side. With a periodic slab axis, x, one rank has a cut as well."""
    bodies = [
        {"material": name, "shape": box([0.2 * i] + [0.0] * (dim - 1), [0.2 * i + 0.1] + [0.1] * (dim - 1))}
        for i, name in enumerate(materials)
    ]
    return pmpm.Scene(
        domain={
            "size": [0.8] + [0.2] * (dim - 1),
            "cell_size": 0.02,
            "gravity": [0.0] * (dim - 1) + [-9.81],
            "periodic": periodic,
        },
        method={"precision": precision, "transfer": transfer, "f_bar": f_bar},
        time={"end": 0.1},
        materials=materials,
        bodies=bodies,
        **keys,
    )


def in_the_way(dim):
    """Something of each surface, well apart."""
    surfaces = ("stick", "slip", "separate", {"type": "friction", "coefficient": 0.3})
    places = ([0.1 + 0.2 * i] + [0.15] * (dim - 1) for i in range(len(surfaces)))
    return [
        {"shape": {"type": "sphere", "center": place, "radius": 0.03}, "surface": surface}
        for place, surface in zip(places, surfaces, strict=True)
    ]


def text_of(simulation, names=("p2g 0", "g2p 0")):
    """LLVM text of entry kernels after optimisation, by name."""
    entries = simulation.kernels.entries
    texts = {name: "\n".join(map(entries[name].inspect_llvm, entries[name].signatures)) for name in names}
    assert all("define " in text for text in texts.values())  # what comes from the cache on disk keeps no text
    return texts


@pytest.fixture(scope="module")
def simulation_of(tmp_path_factory):
    """Simulations by scene and kind of loops, each compiled in this process and once: what is loaded keeps no LLVM text."""

    @functools.cache
    def made(scene, loops):
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("PMPM_CACHE_DIR", str(tmp_path_factory.mktemp("cache")))
            patch.setenv("PMPM_LOOPS", loops)
            return pmpm.Simulation(SCENES[scene]())

    return lambda scene, loops="lanes": made(scene, loops)


ALL_LAWS = {"water": WATER, "rubber": RUBBER, "sand": SAND}
SCENES = {
    "dam break": lambda: pmpm.Scene.builtin("dam_break"),
    "colliding disks": lambda: pmpm.Scene.builtin("colliding_disks"),
    "water and sand": lambda: scene({"water": WATER, "sand": SAND}),
    "water, MLS": lambda: scene({"water": WATER}, transfer="mls"),
    "float32, 2-D": lambda: scene(ALL_LAWS, "float32", dim=2, periodic=["x"], colliders=in_the_way(2), contact={}),
    "float32, 3-D": lambda: scene(ALL_LAWS, "float32", dim=3, periodic=["x"], colliders=in_the_way(3)),
    "float32, FLIP and F-bar": lambda: scene({"rubber": RUBBER}, "float32", "flip", f_bar=True),
    "float32, 3-D, water": lambda: scene({"water": WATER}, "float32", dim=3),
}


# ---- what a scene does not choose is not there --------------------------------------------------------------------------


def in_llvm(number):
    """A double as LLVM writes it: on lanes exp and log are polynomials and no calls, and told by their constants."""
    return "0x" + struct.pack(">d", number).hex().upper()


EXPONENTIAL = in_llvm(1 / math.log(2))  # exp and expm1 divide by ln 2
LOGARITHM = in_llvm(math.sqrt(2))  # log and log1p bring the mantissa below it
HENCKY = {  # what eigenvalues and Hencky strains cannot do without
    "square root": "sqrt",
    "expm1": in_llvm(1 / math.factorial(14)),  # exp stops at 13
    "series of exp(2 E) - 1": in_llvm(EXPM1_OF_TWICE[0]),
    "series of atanh": in_llvm(ATANH_OVER_ROOT[0]),
}


def hencky_in(text):
    return [name for name, mark in HENCKY.items() if mark in text]


def test_dam_break_holds_no_root_no_decomposition_and_no_deformation_gradient(simulation_of):
    simulation = simulation_of("dam break")
    assert [field.name for field in simulation.layouts[0].fields] == ["x", "v", "C", "J"]
    text = text_of(simulation)
    assert EXPONENTIAL in text["p2g 0"]  # the equation of state is there, so the search below looks at the right text
    assert LOGARITHM in text["p2g 0"]
    assert not hencky_in(text["p2g 0"] + text["g2p 0"])


def test_colliding_disks_keep_no_plastic_state(simulation_of):
    simulation = simulation_of("colliding disks")
    assert [field.name for field in simulation.layouts[0].fields] == ["x", "v", "C", "F"]
    text = text_of(simulation)
    assert LOGARITHM in text["p2g 0"]
    assert EXPONENTIAL not in text["p2g 0"] + text["g2p 0"]
    assert not hencky_in(text["p2g 0"] + text["g2p 0"])


def test_the_search_for_roots_and_strains_finds_them_where_they_are(simulation_of):
    text = text_of(simulation_of("water and sand"), ["g2p 1"])["g2p 1"]
    assert hencky_in(text) == list(HENCKY)
    assert EXPONENTIAL in text
    assert LOGARITHM in text


def test_mls_computes_no_weight_gradients(simulation_of):
    """The quadratic slopes are the only place where a distance is multiplied by -2."""
    apic, mls = (text_of(simulation_of(s), ["p2g 0"])["p2g 0"] for s in ("water and sand", "water, MLS"))
    minus_two = re.compile(r"-2\.0+e\+00")
    assert minus_two.search(apic)
    assert not minus_two.search(mls)


# ---- precision and width of vectors -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("loops", "scene_name"),
    [
        ("lanes", "float32, 2-D"),
        ("lanes", "float32, 3-D"),
        ("scalar", "float32, 3-D"),
        ("lanes", "float32, FLIP and F-bar"),
        ("scalar", "float32, FLIP and F-bar"),
    ],
)
def test_float32_kernels_hold_no_double_arithmetic(simulation_of, loops, scene_name):
    """No entry of a step does, those that sort particles and sum planes included; the guard sums energies in double."""
    simulation = simulation_of(scene_name, loops)
    simulation.kernels.damp(simulation.patch.nodes[0], 0, 0, simulation.drive.kept(0.0))
    unused = (*OUT_OF_BLOCKS, *PER_OPEN, *(() if simulation.slabs.cuts else PER_CUT))
    unused += () if simulation.needs.contact else PER_CONTACT
    entries = [name for name in simulation.kernels.entries if not name.startswith("energies")]
    texts = text_of(simulation, [name for name in entries if name not in unused])
    assert {name: found for name, text in texts.items() if (found := arithmetic_in(text, "double"))} == {}
    for name in texts:
        if name.startswith(("p2g", "g2p")):
            assert arithmetic_in(texts[name], "float")  # the search looks at the right text


def test_the_search_for_double_arithmetic_finds_it_in_float64(simulation_of):
    """Of single numbers, of lanes, and in calls of either."""
    text = text_of(simulation_of("water and sand"), ["g2p 1", "p2g 1"])
    found = "\n".join(arithmetic_in(text["g2p 1"] + text["p2g 1"], "double"))
    assert re.search(r"fmul [a-z ]*double", found)
    assert re.search(r"fmul [a-z ]*<16 x double>", found)
    assert re.search(r"call [a-z ]*<16 x double> @", found)
    assert not arithmetic_in(text["g2p 1"], "float")


def registers_of_arithmetic(simulation, names):
    """How often the assembly of these kernels computes with single precision in zmm, ymm, xmm, or one number at a time."""
    entries, counts = simulation.kernels.entries, Counter()
    for name in names:
        for signature in entries[name].signatures:
            text = entries[name].inspect_asm(signature)
            for operation, packed, operands in re.findall(
                r"\bv(fn?m(?:add|sub)\d+|add|sub|mul|div)([ps]s)\s(.*)", text
            ):
                register = re.search("[xyz]mm", operands).group() if packed == "ps" else "one"
                counts["fma" if operation.startswith("f") else "other", register] += 1
    return counts


def share(counts, register, kinds=("fma",)):
    return sum(counts[k, register] for k in kinds) / sum(n for (kind, _), n in counts.items() if kind in kinds)


def check_width(counts, register):
    """The vectors of the machine do the work.

    Found: every FMA, and 95 % of the arithmetic. Once a segment or a call single numbers are computed with (mass, step,
    limits); a compiler may do a little more of that, so nearly all is claimed, not all.
    """
    assert sum(n for (kind, _), n in counts.items() if kind == "fma") > 100
    assert share(counts, register) >= 0.95
    assert share(counts, register, ("fma", "other")) >= 0.9
    assert share(counts, "one") <= 0.02


on_x86 = pytest.mark.skipif(platform.machine().lower() not in ("x86_64", "amd64"), reason="names registers of x86")


@on_x86
def test_float32_kernels_compute_in_the_widest_vectors_of_the_machine(simulation_of):
    """P2G and G2P of all laws: 512 bits with AVX-512, else 256 bits."""
    features = llvmlite.binding.get_host_cpu_features()
    told = numba.config.CPU_NAME or numba.config.CPU_FEATURES
    if told or not (features.get("avx2") and features.get("fma")):
        pytest.skip("compiled for another machine, or for one without AVX2 and FMA")
    names = [f"{phase} {law}" for phase in ("p2g", "g2p") for law in range(3)]
    counts = registers_of_arithmetic(simulation_of("float32, 3-D"), names)
    check_width(counts, "zmm" if features.get("avx512f") else "ymm")


def print_registers():
    counts = registers_of_arithmetic(pmpm.Simulation(SCENES["float32, 3-D, water"]()), ["p2g 0", "g2p 0"])
    print(json.dumps([[*key, count] for key, count in counts.items()]))


@on_x86
def test_float32_kernels_compute_in_256_bits_on_machines_without_avx512(tmp_path):
    environment = (
        os.environ
        | {
            "NUMBA_CPU_NAME": "x86-64-v3",
            "NUMBA_CPU_FEATURES": "+avx2,+fma",  # numba adds those of this machine to the name unless told which
            "PMPM_CACHE_DIR": str(tmp_path),
            "PMPM_LOOPS": "lanes",
            "PYTHONPATH": os.pathsep.join(map(str, [PACKAGE.parent, *Path(__file__).parents[:2]])),
        }
    )
    command = [sys.executable, "-c", "import test_kernels; test_kernels.print_registers()"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr
    counts = Counter({(kind, register): n for kind, register, n in json.loads(done.stdout)})
    check_width(counts, "ymm")
    assert counts["fma", "zmm"] + counts["other", "zmm"] == 0


# ---- one source ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("example", law_examples.each_example(), ids=law_examples.identify)
def test_plain_python_numpy_and_numba_agree(example):
    """One source: the same law as plain Python, over numpy arrays and compiled, to round-off of exp and log."""
    states, gradients = example.particles(20)
    plain, compiled_update, arrays = (
        make(**example.words).compile(advance_then_stress)
        for make in (
            targets.plain,
            functools.partial(targets.scalar, np.float64),
            functools.partial(targets.arrays, np.float64),
        )
    )
    over_arrays = arrays(tuple(states.T), tuple(gradients.T), example.params)
    for k in range(len(states)):
        state, gradient = tuple(map(float, states[k])), tuple(map(float, gradients[k]))
        expected = plain(state, gradient, example.params)
        for other in (compiled_update(state, gradient, example.params), [c[k] for c in over_arrays]):
            np.testing.assert_allclose(other, expected, rtol=1e-11, atol=1e-11 * law_examples.STIFFNESS)


law = neo_hookean  # replaced by each target


def advance_then_stress(state, G, params):
    advanced = law.advance(state, G, 1e-3, params)
    return advanced + law.kirchhoff_stress(advanced, params)


# ---- parts of kernels ----------------------------------------------------------------------------------------------------


def half(x):
    return 0.5 * x


def twice(x):
    return x + x


def half_of_twice(x):
    return half(twice(x)) - twice(half(x) * 3.0)


def test_what_a_kernel_calls_is_compiled_once_in_a_process_and_to_no_machine_code_of_its_own():
    """Of two kernels made apart from one source; numba would compile each function for itself, and to the end."""
    first, second = (targets.scalar(np.float64).compile(half_of_twice) for _ in range(2))
    assert first is not second
    assert first(5.0) == second(5.0) == 5.0 - 15.0
    part = first.py_func.__globals__["twice"]
    assert part is second.py_func.__globals__["twice"]
    assert len(part.overloads) == 1
    (compiled,) = part.overloads.values()
    code = compiled._asdict()["library"]
    assert code.get_pointer_to_function(compiled.fndesc.llvm_func_name) == 0
    with pytest.raises(TypeError, match="twice is part of a kernel"):
        part(5.0)


def test_functions_that_change_places_change_the_fingerprint():
    """The code of both is the same but for the order of the names in it."""

    def swapped(x):
        return twice(half(x)) - half(twice(x) * 3.0)

    assert swapped.__code__.co_code == half_of_twice.__code__.co_code
    copy = FunctionType(swapped.__code__, globals(), "half_of_twice")
    assert targets.plain().specialise(copy)[1] != targets.plain().specialise(half_of_twice)[1]


@pytest.mark.parametrize(("argument", "error"), [(1.0, None), ("text", numba.TypingError)])
def test_garbage_is_collected_again_after_a_kernel_is_compiled(argument, error):
    assert gc.isenabled()
    kernel = targets.scalar(np.float64).compile(half)
    with pytest.raises(error) if error else nullcontext():
        kernel(argument)
    assert gc.isenabled()


def test_parts_may_hold_comprehensions():
    """Passes that compile them are left out for parts without any."""
    assert targets.scalar(np.float64).compile(sum_of_squares)(3) == 0.0 + 1.0 + 4.0


def squares(count):
    return [1.0 * k * k for k in range(count)]


def sum_of_squares(count):
    total = 0.0
    for square in squares(count):
        total += square
    return total


# ---- when kernels are compiled again -------------------------------------------------------------------------------------


def run(folder, package, cache, out):
    """Run the scene of `folder` in a fresh process with its own copy of the package; returns its report."""
    environment = os.environ | {"PYTHONPATH": str(package.parent), "PMPM_CACHE_DIR": str(cache)}
    command = [sys.executable, "-m", "pmpm", "run", "both.toml", "--steps", "2", "--quiet", "--out", out]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr
    return json.loads((folder / out / "run.json").read_text())["report"]


def test_a_second_start_compiles_nothing_and_an_edit_only_what_uses_it(tmp_path):
    """Of a scene of water and rubber, editing rubber's law compiles its P2G and its G2P again, nothing else.

    The words of lanes.py are no plain Python that could be followed into each kernel: editing it compiles all of them.
    """
    package, cache = tmp_path / "copy" / "pmpm", tmp_path / "cache"
    shutil.copytree(PACKAGE, package, ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "both.toml").write_text(scene({"water": WATER, "rubber": RUBBER}).to_toml(), encoding="utf-8")

    first = run(tmp_path, package, cache, "first")
    kernels = first["kernels_compiled"]
    # P2G and G2P of two laws; 2 that every scene has for its nodes, 6 to sort particles, 3 to lay nodes out; separating wall
    # and its image; 2 of the checkpoint with which a run stops early.
    assert (
        kernels
        == 2 * 2 + len(PER_SCENE) + len(PER_PLACES) + len(SORTING) + len(LAYING_OUT) + 2 + len(OUT_OF_BLOCKS)
        == 19
    )
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

    with (package / "kernels" / "lanes.py").open("a") as words_of_lanes:
        words_of_lanes.write("# edited\n")
    sixth = run(tmp_path, package, cache, "sixth")
    assert (sixth["kernels_compiled"], sixth["kernels_loaded"]) == (kernels, 0)


def energy(E, mu, lam):
    """Called like the function of the module that it uses."""
    return hencky.energy(E, mu, lam)


def test_a_function_may_use_one_of_a_module_that_is_called_like_itself():
    found = targets.plain(la=law_examples.TENSORS[3]).compile(energy)((1.0, 0.0, 0.0, 0.0, 0.0, 0.0), 1.0, 1.0)
    assert found == 1.5  # mu |E|^2 + lam / 2 (tr E)^2


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
