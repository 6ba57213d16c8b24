"""`StereoSlam/Follow-v0`: keep a safe distance behind a bus that stops and goes, by what a filter believes of it."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from filters.contract.validation import positive
from filters.geometry.arrays import BoolArray, FloatArray
from stereo_slam_env.envs.closed_loop import follow_route
from stereo_slam_env.envs.observe_bodies import MASK, POSITION, SIGMAS, VELOCITY, ObserveBodies
from stereo_slam_env.envs.row_wrapper import PaidRows
from stereo_slam_env.envs.rows import Arrays, Seeds, Step
from stereo_slam_env.envs.task_env import TaskEnv
from stereo_slam_env.world.routes import FRAME_PERIOD
from stereo_slam_env.world.traffic import BUS_LENGTH
from stereo_slam_env.world.vehicle import Car

HEADWAY, STANDSTILL = 1.5, 4.0
"""Gap to keep: so many seconds of the car's own speed, and m."""
BUMPER = 0.5 * Car.size[0] + Car.body_c[2]
"""From the camera to the front of the car, m."""
_BY_GAP, _BY_SPEED, _UNSEEN = 0.5, 1.2, -0.3
"""Gains of `follow_bus`, 1/s^2 and 1/s; its acceleration where no body is believed in, m/s^2."""


class FollowLeader(PaidRows):
    """Pays for a safe gap to the bus ahead; the action is the acceleration alone, `follow_route` steers.

    The gap g is from bumper to bumper in a straight line, w = `standstill` + `headway` x speed the one to keep. Each
    second pays `gap_weight` x (1 - |g - w| / w), or nothing where that is negative. `info` gains `gap` (m; 0 where
    there is no bus) and `reward_gap`; `is_success` is whether that mean is at least 0.5 so far, without a failure.

    Parameters
    ----------
    env : gymnasium.Env
        In which the agent drives and there is a bus with landmarks.
    headway : float
        s.
    standstill : float
        m.
    gap_weight : float
        Of the reward.
    """

    def __init__(
        self, env: Any, headway: float = HEADWAY, standstill: float = STANDSTILL, gap_weight: float = 1.0
    ) -> None:
        super().__init__(env, ["gap"])
        options = self.needed("options")
        if options.bus is None or not options.moving_landmarks:
            raise ValueError("FollowLeader needs a bus that is seen: give bus='stops-and-goes' and moving_landmarks=40")
        self._headway, self._standstill = (
            positive("headway", headway, allow_zero=True),
            positive("standstill", standstill),
        )
        self._weight = positive("gap_weight", gap_weight)
        self.action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)
        self._gaps, self._kept, self._steps = np.zeros((3, self.num_envs))

    def reset(self, chosen: BoolArray, seeds: Seeds, options: Mapping[str, Any]) -> None:
        super().reset(chosen, seeds, options)
        self._kept[chosen], self._steps[chosen], self._gaps[chosen] = 0.0, 0.0, self._measure()[chosen]

    def step(self, actions: Any, going: BoolArray) -> Step:
        """Steer along the route, slowly enough for its bends, and pay for the gap."""
        driven = follow_route({key: self.world.shown(key) for key in ("car", "route")})
        driven[:, 0] = np.minimum(driven[:, 0], actions[:, 0])
        rewards, terminated, truncated = self.rows.step(driven, going)
        self._gaps[going] = self._measure()[going]
        target = self._standstill + self._headway * self.world.shown("car")[:, 0]
        share = np.where(self._gaps > 0.0, np.maximum(1.0 - np.abs(self._gaps - target) / target, 0.0), 0.0)
        self._kept, self._steps = self._kept + np.where(going, share, 0.0), self._steps + going
        return rewards + self.paid(going, {"gap": self._weight * FRAME_PERIOD * share}), terminated, truncated

    def observe(self) -> tuple[Arrays, Arrays]:
        observation, info = super().observe()
        success = (self._kept >= 0.5 * np.maximum(self._steps, 1.0)) & ~np.asarray(info["failed"])
        return observation, {**info, "gap": self._gaps.copy(), "is_success": success}

    def _measure(self) -> FloatArray:
        """True gaps (B,), m; 0 where there is no bus, which is the first of the moving bodies."""
        bus = self.world.true_bodies()[:, 0]
        away = np.hypot(*(bus[:, 1:4] - self.world.true_positions())[:, [0, 2]].T)
        return np.where(bus[:, 0] > 0.0, np.maximum(away - 0.5 * BUS_LENGTH - BUMPER, 0.0), 0.0)


