"""`StereoSlam/Drive-v0`: a car with a stereo camera drives through a street and sees landmarks."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import EzPickle
from numpy.typing import NDArray

from filters.camera import StereoCamera
from filters.interface import BodyVelocity
from filters.noise import StereoNoise
from filters.validation import IntArray, finite_array
from stereo_slam_env.envs.display import modes_here, window_for
from stereo_slam_env.envs.options import DriveOptions
from stereo_slam_env.envs.stage import Stage
from stereo_slam_env.frontend.recorder import TYPICAL_NOISE
from stereo_slam_env.frontend.tracked import TrackedPair
from stereo_slam_env.recording import Frame, LandmarkTruth, Pose, Start, Velocity
from stereo_slam_env.rendering.images import StereoImages
from stereo_slam_env.rendering.overlay import annotated_pair
from stereo_slam_env.sensing.image_sensor import ImageSensor
from stereo_slam_env.sensing.landmark_sensor import LandmarkSensor
from stereo_slam_env.sensing.odometry import OdometrySensor
from stereo_slam_env.sensing.padding import NO_LANDMARK, padded, padded_extras
from stereo_slam_env.sensing.pixel_noise import NOISE_MODELS
from stereo_slam_env.sensing.rigs import RIGS
from stereo_slam_env.world.route_files import named_route
from stereo_slam_env.world.routes import FRAME_PERIOD, Driver, Route, RouteDriver, advance
from stereo_slam_env.world.vehicle import AgentDriver, Car

_PROGRESS_WEIGHT, _VISIBILITY_WEIGHT, _COLLISION_WEIGHT = 0.1, 0.02, -10.0
_ARENA = 60.0
"""m from the route: what is farther away has left the arena."""
_IMAGE_SLACK = 10.0
"""px beyond the image that what is measured in it never is; disparities come out below 0 by less."""
_MAX_VELOCITY = np.repeat([50.0, 10.0], 3)
"""Bounds of the odometry in the observation, m/s and rad/s."""
_START_SIGMAS = np.repeat([1e-6, 1e-6, 0.5, 0.05], 3)
"""What is known at reset of position, rotation, linear and angular velocity: m, rad, m/s, rad/s."""

Observation = dict[str, Any]


class StereoDriveEnv(gym.Env[Observation, NDArray[np.float32]], EzPickle):
    """A car with a stereo camera drives along a street; the camera tracks landmarks.

    ## Description

    A procedural scene (a street by default: houses, parked cars, lamps, trees, signs) is built along a route,
    differently for each seed. A car drives along it, scripted or by the agent, and a stereo camera on its roof measures
    landmarks: left pixel `u`, `v` and disparity `d`, with noise, 10 times a second. With `sensor="landmarks"` they are
    given points on the surfaces, measured while both eyes see them; walls, cars and trees hide what is behind them.
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

    `Dict`; N is `max_landmarks`, rows are sorted by id, padding rows come last.

    | Key | Shape | Type | Meaning |
    |-----|-------|------|---------|
    | `uvd` | (N, 3) | float32 | left pixel and disparity, px; 0 in padding |
    | `ids` | (N,) | int64 | identity of the landmark, never reused in an episode; -1 in padding |
    | `mask` | (N,) | int8 | 1 where there is a landmark |
    | `odometry` | (6,) | float32 | noisy mean velocity of the left camera over the last step, m/s and rad/s |
    | `left`, `right` | (H, W, 3) | uint8 | rendered views, only with `render_images=True` |

    The odometry is in the camera frame half-way through the turn of the step; at reset it is the initial velocity.
    `stereo_slam_env.stereo_observation(observation, info)` makes a `StereoObservation` of the rest.

    ## Info

    Scalars and arrays of fixed shape, the same keys from `reset` and `step`: `truth_position` (3,) and
    `truth_orientation` (4,) xyzw of the left camera in W; `truth_linear_velocity` (3,) in W and
    `truth_angular_velocity` (3,) in the camera frame, over the last step; `time` s; `distance` driven, m;
    `collision`; `v_right` (N,), the row in the right image, and `v_right_measured`; `R` (N, 3, 3), covariances of
    (u, v, d) in px^2, and `R_measured`; and the terms of the reward.

    ## Rewards

    *reward = reward_progress + reward_visibility + reward_collision*, each in `info`:

    - *reward_progress*: 0.1 for each metre advanced along the route (negative backwards);
    - *reward_visibility*: 0.02 x tracked landmarks / `max_landmarks`: standing in front of a wall is bad for SLAM;
    - *reward_collision*: -10 when the car hits something or leaves the arena.

    ## Starting State

    In the right-hand lane at the beginning of the street, at the speed of the route. A filter is told (`start`)
    the pose exactly and the velocity with an error of 0.5 m/s and 0.05 rad/s (standard deviation, each axis).

    ## Episode End

    - Termination: the car hits something, is more than 60 m off the route, or reaches the end of the route. The end of
      the route ends the task itself, for a scripted drive as for an agent; it is not a limit from outside.
    - Truncation: after 3000 steps, by `TimeLimit` (only an agent that dawdles gets there).

    ## Arguments

    | Argument | Default | Meaning |
    |----------|---------|---------|
    | `route` | `"town"` | `"town"` (350 m, two turns), `"right-turn"`, `"straight"`, `"loop"`, or a KITTI pose file |
    | `surroundings` | `"street"` | `"street"`; `"field"`: far features only; `"corridor"`: low texture; `"groves"` |
    | `moving_cars` | `0` | most cars that drive |
    | `pedestrians` | `0` | most people that walk |
    | `randomise` | `False` | textures, colours, light, air and cameras (exposure, noise, blur) by the seed too |
    | `policy` | `"agent"` | `"agent"`: the action drives; `"route"`: a script does |
    | `rig` | `"reference"` | `"reference"` 1344x391, f = 721.5 px; `"vga"` 640x480; `"qvga"` 320x240 |
    | `sensor` | `"landmarks"` | `"landmarks"`: projection, occlusion and noise; `"images"`: rendered, front end |
    | `renderer` | `"tiny"` | who draws: `"tiny"`, everywhere; `"gl"`, fast, needs the extra gl and EGL |
    | `render_images` | `False` | add the rendered views to the observation (slow) |
    | `noise` | `"pixels"` | of landmarks: `"pixels"`, `"heavy-tailed"`, `"quantised"` or `"uvd"`, see below |
    | `sigma` | `1.0` | standard deviation of the noise, px |
    | `max_landmarks` | `90` | most landmarks in one frame, N |
    | `refill_below` | `None` | take up new landmarks when fewer are left; None: 72 % of `max_landmarks` |
    | `revisit` | `False` | whether a lost landmark can be tracked again under its id |
    | `odometry_sigma_linear` | `0.1` | m/s, each axis |
    | `odometry_sigma_angular` | `0.01` | rad/s, each axis |
    | `perturbation` | `1.0` | scale of the random sway of a scripted drive; 0: none |
    | `supersample` | `1` | draw images this many times finer and average |
    | `render_mode` | `None` | `"rgb_array"`: both views with the observed landmarks; `"human"`: in a window |

    Noise of landmarks: `"pixels"`: u, v of both eyes have independent Gaussian errors; `"heavy-tailed"`: the same with
    rare gross errors, as in rendered images; `"quantised"`: rounded to whole pixels; `"uvd"`: u, v, d are independent.

    Randomness comes from separate streams for scene, motion, landmarks, odometry, start and cameras: the same seed
    gives the same scene and drive whatever the sensor. `copy.deepcopy` and pickle make a fresh environment, not a
    snapshot.

    ## Version History

    * v0: first version.
    """

    metadata = {"render_modes": ["rgb_array", "human"], "render_fps": 10}  # noqa: RUF012 (Gymnasium's contract)

    def __init__(self, render_mode: str | None = None, **options: Any) -> None:
        EzPickle.__init__(self, render_mode=render_mode, **options)
        self.options = DriveOptions.checked(options)
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise ValueError(f"render_mode must be None, 'rgb_array' or 'human', got {render_mode!r}")
        self.render_mode = render_mode
        self.metadata = modes_here(self.metadata)
        self._window = window_for(render_mode, self.metadata["render_fps"])
        self.camera: StereoCamera = RIGS[self.options.rig]
        self._noise = NOISE_MODELS[self.options.noise](self.options.sigma)
        self.observation_space = self._make_observation_space()
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)

        self._route = named_route(self.options.route)
        self._car = Car()
        self._stage = Stage(self.options, self._route, self.camera, self._car)
        self._odometry = OdometrySensor(self.options.odometry_sigma_linear, self.options.odometry_sigma_angular)
        self._driver: Driver
        self._sensor: LandmarkSensor | ImageSensor
        self._pose: Pose
        self._frame: Frame | None = None
        self._start = Start()
        self._over = True

    @property
    def noise(self) -> StereoNoise:
        """Covariance to assume of a measurement that does not come with its own."""
        return TYPICAL_NOISE if self.options.sensor == "images" else self._noise.stereo_noise

    @property
    def route(self) -> Route:
        """The nominal drive."""
        return self._route

    @property
    def frame(self) -> Frame:
        """The current frame in full precision: observation, odometry, truth."""
        if self._frame is None:
            raise RuntimeError("there is no frame yet: reset the environment first")
        return self._frame

    @property
    def start(self) -> Start:
        """What a filter is told before the first frame."""
        return self._start

    def landmark_truth(self) -> LandmarkTruth:
        """All landmarks of the scene, in W; with the sensor "images" those found so far."""
        if self._frame is None:
            raise RuntimeError("there are no landmarks yet: reset the environment first")
        return self._sensor.landmarks

    @property
    def tracked(self) -> TrackedPair:
        """What the front end found in the current frame, with the sensor "images"."""
        tracked = self._image_sensor.tracked
        assert tracked is not None
        return tracked

    @property
    def moving_ids(self) -> IntArray:
        """Ids that the front end gave to corners of moving bodies so far, with the sensor "images"; ascending."""
        return self._image_sensor.moving_ids

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Build a new street and put the car at its beginning; `options` must be empty."""
        super().reset(seed=seed)
        if options:
            raise ValueError(f"reset takes no options, got {', '.join(map(repr, options))}")
        scene_rng, motion_rng, landmark_rng, self._odometry_rng, start_rng, camera_rng = self.np_random.spawn(6)
        self._stage.build(scene_rng, camera_rng, draws=self.options.draws or self.render_mode is not None)
        if self.options.sensor == "images":
            self._sensor = ImageSensor(self.camera, self._rendered, self.options.front_end, self._stage.on_moving_body)
        else:
            self._sensor = LandmarkSensor(
                self.camera,
                self._noise,
                self._stage.landmarks,
                self._stage.visible,
                self.options.tracking,
                landmark_rng,
            )
        if self.options.policy == "route":
            self._driver = RouteDriver(self._route, self.options.perturbation, motion_rng)
        else:
            self._driver = AgentDriver(self._car, self._route)
        self._pose, velocity = self._driver.start()
        self._start = _start_belief(velocity, start_rng)
        self._step_count, self._distance, self._nearest, self._over = 0, 0.0, 0, False
        odometry = self._odometry.measure(self._pose, velocity, FRAME_PERIOD, self._odometry_rng)
        self._sense(velocity, None)
        self._show()
        return self._observation(odometry), self._info(collision=False, progress=0.0, failed=False)

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Drive for 0.1 s and look."""
        if self._over:
            raise RuntimeError("the episode is over: call reset before the next step")
        command = np.clip(finite_array("action", action, (2,)), -1.0, 1.0)
        before = self._pose
        velocity = self._driver.drive(before, command)
        self._pose = advance(before, velocity, FRAME_PERIOD)
        self._step_count += 1
        self._distance += float(np.linalg.norm(self._pose.position - before.position))
        odometry = self._odometry.measure(before, velocity, FRAME_PERIOD, self._odometry_rng)
        self._sense(velocity, odometry)
        self._show()

        nearest = self._route.nearest(self._pose.position, around=self._nearest)
        progress = float(self._route.arc_length[nearest] - self._route.arc_length[self._nearest])
        self._nearest = nearest
        collision = self._stage.collides(self._pose)
        away = float(np.linalg.norm(self._route.positions[nearest] - self._pose.position)) > _ARENA
        info = self._info(collision=collision, progress=progress, failed=collision or away)
        reward = info["reward_progress"] + info["reward_visibility"] + info["reward_collision"]
        self._over = collision or away or self._driver.finished
        return self._observation(odometry), reward, self._over, False, info

    def render(self) -> NDArray[np.uint8] | None:
        """Both views with the observed landmarks, (H, W, 3) uint8; with "human" they are in the window already."""
        if self.render_mode is None:
            gym.logger.warn("render() needs a render_mode: make the environment with render_mode='rgb_array'")
            return None
        return self._picture() if self._window is None else None

    def _show(self) -> None:
        if self._window is not None:
            self._window.show(self._picture())

    def _picture(self) -> NDArray[np.uint8]:
        frame, pair = self.frame, self._rendered()
        seen = frame.observation
        speed = float(np.linalg.norm(frame.truth_velocity.linear)) if frame.truth_velocity else 0.0
        caption = [
            f"route {self.options.route}",
            f"t = {frame.timestamp:.1f} s",
            f"{self._distance:.0f} m driven",
            f"{speed:.1f} m/s",
            f"{len(seen)} landmarks",
        ]
        return annotated_pair(pair, seen, caption, self._route.positions, self._pose)

    def close(self) -> None:
        """Stop the physics engine; may be called at any time, also twice."""
        self._stage.close()
        if self._window is not None:
            self._window.close()
        self._over = True

    @property
    def _image_sensor(self) -> ImageSensor:
        if self._frame is None or not isinstance(self._sensor, ImageSensor):
            raise RuntimeError("nothing is seen in images: use sensor='images' and reset the environment first")
        return self._sensor

    def _sense(self, velocity: Velocity, odometry: BodyVelocity | None) -> None:
        self._stage.set_frame(self._step_count)
        self._frame = Frame(
            timestamp=self._step_count * FRAME_PERIOD,
            observation=self._sensor.observe(self._pose),
            odometry=odometry,
            truth=self._pose,
            truth_velocity=velocity,
        )

    def _rendered(self) -> StereoImages:
        return self._stage.images(self._pose)

    def _observation(self, odometry: BodyVelocity) -> Observation:
        observation = padded(self.frame.observation, self.options.max_landmarks)
        velocity = np.concatenate([odometry.linear, odometry.angular])
        observation["odometry"] = np.clip(velocity, -_MAX_VELOCITY, _MAX_VELOCITY).astype(np.float32)
        if self.options.render_images:
            images = self._rendered()
            observation |= {"left": images.left, "right": images.right}
        return observation

    def _info(self, *, collision: bool, progress: float, failed: bool) -> dict[str, Any]:
        frame = self.frame
        assert frame.truth is not None
        assert frame.truth_velocity is not None
        share = len(frame.observation) / self.options.max_landmarks
        return {
            "truth_position": frame.truth.position.copy(),
            "truth_orientation": frame.truth.orientation.copy(),
            "truth_linear_velocity": frame.truth_velocity.linear.copy(),
            "truth_angular_velocity": frame.truth_velocity.angular.copy(),
            "time": frame.timestamp,
            "distance": self._distance,
            "collision": collision,
            "reward_progress": _PROGRESS_WEIGHT * progress,
            "reward_visibility": _VISIBILITY_WEIGHT * share,
            "reward_collision": _COLLISION_WEIGHT if failed else 0.0,
            **padded_extras(frame.observation, self.options.max_landmarks),
        }

    def _make_observation_space(self) -> spaces.Dict:
        camera, rows = self.camera, self.options.max_landmarks
        if self.options.sensor == "images":
            largest, slack = float(camera.width), _IMAGE_SLACK
        else:
            largest = camera.disparity_constant / self.options.tracking.nearest
            slack = self._noise.largest_error  # so the bounds hold without clipping
        high = np.array([camera.width, camera.height, largest]) + slack
        low = np.full(3, -slack)
        velocity = _MAX_VELOCITY.astype(np.float32)
        shapes: dict[str, spaces.Space[Any]] = {
            "uvd": spaces.Box(np.tile(low, (rows, 1)).astype(np.float32), np.tile(high, (rows, 1)).astype(np.float32)),
            "ids": spaces.Box(NO_LANDMARK, np.iinfo(np.int32).max, (rows,), np.int64),
            "mask": spaces.MultiBinary(rows),
            "odometry": spaces.Box(-velocity, velocity),
        }
        if self.options.render_images:
            for eye in ("left", "right"):
                shapes[eye] = spaces.Box(0, 255, (camera.height, camera.width, 3), np.uint8)
        return spaces.Dict(shapes)


def _start_belief(velocity: Velocity, rng: np.random.Generator) -> Start:
    """The pose is known, the velocity up to an error that the covariance tells truly."""
    error = _START_SIGMAS[6:] * rng.standard_normal(6)
    return Start(
        linear_velocity=velocity.linear + error[:3],
        angular_velocity=velocity.angular + error[3:],
        covariance=np.diag(_START_SIGMAS**2),
    )
