"""The front end: follows landmarks through stereo pairs by active search (section 4.2 of the paper)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.stats import chi2

from filters.camera import StereoCamera
from filters.interface import Forecast, StereoObservation
from filters.validation import BoolArray, FloatArray, IntArray, positive
from stereo_slam_env.frontend.correlation import search
from stereo_slam_env.frontend.detection import detect_corners
from stereo_slam_env.frontend.disparity_offset import DisparityOffset
from stereo_slam_env.frontend.ego_motion import MIN_POINTS, RobustStep, chained, continued, predicted, robust_step
from stereo_slam_env.frontend.moving import STRIKES, beside_moving, moving_together
from stereo_slam_env.frontend.patches import cut_patches, local_affine, warped_patches
from stereo_slam_env.frontend.settings import TrackerSettings
from stereo_slam_env.frontend.stereo_matching import match_rows
from stereo_slam_env.frontend.tracked import Outcome, Search, TrackedPair
from stereo_slam_env.frontend.tracks import MEMORY, Tracks, new_tracks
from stereo_slam_env.image_sequence import GreyImage
from stereo_slam_env.stereo_step import Pairs, Step, squared_distances

_REST = Step(np.eye(3), np.zeros(3))
_LOST_SHARE = 0.3
"""With fewer of the expected landmarks found, the expectation was wrong: optical flow gives another one."""
_GIVE_UP_STRIKES = 4
_SPARE = 1.3
"""Landmarks are followed, in numbers of `max_landmarks`: some are on probation."""


@dataclass(frozen=True, eq=False)
class _Expected:
    """Where the tracks are expected: uvd (N, 3), covariance S (N, 3, 3) of measured minus expected, in view (N,)."""

    uvd: FloatArray
    S: FloatArray
    in_view: BoolArray


@dataclass(frozen=True, eq=False)
class _Found:
    """What the search found: uvd (N, 3) (NaN: nothing), R (N, 3, 3), and why not: `outcome` (N,)."""

    uvd: FloatArray
    R: FloatArray
    outcome: IntArray

    @property
    def matched(self) -> BoolArray:
        return np.asarray(self.outcome == Outcome.MATCHED)


class StereoTracker:
    """Turns stereo pairs into (u, v, d) with ids and covariances.

    New landmarks are corners, matched along the row. In later pairs each is searched for where the filter (or, without
    one, the motion so far) expects it: its patch is warped to the expected view and correlated inside the innovation
    ellipse of the left image, then what was found is matched along the row of the right one. A landmark outside
    either image, or missed too often, is dropped; so is one that moves unlike the scene.

    Parameters
    ----------
    camera : StereoCamera
        The rectified rig.
    settings : TrackerSettings, optional
        See there.
    """

    def __init__(self, camera: StereoCamera, settings: TrackerSettings | None = None) -> None:
        self.camera = camera
        self.settings = TrackerSettings() if settings is None else settings
        self.reset()

    def reset(self) -> None:
        """Forget everything; ids begin at 0 again."""
        side = cut_patches(np.zeros((64, 64), dtype=np.uint8), np.full((1, 2), 32.0)).shape[1]
        self._tracks = new_tracks(
            np.zeros(0, dtype=np.int64),
            np.zeros((0, side, side), dtype=np.float32),
            np.zeros((0, 3)),
            np.zeros((0, 3, 3)),
            np.eye(3),
            np.zeros(3),
        )
        self._next_id = 0
        self._R_vc, self._position_v = np.eye(3), np.zeros(3)
        self._steps: list[Step] = []  # newest first
        self._dt = 0.0
        self._left: GreyImage | None = None
        self.disparity_offset = DisparityOffset(self.camera)
        """What is added to every measured disparity: the residual of the rectification, learnt on the way."""
        self._pairs_since_offset = 0

    def track(
        self, left: GreyImage, right: GreyImage, dt: float | None = None, forecast: Forecast | None = None
    ) -> TrackedPair:
        """Follow the landmarks to the next pair and find new ones.

        Parameters
        ----------
        left, right : (H, W) uint8
            The pair, rectified, grey.
        dt : float, optional
            Time since the previous pair, s; needed from the second pair on.
        forecast : Forecast, optional
            Where a filter expects its landmarks after `predict`; None: where the motion so far leads.

        Returns
        -------
        TrackedPair

        Raises
        ------
        ValueError
            An image has the wrong size or type, or `dt` is missing or not positive.
        """
        self._check(left, right)
        if self._left is None:
            followed, search_result, dropped = self._tracks, _nothing_searched(), np.zeros(0, dtype=np.int64)
        else:
            if dt is None:
                raise ValueError("dt must be given from the second pair on, got None")
            followed, search_result, dropped = self._follow(left, right, positive("dt", dt), forecast)
        fresh = self._new_corners(followed, left, right)
        corners = StereoObservation(fresh.ids, fresh.uvd, R=fresh.R)
        observation, tracks, initialised = self._release(followed.joined(fresh), first=self._left is None)
        self._tracks, self._left = tracks, left
        return TrackedPair(observation, search_result, corners, initialised, dropped)

    def _check(self, left: GreyImage, right: GreyImage) -> None:
        shape = (self.camera.height, self.camera.width)
        for name, image in (("left", left), ("right", right)):
            if not isinstance(image, np.ndarray) or image.shape != shape or image.dtype != np.uint8:
                what = f"{image.dtype} {image.shape}" if isinstance(image, np.ndarray) else type(image).__name__
                raise ValueError(f"{name} must be a grey uint8 image of shape {shape}, got {what}")

    def _follow(
        self, left: GreyImage, right: GreyImage, dt: float, forecast: Forecast | None
    ) -> tuple[Tracks, Search, IntArray]:
        tracks = self._tracks.next_pair()
        step = self._expected_step(tracks, dt, forecast)
        if step is None:
            step = self._flow_step(tracks, left, right)
        expected = self._expected(tracks, step or _REST, dt, forecast)
        found = self._searched(tracks, expected, step or _REST, left, right)
        if found.matched.sum() < max(MIN_POINTS, _LOST_SHARE * expected.in_view.sum()):
            step = self._flow_step(tracks, left, right)
            if step is not None:
                expected = self._expected(tracks, step, dt, None)
                found = self._searched(tracks, expected, step, left, right)
        motion = self._motion(tracks, found, step)
        self._moved(motion.step if motion is not None else step or _REST, dt)
        tracks, outcome = self._judged(tracks, found, motion)
        tracks = self._rectified(tracks)
        kept = self._kept(tracks, outcome)
        carried = self._carried(tracks, found, dt)
        result = Search(tracks.ids, expected.uvd, expected.S, found.uvd, outcome)
        gone = tracks.ids[~kept | (tracks.moving & tracks.released & ~self._tracks.moving)]
        return carried.select(kept), result, gone

    # Where landmarks are expected.

    def _expected_step(self, tracks: Tracks, dt: float, forecast: Forecast | None) -> Step | None:
        """The motion that the filter's forecast means, or constant velocity; None where neither is known."""
        if forecast is not None:
            _, i, j = np.intersect1d(tracks.ids, forecast.ids, assume_unique=True, return_indices=True)
            sure = self._searchable(forecast.S[j]) & (tracks.misses[i] == 0)
            i, j = i[sure], j[sure]
            if len(i) >= MIN_POINTS:
                found = robust_step(
                    self.camera, Pairs(tracks.uvd[i], forecast.uvd[j], tracks.R[i], forecast.S[j]), None
                )
                if found is not None:
                    return found.step
        return continued(self._steps[0], dt / self._dt) if self._steps else None

    def _searchable(self, S: FloatArray) -> BoolArray:
        """Whether the ellipses in the left image are small enough."""
        half_axis = np.sqrt(chi2.ppf(self.settings.search_gate, 2) * np.linalg.eigvalsh(S[:, :2, :2])[:, 1])
        return np.asarray(half_axis <= self.settings.max_radius)

    def _expected(self, tracks: Tracks, step: Step, dt: float, forecast: Forecast | None) -> _Expected:
        settings = self.settings
        sigmas = np.repeat([settings.sigma_acceleration, settings.sigma_angular_acceleration], 3) * dt**2
        uvd, covariance, in_front = predicted(self.camera, tracks.uvd, tracks.R, step, np.diag(sigmas**2))
        S = covariance + tracks.R
        # A moving landmark goes on as it did.
        unlike = tracks.moving & np.isfinite(tracks.measured[:, 1:3]).all(axis=(1, 2)) & (len(self._steps) > 0)
        if unlike.any():
            stayed, _, _ = predicted(
                self.camera, tracks.measured[unlike, 2], tracks.measured_R[unlike, 2], self._steps[0], np.zeros((6, 6))
            )
            uvd[unlike] += tracks.measured[unlike, 1] - stayed
        if forecast is not None:
            _, i, j = np.intersect1d(tracks.ids, forecast.ids, assume_unique=True, return_indices=True)
            sure = self._searchable(forecast.S[j]) & ~tracks.moving[i]
            uvd[i[sure]], S[i[sure]] = forecast.uvd[j[sure]], forecast.S[j[sure]]
        in_view = in_front & self.camera.in_view(uvd, settings.margin)
        return _Expected(uvd, S, in_view)

    def _flow_step(self, tracks: Tracks, left: GreyImage, right: GreyImage) -> Step | None:
        """The motion from optical flow, for pairs that no motion so far explains."""
        seen = np.flatnonzero((tracks.misses == 0) & ~tracks.moving)
        if len(seen) < MIN_POINTS or self._left is None:
            return None
        before = tracks.uvd[seen]
        uv, status, _ = cv2.calcOpticalFlowPyrLK(
            self._left, left, before[:, None, :2].astype(np.float32), None, winSize=(21, 21), maxLevel=4
        )
        uv = np.asarray(uv, dtype=np.float64)[:, 0]
        margin = self.settings.margin
        inside = (uv >= margin).all(axis=1) & (uv < [self.camera.width - margin, self.camera.height - margin]).all(
            axis=1
        )
        tracked = np.flatnonzero((np.asarray(status)[:, 0] > 0) & inside)
        if len(tracked) < MIN_POINTS:
            return None
        seen, uv, before = seen[tracked], uv[tracked], before[tracked]
        rows = match_rows(
            left, right, uv, np.maximum(0.5 * before[:, 2] - 2.0, 0.0), 2.0 * before[:, 2] + 4.0,
            min_score=self.settings.min_score, ratio=self.settings.uniqueness, left_right_check=False,
        )  # fmt: skip
        ok = np.flatnonzero(rows.accepted)
        if len(ok) < MIN_POINTS:
            return None
        now = np.column_stack([uv[ok], rows.disparity[ok] + self.disparity_offset.value])
        pairs = Pairs(before[ok], now, tracks.R[seen[ok]], np.tile(np.diag([0.25, 0.25, 0.25]), (len(ok), 1, 1)))
        found = robust_step(self.camera, pairs, None)
        return None if found is None else found.step

    # Finding them.

    def _searched(self, tracks: Tracks, expected: _Expected, step: Step, left: GreyImage, right: GreyImage) -> _Found:
        settings, count = self.settings, len(tracks)
        uvd, R = np.full((count, 3), np.nan), np.full((count, 3, 3), np.nan)
        outcome = np.full(count, int(Outcome.OUT_OF_VIEW), dtype=np.int64)
        wanted = np.flatnonzero(expected.in_view)
        if len(wanted) == 0:
            return _Found(uvd, R, outcome)
        sought = tracks.select(wanted)
        R_vn, position_v = self._R_vc @ step.R, self._position_v + self._R_vc @ step.t
        R_now_then = R_vn.T @ sought.first_R
        t_now_then = (sought.first_position - position_v) @ R_vn
        templates = warped_patches(sought.patches, local_affine(self.camera, sought.first_uvd, R_now_then, t_now_then))
        result = search(
            left, templates, expected.uvd[wanted, :2], expected.S[wanted, :2, :2],
            gate=settings.search_gate, max_radius=settings.max_radius,
        )  # fmt: skip
        good = (result.score >= settings.min_score) & (result.second <= settings.uniqueness * result.score)
        good &= ~result.on_border & self._away_from_edges(result.position)
        outcome[wanted] = np.where(good, Outcome.NO_DISPARITY, Outcome.NO_MATCH)
        hit = np.flatnonzero(good)
        at = wanted[hit]
        reach = 1.0 + np.sqrt(chi2.ppf(settings.search_gate, 1) * expected.S[at, 2, 2])
        middle = expected.uvd[at, 2] - self.disparity_offset.value
        rows = match_rows(
            left, right, result.position[hit], middle - reach, middle + reach,
            min_score=settings.min_score, ratio=settings.uniqueness, left_right_check=False,
        )  # fmt: skip
        ok = np.flatnonzero(rows.accepted)
        at, hit = at[ok], hit[ok]
        uvd[at] = np.column_stack([result.position[hit], rows.disparity[ok] + self.disparity_offset.value])
        R[at] = self._noise(result.covariance[hit], rows.variance[ok])
        outcome[at] = Outcome.MATCHED
        return _Found(uvd, R, outcome)

    def _away_from_edges(self, uv: FloatArray) -> BoolArray:
        margin = self.settings.margin
        high = [self.camera.width - 1 - margin, self.camera.height - 1 - margin]
        return np.asarray(((uv >= margin) & (uv <= high)).all(axis=1))

    def _noise(self, covariance_uv: FloatArray, variance_d: FloatArray) -> FloatArray:
        """R of each measurement: what was found in the left image is independent of the match along the row."""
        floor = self.settings.sigma_floor**2
        R = np.zeros((len(variance_d), 3, 3))
        R[:, :2, :2] = covariance_uv + floor * np.eye(2)
        R[:, 2, 2] = variance_d + floor
        return R

    # What they tell about the motion, and the motion about them.

    def _motion(self, tracks: Tracks, found: _Found, expected: Step | None) -> RobustStep | None:
        usable = found.matched & (tracks.misses == 0) & ~tracks.moving
        if usable.sum() < MIN_POINTS:
            return None
        pairs = Pairs(tracks.uvd[usable], found.uvd[usable], tracks.R[usable], found.R[usable])
        return robust_step(self.camera, pairs, expected)

    def _moved(self, step: Step, dt: float) -> None:
        self._position_v = self._position_v + self._R_vc @ step.t
        self._R_vc = self._R_vc @ step.R
        self._steps = [step, *self._steps][: MEMORY - 1]
        self._dt = dt

    def _judged(self, tracks: Tracks, found: _Found, motion: RobustStep | None) -> tuple[Tracks, IntArray]:
        """Who moved unlike the scene, over the last step or over the whole memory."""
        outcome, matched = found.outcome.copy(), found.matched
        measured, measured_R = tracks.measured.copy(), tracks.measured_R.copy()
        measured[:, 0], measured_R[:, 0] = found.uvd, found.R
        unlike = np.zeros(len(tracks), dtype=bool)
        together = np.zeros(len(tracks), dtype=bool)
        if motion is not None:
            limit = chi2.ppf(self.settings.gate, 3)
            over = _REST
            for back, step in enumerate(self._steps, start=1):
                over = chained(step, over)
                known = np.flatnonzero(matched & np.isfinite(measured[:, back, 0]))
                pairs = Pairs(measured[known, back], measured[known, 0], measured_R[known, back], measured_R[known, 0])
                unlike[known] |= squared_distances(self.camera, pairs, over) > limit
                strange = known[(squared_distances(self.camera, pairs, over) > limit) & (measured[known, 0, 2] > 0)
                                & (measured[known, back, 2] > 0)]  # fmt: skip
                together[strange] |= moving_together(
                    self.camera, measured[strange, back], measured[strange, 0],
                    measured_R[strange, back], measured_R[strange, 0], over,
                )  # fmt: skip
        strikes = np.where(matched, np.where(unlike, tracks.strikes + 1, 0), tracks.strikes)
        moving = tracks.moving | (together & (strikes >= STRIKES))
        outcome[matched & unlike] = Outcome.INCONSISTENT
        outcome[matched & moving] = Outcome.MOVING
        tracks = replace(
            tracks,
            measured=measured,
            measured_R=measured_R,
            age=tracks.age + matched,
            misses=np.where(matched, 0, tracks.misses + 1),
            strikes=strikes,
            moving=moving,
        )
        return tracks, outcome

    def _rectified(self, tracks: Tracks) -> Tracks:
        """Learn the disparity offset from the whole memory, each measurement once."""
        self._pairs_since_offset += 1
        if self._pairs_since_offset < MEMORY - 1 or len(self._steps) < MEMORY - 1:
            return tracks
        both = np.flatnonzero(np.isfinite(tracks.measured[:, [0, -1], 0]).all(axis=1) & ~tracks.moving)
        if len(both) < MIN_POINTS:
            return tracks
        over = _REST
        for step in self._steps:
            over = chained(step, over)
        measured, R = tracks.measured[both], tracks.measured_R[both]
        pairs = Pairs(measured[:, -1], measured[:, 0], R[:, -1], R[:, 0])
        found = robust_step(self.camera, pairs, over)
        if found is None:
            return tracks
        self._pairs_since_offset = 0
        change = np.array([0.0, 0.0, self.disparity_offset.update(pairs.select(found.inliers), found.step)])
        return replace(
            tracks,
            first_uvd=tracks.first_uvd + change,
            uvd=tracks.uvd + change,
            measured=tracks.measured + change,
        )

    def _kept(self, tracks: Tracks, outcome: IntArray) -> BoolArray:
        gone = (outcome == Outcome.OUT_OF_VIEW) | (tracks.misses > self.settings.max_misses)
        gone |= ~tracks.moving & (tracks.strikes >= _GIVE_UP_STRIKES)
        gone |= ~tracks.released & (tracks.strikes >= STRIKES) & ~tracks.moving
        return np.asarray(~gone)

    def _carried(self, tracks: Tracks, found: _Found, dt: float) -> Tracks:
        """Last measured image of each landmark, or the one before carried over by the motion."""
        sigmas = np.repeat([0.02, 0.002], 3)
        uvd, R, _ = predicted(self.camera, tracks.uvd, tracks.R, self._steps[0], np.diag(sigmas**2))
        matched = found.matched
        return replace(
            tracks,
            uvd=np.where(matched[:, None], found.uvd, uvd),
            R=np.where(matched[:, None, None], found.R, R),
        )

    # New ones.

    def _new_corners(self, tracks: Tracks, left: GreyImage, right: GreyImage) -> Tracks:
        settings, camera = self.settings, self.camera
        standing = int((~tracks.moving).sum())
        if standing >= settings.refill_below * _SPARE:
            return tracks.select(slice(0))
        corners = detect_corners(
            left, round(_SPARE * settings.max_landmarks) - standing, tracks.uvd[:, :2],
            margin=settings.margin, min_distance=10.0,
        )  # fmt: skip
        if len(corners) == 0:
            return tracks.select(slice(0))
        high = np.full(len(corners), camera.disparity_constant / settings.nearest)
        rows = match_rows(
            left, right, corners, np.full(len(corners), settings.min_disparity), high,
            min_score=settings.min_score, ratio=settings.uniqueness, left_right_check=True,
        )  # fmt: skip
        uvd = np.column_stack([corners, rows.disparity + self.disparity_offset.value])
        good = rows.accepted & ~beside_moving(camera, uvd, tracks.uvd[tracks.moving])
        uvd = uvd[good]
        R = self._noise(np.zeros((len(uvd), 2, 2)), rows.variance[good])  # the corner itself is the landmark
        ids = self._next_id + np.arange(len(uvd), dtype=np.int64)
        self._next_id += len(uvd)
        return new_tracks(ids, cut_patches(left, uvd[:, :2]), uvd, R, self._R_vc, self._position_v)

    def _release(self, tracks: Tracks, *, first: bool) -> tuple[StereoObservation, Tracks, IntArray]:
        """What the filter gets: found in this pair, standing, and past probation (in the first pair: all)."""
        here = np.isfinite(tracks.measured[:, 0, 0]) & ~tracks.moving & (tracks.strikes == 0)
        here &= tracks.released | (tracks.age >= self.settings.probation) | first
        candidates = np.flatnonzero(here)
        if len(candidates) > self.settings.max_landmarks:
            order = np.argsort(~tracks.released[candidates], kind="stable")  # those the filter has, then by id
            candidates = np.sort(candidates[order[: self.settings.max_landmarks]])
        initialised = tracks.ids[candidates[~tracks.released[candidates]]]
        released = tracks.released.copy()
        released[candidates] = True
        observation = StereoObservation(
            tracks.ids[candidates], tracks.measured[candidates, 0], R=tracks.measured_R[candidates, 0]
        )
        return observation, replace(tracks, released=released), initialised


def _nothing_searched() -> Search:
    return Search(
        np.zeros(0, dtype=np.int64),
        np.zeros((0, 3)),
        np.zeros((0, 3, 3)),
        np.zeros((0, 3)),
        np.zeros(0, dtype=np.int64),
    )
