"""Policies that plan on the belief of a filter: `MostUncertain`, `Greedy`, `Lookahead`, and what they share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, get_args

import gymnasium as gym
import numpy as np

from filters.contract.known_names import one_of
from filters.contract.stereo_filter import StereoFilter
from filters.contract.validation import positive, whole_number
from filters.geometry.arrays import FloatArray
from filters.geometry.poses import Pose
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
from stereo_slam_env.sensing.tracking import TrackingPolicy
from stereo_slam_env.world.routes import FRAME_PERIOD, Route
from stereo_slam_env.world.vehicle import Head
from stereo_slam_env.wrappers import Belief

_THERE = 1e-3
"""Distance at which the head has arrived at its target, rad."""


class Outlook:
    """The part of an environment that a planner may use: belief of the filter, sensor, head and route.

    A `ValueError` where there is no filter in the loop, or no head that moves.
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
        self.slam: StereoFilter = env.get_wrapper_attr("slam")
        self.route: Route = env.get_wrapper_attr("route")
        self.odometry_sigmas = (
            FRAME_PERIOD * options.odometry_sigma_linear,
            FRAME_PERIOD * options.odometry_sigma_angular,
        )

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


@dataclass(frozen=True)
class Preferences:
    """Directions that a planner chooses from, and weights of their worth.

    Raises
    ------
    ValueError
        One of them is impossible.
    """

    gain: Gain
    """Covariance that is to become small: "pose", or "map" for pose and map together."""
    pans: int
    """Directions to choose from, over all that the head can pan."""
    tilts: int
    """Directions to choose from, over all that the head can tilt; with `pans` they form a grid."""
    curiosity: float
    """What it is worth to look at a place beside the route for the first time, nats."""
    effort: float
    """What it costs to turn by the largest pan or tilt, nats."""

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
        """Worth of each of B directions `targets` (B, 2), rad; (B,) nats.

        `angles` (B, K, 2) are pan and tilt in the next K steps if the head turns there, rad.
        """
        outlook, wanted = self.outlook, self._preferences
        body = outlook.head.body_pose(outlook.pose, outlook.angles)
        bodies = planned_bodies(body, outlook.route, self.step, angles.shape[1])
        cameras = seen_from(outlook.head, bodies, angles)
        away = np.linalg.norm(cameras.positions - outlook.pose.position, axis=-1).max()
        knowledge = Knowledge.of(outlook.slam, within=outlook.sensor.reach + float(away))
        looks = outlook.sensor.information(knowledge.points, cameras)
        ends = bodies.positions - outlook.pose.position
        middles = 0.5 * (np.concatenate([np.zeros((1, 3)), ends[:-1]]) + ends)
        gains = expected_gain(knowledge, looks, motion_noise(middles, *outlook.odometry_sigmas), wanted.gain)
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
        belief: Belief = self._env.get_wrapper_attr("belief")
        body = outlook.head.body_pose(outlook.pose, outlook.angles)
        x, y, z = body.to_camera(belief.points_w).T
        bearings = np.stack([np.arctan2(x, z), np.arctan2(-y, np.hypot(x, z))], axis=1)
        distance = np.linalg.norm(belief.points_c, axis=1)
        if self._step % self._patience == 0:
            if self._wanted >= 0 and self._wanted not in observation["ids"]:
                self._in_vain = np.append(self._in_vain, self._wanted)[-self._patience :]
            # In the middle of the image of a camera turned to it, and not looked at in vain.
            can = (distance >= outlook.sensor.nearest) & (distance <= outlook.sensor.farthest)
            can &= (np.abs(bearings) <= outlook.head.max_angles).all(axis=1) & ~np.isin(belief.ids, self._in_vain)
            uncertainty = np.where(can, np.trace(belief.relative_covariances, axis1=1, axis2=2), -np.inf)
            self._wanted = int(belief.ids[uncertainty.argmax()]) if can.any() else -1
        self._step += 1
        wanted = (belief.ids == self._wanted) & (distance <= outlook.sensor.reach)
        if wanted.any():
            self._target = bearings[wanted][0]
        return look_towards(self._env, self._target)


class _Planning:
    """Turn to the most worthwhile direction, arrive, then choose again after `replan` steps at the earliest.

    Choosing again on the way would leave the head between two groups that are worth about the same. The looks that
    count are those of the next `steps` steps of turning there; None: one look from there.
    """

    def __init__(self, preferences: Preferences, replan: int = 1, steps: int | None = None) -> None:
        self._preferences, self._replan, self._steps = preferences, replan, steps

    def reset(self, env: gym.Env[Any, Any], rng: np.random.Generator) -> None:
        """See `Policy.reset`."""
        self._env, self._planner = env, Planner(env, self._preferences)
        self._target, self._decided = self._planner.outlook.angles, -self._replan

    def act(self, observation: Mapping[str, Any]) -> Action:
        """See `Policy.act`."""
        planner, outlook = self._planner, self._planner.outlook
        planner.look()
        if planner.step >= self._decided + self._replan and outlook.is_turned_to(self._target):
            angles = planner.targets[:, None]
            if self._steps is not None:
                angles = turning_head(outlook.head, outlook.angles, planner.targets, self._steps)
            self._target, self._decided = planner.best(angles), planner.step
        return look_towards(self._env, self._target)


class Greedy(_Planning):
    """Turn to the direction in which one look has the largest expected gain; arrive, then choose again.

    Parameters
    ----------
    gain, pans, tilts, curiosity, effort
        See `Preferences`.
    """

    def __init__(
        self, gain: Gain = "map", pans: int = 17, tilts: int = 1, curiosity: float = 0.15, effort: float = 0.05
    ) -> None:
        super().__init__(Preferences(gain, pans, tilts, curiosity, effort))


class Lookahead(_Planning):
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
        preferences = Preferences(gain, pans, tilts, curiosity, effort)
        super().__init__(preferences, whole_number("replan", replan, 1), whole_number("steps", steps, 1))
