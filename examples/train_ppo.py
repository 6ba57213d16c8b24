"""Train a network to look where a filter gains most (stable-baselines3), and compare it with a fixed gaze.

Run it (extra rl): python examples/train_ppo.py --decisions 30000. It prints both final sigmas of the position, m.
"""

import argparse

import gymnasium as gym
import numpy as np
from stable_baselines3 import PPO

import stereo_slam_env  # noqa: F401 (registers the ids)


def final_sigma(look, seed):
    """Root of the trace of the position covariance at the end of an episode, m."""
    (observation, _), over = env.reset(seed=seed), False
    while not over:
        observation, _, over, _, _ = env.step(look(observation))
    return np.linalg.norm(observation["belief_sigmas"][:3])


parser = argparse.ArgumentParser()
parser.add_argument("--decisions", type=int, default=30_000)
parser.add_argument("--route", default="straight")
given = parser.parse_args()
env = gym.make("StereoSlam/ActiveGaze-v0", arguments={"route": given.route})
model = PPO("MultiInputPolicy", env, 5e-4, min(1000, given.decisions), batch_size=250, gamma=0.95, seed=0)
model.learn(given.decisions)
for name, look in {"fixed": lambda _: 4, "ppo": lambda o: model.predict(o, deterministic=True)[0]}.items():
    print(f"{name:<5} gaze: {np.mean([final_sigma(look, 1000 + seed) for seed in range(8)]):.3f} m")
