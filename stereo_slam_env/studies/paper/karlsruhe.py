"""The same judgements on the paper's own recordings, for those who have them: one drive each, and no true landmarks.

Section 4.3 is frames 61 to 72 of `2009_09_08_drive_0010`, where intervals are over landmarks of the one drive; they
say nothing about other drives. Section 4.4 is 800 frames of `2009_09_08_drive_0015` against the GPS/IMU unit, a weak
truth of metres: one number, which is taken as it is. Consistency can be judged by the innovations only.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from filters.validation import FloatArray
from stereo_slam_env.datasets import layout_of, open_for_front_end
from stereo_slam_env.evaluation.filter_run import run_filter
from stereo_slam_env.evaluation.trajectory_metrics import ate_rigid
from stereo_slam_env.frontend.recorder import record_tracks
from stereo_slam_env.recording.recording import Recording
from stereo_slam_env.studies.paper import convergence, limits, long_drive, sentences
from stereo_slam_env.studies.paper.claims import Claim, Finding, Interval, Range, Sentence
from stereo_slam_env.studies.paper.convergence import Depths
from stereo_slam_env.studies.paper.depth_history import (
    DepthHistory,
    follow_depths,
    measured_disparities,
    seen_throughout,
    with_one_noise,
)
from stereo_slam_env.studies.paper.intervals import mean_interval, ratio_interval
from stereo_slam_env.studies.paper.parts import Arrays, Part
from stereo_slam_env.studies.paper.settings import ASSUMED, COMMON_OPTIONS, DIAGONAL, DUAL, JOINT

TURN, DRIVE = "2009_09_08_drive_0010", "2009_09_08_drive_0015"
TURN_FRAMES, DRIVE_FRAMES = (61, 72), (0, 799)
"""First and last, both included."""
HOW_TO_GET_IT = (
    f"Not judged on the Karlsruhe sequences: get {TURN} and {DRIVE} with 2009_09_08_calib.txt from "
    "www.cvlibs.net/datasets/karlsruhe_sequences and give their folder with --karlsruhe."
)
PREFIX = "karlsruhe-"
OWN = "measurement"
R_NAMES: Mapping[str, str] = {DIAGONAL: "the paper's", OWN: "each measurement's own"}
OPTIONS: Mapping[str, Any] = {**COMMON_OPTIONS, "gate": 0.99, "consensus": True}
"""A front end makes mistakes, so they are looked for."""
NEAR_BELOW, FAR_FROM = 30.0, 45.0
"""m, by the median of the raw depths."""
CASES = tuple((name, R) for name in (JOINT, DUAL) for R in R_NAMES)


def sequences(path: Path) -> dict[str, Path]:
    """Which of the two sequences are in a folder (or are the folder).

    Raises
    ------
    ValueError
        Neither is there.
    """
    found = {
        name: folder
        for name in (TURN, DRIVE)
        for folder in (path / name, path)
        if folder.name == name and folder.is_dir() and layout_of(folder) == "karlsruhe"
    }
    if not found:
        raise ValueError(
            f"{path} holds neither {TURN} nor {DRIVE} with images I1_*.png, I2_*.png and 2009_09_08_calib.txt in it "
            f"or beside it"
        )
    return found


def parts(found: Mapping[str, Path]) -> list[Part]:
    """The work on what is there."""
    work: dict[str, tuple[Callable[[Path, tuple[int, int]], Arrays], tuple[int, int]]] = {
        TURN: (compute_turn, TURN_FRAMES),
        DRIVE: (compute_drive, DRIVE_FRAMES),
    }
    return [
        Part(
            f"karlsruhe-{name}",
            {"path": str(folder.resolve()), "frames": work[name][1], "files": _stamp(folder), "options": dict(OPTIONS)},
            partial(work[name][0], folder, work[name][1]),
        )
        for name, folder in found.items()
    ]


def compute_turn(folder: Path, frames: tuple[int, int]) -> Arrays:
    """Depth histories of the landmarks seen throughout."""
    recording = _recording(folder, frames, {"probation": 0})
    ids = seen_throughout(recording)
    raw = convergence.raw_depths(measured_disparities(recording, ids), recording.camera.disparity_constant)
    arrays: Arrays = {"raw": raw, "disparity_constant": np.array(recording.camera.disparity_constant)}
    for name, R in CASES:
        history = follow_depths(with_one_noise(recording, ASSUMED.get(R)), name, ids, OPTIONS)
        arrays |= {f"{name}.{R}.{field}": values for field, values in vars(history).items()}
    return arrays


def compute_drive(folder: Path, frames: tuple[int, int]) -> Arrays:
    """Trajectories, velocities and innovations."""
    recording = _recording(folder, frames, {})
    arrays: Arrays = {}
    for name, R in CASES:
        run = run_filter(with_one_noise(recording, ASSUMED.get(R)), name, OPTIONS)
        arrays |= {f"{name}.{R}.{series}": values for series, values in long_drive.series_of(run).items()}
        truth = long_drive.true_series_of(run)
        steps = np.diff(run.true_positions, axis=0) / np.diff(run.timestamps)[:, None]
        truth["velocities"] = np.vstack([steps[:1], steps])
        arrays |= {f"{long_drive.TRUTH}.{series}": values for series, values in truth.items()}
    return arrays


def depths(results: Mapping[str, Arrays]) -> Depths | None:
    """What the turn showed, every landmark for itself; None where it was not run."""
    arrays = results.get(f"karlsruhe-{TURN}")
    if arrays is None:
        return None
    typical = np.nanmedian(arrays["raw"], axis=1) if arrays["raw"].size else np.zeros(0)
    label = np.select([typical < NEAR_BELOW, typical >= FAR_FROM], ["near", "far"], "between")
    filters = {
        (name, R): DepthHistory(*(arrays[f"{name}.{R}.{field}"] for field in ("d", "sigma_d", "hindsight")))
        for name, R in CASES
    }
    unknown = np.full_like(arrays["raw"], np.nan)
    constant = float(arrays["disparity_constant"])
    return Depths(np.arange(len(label)), label, unknown, arrays["raw"], filters, constant)


def drive(results: Mapping[str, Arrays], case: str) -> dict[str, FloatArray] | None:
    """Series of the long drive where all of it is known; None where it was not run."""
    arrays = results.get(f"karlsruhe-{DRIVE}")
    if arrays is None:
        return None
    known = np.isfinite(arrays[f"{long_drive.TRUTH}.positions"]).all(axis=1)
    return {name: values[known] for name, values in long_drive.one(arrays, case).items()}


def claims(results: Mapping[str, Arrays]) -> tuple[Claim, ...]:
    """The claims, judged on the recordings that were run."""
    return (*_claims_of_turn(results), *_claims_of_drive(results))


def _claims_of_turn(results: Mapping[str, Arrays]) -> list[Claim]:
    found = depths(results)
    if found is None:
        return []

    def against_rival(quantity: convergence.Quantity) -> tuple[Finding, ...]:
        return tuple(
            Finding(
                {"R": name, "landmark": label},
                ratio_interval(*(convergence.of_drives(found, label, quantity, (who, R)) for who in (JOINT, DUAL))),
                limits.BETTER,
            )
            for R, name in R_NAMES.items()
            for label in convergence.RANGES
        )

    return [
        Claim(_here(sentences.UNCERTAINTY_CONVERGES, "karlsruhe-4"), against_rival(convergence.sigma)),
        Claim(_here(sentences.SMOOTHER, "karlsruhe-4"), against_rival(convergence.roughness)),
        Claim(_here(sentences.RAW_MEAN, "karlsruhe-4"), against_rival(convergence.distance_to_raw_mean)),
    ]


def _claims_of_drive(results: Mapping[str, Arrays]) -> list[Claim]:
    true = drive(results, long_drive.TRUTH)
    if true is None:
        return []

    def of_ours(quantity: long_drive.Quantity, asked: Range) -> tuple[Finding, ...]:
        return tuple(
            Finding({"R": name}, _as_it_is(_of(results, (JOINT, R), quantity)), asked) for R, name in R_NAMES.items()
        )

    consistent = []
    for R, name in R_NAMES.items():
        arrays = results[f"karlsruhe-{DRIVE}"]
        nis, dof = (arrays[f"{JOINT}.{R}.{series}"] for series in ("nis", "nis_dof"))
        consistent.append(Finding({"R": name}, mean_interval(nis[dof > 0] / dof[dof > 0]), limits.CONSISTENT))
    ratio = tuple(
        Finding(
            {"R": name},
            _as_it_is(_of(results, (JOINT, R), aligned_error) / _of(results, (DUAL, R), aligned_error)),
            limits.BETTER,
        )
        for R, name in R_NAMES.items()
    )
    by_innovations = replace(
        _here(sentences.CONSISTENT, "karlsruhe-6"), statement=f"NIS by its degrees of freedom: {limits.CONSISTENT}"
    )
    judged = [Claim(by_innovations, tuple(consistent))]
    if len(true["positions"]) > long_drive.CHORD:
        judged += [
            Claim(_here(sentences.TRAJECTORY, "karlsruhe-6"), of_ours(aligned_error, limits.POSITION_M)),
            Claim(_here(sentences.DRIFT, "karlsruhe-6"), of_ours(long_drive.drift_percent, limits.DRIFT_PERCENT)),
            Claim(_here(sentences.YAW, "karlsruhe-6"), of_ours(long_drive.yaw_rmse, limits.YAW_DEG)),
            Claim(_here(sentences.VELOCITY, "karlsruhe-6"), of_ours(long_drive.velocity_rmse, limits.VELOCITY_M_S)),
            Claim(_here(sentences.SCALE, "karlsruhe-6"), of_ours(scale_error, limits.SCALE_PERCENT)),
            Claim(_here(sentences.RANGE_HELPS, "karlsruhe-6"), ratio),
        ]
    return judged


def aligned_error(said: Mapping[str, FloatArray], true: Mapping[str, FloatArray]) -> float:
    """RMS position error after the best rigid motion, m: the weak truth begins no better than it goes on."""
    return ate_rigid(said["positions"], true["positions"])


def scale_error(said: Mapping[str, FloatArray], true: Mapping[str, FloatArray]) -> float:
    """Without its sign, %."""
    return abs(long_drive.scale_error_percent(said, true))


def _of(results: Mapping[str, Arrays], case: tuple[str, str], quantity: long_drive.Quantity) -> float:
    said, true = drive(results, ".".join(case)), drive(results, long_drive.TRUTH)
    assert said is not None
    assert true is not None
    return quantity(said, true) if np.isfinite(said["positions"]).all() else np.nan


def _as_it_is(value: float) -> Interval:
    """One drive, one number: nothing is said of others."""
    return Interval(value, value, value)


def _here(sentence: Sentence, evidence: str) -> Sentence:
    return replace(
        sentence, key=f"{PREFIX}{sentence.key}", section=f"{sentence.section} (Karlsruhe)", evidence=evidence
    )


def _recording(folder: Path, frames: tuple[int, int], front_end: Mapping[str, Any]) -> Recording:
    sequence, settings = open_for_front_end(folder, first=frames[0], last=frames[1], on_broken="skip")
    return record_tracks(sequence, replace(settings, **front_end))


def _stamp(folder: Path) -> list[Any]:
    """What tells that the files are still the same."""
    files = [path for path in folder.iterdir() if path.is_file()]
    return [len(files), sum(path.stat().st_size for path in files), max(path.stat().st_mtime for path in files)]
