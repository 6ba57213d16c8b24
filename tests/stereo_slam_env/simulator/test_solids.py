"""What hides and what is touched, by geometry alone: points within shapes, planes between them (3 s)."""

import numpy as np
import pytest

from filters.geometry import rotations
from stereo_slam_env.simulator.contacts import touching
from stereo_slam_env.simulator.rays import obstacles, visible
from stereo_slam_env.world.scene import Box, Cylinder, Material, Sphere, TriangleMesh

GREY = Material((0.5, 0.5, 0.5))
KINDS = ("box", "cylinder", "sphere", "mesh")
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
"""Of a tetrahedron."""
STEPS = np.linspace(0.0, 1.0, 400)[:, None]


def random_solid(kind, rng, reach=5.0):
    at = rng.uniform((-reach, -reach, 1.0), (reach, reach, 4.0))
    if kind == "box":
        return Box(tuple(at), tuple(rng.uniform(0.5, 3.0, 3)), rng.uniform(-3.0, 3.0), GREY)
    if kind == "cylinder":
        return Cylinder(tuple(at), tuple(at + rng.uniform(-2.0, 2.0, 3)), rng.uniform(0.3, 1.0), GREY)
    if kind == "sphere":
        return Sphere(tuple(at), rng.uniform(0.3, 1.5), GREY)
    return TriangleMesh(at + rng.uniform(-2.0, 2.0, (4, 3)), FACES, GREY)


