"""Description of a real recording: what it holds, how it was read, and its measurements' errors against its truth."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from filters import ColouredNoise, StereoCamera, StereoNoise, nees
from filters.checks.consistency import chi_square_quantile
from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from stereo_slam_env.evaluation.audits import rig_errors
from stereo_slam_env.frontend.settings import TrackerSettings
from stereo_slam_env.recording.recording import Recording

RANGES = (0.0, 15.0, 30.0, 45.0, 70.0, 150.0, np.inf)
"""Bounds of the bins, m."""
OUTLIER = 1.5
"""An error beyond this is an outlier, px: the convention of the figures it is compared with."""
LAGS = (1, 5, 10)
"""Frames between two errors of a landmark whose correlation is stated."""
_MAD_TO_SIGMA = 1.4826
_EXACT = 1e-9
"""Errors below it are rounding, px."""


@dataclass(frozen=True, eq=False)
class MeasurementErrors:
    """Errors of all measurements whose truth is known."""

    ids: IntArray  # (N,): of the landmarks
    frames: IntArray  # (N,): number of the frame
    depths: FloatArray  # (N,): z, m
    errors: FloatArray  # (N, 3): of (u, v, d), px
    R: FloatArray | None  # (N, 3, 3): claimed covariances, px^2; None where nothing is claimed
    measured: int  # measurements with and without a known truth

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def defines_truth(self) -> BoolArray:
        """Mask (N,) of the measurements whose pixel defines the true point, so that u and v have no error at all."""
        return np.asarray((np.abs(self.errors[:, :2]) < _EXACT).all(axis=1))

    @property
    def judged(self) -> FloatArray:
        """Errors (N, 3), px, with NaN for the u and v of those that define the truth."""
        errors = self.errors.copy()
        errors[self.defines_truth, :2] = np.nan
        return errors


@dataclass(frozen=True)
class NoiseOfRange:
    """Errors of the measurements of landmarks in one range of depths; each triple is for u, v, d.

    Errors of u and v are of the measurements that do not define the true point; NaN where there are none, or where
    nothing is claimed.
    """

    # Depths z, m.
    low: float
    high: float
    count: int
    nees: float  # median NEES of the errors over the median of chi2 with 3 degrees of freedom; 1 is ideal
    bias: tuple[float, float, float]  # median error, px
    sigma: tuple[float, float, float]  # 1.4826 x median absolute deviation, px
    outliers: tuple[float, float, float]  # share of errors beyond `OUTLIER` px
    claimed: tuple[float, float, float]  # median of the standard deviations that the measurements claim, px
    over_claim: tuple[float, float, float]  # 1.4826 x median of |error| / claimed standard deviation


def measurement_errors(recording: Recording, *, claims: bool = True) -> MeasurementErrors:
    """Errors of a recording with known landmarks; a `ValueError` for one without.

    `claims`: whether the covariances of its measurements, or its noise, are to be judged with them.
    """
    truth = recording.landmarks
    if truth is None:
        raise ValueError(f"recording {recording.name!r} has no true landmarks: its errors cannot be known")
    none = np.zeros(0, dtype=np.int64)
    parts = [(none, none, np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3, 3)))]
    measured = 0
    for number, frame in enumerate(recording.frames):
        if frame.truth is None:
            continue
        observation = frame.observation
        measured += len(observation)
        ids, i, j = np.intersect1d(observation.ids, truth.ids, assume_unique=True, return_indices=True)
        p_c = frame.truth.to_camera(truth.positions[j])
        errors = observation.uvd[i] - recording.camera.project(p_c)
        R = observation.covariances(recording.noise)[i]
        parts.append((ids, np.full(len(ids), number), p_c[:, 2], errors, R))
    ids, frames, depths, errors, R = (np.concatenate(column) for column in zip(*parts, strict=True))
    return MeasurementErrors(ids, frames, depths, errors, R if claims else None, measured)


def noise_by_range(found: MeasurementErrors) -> tuple[NoiseOfRange, ...]:
    """Bias, spread, outliers and claims in each range that has measurements, then over all."""
    rows, errors = [], found.judged
    sigmas, of_chi2 = np.full((len(found), 3), np.nan), np.full((len(found), 1), np.nan)
    if found.R is not None:
        sigmas = np.sqrt(np.einsum("nii->ni", found.R))
        of_chi2 = nees(errors, found.R)[:, None] / chi_square_quantile(0.5, 3)
    for low, high in [*pairwise(RANGES), (RANGES[0], RANGES[-1])]:
        inside = (found.depths >= low) & (found.depths < high)
        if not inside.any():
            continue
        error = errors[inside]
        bias = _each(np.median, error)
        sigma = _MAD_TO_SIGMA * _each(np.median, np.abs(error - bias))
        outliers = _each(np.mean, np.where(np.isnan(error), np.nan, np.abs(error) > OUTLIER))
        claimed = _each(np.median, sigmas[inside])
        over_claim = _MAD_TO_SIGMA * _each(np.median, np.abs(error) / sigmas[inside])
        triples = (tuple(values.tolist()) for values in (bias, sigma, outliers, claimed, over_claim))
        ratio = float(_each(np.median, of_chi2[inside])[0])
        rows.append(NoiseOfRange(low, high, int(inside.sum()), ratio, *triples))
    return tuple(rows)


def _each(statistic: Callable[[FloatArray], Any], values: FloatArray) -> FloatArray:
    """Statistic of each column of (N, C), NaN left out; NaN where nothing is left."""
    columns = (column[np.isfinite(column)] for column in values.T)
    return np.array([statistic(column) if len(column) else np.nan for column in columns])


def error_correlation(found: MeasurementErrors, lag: int) -> FloatArray:
    """Correlation of two errors of a landmark, `lag` frames apart, of u, v and d (3,); NaN where there are none.

    Errors of `OUTLIER` px and more are left out, and those of u and v where they define the truth. White noise has 0;
    errors that last have up to 1.
    """
    span = int(found.frames.max(initial=0)) + lag + 1
    inlier = (np.abs(found.errors) < OUTLIER).all(axis=1)
    landmark = np.unique(found.ids, return_inverse=True)[1]  # ids of others may be large
    key = (landmark * span + found.frames)[inlier]
    _, first, later = np.intersect1d(key + lag, key, assume_unique=True, return_indices=True)
    judged = found.judged[inlier]
    a, b = judged[first], judged[later]
    both = np.isfinite(a) & np.isfinite(b)
    a, b = np.where(both, a, np.nan), np.where(both, b, np.nan)
    energy = np.sqrt(_each(np.mean, a**2) * _each(np.mean, b**2))
    return np.asarray(_each(np.mean, a * b) / np.where(energy > 0.0, energy, np.nan))


def noise_remarks(found: MeasurementErrors) -> tuple[str, ...]:
    """Sentences on measurements that are left out of the errors, and on a scene that may be another one."""
    remarks = []
    unknown, defining = found.measured - len(found), int(found.defines_truth.sum())
    if unknown:
        remarks.append(
            f"{unknown} of {found.measured} measurements have no known truth: first measured at the edge of a thing or "
            "of the image, in the sky, or on a body that moves"
        )
    if defining:
        remarks.append(
            f"{defining} of {len(found)} are the first of their landmark, and their pixel defines the true point: "
            "their u and v are left out"
        )
    middle = float(np.median(np.abs(found.errors[:, 2]))) if len(found) else np.nan
    if not middle <= OUTLIER:
        remarks.append(
            "are these tracks of this scene and seed? "
            + ("no left pixel hits a surface" if np.isnan(middle) else f"the median error of d is {middle:.1f} px")
        )
    return tuple(remarks)


def noise_figures(name: str, found: MeasurementErrors) -> dict[str, Any]:
    """All figures of errors as plain data for JSON; lags in frames."""
    return {
        "recording": name,
        "measurements": found.measured,
        "with_truth": len(found),
        "defining_truth": int(found.defines_truth.sum()),
        "ranges": [dataclasses.asdict(row) for row in noise_by_range(found)],
        "correlation": {str(lag): error_correlation(found, lag).tolist() for lag in LAGS},
        "remarks": list(noise_remarks(found)),
    }


_FAR_FROM_PRIOR = 3.0
"""Sigmas of the prior beyond which what is put down to the rig is hardly the rig's."""
_LEFT_OUT = {
    "dropped_repeats": "measurements of repeated frames left out",
    "dropped_non_positive_disparity": "measurements of no positive disparity left out",
}
"""Counts of readers in words."""


