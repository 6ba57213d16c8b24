"""Calibration of a drift model: its variances from drives with a truth, and the factor that makes it cover 90 %.

The variances maximise the likelihood of the errors of motions over windows, under Student's t, so that few bad windows
do not rule; the iteration is the minorise-maximise one for variance components (Zhou, Hu, Zhou and Lange, "MM
algorithms for variance components models", 2019), which keeps them positive. The factor is conformal: each drive is
scored by the model of the others, and the pooled distribution of the scores, drives alike, has its 90 % quantile where
the claimed ellipsoid has it (Dunn, Wasserman and Ramdas, "Distribution-free prediction sets for two-layer hierarchical
models", JASA 2022, pooled distributions).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.special import stdtrit

from filters import Pose, nees
from filters.checks.consistency import chi_square_quantile
from filters.contract.validation import positive
from filters.geometry import rotations
from filters.geometry.arrays import FloatArray, IntArray
from filters.motions.motion_model import POSE_SIZE
from stereo_slam_env.evaluation.body_frames import find_body_offset
from stereo_slam_env.evaluation.comparability import find_obstacles
from stereo_slam_env.evaluation.drift_model import DRIVERS, DriftModel, LengthCheck, basis
from stereo_slam_env.evaluation.gauges import UP, aligned_pair, find_alignment
from stereo_slam_env.evaluation.synchronisation import MAX_GAP, PosePairs, paired
from stereo_slam_env.evaluation.windows import LENGTHS, motions
from stereo_slam_env.recording.trajectory import Trajectory, pose_errors
from stereo_slam_env.recording.trajectory_files import load_trajectory

COVERED = 0.9
"""Share of windows that the factor makes the ellipsoids cover."""
_WINDOWS = 40
"""Windows of a length that a drive gives, from starts spread over it."""
_LONGER = 1.2
"""Windows that holes in the times make so many times as long are left out."""
_FREEDOM = 30.0
"""Degrees of freedom of Student's t."""
_ROUNDS = 80
"""Of the iteration; more change no covariance by a percent."""
_FEWEST_DRIVES = 3
"""With less there is no spread between drives to be known."""
_TURNED, _APART = np.deg2rad(10.0), 1.0
"""rad and m: an offset of the body below both is learned as part of the drift."""
_LEAST = 1e-12
"""m^2 and rad^2: variance that each pose has alone at least."""


@dataclass(frozen=True, eq=False)
class _Windows:
    """Errors of the motions of one drive, and what the variances of a model add to their covariances."""

    lengths: FloatArray
    """(W,), s."""
    errors: FloatArray
    """(W, 6): Log(T^^-1 T) of the motion."""
    parts: FloatArray
    """(P, W, 6, 6): of `basis`."""
    weights: FloatArray
    """(W,): the windows of a length weigh 1 together."""


def calibrate(
    estimates: Sequence[Trajectory | str | Path],
    references: Sequence[Trajectory | str | Path],
    *,
    body: Pose | Literal["estimated"] | None = None,
    max_gap: float = MAX_GAP,
) -> DriftModel:
    """Learn how the error of an odometry grows, from drives with a truth.

    Parameters
    ----------
    estimates : sequence of Trajectory, str or Path
        Trajectories of one system, a drive each, with times; files in any layout of `load_trajectory`.
    references : sequence of Trajectory, str or Path
        Their truths, in the same order; or one for all.
    body : Pose or "estimated", optional
        Pose T_bc of the truths' body in that of the estimates, m; "estimated": of each the one that fits best. None:
        they are the same.
    max_gap : float
        Largest difference between the times of a pose and its reference, s.

    Returns
    -------
    DriftModel
        For `claim`.

    Raises
    ------
    ValueError
        A file is damaged, there are not as many truths as estimates, or an estimate cannot be compared with its truth:
        it diverged, has another body or scale, or fits only where it is read in another way.
    """
    if not estimates:
        raise ValueError("calibrate needs at least one estimate, with its truth")
    if len(references) not in (1, len(estimates)):
        raise ValueError(
            f"calibrate got {len(estimates)} estimates and {len(references)} truths: give one truth an estimate, in "
            "the same order, or one for all"
        )
    positive("max_gap", max_gap)
    loaded = [_loaded(one) for one in estimates]
    truths = [_loaded(one) for one in references] * (len(loaded) if len(references) == 1 else 1)
    drives = [_windows_of(one, truth, body, max_gap) for one, truth in zip(loaded, truths, strict=True)]
    if len({one.tracks is None for one in loaded}) > 1:
        raise ValueError("some estimates have numbers of tracks and some have none: give them of all, or of none")
    names = tuple(one.name for one in loaded)
    variances = _fitted(drives)
    if len(drives) == 1:
        return DriftModel(variances, drives=names)
    scores = [_scores(_fitted([other for other in drives if other is not drive]), drive) for drive in drives]
    quantile, ideal = _pooled_quantile(drives, scores), chi_square_quantile(COVERED, POSE_SIZE)
    covered = [
        float(drive.weights @ (score <= quantile) / drive.weights.sum())
        for drive, score in zip(drives, scores, strict=True)
    ]
    factor = quantile / ideal
    return DriftModel(
        variances * factor,
        factor,
        names,
        float(np.std(covered, ddof=1) / np.sqrt(len(drives))),
        _checks(drives, [score / factor for score in scores]),
        _drive_range(drives, [score / factor for score in scores]),
    )


