"""View and projection matrices of a pinhole camera, as pure functions.

Pixels: integer (u, v) is the centre of a pixel, u = fx x/z + cx, v = fy y/z + cy.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from filters.camera import StereoCamera
from filters.validation import FloatArray

OPENGL_OFFSET = (0.5, 0.5)
"""Where OpenGL samples a pixel, relative to its corner, px."""
TINY_OFFSET = (0.0, 1.0)
"""TinyRenderer samples at the corners and then flips the rows."""

_NOTHING = 1.0 - 2.0**-22
"""TinyRenderer clears to the float32 just below 1."""


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


def metric_depth(buffer: FloatArray, near: float, far: float) -> FloatArray:
    """Depth z in m from an OpenGL depth buffer in 0..1; infinity where nothing was drawn."""
    buffer = np.asarray(buffer, dtype=np.float64)
    z: FloatArray = far * near / (far - (far - near) * buffer)
    return np.where(buffer < _NOTHING, z, np.inf)


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
