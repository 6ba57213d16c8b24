"""Stereo images by PyBullet's TinyRenderer: on the CPU, everywhere, the same bits every time; slow."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from filters import rotations
from filters.camera import StereoCamera
from filters.validation import FloatArray
from stereo_slam_env.recording.recording import Pose
from stereo_slam_env.rendering import pinhole
from stereo_slam_env.rendering.air import Air
from stereo_slam_env.rendering.images import StereoImages
from stereo_slam_env.rendering.pinhole import FAR, NEAR
from stereo_slam_env.world.frames import WorldFrame
from stereo_slam_env.world.physics import PhysicsWorld
from stereo_slam_env.world.scene import Look, Scene


class TinyRenderer:
    """Draws a built `PhysicsWorld`.

    Parameters
    ----------
    world : PhysicsWorld
        Built; `build` adds what is drawn.
    camera : StereoCamera
        The rig.
    frame : WorldFrame
        Where W sits in the scene.
    supersample : int
        Draw this many times finer and average: smoother edges, for the square of the time.
    """

    def __init__(self, world: PhysicsWorld, camera: StereoCamera, frame: WorldFrame, supersample: int = 1) -> None:
        self.camera = camera
        self._world, self._frame, self._factor = world, frame, supersample
        self._fine = pinhole.supersampled(camera, supersample)
        self._projection = pinhole.projection_matrix(self._fine, NEAR, FAR, pinhole.TINY_OFFSET)
        self._use(Look())

    def build(self, scene: Scene) -> None:
        """Make `scene`, which the world was built from, visible."""
        self._use(scene.look)
        self._world.dress(scene)

    def close(self) -> None:
        """Nothing: the world is its owner's to close."""

    def render_pair(self, pose: Pose, time: float = 0.0) -> StereoImages:
        """Draw what the rig sees from `pose` (left camera in W) when moving bodies are where they are at `time` s.

        Returns
        -------
        StereoImages
            The depth is that of the pixel centres, never averaged.
        """
        self._world.set_time(time)
        R_wc = rotations.matrix(pose.orientation)
        left, buffer = self._draw(pose.position, R_wc)
        right, _ = self._draw(pose.position + self.camera.baseline * R_wc[:, 0], R_wc)
        depth = pinhole.metric_depth(buffer, NEAR, FAR)
        return StereoImages(left, right, pinhole.centre_depth(depth, self._factor))

    def _use(self, look: Look) -> None:
        self._look, self._air = look, Air(self._fine, look)

    def _draw(self, position_w: FloatArray, R_wc: FloatArray) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        fine, look, R_sc = self._fine, self._look, self._frame.rotation_to_scene(R_wc)
        view = pinhole.view_matrix(self._frame.to_scene(position_w), R_sc)
        rgb, buffer = self._world.camera_image(
            view, self._projection, fine.width, fine.height, look.sun, look.ambient, look.diffuse
        )
        image = self._air.over(rgb, pinhole.metric_depth(buffer, NEAR, FAR, np.float32), R_sc)
        return pinhole.averaged(image, self._factor), buffer
