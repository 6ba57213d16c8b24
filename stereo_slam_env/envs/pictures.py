"""Pictures of a row: its scene through a renderer, with the faults of its cameras."""

from __future__ import annotations

import numpy as np

from filters.geometry.arrays import BoolArray, FloatArray
from filters.geometry.camera import StereoCamera
from filters.geometry.poses import Pose
from stereo_slam_env.envs.options import StereoOptions
from stereo_slam_env.rendering.backends import make_renderer
from stereo_slam_env.rendering.camera_effects import CameraEffects
from stereo_slam_env.rendering.images import StereoImages, StereoRenderer
from stereo_slam_env.sensing.rigs import CAMERA_HEIGHT
from stereo_slam_env.sensing.tracking import TrackingPolicy
from stereo_slam_env.simulator.kept import Kept
from stereo_slam_env.world.frames import WorldFrame
from stereo_slam_env.world.looks import in_fog, without_texture
from stereo_slam_env.world.physics import PhysicsWorld
from stereo_slam_env.world.routes import FRAME_PERIOD
from stereo_slam_env.world.scene import Scene
from stereo_slam_env.world.traffic import MovingPoints
from stereo_slam_env.world.vehicle import Car


class Pictures(Kept):
    """The pictures that an environment with these options takes, frame by frame."""

    changes = ("_drawn", "_textured", "_moving", "_effects", "_number", "_images")

    def __init__(self, options: StereoOptions, camera: StereoCamera) -> None:
        self._options, self._camera = options, camera
        self._frame = WorldFrame(CAMERA_HEIGHT)
        self._world = PhysicsWorld()
        self._renderer: StereoRenderer | None = None
        self._effects: CameraEffects | None = None
        self._moving = MovingPoints(())
        self._textured: Scene | None = None  # what is drawn, until it turns blank
        self._drawn: Scene | None = None
        self._images: StereoImages | None = None
        self._number = 0
        self._built: Scene | None = None  # what the renderer has: only what is looked at is built

    def build(self, scene: Scene, rng: np.random.Generator) -> None:
        """Draw another scene, by cameras whose faults are drawn from `rng`."""
        if self._options.visibility < TrackingPolicy.farthest:
            scene = in_fog(scene, self._options.visibility)
        self._moving = MovingPoints(scene.moving)
        self._effects = CameraEffects.random(rng) if self._options.randomise else None
        self._drawn = self._textured = scene

    def set_frame(self, number: int) -> None:
        """Go to a frame: moving bodies are elsewhere, and textures may be gone."""
        self._number, self._images = number, None
        blank_from = self._options.blank_from
        if self._textured is not None and blank_from is not None and self._time >= blank_from - 1e-9:
            self._drawn, self._textured = without_texture(self._textured), None

    def images(self, pose: Pose) -> StereoImages:
        """Images of the cameras at `pose`; one pose a frame."""
        if self._images is None:
            clean = self._ready().render_pair(pose, self._time)
            self._images = clean if self._effects is None else self._effects.apply(clean, self._number)
        return self._images

    def on_moving_body(self, points_w: FloatArray) -> BoolArray:
        """Which points (N, 3) are on a body that moves."""
        return self._moving.on_body(self._frame.to_scene(points_w), self._time)

    def close(self) -> None:
        """Stop the renderer; may be called at any time, also twice."""
        if self._renderer is not None:
            self._renderer.close()
        self._renderer = self._drawn = self._built = None
        self._world.close()

    @property
    def _time(self) -> float:
        return self._number * FRAME_PERIOD

    def _ready(self) -> StereoRenderer:
        """The renderer with the scene of now."""
        scene = self._drawn
        assert scene is not None
        if self._renderer is not None and self._built is scene:
            return self._renderer
        if self._options.renderer == "tiny":
            self._world.build(scene, Car().size)
        if self._renderer is None:
            self._renderer = make_renderer(
                self._options.renderer,
                camera=self._camera,
                frame=self._frame,
                world=self._world,
                supersample=self._options.supersample,
            )
        self._renderer.build(scene)
        self._built = scene
        return self._renderer