class Follow(TaskEnv):
    """Keep a safe distance behind a bus that stops and goes.

    ## Description

    A bus drives ahead in the same lane; it chooses its speeds itself, up to 8 m/s, and often stands. The car steers
    along its route, the agent accelerates and brakes. The filter `moving-bodies` has the bus in its state, and the
    agent sees what it believes: where the bus is, how fast it drives, and how well both are known. Street, sensors and
    truth are those of `StereoSlam/Drive-v0`, with 40 landmarks at most that stand and 40 on the bus; at the level hard
    10, so that the filter often has no bus in its state.

    ## Action Space

    `Box(-1, 1, (1,), float32)`: acceleration, -3 to 3 m/s^2. In bends the car brakes by itself.

    ## Observation Space

    `Dict`:

    | Key | Shape | Type | Meaning |
    |-----|-------|------|---------|
    | `bodies` | (4, 11) | float32 | moving bodies by the belief, the nearest first, see `ObserveBodies` |
    | `car` | (2,) | float32 | speed, m/s, and steering angle, rad, without error |

    ## Rewards

    Each term is in `info`: *reward_gap*, for each second 1 - |g - w| / w, not less than 0, where g is the true gap to
    the bus, from bumper to bumper, and w = 4 m + 1.5 s x speed; *reward_collision*, -10 for a collision, or for 2 m
    beside the route; *reward_jerk*, -0.05 for each second x (jerk / 10 m/s^3)^2. So nothing is earned by staying
    behind, and a collision costs the rest of the drive, too.

    ## Episode End

    - Termination: a collision, or 2 m beside the route (`failed`); the end of the route.
    - Truncation: after 200 steps. `is_success`: the mean of 1 - |g - w| / w is at least 0.5, without a failure.

    ## Arguments

    `headway` (1.5 s), `standstill` (4 m) and `gap_weight` (1) of the gap to keep; `most` (4), rows of `bodies`;
    `filter` (one with bodies in its state), `filter_options`, `level`, `keys`, `observation`, `arguments`, and those
    of `StereoSlam/Drive-v0`.

    ## Training

    `stereo-slam train --environment StereoSlam/Follow-v0 --validation 32`; no network has been trained yet. What
    careless drivers and the rule `follow_bus` score is on the page of the tasks.

    ## Version History

    * v0: first version.
    """

    world = "StereoSlam/Drive-v0"
    settings = MappingProxyType(
        {
            **{"route": "town", "bus": "stops-and-goes", "moving_landmarks": 40, "max_landmarks": 40, "slowest": 0.0},
            **dict.fromkeys(("progress_weight", "tracking_weight", "goal_weight", "time_weight"), 0.0),
        }
    )
    filter, filter_options = "moving-bodies", None
    parts = ((ObserveBodies, {"most": 4}), (FollowLeader, {}))
    keys = ("bodies", "car")

    @classmethod
    def at_level(cls, level: str) -> Mapping[str, Any]:
        return {**super().at_level(level), **({"moving_landmarks": 10} if level == "hard" else {})}


follow_vector = Follow.vector


def follow_bus(observation: Mapping[str, Any]) -> NDArray[np.float32]:
    """Acceleration that keeps the gap of `StereoSlam/Follow-v0` to the nearest body ahead, by the belief.

    It takes the gap for smaller by the standard deviation of the distance, and slows down gently where there is none.
    """
    bodies, speed = np.asarray(observation["bodies"], dtype=np.float64), float(observation["car"][0])
    ahead = bodies[(bodies[:, MASK] > 0.0) & (bodies[:, POSITION][:, 2] > 0.0)]
    if not len(ahead):
        return np.array([_UNSEEN / Car.max_acceleration], dtype=np.float32)
    gap = np.hypot(*ahead[0, POSITION][[0, 2]]) - BUMPER - ahead[0, SIGMAS][0]
    closing = speed - np.hypot(*ahead[0, VELOCITY][[0, 2]])
    acceleration = _BY_GAP * (gap - STANDSTILL - HEADWAY * speed) - _BY_SPEED * closing
    return np.array([np.clip(acceleration / Car.max_acceleration, -1.0, 1.0)], dtype=np.float32)
