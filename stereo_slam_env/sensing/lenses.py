"""Lenses as they are, and the rectification of a raw stereo pair by OpenCV: found once, its maps kept."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, Literal

import numpy as np

from filters import StereoCamera
from filters.geometry.arrays import FloatArray
from stereo_slam_env.recording.recording import GreyImage
from stereo_slam_env.sensing.projections import rectified_rig

LensModel = Literal["radial-tangential", "equidistant"]
COEFFICIENTS = {"radial-tangential": (0, 4, 5, 8, 12, 14), "equidistant": (0, 4)}
"""Numbers of coefficients that a model may have; none: an ideal pinhole."""
Rectify = Callable[[GreyImage, GreyImage], tuple[GreyImage, GreyImage]]
_ROUNDING = 1e-9
_LEAST_ZOOM = 0.3
"""Rectified focal length over that of a fisheye: below, the middle of its images is too coarse to be of use."""
_NO_BASELINE = 1e-9
"""m: what is left of a baseline where the poses of both cameras are the same."""


_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Lens:
    """A camera with its lens, as a calibration has it."""

    fx: float
    """Focal length along a row, px."""
    fy: float
    """Focal length along a column, px."""
    cx: float
    """Principal point, px."""
    cy: float
    """Principal point, px."""
    width: int
    """Of the images, px."""
    height: int
    """Of the images, px."""
    distortion: tuple[float, ...] = ()
    """k1, k2, p1, p2, (k3, ...) of a radial-tangential lens, k1 to k4 of an equidistant one, in OpenCV's order."""
    model: LensModel = "radial-tangential"
    """OpenCV's pinhole model, or its fisheye model (Kannala and Brandt)."""

    def __post_init__(self) -> None:
        if len(self.distortion) not in COEFFICIENTS[self.model]:
            counts = ", ".join(map(str, COEFFICIENTS[self.model]))
            raise ValueError(f"a lens that is {self.model} has {counts} coefficients, got {len(self.distortion)}")
        numbers = (self.fx, self.fy, self.cx, self.cy, *self.distortion)
        if not np.isfinite(numbers).all() or min(self.fx, self.fy) <= 0:
            raise ValueError(f"focal lengths of a lens must be positive and all its numbers finite, got {numbers}")

    @property
    def K(self) -> FloatArray:
        """Camera matrix (3, 3), px."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @property
    def size(self) -> tuple[int, int]:
        """Width and height, px."""
        return self.width, self.height

    @property
    def coefficients(self) -> FloatArray:
        """The distortion as OpenCV takes it, zeros where there is none."""
        return np.array(self.distortion or (0.0,) * 4)


@dataclass(frozen=True, eq=False)
class Rectification:
    """A raw stereo pair turned to a common plane and freed of distortion."""

    lenses: tuple[Lens, Lens]
    """Left and right."""
    turns: tuple[FloatArray, FloatArray]
    """(3, 3) each: from the camera as it is mounted to the rectified one."""
    projections: tuple[FloatArray, FloatArray]
    """(3, 4) each: K [I | t] of the rectified cameras."""
    camera: StereoCamera
    """The rectified rig."""
    mapped: tuple[bool, bool] = (True, True)
    """Whether the images of the left and of the right camera are raw; others are rectified already, and left alone."""

    @property
    def R_left(self) -> FloatArray:
        """(3, 3): from the left camera as it is mounted to the rectified one; none where its images are rectified."""
        return self.turns[0] if self.mapped[0] else np.eye(3)

    @cached_property
    def changes(self) -> tuple[bool, bool]:
        """Whether rectified images of the left and of the right camera differ from raw ones."""
        left, right = (
            any(lens.distortion)
            or np.abs(R - np.eye(3)).max() > _ROUNDING
            or np.abs(P[:, :3] - lens.K).max() > _ROUNDING * lens.fx
            for lens, R, P in zip(self.lenses, self.turns, self.projections, strict=True)
        )
        return bool(left), bool(right)

    @property
    def needed(self) -> bool:
        """Whether rectified images are others than those taken."""
        return any(changed and mapped for changed, mapped in zip(self.changes, self.mapped, strict=True))

    @cached_property
    def _maps(self) -> list[tuple[Any, Any]]:
        import cv2

        maps = []
        for lens, R, P in zip(self.lenses, self.turns, self.projections, strict=True):
            undistort = (
                cv2.fisheye.initUndistortRectifyMap if lens.model == "equidistant" else cv2.initUndistortRectifyMap
            )
            maps.append(undistort(lens.K, lens.coefficients, R, P[:, :3], lens.size, cv2.CV_16SC2))
        return maps

    def __call__(self, left: GreyImage, right: GreyImage) -> tuple[GreyImage, GreyImage]:
        """Rectified images of those of the left and of the right camera, (H, W) uint8."""
        if not self.needed:
            return left, right
        import cv2

        turned = [
            np.asarray(cv2.remap(image, *both, interpolation=cv2.INTER_LINEAR), dtype=np.uint8) if mapped else image
            for image, both, mapped in zip((left, right), self._maps, self.mapped, strict=True)
        ]
        return turned[0], turned[1]


def require_rotation(R: FloatArray, where: str, what: str) -> None:
    """A `ValueError` that names the calibration where a matrix (3, 3) is no rotation, to 1e-3."""
    if not (np.abs(R @ R.T - np.eye(3)) <= 1e-3).all() or np.linalg.det(R) < 0:
        raise ValueError(f"{where}: {what} holds no rotation: take the calibration again")


@lru_cache(maxsize=8)
def rectification(left: Lens, right: Lens, T_rl: tuple[float, ...], where: str) -> Rectification:
    """The rectification of two lenses by OpenCV; only pixels that both images have are kept (alpha 0).

    Parameters
    ----------
    left, right : Lens
        Both with one size of images and one lens model.
    T_rl : 16 floats
        (4, 4), row by row: takes points of the left camera to the right one, m.
    where : str
        The calibration, for messages.

    Raises
    ------
    ValueError
        The cameras are no rig, or are none side by side; the message names `where`.
    """
    import cv2

    if left.size != right.size:
        raise ValueError(f"{where}: the images are {right.size}, those of the left camera {left.size}: not one rig")
    if left.model != right.model:
        raise ValueError(f"{where}: one lens is {left.model}, the other {right.model}: OpenCV rectifies neither")
    T = np.reshape(T_rl, (4, 4))
    R = T[:3, :3]
    require_rotation(R, where, "the pose between the cameras")
    turn, shift = np.ascontiguousarray(R), np.ascontiguousarray(T[:3, 3:])
    if np.linalg.norm(shift) < _NO_BASELINE:
        raise ValueError(f"{where}: both cameras are in one place, T is zero: a rig has a baseline, in metres")
    if abs(shift[1, 0]) > abs(shift[0, 0]):
        raise ValueError(
            f"{where}: the right camera is {-shift[1, 0]:+.4g} m below the left one and {-shift[0, 0]:+.4g} m beside "
            "it, a vertical pair: only cameras side by side are read, so turn images and calibration by 90 degrees"
        )
    if _is_rectified(left, right, T):  # OpenCV would find the same, to seven digits
        P_left, shift_right = np.column_stack([left.K, np.zeros(3)]), np.zeros((3, 4))
        shift_right[0, 3] = left.fx * shift[0, 0]
        return stated_rectification((left, right), (np.eye(3), np.eye(3)), (P_left, P_left + shift_right), where)
    of_both = left.K, left.coefficients, right.K, right.coefficients, left.size, turn, shift
    maps: Any
    try:
        if left.model == "equidistant":
            maps = cv2.fisheye.stereoRectify(*of_both, flags=cv2.CALIB_ZERO_DISPARITY, balance=0.0)
        else:
            maps = cv2.stereoRectify(*of_both, flags=cv2.CALIB_ZERO_DISPARITY, alpha=0)
    except cv2.error as error:
        reason = str(error).splitlines()[0]
        raise ValueError(f"{where}: OpenCV cannot rectify this pair ({reason}): take the calibration again") from error
    R_left, R_right, P_left, P_right = (np.asarray(matrix, dtype=np.float64) for matrix in maps[:4])
    if left.model == "equidistant" and not (np.isfinite(P_left).all() and P_left[0, 0] > _LEAST_ZOOM * left.fx):
        P_left, P_right = _narrowed(left, P_left, P_right, where)
    turns, projections = (R_left, R_right), (P_left, P_right)
    camera = rectified_rig(where, *projections, left.size)
    return Rectification((left, right), turns, projections, camera)


def _is_rectified(left: Lens, right: Lens, T_rl: FloatArray) -> bool:
    """Whether two lenses are one ideal pinhole each, the same one, side by side along x."""
    apart = T_rl - np.eye(4)
    apart[0, 3] = 0.0
    ideal = left.model == "radial-tangential" and not any((*left.distortion, *right.distortion))
    return ideal and np.array_equal(left.K, right.K) and bool(np.abs(apart).max() <= _ROUNDING and T_rl[0, 3] < 0)


def _narrowed(lens: Lens, P_left: FloatArray, P_right: FloatArray, where: str) -> tuple[FloatArray, FloatArray]:
    """Projections with the focal length of the lens, so that its middle keeps its resolution.

    No plane holds all that a lens of 180 degrees sees, and one of nearly so much would be all edge.
    """
    K = np.array([[lens.fx, 0.0, 0.5 * (lens.width - 1)], [0.0, lens.fx, 0.5 * (lens.height - 1)], [0.0, 0.0, 1.0]])
    baseline = -P_right[0, 3] / P_right[0, 0]
    field = np.rad2deg(2.0 * np.arctan(0.5 * lens.width / lens.fx))
    _log.warning(
        "%s: its field of view is too wide for a plane (fx would be %.4g px): fx %.4g px is taken, %.0f degrees",
        *(where, P_left[0, 0], lens.fx, field),
    )
    return np.column_stack([K, np.zeros(3)]), np.column_stack([K, [-lens.fx * baseline, 0.0, 0.0]])


def stated_rectification(
    lenses: tuple[Lens, Lens], turns: tuple[FloatArray, FloatArray], P: tuple[FloatArray, FloatArray], where: str
) -> Rectification:
    """The rectification that a calibration states by its R (3, 3) and P (3, 4) of both cameras."""
    for R in turns:
        require_rotation(R, where, "the rectification matrix")
    return Rectification(lenses, turns, P, rectified_rig(where, *P, lenses[0].size))
