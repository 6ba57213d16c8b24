"""Run a filter in the environment and compare its errors with its covariance.

Run it: python examples/run_a_filter.py
"""

import gymnasium as gym
import numpy as np

from filters import make_filter
from stereo_slam_env import stereo_observation

env = gym.make("StereoSlam/Drive-v0", route="right-turn", policy="route")
observation, info = env.reset(seed=0)
rig, start = env.unwrapped, env.unwrapped.start
slam = make_filter("inverse-depth", camera=rig.camera, noise=rig.noise)
slam.reset(start)
slam.update(stereo_observation(observation, info))
over = False
while not over:
    observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
    slam.predict(0.1)
    report = slam.update(stereo_observation(observation, info))
    over = terminated or truncated
    if info["time"] % 1.0 < 0.05 or over:
        error, covariance = slam.pose_error(info["truth_position"], info["truth_orientation"])
        print(
            f"{info['time']:4.1f} s  driven {info['distance']:5.1f} m  position error {np.linalg.norm(error[:3]):.3f} m"
            f"  NEES / 6 {error @ np.linalg.solve(covariance, error) / 6:5.2f} (1 expected)"
            f"  {len(report.updated)} landmarks used"
        )
env.close()
