"""An environment that replays a recording: all that the wrappers ask of one, without physics."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from stereo_slam_env.envs.arguments import StereoOptions
from stereo_slam_env.recording.recording import LandmarkTruth, Recording
from stereo_slam_env.sensing.padding import padded

from ..benchmark.small_recordings import small_recording

ROWS = 45


class ReplayEnv(gym.Env):
    """Frames of a recording, whatever the action; reward 1 a step; `head` is in the observation where it is given."""

    def __init__(self, recording: Recording | None = None, head=None) -> None:
        self.recording = small_recording(frames=25) if recording is None else recording
        self.head = head
        self.options = StereoOptions()
        self.camera, self.noise, self.start = self.recording.camera, self.recording.noise, self.recording.start
        low, high = np.full((ROWS, 3), -100.0), np.full((ROWS, 3), 2000.0)
        shapes = {
            "uvd": spaces.Box(low.astype(np.float32), high.astype(np.float32)),
            "ids": spaces.Box(-1, np.iinfo(np.int32).max, (ROWS,), np.int64),
            "mask": spaces.Box(0, 1, (ROWS,), np.int8),
            "odometry": spaces.Box(-50.0, 50.0, (6,), np.float32),
        }
        if head is not None:
            shapes["head"] = spaces.Box(-3.0, 3.0, (2,), np.float32)
        self.observation_space = spaces.Dict(shapes)
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.number = 0

    @property
    def frame(self):
        return self.recording.frames[self.number]

    def landmark_truth(self) -> LandmarkTruth:
        return self.recording.landmarks

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.number = 0
        return self._observation(), {"time": 0.0}

    def step(self, action):
        self.number += 1
        over = self.number == len(self.recording) - 1
        return self._observation(), 1.0, over, False, {"time": self.frame.timestamp}

    def _observation(self):
        observation = padded(self.frame.observation, ROWS)
        observation["odometry"] = np.zeros(6, dtype=np.float32)
        if self.head is not None:
            observation["head"] = np.array(self.head, dtype=np.float32)
        return observation


def episode(env, steps=None):
    """Observations, rewards and infos of an episode, those of reset first (its reward is None)."""
    observation, info = env.reset(seed=0)
    results = [(observation, None, info)]
    over = False
    while not over and (steps is None or len(results) <= steps):
        observation, reward, terminated, truncated, info = env.step(np.zeros(2, dtype=np.float32))
        results.append((observation, reward, info))
        over = terminated or truncated
    return tuple(zip(*results, strict=True))


def assert_the_second_rests(rows, actions):
    """Of two rows the first goes on, and earns something; the other earns nothing and stays as it is."""
    before = rows.observe()
    rewards, terminated, truncated = rows.step(actions, np.array([True, False]))
    assert rewards[0] != 0.0
    assert (rewards[1], terminated[1], truncated[1]) == (0.0, False, False)
    for old, new in zip(before, rows.observe(), strict=True):
        for key, values in old.items():
            np.testing.assert_array_equal(new[key][1], values[1], err_msg=key)
