"""The options of `pmpm study`; nothing heavy is imported for them."""

import argparse

NOTES = """\
A study goes on where it was interrupted: the same command runs what has not ended yet. It leaves study.csv, study.md and
study.png (matplotlib: pip install 'pmpm[viz]') in its folder.

examples:
  pmpm study column_collapse --levels 3 --transfer apic,mls,flip
  pmpm study colliding_disks --transfer apic,flip --shape-function quadratic,cubic --until 2 --repeat 3
  pmpm study dam_break --refine time --cfl 0.8 --levels 4
exit status: 0 done (runs that failed are rows of the table), 1 what was found could not be written, 2 wrong input,
3 stopped on request"""


def words(text):
    """A list of words with commas between them."""
    return tuple(word.strip() for word in text.split(","))


def numbers(text):
    """A list of numbers with commas between them."""
    return tuple(float(word) for word in text.split(","))


def add_study(commands):
    """Add `study` to the commands of a parser."""
    study = commands.add_parser(
        "study",
        help="error against run time of a scene: refined level by level, in several schemes",
        description="Refine a scene level by level, in several schemes: error, order of convergence and run time.",
        epilog=NOTES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    study.add_argument("scene", metavar="SCENE", help="TOML file or built-in scene: the coarsest level")
    study.add_argument("--levels", type=int, default=3, metavar="N", help="the scene and N - 1 refinements (default 3)")
    study.add_argument(
        "--refine",
        default="space",
        metavar="WHAT",
        help="space: cells halved per level; time: steps halved (default space)",
    )
    study.add_argument("--transfer", type=words, default=(), metavar="A,B", help="transfers to compare")
    study.add_argument("--shape-function", type=words, default=(), metavar="A,B", help="splines to compare")
    study.add_argument("--precision", type=words, default=(), dest="precisions", metavar="A,B", help="float32,float64")
    study.add_argument("--cfl", type=numbers, default=(), metavar="A,B", help="fractions of the stable step to compare")
    study.add_argument("--until", type=float, metavar="T", help="end all runs at T (s)")
    study.add_argument("--repeat", type=int, default=1, metavar="N", help="run each N times, take the median time")
    study.add_argument(
        "--set", action="append", default=[], metavar="KEY.PATH=VALUE", help="change any key of the scene (repeatable)"
    )
    study.add_argument("--out", metavar="DIR", help="folder of the study (default: ./<scene name>_study)")
    study.add_argument("--overwrite", action="store_true", help="replace a study that is in the folder")
    study.add_argument("--quiet", action="store_true", help="no progress on the screen")
    study.set_defaults(precision=None)
