"""Write docs/materials: a page per law, from the law's own file, and a picture of its example on a typical path.

    python docs/make_materials.py [--no-pictures]

Run it after a change to a law; tests/unit/test_material_pages.py compares the text. Pictures need matplotlib.
"""

import argparse
import re
import sys
from pathlib import Path

from pmpm.physics.materials import LAWS
from pmpm.physics.materials.examples import EXAMPLES
from pmpm.point import report
from pmpm.point.command import complete_keys, completed, course_text, short_text, typical_run
from pmpm.scene.messages import value_text
from pmpm.scene.values import range_text
from pmpm.state.fields import KIND_SIZE

FOLDER = Path(__file__).parent / "materials"
MADE = "`python docs/make_materials.py` wrote this page from [{0}](../../{0}).\n"
CONSTANT = re.compile(r"^([A-Z][A-Z_0-9]+) = ([^#\n]+?)  # (.+)$", re.MULTILINE)
ID_BYTES = 8


def pages():
    """{file name: text} of all pages and the index."""
    return {f"{model}.md": page(model) for model in LAWS} | {"README.md": index()}


def index():
    """A line per law."""
    lines = ["# Materials", "", MADE.format("pmpm/physics/materials/__init__.py")]
    lines += ["| model | what it is | a particle keeps |", "| --- | --- | --- |"]
    for model, law in LAWS.items():
        kept = ", ".join(f"`{field.name}`" for field in law.STATE)
        lines.append(f"| [`{model}`]({model}.md) | {cell_text(summary(law))} | {kept} |")
    lines += ["", "`pmpm materials` lists the same on the screen, `pmpm point MODEL` drives one particle of a law:"]
    lines += [
        "see [below](#one-particle-on-a-path). A function of your own is [a law, too](../scene.md#a-law-of-your-own);"
    ]
    lines += ["how to add one to pmpm is [told here](../adding_a_material.md)."]
    return "\n".join([*lines, "", POINT])


POINT = """## One particle on a path

```sh
pmpm point drucker_prager                     # the example of the law's page, on its typical path
pmpm point drucker_prager --path triaxial --pressure 1e5 --strain -0.05 --set friction_angle=40 --plot triaxial.png
pmpm point column_collapse:sand --path direct_shear --pressure 500 --cycles 3 --two-way --out shear.csv
pmpm point --help                             # all paths and options
```

One particle, no grid, no MPI, nothing compiled: the law's own functions in plain Python, in float64. x is the axial
direction; shear moves planes y = const. along x. Normal strains are logarithms of stretches, shear is the integral of
dv_x/dy, stresses are Cauchy's, positive in tension; p is minus their mean and q von Mises'. In 2-D (plane strain) confining
pressures and held stresses are those of xx and yy.

Columns of `--out`: `step`, `time` (s), `strain` (the driven one), `strain_xx` .., `gamma_xy` .., `stress_xx` .. (Pa), `p`, `q`
(Pa), `J` (the law's: what its stress is divided by) and the state. A held stress is met to 1e-9 of itself or 1e-12 of
the stiffness, by growing steps and Chandrupatla's method on the free strain; where that fails, in halves of the step. Exit
status 1 says that the material failed on its way, or that no strain gives the stress: the table ends there.

Pages and pictures are made by `python docs/make_materials.py`; a test compares the text with the code.
"""


def page(model):
    """The text of one law's page."""
    law, example = LAWS[model], EXAMPLES.get(model)
    title, *rest = law.__doc__.strip().split("\n\n")
    source = f"pmpm/physics/materials/{Path(law.__file__).name}"
    lines = [f"# {model}", "", MADE.format(source), cell_text(title.replace("\n", " ")), ""]
    if rest:
        lines += ["```text", "\n\n".join(rest), "```", ""]
    if "Source" not in law.__doc__:
        lines += [f"Source: {law.SOURCE}.", ""]
    lines += ["## Keys", ""]
    lines += ["| key | unit | allowed | default | meaning |", "| --- | --- | --- | --- | --- |"]
    lines += [key_line(key) for key in law.KEYS]
    lines += [
        "",
        "## What a particle keeps",
        "",
        "| field | kind | unit | at rest | meaning |",
        "| --- | --- | --- | --- | --- |",
    ]
    lines += [f"| `{f.name}` | {f.kind} | {f.unit} | {rest_text(f)} | {cell_text(f.meaning)} |" for f in law.STATE]
    lines += ["", bytes_text(law), "", *switch_lines(model, law), *limit_lines(law, source)]
    if example is not None:
        lines += example_lines(model, example)
    return "\n".join(lines).rstrip() + "\n"


