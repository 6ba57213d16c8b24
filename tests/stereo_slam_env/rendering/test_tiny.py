"""TinyRenderer draws where the camera model says. About 1 s."""

import numpy as np
import pytest

from filters import rotations
from filters.camera import StereoCamera
from stereo_slam_env.recording import Pose
from stereo_slam_env.rendering.tiny import TinyRenderer
from stereo_slam_env.world.frames import WorldFrame
from stereo_slam_env.world.physics import PhysicsWorld
from stereo_slam_env.world.scene import Box, Ground, Material, Scene

FRAME = WorldFrame(1.65)
WALL = Box((30.0, 3.0, 0.0), (20.0, 60.0, 60.0), 0.5, Material((0.9, 0.3, 0.2)))
"""Seen at an angle; its face cuts the forward axis about 20 m ahead."""


@pytest.fixture(scope="module")
def world():
    nothing = np.zeros(0, dtype=np.int64), np.zeros((0, 3))
    ground = Ground((-400.3, -400.3), (400.3, 400.3), Material((0.3, 0.6, 0.3)))
    world = PhysicsWorld()
    scene = Scene(ground, (WALL,), (), *nothing)
    world.build(scene, (4.0, 1.8, 1.0))
    world.dress(scene)
    yield world
    world.close()


def plane_in_camera(pose):
    """Normal n and offset c of the wall's face n . p = c in the camera frame."""
    normal_s = -np.array([np.cos(WALL.yaw), np.sin(WALL.yaw), 0.0])
    point_s = np.array(WALL.center) + 0.5 * WALL.size[0] * normal_s
    R_sc = FRAME.rotation_to_scene(rotations.matrix(pose.orientation))
    normal_c = R_sc.T @ normal_s
    return normal_c, float(normal_s @ (point_s - FRAME.to_scene(pose.position)))


@pytest.mark.parametrize("size", [(320, 240), (501, 203)])
def test_a_slanted_plane_is_drawn_to_a_hundredth_of_a_pixel(world, size):
    camera = StereoCamera(300.0, 310.0, 0.5 * size[0] + 33.0, 0.5 * size[1] - 22.0, 0.5, *size)
    pose = Pose(np.array([0.4, -0.6, 1.0]), rotations.exp_quaternion([0.3, 0.1, 0.2]))
    depth = TinyRenderer(world, camera, FRAME).render_pair(pose).depth
    n, c = plane_in_camera(pose)
    rows, columns = np.indices(depth.shape)
    # 1/z = n . ray / c is affine in the pixel; fit it and compare with the prediction.
    predicted = np.array([n[0] / camera.fx, n[1] / camera.fy, 0.0]) / c
    predicted[2] = n[2] / c - predicted[0] * camera.cx - predicted[1] * camera.cy
    design = np.column_stack([columns.ravel(), rows.ravel(), np.ones(depth.size)])
    inverse = 1.0 / depth.ravel()
    on_wall = np.abs(inverse - design @ predicted) < 5e-3 * np.abs(inverse)
    assert on_wall.mean() > 0.5
    fitted = np.linalg.lstsq(design[on_wall], inverse[on_wall], rcond=None)[0]
    gradient = predicted[:2] / np.linalg.norm(predicted[:2])
    center = design[on_wall].mean(axis=0)
    offset = (fitted - predicted) @ center / (predicted[:2] @ gradient)
    assert abs(offset) < 0.01
    np.testing.assert_allclose(fitted[:2], predicted[:2], rtol=1e-3)


def test_the_right_eye_sees_edges_shifted_by_the_disparity(world):
    camera = StereoCamera(300.0, 300.0, 159.5, 119.5, 0.5, 320, 240)
    pose = Pose(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
    images = TinyRenderer(world, camera, FRAME).render_pair(pose)
    row = 100
    edge = [int(np.flatnonzero(np.diff(image[row, :, 0].astype(int)) < -50)[0])
            if (np.diff(image[row, :, 0].astype(int)) < -50).any() else None
            for image in (images.left, images.right)]  # fmt: skip
    assert images.left.shape == images.right.shape == (240, 320, 3)
    if None not in edge:
        disparity = camera.disparity_constant / images.depth[row, edge[0]]
        assert edge[0] - edge[1] == pytest.approx(disparity, abs=1.5)
    assert not np.array_equal(images.left, images.right)


def test_same_pose_same_bits_and_sky_above(world):
    camera = StereoCamera(100.0, 100.0, 79.5, 59.5, 0.5, 160, 120)
    away = Pose(np.zeros(3), rotations.exp_quaternion([0.0, np.pi, 0.0]))
    renderer = TinyRenderer(world, camera, FRAME)
    one, two = renderer.render_pair(away), renderer.render_pair(away)
    for name in ("left", "right", "depth"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
    assert np.isinf(one.depth[:50]).all()
    assert np.isfinite(one.depth[70:]).all()
    assert one.left[5, 80, 2] > one.left[5, 80, 0]
    bottom = one.depth[119, 80]
    assert bottom == pytest.approx(1.65 * camera.fy / (119 - camera.cy), rel=1e-3)


def test_supersampling_keeps_the_geometry(world):
    camera = StereoCamera(100.0, 100.0, 79.5, 59.5, 0.5, 160, 120)
    pose = Pose(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
    plain = TinyRenderer(world, camera, FRAME).render_pair(pose)
    fine = TinyRenderer(world, camera, FRAME, supersample=3).render_pair(pose)
    both = np.isfinite(plain.depth) & np.isfinite(fine.depth)
    relative = np.abs(fine.depth[both] / plain.depth[both] - 1)
    assert np.median(relative) < 1e-3
    assert np.abs(fine.left.astype(int) - plain.left.astype(int)).mean() < 2
