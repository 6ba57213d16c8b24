"""Exact geometry behind the pixels of a rendered image: depth between pixel centres, points, and where they are next.

On a plane 1/z is affine in the pixel, so it is 1/z that is interpolated: that is exact.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from filters import rotations
from filters.camera import StereoCamera
from filters.validation import FloatArray, finite_array
from stereo_slam_env.recording.recording import Pose

_BEND = 2e-4
"""Neighbouring values of 1/z that leave a straight line by more than this share are not on one surface."""
_RESOLUTION = 1e-6
"""1/m: the same for surfaces far away, where the depth buffer's steps show."""


def depth_at(depth: FloatArray, uv: ArrayLike) -> FloatArray:
    """Depth of the surface seen at sub-pixel places.

    Parameters
    ----------
    depth : (H, W)
        As in `StereoImages`, m: of the pixel centres, infinity where there is nothing.
    uv : (N, 2) array_like
        px; integers are pixel centres.

    Returns
    -------
    (N,) ndarray
        z in m; infinity in the sky; NaN where the 4x4 pixels around are not on one smooth surface (an edge), and
        less than 1 px from the border or outside.

    Raises
    ------
    ValueError
        `uv` has another shape or is not finite.
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
    """Points of the world behind pixels of the left image.

    Parameters
    ----------
    camera : StereoCamera
        The rig.
    pose : Pose
        From where `depth` was rendered.
    depth : (H, W)
        m.
    uv : (N, 2) array_like
        px.

    Returns
    -------
    (N, 3) ndarray
        p_w in m; NaN where `depth_at` is not finite.
    """
    places = finite_array("uv", uv, ("N", 2))
    z = depth_at(depth, places)
    z = np.where(np.isfinite(z), z, np.nan)
    rays = camera.ray(np.column_stack([places, np.ones(len(places))]))
    points: FloatArray = pose.position + (rays * z[:, None]) @ rotations.matrix(pose.orientation).T
    return points


def measurements_of(camera: StereoCamera, pose: Pose, points_w: FloatArray) -> FloatArray:
    """Where points of the world are seen from a pose, without noise or occlusion.

    Parameters
    ----------
    camera : StereoCamera
        The rig.
    pose : Pose
        Of the left camera.
    points_w : (N, 3)
        m; NaN stays NaN.

    Returns
    -------
    (N, 3) ndarray
        (u, v, d) in px; NaN for points behind the camera.
    """
    points_c = pose.to_camera(points_w)
    return np.where(points_c[:, 2:] > 0, camera.project(points_c), np.nan)
