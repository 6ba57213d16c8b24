"""Policies that plan on the belief of a filter: `MostUncertain`, `Greedy`, `Lookahead`, and what they share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, get_args

import gymnasium as gym
import numpy as np

from filters.interface import StereoFilter
from filters.known_names import one_of
from filters.poses import Pose
from filters.validation import BoolArray, FloatArray, positive, whole_number
from stereo_slam_env.policies.expected_gain import Gain, expected_gain, motion_noise
from stereo_slam_env.policies.foresight import (
    CameraPoses,
    Knowledge,
    SensorModel,
    UnseenPlaces,
    planned_bodies,
    seen_from,
    turning_head,
)
from stereo_slam_env.policies.interface import Action, look_towards, require_head
from stereo_slam_env.sensing.sensors import TrackingPolicy
from stereo_slam_env.world.routes import FRAME_PERIOD, Route
from stereo_slam_env.world.vehicle import Head

_THERE = 1e-3
"""Distance at which the head has arrived at its target, rad."""


class Outlook:
    """The part of an environment that a planner may use: belief of the filter, sensor, head and route.

    Parameters
    ----------
    env : gymnasium.Env
        Reset, with a filter in the loop and a head that moves.

    Raises
    ------
    ValueError
        One of the two is missing.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        self._env = env
        self.head: Head = require_head(env)
        if not env.has_wrapper_attr("slam"):
            raise ValueError(
                "the policy plans on the belief of a filter and there is none: "
                "wrap the environment in stereo_slam_env.wrappers.BeliefObservation"
            )
        options = env.get_wrapper_attr("options")
        tracking: TrackingPolicy = options.tracking
        self.sensor = SensorModel(
            camera=env.get_wrapper_attr("camera"),
            noise=env.get_wrapper_attr("noise"),
            nearest=tracking.nearest,
            farthest=tracking.farthest,
            margin=tracking.margin,
            most=tracking.max_landmarks,
        )
        self.route: Route = env.get_wrapper_attr("route")
        self._sigmas = FRAME_PERIOD * options.odometry_sigma_linear, FRAME_PERIOD * options.odometry_sigma_angular

    @property
    def slam(self) -> StereoFilter:
        """The filter."""
        slam: StereoFilter = self._env.get_wrapper_attr("slam")
        return slam

    @property
    def angles(self) -> FloatArray:
        """Pan and tilt now, rad; (2,)."""
        angles: FloatArray = self._env.get_wrapper_attr("head_angles")
        return angles

    def is_turned_to(self, target: FloatArray) -> bool:
        """Whether the head has arrived at pan and tilt `target` (2,), rad."""
        return bool(np.abs(self.angles - target).max() < _THERE)

    @property
    def pose(self) -> Pose:
        """Estimated pose of the left camera."""
        belief = self.slam.pose
        return Pose(belief.position, belief.orientation)

    def bodies(self, step: int, steps: int) -> CameraPoses:
        """Poses of the camera in the next steps, after `step`, if it looks straight ahead."""
        return planned_bodies(self.head.body_pose(self.pose, self.angles), self.route, step, steps)

    def drift(self, positions: FloatArray) -> FloatArray:
        """Noise of the odometry in the steps that end at `positions` (K, 3), see `motion_noise`."""
        ends = positions - self.pose.position
        starts = np.concatenate([np.zeros((1, 3)), ends[:-1]])
        return motion_noise(0.5 * (starts + ends), *self._sigmas)


@dataclass(frozen=True)
class Preferences:
    """Directions that a planner chooses from, and weights of their worth.

    Attributes
    ----------
    gain : {"pose", "map"}
        Covariance that is to become small: of the pose, or of the pose and the map.
    pans, tilts : int
        Directions to choose from: a grid over all that the head can do.
    curiosity : float
        What it is worth to look at a place beside the route for the first time, nats.
    effort : float
        What it costs to turn by the largest pan or tilt, nats.

    Raises
    ------
    ValueError
        One of them is impossible.
    """

    gain: Gain
    pans: int
    tilts: int
    curiosity: float
    effort: float

    def __post_init__(self) -> None:
        one_of("gain", self.gain, get_args(Gain))
        for name in ("pans", "tilts"):
            whole_number(name, getattr(self, name), 1)
        for name in ("curiosity", "effort"):
            positive(name, getattr(self, name), allow_zero=True)


class Planner:
    """Choice among the directions that the head can turn to, in one episode.

    The worth of a direction is the expected gain of the looks on the way, in nats; plus `curiosity` for every place
    beside the route that has never been in view and would be; less `effort` times the turn, in shares of the largest.

    Parameters
    ----------
    env : gymnasium.Env
        See `Outlook`.
    preferences : Preferences
        Directions and weights.
    """

    def __init__(self, env: gym.Env[Any, Any], preferences: Preferences) -> None:
        self.outlook = Outlook(env)
        self.targets = directions(self.outlook.head, preferences.pans, preferences.tilts)
        """The directions, (B, 2) rad."""
        self._preferences = preferences
        self._places = UnseenPlaces(self.outlook.route, self.outlook.sensor)
        self.step = -1
        """Steps driven so far."""

    def look(self) -> None:
        """Use a new frame: places that are in view are no longer unseen."""
        self.step += 1
        self._places.look(CameraPoses.at(self.outlook.pose))

    def best(self, angles: FloatArray) -> FloatArray:
        """The most worthwhile of `targets`, (2,) rad; `angles` as of `worth`, one row a target."""
        choice: FloatArray = self.targets[int(np.argmax(self.worth(self.targets, angles)))]
        return choice

    def worth(self, targets: FloatArray, angles: FloatArray) -> FloatArray:
        """Worth of each of B directions, (B,) nats.

        Parameters
        ----------
        targets : (B, 2)
            Directions, rad.
        angles : (B, K, 2)
            Pan and tilt in the next K steps if the head turns there.
        """
        outlook, wanted = self.outlook, self._preferences
        bodies = outlook.bodies(self.step, angles.shape[1])
        cameras = seen_from(outlook.head, bodies, angles)
        away = np.linalg.norm(cameras.positions - outlook.pose.position, axis=-1).max()
        knowledge = Knowledge.of(outlook.slam, within=outlook.sensor.reach + float(away))
        looks = outlook.sensor.information(knowledge.points, cameras)
        gains = expected_gain(knowledge, looks, outlook.drift(bodies.positions), wanted.gain)
        turn = np.abs(targets - outlook.angles) / np.maximum(outlook.head.max_angles, np.finfo(float).tiny)
        worth: FloatArray = gains - wanted.effort * turn.sum(axis=1)
        worth += wanted.curiosity * self._places.discovered(cameras)
        return worth


