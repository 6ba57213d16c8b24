"""Stereo images by PyBullet's TinyRenderer: on the CPU, everywhere, the same bits every time; slow."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from filters.geometry import rotations
from filters.geometry.arrays import FloatArray
from filters.geometry.camera import StereoCamera
from filters.geometry.poses import Pose
from stereo_slam_env.rendering import pinhole
from stereo_slam_env.rendering.pinhole import FAR, NEAR, ImageQuality, StereoImages
from stereo_slam_env.world.frames import WorldFrame
from stereo_slam_env.world.scene import Look, Scene
from stereo_slam_env.world.vehicle import Car


class Air:
    """Sky and haze of a look, laid over pictures of a camera on the CPU."""

    def __init__(self, camera: StereoCamera, look: Look) -> None:
        horizon, zenith = (np.array(color, dtype=np.float64) for color in (look.horizon, look.zenith))
        ramp = horizon + np.linspace(0.0, 1.0, 256)[:, None] * (zenith - horizon)
        self._camera, self._haze_range = camera, look.haze_range
        self._ramp = np.rint(ramp).astype(np.uint8).reshape(256, 1, 3)
        self._horizon = np.full((camera.height, camera.width, 3), np.rint(horizon), dtype=np.uint8)
        self._columns = np.arange(camera.width, dtype=np.float32)
        self._rows = np.arange(camera.height, dtype=np.float32)

    def over(self, rgb: NDArray[np.uint8], depth: NDArray[np.floating], R_sc: FloatArray) -> NDArray[np.uint8]:
        """Blend a picture (H, W, 3) into the haze with `depth` (H, W), m, and put the sky where that is infinite."""
        clear = np.multiply(depth, np.float32(-1.0 / self._haze_range), dtype=np.float32)
        cv2.exp(clear, dst=clear)
        blended = cv2.blendLinear(rgb, self._horizon, clear, 1.0 - clear)
        nothing = np.isinf(depth)
        rows = np.flatnonzero(nothing.any(axis=1))
        if len(rows):
            band = slice(int(rows[0]), int(rows[-1]) + 1)
            cv2.copyTo(self._sky(R_sc, band), nothing[band].view(np.uint8), blended[band])
        return np.asarray(blended, dtype=np.uint8)

    def _sky(self, R_sc: FloatArray, band: slice) -> NDArray[np.uint8]:
        a, b, c = pinhole.sky_slope(self._camera, R_sc)
        slope = np.add.outer(np.float32(b) * self._rows[band] + np.float32(c), np.float32(a) * self._columns)
        level = cv2.convertScaleAbs(cv2.sqrt(np.maximum(slope, 0.0)), alpha=255.0)
        return np.asarray(cv2.applyColorMap(level, self._ramp), dtype=np.uint8)


class TinyRenderer:
    """Draws scenes with PyBullet's software renderer; see `make_renderer` for the arguments."""

    def __init__(self, camera: StereoCamera, frame: WorldFrame, supersample: int = 1) -> None:
        from stereo_slam_env.world.physics import PhysicsWorld  # needs PyBullet

        self.camera = camera
        self._world, self._frame, self._factor = PhysicsWorld(), frame, supersample
        self._fine = pinhole.supersampled(camera, supersample)
        self._projection = pinhole.projection_matrix(self._fine, NEAR, FAR, pinhole.TINY_OFFSET)
        self._use(Look())

    @staticmethod
    def image_quality(supersample: int = 1) -> ImageQuality:
        """The nearest texel is taken: sharp, and up to half a texel off."""
        return ImageQuality(blur=0.0, texture_sigma=0.25)

    def build(self, scene: Scene) -> None:
        """Replace what is drawn by `scene`."""
        self._use(scene.look)
        self._world.build(scene, Car().size)
        self._world.dress(scene)

    def close(self) -> None:
        """Stop the engine; may be called at any time, also twice."""
        self._world.close()

    def render_pair(self, pose: Pose, time: float = 0.0) -> StereoImages:
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
