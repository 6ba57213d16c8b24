"""Stereo images by PyBullet's TinyRenderer: on the CPU, everywhere, the same bits every time; slow."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from filters import rotations
from filters.camera import StereoCamera
from filters.validation import FloatArray
from stereo_slam_env.recording import Pose
from stereo_slam_env.rendering import pinhole
from stereo_slam_env.rendering.images import StereoImages
from stereo_slam_env.world.frames import WorldFrame
from stereo_slam_env.world.physics import PhysicsWorld
from stereo_slam_env.world.scene import Scene

NEAR, FAR = 0.5, 300.0
_SUN = (0.35, 0.55, 0.9)
_HORIZON = np.array([219.0, 228.0, 236.0])
_ZENITH = np.array([112.0, 160.0, 212.0])
_ZENITH_SLOPE = 0.45
"""Upward slope of a ray at which the sky has its full colour."""
_HAZE_RANGE = 260.0
"""m: how far one sees through the haze that softens the distance."""


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

    def build(self, scene: Scene) -> None:
        """Make `scene`, which the world was built from, visible."""
        self._world.dress(scene)

    def close(self) -> None:
        """Nothing: the world is its owner's to close."""

    def render_pair(self, pose: Pose, time: float = 0.0) -> StereoImages:
        """Draw what the rig sees from `pose` (left camera in W).

        Returns
        -------
        StereoImages
            The depth is that of the pixel centres, never averaged.
        """
        R_wc = rotations.matrix(pose.orientation)
        left, depth = self._draw(pose.position, R_wc)
        right, _ = self._draw(pose.position + self.camera.baseline * R_wc[:, 0], R_wc)
        return StereoImages(left, right, depth)

    def _draw(self, position_w: FloatArray, R_wc: FloatArray) -> tuple[NDArray[np.uint8], FloatArray]:
        fine = self._fine
        view = pinhole.view_matrix(self._frame.to_scene(position_w), self._frame.rotation_to_scene(R_wc))
        rgb, buffer = self._world.camera_image(view, self._projection, fine.width, fine.height, _SUN)
        depth = pinhole.metric_depth(np.asarray(buffer, dtype=np.float64), NEAR, FAR)
        image = _with_air(rgb, depth, fine, R_wc)
        if self._factor == 1:
            return image, depth
        size = (self.camera.width, self.camera.height)
        averaged = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        middle = self._factor // 2
        return averaged, np.ascontiguousarray(depth[middle :: self._factor, middle :: self._factor])


def _with_air(rgb: NDArray[np.uint8], depth: FloatArray, camera: StereoCamera, R_wc: FloatArray) -> NDArray[np.uint8]:
    """Blend into haze with distance, and put the sky where nothing was drawn."""
    x = (np.arange(camera.width, dtype=np.float32) - np.float32(camera.cx)) / np.float32(camera.fx)
    y = (np.arange(camera.height, dtype=np.float32) - np.float32(camera.cy)) / np.float32(camera.fy)
    up = (-R_wc[1]).astype(np.float32)
    slope = (up[0] * x + up[2])[None, :] + (up[1] * y)[:, None]
    clear = np.exp(np.float32(-1.0 / _HAZE_RANGE) * depth.astype(np.float32))[..., None]
    height = np.sqrt(np.clip(slope / np.float32(_ZENITH_SLOPE), 0.0, 1.0))[..., None]
    sky = _HORIZON.astype(np.float32) + height * (_ZENITH - _HORIZON).astype(np.float32)
    haze = np.where(np.isinf(depth)[..., None], sky, _HORIZON.astype(np.float32))
    blended: NDArray[np.uint8] = np.rint(clear * rgb + (1.0 - clear) * haze).astype(np.uint8)
    return blended
