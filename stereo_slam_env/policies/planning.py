"""Policies that plan on the belief of a filter: `MostUncertain`, `Greedy`, `Lookahead`, and what they share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, get_args

import gymnasium as gym
import numpy as np

from filters.contract.stereo_filter import StereoFilter
from filters.contract.validation import one_of, positive, whole_number
from filters.geometry.arrays import FloatArray
from filters.geometry.poses import Pose
from stereo_slam_env.envs import Belief
from stereo_slam_env.envs.filter_rows import FilterRows
from stereo_slam_env.policies.foresight import (
    CameraPoses,
    Gain,
    Knowledge,
    SensorModel,
    discovered,
    expected_gain,
    motion_noise,
    places_beside,
    planned_bodies,
    seen_from,
    straight_ahead,
    turning_head,
)
from stereo_slam_env.policies.named_policies import Action, look_towards, require_head
from stereo_slam_env.sensing.padding import TrackingPolicy
from stereo_slam_env.world.routes import FRAME_PERIOD, Route
from stereo_slam_env.world.vehicle import Head

_THERE = 1e-3
"""Distance at which the head has arrived at its target, rad."""


class Outlook:
    """The part of an environment that a planner may use: belief of the filter, sensor, head and route.

    A `ValueError` where there is no filter in the loop, or no head that moves.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        self._env = env
        self.head: Head = require_head(env)
        if not env.has_wrapper_attr("beliefs"):
            raise ValueError(
                "the policy plans on the belief of a filter and there is none: "
                "wrap the environment in stereo_slam_env.envs.BeliefObservation"
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
        self._slam: StereoFilter = env.get_wrapper_attr("slam")
        self._beliefs: FilterRows = env.get_wrapper_attr("beliefs")
        self._row = int(env.get_wrapper_attr("row")) if env.has_wrapper_attr("row") else 0
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
        pose = self._beliefs.poses[self._row]
        return Pose(pose[:3], pose[3:])

    def knowledge(self, within: float = np.inf) -> Knowledge:
        """The current belief, with the landmarks `within` m of the camera that have a finite position."""
        pose, maps = self.pose, self._beliefs.maps
        mine = slice(*maps.offsets[self._row : self._row + 2])
        near = maps.located[mine] & (np.linalg.norm(maps.points_c[mine], axis=1) <= within)
        return Knowledge.of(self._slam, pose, maps.ids[mine][near], pose @ maps.points_c[mine][near])


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
        self.preferences = preferences
        self.unseen = places_beside(self.outlook.route, self.outlook.sensor.farthest)
        """Places beside the route that have not been in view so far, in W, m; (P, 3)."""
        self.step = -1
        """Steps driven so far."""

    def look(self) -> None:
        """Use a new frame: places that are in view are no longer unseen."""
        self.step += 1
        self.unseen = self.unseen[~self.outlook.sensor.in_view(self.unseen, CameraPoses.at(self.outlook.pose))]

    def best(self, angles: FloatArray) -> FloatArray:
        """The most worthwhile of `targets`, (2,) rad; `angles` as of `worth`, one row a target."""
        choice: FloatArray = self.targets[int(np.argmax(self.worth(self.targets, angles)))]
        return choice

    def worth(self, targets: FloatArray, angles: FloatArray) -> FloatArray:
        """Worth of each of B directions `targets` (B, 2), rad; (B,) nats.

        `angles` (B, K, 2) are pan and tilt in the next K steps if the head turns there, rad.
        """
        worth: FloatArray = worths([self], targets, angles[None])[0]
        return worth


def worths(planners: Sequence[Planner], targets: FloatArray, angles: FloatArray) -> FloatArray:
    """`Planner.worth` of B directions `targets` (B, 2), rad, in Q environments at once; (Q, B) nats.

    `angles` (Q, B, K, 2) are those of each. The environments have the same head and the same sensors, and their
    planners the same preferences.
    """
    outlooks, planners_left = [planner.outlook for planner in planners], planners[0].preferences
    head, sensor = outlooks[0].head, outlooks[0].sensor
    now = np.stack([outlook.angles for outlook in outlooks])
    turn = np.abs(targets - now[:, None]) / np.maximum(head.max_angles, np.finfo(float).tiny)
    worths: FloatArray = -planners_left.effort * turn.sum(axis=-1)

    eyes = CameraPoses.of([outlook.pose for outlook in outlooks])
    routes, done = [outlook.route for outlook in outlooks], [planner.step for planner in planners]
    bodies = planned_bodies(straight_ahead(head, eyes, now), routes, done, angles.shape[2])
    cameras = seen_from(head, bodies[:, None], angles)
    ends = bodies.positions - eyes.positions[:, None]
    middles = 0.5 * (np.concatenate([np.zeros((len(ends), 1, 3)), ends[:, :-1]], axis=1) + ends)
    Q = motion_noise(middles, *outlooks[0].odometry_sigmas)
    away = np.linalg.norm(cameras.positions - eyes.positions[:, None, None], axis=-1).max(axis=(1, 2))
    for q, planner in enumerate(planners):
        knowledge = outlooks[q].knowledge(within=sensor.reach + float(away[q]))
        looks = sensor.information(knowledge.points, cameras[q])
        worths[q] += expected_gain(knowledge, looks, Q[q], planners_left.gain)
        worths[q] += planners_left.curiosity * discovered(planner.unseen, sensor, cameras[q])
    return worths


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
        self._env, self._outlook, self._step = env, Outlook(env), 0
        self._target = np.zeros(2)
        self._wanted = -1
        self._in_vain = np.zeros(0, dtype=np.int64)

    def act(self, observation: Mapping[str, Any]) -> Action:
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
        is_wanted = (belief.ids == self._wanted) & (distance <= outlook.sensor.reach)
        if is_wanted.any():
            self._target = bearings[is_wanted][0]
        return look_towards(self._env, self._target)


class _Planning:
    """Turn to the most worthwhile direction, arrive, then choose again after `replan` steps at the earliest.

    Choosing again on the way would leave the head between two groups that are worth about the same. The looks that
    count are those of the next `steps` steps of turning there; None: one look from there.
    """

    def __init__(self, preferences: Preferences, replan: int = 1, steps: int | None = None) -> None:
        self._preferences, self._replan, self._steps = preferences, replan, steps

    def reset(self, env: gym.Env[Any, Any], rng: np.random.Generator) -> None:
        self._env, self._planner = env, Planner(env, self._preferences)
        self._target, self._decided = self._planner.outlook.angles, -self._replan

    def act(self, observation: Mapping[str, Any]) -> Action:
        action: Action = self.act_together([self], [observation])[0]
        return action

    @staticmethod
    def act_together(policies: Sequence[_Planning], observations: Sequence[Mapping[str, Any]]) -> Action:
        deciding: dict[Any, list[_Planning]] = {}
        for policy in policies:
            policy._planner.look()
            if policy._may_decide:
                deciding.setdefault((policy._preferences, policy._steps), []).append(policy)
        for (_, steps), group in deciding.items():
            planners = [policy._planner for policy in group]
            targets, head = planners[0].targets, planners[0].outlook.head
            angles = np.broadcast_to(targets[:, None], (len(group), len(targets), 1, 2))
            if steps is not None:
                angles = turning_head(head, np.stack([one.outlook.angles for one in planners]), targets, steps)
            for policy, best in zip(group, worths(planners, targets, angles).argmax(axis=1), strict=True):
                policy._target, policy._decided = targets[best], policy._planner.step
        return look_towards(policies[0]._env, np.stack([policy._target for policy in policies]))

    @property
    def _may_decide(self) -> bool:
        planner = self._planner
        return planner.step >= self._decided + self._replan and planner.outlook.is_turned_to(self._target)


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
