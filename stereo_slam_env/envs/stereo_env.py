"""The common core of the environments: a car with a stereo camera, its sensors, and the terms of the reward."""

from __future__ import annotations

from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import EzPickle
from numpy.typing import NDArray

from filters.contract.noise import StereoNoise
from filters.contract.odometry import BodyVelocity
from filters.contract.start import Start
from filters.geometry import rotations
from filters.geometry.camera import StereoCamera
from filters.geometry.poses import Pose
from filters.validation import FloatArray, IntArray, finite_array
from stereo_slam_env.envs.display import modes_here, window_for
from stereo_slam_env.envs.options import DriveOptions, HeadOptions, StereoOptions
from stereo_slam_env.envs.stage import Stage
from stereo_slam_env.frontend.image_sensor import ImageSensor
from stereo_slam_env.frontend.recorder import TYPICAL_NOISE
from stereo_slam_env.frontend.tracks import TrackedPair
from stereo_slam_env.recording.recording import Frame, LandmarkTruth, Velocity
from stereo_slam_env.rendering.images import StereoImages
from stereo_slam_env.rendering.overlay import annotated_pair
from stereo_slam_env.sensing.padding import NO_LANDMARK, padded, padded_extras
from stereo_slam_env.sensing.pixel_noise import NOISE_MODELS
from stereo_slam_env.sensing.sensors import LandmarkSensor, OdometrySensor
from stereo_slam_env.world.routes import FRAME_PERIOD, Route, named_route
from stereo_slam_env.world.vehicle import AgentDriver, Car, Driver, Head, RouteDriver, advance, velocity_between

ARENA = 60.0
"""m from the route: what is farther away has left the arena."""
_IMAGE_SLACK = 10.0
"""px beyond the image that what is measured in it never is; disparities come out below 0 by less."""
MAX_VELOCITY = np.repeat([50.0, 10.0], 3)
"""Bounds of the odometry in the observation, m/s and rad/s."""
_LOOK_AHEAD = np.array([2.0, 5.0, 10.0, 20.0, 30.0])
"""Distances along the route of the points of the route in the observation, m."""
START_SIGMAS = np.repeat([1e-6, 1e-6, 0.5, 0.05], 3)
"""What is known at reset of position, rotation, linear and angular velocity: m, rad, m/s, rad/s."""

Observation = dict[str, Any]


