"""A shape holds the points it should, lies within its bounds, and its size is the textbook's."""

import math

import numpy as np
import pytest

from pmpm.scene.errors import SceneError
from pmpm.scene.shapes import Box, Capsule, Cylinder, Difference, Intersection, Plane, Sphere, Union

BOX = Box(min=[0.1, 0.2], max=[0.5, 0.4])
DISK = Sphere(center=[0.5, 0.3], radius=0.2)
BALL = Sphere(center=[0.5, 0.5, 0.5], radius=0.4)
UPRIGHT = Cylinder(center=[0.5, 0.5, 0.5], axis="z", radius=0.3, height=0.6)
OBLIQUE = Cylinder(center=[0.5, 0.5, 0.5], axis=[1, 2, 2], radius=0.2, height=0.5)
LENS = 2 * 0.2**2 * math.acos(0.5) - 0.1 * math.sqrt(4 * 0.2**2 - 0.2**2)  # two disks, radius r, centres r apart
CAPSULE = Capsule(start=[0.4, 0.4, 0.4], end=[0.6, 0.6, 0.6], radius=0.2)
OTHER = Sphere(center=[0.7, 0.3], radius=0.2)

SIZES = [
    ("box", BOX, 0.4 * 0.2),
    ("disk", DISK, math.pi * 0.2**2),
    ("ball", BALL, 4 / 3 * math.pi * 0.4**3),
    ("upright cylinder", UPRIGHT, math.pi * 0.3**2 * 0.6),
    ("oblique cylinder", OBLIQUE, math.pi * 0.2**2 * 0.5),
    ("intersection", Intersection(of=[DISK, OTHER]), LENS),
    ("union", Union(of=[DISK, OTHER]), 2 * math.pi * 0.2**2 - LENS),
    ("difference", Difference(of=[DISK, OTHER]), math.pi * 0.2**2 - LENS),
    ("stadium", Capsule(start=[0.3, 0.4], end=[0.6, 0.7], radius=0.1), 0.2 * math.hypot(0.3, 0.3) + math.pi * 0.1**2),
    ("capsule", CAPSULE, math.pi * 0.2**2 * math.sqrt(0.12) + 4 / 3 * math.pi * 0.2**3),
    ("cut box", Intersection(of=[BOX, Plane(point=[0.3, 0.3], normal=[1.0, 1.0])]), 0.5 * 0.4 * 0.2),
    (
        "nested",
        Difference(of=[DISK, Union(of=[OTHER, Sphere(center=[0.3, 0.3], radius=0.2)])]),
        math.pi * 0.2**2 - 2 * LENS,
    ),
]
SHAPES = pytest.mark.parametrize(("shape", "size"), [case[1:] for case in SIZES], ids=[case[0] for case in SIZES])


def unit_points(dim):
    """Centres of equal cells in the unit square or cube, (n, dim)."""
    count = 400 if dim == 2 else 80
    places = (np.arange(count) + 0.5) / count
    return np.stack(np.meshgrid(*[places] * dim, indexing="ij"), -1).reshape(-1, dim)


def points_for(shape):
    return unit_points(len(shape.bounds()[0]))


@SHAPES
def test_the_share_of_points_inside_is_the_size(shape, size):
    assert shape.contains(points_for(shape)).mean() == pytest.approx(size, rel=0.01)


@SHAPES
def test_the_distance_is_negative_where_points_are_inside(shape, size):
    points = points_for(shape)
    distance, inside = shape.signed_distance(points), shape.contains(points)
    apart = np.abs(distance) > 1e-12
    assert np.array_equal((distance < 0.0)[apart], inside[apart])


@pytest.mark.parametrize(
    "shape", [BOX, DISK, BALL, UPRIGHT, OBLIQUE, CAPSULE, Plane(point=[0.2, 0.1], normal=[3.0, 4.0])]
)
def test_a_walk_of_the_distance_towards_a_shape_ends_on_its_surface(shape):
    points = unit_points(len(shape.bounds()[0]))[::17]
    steps = 1e-7 * np.eye(points.shape[1])
    slope = [(shape.signed_distance(points + e) - shape.signed_distance(points - e)) / 2e-7 for e in steps]
    slope = np.stack(slope, axis=1)
    smooth = np.abs(np.linalg.norm(slope, axis=1) - 1.0) < 1e-6
    assert smooth.mean() > 0.97  # all but ridges, where two sides are equally near
    nearest = points - shape.signed_distance(points)[:, None] * slope
    assert np.abs(shape.signed_distance(nearest[smooth])).max() < 1e-6


@SHAPES
def test_every_point_inside_lies_within_the_bounds(shape, size):
    points = points_for(shape)
    low, high = shape.bounds()
    inside = points[shape.contains(points)]
    assert len(inside) > 0
    assert np.all((inside >= low) & (inside <= high))