def _loaded(trajectory: Trajectory | str | Path) -> Trajectory:
    return trajectory if isinstance(trajectory, Trajectory) else load_trajectory(trajectory)


def _windows_of(
    estimate: Trajectory, reference: Trajectory, body: Pose | Literal["estimated"] | None, max_gap: float
) -> _Windows:
    """The windows of one drive, of all lengths that it has."""
    if estimate.timestamps is None or reference.timestamps is None:
        name = (estimate if estimate.timestamps is None else reference).name
        raise ValueError(f"{name} has no times, by which a drift grows: give it as TUM, with a time a row")
    pairs = paired(estimate, reference, max_gap)
    first, last, lengths = _ends(pairs.reference.timestamps)
    if not len(first):
        raise ValueError(f"{estimate.name} has no two poses {LENGTHS[0]:g} s apart with a truth: give a longer drive")
    if body is not None:
        T_bc = body if isinstance(body, Pose) else find_body_offset(pairs.estimate, pairs.reference).T_bc
        pairs = replace(pairs, reference=pairs.reference.of_body(T_bc.inverse()))
        reference = reference.of_body(T_bc.inverse())
    everything = np.ones(len(pairs.rows), dtype=bool)
    start = find_alignment("start", pairs.estimate, pairs.reference, everything, UP["z"])
    from_start = aligned_pair(pairs.estimate, pairs.reference, start)
    why = find_obstacles(pairs, (estimate, reference), from_start).obstacles["pose"]
    if why and why != _small_offset(pairs):
        raise ValueError(f"nothing is learned from {estimate.name}: {why}")
    moved, truly = (motions(one, first, last) for one in (pairs.estimate, pairs.reference))
    errors = pose_errors("right", *moved, *truly)
    counts = {length: np.count_nonzero(lengths == length) for length in np.unique(lengths)}
    weights = np.array([1.0 / counts[length] for length in lengths])
    parts = np.stack(list(basis(estimate, pairs.rows[first], pairs.rows[last])))
    return _Windows(lengths, errors, parts, weights)


def _small_offset(pairs: PosePairs) -> str:
    """An offset of the body so small that what is learned may hold it, in words; empty where there is none."""
    offset = find_body_offset(pairs.estimate, pairs.reference)
    turn = np.linalg.norm(rotations.log(offset.T_bc.R_wc))
    return offset.words if turn < _TURNED and np.linalg.norm(offset.T_bc.position) < _APART else ""


def _ends(times: FloatArray | None) -> tuple[IntArray, IntArray, FloatArray]:
    """First and last rows (W,) of windows, and their length, s."""
    assert times is not None
    first, last, lengths = [], [], []
    for length in LENGTHS:
        ends = np.searchsorted(times, times + length - 1e-6)
        starts = np.flatnonzero(ends < len(times))
        starts = starts[times[ends[starts]] - times[starts] <= _LONGER * length]
        starts = starts[np.unique(np.linspace(0, len(starts) - 1, min(_WINDOWS, len(starts))).astype(int))]
        first.append(starts)
        last.append(ends[starts])
        lengths.append(np.full(len(starts), length))
    return np.concatenate(first), np.concatenate(last), np.concatenate(lengths)