def recording_words(recording: Recording) -> dict[str, str]:
    """Contents of a real recording, how it was read, and what is measured and assumed of its errors, a line each."""
    frames = recording.frames
    observed = sum(len(frame.observation) for frame in frames)
    referenced = sum(frame.truth is not None for frame in frames)
    noise = f"R = {json.dumps(recording.noise.R.round(6).tolist())} px² of (u, v, d)"
    pair = all(frame.observation.has_disparity for frame in frames)
    if any(frame.observation.R is not None for frame in frames):
        R = np.concatenate([frame.observation.covariances(recording.noise) for frame in frames])
        sigmas = np.median(np.sqrt(np.einsum("nii->ni", R)), axis=0)[: 3 if pair else 2]
        of = "u / v / d" if pair else "u / v; no disparity is measured"
        noise = f"an R for each measurement, its median sigma {' / '.join(f'{x:.2f}' for x in sigmas)} px of {of}"
    source = dict(recording.source)
    front_end = source.pop("front_end", None)
    lines = {
        "recording": f"{recording.name}: {len(frames)} frames, {frames[-1].timestamp - frames[0].timestamp:.1f} s, "
        f"{observed / len(frames):.0f} landmarks a frame, {referenced} with a reference pose",
        "rig": _rig(recording.camera, pair=pair),
        "reference": str(recording.reference),
        **_audit(recording),
        "its noise": noise,
        **_lasting(recording.noise, referenced > 0),
        **_rig_found(recording),
        "read as": _listed(source),
    }
    if front_end is not None:
        usual = dataclasses.asdict(TrackerSettings())
        changed = {key: value for key, value in front_end.items() if value != usual[key]}
        lines["front end"] = _listed(changed) if changed else "default settings"
    return lines


