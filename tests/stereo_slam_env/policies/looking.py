"""Environments with a filter in the loop, after a short drive with the head turning."""

from __future__ import annotations

import gymnasium as gym
import numpy as np

import stereo_slam_env  # noqa: F401
from stereo_slam_env.policies.foresight import Eyes
from stereo_slam_env.wrappers import BeliefObservation

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


def eyes_of(env, **options):
    return Eyes(env.get_wrapper_attr("camera"), env.get_wrapper_attr("noise"), **options)
