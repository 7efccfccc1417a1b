"""The options of `pmpm point`; nothing heavy is imported for them."""

import argparse

from pmpm.point.paths import PATHS

NOTES = """\
x is the axial direction, y (and z in 3-D) lie across; shear moves planes y = const. along x. Normal strains are
logarithms of stretches, gamma is the integral of dv_x/dy; stresses are Cauchy's in Pa, positive in tension; p is minus
their mean, q is von Mises'. In 2-D, --pressure and what is held are those of stress_xx and stress_yy.
A file of increments has a head with any of dt (s), xx, xy, yx, yy (xz .. zz in 3-D): entries of G = dt grad v, F = (I + G) F.

examples:
  pmpm point drucker_prager --path triaxial --pressure 1e5 --strain -0.05 --set friction_angle=40
  pmpm point column_collapse:sand --path direct_shear --pressure 500 --cycles 3 --two-way --plot shear.png
exit status: 0 done, 1 the material failed or a stress could not be held (the table ends there), 2 wrong input"""


def add_point(commands):
    """Add `point` to the commands of a parser."""
    paths = "\n".join(f"  {name:24s} {path.meaning}" for name, path in PATHS.items())
    point = commands.add_parser(
        "point",
        help="drive one particle of a material along a path of strains and stresses, without a grid",
        description="Drive one particle of a material: stress and state along a path of strains and held stresses.",
        epilog=f"paths:\n{paths}\n\n{NOTES}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    point.add_argument(
        "what",
        nargs="?",
        metavar="MATERIAL",
        help="a model (`pmpm materials` lists them), with the keys of an example, or SCENE:MATERIAL, one of a scene",
    )
    point.add_argument("--scene", metavar="SCENE", help="TOML file or built-in scene that holds the material")
    point.add_argument("--material", metavar="NAME", help="its name in the scene")
    point.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="change a key (repeatable)")
    point.add_argument(
        "--path", metavar="NAME", help="see below (default: a typical one of the model; uniaxial_strain for a scene's)"
    )
    point.add_argument("--increments", metavar="FILE.csv", help="a path of your own, see below")
    point.add_argument("--strain", type=float, metavar="E", help="strain to reach; negative in compression")
    point.add_argument("--pressure", type=float, metavar="PA", help="isotropic pressure at the start, reached slowly")
    point.add_argument("--rate", type=float, metavar="R", help="|d strain / dt| in 1/s (default 1)")
    point.add_argument("--steps", type=int, metavar="N", help="steps to the largest strain (default 200)")
    point.add_argument("--cycles", type=int, metavar="N", help="there and back to zero N times")
    point.add_argument("--two-way", action="store_true", help="cycles pass through minus the strain, too")
    point.add_argument("--dimension", type=int, choices=(2, 3), help="2: plane strain (default: 3, or the scene's)")
    point.add_argument("--rows", type=int, metavar="N", help="rows of the table on the screen (default 21)")
    point.add_argument("--out", metavar="FILE.csv", help="write all rows and columns to a file instead")
    point.add_argument("--plot", metavar="FILE.png", help="draw stress over strain (needs matplotlib)")
