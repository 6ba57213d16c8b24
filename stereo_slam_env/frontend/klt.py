"""The usual front end of visual odometry: corners followed by OpenCV's Lucas-Kanade, in time and to the right."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from filters import Forecast, StereoCamera, StereoNoise
from filters.contract.validation import positive
from filters.geometry.arrays import BoolArray, FloatArray
from stereo_slam_env.frontend.settings import TrackerSettings
from stereo_slam_env.frontend.tracks import TrackedPair, require_legal, require_pair
from stereo_slam_env.recording.recording import GreyImage

SIGMA = 0.5
"""Standard deviation that is claimed for a pixel coordinate, px: what is commonly assumed; LK does not measure it."""
Points = NDArray[np.float32]
"""(N, 2) px, as OpenCV takes them."""
_WINDOW, _LEVELS = (21, 21), 3
_RETURNS = 0.5
"""Followed back, a point must come home to within this, px."""
_ROWS = 1.0
"""Rows of both images may differ by this, px."""
_EPIPOLAR = 1.0
"""Distance from the epipolar line beyond which RANSAC drops a point, px."""
_QUALITY = 0.01
_FEWEST = 8
"""Points for a fundamental matrix."""


class KLTFrontEnd:
    """Shi-Tomasi corners followed by pyramidal Lucas-Kanade (OpenCV), with one constant covariance.

    Points are followed from the left image to the next left one, checked backwards and against the epipolar geometry
    (RANSAC), then from left to right. The covariance claimed is that of independent pixels of `SIGMA`, or of
    `settings.sigma_floor` where that is more. A forecast is not used.

    Parameters
    ----------
    camera : StereoCamera
        The rectified rig.
    settings : TrackerSettings, optional
        Used are `max_landmarks`, `refill_below`, `min_distance`, `margin`, `min_disparity`, `nearest`, `max_misses`,
        `sigma_floor` and `disparity_offset`.
    """

    def __init__(self, camera: StereoCamera, settings: TrackerSettings | None = None) -> None:
        self.camera = camera
        self.settings = TrackerSettings() if settings is None else settings
        self._R = StereoNoise.independent_pixels(max(SIGMA, self.settings.sigma_floor)).R
        self.reset()

    def reset(self) -> None:
        """Forget everything; ids begin at 0 again."""
        self._left: GreyImage | None = None
        self._ids = np.zeros(0, dtype=np.int64)
        self._uv: Points = np.zeros((0, 2), dtype=np.float32)
        self._misses = np.zeros(0, dtype=np.int64)
        self._known, self._next = np.zeros(0, dtype=np.int64), 0

    def track(
        self, left: GreyImage, right: GreyImage, dt: float | None = None, forecast: Forecast | None = None
    ) -> TrackedPair:
        """Follow the landmarks to the next pair and find new ones, see `FrontEnd`."""
        require_pair(self.camera, left, right)
        if forecast is not None:
            require_legal(forecast)
        before = self._ids
        if self._left is not None:
            if dt is None:
                raise ValueError("dt must be given from the second pair on, got None")
            positive("dt", dt)
            self._follow(left)
        if len(self._ids) < self.settings.refill_below:
            self._refill(left)
        disparity, seen = self._disparities(left, right)
        self._misses = np.where(seen, 0, self._misses + 1)
        ids = self._ids[seen]
        uvd = np.column_stack([self._uv[seen].astype(np.float64), disparity[seen]])
        fresh = ids[~np.isin(ids, self._known)]
        kept = (self._misses <= self.settings.max_misses) & (seen | np.isin(self._ids, self._known))
        self._select(kept)
        self._known = np.intersect1d(np.union1d(self._known, ids), self._ids)
        self._left = left.copy()
        R = np.tile(self._R, (len(ids), 1, 1))
        return TrackedPair(ids, uvd, R, initialised=fresh, dropped=np.setdiff1d(before, self._ids))

    def _select(self, kept: BoolArray) -> None:
        self._ids, self._uv, self._misses = self._ids[kept], self._uv[kept], self._misses[kept]

    def _follow(self, left: GreyImage) -> None:
        """Move the points on to the next left image; those that are lost are left out."""
        assert self._left is not None
        found, good = followed(self._left, left, self._uv, self._uv)
        good &= self._inside(found)
        at = np.flatnonzero(good)
        if len(at) >= _FEWEST:
            _, mask = cv2.findFundamentalMat(self._uv[at], found[at], cv2.FM_RANSAC, _EPIPOLAR, 0.99)
            if mask is not None:
                good[at] &= np.asarray(mask).reshape(-1).astype(bool)
        self._uv = found
        self._select(good)

    def _refill(self, left: GreyImage) -> None:
        distance = int(np.ceil(self.settings.min_distance))
        free = np.zeros(left.shape, dtype=np.uint8)
        margin = self.settings.margin
        free[margin : left.shape[0] - margin, margin : left.shape[1] - margin] = 255
        for u, v in self._uv:
            cv2.circle(free, (round(float(u)), round(float(v))), distance, 0, -1)
        wanted = self.settings.max_landmarks - len(self._ids)
        corners = cv2.goodFeaturesToTrack(left, wanted, _QUALITY, distance, mask=free)
        new = np.zeros((0, 2), dtype=np.float32) if corners is None else np.asarray(corners, np.float32).reshape(-1, 2)
        self._ids = np.concatenate([self._ids, self._next + np.arange(len(new), dtype=np.int64)])
        self._uv = np.concatenate([self._uv, new])
        self._misses = np.concatenate([self._misses, np.zeros(len(new), dtype=np.int64)])
        self._next += len(new)

    def _disparities(self, left: GreyImage, right: GreyImage) -> tuple[FloatArray, BoolArray]:
        """Disparities (N,), px, and which were found."""
        found, good = followed(left, right, self._uv, self._uv)
        shift = (self._uv - found).astype(np.float64)
        disparity = shift[:, 0] + self.settings.disparity_offset
        most = self.camera.disparity_constant / self.settings.nearest
        fits = (disparity > 0) & (disparity < most) & (np.abs(shift[:, 1]) < _ROWS)
        new = ~np.isin(self._ids, self._known)
        return disparity, good & fits & (~new | (disparity > self.settings.min_disparity))

    def _inside(self, uv: Points) -> BoolArray:
        size = np.array([self.camera.width, self.camera.height])
        return np.asarray(((uv >= self.settings.margin) & (uv < size - self.settings.margin)).all(axis=1))


def followed(first: GreyImage, second: GreyImage, uv: Points, guess: Points) -> tuple[Points, BoolArray]:
    """Points (N, 2) of the first image in the second, px, and which come home when they are followed back."""
    if not len(uv):
        return uv, np.zeros(0, dtype=bool)
    options = {"winSize": _WINDOW, "maxLevel": _LEVELS}
    there, status, _ = cv2.calcOpticalFlowPyrLK(first, second, uv, guess.copy(), **options)  # type: ignore[call-overload]
    back, again, _ = cv2.calcOpticalFlowPyrLK(second, first, there, uv.copy(), **options)  # type: ignore[call-overload]
    home = np.abs(np.asarray(back) - uv).max(axis=1) < _RETURNS
    good = (np.asarray(status).reshape(-1) > 0) & (np.asarray(again).reshape(-1) > 0) & home
    return np.asarray(there, dtype=np.float32), good
