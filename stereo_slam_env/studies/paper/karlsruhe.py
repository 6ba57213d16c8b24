"""Sections 4.3 and 4.4 on the paper's own recordings: one drive each, and no true landmarks.

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

from stereo_slam_env import Recording, evaluate
from stereo_slam_env.datasets import layout_of, open_for_front_end
from stereo_slam_env.evaluation import FilterRun, ate_rigid
from stereo_slam_env.frontend import record_tracks
from stereo_slam_env.studies.paper import convergence, long_drive
from stereo_slam_env.studies.paper.claims import (
    ASSUMED,
    COMMON_OPTIONS,
    DIAGONAL,
    DUAL,
    JOINT,
    SENTENCES,
    Arrays,
    Claim,
    FloatArray,
    Interval,
    Measured,
    Sentence,
    claim,
    mean_interval,
    ratio_interval,
)

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
    """The folders of those of the two sequences that are in a folder (or are the folder); at least one."""
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


def experiments(found: Mapping[str, Path]) -> dict[str, partial[Arrays]]:
    """The work on the sequences that are there."""
    work = {TURN: (turn, TURN_FRAMES), DRIVE: (drive, DRIVE_FRAMES)}
    return {
        f"{PREFIX}{name}": partial(work[name][0], str(folder.resolve()), work[name][1], files=_stamp(folder))
        for name, folder in found.items()
    }


def turn(folder: str, frames: tuple[int, int], files: Any = None) -> Arrays:
    """Depth histories of the landmarks seen throughout; `files` tells results of other files apart."""
    recording = _recording(folder, frames)
    ids = convergence.seen_throughout(recording)
    constant = recording.camera.disparity_constant
    raw = convergence.raw_depths(convergence.measured_disparities(recording, ids), constant)
    alike = {DIAGONAL: ASSUMED[DIAGONAL]}
    return {
        "raw": raw,
        "disparity_constant": np.array(constant),
        **convergence.follow_all(_without_own_R(recording), alike, ids, OPTIONS),
        **convergence.follow_all(recording, {OWN: recording.noise}, ids, OPTIONS),
    }


def drive(folder: str, frames: tuple[int, int], files: Any = None) -> Arrays:
    """Figures of the drive by filter and R, and the courses to show, where the truth is known."""
    recording = _recording(folder, frames)
    arrays: Arrays = {}
    for name, R in CASES:
        own = R == OWN
        slam_input = recording if own else _without_own_R(recording)
        run = evaluate(name, slam_input, noise=None if own else ASSUMED[R], **OPTIONS).series
        case, used, known = f"{name}.{R}", run.nis_dof > 0, _known(run)
        arrays[f"{case}.nis"] = run.nis[used] / run.nis_dof[used]
        if len(known.positions) > long_drive.CHORD:
            for key, quantity in QUANTITIES.items():
                arrays[f"{case}.{key}"] = long_drive.of_runs([known], quantity)
        if (name, R) == SHOWN and len(known.positions):
            for who, course in (("said", long_drive.course(known)), ("true", long_drive.course(known, true=True))):
                arrays |= {f"{who}.{series}": values for series, values in course.items()}
    return arrays


def aligned_error(run: FilterRun) -> float:
    """RMS position error after the best rigid motion, m: the weak truth begins no better than it goes on."""
    return ate_rigid(run.positions, run.true_positions)


def scale_error(run: FilterRun) -> float:
    """Without its sign, %."""
    return abs(long_drive.scale_error_percent(run))


SHOWN = (JOINT, OWN)
QUANTITIES: Mapping[str, long_drive.Quantity] = {
    "trajectory": aligned_error,
    "drift": long_drive.drift_percent,
    "yaw": long_drive.yaw_rmse,
    "velocity": long_drive.velocity_rmse,
    "scale": scale_error,
}
"""Of the drive, by key of the sentence."""


def depths(results: Mapping[str, Arrays]) -> convergence.Depths | None:
    """The turn, every landmark for itself; None where it was not run."""
    arrays = results.get(f"{PREFIX}{TURN}")
    if arrays is None:
        return None
    typical = np.nanmedian(arrays["raw"], axis=1) if arrays["raw"].size else np.zeros(0)
    label = np.select([typical < NEAR_BELOW, typical >= FAR_FROM], ["near", "far"], "between")
    unknown = np.full_like(arrays["raw"], np.nan)
    filters = convergence.histories(arrays, CASES)
    constant = float(arrays["disparity_constant"])
    return convergence.Depths(np.arange(len(label)), label, unknown, arrays["raw"], filters, constant)


def course(results: Mapping[str, Arrays], who: str) -> dict[str, FloatArray] | None:
    """Curves of figure 6: of the filter ("said") or of the truth ("true"); None where there is none."""
    arrays = results.get(f"{PREFIX}{DRIVE}", {})
    found = {name.removeprefix(f"{who}."): values for name, values in arrays.items() if name.startswith(f"{who}.")}
    return found or None


def judge(results: Mapping[str, Arrays]) -> tuple[Claim, ...]:
    """The claims, on the recordings that were run."""
    return (*_claims_of_turn(results), *_claims_of_drive(results))


def _claims_of_turn(results: Mapping[str, Arrays]) -> list[Claim]:
    found = depths(results)
    if found is None:
        return []

    def against_competitor(quantity: convergence.Quantity) -> Measured:
        for R, name in R_NAMES.items():
            for label in convergence.RANGES:
                both = (convergence.of_drives(found, label, quantity, (who, R)) for who in (JOINT, DUAL))
                yield {"R": name, "landmark": label}, ratio_interval(*both)

    return [
        claim(_here(key, "karlsruhe-4"), against_competitor(quantity))
        for key, quantity in (
            ("uncertainty-converges", convergence.sigma),
            ("smoother", convergence.roughness),
            ("raw-mean", convergence.distance_to_raw_mean),
        )
    ]


def _claims_of_drive(results: Mapping[str, Arrays]) -> list[Claim]:
    arrays = results.get(f"{PREFIX}{DRIVE}")
    if arrays is None:
        return []

    def value(name: str, key: str, R: str) -> float:
        return float(arrays[f"{name}.{R}.{key}"][0])

    def as_it_is(values: Callable[[str], float]) -> Measured:
        """One drive, one number: nothing is said of others."""
        return [({"R": words}, Interval(found, found, found)) for R, words in R_NAMES.items() for found in [values(R)]]

    consistent = _here("consistent", "karlsruhe-6")
    consistent = replace(consistent, statement=f"NIS by its degrees of freedom: {consistent.asked}")
    nis = [({"R": words}, mean_interval(arrays[f"{JOINT}.{R}.nis"])) for R, words in R_NAMES.items()]
    judged = [claim(consistent, nis)]
    if f"{JOINT}.{OWN}.trajectory" not in arrays:  # too short to be a drive
        return judged
    for key in QUANTITIES:
        judged.append(claim(_here(key, "karlsruhe-6"), as_it_is(partial(value, JOINT, key))))
    ratios = as_it_is(lambda R: value(JOINT, "trajectory", R) / value(DUAL, "trajectory", R))
    return [*judged, claim(_here("range-helps", "karlsruhe-6"), ratios)]


def _here(key: str, evidence: str) -> Sentence:
    sentence = SENTENCES[key]
    return replace(sentence, key=f"{PREFIX}{key}", section=f"{sentence.section} (Karlsruhe)", evidence=evidence)


def _known(run: FilterRun) -> FilterRun:
    """The run in the frames with a true position, with the true velocities that these positions mean."""
    steps = np.diff(run.true_positions, axis=0) / np.diff(run.timestamps)[:, None]
    run = replace(run, true_linear_velocities=np.vstack([steps[:1], steps]))
    known = np.isfinite(run.true_positions).all(axis=1)
    series = ("positions", "orientations", "linear_velocities")
    return replace(
        run, **{f"{who}{name}": getattr(run, f"{who}{name}")[known] for who in ("", "true_") for name in series}
    )


def _without_own_R(recording: Recording) -> Recording:
    """The recording without the R of each measurement, so that all have the one that filters assume."""
    return recording.with_observations(replace(frame.observation, R=None) for frame in recording.frames)


def _recording(folder: str, frames: tuple[int, int]) -> Recording:
    sequence, settings = open_for_front_end(folder, first=frames[0], last=frames[1], on_broken="skip")
    return record_tracks(sequence, settings)


def _stamp(folder: Path) -> list[float]:
    """Fingerprint of the files."""
    files = [path for path in folder.iterdir() if path.is_file()]
    return [len(files), sum(path.stat().st_size for path in files), max(path.stat().st_mtime for path in files)]