def summary(law):
    """The first sentence of a law's docstring."""
    first = law.__doc__.strip().split("\n\n")[0].replace("\n", " ")
    return first.split(". ")[0].rstrip(".")


def cell_text(text):
    """Text that stands in a table as it is."""
    return text.replace("|", r"\|").replace("_", r"\_").replace("*", r"\*")


def key_line(key):
    if isinstance(key.default, bool):
        allowed = "true, false"
    elif key.choices:
        allowed = ", ".join(f'"{word}"' for word in key.choices)
    else:
        allowed = range_text("-", above=key.above, at_least=key.at_least, below=key.below, at_most=key.at_most).strip()
    if key.only is not None:
        allowed = f"only {value_text(key.only)} is built"
    if key.default is not None:
        default = value_text(key.default)
    else:
        default = "optional" if key.optional else "required"
    return f"| `{key.name}` | {key.unit} | {allowed or 'any number'} | {default} | {cell_text(key.meaning)} |"


def rest_text(field):
    return f"{field.rest:g} I" if field.kind == "tensor" and field.rest else f"{field.rest:g}"


def bytes_text(law):
    """Bytes per particle in both dimensions and precisions."""
    rows = []
    for dim in (2, 3):
        reals = 2 * dim + dim * dim + sum(KIND_SIZE[field.kind](dim) for field in law.STATE)
        rows.append(f"{4 * reals} bytes in float32 and {8 * reals} in float64 in {dim}-D")
    kept = "With all of these," if len(law.STATE) > 1 else "With it,"
    text = f"{kept} position, velocity and affine field a particle takes {', '.join(rows)}"
    return f"{text}, and {ID_BYTES} for its id."


def switch_lines(model, law):
    """Choices that are compiled in."""
    choices = law.choices(complete_keys(model, {})) if model in EXAMPLES else {}
    if not choices:
        return []
    comments = {name: text for name, _, text in CONSTANT.findall(Path(law.__file__).read_text(encoding="utf-8"))}
    lines = ["## Switches", "", "Compiled in: what a material does not need costs nothing.", ""]
    for name, value in sorted(choices.items()):
        says = f": {cell_text(comments[name])}" if name in comments else ""
        lines.append(f"- `{name}`, {value} in the example{says}")
    return [*lines, ""]


def limit_lines(law, source):
    """What the law does not do, and the constants that bound it."""
    lines = ["## Limits", ""]
    for key in law.KEYS:
        if key.only is not None:
            lines.append(f"- `{key.name}`: values other than {value_text(key.only)} are refused as not built yet.")
    text = Path(law.__file__).read_text(encoding="utf-8")
    for name, value, meaning in CONSTANT.findall(text):
        if value not in ("True", "False"):
            lines.append(f"- `{name} = {value}`: {cell_text(meaning)}.")
    lines.append(
        f"- A particle whose `valid(state)` in [{source}](../../{source}) is false stops the run, with its cause."
    )
    return [*lines, ""]


def example_lines(model, example):
    """The example and its picture."""
    keys = "\n".join(f"{name} = {short_text(value)}" for name, value in example.keys.items())
    course = completed(example.path)
    return [
        "## Example",
        "",
        f"{example.name[0].upper()}{example.name[1:]}. {example.source}.",
        "",
        "```toml",
        f'model = "{model}"',
        keys,
        "```",
        "",
        f"`pmpm point {model}`: {cell_text(course_text(course, 3))}.",
        "",
        f"![{example.name} on the path {course['path'].replace('_', ' ')}]({model}.png)",
        "",
    ]


def draw(model, folder):
    """The picture of a law's example."""
    record, path, course = typical_run(model)
    if record.failure:
        sys.exit(f"{model}: {record.failure}")
    title = f"{EXAMPLES[model].name}, {course['path'].replace('_', ' ')}"
    report.draw(record, path, title, folder / f"{model}.png")


def main():
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--no-pictures", action="store_true", help="text only")
    given = options.parse_args()
    FOLDER.mkdir(exist_ok=True)
    for name, text in pages().items():
        (FOLDER / name).write_text(text, encoding="utf-8")
    if not given.no_pictures:
        for model in LAWS:
            if model in EXAMPLES:
                draw(model, FOLDER)


if __name__ == "__main__":
    main()
