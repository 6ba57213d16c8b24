"""`Greedy`: the direction from which one look is expected to tell most."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np

from stereo_slam_env.policies.expected_gain import expected_gain, motion_noise
from stereo_slam_env.policies.imagined_drive import planned_bodies, seen_from, turning_head
from stereo_slam_env.policies.interface import Action, look_towards
from stereo_slam_env.policies.planner import Observer, directions, turning_share
from stereo_slam_env.world.routes import FRAME_PERIOD
from filters.validation import FloatArray


class Greedy:
    def __init__(self, gain="pose", pans=17, tilts=1, effort=0.02, at_once=True, replan=1):
        self._gain, self._pans, self._tilts, self._effort, self._at_once, self._replan = gain, pans, tilts, effort, at_once, replan

    def reset(self, env, rng):
        self._env, self._observer, self._step = env, Observer(env), 0
        self._targets = directions(self._observer.head, self._pans, self._tilts)

    def act(self, observation):
        o = self._observer
        if self._step % self._replan == 0:
            knowledge = o.knowledge()
            bodies = planned_bodies(o.body(knowledge.pose), o.route, self._step, 1)
            targets = self._targets
            angles = targets[:, None] if self._at_once else turning_head(o.head, o.angles, targets, 1)
            cameras = seen_from(o.head, bodies, angles)
            looks = o.eyes.information(knowledge.points, cameras)
            Q = motion_noise(bodies.positions - knowledge.pose.position, *(s * FRAME_PERIOD for s in o.odometry_sigmas))
            value = expected_gain(knowledge, looks, Q, self._gain) - self._effort * turning_share(o.head, o.angles, targets)
            self._target = targets[np.argmax(value)]
        self._step += 1
        return look_towards(self._env, self._target)


class Lookahead:
    def __init__(self, steps=8, replan=4, gain="pose", pans=17, tilts=1, effort=0.02):
        self._gain, self._pans, self._tilts, self._effort, self._steps, self._replan = gain, pans, tilts, effort, steps, replan

    def reset(self, env, rng):
        self._env, self._observer, self._step = env, Observer(env), 0
        self._targets = directions(self._observer.head, self._pans, self._tilts)

    def act(self, observation):
        o = self._observer
        if self._step % self._replan == 0:
            ahead = float(np.max(o.route.speeds)) * FRAME_PERIOD * self._steps
            knowledge = o.knowledge(ahead)
            bodies = planned_bodies(o.body(knowledge.pose), o.route, self._step, self._steps)
            targets = self._targets
            angles = turning_head(o.head, o.angles, targets, self._steps)
            cameras = seen_from(o.head, bodies, angles)
            looks = o.eyes.information(knowledge.points, cameras)
            Q = motion_noise(bodies.positions - knowledge.pose.position, *(s * FRAME_PERIOD for s in o.odometry_sigmas))
            value = expected_gain(knowledge, looks, Q, self._gain) - self._effort * turning_share(o.head, o.angles, targets)
            self._target = targets[np.argmax(value)]
        self._step += 1
        return look_towards(self._env, self._target)
