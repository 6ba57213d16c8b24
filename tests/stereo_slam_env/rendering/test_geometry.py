"""Every back end draws where the camera model says: planes, both views, moving bodies. About 10 s."""

import cv2
import numpy as np
import pytest

from filters import Pose
from filters.geometry import rotations
from filters.geometry.camera import StereoCamera
from stereo_slam_env.rendering.pinhole import depth_at
from stereo_slam_env.world.scene import Box, Look, Material, MovingBody
from stereo_slam_env.world.surroundings import in_fog

from .planes import AHEAD, CAMERA, FRAME, Wall, both_back_ends, drawing, scene_of
from .subpixel import disparity_bias

SLANTED = Wall(20.0, 0.5)


@both_back_ends
@pytest.mark.parametrize("size", [(320, 240), (501, 203)])
@pytest.mark.parametrize("options", [{}, {"supersample": 2}, {"supersample": 3}], ids=str)
def test_a_slanted_plane_is_drawn_to_a_hundredth_of_a_pixel(name, size, options):
    camera = StereoCamera(300.0, 310.0, 0.5 * size[0] + 33.0, 0.5 * size[1] - 22.0, 0.5, *size)
    pose = Pose(np.array([0.4, -0.6, 1.0]), rotations.exp_quaternion([0.3, 0.1, 0.2]))
    with drawing(name, scene_of(SLANTED.box), camera, **options) as renderer:
        depth = renderer.render_pair(pose).depth
    predicted = SLANTED.inverse_depth(camera, pose)
    rows, columns = np.indices(depth.shape)
    # 1/z is affine in the pixel; fit it and compare with the prediction.
    design = np.column_stack([columns.ravel(), rows.ravel(), np.ones(depth.size)])
    inverse = 1.0 / depth.ravel()
    on_wall = np.abs(inverse - design @ predicted) < 5e-3 * np.abs(inverse)
    assert on_wall.mean() > 0.5
    fitted = np.linalg.lstsq(design[on_wall], inverse[on_wall], rcond=None)[0]
    gradient = predicted[:2] / np.linalg.norm(predicted[:2])
    offset = (fitted - predicted) @ design[on_wall].mean(axis=0) / (predicted[:2] @ gradient)
    assert abs(offset) < 0.01
    np.testing.assert_allclose(fitted[:2], predicted[:2], rtol=1e-3)


@both_back_ends
@pytest.mark.parametrize("yaw", [0.0, 0.4], ids=["fronto-parallel", "slanted"])
def test_the_disparity_in_the_pictures_has_no_bias(name, yaw):
    rows, columns = np.indices((CAMERA.height, CAMERA.width))
    biases = []
    for i, distance in enumerate(np.geomspace(5.0, 45.0, 7)):
        tile = 256 * 3.1 * distance / CAMERA.fx  # about three pixels a texel
        wall = Wall(distance, yaw, Material((0.9, 0.9, 0.9), "grass", (tile, 1.13 * tile)))
        # Rolled, so that the edges of texels cross the columns everywhere between two pixel centres.
        pose = Pose(np.array([0.013 * i, -0.021 * i, 0.0]), rotations.exp_quaternion([0.0, 0.0, 0.2 + 0.03 * i]))
        with drawing(name, scene_of(wall.box)) as renderer:
            images = renderer.render_pair(pose)
        a, b, c = wall.inverse_depth(CAMERA, pose)
        inverse = a * columns + b * rows + c
        on_wall = np.abs(images.depth * inverse - 1.0) < 1e-3
        predicted = np.where(on_wall, CAMERA.disparity_constant * inverse, np.nan)
        biases.append(disparity_bias(images.left, images.right, predicted))
    assert abs(np.mean(biases)) < 0.01
    assert np.abs(biases).max() < 0.03


@both_back_ends
def test_the_same_pose_gives_the_same_bits_and_the_sky_is_above(name):
    away = Pose(np.zeros(3), rotations.exp_quaternion([0.0, np.pi, 0.0]))
    camera = StereoCamera(100.0, 100.0, 79.5, 59.5, 0.5, 160, 120)
    with drawing(name, scene_of(SLANTED.box), camera) as renderer:
        one = renderer.render_pair(away)
        renderer.render_pair(AHEAD)
        two = renderer.render_pair(away)
    for part in ("left", "right", "depth"):
        np.testing.assert_array_equal(getattr(one, part), getattr(two, part))
    assert np.isinf(one.depth[:50]).all()
    assert np.isfinite(one.depth[70:]).all()
    assert one.left[5, 80, 2] > one.left[5, 80, 0]
    assert one.depth[119, 80] == pytest.approx(1.65 * camera.fy / (119 - camera.cy), rel=1e-3)