def depth_of(solid, points):
    """How far points are within a solid, m; below 0 outside, where it is only a bound of the distance."""
    if isinstance(solid, Box):
        local = (points - solid.center) @ rotations.exp([0.0, 0.0, solid.yaw])
        return (0.5 * np.array(solid.size) - np.abs(local)).min(axis=1)
    if isinstance(solid, Cylinder):
        start, end = np.array(solid.start), np.array(solid.end)
        length = np.linalg.norm(end - start)
        along = (points - start) @ (end - start) / length
        away = np.linalg.norm(points - start - np.outer(along, (end - start) / length), axis=1)
        return np.minimum(np.minimum(along, length - along), solid.radius - away)
    if isinstance(solid, Sphere):
        return solid.radius - np.linalg.norm(points - solid.center, axis=1)
    corners = solid.vertices[solid.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    inwards = np.sign(np.einsum("ti,ti->t", solid.vertices.mean(axis=0) - corners[:, 0], normals))
    return (np.einsum("nti,ti->nt", points[:, None] - corners[:, 0], normals) * inwards).min(axis=1)


def deepest(solid, camera, point):
    """How deep the ray from a camera to 5 cm before a point goes into a solid."""
    way = point - camera
    way *= 1.0 - 0.05 / np.linalg.norm(way)
    return depth_of(solid, camera + STEPS * way).max()


@pytest.mark.parametrize("kind", KINDS)
def test_a_solid_hides_what_the_ray_to_goes_through_it(kind):
    rng = np.random.default_rng(3)
    hidden = clear = 0
    for _ in range(60):
        solid = random_solid(kind, rng, reach=1.0)
        camera = rng.uniform((-9, -9, 1), (9, 9, 4))
        away = rng.uniform((-3, -3, 1), (3, 3, 4), (12, 3))
        points = away - rng.uniform(0.0, 1.0, (12, 1)) * camera * [1.0, 1.0, 0.0]
        depths = np.array([deepest(solid, camera, point) for point in points])
        if depth_of(solid, camera[None])[0] > -0.1:  # nothing hides what is around itself, but for triangles
            continue
        seen = visible(obstacles([solid]), camera[None], points)
        assert not seen[depths > 0.03].any()
        assert seen[depths < -0.03].all()
        hidden, clear = hidden + (depths > 0.03).sum(), clear + (depths < -0.03).sum()
    assert min(hidden, clear) > 80


def test_what_one_of_two_cameras_does_not_see_is_not_seen():
    rng = np.random.default_rng(4)
    differ = 0
    for _ in range(10):
        shapes = obstacles([random_solid(kind, rng) for kind in KINDS])
        cameras, points = rng.uniform((-9, -9, 1), (9, 9, 4), (2, 3)), rng.uniform((-9, -9, -1), (9, 9, 6), (60, 3))
        left, right = (visible(shapes, camera[None], points) for camera in cameras)
        np.testing.assert_array_equal(visible(shapes, cameras, points), left & right)
        differ += (left != right).sum()
    assert differ > 50


def test_many_solids_hide_what_any_of_them_hides():
    rng = np.random.default_rng(5)
    for count in (1, 7, 8, 9, 64, 65, 130):
        solids = [random_solid(KINDS[i % 3], rng, reach=25.0) for i in range(count)]
        cameras = rng.uniform((-30, -30, 1), (30, 30, 4), (2, 3))
        points = rng.uniform((-30, -30, 0.5), (30, 30, 6), (40, 3))
        expected = np.all([visible(obstacles([solid]), cameras, points) for solid in solids], axis=0)
        np.testing.assert_array_equal(visible(obstacles(solids), cameras, points), expected)


def test_rays_along_the_axes_and_in_the_planes_of_a_box():
    """One that runs along a face does not go through it; one that stops before the box is not hidden by it."""
    shapes = obstacles([Box((5.0, 0.0, 2.0), (2.0, 2.0, 2.0), 0.0, GREY)])
    for camera, point, seen in (
        *(((0.0, 0.0, 2.0), (9.0, 0.0, 2.0), False), ((0.0, 0.9, 2.0), (9.0, 0.9, 2.0), False)),
        *(((0.0, 1.1, 2.0), (9.0, 1.1, 2.0), True), ((0.0, 0.0, 3.1), (9.0, 0.0, 3.1), True)),
        *(((5.0, -4.0, 2.0), (5.0, 4.0, 2.0), False), ((5.0, 0.0, 9.0), (5.0, 0.0, 0.5), False)),
        *(((0.0, 0.0, 2.0), (4.03, 0.0, 2.0), True), ((0.0, 0.0, 2.0), (4.07, 0.0, 2.0), False)),
        *(((9.0, 0.0, 2.0), (5.97, 0.0, 2.0), True), ((0.0, 0.0, 2.0), (-9.0, 0.0, 2.0), True)),
    ):
        assert visible(shapes, np.array([camera]), np.array([point])).tolist() == [seen], (camera, point)


@pytest.mark.parametrize(
    "turned",
    [np.eye(3), rotations.exp([0.0, 0.0, 0.7]), rotations.exp([0.4, -0.9, 0.3])],
    ids=["upright", "yawed", "leaning"],
)
def test_cylinders_end_where_they_are_said_to(turned):
    """Rays along the axis, beside it, through an end, and past both ends."""
    at = np.array([1.0, 2.0, 5.0])
    solid = Cylinder(tuple(at - turned @ [0, 0, 1.0]), tuple(at + turned @ [0, 0, 1.0]), 0.5, GREY)
    for camera, point, seen in (
        *(((0.0, 0.0, 3.0), (0.0, 0.0, -3.0), False), ((0.4, 0.0, 3.0), (0.4, 0.0, -3.0), False)),
        *(((0.6, 0.0, 3.0), (0.6, 0.0, -3.0), True), ((3.0, 0.0, 0.9), (-3.0, 0.0, 0.9), False)),
        *(((3.0, 0.0, 1.1), (-3.0, 0.0, 1.1), True), ((3.0, 0.0, -1.1), (-3.0, 0.0, -1.1), True)),
        *(((3.0, 0.0, 0.0), (0.53, 0.0, 0.0), True), ((3.0, 0.0, 0.0), (0.57, 0.0, 0.0), True)),
        *(((0.0, 0.3, 3.0), (0.0, 0.3, 1.03), True), ((0.0, 0.3, 3.0), (0.0, 0.3, 0.9), False)),
        ((2.0, 0.0, 2.0), (-1.0, 0.0, -1.0), False),
    ):
        camera, point = at + turned @ camera, at + turned @ point
        assert visible(obstacles([solid]), camera[None], point[None]).tolist() == [seen], (camera, point)


def test_a_mesh_has_a_row_for_each_of_its_triangles():
    rng = np.random.default_rng(0)
    mesh, box = random_solid("mesh", rng), random_solid("box", rng)
    shapes = obstacles([box, mesh, box])
    assert shapes.solids.shape == (6, 10)
    np.testing.assert_array_equal(shapes.solids[1:5, :9], mesh.corners_and_edges)
    np.testing.assert_array_equal(shapes.solids[0], shapes.solids[5])


# --- contacts --------------------------------------------------------------------------------------------------------


def corners_of(half, at, R):
    return at + np.array(np.meshgrid(*([-1.0, 1.0],) * 3)).reshape(3, -1).T * half @ R.T


def gap_of(one, other, axes):
    """Largest gap between the corners of two convex bodies along axes, m; below 0 where none separates them."""
    axes = axes[np.linalg.norm(axes, axis=1) > 1e-9]
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    a, b = one @ axes.T, other @ axes.T
    return np.maximum(a.min(axis=0) - b.max(axis=0), b.min(axis=0) - a.max(axis=0)).max()


def gap_to(solid, half, at, R):
    """Distance from a box to a solid, or what separates them at most, m; below 0 where they touch."""
    box = corners_of(half, at, R)
    if isinstance(solid, Sphere):
        local = (np.array(solid.center) - at) @ R
        return np.linalg.norm(local - np.clip(local, -half, half)) - solid.radius
    gaps = []
    for triangle in solid.vertices[solid.triangles]:
        edges = triangle - np.roll(triangle, 1, axis=0)
        normal = np.cross(edges[0], edges[1])
        axes = np.array([*R.T, normal, *(np.cross(a, b) for a in R.T for b in edges)])
        gaps.append(gap_of(box, triangle, axes))
    return min(gaps)


@pytest.mark.parametrize("kind", ["sphere", "mesh"])
def test_a_box_touches_what_nothing_separates_from_it(kind):
    rng, touched, apart = np.random.default_rng(6), 0, 0
    for _ in range(150):
        solid, half = random_solid(kind, rng, reach=2.0), rng.uniform(0.2, 2.0, 3)
        at, R = rng.uniform((-3, -3, 0), (3, 3, 5)), rotations.exp(rng.normal(size=3))
        gap = gap_to(solid, half, at, R)
        found = touching(obstacles([solid]), tuple(half), at[None], R[None])
        assert found[0] == (gap < 0.0) or abs(gap) < 1e-6
        touched, apart = touched + (gap < 0.0), apart + (gap > 0.0)
    assert min(touched, apart) > 30


def test_a_box_that_turns_about_the_axis_of_a_cylinder():
    """Then circles and rectangles, and their heights, decide."""
    rng, touched = np.random.default_rng(7), 0
    for _ in range(150):
        Q, half = rotations.exp(rng.normal(size=3)), rng.uniform(0.2, 2.0, 3)
        radius, length, centre = rng.uniform(0.2, 1.5), rng.uniform(0.5, 3.0), rng.uniform(-3, 3, 3)
        ends = centre - 0.5 * length * Q[:, 2], centre + 0.5 * length * Q[:, 2]
        R, at = Q @ rotations.exp([0.0, 0.0, rng.uniform(-3, 3)]), centre + Q @ rng.uniform(-3, 3, 3)
        local = (centre - at) @ R
        beside = np.linalg.norm(local[:2] - np.clip(local[:2], -half[:2], half[:2])) - radius
        gap = max(beside, abs(local[2]) - half[2] - 0.5 * length)
        shapes = obstacles([Cylinder(tuple(ends[0]), tuple(ends[1]), radius, GREY)])
        assert touching(shapes, tuple(half), at[None], R[None])[0] == (gap < 0.0) or abs(gap) < 1e-3
        touched += gap < 0.0
    assert 30 < touched < 120


def test_a_box_among_many_touches_where_it_touches_one_of_them():
    rng = np.random.default_rng(8)
    solids = [random_solid(KINDS[i % 4], rng, reach=20.0) for i in range(80)]
    half, at = (2.0, 0.9, 0.7), rng.uniform((-20, -20, 0.7), (20, 20, 4), (60, 3))
    R = np.array([rotations.exp(turn) for turn in rng.normal(size=(60, 3))])
    expected = np.any([touching(obstacles([solid]), half, at, R) for solid in solids], axis=0)
    assert 10 < expected.sum() < 50
    np.testing.assert_array_equal(touching(obstacles(solids), half, at, R), expected)
