"""Imagined poses of the camera, against those of the drive (4 s)."""

import gymnasium as gym
import numpy as np
import pytest

import stereo_slam_env  # noqa: F401
from filters.geometry import rotations
from stereo_slam_env.policies.foresight import CameraPoses, planned_bodies, seen_from, straight_ahead, turning_head
from stereo_slam_env.world.routes import named_route
from stereo_slam_env.world.vehicle import Head


@pytest.mark.parametrize(("before", "steps"), [(0, 8), (20, 8), (70, 12)])
@pytest.mark.parametrize("target", [(1.7, -0.3), (-0.4, 0.4)])
def test_without_perturbations_the_camera_gets_where_it_was_imagined(before, steps, target):
    env = gym.make("StereoSlam/Gaze-v0", rig="qvga", route="right-turn", perturbation=0.0)
    env.reset(seed=0)
    core = env.unwrapped
    for k in range(before):
        env.step(np.array([np.sin(k), np.cos(k)], dtype=np.float32))
    body = straight_ahead(core.head, CameraPoses.of([core.frame.truth]), core.head_angles[None])
    np.testing.assert_allclose(body.positions[0], core.body.position, atol=1e-9)
    angles = turning_head(core.head, core.head_angles, np.array([[0.0, 0.0], target]), steps)
    cameras = seen_from(core.head, planned_bodies(body, [core.route], [before], steps), angles)
    action = (np.array(target) / core.head.max_angles).astype(np.float32)
    for k in range(steps):
        over = env.step(action)[2]
        np.testing.assert_allclose(angles[1, k], core.head_angles, atol=1e-7)  # the action is float32
        np.testing.assert_allclose(cameras.positions[1, k], core.frame.truth.position, atol=1e-6)
        np.testing.assert_allclose(cameras.R_wc[1, k], rotations.matrix(core.frame.truth.orientation), atol=1e-6)
        if over:
            break
    env.close()


def test_at_the_end_of_the_route_the_car_stands_still():
    env = gym.make("StereoSlam/Gaze-v0", rig="qvga", route="right-turn")
    route = env.unwrapped.route
    env.reset(seed=0)
    here, other = env.unwrapped.frame.truth, named_route("town")
    bodies = planned_bodies(CameraPoses.of([here, here]), [route, other], [route.frames + 3, 5], 4)
    np.testing.assert_array_equal(bodies.positions[0], np.tile(here.position, (4, 1)))
    one = planned_bodies(CameraPoses.of([here]), [other], [5], 4)
    np.testing.assert_array_equal(bodies.positions[1], one.positions[0])
    assert np.linalg.norm(one.positions[0, -1] - here.position) > 1.0
    env.close()


def test_a_head_that_cannot_turn_stays():
    angles = turning_head(Head(0.5, (0.0, 0.4), (1.5, 1.0)), np.zeros(2), np.array([[0.0, 0.4]]), 20)
    np.testing.assert_array_equal(angles[0, :, 0], 0.0)
    assert angles[0, -1, 1] == 0.4