@both_back_ends
def test_the_look_of_the_scene_is_used(name):
    dim = Look(
        sun=(-1.0, 0.0, 0.3), ambient=0.3, horizon=(250.0, 120.0, 40.0), zenith=(20.0, 10.0, 90.0), haze_range=40
    )
    level = Pose(np.array([0.0, 0.0, 12.0]), AHEAD.orientation)
    wall = Wall(20.0, 0.0)
    with drawing(name, scene_of(wall.box, look=dim)) as renderer:
        seen = renderer.render_pair(level).left[int(CAMERA.cy), int(CAMERA.cx)]
        sky = renderer.render_pair(Pose(np.zeros(3), rotations.exp_quaternion([0.0, np.pi, 0.0]))).left[0, 160]
    sun = np.array(dim.sun) / np.linalg.norm(dim.sun)
    lit = 255 * np.array(wall.material.color) * (dim.ambient + dim.diffuse * (wall.normal @ sun))
    clear = np.exp(-8.0 / dim.haze_range)
    np.testing.assert_allclose(seen, clear * lit + (1 - clear) * np.array(dim.horizon), atol=2)
    height = np.sqrt(min((CAMERA.cy / CAMERA.fy) / 0.45, 1.0))
    np.testing.assert_allclose(sky, (1 - height) * np.array(dim.horizon) + height * np.array(dim.zenith), atol=2)


CROSSING = MovingBody(
    "car",
    (Box((0.3, 0.0, 0.9), (4.0, 1.8, 1.4), 0.0, Material((0.9, 0.05, 0.05))),),
    np.array([0.0, 2.0, 4.0]),
    np.array([[14.0, 4.0, 0.0], [14.0, -3.0, 0.0], [22.0, -3.0, 0.0]]),
    np.array([-np.pi / 2, -np.pi / 2, -0.7]),
)
"""Crosses from left to right, then turns away."""


def corners_in_camera(body, time):
    (box,) = body.parts
    position, yaw = body.pose_at(time)
    unit = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0.0], [np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
    return FRAME.to_world((unit * box.size + box.center) @ turn.T + position)


def is_red(image):
    return image[..., 0].astype(int) > 2 * image[..., 1].astype(int)


def center_of(mask):
    assert mask.sum() > 300
    return np.argwhere(mask).mean(axis=0)[::-1]


def pixels_inside(uv, shape):
    """Pixels whose centres are in the convex hull of points (N, 2)."""
    hull = cv2.convexHull(uv.astype(np.float32))[:, 0].astype(np.float64)
    edges = np.roll(hull, -1, axis=0) - hull
    rows, columns = np.indices(shape)
    to_pixel = np.stack([columns, rows], axis=-1)[:, :, None] - hull
    side = edges[:, 0] * to_pixel[..., 1] - edges[:, 1] * to_pixel[..., 0]
    return (side > 0).all(axis=-1) | (side < 0).all(axis=-1)


@both_back_ends
def test_a_moving_body_is_where_it_is_at_the_time_and_nowhere_where_it_is_out_of_view(name):
    with drawing(name, scene_of(moving=[CROSSING], look=Look(haze_range=1e6))) as renderer:
        for time in (3.3, 0.0, 1.4):
            images = renderer.render_pair(AHEAD, time)
            points = CAMERA.project(corners_in_camera(CROSSING, time))
            for image, u in ((images.left, points[:, 0]), (images.right, points[:, 0] - points[:, 2])):
                predicted = pixels_inside(np.column_stack([u, points[:, 1]]), image.shape[:2])
                np.testing.assert_allclose(center_of(is_red(image)), center_of(predicted), atol=0.05)
        turned = Pose(np.zeros(3), rotations.exp_quaternion([0.0, 0.9, 0.0]))
        assert not is_red(renderer.render_pair(turned, 0.0).left).any()


@both_back_ends
def test_the_depth_of_a_moving_body_is_right(name):
    with drawing(name, scene_of(moving=[CROSSING])) as renderer:
        for time in (0.5, 1.4):  # broadside: its side is a plane across the view
            depth = renderer.render_pair(AHEAD, time).depth
            corners = corners_in_camera(CROSSING, time)
            near = corners[np.argsort(corners[:, 2])[:4]]
            uv = CAMERA.project(near.mean(axis=0, keepdims=True))[:, :2]
            np.testing.assert_allclose(depth_at(depth, uv), near[:, 2].mean(), rtol=1e-5)


@both_back_ends
def test_a_twentieth_of_the_contrast_is_left_at_the_visibility(name):
    black = Material((0.0, 0.0, 0.0))
    for visibility, distance, share in ((30.0, 30.0, 0.05), (30.0, 10.0, 0.37), (60.0, 30.0, 0.22)):
        scene = in_fog(scene_of(Wall(distance, 0.0, black).box), visibility)
        with drawing(name, scene) as renderer:
            wall = renderer.render_pair(AHEAD).left[80:110, 170:210].astype(float)
        contrast = 1.0 - wall / np.array(scene.look.horizon)
        assert contrast.mean() == pytest.approx(share, abs=0.01)
