"""The paths on which a point is driven: which strain is given, which stress is held, which strain is free for that.

Axes: x is axial, y across (in 3-D y and z); planes y = const. are sheared along x. Strains are logarithms of stretches,
positive in extension, as stresses are; a shear strain is the integral of dv_x/dy over time. Pressures are positive in
compression.
"""

from dataclasses import dataclass

AXIAL, ACROSS, NORMAL, VOLUME, SHEAR = "axial", "across", "normal", "volume", "shear"
NONE, OPTIONAL, REQUIRED = "none", "optional", "required"


@dataclass(frozen=True)
class Path:
    """`driven` by a given strain while the mean normal stress along the axes of `held` stays what it was at the start.

    Strains along the axes of `held` are then free, and the same along each. `strain`: the largest one, if none is given.
    `pressure`: whether the path begins under an isotropic pressure.
    """

    meaning: str
    driven: str
    strain: float
    pressure: str = OPTIONAL
    held: str | None = None


PATHS = {
    "uniaxial_strain": Path("axial strain, none across: confined compression, oedometer", AXIAL, -0.05),
    "uniaxial_stress": Path("axial strain, no stress across: tension and compression tests", AXIAL, 0.05, NONE, ACROSS),
    "triaxial": Path("axial strain, the pressure across held (plane strain in 2-D)", AXIAL, -0.05, REQUIRED, ACROSS),
    "isotropic": Path("the same strain along all axes; given as ln J", VOLUME, -0.05),
    "simple_shear": Path("shear at constant volume", SHEAR, 0.1),
    "constant_pressure_shear": Path(
        "shear, the mean normal stress held by a change of volume", SHEAR, 0.1, REQUIRED, VOLUME
    ),
    "direct_shear": Path("shear, the stress normal to it held, no strain along it", SHEAR, 0.1, REQUIRED, NORMAL),
}


def pattern(name, dim):
    """How a normal strain is spread over the axes."""
    if name == VOLUME:
        return (1.0 / dim,) * dim
    return {AXIAL: (1.0, 0.0, 0.0), ACROSS: (0.0, 1.0, 1.0), NORMAL: (0.0, 1.0, 0.0)}[name][:dim]


def courses(strain, steps, cycles=0, two_way=False):
    """The driven strain at each step, without the zero at the start: to `strain`, or `cycles` times there and back to zero.

    `two_way`: through -strain on the way back. `steps` lead from 0 to `strain`.
    """
    if not cycles:
        turns = [1]
    else:
        turns = [1, -1, 0] * cycles if two_way else [1, 0] * cycles
    values, at = [], 0
    for turn in turns:
        count = steps * abs(turn - at)
        values += [strain * (at + (turn - at) * n / count) for n in range(1, count + 1)]
        at = turn
    return values
