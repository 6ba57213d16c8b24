"""Train a network to look where the estimate becomes true (stable-baselines3), and compare it with a fixed gaze.

Run it (extra rl): python examples/train_ppo.py --decisions 30000. Half a minute of one core; it shows how far it is,
and prints both true errors of the position at the end, m.
"""

import argparse

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize

import stereo_slam_env  # noqa: F401 (registers the ids)
from stereo_slam_env.policies import SB3VecEnv

ID = "StereoSlam/ActiveGaze-v0"


def true_error(look, drives):
    """Mean true error of the position at the end of unseen drives, m; all drives run in lock-step."""
    vector = gym.make_vec(ID, num_envs=drives, arguments={"route": given.route})
    (observation, _), over = vector.reset(seed=1000), np.zeros(drives, dtype=bool)
    while not over.any():  # a scripted drive: all are over in the same step
        observation, _, over, _, info = vector.step(look(observation))
    vector.close()
    return np.sqrt(-info["reward_error"]).mean()


parser = argparse.ArgumentParser()
parser.add_argument("--decisions", type=int, default=30_000)
parser.add_argument("--drives", type=int, default=64)
parser.add_argument("--route", default="straight")
given = parser.parse_args()
torch.set_num_threads(1)  # so small a network is slower on several
envs = SB3VecEnv(gym.make_vec(ID, num_envs=16, autoreset_mode="SameStep", arguments={"route": given.route}))
envs = VecNormalize(envs, norm_obs=False, gamma=0.95)  # rewards of one size
model = PPO("MultiInputPolicy", envs, 5e-4, max(min(128, given.decisions // 16), 2), 256, gamma=0.95, seed=0)
while model.num_timesteps < given.decisions:
    model.learn(max(given.decisions // 10, 1), reset_num_timesteps=False)
    print(f"{model.num_timesteps:>7} decisions, entropy {-model.logger.name_to_value['train/entropy_loss']:.2f}")
looks = {"fixed": lambda _: np.full(given.drives, 4), "ppo": lambda o: model.predict(o, deterministic=True)[0]}
for name, look in looks.items():
    print(f"{name:<5} gaze: {true_error(look, given.drives):.3f} m")
