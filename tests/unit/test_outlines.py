"""What pictures show of colliders."""

import tomllib

import h5py
import numpy as np
import pytest

import pmpm
from pmpm.cli import main
from pmpm.output.files import OutputError
from pmpm.output.outlines import outlines

pytest.importorskip("contourpy")
BOX = {"type": "box", "min": [0.2, 0.2], "max": [0.4, 0.4]}


def scene_of(collider, **keys):
    return pmpm.Scene(
        **{"domain": {"size": [1.0, 1.0], "cell_size": 0.1}, "time": {"end": 1.0}} | keys,
        materials={"a": {"model": "fluid", "density": 1.0, "sound_speed": 1.0}},
        bodies=[{"material": "a", "shape": BOX}],
        colliders=[{"cut": False} | collider],
    )


def shown(collider):
    return outlines(tomllib.loads(scene_of(collider).to_toml()))


def middle(surface, time, places):
    (points,) = surface.at(time, places)
    return 0.5 * (points.min(axis=0) + points.max(axis=0))


def test_what_a_function_moves_is_not_drawn_where_it_is_not():
    (rests,) = shown({"shape": BOX})
    assert middle(rests, 0.5, {}) == pytest.approx([0.3, 0.3], abs=1e-3)
    for motion in ({"velocity": lambda time: [1.0, 0.0]}, {"angular_velocity": lambda time: 90.0}):
        (moved,) = shown({"shape": BOX} | motion)
        assert moved.at(0.0, {}) == []
        here = {"collider_0": (np.eye(2), np.array([0.5, 0.0]))}  # as a snapshot tells
        assert middle(moved, 0.0, here) == pytest.approx([0.8, 0.3], abs=1e-3)
    assert not shown({"distance": lambda x, time: np.linalg.norm(x - 0.5, axis=1) - 0.2})


def test_across_the_end_of_a_periodic_axis_both_parts_are_drawn():
    periodic = {"domain": {"size": [1.0, 1.0], "cell_size": 0.1, "periodic": ["x"]}}
    ball = {"shape": {"type": "sphere", "center": [0.8, 0.7], "radius": 0.1}, "velocity": [1.0, 1.0]}
    (drawn,) = outlines(tomllib.loads(scene_of(ball, **periodic).to_toml()))
    for time, where in ((0.0, [0.8]), (0.15, [-0.05, 0.95]), (0.4, [0.2]), (7.4, [0.2])):
        found = [points.mean(axis=0) for points in drawn.at(time, {})]
        assert [x for x, _ in found] == pytest.approx(where, abs=5e-3)
        assert [y for _, y in found] == pytest.approx([0.7 + time] * len(where), abs=5e-3)


def test_after_a_restart_with_another_velocity_a_collider_is_drawn_where_it_is(tmp_path):
    """Out with 1 m/s, back with -1 m/s, then at rest; what has no say in it is where the last velocity would have led."""
    ball = {"shape": {"type": "sphere", "center": [0.3, 0.7], "radius": 0.1}, "velocity": [1.0, 0.0]}
    scene = scene_of(
        ball, time={"end": 0.1, "step": 0.01}, output={"snapshot_interval": 0.1, "checkpoint_interval": 0.1}
    )
    file, run = tmp_path / "ball.toml", tmp_path / "run"
    file.write_text(scene.to_toml(), encoding="utf-8")
    assert main(["run", str(file), "--out", str(run), "--quiet"]) == 0
    for end, velocity in (("0.2", "[-2.0, 0.0]"), ("0.3", "[0.0, 0.0]")):
        changes = ["--set", f"time.end={end}", "--set", f"colliders[0].velocity={velocity}"]
        assert main(["run", "--restart", str(run), *changes, "--quiet"]) == 0

    held = pmpm.load(run)
    (drawn,) = outlines(held.table)
    where = [middle(drawn, snapshot.time, snapshot.collider_places)[0] for snapshot in held.snapshots]
    assert where == pytest.approx([0.3, 0.4, 0.2, 0.2], abs=2e-3)
    assert middle(drawn, 0.1, {})[0] == pytest.approx(0.3, abs=2e-3)  # by the scene alone, as in older runs

    with h5py.File(held.snapshots[-1].path, "r+") as opened:
        opened["pmpm"].attrs["collider collider_0"] = np.array([0.0, 1.0])
    with pytest.raises(OutputError, match="is damaged: attribute collider collider_0 is no place"):
        _ = held.snapshots[-1].collider_places
