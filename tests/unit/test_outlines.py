"""What pictures show of colliders."""

import tomllib

import numpy as np

import pmpm
from pmpm.output.outlines import outlines

BOX = {"type": "box", "min": [0.2, 0.2], "max": [0.4, 0.4]}


def shown(collider):
    scene = pmpm.Scene(
        domain={"size": [1.0, 1.0], "cell_size": 0.1},
        time={"end": 1.0},
        materials={"a": {"model": "fluid", "density": 1.0, "sound_speed": 1.0}},
        bodies=[{"material": "a", "shape": BOX}],
        colliders=[{"cut": False} | collider],
    )
    return outlines(tomllib.loads(scene.to_toml()))


def test_what_a_function_moves_is_not_drawn_where_it_is_not():
    assert shown({"shape": BOX})
    assert not shown({"shape": BOX, "velocity": lambda time: [1.0, 0.0]})
    assert not shown({"shape": BOX, "angular_velocity": lambda time: 90.0})
    assert not shown({"distance": lambda x, time: np.linalg.norm(x - 0.5, axis=1) - 0.2})