@pytest.mark.parametrize("shape", [BOX, DISK, BALL, UPRIGHT, OBLIQUE, Intersection(of=[DISK, OTHER])])
def test_bounds_are_no_wider_than_the_shape(shape):
    points = points_for(shape)
    inside = points[shape.contains(points)]
    # The lens ends in tips that the sampling meets late; two cells of slack.
    slack = 2.0 / (400 if points.shape[1] == 2 else 80) + 0.1 * isinstance(shape, Intersection)
    low, high = shape.bounds()
    assert np.all(np.abs(inside.min(axis=0) - low) < slack)
    assert np.all(np.abs(inside.max(axis=0) - high) < slack)


@SHAPES
def test_no_points_give_no_answers(shape, size):
    assert shape.contains(np.empty((0, len(shape.bounds()[0])))).shape == (0,)


@SHAPES
def test_answers_are_one_truth_value_for_each_point(shape, size):
    points = points_for(shape)
    inside = shape.contains(points)
    assert (inside.dtype, inside.shape) == (np.bool_, (len(points),))


def test_a_box_holds_its_corners():
    assert BOX.contains(np.array([BOX.min, BOX.max])).all()


def test_a_box_ends_at_its_faces():
    assert not BOX.contains(np.array([[0.1 - 1e-12, 0.3], [0.3, 0.4 + 1e-12]])).any()


def test_a_cylinder_about_an_axis_has_exact_bounds():
    low, high = Cylinder(center=[0.0, 0.0, 1.0], axis="z", radius=0.5, height=2.0).bounds()
    assert (low.tolist(), high.tolist()) == ([-0.5, -0.5, 0.0], [0.5, 0.5, 2.0])


def test_a_direction_need_not_have_length_one():
    points = unit_points(3)
    long = Cylinder(center=[0.5, 0.5, 0.5], axis=[0, 0, 7], radius=0.3, height=0.6)
    assert np.array_equal(long.contains(points), UPRIGHT.contains(points))


@pytest.mark.parametrize("scale", [1e-150, 1e-9, 1e9, 1e150])
@pytest.mark.parametrize("kind", [Sphere, Cylinder])
def test_the_unit_of_length_does_not_matter(kind, scale):
    def scaled(s):
        keys = {"center": [0.5 * s] * 3, "radius": 0.25 * s}
        return kind(**keys) if kind is Sphere else kind(**keys, axis="x", height=0.5 * s)

    points = unit_points(3)
    assert np.array_equal(scaled(scale).contains(points * scale), scaled(1.0).contains(points))


def test_a_difference_takes_away_all_but_the_first():
    shape = Difference(of=[BOX, Box(min=[0.1, 0.2], max=[0.2, 0.4]), Box(min=[0.4, 0.2], max=[0.5, 0.4])])
    points = np.array([[0.15, 0.3], [0.3, 0.3], [0.45, 0.3]])
    assert shape.contains(points).tolist() == [False, True, False]


def test_asking_a_difference_changes_none_of_its_shapes():
    points = unit_points(2)
    before = DISK.contains(points)
    Difference(of=[DISK, OTHER]).contains(points)
    assert np.array_equal(DISK.contains(points), before)


def test_shapes_that_do_not_overlap_are_a_misfit():
    apart = Intersection(of=[BOX, Sphere(center=[0.9, 0.9], radius=0.05)])
    assert "do not all overlap" in apart.misfits(2)[0].text


@pytest.mark.parametrize("shape", [BOX, DISK, Union(of=[DISK])])
def test_a_flat_shape_is_a_misfit_in_three_dimensions(shape):
    assert shape.misfits(2) == []
    assert shape.misfits(3) != []


def test_a_cylinder_is_a_misfit_in_two_dimensions():
    assert (UPRIGHT.misfits(3), [problem.path for problem in UPRIGHT.misfits(2)]) == ([], [("type",)])


def test_a_misfit_within_a_shape_has_its_path():
    inner = Union(of=[DISK, Difference(of=[DISK, BALL])])
    assert [problem.path for problem in inner.misfits(2)] == [("of", 1, "of", 1, "center")]


def test_a_box_turned_inside_out_is_refused():
    with pytest.raises(SceneError, match=r"^box: max\[1\] = -1.0 must be > min\[1\] = 0.0 m$"):
        Box(min=[0, 0], max=[1, -1])


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "shape",
    [Sphere(center=[0.5] * 3, radius=1e-200), Cylinder(center=[0.5] * 3, axis="z", radius=1e-310, height=1e-310)],
)
def test_points_are_far_outside_of_the_tiniest_shapes_without_a_warning(shape):
    assert not shape.contains(np.array([[0.0, 0.0, 0.0], [1e3, -1e3, 0.25]])).any()