class StereoEnv(gym.Env[Observation, NDArray[np.float32]], EzPickle):
    """A car with a stereo camera; subclasses say what the agent moves and give their `Options`."""

    metadata = {"render_modes": ["rgb_array", "human"], "render_fps": 10}  # noqa: RUF012 (Gymnasium's contract)
    Options: ClassVar[type[StereoOptions]]
    drives: ClassVar[bool]
    """Whether the first two actions are acceleration and steering."""
    gazes: ClassVar[bool]
    """Whether the last two actions are pan and tilt."""

    def __init__(self, render_mode: str | None = None, **options: Any) -> None:
        EzPickle.__init__(self, render_mode=render_mode, **options)
        self.options: Any = self.Options.checked(options)
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise ValueError(f"render_mode must be None, 'rgb_array' or 'human', got {render_mode!r}")
        self.render_mode = render_mode
        self.metadata = modes_here(self.metadata)
        self._window = window_for(render_mode, self.metadata["render_fps"])
        self.camera: StereoCamera = self.options.camera
        self.head: Head | None = None
        """Head that carries the cameras; None: they are fixed to the car."""
        if isinstance(self.options, HeadOptions):
            self.head = self.options.head(self.camera.baseline)
        self._noise = NOISE_MODELS[self.options.noise](self.options.sigma)
        self._route = named_route(self.options.route)
        self._car = Car()
        self.observation_space = self._make_observation_space()
        self.action_space = spaces.Box(-1.0, 1.0, (self._action_size,), np.float32)

        self._stage = Stage(self.options, self._route, self.camera, self._car)
        self._odometry = OdometrySensor(self.options.odometry_sigma_linear, self.options.odometry_sigma_angular)
        self._driver: Driver
        self._sensor: LandmarkSensor | ImageSensor
        self._body: Pose
        self._pose: Pose
        self._angles: FloatArray = np.zeros(2)
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
        """Start of a filter, before the first frame."""
        return self._start

    @property
    def head_angles(self) -> FloatArray:
        """Pan and tilt of the head now, rad; (2,)."""
        return self._angles.copy()

    @property
    def body(self) -> Pose:
        """Pose of the left camera if the head looked straight ahead: the drive without the gaze."""
        return self._body

    def landmark_truth(self) -> LandmarkTruth:
        """All landmarks of the scene, in W; with the sensor "images" those found so far."""
        if self._frame is None:
            raise RuntimeError("there are no landmarks yet: reset the environment first")
        return self._sensor.landmarks

    @property
    def tracked(self) -> TrackedPair:
        """Tracks of the front end in the current frame, with the sensor "images"."""
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
        """Build a new scene and put the car at the beginning of the route; `options` must be empty."""
        if options:
            raise ValueError(f"reset takes no options, got {', '.join(map(repr, options))}")
        super().reset(seed=seed)
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
        if self._steered:
            self._driver = AgentDriver(self._car, self._route)
        else:
            self._driver = RouteDriver(self._route, self.options.perturbation, motion_rng)
        self._body, velocity = self._driver.start()
        self._pose, self._angles = self._body, np.zeros(2)
        self._start = _start_belief(velocity, start_rng)
        self._step_count, self._distance, self._nearest, self._farthest, self._over = 0, 0.0, 0, 0.0, False
        odometry = self._odometry.measure(self._pose, velocity, FRAME_PERIOD, self._odometry_rng)
        self._sense(velocity, None)
        self._show()
        return self._observation(odometry), self._info({}, collision=False, success=False)

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Drive for 0.1 s and measure."""
        if self._over:
            raise RuntimeError("the episode is over: call reset before the next step")
        command = np.clip(finite_array("action", action, (self._action_size,)), -1.0, 1.0)
        before, angles_before = self._pose, self._angles
        velocity = self._move(command)
        self._step_count += 1
        odometry = self._odometry.measure(before, velocity, FRAME_PERIOD, self._odometry_rng)
        self._sense(velocity, odometry)
        self._show()

        self._nearest = self._route.nearest(self._body.position, around=self._nearest)
        advanced = max(0.0, float(self._route.arc_length[self._nearest]) - self._farthest)
        self._farthest += advanced
        collision = self._stage.collides(self._body)
        away = float(np.linalg.norm(self._route.positions[self._nearest] - self._body.position)) > ARENA
        failed = collision or away
        success = self._driver.finished and not failed
        terms = {
            "progress": advanced,
            "tracking": self._tracked * advanced,
            "collision": -float(failed),
            "goal": float(success),
            "time": -FRAME_PERIOD,
        }
        if self.head is not None:
            turned = (self._angles - angles_before) / (np.array(self.head.max_rates) * FRAME_PERIOD)
            terms["effort"] = -float(np.mean(turned**2))
        info = self._info(terms, collision=collision, success=success)
        reward = float(sum(info[f"reward_{name}"] for name in self._weights))
        self._over = failed or self._driver.finished
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
        if self.head is None:
            return annotated_pair(pair, seen, caption, self._route.positions, self._pose)
        pan = float(self._angles[0])
        return annotated_pair(pair, seen, caption, self._route.positions, self._pose, camera=self.camera, pan=pan)

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

    @property
    def _steered(self) -> bool:
        """Whether the agent drives, and not a script."""
        return isinstance(self.options, DriveOptions) and self.options.policy == "agent"

    @property
    def _action_size(self) -> int:
        return 2 * (self.drives + self.gazes)

    @property
    def _weights(self) -> dict[str, float]:
        """Weights of the terms of the reward that this environment has."""
        terms = ("progress", "tracking", "collision", "goal", "time", "effort")
        return {
            name: getattr(self.options, f"{name}_weight") for name in terms if hasattr(self.options, f"{name}_weight")
        }

    @property
    def _tracked(self) -> float:
        return len(self.frame.observation) / int(self.options.max_landmarks)

    def _move(self, command: FloatArray) -> Velocity:
        """Move the car and turn the head for a step; the velocity of the left camera (Eq. 6)."""
        before = self._pose
        driven = self._driver.drive(self._body, command[:2])  # a route needs no command
        body_before, self._body = self._body, advance(self._body, driven, FRAME_PERIOD)
        self._distance += float(np.linalg.norm(self._body.position - body_before.position))
        if self.head is None:
            self._pose = self._body
            return driven
        self._angles = self.head.turned(self._angles, command[-2:], FRAME_PERIOD)
        self._pose = self.head.camera_pose(self._body, self._angles)
        return velocity_between(before, self._pose, FRAME_PERIOD)

    def _sense(self, velocity: Velocity, odometry: BodyVelocity | None) -> None:
        self._stage.set_frame(self._step_count)
        self._frame = Frame(
            timestamp=self._step_count * FRAME_PERIOD,
            observation=self._sensor.observe(self._pose),
            odometry=odometry,
            truth=self._pose,
            truth_velocity=velocity,
            head=None if self.head is None else self._angles,
        )

    def _rendered(self) -> StereoImages:
        return self._stage.images(self._pose)

    def _observation(self, odometry: BodyVelocity) -> Observation:
        observation = padded(self.frame.observation, self.options.max_landmarks)
        if not self.options.observe_ids:
            del observation["ids"]
        velocity = np.concatenate([odometry.linear, odometry.angular])
        observation["odometry"] = np.clip(velocity, -MAX_VELOCITY, MAX_VELOCITY).astype(np.float32)
        observation["progress"] = np.array([self._farthest / self._route.length], dtype=np.float32)
        if isinstance(self._driver, AgentDriver):
            observation["car"] = np.array([self._driver.speed, self._driver.steering], dtype=np.float32)
            place = np.array([self._nearest]), self._body.position[None], self._body.orientation[None]
            observation["route"] = route_ahead(self._route, *place)[0]
        if self.head is not None:
            observation["head"] = self._angles.astype(np.float32)
        if self.options.render_images:
            images = self._rendered()
            observation |= {"left": images.left, "right": images.right}
        return observation

    def _info(self, terms: dict[str, float], *, collision: bool, success: bool) -> dict[str, Any]:
        frame = self.frame
        assert frame.truth is not None
        assert frame.truth_velocity is not None
        return {
            "truth_position": frame.truth.position.copy(),
            "truth_orientation": frame.truth.orientation.copy(),
            "truth_linear_velocity": frame.truth_velocity.linear.copy(),
            "truth_angular_velocity": frame.truth_velocity.angular.copy(),
            "time": np.float64(frame.timestamp),
            "distance": np.float64(self._distance),
            "collision": np.bool_(collision),
            "is_success": np.bool_(success),
            **{f"reward_{name}": np.float64(weight * terms.get(name, 0.0)) for name, weight in self._weights.items()},
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
        velocity = MAX_VELOCITY.astype(np.float32)
        shapes: dict[str, spaces.Space[Any]] = {
            "uvd": spaces.Box(np.tile(low, (rows, 1)).astype(np.float32), np.tile(high, (rows, 1)).astype(np.float32)),
            "ids": spaces.Box(NO_LANDMARK, np.iinfo(np.int32).max, (rows,), np.int64),
            "mask": spaces.Box(0, 1, (rows,), np.int8),
            "odometry": spaces.Box(-velocity, velocity),
            "progress": spaces.Box(0.0, 1.0, (1,), np.float32),
        }
        if not self.options.observe_ids:
            del shapes["ids"]
        if self._steered:
            car = np.array([self._car.max_speed, self._car.max_steering], dtype=np.float32)
            shapes["car"] = spaces.Box(-car, car)
            shapes["route"] = spaces.Box(-ARENA, ARENA, (len(_LOOK_AHEAD), 2), np.float32)
        if self.head is not None:
            most = np.array(self.head.max_angles, dtype=np.float32)
            shapes["head"] = spaces.Box(-most, most)
        if self.options.render_images:
            for view in ("left", "right"):
                shapes[view] = spaces.Box(0, 255, (camera.height, camera.width, 3), np.uint8)
        return spaces.Dict(shapes)


def route_ahead(
    route: Route, nearest: IntArray, positions: FloatArray, orientations: FloatArray
) -> NDArray[np.float32]:
    """Points of the route ahead of cameras, from poses and nearest frames (B,): right and forward, m; (B, 5, 2)."""
    points_w = route.points_at(route.arc_length[nearest][:, None] + _LOOK_AHEAD)
    points_c = np.einsum("bij,bki->bkj", rotations.matrix(orientations), points_w - positions[:, None])
    ahead: NDArray[np.float32] = points_c[..., [0, 2]].clip(-ARENA, ARENA).astype(np.float32)
    return ahead


def _start_belief(velocity: Velocity, rng: np.random.Generator) -> Start:
    """A known pose, and a velocity with an error of the stated covariance."""
    error = START_SIGMAS[6:] * rng.standard_normal(6)
    return Start(
        linear_velocity=velocity.linear + error[:3],
        angular_velocity=velocity.angular + error[3:],
        covariance=np.diag(START_SIGMAS**2),
    )
