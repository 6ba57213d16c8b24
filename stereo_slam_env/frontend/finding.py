"""Find expected landmarks in a pair: correlate inside the ellipse on the left, then along the row on the right."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from filters.camera import StereoCamera
from filters.engine.gating import gate_limit
from filters.validation import BoolArray, FloatArray, IntArray
from stereo_slam_env.frontend.correlation import search
from stereo_slam_env.frontend.detection import detect_corners
from stereo_slam_env.frontend.expectation import Expectation
from stereo_slam_env.frontend.patches import local_affine, parallax, warped_patches
from stereo_slam_env.frontend.settings import TrackerSettings
from stereo_slam_env.frontend.stereo_matching import match_rows
from stereo_slam_env.frontend.tracked import Outcome
from stereo_slam_env.frontend.tracks import Tracks
from stereo_slam_env.recording.recording import GreyImage

_ROW_SLACK = 1.0
"""Added to the range of disparities that is searched, px."""
_UNDERSTATED = 1.8
"""The errors of a correlation are so much larger than its covariance says, whose noise is white: measured where neither
noise nor relief matters, on rendered streets (`stereo-slam scenes noise`), in u, v and d, from 0.03 to 0.3 px alike."""


@dataclass(frozen=True, eq=False)
class Found:
    """What was found of N landmarks: uvd (N, 3) px (NaN: nothing), R (N, 3, 3) px^2, an `Outcome` each (N,)."""

    uvd: FloatArray
    R: FloatArray
    outcome: IntArray

    @property
    def matched(self) -> BoolArray:
        """Found in both images; (N,)."""
        return np.asarray(self.outcome == Outcome.MATCHED)

    def merged(self, other: Found, rows: BoolArray) -> Found:
        """This one, with `rows` (N,) from the other."""
        return Found(
            np.where(rows[:, None], other.uvd, self.uvd),
            np.where(rows[:, None, None], other.R, self.R),
            np.where(rows, other.outcome, self.outcome),
        )


@dataclass(frozen=True, eq=False)
class PairFinder:
    """Looks into one pair.

    Attributes
    ----------
    camera : StereoCamera
        The rig.
    settings : TrackerSettings
        Of the front end.
    left, right : (H, W) uint8
        The pair.
    """

    camera: StereoCamera
    settings: TrackerSettings
    left: GreyImage
    right: GreyImage

    def find(
        self, tracks: Tracks, expected: Expectation, R_vn: FloatArray, position_v: FloatArray, which: BoolArray
    ) -> Found:
        """Look for the tracks `which` (N,) from the expected camera pose R_vn, position_v in the front end's world."""
        count, settings = len(tracks), self.settings
        uvd, R = np.full((count, 3), np.nan), np.full((count, 3, 3), np.nan)
        outcome = np.full(count, int(Outcome.OUT_OF_VIEW), dtype=np.int64)
        wanted = np.flatnonzero(expected.in_view & which)
        if len(wanted) == 0:
            return Found(uvd, R, outcome)
        sought = tracks.select(wanted)
        R_now_then = R_vn.T @ sought.first_R
        t_now_then = (sought.first_position - position_v) @ R_vn
        templates = warped_patches(sought.patches, local_affine(self.camera, sought.first_uvd, R_now_then, t_now_then))
        result = search(
            self.left,
            templates,
            expected.uvd[wanted, :2],
            expected.S[wanted, :2, :2],
            gate=float(np.sqrt(gate_limit(settings.search_gate, 2))),
            max_radius=settings.max_radius,
        )
        good = (result.score >= settings.min_score) & (result.second <= settings.uniqueness * result.score)
        good &= ~result.on_border & self.inside(result.position)
        outcome[wanted] = np.where(good, Outcome.NO_DISPARITY, Outcome.NO_MATCH)
        hit = np.flatnonzero(good)
        at = wanted[hit]
        reach = _ROW_SLACK + np.sqrt(gate_limit(settings.search_gate, 1) * expected.S[at, 2, 2])
        disparity, variance, accepted = self.disparities(
            result.position[hit], expected.uvd[at, 2] - reach, expected.uvd[at, 2] + reach
        )
        hit, at = hit[accepted], at[accepted]
        uvd[at] = np.column_stack([result.position[hit], disparity[accepted]])
        moved = parallax(self.camera, sought.first_uvd[hit], R_now_then[hit], t_now_then[hit])
        R[at] = self._noise(result.covariance[hit], variance[accepted], moved, disparity[accepted])
        outcome[at] = Outcome.MATCHED
        return Found(uvd, R, outcome)

    def corners(self, wanted: int, occupied: FloatArray) -> tuple[FloatArray, FloatArray]:
        """New corners away from `occupied` (K, 2), with a disparity: (u, v, d) (M, 3) px and R (M, 3, 3) px^2."""
        settings = self.settings
        uv = detect_corners(self.left, wanted, occupied, margin=settings.margin, min_distance=settings.min_distance)
        low = np.full(len(uv), settings.min_disparity)
        high = np.full(len(uv), min(self.camera.disparity_constant / settings.nearest, self.camera.width))
        disparity, variance, accepted = self.disparities(uv, low, high, left_right_check=True)
        uvd = np.column_stack([uv, disparity])[accepted]
        count = len(uvd)
        exact, unmoved = np.zeros((count, 2, 2)), np.zeros((count, 2))  # the corner itself is the landmark
        return uvd, self._noise(exact, variance[accepted], unmoved, uvd[:, 2])

    def disparities(
        self, uv: FloatArray, low: FloatArray, high: FloatArray, *, left_right_check: bool = False
    ) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Disparities of left pixels (M, 2) in low..high (M,), their variances, and which matches are accepted."""
        if len(uv) == 0:
            return np.zeros(0), np.zeros(0), np.zeros(0, dtype=bool)
        offset = self.settings.disparity_offset
        rows = match_rows(
            self.left,
            self.right,
            uv,
            low - offset,
            high - offset,
            min_score=self.settings.min_score,
            ratio=self.settings.uniqueness,
            left_right_check=left_right_check,
        )
        return rows.disparity + offset, rows.variance, rows.accepted

    def inside(self, uv: FloatArray) -> BoolArray:
        """Which pixels (M, 2) are off the edge of the left image by the margin."""
        margin = self.settings.margin
        high = [self.camera.width - 1 - margin, self.camera.height - 1 - margin]
        return np.asarray(((uv >= margin) & (uv <= high)).all(axis=1))

    def _noise(
        self, covariance_uv: FloatArray, variance_d: FloatArray, moved: FloatArray, disparity: FloatArray
    ) -> FloatArray:
        """R of each measurement, from that of the correlations and from what was `moved` (M, 2) px by parallax.

        What was found in the left image and the match along the row have independent noise. But both compare a patch
        that is taken for a plane; where it is off that plane by r, a match is displaced by the share r / z of all
        parallax: that since the landmark was first seen, and that between the eyes, the disparity.
        """
        floor = self.settings.sigma_floor**2
        R = np.zeros((len(disparity), 3, 3))
        R[:, :2, :2] = _UNDERSTATED**2 * covariance_uv + floor * np.eye(2)
        R[:, 2, 2] = _UNDERSTATED**2 * variance_d + floor
        share = self.settings.sigma_relief * disparity / self.camera.disparity_constant
        displaced = share[:, None] * np.column_stack([moved, disparity])
        return R + displaced[:, :, None] * displaced[:, None, :]
