"""Small scenes in which everything meets that could tell one rank count from another.

A fluid, a solid and sand overlap; particles are jittered; a slab axis is periodic; gravity is along no axis; and all of
it moves across every cut.
"""

from pmpm.scene.schema import Scene

MATERIALS = {
    "water": {"model": "fluid", "density": 1000.0, "sound_speed": 20.0},
    "rubber": {"model": "neo_hookean", "density": 1200.0, "youngs_modulus": 1e5, "poisson_ratio": 0.3},
    "soft_sand": {
        "model": "drucker_prager",
        "density": 1600.0,
        "youngs_modulus": 2e5,
        "poisson_ratio": 0.25,
        "friction_angle": 35.0,
    },
}


def ball(material, center, radius, velocity, particles_per_cell):
    shape = {"type": "sphere", "center": center, "radius": radius}
    return {"material": material, "shape": shape, "velocity": velocity, "particles_per_cell": particles_per_cell}


def block(material, low, high, velocity, particles_per_cell):
    shape = {"type": "box", "min": low, "max": high}
    return {"material": material, "shape": shape, "velocity": velocity, "particles_per_cell": particles_per_cell}


def flat(end=0.2, precision="float64", periodic=("x",), transfer="mls", contact=None):
    """2-D: slabs across x, which is periodic. 50 x 30 cells, about 2400 particles."""
    walls = {"y_min": {"type": "friction", "coefficient": 0.3}, "y_max": "separate"}
    return Scene(
        domain={"size": [1.0, 0.6], "cell_size": 0.02, "gravity": [2.0, -9.81], "periodic": periodic, "walls": walls},
        time={"end": end},
        method={"transfer": transfer, "precision": precision},
        materials=MATERIALS,
        contact=contact,
        bodies=[
            block("water", [0.0, 0.0], [1.0, 0.15], [2.0, 0.0], 5),
            block("soft_sand", [0.2, 0.1], [0.6, 0.3], [1.5, -0.5], 3),
            ball("rubber", [0.45, 0.25], 0.12, [2.5, -1.0], 4),
            ball("water", [0.85, 0.35], 0.1, [3.0, -1.0], 7),
        ],
        output={"snapshot_interval": end / 5},
    )


def deep(end=0.06, precision="float64", contact=None):
    """3-D: slabs across z, which is periodic as x is. 8 x 10 x 20 cells, about 5000 particles."""
    return Scene(
        domain={
            "size": [0.24, 0.3, 0.6],
            "cell_size": 0.03,
            "gravity": [1.0, -9.81, 3.0],
            "periodic": ["x", "z"],
            "walls": {"y_min": {"type": "friction", "coefficient": 0.3}, "y_max": "separate"},
        },
        time={"end": end},
        method={"transfer": "mls", "precision": precision},
        materials=MATERIALS,
        contact=contact,
        bodies=[
            block("water", [0.0, 0.0, 0.0], [0.24, 0.1, 0.6], [0.5, 0.0, 2.0], 5),
            block("soft_sand", [0.0, 0.09, 0.1], [0.24, 0.18, 0.35], [0.0, -0.5, 3.0], 6),
            ball("rubber", [0.12, 0.17, 0.3], 0.1, [-0.5, -1.0, 4.0], 9),
        ],
        output={"snapshot_interval": end / 3},
    )


def tall(end=0.3, contact=None):
    """2-D: slabs across y, along which water and sand fall. 15 x 40 cells."""
    return Scene(
        domain={"size": [0.3, 0.8], "cell_size": 0.02, "gravity": [0.5, -9.81], "walls": {"y_min": "stick"}},
        time={"end": end},
        materials=MATERIALS,
        contact=contact,
        bodies=[
            block("water", [0.0, 0.0], [0.3, 0.3], [0.0, 1.5], 5),
            ball("soft_sand", [0.15, 0.55], 0.12, [0.0, -2.0], 4),
        ],
        output={"snapshot_interval": end / 3},
    )


def short(end=0.1):
    """2-D: 13 layers, room for two ranks; a third one idles."""
    return Scene(
        domain={"size": [0.24, 0.2], "cell_size": 0.02, "gravity": [0.0, -9.81]},
        time={"end": end},
        materials=MATERIALS,
        bodies=[block("water", [0.0, 0.0], [0.12, 0.12], [1.0, 0.0], 4)],
        output={"snapshot_interval": end / 3},
    )


def corner(end=0.1):
    """2-D: a drop in the first few of 51 layers, so that all ranks but the first hold nothing at the start."""
    return Scene(
        domain={"size": [1.0, 0.2], "cell_size": 0.02, "gravity": [0.0, -9.81]},
        time={"end": end},
        materials=MATERIALS,
        bodies=[block("water", [0.0, 0.0], [0.06, 0.1], [1.5, 0.0], 4)],
        output={"snapshot_interval": end / 3},
    )
