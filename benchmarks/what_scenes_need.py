"""What each built-in scene holds in memory and compiles: the tables of `pmpm check`, as a page.

    python benchmarks/what_scenes_need.py [--docs docs]

Prints the page, or writes results/what_scenes_need.md. Nothing is compiled or run; tests/unit/test_what_scenes_need.py compares
the page with what the code says, and what it says with what a simulation allocates and compiles.
"""

import argparse
from pathlib import Path

import pages

from pmpm.explain import byte_rows, bytes_per_particle, compiled_kernels, labels, left_out
from pmpm.scene.files import builtin_scenes
from pmpm.scene.needs import scene_needs
from pmpm.scene.schema import Scene

RANKS = 2
RUBBER = {"model": "neo_hookean", "density": 1000.0, "youngs_modulus": 1e4, "poisson_ratio": 0.3}
WATER = {"model": "fluid", "density": 1000.0, "sound_speed": 15.0}

HEAD = f"""# What each scene needs

`python benchmarks/what_scenes_need.py --docs docs` wrote this page with the code of `pmpm check`, which shows the same for any
scene: the bytes that a particle of each law holds, field by field, and the entry kernels that a run on {RANKS} ranks compiles.
A field that a scene does not need is not allocated, moved or written; "-" stands where a law has no such field. Mass, volume
and parameters lie in a table row per body, not with the particles.
"""


def box(material, low):
    """A cube of a material, 0.1 m wide."""
    shape = {"type": "box", "min": [low, 0.0, 0.0], "max": [low + 0.1, 0.1, 0.1]}
    return {"material": material, "shape": shape}


def blocks(materials, **method):
    """A scene with a cube of each material, side by side in 3-D and float32."""
    return Scene(
        domain={"size": [0.8, 0.2, 0.2], "cell_size": 0.02, "gravity": [0.0, 0.0, -9.81]},
        method={"precision": "float32"} | method,
        time={"end": 0.1},
        materials=materials,
        bodies=[box(name, 0.2 * number) for number, name in enumerate(materials)],
    )


def held(scene):
    """{law: {field: bytes}}."""
    needs = scene_needs(scene)
    return dict(zip(labels(needs.laws), bytes_per_particle(needs), strict=True))


def kernel_count(scene):
    return sum(map(len, compiled_kernels(scene, scene_needs(scene), RANKS).values()))


def facts():
    """What the bytes and kernels of small scenes say, as lines of a list."""
    rubber, both = blocks({"rubber": RUBBER}), blocks({"rubber": RUBBER, "water": WATER})
    alone, solid, fluid = held(rubber)["neo_hookean"], held(both)["neo_hookean"], held(both)["fluid"]
    shared = [name for name in fluid if name in solid]
    pic, plain = held(blocks({"water": WATER}, transfer="pic"))["fluid"], held(blocks({"water": WATER}))["fluid"]
    averaged = held(blocks({"rubber": RUBBER}, f_bar=True))["neo_hookean"]
    viscous = held(blocks({"water": WATER | {"viscosity": 1.0}}, transfer="pic"))["fluid"]
    more = kernel_count(both) - kernel_count(rubber)
    return [
        f"Adding water to an elastic scene adds no F to the water: its particles hold J ({fluid['J']} bytes) where those of "
        f"rubber hold F ({solid['F']} bytes), {total(fluid)} bytes in all.",
        f"Nor does it change the rubber: {total(alone)} bytes per particle without water, {total(solid)} with it. Both share "
        f"only {', '.join(shared)}.",
        f"It adds {more} kernels, the p2g, g2p and energies of the water, to the {kernel_count(rubber)} that are there.",
        f"PIC carries no affine field C: {total(pic)} bytes for water instead of {total(plain)}. Viscous stress follows from "
        f"C, so that viscous water has it with PIC, too ({total(viscous)} bytes).",
        f"F-bar adds one number, {averaged['divergence']} bytes, and two kernels per law; X, a reference position, is there "
        "only for a body force that reads it or an exact solution, and load only in a scene with loads.",
    ]


def total(fields):
    return sum(fields.values())


def markdown(rows):
    head, *body = [[cell or "law" for cell in row] for row in rows]
    lines = ["| " + " | ".join(head) + " |", "|" + " --- |" * len(head)]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in body])


def section(name, scene):
    """A built-in scene: its bytes, its kernels, what it leaves out."""
    needs = scene_needs(scene)
    kernels = [f"- {who}: {', '.join(names)}" for who, names in compiled_kernels(scene, needs, RANKS).items()]
    fields = [text.removeprefix("field ") for text in left_out(scene, needs) if text.startswith("field ")]
    return "\n".join(
        [
            f"## {name}\n",
            f"{scene.dim}-D, {needs.precision}, {needs.transfer}; bytes of a particle:\n",
            markdown(byte_rows(needs)),
            "\nKernels:\n",
            *kernels,
            f"\nFields left out for all laws: {', '.join(fields) or 'none'}.",
        ]
    )


def page():
    """The text of results/what_scenes_need.md."""
    measured = "\n".join(f"- {fact}" for fact in facts())
    sections = [section(name, Scene.builtin(name)) for name in builtin_scenes()]
    return (
        "\n\n".join([HEAD + f"\nOf a 3-D scene in float32 with a block of each material:\n\n{measured}", *sections])
        + "\n"
    )


def main():
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--docs", type=Path, help="write the page here")
    given = options.parse_args()
    if given.docs:
        pages.write(given.docs, "what_scenes_need", page())
    else:
        print(page(), end="")


if __name__ == "__main__":
    main()
