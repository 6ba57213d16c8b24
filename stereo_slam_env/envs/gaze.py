"""`StereoSlam/Gaze-v0`: a car follows its route, the agent decides where its stereo camera looks."""

from __future__ import annotations

from stereo_slam_env.envs.options import GazeOptions
from stereo_slam_env.envs.stereo_env import StereoEnv


class StereoGazeEnv(StereoEnv):
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

    `Dict`; N is `max_landmarks`, rows are sorted by id, padding rows come last.

    | Key | Shape | Type | Meaning |
    |-----|-------|------|---------|
    | `uvd` | (N, 3) | float32 | left pixel and disparity, px; 0 in padding |
    | `ids` | (N,) | int64 | identity of the landmark, never reused in an episode; -1 in padding |
    | `mask` | (N,) | int8 | 1 where there is a landmark |
    | `odometry` | (6,) | float32 | noisy mean velocity of the left camera over the last step, m/s and rad/s |
    | `head` | (2,) | float32 | pan and tilt now, rad, without error |
    | `left`, `right` | (H, W, 3) | uint8 | rendered views, only with `render_images=True` |

    The odometry is that of the camera, not of the car: it contains the turning of the head.
    `stereo_slam_env.stereo_observation(observation, info)` makes a `StereoObservation` of the rest.

    ## Info

    Scalars and arrays of fixed shape, the same keys from `reset` and `step`: `truth_position` (3,) and
    `truth_orientation` (4,) xyzw of the left camera in W; `truth_linear_velocity` (3,) in W and
    `truth_angular_velocity` (3,) in the camera frame, over the last step; `time` s; `distance` driven, m;
    `collision`; `v_right` (N,), the row in the right image, and `v_right_measured`; `R` (N, 3, 3), covariances of
    (u, v, d) in px^2, and `R_measured`; and the terms of the reward.

    ## Rewards

    *reward = reward_tracking + reward_effort*, each in `info`:

    - *reward_tracking*: `tracking_weight` x tracked landmarks / `max_landmarks`;
    - *reward_effort*: -`effort_weight` x the mean square of the turns of pan and tilt, as a share of the largest.

    They only keep the cameras on something. The reward of the task comes from `InformationGain`.

    ## Starting State

    At the beginning of the route, at its speed, the head straight ahead. A filter is told (`start`) the pose exactly
    and the velocity with an error of 0.5 m/s and 0.05 rad/s (standard deviation, each axis).

    ## Episode End

    - Termination: the car reaches the end of the route (or, where traffic is asked for, is hit).
    - Truncation: after 3000 steps, by `TimeLimit`; no route that comes with the package is that long.

    ## Arguments

    | Argument | Default | Meaning |
    |----------|---------|---------|
    | `route` | `"straight"` | `"straight"` (98 m), `"town"` (350 m), `"right-turn"`, `"loop"`, or a KITTI pose file |
    | `surroundings` | `"groves"` | groups of things on either side; all: `stereo-slam scenes list` |
    | `moving_cars` | `0` | most cars that drive |
    | `pedestrians` | `0` | most people that walk |
    | `randomise` | `False` | textures, colours, light, air and cameras (exposure, noise, blur) by the seed too |
    | `visibility` | `30.0` | fog: landmarks farther than this are not measured, m (8 to 150) |
    | `blank_from` | `None` | from then on nothing that is drawn has a texture, s; None: never |
    | `rig` | `"vga"` | `"vga"` 640x480, f = 460 px; `"reference"` 1344x391; `"qvga"` 320x240 |
    | `sensor` | `"landmarks"` | `"landmarks"`: projection, occlusion and noise; `"images"`: rendered, front end |
    | `renderer` | `"tiny"` | `"tiny"`, everywhere; `"gl"`, fast, needs the extra gl and EGL |
    | `render_images` | `False` | add the rendered views to the observation (slow) |
    | `noise` | `"pixels"` | of landmarks: `"pixels"`, `"heavy-tailed"`, `"quantised"` or `"uvd"`, see below |
    | `sigma` | `1.0` | standard deviation of the noise, px |
    | `max_landmarks` | `24` | most landmarks in one frame, N |
    | `refill_below` | `None` | take up new landmarks when fewer are left; None: 72 % of `max_landmarks` |
    | `revisit` | `True` | whether a lost landmark can be tracked again under its id |
    | `odometry_sigma_linear` | `0.1` | m/s, each axis |
    | `odometry_sigma_angular` | `0.01` | rad/s, each axis |
    | `perturbation` | `1.0` | scale of the random sway of the drive; 0: none |
    | `supersample` | `1` | draw images this many times finer and average |
    | `tracking_weight` | `0.02` | of the reward, for a full frame |
    | `effort_weight` | `0.01` | of the reward, for turning the head as fast as it can |
    | `max_pan` | `2.0` | how far the head turns to either side, rad |
    | `max_tilt` | `0.4` | how far it turns up and down, rad |
    | `pan_rate` | `1.5` | how fast it turns sideways, rad/s |
    | `tilt_rate` | `1.0` | how fast it turns up and down, rad/s |
    | `render_mode` | `None` | `"rgb_array"`: both views with the observed landmarks; `"human"`: in a window |

    `rig` is a name, a `StereoCamera` or some of its numbers (`fx`, `fy`, `cx`, `cy`, `baseline`, `width`, `height`):
    `{"baseline": 0.2}` differs from the default in one, `{"name": "qvga", "baseline": 0.2}` from the rig of that name.

    Noise of landmarks: `"pixels"`: u, v of both views have independent Gaussian errors; `"heavy-tailed"`: the same with
    rare gross errors, as in rendered images; `"quantised"`: rounded to whole pixels; `"uvd"`: u, v, d are independent.

    Randomness comes from separate streams for scene, motion, landmarks, odometry, start and cameras: the same seed
    gives the same scene and drive whatever the sensor. `copy.deepcopy` and pickle make a fresh environment, not a
    snapshot.

    ## Version History

    * v0: first version.
    """

    Options = GazeOptions
    drives, gazes = False, True
