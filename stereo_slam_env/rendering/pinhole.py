"""Pinhole renderers: stereo pairs, matrices of view and projection, depth buffers, the exact surface behind a pixel."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from filters.contract.validation import finite_array
from filters.geometry import rotations
from filters.geometry.arrays import FloatArray
from filters.geometry.camera import StereoCamera
from filters.geometry.poses import Pose
from stereo_slam_env.world.scene import Scene

Image = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class StereoImages:
    """A rendered pair, RGB (H, W, 3) uint8, and depth z of the left pixel centres (H, W), m; infinity: nothing."""

    left: Image
    right: Image
    depth: FloatArray


@dataclass(frozen=True)
class ImageQuality:
    """Properties of a back end's images that a vision front end has to know."""

    blur: float
    """Variance of the point spread along an axis, px^2: that of texture filter and sampling."""
    texture_sigma: float = 0.0
    """By how much textures are displaced in a way that the correlation of patches does not show, px."""


class StereoRenderer(Protocol):
    """A back end that draws both views."""

    @staticmethod
    def image_quality(supersample: int = 1) -> ImageQuality:
        """Quality of the images, drawn so many times finer and averaged."""

    def build(self, scene: Scene) -> None:
        """Replace whatever was drawn by `scene`."""

    def render_pair(self, pose: Pose, time: float = 0.0) -> StereoImages:
        """Draw what the rig sees from `pose` (left camera in W) when moving bodies are where they are at `time` s."""

    def close(self) -> None:
        """Free what the back end holds; may be called twice."""


def grey(image: Image) -> Image:
    """The brightness of an RGB image, what a vision front end works on; (H, W, 3) or (H, W) -> (H, W) uint8."""
    if image.ndim == 2:
        return image
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), dtype=np.uint8)


OPENGL_OFFSET = (0.5, 0.5)
"""Where OpenGL samples a pixel, relative to its corner, px."""
TINY_OFFSET = (0.0, 1.0)
"""TinyRenderer samples at the corners and then flips the rows."""

ZENITH_SLOPE = 0.45
"""Upward slope of a ray at which the sky has its full colour."""
NEAR, FAR = 0.5, 300.0
"""Clipping distances of every back end, m."""

_NOTHING = 1.0 - 2.0**-22
"""TinyRenderer clears to the float32 just below 1."""
_SAME_SURFACE = 0.05
"""Neighbours whose inverse depths differ by less than this share are taken to be on one surface."""


def view_matrix(position: FloatArray, R_sc: FloatArray) -> FloatArray:
    """OpenGL view matrix (4, 4), row-major, of a camera at `position` (3,) m in S with rotation `R_sc` (3, 3)."""
    view = np.eye(4)
    view[:3, :3] = np.diag([1.0, -1.0, -1.0]) @ R_sc.T
    view[:3, 3] = -view[:3, :3] @ position
    return view


def projection_matrix(camera: StereoCamera, near: float, far: float, offset: tuple[float, float]) -> FloatArray:
    """OpenGL projection matrix (4, 4), row-major, of one camera, with clipping distances `near` and `far`, m.

    `offset` is where the renderer samples a pixel, `OPENGL_OFFSET` or `TINY_OFFSET`.
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


_BEND = 2e-4
"""Neighbouring values of 1/z that leave a straight line by more than this share are not on one surface."""
_RESOLUTION = 1e-6
"""1/m: the same for surfaces far away, where the depth buffer's steps show."""


def depth_at(depth: FloatArray, uv: ArrayLike) -> FloatArray:
    """Depth z, m, of the surface seen at sub-pixel places `uv` (N, 2), px; `depth` (H, W) as in `StereoImages`; (N,).

    Infinity in the sky; NaN where the 4x4 pixels around are not on one smooth surface (an edge), and less than 1 px
    from the border or outside. A `ValueError` where `uv` has another shape or is not finite.
    """
    places = finite_array("uv", uv, ("N", 2))
    height, width = depth.shape
    corner = np.floor(places).astype(np.int64)
    inside = (corner >= 1).all(axis=1) & (corner[:, 0] < width - 2) & (corner[:, 1] < height - 2)
    z = np.full(len(places), np.nan)
    corner, part = corner[inside], (places - corner)[inside]
    around = np.arange(-1, 3)
    with np.errstate(divide="ignore"):
        inverse = 1.0 / depth[corner[:, 1, None, None] + around[:, None], corner[:, 0, None, None] + around]
    tolerance = _BEND * inverse.max(axis=(1, 2)) + _RESOLUTION
    bend = np.maximum(np.abs(np.diff(inverse, 2, axis=1)).max(axis=(1, 2)),
                      np.abs(np.diff(inverse, 2, axis=2)).max(axis=(1, 2)))  # fmt: skip
    u, v = part.T
    top = (1 - u) * inverse[:, 1, 1] + u * inverse[:, 1, 2]
    bottom = (1 - u) * inverse[:, 2, 1] + u * inverse[:, 2, 2]
    mixed = (inverse == 0).any(axis=(1, 2)) & (inverse > 0).any(axis=(1, 2))
    with np.errstate(divide="ignore"):
        z[inside] = np.where((bend <= tolerance) & ~mixed, 1.0 / ((1 - v) * top + v * bottom), np.nan)
    return z


def points_at(camera: StereoCamera, pose: Pose, depth: FloatArray, uv: ArrayLike) -> FloatArray:
    """Points p_w (N, 3), m, behind pixels `uv` (N, 2) of a left image rendered from `pose`; NaN as in `depth_at`."""
    places = finite_array("uv", uv, ("N", 2))
    z = depth_at(depth, places)
    z = np.where(np.isfinite(z), z, np.nan)
    rays = camera.ray(np.column_stack([places, np.ones(len(places))]))
    points: FloatArray = pose.position + (rays * z[:, None]) @ rotations.matrix(pose.orientation).T
    return points


def sky_slope(camera: StereoCamera, R_sc: FloatArray) -> tuple[float, float, float]:
    """Slope of the ray through a pixel, in units of `ZENITH_SLOPE`: (a, b, c) of a u + b v + c."""
    right, down, forward = R_sc[2] / ZENITH_SLOPE
    a, b = right / camera.fx, down / camera.fy
    return float(a), float(b), float(forward - a * camera.cx - b * camera.cy)
