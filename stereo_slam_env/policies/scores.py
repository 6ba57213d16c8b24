"""Normalised scores of the tasks, and the driver that has 100 in those in which the agent drives."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import ArrayLike

from filters.contract.validation import require_known
from filters.geometry.arrays import FloatArray
from stereo_slam_env.policies.interface import Action
from stereo_slam_env.world.routes import FRAME_PERIOD
from stereo_slam_env.world.vehicle import Car

_STEER_BY, _BRAKE_BY = 1, 3
"""Points of the observation `route`: the one to steer to, and the farthest one to be slow enough for."""

_AT_RANDOM = {
    "StereoSlam/Drive-v0": -9.63,
    "StereoSlam/ActiveGaze-v0": -5.26,
    "StereoSlam/Explore-v0": 0.08,
    "StereoSlam/Revisit-v0": -0.77,
    "StereoSlam/ClosedLoop-v0": -10.1,
    "StereoSlam/Branches-v0": 13.2,
}
REFERENCE_RETURNS: Mapping[str, tuple[float, float]] = MappingProxyType(
    {name: (least, float(gym.spec(name).reward_threshold or 0.0)) for name, least in _AT_RANDOM.items()}
)
"""Mean returns of actions at random and of the best policy known (`reward_threshold`), by id, with default arguments;
measured by `python benchmarks/task_scores.py`. Of `ActiveGaze-v0` a fixed gaze in 500 drives, and the oracle by its
ratio to that in 16 of them (0.13); measured by `python benchmarks/active_policies.py`. Of `Branches-v0` five trained
networks in 200 scenes, which beat the rule (20.2); measured by `python benchmarks/trained_scores.py`."""


def normalised_score(environment: str, returns: ArrayLike) -> FloatArray:
    """Score of returns in an environment with its default arguments: 0 is random, 100 the best policy known.

    Parameters
    ----------
    environment : str
        A Gymnasium id of this package.
    returns : array_like
        Sums of the rewards of whole episodes, of any shape.

    Raises
    ------
    ValueError
        There is no score for that id.
    """
    require_known("there is no score for", [environment], REFERENCE_RETURNS)
    random, best = REFERENCE_RETURNS[environment]
    return 100.0 * (np.asarray(returns, dtype=np.float64) - random) / (best - random)


def follow_route(
    observation: Mapping[str, Any],
    actions: int = 2,
    *,
    speed: float | FloatArray = Car.max_speed,
    lateral: float = 3.0,
    beside: float = 0.0,
) -> Action:
    """Action that drives along the route that the observation shows (pure pursuit); the head looks straight ahead.

    Steers along the circle through the rear axle and the point 5 m ahead, and keeps slow enough for the circles to all
    points up to 20 m ahead.

    Parameters
    ----------
    observation : mapping
        With `car` (..., 2) and `route` (..., 5, 2), from environments in which the agent drives.
    actions : int
        Entries of the action; those after the first two are 0.
    speed : float or (...)
        Largest one, m/s.
    lateral : float
        Largest acceleration across the direction of travel, m/s^2.
    beside : float
        How far to the right of the route to drive, m.
    """
    car = Car()
    now = np.asarray(observation["car"], dtype=np.float64)[..., 0]
    right, forward = np.moveaxis(np.asarray(observation["route"], dtype=np.float64), -1, 0)
    right, forward = right + beside, forward + car.camera_forward
    curvatures = 2.0 * right / np.maximum(right**2 + forward**2, 1.0)
    bend = np.abs(curvatures[..., _STEER_BY : _BRAKE_BY + 1]).max(axis=-1)
    wanted = np.minimum(speed, np.sqrt(lateral / np.maximum(bend, 1e-6)))
    action = np.zeros((*now.shape, actions), dtype=np.float32)
    action[..., 0] = np.clip((wanted - now) / (car.max_acceleration * FRAME_PERIOD), -1.0, 1.0)
    action[..., 1] = np.clip(np.arctan(car.wheelbase * curvatures[..., _STEER_BY]) / car.max_steering, -1.0, 1.0)
    return action
