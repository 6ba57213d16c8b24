"""The simulated world of an environment: scene, physics and renderer through one interface, in W."""

from __future__ import annotations

import numpy as np

from filters.geometry.camera import StereoCamera
from filters.geometry.poses import Pose
from filters.validation import BoolArray, FloatArray
from stereo_slam_env.envs.options import StereoOptions
from stereo_slam_env.recording.recording import LandmarkTruth
from stereo_slam_env.rendering.backends import make_renderer
from stereo_slam_env.rendering.camera_effects import CameraEffects
from stereo_slam_env.rendering.images import StereoImages, StereoRenderer
from stereo_slam_env.sensing.rigs import CAMERA_HEIGHT
from stereo_slam_env.sensing.sensors import TrackingPolicy
from stereo_slam_env.world.frames import R_SW, WorldFrame
from stereo_slam_env.world.looks import in_fog, without_texture
from stereo_slam_env.world.physics import PhysicsWorld
from stereo_slam_env.world.routes import FRAME_PERIOD, Route
from stereo_slam_env.world.scene import Scene
from stereo_slam_env.world.surroundings import build_scene
from stereo_slam_env.world.traffic import MovingPoints
from stereo_slam_env.world.vehicle import Car


class Stage:
    """The simulated world of one environment: built along `route`, seen by `camera`, hit by the body of `car`."""

    def __init__(self, options: StereoOptions, route: Route, camera: StereoCamera, car: Car) -> None:
        self._options, self._route, self._camera, self._car = options, route, camera, car
        self._frame = WorldFrame(CAMERA_HEIGHT)
        self._world = PhysicsWorld()
        self._renderer: StereoRenderer | None = None
        self._effects: CameraEffects | None = None
        self._moving = MovingPoints(())
        self._textured: Scene | None = None  # what is drawn, until it turns blank
        self._images: StereoImages | None = None
        self._number = 0
        self.landmarks = LandmarkTruth(np.zeros(0, dtype=np.int64), np.zeros((0, 3)))
        """On the surfaces of the scene."""

    def build(self, scene_rng: np.random.Generator, camera_rng: np.random.Generator, *, draws: bool) -> None:
        """A new scene; `draws` says whether `images` will be asked for."""
        options = self._options
        scene = build_scene(
            options.surroundings,
            self._route,
            scene_rng,
            moving_cars=options.moving_cars,
            pedestrians=options.pedestrians,
            randomise=options.randomise,
        )
        if self._options.visibility < TrackingPolicy.farthest:
            scene = in_fog(scene, self._options.visibility)
        self._world.build(scene, self._car.size)
        self._moving = MovingPoints(scene.moving)
        self._effects = CameraEffects.random(camera_rng) if options.randomise else None
        self._textured = None
        if draws:
            self._build_renderer(scene)
            self._textured = scene
        self.landmarks = LandmarkTruth(scene.landmark_ids, self._frame.to_world(scene.landmark_points))

    def set_frame(self, number: int) -> None:
        """Move the moving bodies to their places in frame `number`."""
        self._number, self._images = number, None
        blank_from = self._options.blank_from
        if self._textured is not None and blank_from is not None and self._time >= blank_from - 1e-9:
            blank = without_texture(self._textured)
            self._world.build(blank, self._car.size)
            self._build_renderer(blank)
            self._textured = None
        self._world.set_time(self._time)

    def images(self, pose: Pose) -> StereoImages:
        """Images of the cameras at `pose`; one pose a frame."""
        if self._images is None:
            assert self._renderer is not None
            clean = self._renderer.render_pair(pose, self._time)
            self._images = clean if self._effects is None else self._effects.apply(clean, self._number)
        return self._images

    def visible(self, pose: Pose, points_w: FloatArray) -> BoolArray:
        """Which points (N, 3) both cameras see from `pose`."""
        right = pose.position + self._camera.baseline * pose.R_wc[:, 0]
        cameras = self._frame.to_scene(np.array([pose.position, right]))
        return self._world.visible(cameras, self._frame.to_scene(points_w))

    def on_moving_body(self, points_w: FloatArray) -> BoolArray:
        """Which points (N, 3) are on a body that moves."""
        return self._moving.on_body(self._frame.to_scene(points_w), self._time)

    def collides(self, pose: Pose) -> bool:
        """Whether the car touches something when its camera, looking straight ahead, is at `pose`."""
        R_wc = pose.R_wc
        body = pose.position + R_wc @ np.array(self._car.body_c)
        R_sb = self._frame.rotation_to_scene(R_wc) @ R_SW.T
        return self._world.ego_collides(self._frame.to_scene(body), R_sb)

    def close(self) -> None:
        """Stop physics and renderer; may be called at any time, also twice."""
        if self._renderer is not None:
            self._renderer.close()
        self._renderer = None
        self._world.close()

    @property
    def _time(self) -> float:
        return self._number * FRAME_PERIOD

    def _build_renderer(self, scene: Scene) -> None:
        if self._renderer is None:
            self._renderer = make_renderer(
                self._options.renderer,
                camera=self._camera,
                frame=self._frame,
                world=self._world,
                supersample=self._options.supersample,
            )
        self._renderer.build(scene)
