"""A scene holds, moves and compiles what it needs and no more; `pmpm check` and docs/results/what_scenes_need.md say so."""

import numpy as np
import pytest
import several_laws
import what_scenes_need
from launch import ROOT

from pmpm.explain import bytes_per_particle, compiled_kernels, explain, labels
from pmpm.scene.needs import scene_needs
from pmpm.scene.schema import Scene
from pmpm.simulation import Simulation

WATER = {"model": "fluid", "density": 1000.0, "sound_speed": 15.0}
RUBBER = {"model": "neo_hookean", "density": 1000.0, "youngs_modulus": 1e4, "poisson_ratio": 0.3}
SAND = RUBBER | {"model": "drucker_prager", "friction_angle": 30.0}
SHAPE = {"type": "box", "min": [0.0, 0.0], "max": [0.1, 0.1]}
LOAD = {"shape": SHAPE, "acceleration": [1.0, 0.0]}


def uniform(x, X, t):
    return (1.0, 0.0)


def tied(x, X, t):
    return (10.0 * (X[0] - x[0]), 0.0)


def at_rest(X, t):
    return 0.0 * X


def scene(*materials, **more):
    """A box of each material in 2-D and float64; `more`: tables of the scene."""
    names = [f"{number}" for number in range(len(materials))]
    shapes = [SHAPE | {"min": [0.2 * n, 0.0], "max": [0.2 * n + 0.1, 0.1]} for n in range(len(materials))]
    return Scene(
        **{
            "domain": {"size": [0.8, 0.2], "cell_size": 0.02, "gravity": [0.0, -9.81]},
            "time": {"end": 0.1},
            "materials": dict(zip(names, materials, strict=True)),
            "bodies": [{"material": name, "shape": shape} for name, shape in zip(names, shapes, strict=True)],
        }
        | more
    )


def method(**keys):
    return {"method": keys}


# Bytes in 2-D and float64: 8 per number; x and v have 2, tensors 4, symmetric ones 3.
COMMON = {"x": 16, "v": 16, "id": 8}
APIC = COMMON | {"C": 32}
HELD = {
    "water": (scene(WATER), [APIC | {"J": 8}]),
    "rubber": (scene(RUBBER), [APIC | {"F": 32}]),
    "sand": (scene(SAND), [APIC | {"hencky_strain": 24, "v_c": 8}]),
    "sand without volume correction": (scene(SAND | {"volume_correction": False}), [APIC | {"hencky_strain": 24}]),
    "rubber and water": (scene(RUBBER, WATER), [APIC | {"F": 32}, APIC | {"J": 8}]),
    "pic": (scene(WATER, **method(transfer="pic")), [COMMON | {"J": 8}]),
    "flip": (scene(RUBBER, **method(transfer="flip")), [COMMON | {"F": 32}]),
    "aflip": (scene(RUBBER, **method(transfer="aflip")), [APIC | {"F": 32}]),
    "pic, one of two viscous": (
        scene(WATER, WATER | {"viscosity": 1.0}, **method(transfer="pic")),
        [COMMON | {"J": 8}, APIC | {"J": 8}],
    ),
    "f_bar": (scene(RUBBER, **method(f_bar=True)), [APIC | {"divergence": 8, "F": 32}]),
    "loads": (scene(RUBBER, loads=[LOAD]), [APIC | {"load": 16, "F": 32}]),
    "shares": (
        scene(RUBBER, bodies=[{"material": "0", "shape": SHAPE, "seeding": "quadrature"}]),
        [APIC | {"share": 8, "F": 32}],
    ),
    "body force": (scene(RUBBER, body_force=uniform), [APIC | {"F": 32}]),
    "body force that reads X": (scene(RUBBER, body_force=tied), [APIC | {"X": 16, "F": 32}]),
    "exact solution": (scene(RUBBER, exact={"displacement": at_rest}), [APIC | {"X": 16, "F": 32}]),
    "float32": (scene(WATER, **method(precision="float32")), [{"x": 8, "v": 8, "C": 16, "J": 4, "id": 8}]),
}


@pytest.mark.parametrize("label", HELD)
def test_a_particle_holds_the_fields_that_its_scene_needs_and_no_other(label):
    made, expected = HELD[label]
    assert bytes_per_particle(scene_needs(made)) == expected


