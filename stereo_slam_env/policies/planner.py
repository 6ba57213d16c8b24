"""What planning policies share: what they may know, the directions to choose from, and what a direction is worth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np

from filters.interface import StereoFilter
from filters.validation import FloatArray, positive
from stereo_slam_env.policies.expected_gain import GAINS, Gain, expected_gain, motion_noise
from stereo_slam_env.policies.foresight import CameraPoses, Eyes, Knowledge
from stereo_slam_env.policies.imagined_drive import planned_bodies, seen_from
from stereo_slam_env.policies.interface import require_head
from stereo_slam_env.policies.unseen_places import UnseenPlaces
from stereo_slam_env.recording.recording import Pose
from stereo_slam_env.sensing.sensors import TrackingPolicy
from stereo_slam_env.world.routes import FRAME_PERIOD, Route
from stereo_slam_env.world.vehicle import Head

_THERE = 1e-3
"""rad: nearer than this the head is where it was turned to."""


class Outlook:
    """What a planner may know of an environment: the filter's belief, the sensors, the head and the route.

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
        self.eyes = Eyes(
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
        """Whether the head has got to pan and tilt `target` (2,), rad."""
        return bool(np.abs(self.angles - target).max() < _THERE)

    @property
    def pose(self) -> Pose:
        """Where the left camera is believed to be."""
        belief = self.slam.pose
        return Pose(belief.position, belief.orientation)

    def bodies(self, step: int, steps: int) -> CameraPoses:
        """Where the camera would be in the next steps, after `step`, if it looked straight ahead."""
        return planned_bodies(self.head.body_pose(self.pose, self.angles), self.route, step, steps)

    def drift(self, positions: FloatArray) -> FloatArray:
        """Noise of the odometry in the steps that end at `positions` (K, 3), see `motion_noise`."""
        ends = positions - self.pose.position
        starts = np.concatenate([np.zeros((1, 3)), ends[:-1]])
        return motion_noise(0.5 * (starts + ends), *self._sigmas)


@dataclass(frozen=True)
class Preferences:
    """What a planner chooses among, and by what.

    Attributes
    ----------
    gain : {"pose", "map"}
        What is to be known well: the pose, or the pose and the map.
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
        if self.gain not in GAINS:
            raise ValueError(f"gain must be one of {', '.join(map(repr, GAINS))}, got {self.gain!r}")
        for name in ("pans", "tilts"):
            checked_count(name, getattr(self, name))
        for name in ("curiosity", "effort"):
            positive(name, getattr(self, name), allow_zero=True)


class Planner:
    """Chooses among directions that the head could turn to, in one episode.

    The worth of a direction is the expected gain of the looks on the way, in nats; plus `curiosity` for every place
    beside the route that has never been in view and would be; less `effort` times the turn, in shares of the largest.

    Parameters
    ----------
    env : gymnasium.Env
        See `Outlook`.
    preferences : Preferences
        What is chosen among, and by what.
    """

    def __init__(self, env: gym.Env[Any, Any], preferences: Preferences) -> None:
        self.outlook = Outlook(env)
        self.targets = directions(self.outlook.head, preferences.pans, preferences.tilts)
        """The directions, (B, 2) rad."""
        self._preferences = preferences
        self._places = UnseenPlaces(self.outlook.route, self.outlook.eyes)
        self.step = -1
        """Steps driven so far."""

    def look(self) -> None:
        """Take notice of a new frame."""
        self.step += 1
        self._places.look(CameraPoses.at(self.outlook.pose))

    def best(self, angles: FloatArray) -> FloatArray:
        """The most worthwhile of `targets`, (2,) rad; `angles` as of `worth`, one row a target."""
        choice: FloatArray = self.targets[int(np.argmax(self.worth(self.targets, angles)))]
        return choice

    def worth(self, targets: FloatArray, angles: FloatArray) -> FloatArray:
        """What each of B directions is worth, (B,) nats.

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
        knowledge = Knowledge.of(outlook.slam, within=outlook.eyes.reach + float(away))
        looks = outlook.eyes.information(knowledge.points, cameras)
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


def checked_count(name: str, value: int) -> int:
    """`value`, if it is a whole number above 0; else a ValueError."""
    if isinstance(value, bool) or not isinstance(value, int) or value < 1:
        raise ValueError(f"{name} must be a whole number >= 1, got {value!r}")
    return value
