"""`CoreRows`: the simulator as rows of environments, with its observations, rewards and truth."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.utils.seeding import np_random
from numpy.typing import NDArray

from filters.contract.inputs import Start, StereoObservation
from filters.contract.noise import ColouredNoise, LandmarkDrift, StereoNoise
from filters.geometry.arrays import BoolArray, FloatArray
from filters.geometry.camera import StereoCamera
from filters.geometry.poses import Pose
from stereo_slam_env.envs.arguments import DriveOptions, HeadOptions, StereoOptions
from stereo_slam_env.envs.row_pictures import Pictures
from stereo_slam_env.envs.rows import Arrays, Measured, Rows, Seeds, Step
from stereo_slam_env.frontend.front_ends import FrontEnd, make_front_end
from stereo_slam_env.frontend.track_recorder import TYPICAL_NOISE, ImageSensor
from stereo_slam_env.recording.recording import Frame, LandmarkTruth
from stereo_slam_env.rendering.overlay import annotated_pair
from stereo_slam_env.rendering.pinhole import StereoImages
from stereo_slam_env.sensing.corruptions import NOISE_MODELS
from stereo_slam_env.sensing.imu import Imu
from stereo_slam_env.sensing.padding import NO_LANDMARK, padded_extras
from stereo_slam_env.simulator.motion import LOOK_AHEAD
from stereo_slam_env.simulator.moving_truth import bodies_now, bodies_of_measurements
from stereo_slam_env.simulator.scene_arrays import MAX_VELOCITY, SceneArrays, scene_arrays
from stereo_slam_env.simulator.simulator import Simulator
from stereo_slam_env.simulator.state import ARENA, RIDE_STEPS, WEIGHTS, make_rules
from stereo_slam_env.world.routes import FRAME_PERIOD, RANDOM_ROUTES, Route, named_route
from stereo_slam_env.world.surroundings import build_scene
from stereo_slam_env.world.vehicle import Car, Head

_IMAGE_SLACK = 10.0
"""px beyond the image that what is measured in it never is; disparities come out below 0 by less."""
MAX_INERTIAL: FloatArray = np.repeat([35.0, 240.0], 3)
"""Bounds of the inertial samples in the observation, rad/s and m/s^2: 2,000 degrees a second and 24 g."""
EPISODES_OF_A_SCENE = 10
"""A scene of a pool makes place for a new one after so many."""


class CoreRows(Rows):
    """Cars with stereo cameras, one in each row.

    Parameters
    ----------
    options : StereoOptions
        Arguments of the environments.
    count : int
        Number of rows.
    threads : int
        Threads over which they are spread.
    pool : int, optional
        Take the scenes of all episodes from a pool of so many; each is replaced after ten episodes.
    draws : bool
        Whether pictures will be asked for beyond those that the options need.
    """

    changes = ("generators", "simulator", "_pictures", "_image_sensors", "_seen", "_pool")

    def __init__(
        self, options: StereoOptions, count: int, *, threads: int = 1, pool: int | None = None, draws: bool = False
    ) -> None:
        self.options, self.num_envs, self.world, self.threads = options, count, self, min(threads, count)
        self.draws = draws or options.draws
        self.camera: StereoCamera = options.camera
        self._route: Route = named_route(options.route)
        self.head: Head | None = options.head(self.camera.baseline) if isinstance(options, HeadOptions) else None
        self.generators: list[np.random.Generator | None] = [None] * count
        self._pixel_noise = NOISE_MODELS[options.noise](options.sigma)
        self._weights = {name: k for k, name in enumerate(WEIGHTS) if hasattr(options, f"{name}_weight")}
        drive = options if isinstance(options, DriveOptions) else None
        self._imu = None if drive is None or drive.imu is None else Imu(drive.data_sheet)
        rules = make_rules(
            self.camera,
            options.tracking,
            moving=options.max_measurements - int(options.max_landmarks),
            noise=options.noise,
            sigma=options.sigma,
            lasting=options.lasting,
            lasting_time=options.lasting_time,
            odometry_sigmas=(options.odometry_sigma_linear, options.odometry_sigma_angular),
            perturbation=options.perturbation,
            steered=drive is not None and drive.policy == "agent",
            lane=np.inf if drive is None else drive.lane,
            slowest=0.0 if drive is None else drive.slowest,
            smooth=drive is not None and drive.vehicle == "smooth",
            roughness=1.0 if drive is None else drive.roughness,
            head=self.head,
            weights={name: getattr(options, f"{name}_weight") for name in self._weights},
            exact=options.physics == "exact",
        )
        self._sees_images = options.sensor == "images"
        self.simulator = Simulator(
            rules, count, self._pixel_noise, threads, imu=self._imu, senses=not self._sees_images
        )
        self.observation_space = self._make_observation_space()
        self.action_space = spaces.Box(-1.0, 1.0, (2 * ((drive is not None) + (self.head is not None)),), np.float32)
        self._pictures = [Pictures(options, self.camera) for _ in range(count if self.draws else 0)]
        self._image_sensors: list[ImageSensor | None] = [None] * count
        self._seen: list[StereoObservation | None] = [None] * count  # in images
        self._pool: list[tuple[SceneArrays, int]] = []  # with the number of episodes so far
        self._pool_size = pool

    @property
    def route(self) -> Route:
        """The nominal drive: that of the first row; before its first episode, of a random route, a typical one."""
        return self._route if (scene := self.simulator.scenes[0]) is None else scene.route

    @property
    def noise(self) -> StereoNoise:
        """Covariance to assume of a measurement that does not come with its own."""
        if self._sees_images:
            return TYPICAL_NOISE
        white, lasting, time = self._pixel_noise.stereo_noise, self.options.lasting, self.options.lasting_time
        if not lasting:
            return white
        R = white.R + StereoNoise.independent_pixels(lasting).R
        if time is None:
            return StereoNoise(R)
        step = lasting * np.sqrt(2.0 * (1.0 - np.exp(-FRAME_PERIOD / time)))
        return ColouredNoise(R, white.R, LandmarkDrift(pixels=(step, step, np.sqrt(2.0) * step)), lasting_time=time)

    # --- episodes ---------------------------------------------------------------------------------------------------

    def reset(self, chosen: BoolArray, seeds: Seeds, options: Mapping[str, Any]) -> None:
        """`options={"scene": "keep"}` keeps the scene of the last episode of a row."""
        keep = keeps_scene(options)
        if any(seed is not None for seed in seeds):
            self._pool = []  # episodes depend on their seeds alone
        rows = np.flatnonzero(chosen).tolist()
        for b in rows:
            generator = self.generators[b]
            if generator is None or seeds[b] is not None:
                generator = self.generators[b] = np_random(seeds[b])[0]
            scene_rng, motion, landmark, odometry, start, camera = generator.spawn(6)
            inertial = [] if self._imu is None else generator.spawn(1)
            kept = self.simulator.scenes[b]
            scene = kept if keep and kept is not None else self._scene(scene_rng)
            self.simulator.put(b, scene, [motion, landmark, odometry, start, *inertial])
            if self._pictures:
                self._pictures[b].build(scene.scene, camera)
            if self._sees_images:
                self._image_sensors[b] = self.new_image_sensor(b)
        self.simulator.begin(chosen)
        self._take_pictures(rows)

    def step(self, actions: Any, going: BoolArray) -> Step:
        """Actions are within -1..1."""
        simulator, sensed = self.simulator, self.simulator.sensed
        simulator.step(np.ascontiguousarray(actions, dtype=np.float64), going)
        if self._pictures:
            self._take_pictures(np.flatnonzero(going).tolist())
        if self._sees_images:
            simulator.judge()
        terminated = going & (sensed.failed | sensed.success)
        return np.where(going, sensed.reward, 0.0), terminated, np.zeros(self.num_envs, dtype=np.bool_)

    def restore(self, state: Mapping[str, Any]) -> None:
        if self._sees_images:
            self._image_sensors = [self.new_image_sensor(b) for b in range(self.num_envs)]
        super().restore(state)

    def close(self) -> None:
        """Stop threads, engines and renderers; may be called twice."""
        self.simulator.close()
        for pictures in self._pictures:
            pictures.close()

    def _scene(self, rng: np.random.Generator) -> SceneArrays:
        if self._pool_size is None:
            return self._built(rng)
        if len(self._pool) < self._pool_size:
            self._pool.append((self._built(rng), 1))
            return self._pool[-1][0]
        number = int(rng.integers(len(self._pool)))
        scene, episodes = self._pool[number]
        if episodes == EPISODES_OF_A_SCENE:
            scene, episodes = self._built(rng), 0
        self._pool[number] = scene, episodes + 1
        return scene

    def _built(self, rng: np.random.Generator) -> SceneArrays:
        options, route = self.options, self._route
        if options.route in RANDOM_ROUTES:
            route = RANDOM_ROUTES[options.route](rng.spawn(1)[0])
        scene = build_scene(
            options.surroundings,
            route,
            rng,
            moving_cars=options.moving_cars,
            pedestrians=options.pedestrians,
            bus=options.bus,
            randomise=options.randomise,
        )
        return scene_arrays(scene, route, int(options.moving_landmarks), rng)

    def new_image_sensor(self, b: int, front_end: FrontEnd | None = None) -> ImageSensor:
        """Sensor in the images of a row, by the front end of the options or another one."""
        front_end = front_end or make_front_end(self.camera, self.options.front_end)
        return ImageSensor(self.camera, lambda: self.images(b), front_end, self._pictures[b].on_moving_body)

    def _take_pictures(self, rows: list[int]) -> None:
        """Go on to the next picture of some rows, and measure in it where landmarks are seen in images."""
        for b in rows if self._pictures else ():
            self._pictures[b].set_frame(int(self.simulator.fleet.step[b]))
            sensor = self._image_sensors[b]
            if sensor is not None:
                observed = self._seen[b] = sensor.observe(self.simulator.pose(b))
                self.simulator.sense(b, observed.ids, observed.uvd)

    # --- what is said of them ---------------------------------------------------------------------------------------

    def observe(self) -> tuple[Arrays, Arrays]:
        options, fleet, sensed, shown = self.options, self.simulator.fleet, self.simulator.sensed, self.simulator.show()
        observation: Arrays = {"uvd": shown.uvd, "ids": shown.ids, "mask": shown.mask, "odometry": shown.odometry}
        if not options.observe_ids:
            del observation["ids"]
        observation["progress"] = shown.progress
        if self._imu is not None:
            observation["imu"] = np.clip(sensed.inertial, -MAX_INERTIAL, MAX_INERTIAL).astype(np.float32)
        if self.simulator.rules.steered:
            observation |= {"car": shown.car, "route": shown.route}
        if self.head is not None:
            observation["head"] = shown.head
        if options.render_images:
            pairs = [self.images(b) for b in range(self.num_envs)]
            observation |= {"left": np.stack([p.left for p in pairs]), "right": np.stack([p.right for p in pairs])}
        info: Arrays = {
            "truth_position": shown.position,
            "truth_orientation": shown.orientation,
            "truth_linear_velocity": shown.linear_velocity,
            "truth_angular_velocity": shown.angular_velocity,
            "time": shown.time,
            "distance": fleet.distance.copy(),
            "collision": sensed.collision.copy(),
            "failed": sensed.failed.copy(),
            "is_success": sensed.success.copy(),
        }
        if self.simulator.rules.steered:
            info["cross_track"] = sensed.beside.copy()
        if options.moving_landmarks:
            info["truth_bodies"] = self.true_bodies()
            info["truth_body_of"] = bodies_of_measurements(fleet, sensed)
        info |= {f"reward_{name}": sensed.terms[k].copy() for name, k in self._weights.items()}
        return observation, info | self._extras(shown.v_right)

    def _extras(self, v_right: FloatArray) -> Arrays:
        """Measurements that not every sensor has, see `padded_extras`."""
        rows = self.options.max_measurements
        if self._sees_images:
            each = [padded_extras(images, rows) for images in self._seen if images is not None]
            return {key: np.stack([extras[key] for extras in each]) for key in each[0]}
        measured = self.simulator.measures_right
        return {
            "v_right": v_right if measured else np.zeros_like(v_right),
            "v_right_measured": np.full(self.num_envs, measured),
            "R": np.zeros((self.num_envs, rows, 3, 3)),
            "R_measured": np.zeros(self.num_envs, dtype=np.bool_),
        }

    def get_attr(self, name: str) -> Any:
        return getattr(self, name)

    def route_of(self, b: int) -> Route:
        return self.simulator.route(b)

    def reroute(self, b: int, route: Route) -> None:
        self.simulator.reroute(b, route)

    def body(self, b: int) -> Pose:
        return self.simulator.body(b)

    def frame(self, b: int) -> Frame:
        return self.simulator.frame(b, self._seen[b])

    def start(self, b: int) -> Start:
        return self.simulator.start(b)

    def generator(self, b: int) -> np.random.Generator:
        generator = self.generators[b]
        assert generator is not None
        return generator

    def landmark_truth(self, b: int) -> LandmarkTruth:
        """Landmarks of the scene; where they are seen in images, those found so far."""
        sensor, scene = self._image_sensors[b], self.simulator.scenes[b]
        if sensor is not None:
            return sensor.landmarks
        assert scene is not None
        return LandmarkTruth(np.arange(len(scene.landmarks)), scene.landmarks)

    def angles(self) -> FloatArray:
        return self.simulator.fleet.angles

    def times(self) -> FloatArray:
        return np.asarray(self.simulator.fleet.step * FRAME_PERIOD, dtype=np.float64)

    def true_positions(self) -> FloatArray:
        return self.simulator.fleet.pose[:, :3].copy()

    def true_bodies(self) -> FloatArray:
        return bodies_now(self.simulator.fleet, self.options.moving_bodies)

    def told(self, name: str) -> FloatArray:
        if name == "distance":
            return self.simulator.fleet.distance.copy()
        return np.array(self.simulator.sensed.terms[self._weights[name.removeprefix("reward_")]], dtype=np.float64)

    def shown(self, key: str) -> NDArray[Any]:
        return np.asarray(getattr(self.simulator.show(), key))

    def measured(self, which: BoolArray) -> Measured:
        sensed = self.simulator.sensed
        is_measured = (np.arange(sensed.ids.shape[1]) < sensed.number[:, None]) & which[:, None]
        return Measured(
            np.concatenate([[0], np.cumsum(is_measured.sum(axis=1))]),
            sensed.ids[is_measured],
            sensed.uvd[is_measured],
            sensed.v_right[is_measured],
            np.full(self.num_envs, self.simulator.measures_right),
            None,
            self.times(),
            (sensed.odometry, self.simulator.odometry_covariance, self.simulator.fleet.step > 0),
        )

    def images(self, b: int) -> StereoImages:
        """Both views of a row."""
        return self._pictures[b].images(self.simulator.pose(b))

    def picture(self, b: int) -> NDArray[np.uint8]:
        """Both views of a row with the observed landmarks and the map, (H, W, 3)."""
        frame, fleet, route = self.frame(b), self.simulator.fleet, self.route_of(b)
        assert frame.truth is not None
        speed = float(np.linalg.norm(frame.truth_velocity.linear)) if frame.truth_velocity else 0.0
        caption = [
            f"route {self.options.route}",
            f"t = {frame.timestamp:.1f} s",
            f"{fleet.distance[b]:.0f} m driven",
            f"{speed:.1f} m/s",
            f"{len(frame.observation)} landmarks",
        ]
        camera, pan = (None, 0.0) if self.head is None else (self.camera, float(fleet.angles[b, 0]))
        return annotated_pair(
            self.images(b), frame.observation, caption, route.positions, frame.truth, camera=camera, pan=pan
        )

    def image_sensor(self, b: int) -> ImageSensor:
        """Front end that measures in the images of a row; a `RuntimeError` where nothing does."""
        sensor = self._image_sensors[b]
        if sensor is None or self._seen[b] is None:
            raise RuntimeError("nothing is seen in images: use sensor='images' and reset the environment first")
        return sensor

    def _make_observation_space(self) -> spaces.Dict:
        options, camera, rows = self.options, self.camera, self.options.max_measurements
        if self._sees_images:
            largest, slack = float(camera.width), _IMAGE_SLACK
        else:
            largest = camera.disparity_constant / options.tracking.nearest
            slack = self._pixel_noise.largest_error + 10.0 * options.lasting  # so the bounds hold without clipping
        high = np.array([camera.width, camera.height, largest]) + slack
        velocity = MAX_VELOCITY.astype(np.float32)
        shapes: dict[str, spaces.Space[Any]] = {
            "uvd": spaces.Box(np.full((rows, 3), np.float32(-slack)), np.tile(high, (rows, 1)).astype(np.float32)),
            "ids": spaces.Box(NO_LANDMARK, np.iinfo(np.int32).max, (rows,), np.int64),
            "mask": spaces.Box(0, 1, (rows,), np.int8),
            "odometry": spaces.Box(-velocity, velocity),
            "progress": spaces.Box(0.0, 1.0, (1,), np.float32),
        }
        if not options.observe_ids:
            del shapes["ids"]
        if self._imu is not None:
            most = np.tile(MAX_INERTIAL, (RIDE_STEPS, 1)).astype(np.float32)
            shapes["imu"] = spaces.Box(-most, most)
        if self.simulator.rules.steered:
            car = np.array([Car.max_speed, Car.max_steering], dtype=np.float32)
            shapes["car"] = spaces.Box(-car, car)
            shapes["route"] = spaces.Box(-ARENA, ARENA, (len(LOOK_AHEAD), 2), np.float32)
        if self.head is not None:
            most = np.array(self.head.max_angles, dtype=np.float32)
            shapes["head"] = spaces.Box(-most, most)
        if options.render_images:
            for view in ("left", "right"):
                shapes[view] = spaces.Box(0, 255, (camera.height, camera.width, 3), np.uint8)
        return spaces.Dict(shapes)


def keeps_scene(options: Mapping[str, Any]) -> bool:
    """Whether the options of a reset keep the scene; a `ValueError` for what is none of them."""
    if unknown := set(options) - {"scene"}:
        names = ", ".join(map(repr, sorted(unknown)))
        raise ValueError(f"reset takes no options but scene, and for vectors reset_mask, got {names}")
    if "scene" in options and options["scene"] not in ("keep", "new"):
        raise ValueError(f"scene must be 'keep' or 'new', got {options['scene']!r}")
    return options.get("scene") == "keep"
