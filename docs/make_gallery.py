"""Write docs/gallery.md and its pictures: every built-in scene, run by `pmpm run` and drawn by `pmpm render`.

    python docs/make_gallery.py [NAME ...] [--runs FOLDER] [--text]

Without names all scenes are run that have no run in FOLDER yet (about three minutes on two cores); --text writes the page
alone. tests/unit/test_gallery.py compares the text. Needs matplotlib.
"""

import argparse
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from pmpm.scene.files import builtin_scenes
from pmpm.scene.schema import Scene

DOCS = Path(__file__).parent
LARGEST = 150_000  # bytes of a picture
FRONT = ("landslide", "dam_break_obstacle", "snowballs", "rotating_drum", "hopper", "column_collapse_3d")
TILE = (420, 320)  # pixels of each in the README's picture
COLOURS = 128  # of a picture; more makes it larger, not clearer


@dataclass(frozen=True)
class Shown:
    """What is drawn of a run: a field at one of its snapshots; what to look for, and how long a run takes on one core."""

    field: str = "speed"  # what `pmpm render` draws by itself
    snapshot: int = -1
    expect: str = ""
    takes: str = ""


SHOWN = {
    "cantilever": Shown(
        "pressure",
        takes="5 s",
        expect="The end sinks by 0.304 L, 1.5 % more than the elastica of its length, which knows no shear (0.8 %).",
    ),
    "chute_flow": Shown(
        takes="5 s", expect="The same speeds within 2 %; as much has left in 0.3 s as has come in, to 15 digits."
    ),
    "colliding_disks": Shown(
        "pressure",
        24,
        takes="1 s",
        expect="They part with 80 % of their kinetic energy; 5 % more rings in them. `pmpm plot` shows it.",
    ),
    "column_collapse": Shown(
        snapshot=8, takes="10 s", expect="An outer wedge slides off; what lies in the corner stays."
    ),
    "column_collapse_3d": Shown(
        snapshot=12, takes="one minute", expect="A flat cone, whose foot comes to 1.66 radii at this cell size."
    ),
    "dam_break": Shown(snapshot=18, takes="10 s", expect="The front, [against experiment](results/dam_break.md)."),
    "dam_break_3d": Shown(
        snapshot=16, takes="10 s", expect="The same front, between two side walls; it is on its way at the end."
    ),
    "dam_break_obstacle": Shown(
        snapshot=35,
        takes="20 s",
        expect="Water reaches the box after 0.41 s, smooth walls and floor as they are, and pushes it with up to 374 N.",
    ),
    "hopper": Shown(
        snapshot=20,
        takes="10 s",
        expect="22.8 to 23.5 % of the sand each 0.2 s, from 0.1 to 0.7 s: it hardly slows down.",
    ),
    "jet": Shown("pressure", takes="5 s", expect="Two films of 0.01025 m, 2.5 % thicker than half the jet."),
    "landslide": Shown(
        snapshot=20,
        takes="three minutes on two ranks",
        expect="The middle of it goes 1.9 km and 430 m down, at up to 55 m/s; after 90 s half of it rests.",
    ),
    "mixed_materials": Shown(
        "material", 30, takes="one minute", expect="[Energies](results/mixed_materials.md) that only fall."
    ),
    "mud_slump": Shown(
        snapshot=5,
        takes="15 s",
        expect="It rests after 1.8 s, 1.18 m long; the parabola has 1.10 m, which mud in motion runs past.",
    ),
    "plough": Shown(
        snapshot=35, takes="25 s", expect="The force grows with the heap, from 48 N/m at 0.1 s to 158 N/m at 1.4 s."
    ),
    "rolling_disk": Shown(
        snapshot=20,
        takes="10 s",
        expect="Its foot rests while it rolls; 0.9 % farther than a rigid disk after 1.5 s. "
        "[Other slopes and cells](results/contact.md).",
    ),
    "rotating_drum": Shown(
        snapshot=60, takes="35 s", expect="A slope of 28 to 30 degrees; the angle of friction is 30."
    ),
    "sliding_block": Shown(takes="3 s", expect="0.2870 m in 0.6 s, 0.3 % more than a rigid block."),
    "slope_failure": Shown(
        "e_p", takes="10 s", expect="A curved surface through the toe, and a block that breaks up on it."
    ),
    "snowballs": Shown(snapshot=18, takes="15 s", expect="Cores that stay where they met, and two plumes that fly on."),
    "taylor_bar": Shown(
        "alpha", takes="10 s", expect="21.5 mm of it are left, and the foot has a radius of 6.9 mm in place of 3.2."
    ),
}
HEAD = """# Gallery

The scenes that come with pmpm: each one idea, with its source, run and drawn by the commands beneath its picture. `python
docs/make_gallery.py` wrote this page from the scenes' own files and made the pictures. Times are those of one core of a cloud
machine, without the first compilation. A run leaves its scene, with all defaults, as `scene.toml` in its folder: a beginning
for a scene of your own.

"""


