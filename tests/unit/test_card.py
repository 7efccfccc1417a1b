"""Kernels for graphics cards, without one: what a step calls, what the compiler and the assembler make of it."""

import ast
import re
from pathlib import Path

import assembler
import law_examples
import pytest

import pmpm
from pmpm.explain import card_kernels
from pmpm.processors.plan import kernels_of
from pmpm.scene.needs import scene_needs

ROOT = Path(pmpm.__file__).parent
A100, H100 = (8, 0), (9, 0)  # compute capabilities
LAWS = {"elastic": "neo_hookean", "water": "fluid", "sand": "drucker_prager"}


def block(model, dim=3, **changes):
    """A few particles of a law in a box."""
    method = {"precision": "float32", "transfer": "mls"} | changes.pop("method", {})
    domain = {"size": [0.8] * dim, "cell_size": 0.1, "gravity": [0.0, -9.81, 0.0][:dim]} | changes.pop("domain", {})
    return pmpm.Scene(
        domain=domain,
        method=method,
        time={"end": 1.0},
        materials=dict.fromkeys(("m", "n"), law_examples.EXAMPLES[model]),
        bodies=[
            {"material": "m", "shape": {"type": "box", "min": [0.2] * dim, "max": [0.5] * dim}},
            {"material": "n", "shape": {"type": "box", "min": [0.5] * dim, "max": [0.6] * dim}},
        ],
        **changes,
    )


@pytest.mark.parametrize(
    ("law", "dim", "capability"), [*((law, 3, A100) for law in LAWS), ("sand", 3, H100), ("sand", 2, H100)]
)
def test_kernels_in_float32_have_no_double_arithmetic_no_stack_and_spill_nothing(law, dim, capability):
    ball = {"shape": {"type": "sphere", "center": [0.3] * dim, "radius": 0.1}}
    rubbing = ball | {"surface": {"type": "friction", "coefficient": 0.3}}
    noted = kernels_of(block(LAWS[law], dim, colliders=[rubbing], contact={"friction": 0.3}))
    found = {kernel.name: assembler.assemble(kernel.ptx(capability), capability) for kernel in noted}
    assert {
        "p2g 0",
        "g2p 0",
        "p2g_volumes 0",
        "touch",
        "mirror_volumes",
        "collider friction",
        "mark",
        "sum_energies 0",
        "find_homes",
        "move_by_digit",
        "gather_fields",
    } <= set(found)
    costly = {name: made for name, made in found.items() if made.doubles or made.stack or made.spills}
    assert costly == {}
    # It would be cheap to find nothing in a text of another form.
    assert all(made.registers > 5 for made in found.values())
    assert found["p2g 0"].atomics >= 4


def test_a_kernel_in_float64_has_double_arithmetic():
    (p2g,) = (
        noted for noted in kernels_of(block("neo_hookean", 2, method={"precision": "float64"})) if noted.name == "p2g 0"
    )
    assert ".f64" in p2g.ptx((9, 0))


CASES = {
    "plain": {},
    "flip, periodic": {"method": {"transfer": "flip"}, "domain": {"size": [0.8, 0.8], "periodic": ["x", "y"]}},
    "f-bar, damped": {"method": {"transfer": "apic", "f_bar": True, "damping": 1.0}},
    "no gravity, stick": {"domain": {"gravity": [0.0, 0.0], "walls": {"y_min": "stick"}}},
    "colliders": {"colliders": [{"shape": {"type": "sphere", "center": [0.3, 0.3], "radius": 0.1}}]},
    "contact": {"contact": {"friction": 0.3}},
    "contact, no wall": {
        "contact": {},
        "domain": {"walls": dict.fromkeys(("x_min", "x_max", "y_min", "y_max"), "free")},
    },
    "driven": {"motions": [{"shape": {"type": "box", "min": [0.0, 0.0], "max": [0.8, 0.2]}, "velocity": [0.0, 0.0]}]},
}


@pytest.mark.parametrize("case", CASES)
def test_a_step_calls_the_kernels_that_check_tells_and_no_other(case):
    scene = block(
        "neo_hookean",
        2,
        **{key: dict(value) if isinstance(value, dict) else value for key, value in CASES[case].items()},
    )
    told = {name for names in card_kernels(scene, scene_needs(scene)).values() for name in names}
    called = {re.sub(r" \d+$", "", noted.name) for noted in kernels_of(scene)}
    # `kernels_of` sums energies whether the guard asks for them or not.
    summing = {"sum_energies", "clear_reals"}
    assert called | summing == told | summing


def test_only_the_files_for_cards_name_numba_cuda():
    naming = {
        str(path.relative_to(ROOT))
        for path in ROOT.rglob("*.py")
        if re.search(r"numba\.cuda|from numba import cuda", path.read_text(encoding="utf-8"))
    }
    assert naming == {
        "kernels/cuda_loops.py", "kernels/cuda_sorting.py", "kernels/targets.py", "processors/cards.py", "processors/cuda.py",
        "processors/plan.py",
    }  # fmt: skip


def test_the_loops_for_cards_hold_no_physics():
    """No root, exponential or power, and nothing named as the laws name their quantities."""
    source = "".join(
        (ROOT / "kernels" / f"cuda_{name}.py").read_text(encoding="utf-8") for name in ("loops", "sorting")
    )
    tree = ast.parse(source)
    called = {node.func.id for node in ast.walk(tree) if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)}
    assert not called & {"sqrt", "exp", "log", "expm1", "log1p", "sin", "cos", "pow"}
    assert not re.search(r"\b(kirchhoff|youngs|bulk_modulus|friction_angle)\b", source)
