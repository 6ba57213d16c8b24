"""`StereoSlam/Gaze-v0`: a car follows its route, the agent decides where its stereo camera looks."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from stereo_slam_env.envs.arguments import GazeOptions
from stereo_slam_env.envs.stereo_env import Observation, StereoEnv


class StereoGazeEnv(StereoEnv, gym.Env[Observation, NDArray[np.float32]]):
    """A car with a stereo camera follows its route; the agent pans and tilts the head that carries the cameras.

    ## Description

    Active perception: where to look, so that the estimate of the motion becomes as good as it can. A car drives
    through open country in fog; small groups of things stand on either side of its way, with nothing in between.
    A camera that looks straight ahead sees each group from far away and loses it when it comes near, where it would
    tell most. The car follows its route whatever the agent does; the agent turns the head, as fast as it can turn.
    A landmark that comes back into view is known again (`revisit`), so that it also pays to look back.

    The environment knows no filter. `BeliefObservation` puts the belief of any filter into the observation, and
    `InformationGain` pays for what the filter learns, see `stereo_slam_env.wrappers`. Filters need the odometry: the
    head turns faster than a motion model without it would believe.

    Scene, sensors and truth are those of `StereoSlam/Drive-v0`. The pose is that of the left camera, in the frame W:
    the left camera at reset, looking straight ahead (x right, y down, z forward). The head turns it by
    R_wc = R_wb R_y(pan) R_x(tilt) about the middle between the cameras. The true motion obeys Eq. 6 exactly.

    ## Action Space

    `Box(-1, 1, (2,), float32)`: where to look. The head turns there as fast as it can.

    | Num | Action | Min | Max | Unit at the limits |
    |-----|--------|-----|-----|--------------------|
    | 0 | pan of the head, positive to the right | -1 | 1 | -`max_pan` to `max_pan` (2 rad), at most `pan_rate` |
    | 1 | tilt of the head, positive upwards | -1 | 1 | -`max_tilt` to `max_tilt` (0.4 rad), at most `tilt_rate` |

    ## Observation Space

    That of `StereoSlam/Drive-v0` without `car` and `route`, and:

    | Key | Shape | Type | Meaning |
    |-----|-------|------|---------|
    | `head` | (2,) | float32 | pan and tilt now, rad, without error |

    The odometry is that of the camera, not of the car: it contains the turning of the head.

    ## Info

    That of `StereoSlam/Drive-v0`.

    ## Rewards

    *reward = reward_tracking + reward_effort*, each in `info`:

    - *reward_tracking*: `tracking_weight` for each metre of the route, x tracked landmarks / `max_landmarks`;
    - *reward_effort*: -`effort_weight` x the mean square of the turns of pan and tilt, as a share of the largest.

    They only keep the cameras on something. The reward of the task comes from `InformationGain`.

    ## Starting State

    That of `StereoSlam/Drive-v0`, the head straight ahead.

    ## Episode End

    - Termination: the car reaches the end of the route (or, where traffic is asked for, is hit).
    - Truncation: after 3000 steps, by `TimeLimit`; no route that comes with the package is that long.
      `gymnasium.make` takes `max_episode_steps`; -1 is no limit.

    ## Arguments

    Those of `StereoSlam/Drive-v0` without `policy`, `lane`, `slowest`, `vehicle`, `roughness`, `imu`, `imu_calibrated`,
    `progress_weight`, `collision_weight`, `goal_weight`, `time_weight` and `jerk_weight`, but for:

    | Argument | Default | Meaning |
    |----------|---------|---------|
    | `route` | `"straight"` | 98 m |
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

    Options = GazeOptions
