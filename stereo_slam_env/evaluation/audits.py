"""Audits of a recording: errors of its rig that a drive shows, and steps of its reference that images contradict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from filters import ColouredNoise, StereoEKF
from filters.geometry.arrays import BoolArray, FloatArray
from stereo_slam_env.loop import run
from stereo_slam_env.recording.recording import Recording

FACTOR, LEAST = 3.0, 0.5
"""A step is doubtful whose median residual is so many times that of the images, and larger by so many pixels: turns of
1 mrad a frame at the focal length of KITTI, which no mounting of a camera and no noise of a reference explain."""


@dataclass(frozen=True, eq=False)
class ReferenceAudit:
    """Residuals of the steps to K frames, and which of them speak against the reference."""

    frames: FloatArray
    """(K,): numbers of the frames that the steps lead to."""
    by_reference: FloatArray
    """(K,): median distance of tracks in the left image from where the step of the reference puts them, px."""
    by_images: FloatArray
    """(K,): that of the motion which fits the tracks best, px."""

    @classmethod
    def from_dict(cls, kept: Mapping[str, Sequence[float]]) -> ReferenceAudit:
        """The audit that `as_dict` gave."""
        return cls(**{name: np.array(values, dtype=np.float64) for name, values in kept.items()})

    def as_dict(self) -> dict[str, list[float]]:
        """Its three series, JSON-able, to a thousandth of a pixel."""
        return {name: np.nan_to_num(np.round(values, 3)).tolist() for name, values in vars(self).items()}

    @property
    def doubtful(self) -> BoolArray:
        """(K,): whether the images contradict the step of the reference."""
        far: BoolArray = self.by_reference > np.maximum(FACTOR * self.by_images, self.by_images + LEAST)
        return far

    def __str__(self) -> str:
        frames = self.frames[self.doubtful].astype(int).tolist()
        if not len(self.frames):
            return "the images show no motion to hold it against"
        medians = np.median([self.by_reference, self.by_images], axis=1)
        residuals = f"median residual {medians[0]:.2f} px, by the images {medians[1]:.2f}"
        if not frames:
            return f"tracks and reference agree in {len(self.frames)} steps ({residuals})"
        listed = ", ".join(map(str, frames[:12])) + (", ..." if len(frames) > 12 else "")
        return (
            f"tracks and reference disagree in {len(frames)} of {len(self.frames)} steps, and either may be wrong: "
            f"to frames {listed} ({residuals})"
        )


SHOWN = ("disparity_offset", "right_yaw", "right_roll")
"""Those of `ColouredNoise` that images can show, in the order of the variable "calibration"."""


def rig_errors(recording: Recording) -> Mapping[str, tuple[float, float]]:
    """Estimates and their standard errors after the drive, px and rad, by "coloured-noise" with vision only.

    Only what the noise of the recording has a prior for is estimated; nothing where it has none.
    """
    noise = recording.noise
    names = [name for name in SHOWN if getattr(noise, name)] if isinstance(noise, ColouredNoise) else []
    if not names or not recording.frames:
        return {}
    *_, last = run("coloured-noise", recording, use_odometry=False)
    assert isinstance(last.slam, StereoEKF)
    calibration = last.slam.belief("calibration")
    sigmas = np.sqrt(np.diag(calibration.covariance))
    return {name: (float(x), float(s)) for name, x, s in zip(names, calibration.value, sigmas, strict=True)}