@pytest.mark.parametrize("label", HELD)
def test_check_shows_the_bytes_of_each_field_of_each_law(label):
    made, expected = HELD[label]
    lines = explain(made, 1).splitlines()
    first = lines.index("bytes of a particle") + 1
    head, *rows = [line.split() for line in lines[first : first + 1 + len(expected)]]
    assert head[-1] == "total"
    for name, row, fields in zip(labels(scene_needs(made).laws), rows, expected, strict=True):
        told = dict(zip(head, row[1:], strict=True))
        assert row[0] == name
        assert int(told.pop("total")) == sum(fields.values())
        assert {field: int(size) for field, size in told.items() if size != "-"} == fields


@pytest.mark.parametrize(
    ("label", "absent"),
    [
        ("pic", "field C, field X, field divergence, field load, field share"),
        ("rubber", "field X, field divergence, field load, field share"),
        ("body force that reads X", "field divergence, field load, field share"),
    ],
)
def test_check_names_the_optional_fields_that_are_left_out(label, absent):
    (line,) = [line for line in explain(HELD[label][0], 1).splitlines() if line.startswith("left out")]
    assert absent in line
    assert line.count("field ") == absent.count("field ")


# Scenes whose kernels other tests compile, too.
RUN = {
    "water": scene(WATER, guard={"interval": 2}),
    "several laws, a periodic slab axis": several_laws.flat(),
    "no gravity, no viscosity, pic": scene(
        WATER, domain={"size": [0.8, 0.2], "cell_size": 0.02}, guard={"interval": 2}, **method(transfer="pic")
    ),
}


@pytest.fixture(scope="module", params=RUN)
def simulation(request):
    made = Simulation(RUN[request.param])
    made.run(steps=2)
    return made


def test_what_is_said_of_bytes_is_what_is_allocated(simulation):
    for population, held in zip(simulation.populations, bytes_per_particle(simulation.needs), strict=True):
        blocks, fields, lanes = population.reals.shape
        per_block = population.reals.nbytes + population.id.nbytes
        assert per_block == blocks * lanes * sum(held.values())
        assert fields * population.reals.itemsize == sum(held.values()) - held["id"]


def test_what_is_said_of_kernels_is_what_a_run_compiles(simulation):
    told = compiled_kernels(simulation.scene, simulation.needs, ranks=1)
    names = labels(simulation.needs.laws)
    expected = {f"{entry} {number}" for number, name in enumerate(names) for entry in told[name]}
    expected |= {*told["shared"], *told.get("walls", ())}
    assert {name for name, kernel in simulation.kernels.entries.items() if kernel.signatures} == expected


def test_a_field_that_one_of_two_laws_keeps_is_not_a_number_for_the_other():
    made = Simulation(HELD["pic, one of two viscous"][0])
    without = made.particles.material == 0
    assert np.isnan(made.particles.C[without]).all()
    assert (made.particles.C[~without] == 0.0).all()


def test_particles_have_no_field_that_no_law_keeps():
    made = Simulation(HELD["pic"][0])
    with pytest.raises(AttributeError, match="particles have no 'C'"):
        made.particles.C  # noqa: B018


@pytest.mark.parametrize(
    ("more", "entries"),
    [
        ({}, ["p2g", "g2p", "energies"]),
        ({"guard": {"energy_gain": 0.0}}, ["p2g", "g2p"]),
        (method(transfer="flip"), ["p2g", "g2p", "p2g before", "energies"]),
        (method(f_bar=True), ["p2g", "g2p", "p2g divergence", "divergence", "energies"]),
    ],
)
def test_a_law_has_the_kernels_that_its_scene_needs_and_no_other(more, entries):
    made = scene(RUBBER, **more)
    assert compiled_kernels(made, scene_needs(made), 1)["neo_hookean"] == entries


def test_only_several_ranks_or_a_periodic_slab_axis_need_the_kernels_of_cuts():
    made = scene(WATER)
    alone, two = (compiled_kernels(made, scene_needs(made), ranks)["shared"] for ranks in (1, 2))
    assert set(two) - set(alone) == {"add_planes", "add_slots"}


def test_a_scene_without_damping_or_gravity_compiles_no_kernel_for_them():
    without = scene(WATER, domain={"size": [0.8, 0.2], "cell_size": 0.02})
    with_both = scene(WATER, **method(damping=1.0))
    named = [set(compiled_kernels(made, scene_needs(made), 1)["shared"]) for made in (without, with_both)]
    assert named[1] - named[0] == {"damp", "add_gravity"}


def test_the_page_is_what_the_code_says():
    file = ROOT / "docs" / "results" / "what_scenes_need.md"
    assert file.read_text(encoding="utf-8") == what_scenes_need.page(), (
        "run python benchmarks/what_scenes_need.py --docs docs"
    )