def _fitted(drives: Sequence[_Windows]) -> FloatArray:
    """The variances (6, 6) that make the errors of these drives most likely."""
    errors = np.concatenate([drive.errors for drive in drives])
    weights = np.concatenate([drive.weights for drive in drives])
    parts = np.concatenate([drive.parts for drive in drives], axis=1)
    count = len(errors)
    # Begin with what each would be if it explained its own axis, all alike.
    axes = np.tile(np.arange(POSE_SIZE), len(DRIVERS) + 2)
    explained = np.array([weights @ part[:, axis, axis] for part, axis in zip(parts, axes, strict=True)])
    variances = (weights @ errors**2)[axes] / np.maximum(explained, _LEAST) / (len(DRIVERS) + 2)
    flat = parts.reshape(len(parts), -1)
    for _ in range(_ROUNDS):
        variances[:POSE_SIZE] = np.maximum(variances[:POSE_SIZE], _LEAST)
        inverse = np.linalg.inv((variances @ flat).reshape(count, POSE_SIZE, POSE_SIZE))
        pulled = (inverse @ errors[:, :, None])[:, :, 0]
        tamed = (_FREEDOM + POSE_SIZE) / (_FREEDOM + np.sum(errors * pulled, axis=1))
        found = flat @ ((weights * tamed)[:, None, None] * pulled[:, :, None] * pulled[:, None, :]).ravel()
        expected = flat @ (weights[:, None, None] * inverse).ravel()
        variances = variances * np.sqrt(found / np.maximum(expected, 1e-300))
    variances[:POSE_SIZE] = np.maximum(variances[:POSE_SIZE], _LEAST)
    fitted: FloatArray = variances.reshape(-1, POSE_SIZE)
    return fitted


def _scores(variances: FloatArray, drive: _Windows) -> FloatArray:
    """NEES (W,) of the errors of a drive under these variances."""
    covariances: FloatArray = np.tensordot(variances.ravel(), drive.parts, axes=1)
    return nees(drive.errors, covariances)


def _pooled_quantile(drives: Sequence[_Windows], scores: Sequence[FloatArray]) -> float:
    """Quantile `COVERED` of the scores, in which drives and lengths weigh alike."""
    values = np.concatenate(scores)
    shares = np.concatenate([drive.weights / drive.weights.sum() for drive in drives])
    order = np.argsort(values)
    reached = np.cumsum(shares[order]) / len(drives)
    return float(values[order][np.searchsorted(reached, COVERED)])


def _drive_range(drives: Sequence[_Windows], scores: Sequence[FloatArray]) -> tuple[float, float] | None:
    """Prediction interval of the mean NEES / 6 of a new drive: log-normal between drives, each by the others' model."""
    if len(drives) < _FEWEST_DRIVES:
        return None
    logs = np.log(
        [drive.weights @ score / drive.weights.sum() / 6.0 for drive, score in zip(drives, scores, strict=True)]
    )
    count = len(logs)
    half = stdtrit(count - 1, 0.5 + 0.5 * COVERED) * logs.std(ddof=1) * np.sqrt(1.0 + 1.0 / count)
    return float(np.exp(logs.mean() - half)), float(np.exp(logs.mean() + half))


def _checks(drives: Sequence[_Windows], scores: Sequence[FloatArray]) -> tuple[LengthCheck, ...]:
    ideal = chi_square_quantile(COVERED, POSE_SIZE)
    checks = []
    for length in LENGTHS:
        each = [score[at] for drive, score in zip(drives, scores, strict=True) if (at := drive.lengths == length).any()]
        if each:
            checks.append(
                LengthCheck(
                    length,
                    len(each),
                    sum(map(len, each)),
                    float(np.mean([values.mean() for values in each])),
                    float(np.mean([np.mean(values <= ideal) for values in each])),
                )
            )
    return tuple(checks)
