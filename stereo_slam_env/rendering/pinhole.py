"""View and projection matrices of a pinhole camera, as pure functions.

Pixels: integer (u, v) is the centre of a pixel, u = fx x/z + cx, v = fy y/z + cy.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import DTypeLike, NDArray

from filters.camera import StereoCamera
from filters.validation import FloatArray

OPENGL_OFFSET = (0.5, 0.5)
"""Where OpenGL samples a pixel, relative to its corner, px."""
TINY_OFFSET = (0.0, 1.0)
"""TinyRenderer samples at the corners and then flips the rows."""

NEAR, FAR = 0.5, 300.0
"""Clipping distances of every back end, m."""

_NOTHING = 1.0 - 2.0**-22
"""TinyRenderer clears to the float32 just below 1."""
_SAME_SURFACE = 0.05
"""Neighbours whose inverse depths differ by less than this share are taken to be on one surface."""


def view_matrix(position: FloatArray, R_sc: FloatArray) -> FloatArray:
    """OpenGL view matrix of a camera (x right, y down, z forward) in a scene.

    Parameters
    ----------
    position : (3,)
        Camera position in the scene, m.
    R_sc : (3, 3)
        Takes camera vectors into the scene.

    Returns
    -------
    (4, 4) ndarray
        Row-major.
    """
    view = np.eye(4)
    view[:3, :3] = np.diag([1.0, -1.0, -1.0]) @ R_sc.T
    view[:3, 3] = -view[:3, :3] @ position
    return view


def projection_matrix(camera: StereoCamera, near: float, far: float, offset: tuple[float, float]) -> FloatArray:
    """OpenGL projection matrix of one eye.

    Parameters
    ----------
    camera : StereoCamera
        Intrinsics and image size.
    near, far : float
        Clipping distances, m.
    offset : tuple of float
        Sampling position of the renderer: `OPENGL_OFFSET` or `TINY_OFFSET`.

    Returns
    -------
    (4, 4) ndarray
        Row-major.
    """
    w, h, (ox, oy) = camera.width, camera.height, offset
    return np.array(
        [
            [2 * camera.fx / w, 0.0, 1 - 2 * (camera.cx + ox) / w, 0.0],
            [0.0, 2 * camera.fy / h, 2 * (camera.cy + oy) / h - 1, 0.0],
            [0.0, 0.0, -(far + near) / (far - near), -2 * far * near / (far - near)],
            [0.0, 0.0, -1.0, 0.0],
        ]
    )


def metric_depth(buffer: NDArray[np.floating], near: float, far: float, dtype: DTypeLike = np.float64) -> NDArray[Any]:
    """Depth z in m from an OpenGL depth buffer in 0..1, in `dtype`; infinity where nothing was drawn."""
    slope = 1.0 / near - 1.0 / far
    inverse: NDArray[Any] = np.multiply(buffer, np.array(-slope, dtype=dtype), dtype=dtype)
    inverse += np.array(1.0 / near, dtype=dtype)
    cv2.threshold(inverse, 1.0 / near - slope * _NOTHING, 0.0, cv2.THRESH_TOZERO, dst=inverse)
    with np.errstate(divide="ignore"):
        np.divide(np.array(1.0, dtype=dtype), inverse, out=inverse)
    return inverse


def supersampled(camera: StereoCamera, factor: int) -> StereoCamera:
    """The camera with `factor` times the pixels, so that averaging blocks of them gives the image of `camera`."""
    return replace(
        camera,
        fx=camera.fx * factor,
        fy=camera.fy * factor,
        cx=factor * (camera.cx + 0.5) - 0.5,
        cy=factor * (camera.cy + 0.5) - 0.5,
        width=camera.width * factor,
        height=camera.height * factor,
    )


def averaged(image: NDArray[np.uint8], factor: int) -> NDArray[np.uint8]:
    """The image of a camera from that of its `supersampled` one; (H f, W f, 3) -> (H, W, 3)."""
    if factor == 1:
        return image
    size = (image.shape[1] // factor, image.shape[0] // factor)
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def centre_depth(depth: FloatArray, factor: int) -> FloatArray:
    """Depth at the pixel centres of a camera from that of its `supersampled` one; (H f, W f) -> (H, W)."""
    middle = factor // 2
    here = np.ascontiguousarray(depth[middle::factor, middle::factor])
    if factor % 2:
        return here
    # No sample is in the centre: on a plane the mean of 1/z of the four around it is exact.
    rows, columns = slice(middle - 1, None, factor), slice(middle - 1, None, factor)
    corners = 1.0 / np.stack([here, depth[rows, middle::factor], depth[middle::factor, columns], depth[rows, columns]])
    inverse = corners.mean(axis=0)
    on_surface = np.ptp(corners, axis=0) < _SAME_SURFACE * inverse
    return np.where(on_surface, 1.0 / np.where(on_surface, inverse, 1.0), here)
