"""`MostUncertain`: look at what is known worst."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np

from filters.validation import BoolArray, FloatArray
from stereo_slam_env.policies.foresight import CameraPoses, Knowledge
from stereo_slam_env.policies.interface import Action, look_towards
from stereo_slam_env.policies.planner import Outlook, checked_count


class MostUncertain:
    """Look at the landmark of the map that is known worst, as seen from the camera, of those the head can turn to.

    Its uncertainty is the trace of the covariance of its position relative to the camera. A landmark that has been
    looked at in vain, something stands in between, is not looked at again for a while.

    Parameters
    ----------
    patience : int
        How many steps to look at one.
    """

    def __init__(self, patience: int = 10) -> None:
        self._patience = checked_count("patience", patience)

    def reset(self, env: gym.Env[Any, Any], rng: np.random.Generator) -> None:
        """See `Policy.reset`."""
        self._env, self._outlook, self._step = env, Outlook(env), 0
        self._target = np.zeros(2)
        self._wanted = -1
        self._in_vain = np.zeros(0, dtype=np.int64)

    def act(self, observation: Mapping[str, Any]) -> Action:
        """See `Policy.act`."""
        outlook = self._outlook
        knowledge = Knowledge.of(outlook.slam, within=outlook.eyes.reach)
        if self._step % self._patience == 0:
            if self._wanted >= 0 and self._wanted not in observation["ids"]:
                self._in_vain = np.append(self._in_vain, self._wanted)[-self._patience :]
            self._wanted = self._worst_known(knowledge)
        self._step += 1
        wanted = knowledge.ids == self._wanted
        if wanted.any():
            self._target = self._bearings(knowledge)[wanted][0]
        return look_towards(self._env, self._target)

    def _worst_known(self, knowledge: Knowledge) -> int:
        """Id of the landmark to look at, -1 if there is none."""
        candidates = np.flatnonzero(self._can_be_seen(knowledge) & ~np.isin(knowledge.ids, self._in_vain))
        if len(candidates) == 0:
            return -1
        uncertainty = np.trace(knowledge.relative_covariances[candidates], axis1=1, axis2=2)
        return int(knowledge.ids[candidates[np.argmax(uncertainty)]])

    def _can_be_seen(self, knowledge: Knowledge) -> BoolArray:
        """Whether each landmark is in the middle of the image of a camera turned to it, (N,)."""
        head, eyes = self._outlook.head, self._outlook.eyes
        bearings = self._bearings(knowledge)
        distance = np.linalg.norm(knowledge.points - knowledge.pose.position, axis=1)
        can: BoolArray = (distance >= eyes.nearest) & (distance <= eyes.farthest)
        can &= (np.abs(bearings) <= head.max_angles).all(axis=1)
        return can

    def _bearings(self, knowledge: Knowledge) -> FloatArray:
        """Pan and tilt that look at each landmark, (N, 2) rad."""
        body = CameraPoses.at(self._outlook.head.body_pose(knowledge.pose, self._outlook.angles))
        x, y, z = body.to_camera(knowledge.points).T
        return np.stack([np.arctan2(x, z), np.arctan2(-y, np.hypot(x, z))], axis=1)
