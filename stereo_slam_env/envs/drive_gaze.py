"""`StereoSlam/DriveGaze-v0`: the agent drives the car and decides where its stereo camera looks."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from stereo_slam_env.envs.arguments import DriveGazeOptions
from stereo_slam_env.envs.stereo_env import Observation, StereoEnv


class StereoDriveGazeEnv(StereoEnv, gym.Env[Observation, NDArray[np.float32]]):
    """The agent drives a car with a stereo camera, and pans and tilts the head that carries the cameras.

    ## Description

    Both tasks at once: `StereoSlam/Drive-v0`, to come to the end of the route, and `StereoSlam/Gaze-v0`, to look where
    most is to be learnt on the way. How fast and on which side of the lane to drive is part of what can be seen.

    Scene, sensors and truth are those of `StereoSlam/Drive-v0`; head, camera and what filters need are those of
    `StereoSlam/Gaze-v0`.

    ## Action Space

    `Box(-1, 1, (4,), float32)`. With `policy="route"` the first two are not used.

    | Num | Action | Min | Max | Unit at the limits |
    |-----|--------|-----|-----|--------------------|
    | 0 | acceleration | -1 | 1 | -3 to 3 m/s^2 (speed stays within 0 to 12 m/s) |
    | 1 | steering angle of the front wheels, positive to the right | -1 | 1 | -0.55 to 0.55 rad, at most 1 rad/s |
    | 2 | pan of the head, positive to the right | -1 | 1 | -`max_pan` to `max_pan` (2 rad), at most `pan_rate` |
    | 3 | tilt of the head, positive upwards | -1 | 1 | -`max_tilt` to `max_tilt` (0.4 rad), at most `tilt_rate` |

    ## Observation Space

    That of `StereoSlam/Drive-v0`, and:

    | Key | Shape | Type | Meaning |
    |-----|-------|------|---------|
    | `head` | (2,) | float32 | pan and tilt now, rad, without error |

    The odometry is that of the camera, not of the car: it contains the turning of the head.

    ## Info

    That of `StereoSlam/Drive-v0`.

    ## Rewards

    *reward = reward_progress + reward_tracking + reward_collision + reward_goal + reward_time + reward_jerk +
    reward_effort*, each in `info`: those of `StereoSlam/Drive-v0`, and

    - *reward_effort*: -`effort_weight` x the mean square of the turns of pan and tilt, as a share of the largest.

    ## Starting State

    That of `StereoSlam/Drive-v0`, the head straight ahead.

    ## Episode End

    That of `StereoSlam/Drive-v0`.

    ## Arguments

    Those of `StereoSlam/Drive-v0`, but for:

    | Argument | Default | Meaning |
    |----------|---------|---------|
    | `surroundings` | `"groves"` | groups of things on either side |
    | `visibility` | `30.0` | fog, m |
    | `rig` | `"vga"` | 640x480, f = 460 px |
    | `max_landmarks` | `24` | most landmarks in one frame |
    | `revisit` | `True` | a lost landmark can be tracked again under its id |
    | `effort_weight` | `0.01` | of the reward, for turning the head as fast as it can |
    | `max_pan` | `2.0` | how far the head turns to either side, rad |
    | `max_tilt` | `0.4` | how far it turns up and down, rad |
    | `pan_rate` | `1.5` | how fast it turns sideways, rad/s |
    | `tilt_rate` | `1.0` | how fast it turns up and down, rad/s |

    ## Version History

    * v0: first version.
    """

    Options = DriveGazeOptions