def page():
    """The text of docs/gallery.md."""
    lines = ["| scene | what | takes |", "| --- | --- | --- |"]
    for name in builtin_scenes():
        lines.append(f"| [{name}](#{name}) | {Scene.builtin(name).title} | {shown(name).takes} |")
    return HEAD + "\n".join([*lines, "", *(section(name) for name in builtin_scenes())])


def shown(name):
    return SHOWN.get(name, Shown())


def section(name):
    """Picture, text and commands of one scene."""
    look, (about, source) = shown(name), told(name)
    commands = [f"pmpm run {name}", f"pmpm render {name}{options_text(look)}"]
    lines = [f"## {name}", "", about, "", f"![{Scene.builtin(name).title}](pictures/gallery/{name}.png)", ""]
    lines += [f"{source} {look.expect}".strip(), "", "```sh", *commands, "```", ""]
    return "\n".join(lines)


def told(name):
    """(what a scene shows, from where it is) as the comment at the head of its file says."""
    lines = builtin_scenes()[name].read_text(encoding="utf-8").splitlines()
    head = lines[: next(n for n, line in enumerate(lines) if not line.startswith("#"))]
    about, sign, source = " ".join(line.removeprefix("#").strip() for line in head).partition("Source: ")
    return about.strip(), f"{sign}{source}".replace("*", r"\*")


def options_text(look):
    field = f" --field {look.field}" if look.field != "speed" else ""
    return field + (f" --snapshot {look.snapshot}" if look.snapshot != -1 else "")


def draw(name, runs):
    """Run a scene unless its run is there, and draw it."""
    look, out = shown(name), runs / name
    picture = DOCS / "pictures" / "gallery" / f"{name}.png"
    picture.parent.mkdir(exist_ok=True)
    pmpm = [sys.executable, "-m", "pmpm"]
    if not (out / "run.json").exists():
        subprocess.run([*pmpm, "run", name, "--out", str(out)], check=True)
    subprocess.run(
        [*pmpm, "render", str(out), *options_text(look).split(), "--out", str(picture), "--quiet"], check=True
    )
    shrink(picture)


def shrink(picture):
    """Write a picture in few colours and without white margins, which makes it a third as large."""
    from PIL import Image, ImageChops

    image = Image.open(picture).convert("RGB")
    box = ImageChops.difference(image, Image.new("RGB", image.size, "white")).getbbox()
    image.crop(box).quantize(COLOURS).save(picture, optimize=True)
    size = picture.stat().st_size
    if size > LARGEST:
        raise SystemExit(f"{picture}: {size} bytes, more than {LARGEST}")


def draw_front():
    """Write docs/pictures/front.png, what the README begins with: pictures of the gallery side by side."""
    from PIL import Image

    (width, height), columns = TILE, 3
    sheet = Image.new("RGB", (columns * width, -(-len(FRONT) // columns) * height), "white")
    for number, name in enumerate(FRONT):
        picture = Image.open(DOCS / "pictures" / "gallery" / f"{name}.png").convert("RGB")
        picture.thumbnail((width - 16, height - 16))
        left, top = number % columns * width, number // columns * height
        sheet.paste(picture, (left + (width - picture.width) // 2, top + (height - picture.height) // 2))
    sheet.quantize(COLOURS).save(DOCS / "pictures" / "front.png", optimize=True)


def main():
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("names", nargs="*", help="of built-in scenes (default: all)")
    options.add_argument("--runs", type=Path, default=Path("runs"), help="folder of the runs")
    options.add_argument("--text", action="store_true", help="write the page alone")
    given = options.parse_args()
    for name in [] if given.text else given.names or builtin_scenes():
        draw(name, given.runs)
    if not given.text:
        draw_front()
    (DOCS / "gallery.md").write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    main()
