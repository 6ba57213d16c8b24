"""Sky and haze, laid over a picture on the CPU."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from filters.camera import StereoCamera
from filters.validation import FloatArray
from stereo_slam_env.world.scene import Look

ZENITH_SLOPE = 0.45
"""Upward slope of a ray at which the sky has its full colour."""


def sky_slope(camera: StereoCamera, R_sc: FloatArray) -> tuple[float, float, float]:
    """How steeply the ray through a pixel rises, in units of `ZENITH_SLOPE`: (a, b, c) of a u + b v + c.

    Parameters
    ----------
    camera : StereoCamera
        The rig.
    R_sc : (3, 3)
        Takes camera vectors into the scene.
    """
    right, down, forward = R_sc[2] / ZENITH_SLOPE
    a, b = right / camera.fx, down / camera.fy
    return float(a), float(b), float(forward - a * camera.cx - b * camera.cy)


class Air:
    """What lies between the camera and the things, and behind them.

    Parameters
    ----------
    camera : StereoCamera
        Its image size and lens.
    look : Look
        Colours and haze.
    """

    def __init__(self, camera: StereoCamera, look: Look) -> None:
        horizon, zenith = (np.array(color, dtype=np.float64) for color in (look.horizon, look.zenith))
        ramp = horizon + np.linspace(0.0, 1.0, 256)[:, None] * (zenith - horizon)
        self._camera, self._haze_range = camera, look.haze_range
        self._ramp = np.rint(ramp).astype(np.uint8).reshape(256, 1, 3)
        self._horizon = np.full((camera.height, camera.width, 3), np.rint(horizon), dtype=np.uint8)
        self._columns = np.arange(camera.width, dtype=np.float32)
        self._rows = np.arange(camera.height, dtype=np.float32)

    def over(self, rgb: NDArray[np.uint8], depth: NDArray[np.floating], R_sc: FloatArray) -> NDArray[np.uint8]:
        """Blend a picture into the haze with distance, and put the sky where nothing was drawn.

        Parameters
        ----------
        rgb : (H, W, 3) uint8
            What was drawn.
        depth : (H, W)
            m; infinity where there is nothing.
        R_sc : (3, 3)
            Takes camera vectors into the scene.
        """
        clear = np.multiply(depth, np.float32(-1.0 / self._haze_range), dtype=np.float32)
        cv2.exp(clear, dst=clear)
        seen = cv2.blendLinear(rgb, self._horizon, clear, 1.0 - clear)
        nothing = np.isinf(depth)
        rows = np.flatnonzero(nothing.any(axis=1))
        if len(rows):
            band = slice(int(rows[0]), int(rows[-1]) + 1)
            cv2.copyTo(self._sky(R_sc, band), nothing[band].view(np.uint8), seen[band])
        return np.asarray(seen, dtype=np.uint8)

    def _sky(self, R_sc: FloatArray, band: slice) -> NDArray[np.uint8]:
        a, b, c = sky_slope(self._camera, R_sc)
        slope = np.add.outer(np.float32(b) * self._rows[band] + np.float32(c), np.float32(a) * self._columns)
        level = cv2.convertScaleAbs(cv2.sqrt(np.maximum(slope, 0.0)), alpha=255.0)
        return np.asarray(cv2.applyColorMap(level, self._ramp), dtype=np.uint8)