def _rig(camera: StereoCamera, *, pair: bool) -> str:
    focal = f"{camera.fx:.6g}" if camera.fx == camera.fy else f"{camera.fx:.6g} and {camera.fy:.6g}"
    return (
        f"{camera.width}x{camera.height} px, focal length {focal} px, principal point ({camera.cx:.6g}, "
        f"{camera.cy:.6g}) px, {f'baseline {camera.baseline:.4g} m' if pair else 'one camera'}"
    )


def _lasting(noise: StereoNoise, referenced: bool) -> dict[str, str]:
    """How errors last, as `coloured-noise` is told."""
    if not isinstance(noise, ColouredNoise):
        return {}
    sentences = []
    lasting = noise.lasting_covariance
    if lasting is not None:
        sigmas = " / ".join(f"{sigma:.2f}" for sigma in np.sqrt(np.diag(lasting)))
        sentences.append(
            f"each point errs by {sigmas} px of u / v / d, forgotten with a time constant of {noise.lasting_time:g} s"
        )
    elif noise.drift is not None:
        if any(noise.drift.pixels):
            steps = " / ".join(f"{step:.2f}" for step in noise.drift.pixels)
            sentences.append(f"each point walks {steps} px of u / v / d a frame")
        if noise.drift.share:
            sentences.append(f"each point walks {noise.drift.share:.2f} of its sigma a frame")
    if noise.gauge_walk:
        sentences.append(f"all together by {1e3 * noise.gauge_walk:.1f} mrad per root of a radian of image motion")
    if noise.misalignment and referenced:
        sentences.append(f"camera and reference are aligned to {1e3 * noise.misalignment:.0f} mrad")
    assumed = []
    if noise.disparity_offset:
        assumed.append(f"disparity offset {noise.disparity_offset:.2f} px")
    if noise.right_yaw or noise.right_roll:
        assumed.append(f"right camera {1e3 * noise.right_yaw:.1f} mrad in yaw, {1e3 * noise.right_roll:.1f} in roll")
    if noise.scale:
        assumed.append(f"scale {100 * noise.scale:.1f} %")
    lines = {"that lasts": "; ".join(sentences) or "nothing"}
    return lines | ({"assumed of the rig": f"sigmas, not measured: {', '.join(assumed)}"} if assumed else {})


def _audit(recording: Recording) -> dict[str, str]:
    """Whether the images contradict the reference; nothing where there is none, or an exact one."""
    from stereo_slam_env.frontend.camera_motion import audit_of  # needs OpenCV, which a judge of filters may lack

    audit = audit_of(recording)
    return {} if audit is None else {"its steps": str(audit)}


def _rig_found(recording: Recording) -> dict[str, str]:
    """Errors that the filter puts down to the rig, with standard errors and how far beyond their prior they are."""
    units = {"disparity_offset": (1.0, "px"), "right_yaw": (1e3, "mrad"), "right_roll": (1e3, "mrad")}
    errors = {name: (units[name], *value) for name, value in rig_errors(recording).items()}
    facts = []
    for name, ((scale, unit), value, sigma) in errors.items():
        words = f"{name.replace('_', ' ')} {scale * value:+.2f} ± {scale * sigma:.2f} {unit}"
        beyond = abs(value) > _FAR_FROM_PRIOR * getattr(recording.noise, name)
        facts.append(words + (f" (beyond {_FAR_FROM_PRIOR:g} sigma of what a rig may be wrong by)" if beyond else ""))
    return {"put down to the rig": f"{', '.join(facts)}; tracks that slide look the same"} if facts else {}


def _listed(entries: Mapping[str, object]) -> str:
    words = {key: f"{value:.4g}" if isinstance(value, float) else value for key, value in entries.items()}
    return ", ".join(f"{_LEFT_OUT.get(key, key)} = {value}" for key, value in words.items())
