"""Environments with a filter in the loop, after a short drive with the head turning."""

from __future__ import annotations

import gymnasium as gym
import numpy as np

import stereo_slam_env  # noqa: F401
from filters import Pose
from stereo_slam_env.envs import BeliefObservation
from stereo_slam_env.policies.foresight import Knowledge, SensorModel

KEEPS = {"drop_unseen": False, "motion": "velocity-driven", "gate": None}


def with_belief(filter="shared-anchor", options=None, **arguments):
    env = gym.make("StereoSlam/Gaze-v0", **{"rig": "vga", "route": "straight", **arguments})
    return BeliefObservation(env, filter=filter, options={**KEEPS, **(options or {})})


def looked_around(steps=25, seed=8, **arguments):
    """An environment whose filter has seen something on both sides."""
    env = with_belief(**arguments)
    env.reset(seed=seed)
    for step in range(steps):
        env.step(np.array([np.sin(0.25 * step), 0.2], dtype=np.float32))
    return env


def sensor_of(env, **options):
    return SensorModel(env.get_wrapper_attr("camera"), env.get_wrapper_attr("noise"), **options)


def knowledge_of(slam, within=np.inf):
    """All that a filter knows, as it says itself."""
    landmarks = slam.landmarks
    near = np.linalg.norm(landmarks.positions - slam.pose.position, axis=1) <= within
    near &= np.isfinite(landmarks.covariances).all(axis=(1, 2)) & (landmarks.inverse_distance > 0.0)
    pose = Pose(slam.pose.position, slam.pose.orientation)
    return Knowledge.of(slam, pose, landmarks.ids[near], landmarks.positions[near])


def in_cameras(points_w, cameras):
    """Points (N, 3) of W in each camera frame; (..., N, 3) m."""
    return (points_w - cameras.positions[..., None, :]) @ cameras.R_wc


def innovation_covariances(sensor, knowledge, cameras):
    """S (Eq. 15) of each landmark from each camera, the motion to it being known exactly; (..., N, 3, 3) px^2."""
    H = sensor.camera.project_jacobian(in_cameras(knowledge.points, cameras))
    H = H @ np.swapaxes(cameras.R_wc, -1, -2)[..., None, :, :]
    return H @ relative_covariances(knowledge) @ np.swapaxes(H, -1, -2) + sensor.noise.R


def relative_covariances(knowledge):
    """Covariance of each landmark as seen from the camera, in the axes of W; (N, 3, 3) m^2."""
    J = whole_jacobians(knowledge)
    return J @ knowledge.covariance @ J.transpose(0, 2, 1)


def whole_jacobians(knowledge):
    """d e / d (pose, map) of each landmark; (N, 3, 6 + 3 N)."""
    count = len(knowledge.points)
    J = np.zeros((count, 3, 6 + 3 * count))
    J[:, :, :6] = knowledge.by_pose
    for k in range(count):
        J[k, :, 6 + 3 * k : 9 + 3 * k] = np.eye(3)
    return J