def directions(head: Head, pans: int, tilts: int) -> FloatArray:
    """A grid of pan and tilt over all that the head can do, (pans * tilts, 2) rad; odd numbers have 0 among them."""
    axes = [np.linspace(-1.0, 1.0, n) if n > 1 else np.zeros(1) for n in (pans, tilts)]
    shares = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    grid: FloatArray = shares * np.array(head.max_angles)
    return grid


class MostUncertain:
    """Look at the landmark of the map with the largest uncertainty relative to the camera, within reach of the head.

    Its uncertainty is the trace of the covariance of its position relative to the camera. A landmark that has been
    looked at in vain, something stands in between, is not looked at again for a while.

    Parameters
    ----------
    patience : int
        How many steps to look at one.
    """

    def __init__(self, patience: int = 10) -> None:
        self._patience = whole_number("patience", patience, 1)

    def reset(self, env: gym.Env[Any, Any], rng: np.random.Generator) -> None:
        """See `Policy.reset`."""
        self._env, self._outlook, self._step = env, Outlook(env), 0
        self._target = np.zeros(2)
        self._wanted = -1
        self._in_vain = np.zeros(0, dtype=np.int64)

    def act(self, observation: Mapping[str, Any]) -> Action:
        """See `Policy.act`."""
        outlook = self._outlook
        knowledge = Knowledge.of(outlook.slam, within=outlook.sensor.reach)
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
        head, sensor = self._outlook.head, self._outlook.sensor
        bearings = self._bearings(knowledge)
        distance = np.linalg.norm(knowledge.points - knowledge.pose.position, axis=1)
        can: BoolArray = (distance >= sensor.nearest) & (distance <= sensor.farthest)
        can &= (np.abs(bearings) <= head.max_angles).all(axis=1)
        return can

    def _bearings(self, knowledge: Knowledge) -> FloatArray:
        """Pan and tilt that look at each landmark, (N, 2) rad."""
        body = CameraPoses.at(self._outlook.head.body_pose(knowledge.pose, self._outlook.angles))
        x, y, z = body.to_camera(knowledge.points).T
        return np.stack([np.arctan2(x, z), np.arctan2(-y, np.hypot(x, z))], axis=1)


class Greedy:
    """Turn to the direction in which one look has the largest expected gain; arrive, then choose again.

    Choosing again on the way would leave the head between two groups that are worth about the same.

    Parameters
    ----------
    gain, pans, tilts, curiosity, effort
        See `Preferences`.
    """

    def __init__(
        self, gain: Gain = "map", pans: int = 17, tilts: int = 1, curiosity: float = 0.15, effort: float = 0.05
    ) -> None:
        self._preferences = Preferences(gain, pans, tilts, curiosity, effort)

    def reset(self, env: gym.Env[Any, Any], rng: np.random.Generator) -> None:
        """See `Policy.reset`."""
        self._env, self._planner = env, Planner(env, self._preferences)
        self._target = self._planner.outlook.angles

    def act(self, observation: Mapping[str, Any]) -> Action:
        """See `Policy.act`."""
        planner = self._planner
        planner.look()
        if planner.outlook.is_turned_to(self._target):
            self._target = planner.best(planner.targets[:, None])
        return look_towards(self._env, self._target)


class Lookahead:
    """Turn to the direction with the largest expected gain of all looks in the next steps of the planned drive.

    The head arrives before the next decision, see `Greedy`; it turns as fast as it can.

    Parameters
    ----------
    steps : int
        How far to look ahead, in steps of 0.1 s.
    replan : int
        Fewest steps between two decisions.
    gain, pans, tilts, curiosity, effort
        See `Preferences`.
    """

    def __init__(
        self,
        steps: int = 16,
        replan: int = 4,
        gain: Gain = "pose",
        pans: int = 33,
        tilts: int = 1,
        curiosity: float = 0.15,
        effort: float = 0.05,
    ) -> None:
        self._steps, self._replan = whole_number("steps", steps, 1), whole_number("replan", replan, 1)
        self._preferences = Preferences(gain, pans, tilts, curiosity, effort)

    def reset(self, env: gym.Env[Any, Any], rng: np.random.Generator) -> None:
        """See `Policy.reset`."""
        self._env, self._planner = env, Planner(env, self._preferences)
        self._target, self._decided = self._planner.outlook.angles, -self._replan

    def act(self, observation: Mapping[str, Any]) -> Action:
        """See `Policy.act`."""
        planner = self._planner
        planner.look()
        outlook = planner.outlook
        if planner.step >= self._decided + self._replan and outlook.is_turned_to(self._target):
            angles = turning_head(outlook.head, outlook.angles, planner.targets, self._steps)
            self._target, self._decided = planner.best(angles), planner.step
        return look_towards(self._env, self._target)
