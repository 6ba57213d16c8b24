"""Front ends of other kinds: OpenCV's Lucas-Kanade, SIFT, and learned features of OpenCV 5 with a model file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from filters import Forecast, StereoCamera, StereoNoise
from filters.contract.validation import first_line, positive
from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from stereo_slam_env.frontend.settings import TrackerSettings
from stereo_slam_env.frontend.tracks import TrackedPair, require_legal, require_pair
from stereo_slam_env.recording.recording import GreyImage

SIGMA = 0.7
"""Standard deviation that is claimed for a pixel coordinate, px: what is commonly assumed of features."""
_SPARE = 6
"""Features found for each landmark that the filter may have."""
_RATIO = 0.8
"""Of the distances to the best and to the second best descriptor (Lowe)."""
_ROWS = 1.5
"""Rows of both images may differ by this, px."""
_EPIPOLAR = 1.0
"""Distance from the epipolar line beyond which RANSAC drops a match, px."""
_FEWEST = 8
"""Matches for a fundamental matrix."""

Matches = tuple[IntArray, IntArray]


class FeatureFrontEnd:
    """Features matched by their descriptors, from left to right and from pair to pair, with one constant covariance.

    A landmark whose feature is not found again ends, as long as `settings.max_misses` pairs have not passed it waits
    for it. A forecast is not used.

    Parameters
    ----------
    camera : StereoCamera
        The rectified rig.
    settings : TrackerSettings
        Used are `max_landmarks`, `margin`, `min_disparity`, `nearest`, `max_misses`, `sigma_floor` and
        `disparity_offset`; `matcher_model` names a LightGlue network in place of nearest neighbours.
    detector : cv2.Feature2D
        Finds and describes features.
    """

    def __init__(self, camera: StereoCamera, settings: TrackerSettings, detector: Any) -> None:
        self.camera, self.settings, self._detector = camera, settings, detector
        self._R = StereoNoise.independent_pixels(max(SIGMA, settings.sigma_floor)).R
        self._glue = None if settings.matcher_model is None else _of_model("LightGlueMatcher", settings.matcher_model)
        self.reset()

    def reset(self) -> None:
        """Forget everything; ids begin at 0 again."""
        self._ids, self._misses = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
        self._uv: FloatArray = np.zeros((0, 2))
        self._descriptors: Any = None
        self._next, self._begun = 0, False

    def track(
        self, left: GreyImage, right: GreyImage, dt: float | None = None, forecast: Forecast | None = None
    ) -> TrackedPair:
        """Match the landmarks in the next pair and find new ones, see `FrontEnd`."""
        require_pair(self.camera, left, right)
        if forecast is not None:
            require_legal(forecast)
        if self._begun:
            if dt is None:
                raise ValueError("dt must be given from the second pair on, got None")
            positive("dt", dt)
        uv, descriptors = self._features(left)
        uv_right, descriptors_right = self._features(right)
        i, j = self._matched(uv, descriptors, uv_right, descriptors_right)
        shift = uv[i] - uv_right[j]
        d = shift[:, 0] + self.settings.disparity_offset
        most = self.camera.disparity_constant / self.settings.nearest
        good = (np.abs(shift[:, 1]) < _ROWS) & (d > self.settings.min_disparity) & (d < most)
        i, d = i[good], d[good]
        uv, descriptors = uv[i], None if descriptors is None else descriptors[i]  # those that have a depth
        before, ids = self._ids, self._identities(uv, descriptors)
        order = np.argsort(ids)[np.count_nonzero(ids < 0) :]  # without those that there is no place for
        self._begun = True
        new = ids[order][~np.isin(ids[order], before)]
        R = np.tile(self._R, (len(order), 1, 1))
        uvd = np.column_stack([uv, d])[order]
        return TrackedPair(ids[order], uvd, R, initialised=new, dropped=np.setdiff1d(before, self._ids))

    def _features(self, image: GreyImage) -> tuple[FloatArray, Any]:
        keypoints, descriptors = self._detector.detectAndCompute(image, None)
        uv = np.array([point.pt for point in keypoints], dtype=np.float64).reshape(-1, 2)
        if descriptors is None or not len(uv):
            return np.zeros((0, 2)), None
        size, margin = np.array([self.camera.width, self.camera.height]), self.settings.margin
        inside = np.flatnonzero(((uv >= margin) & (uv < size - margin)).all(axis=1))
        strong = np.argsort([-keypoints[at].response for at in inside], kind="stable")
        strongest = inside[strong[: _SPARE * self.settings.max_landmarks]]
        _, once = np.unique(uv[strongest], axis=0, return_index=True)  # SIFT has a feature for each of its directions
        strongest = strongest[np.sort(once)]
        return uv[strongest], np.ascontiguousarray(np.asarray(descriptors)[strongest])

    def _identities(self, uv: FloatArray, descriptors: Any) -> IntArray:
        """Ids (M,) of features, -1 where there is no place; what is measured is kept for the next pair."""
        i, j = self._matched(self._uv, self._descriptors, uv, descriptors)
        if len(i) >= _FEWEST:
            _, mask = cv2.findFundamentalMat(self._uv[i], uv[j], cv2.FM_RANSAC, _EPIPOLAR, 0.99)
            if mask is not None:
                kept_rows = np.asarray(mask).reshape(-1).astype(bool)
                i, j = i[kept_rows], j[kept_rows]
        ids = np.full(len(uv), -1, dtype=np.int64)
        ids[j] = self._ids[i]
        free = np.flatnonzero(ids < 0)[: max(self.settings.max_landmarks - len(i), 0)]  # the strongest come first
        ids[free] = self._next + np.arange(len(free))
        self._next += len(free)
        self._remember(ids, uv, descriptors, i)
        return ids

    def _remember(self, ids: IntArray, uv: FloatArray, descriptors: Any, found: IntArray) -> None:
        missed = np.setdiff1d(np.arange(len(self._ids)), found)
        waiting = missed[self._misses[missed] < self.settings.max_misses]
        taken = ids >= 0
        parts = [] if self._descriptors is None else [self._descriptors[waiting]]
        parts += [] if descriptors is None else [descriptors[taken]]
        self._descriptors = np.concatenate(parts) if parts else None
        self._uv = np.concatenate([self._uv[waiting], uv[taken]])
        self._misses = np.concatenate([self._misses[waiting] + 1, np.zeros(int(taken.sum()), dtype=np.int64)])
        self._ids = np.concatenate([self._ids[waiting], ids[taken]])

    def _matched(self, uv: FloatArray, first: Any, uv_second: FloatArray, second: Any) -> Matches:
        """Rows of the same features in both."""
        if first is None or second is None or len(first) < 2 or len(second) < 2:
            return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
        if self._glue is not None:
            size = self.camera.width, self.camera.height
            self._glue.setPairInfo(uv.astype(np.float32), uv_second.astype(np.float32), size, size)
            matches = self._glue.match(first, second)
        else:
            norm = cv2.NORM_HAMMING if first.dtype == np.uint8 else cv2.NORM_L2
            both = [cv2.BFMatcher(norm).knnMatch(*one, k=2) for one in ((first, second), (second, first))]
            back = {match[0].queryIdx: match[0].trainIdx for match in both[1]}
            best = (match for match in both[0] if match[0].distance < _RATIO * match[1].distance)
            matches = [match[0] for match in best if back[match[0].trainIdx] == match[0].queryIdx]
        pairs = np.array([(match.queryIdx, match.trainIdx) for match in matches], dtype=np.int64).reshape(-1, 2)
        return pairs[:, 0], pairs[:, 1]


def sift(camera: StereoCamera, settings: TrackerSettings) -> FeatureFrontEnd:
    """SIFT features (OpenCV), matched by mutual nearest neighbours."""
    return FeatureFrontEnd(camera, settings, cv2.SIFT_create(_SPARE * settings.max_landmarks))  # type: ignore[attr-defined]


def aliked(camera: StereoCamera, settings: TrackerSettings) -> FeatureFrontEnd:
    """ALIKED features (OpenCV 5), a network in the file `model` that you bring (ONNX)."""
    return FeatureFrontEnd(camera, settings, _of_model("ALIKED", settings.model))


def disk(camera: StereoCamera, settings: TrackerSettings) -> FeatureFrontEnd:
    """DISK features (OpenCV 5), a network in the file `model` that you bring (ONNX)."""
    return FeatureFrontEnd(camera, settings, _of_model("DISK", settings.model))


def _of_model(name: str, model: str | None) -> Any:
    """The class of OpenCV with a network from a file."""
    kind: Callable[[str], Any] | None = getattr(getattr(cv2, name, None), "create", None)
    if kind is None:
        raise ValueError(
            f"{name} needs OpenCV 5, this is {cv2.__version__}: pip install 'opencv-python-headless>=5,<6'"
        )
    if model is None:
        raise ValueError(f"{name} needs a network: give its ONNX file as model, in TrackerSettings or a scenario")
    if not Path(model).is_file():
        raise ValueError(f"{model} does not exist: give the ONNX file of {name}")
    try:
        return kind(model)
    except cv2.error as error:
        raise ValueError(f"{model} is no network that {name} takes ({first_line(error)})") from error


KLT_SIGMA = 0.5
"""Standard deviation that is claimed for a pixel coordinate, px: what is commonly assumed; LK does not measure it."""
Points = NDArray[np.float32]
"""(N, 2) px, as OpenCV takes them."""
_WINDOW, _LEVELS = (21, 21), 3
_RETURNS = 0.5
"""Followed back, a point must come home to within this, px."""
_KLT_ROWS = 1.0
"""Rows of both images may differ by this, px."""
_QUALITY = 0.01


class KLTFrontEnd:
    """Shi-Tomasi corners followed by pyramidal Lucas-Kanade (OpenCV), with one constant covariance.

    Points are followed from the left image to the next left one, checked backwards and against the epipolar geometry
    (RANSAC), then from left to right. The covariance claimed is that of independent pixels of `KLT_SIGMA`, or of
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
        self._R = StereoNoise.independent_pixels(max(KLT_SIGMA, self.settings.sigma_floor)).R
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
        disparity, has_disparity = self._disparities(left, right)
        self._misses = np.where(has_disparity, 0, self._misses + 1)
        ids = self._ids[has_disparity]
        uvd = np.column_stack([self._uv[has_disparity].astype(np.float64), disparity[has_disparity]])
        fresh = ids[~np.isin(ids, self._known)]
        remaining = (self._misses <= self.settings.max_misses) & (has_disparity | np.isin(self._ids, self._known))
        self._select(remaining)
        self._known = np.intersect1d(np.union1d(self._known, ids), self._ids)
        self._left = left.copy()
        R = np.tile(self._R, (len(ids), 1, 1))
        return TrackedPair(ids, uvd, R, initialised=fresh, dropped=np.setdiff1d(before, self._ids))

    def _select(self, kept: BoolArray) -> None:
        self._ids, self._uv, self._misses = self._ids[kept], self._uv[kept], self._misses[kept]

    def _follow(self, left: GreyImage) -> None:
        """Move the points on to the next left image; those that are lost are left out."""
        assert self._left is not None
        followed_uv, good = followed(self._left, left, self._uv, self._uv)
        good &= self._inside(followed_uv)
        at = np.flatnonzero(good)
        if len(at) >= _FEWEST:
            _, mask = cv2.findFundamentalMat(self._uv[at], followed_uv[at], cv2.FM_RANSAC, _EPIPOLAR, 0.99)
            if mask is not None:
                good[at] &= np.asarray(mask).reshape(-1).astype(bool)
        self._uv = followed_uv
        self._select(good)

    def _refill(self, left: GreyImage) -> None:
        distance = int(np.ceil(self.settings.min_distance))
        free = np.zeros(left.shape, dtype=np.uint8)
        margin = self.settings.margin
        free[margin : left.shape[0] - margin, margin : left.shape[1] - margin] = 255
        for u, v in self._uv:
            cv2.circle(free, (round(float(u)), round(float(v))), distance, 0, -1)
        missing_count = self.settings.max_landmarks - len(self._ids)
        corners = cv2.goodFeaturesToTrack(left, missing_count, _QUALITY, distance, mask=free)
        new = np.zeros((0, 2), dtype=np.float32) if corners is None else np.asarray(corners, np.float32).reshape(-1, 2)
        self._ids = np.concatenate([self._ids, self._next + np.arange(len(new), dtype=np.int64)])
        self._uv = np.concatenate([self._uv, new])
        self._misses = np.concatenate([self._misses, np.zeros(len(new), dtype=np.int64)])
        self._next += len(new)

    def _disparities(self, left: GreyImage, right: GreyImage) -> tuple[FloatArray, BoolArray]:
        """Disparities (N,), px, and which were found."""
        followed_uv, good = followed(left, right, self._uv, self._uv)
        shift = (self._uv - followed_uv).astype(np.float64)
        disparity = shift[:, 0] + self.settings.disparity_offset
        most = self.camera.disparity_constant / self.settings.nearest
        fits = (disparity > 0) & (disparity < most) & (np.abs(shift[:, 1]) < _KLT_ROWS)
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
    uv_after, status, _ = cv2.calcOpticalFlowPyrLK(first, second, uv, guess.copy(), **options)  # type: ignore[call-overload]
    back, again, _ = cv2.calcOpticalFlowPyrLK(second, first, uv_after, uv.copy(), **options)  # type: ignore[call-overload]
    home = np.abs(np.asarray(back) - uv).max(axis=1) < _RETURNS
    good = (np.asarray(status).reshape(-1) > 0) & (np.asarray(again).reshape(-1) > 0) & home
    return np.asarray(uv_after, dtype=np.float32), good
