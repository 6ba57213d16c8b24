"""Active gaze with a filter and a rule: plain Gymnasium, no learning.

The rule turns the head to the nearest landmark in the filter's map that is not too far to the side. A head that looks
straight ahead gets the same seeds: the same world, the same drive.
Run it: python examples/active_gaze.py --seeds 8
It prints, for either, the claimed standard deviation and the true error of the final position, m.
"""

import argparse

import gymnasium as gym
import numpy as np

import stereo_slam_env as sse
from filters import Pose, make_filter
from stereo_slam_env.envs import GazeTask

# The map keeps what is out of view, the odometry is believed, what comes back into view is linearised twice.
OPTIONS = GazeTask().filter_options
SIDEWAYS = 0.9  # rad; what is farther round has almost been passed


def straight_ahead(slam, head):
    """Pan and tilt of a fixed gaze, rad."""
    return np.zeros(2)


def nearest_landmark(slam, head):
    """Pan and tilt of the landmark, rad; straight ahead while there is none."""
    camera = Pose(slam.pose.position, slam.pose.orientation)
    right, down, forward = camera.to_camera(slam.landmarks.positions).T
    pan, tilt = head[0] + np.arctan2(right, forward), head[1] - np.arctan2(down, np.hypot(right, forward))
    near = np.where(np.abs(pan) < SIDEWAYS, right**2 + down**2 + forward**2, np.inf)
    return np.array([pan[near.argmin()], tilt[near.argmin()]]) if np.isfinite(near).any() else np.zeros(2)


def drive(env, rule, seed):
    """Claimed standard deviation and true error of the final position, m."""
    rig = env.unwrapped
    env.reset(seed=seed)
    loop = sse.FilterLoop(make_filter("shared-anchor", camera=rig.camera, noise=rig.noise, **OPTIONS))
    loop.reset(rig.start)
    moment, over = loop.step(rig.frame), False
    while not over:
        action = rule(moment.slam, rig.head_angles) / rig.head.max_angles
        _, _, terminated, truncated, _ = env.step(np.clip(action, -1, 1).astype(np.float32))
        moment, over = loop.step(rig.frame), terminated or truncated
    return np.sqrt(moment.pose.covariance[:3, :3].trace()), moment.position_error


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--route", default="straight")
    given = parser.parse_args()
    env = gym.make("StereoSlam/Gaze-v0", route=given.route)
    for rule in (straight_ahead, nearest_landmark):
        sigma, error = np.mean([drive(env, rule, seed) for seed in range(given.seeds)], axis=0)
        print(f"{rule.__name__:<18} final position: sigma {sigma:.3f} m, true error {error:.3f} m")
