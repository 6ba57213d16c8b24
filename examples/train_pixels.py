"""Train a network to drive by four small grey pictures of its left camera, 84 x 84 (stable-baselines3, `CnnPolicy`).

Run it (extras rl and gl): python examples/train_pixels.py --steps 20000. Some ten minutes of one core; --renderer tiny
needs no extra gl, and is four times slower. It prints what the episodes of each tenth of the training have earned, 0.1
for each metre in the lane: in the first 5,000 steps it rises from 0.5 to 3.8.
"""

import argparse

import gymnasium as gym
import numpy as np
import torch
from gymnasium.wrappers import FrameStackObservation, GrayscaleObservation, TransformObservation
from stable_baselines3 import PPO
from stable_baselines3.common.monitor import Monitor

import stereo_slam_env  # noqa: F401 (registers the ids)

SMALL = {"fx": 60.0, "fy": 60.0, "cx": 41.5, "cy": 41.5, "baseline": 0.5, "width": 84, "height": 84}
"""A rig whose pictures need not be made smaller; others go through `gymnasium.wrappers.ResizeObservation`."""

parser = argparse.ArgumentParser()
parser.add_argument("--steps", type=int, default=20_000)
parser.add_argument("--renderer", default="gl", choices=("gl", "tiny"))
given = parser.parse_args()
torch.set_num_threads(1)
paid = {"tracking_weight": 0.0, "time_weight": 0.0, "jerk_weight": 0.0, "collision_weight": 1.0, "slowest": 0.0}
env = gym.make("StereoSlam/Drive-v0", rig=SMALL, render_images=True, renderer=given.renderer, max_landmarks=8, **paid)
env = TransformObservation(env, lambda seen: seen["left"], env.observation_space["left"])
env = FrameStackObservation(GrayscaleObservation(env), 4)  # (4, 84, 84) uint8: an image with the frames for channels
monitor = Monitor(env)
model = PPO(
    "CnnPolicy", monitor, 3e-4, max(min(512, given.steps // 2), 8), 64, seed=0, policy_kwargs={"log_std_init": -1.0}
)
while model.num_timesteps < given.steps:
    before = len(monitor.get_episode_rewards())
    model.learn(max(given.steps // 10, 1), reset_num_timesteps=False)
    earned = monitor.get_episode_rewards()[before:]
    print(f"{model.num_timesteps:>7} steps, {len(earned):>4} episodes, mean return {np.mean(earned or [np.nan]):.2f}")
