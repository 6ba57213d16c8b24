"""`StereoSlam/Drive-v0`: a car with a stereo camera drives through a street and sees landmarks."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from stereo_slam_env.envs.arguments import DriveOptions
from stereo_slam_env.envs.stereo_env import Observation, StereoEnv


class StereoDriveEnv(StereoEnv, gym.Env[Observation, NDArray[np.float32]]):
    """A car with a stereo camera drives along a street; the camera tracks landmarks.

    ## Description

    A procedural scene (a street by default: houses, parked cars, lamps, trees, signs) is built along a route,
    differently for each seed. A car drives along it, scripted or by the agent, and a stereo camera on its roof measures
    landmarks: left pixel `u`, `v` and disparity `d`, with noise, 10 times a second. With `sensor="landmarks"` they are
    given points on the surfaces, measured while both cameras see them; walls, cars and trees hide what is behind them.
    With `sensor="images"` both views are rendered and a vision front end finds and follows corners in them; each
    measurement then comes with a covariance of its own. Ground truth is in `info`, in
    the frame W: the left camera at reset (x right, y down, z forward). The true motion obeys Eq. 6 exactly:
    r' = r + v dt, q' = q x q(omega dt).

    The task is what you make of it: drive to the end of the street (the reward below), or estimate the motion
    (`info["truth_*"]`), or both.

    ## Action Space

    `Box(-1, 1, (2,), float32)`. With `policy="route"` the action is not used.

    | Num | Action | Min | Max | Unit at the limits |
    |-----|--------|-----|-----|--------------------|
    | 0 | acceleration | -1 | 1 | -3 to 3 m/s^2 (speed stays within 0 to 12 m/s) |
    | 1 | steering angle of the front wheels, positive to the right | -1 | 1 | -0.55 to 0.55 rad, at most 1 rad/s |

    ## Observation Space

    `Dict`; N is `max_landmarks`, and with `moving_landmarks` so many more for each car that was asked for and half as
    many for each pedestrian. Rows are sorted by id, padding rows come last. `car` and `route` are there where the agent
    drives.

    | Key | Shape | Type | Meaning |
    |-----|-------|------|---------|
    | `uvd` | (N, 3) | float32 | left pixel and disparity, px; 0 in padding |
    | `ids` | (N,) | int64 | identity of the landmark, never reused; -1 in padding; not with `observe_ids=False` |
    | `mask` | (N,) | int8 | 1 where there is a landmark |
    | `odometry` | (6,) | float32 | noisy mean velocity of the left camera over the last step, m/s and rad/s |
    | `progress` | (1,) | float32 | share of the route that has been driven, 0 to 1 |
    | `car` | (2,) | float32 | speed, m/s, and steering angle, rad, without error |
    | `route` | (5, 2) | float32 | points of the route 2, 5, 10, 20 and 30 m ahead: right and forward of the camera, m |
    | `left`, `right` | (H, W, 3) | uint8 | rendered views, only with `render_images=True` |

    With `imu` there are also the samples of an inertial unit at 200 Hz over the last step, `imu`, (20, 6) float32:
    angular rates, rad/s, and specific forces, m/s^2, in the frame of the unit; 0 at reset.

    The odometry is in the camera frame half-way through the turn of the step; at reset it is the initial velocity.
    `route` is what a perfect navigation system would show: it is made from the true pose and ends where the route ends.
    `stereo_slam_env.stereo_observation(observation, info)` makes a `StereoObservation` for a filter; learners can do
    without `ids`, which are names and no numbers.

    ## Info

    Scalars and arrays of fixed shape, the same keys from `reset` and `step`: `truth_position` (3,) and
    `truth_orientation` (4,) xyzw of the left camera in W; `truth_linear_velocity` (3,) in W and
    `truth_angular_velocity` (3,) in the camera frame, over the last step; `time` s; `distance` driven, m; `collision`;
    `failed`, whether the episode has ended by that, too late, beside the lane or outside the arena; `is_success`,
    whether the end of the route has been reached; where the agent drives `cross_track`, the distance from the route to
    the side, m;
    `v_right` (N,), the row in the right image, and `v_right_measured`; `R` (N, 3, 3), covariances of (u, v, d) in px^2,
    and `R_measured`; and the terms of the reward.

    With `moving_landmarks` there are also the moving bodies, for scores only. `truth_bodies` (K, 14) has a row for each
    that may be there, its number: the code of its kind (1 a car, 2 a pedestrian, 3 a bus), position (3) and orientation
    (4, xyzw) in W, linear and angular velocity (3 and 3) in W over the last step, m/s and rad/s. A body is x forward,
    y left, z up, with its origin on the ground. All are 0 where there is none, and in the step in which it comes or
    goes. `truth_body_of` (N,) is the number of the body that each measurement is of, -1 where it stands.

    ## Rewards

    *reward = reward_progress + reward_tracking + reward_collision + reward_goal + reward_time + reward_jerk*, each in
    `info`:

    - *reward_progress*: `progress_weight` for each metre of the route that is driven for the first time, times
      1 - (`cross_track` / `lane`)^2 where the agent drives;
    - *reward_tracking*: `tracking_weight` for each such metre, x tracked landmarks that stand / `max_landmarks`: to
      drive where nothing can be seen is bad for SLAM;
    - *reward_collision*: -`collision_weight` when the car hits something, leaves its lane, or is too late: an agent
      must arrive with a mean speed of `slowest`;
    - *reward_goal*: `goal_weight` when it reaches the end of the route without that;
    - *reward_time*: -`time_weight` for each second;
    - *reward_jerk*: -`jerk_weight` for each second, x (jerk / 10 m/s^3)^2 of an agent's car.

    So nothing is earned by standing still, by driving back and forth, slowly, jerkily, or in the oncoming lane.
    `stereo_slam_env.policies.normalised_score` puts a return on a scale from 0, actions at random, to 100, a driver
    that is shown the route.

    ## Starting State

    In the right-hand lane at the beginning of the street, at the speed of the route. A filter is told (`start`)
    the pose exactly and the velocity with an error of 0.5 m/s and 0.05 rad/s (standard deviation, each axis).

    ## Episode End

    - Termination: the car hits something, is more than `lane` beside the route where the agent drives (60 m in a
      script), is slower than `slowest` on the whole route where the agent drives, or reaches its end. The end of
      the route ends the task itself, for a scripted drive as for an agent; it is not a limit from outside.
    - Truncation: after 1200 steps, by `TimeLimit`, more than any random route takes at its own speed. For
      other routes `gymnasium.make` takes `max_episode_steps`; -1 is no limit.

    ## Arguments

    | Argument | Default | Meaning |
    |----------|---------|---------|
    | `route` | `"random-town"` | a name (`stereo-slam scenes list`) or a KITTI pose file, see below |
    | `surroundings` | `"street"` | `"street"`; `"groves"`, `"field"`, `"corridor"`: see `stereo-slam scenes list` |
    | `moving_cars` | `0` | most cars that drive |
    | `pedestrians` | `0` | most people that walk |
    | `bus` | `None` | in the lane ahead: `"leads"`, 13 m ahead; `"pulls-away"` or `"stops-and-goes"`, see below |
    | `moving_landmarks` | `0` | landmarks on each car and bus that are tracked at a time, half as many on people |
    | `randomise` | `False` | textures, colours, light, air and cameras (exposure, noise, blur) by the seed too |
    | `visibility` | `150.0` | fog: landmarks farther than this are not measured, m (8 to 150) |
    | `blank_from` | `None` | from then on nothing that is drawn has a texture, s; None: never |
    | `policy` | `"agent"` | `"agent"`: the action drives; `"route"`: a script does |
    | `lane` | `2.0` | how far beside the route an agent may drive, m |
    | `slowest` | `6.0` | mean speed at which an agent must arrive, m/s; 0: whenever |
    | `vehicle` | `"kinematic"` | `"smooth"`: continuous accelerations, springs, uneven road; no head |
    | `roughness` | `1.0` | scale of the unevenness of the road of a smooth vehicle |
    | `imu` | `None` | inertial unit of a smooth vehicle: `"adis16448"`, `"bmi088"`, `"car"` |
    | `imu_calibrated` | `False` | whether its scales and orientation are exactly as stated |
    | `rig` | `"reference"` | `"reference"` 1344x391, f = 721.5 px; `"vga"` 640x480; `"qvga"` 320x240 |
    | `sensor` | `"landmarks"` | `"landmarks"`: projection, occlusion and noise; `"images"`: rendered, front end |
    | `renderer` | `"tiny"` | `"tiny"`, everywhere; `"gl"`, fast, needs the extra gl and EGL |
    | `render_images` | `False` | add the rendered views to the observation (slow) |
    | `noise` | `"pixels"` | of landmarks: `"pixels"`, `"heavy-tailed"`, `"quantised"` or `"uvd"`, see below |
    | `sigma` | `1.0` | standard deviation of the noise, px |
    | `lasting` | `0.0` | standard deviation of the errors that last, see below, px |
    | `lasting_time` | `None` | their correlation time, s; None: they never change |
    | `max_landmarks` | `90` | most landmarks in one frame, N |
    | `refill_below` | `None` | take up new landmarks when fewer are left; None: 72 % of `max_landmarks` |
    | `revisit` | `False` | whether a lost landmark can be tracked again under its id |
    | `odometry_sigma_linear` | `0.1` | m/s, each axis |
    | `odometry_sigma_angular` | `0.01` | rad/s, each axis |
    | `perturbation` | `1.0` | scale of the random sway of a scripted drive; 0: none |
    | `supersample` | `1` | draw images this many times finer and average |
    | `front_end_name` | `"active-search"` | who measures in images: one of `available_front_ends()` |
    | `progress_weight` | `0.1` | of the reward, for each metre |
    | `physics` | `"exact"` | rays and contacts: `"exact"`, in closed form; `"bullet"`, by PyBullet |
    | `observe_ids` | `True` | whether `ids` are in the observation: filters need them |
    | `tracking_weight` | `0.05` | of the reward, for each metre with all `max_landmarks` tracked |
    | `collision_weight` | `10.0` | of the reward |
    | `goal_weight` | `10.0` | of the reward |
    | `time_weight` | `0.4` | of the reward, for each second |
    | `jerk_weight` | `0.05` | of the reward, for each second with a jerk of 10 m/s^3 |
    | `render_mode` | `None` | `"rgb_array"`: both views with the observed landmarks; `"human"`: in a window |

    `route`: `"random-town"` is drawn anew for each episode (one to four turns, 60 to 370 m); where a script drives, the
    default is `"town"` (350 m, two turns). Others are `"random-loop"`, `"random-grid"`, `"loop"`,
    `"right-turn"` and `"straight"`.

    `bus`: one that `"pulls-away"` stands 25 m ahead for 0.8 s, and then follows the speed of the route, as one that
    `"leads"`. One that `"stops-and-goes"` has speeds of its own, 20 m ahead at first; the agent must drive.

    `rig` is a name, a `StereoCamera` or some of its numbers (`fx`, `fy`, `cx`, `cy`, `baseline`, `width`, `height`):
    `{"baseline": 0.2}` differs from the default in one, `{"name": "qvga", "baseline": 0.2}` from the rig of that name.

    Noise of landmarks: `"pixels"`: u, v of both views have independent Gaussian errors; `"heavy-tailed"`: the same with
    rare gross errors, as in rendered images; `"quantised"`: rounded to whole pixels; `"uvd"`: u, v, d are independent.
    To these come, with `lasting`, errors that last: each landmark has one in each coordinate of both images, which
    changes as a Gauss-Markov process of first order. A filter is told the R of both parts together, and takes it for
    white noise; with `lasting_time` it is a `ColouredNoise`, and the filter `coloured-noise` knows better.

    The velocity of the `"kinematic"` vehicle is constant in each step and jumps between them. With `vehicle="smooth"`
    the camera follows that car through a low-pass, 67 ms behind it, pitches and rolls with the accelerations, and feels
    the road; the car of contacts and rewards stays the same. `truth_*_velocity` is then that at the end of the step.
    Samples of `imu` have the errors of its data sheet, see `stereo_slam_env.sensing.imu`; recordings carry them, and
    the filters `inertial` and `msckf` (with `motion="strapdown"`) use them.

    `reset(options={"scene": "keep"})` drives through the same scene once more.

    Randomness comes from separate streams for scene, motion, landmarks, odometry, start and cameras: the same seed
    gives the same scene and drive whatever the sensor. `copy.deepcopy` and pickle make a fresh environment;
    `stereo_slam_env.envs.snapshot` copies its state.

    ## Version History

    * v0: first version.
    """

    Options = DriveOptions
