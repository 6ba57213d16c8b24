"""One camera and an inertial unit: `msckf` with its gate and without, and `inertial` with one mistake after the other.

python benchmarks/monocular_inertial.py flights               # 20 flights of 15 s, three minutes
python benchmarks/monocular_inertial.py drives --frames 200
python benchmarks/monocular_inertial.py flights --period 0.05 --frames 300 --rest 0 5         # 5 s at rest, then 10 s
python benchmarks/monocular_inertial.py flights --period 0.05 --frames 300 --rest 0 5 --mistakes
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from filters import StereoObservation
from harness import arguments, show
from stereo_slam_env import Recording, evaluate
from stereo_slam_env.benchmark.recordings.inertial_problem import inertial_drive, inertial_flight
from stereo_slam_env.evaluation.bands import mean_band
from stereo_slam_env.sensing.imu import DATA_SHEETS

PROBLEMS = {"flights": inertial_flight, "drives": inertial_drive}
MONOCULAR = {"measurement": "left", "use_odometry": False}
OPTIONS = {"motion": "strapdown", "map_landmarks": 0, **MONOCULAR}
LOST, FALSE = 10.0, 10.0
"""Position error, m, of a run that has diverged, and NEES/6 of one whose claim is false."""
HEADS = ["median error, m", "largest", "claim at the end, m", "rotation, mrad", "NEES/6", "NEES/3", "at the end"]
EXACT = replace(DATA_SHEETS["adis16448"], scale=0.0, misalignment=0.0)
INVENTED = 5.0
"""Depth of all new points, m, where no camera has measured it."""
Change = Callable[[Recording], Recording]


def main() -> None:
    """Rows of gates or of mistakes: errors, claims, and runs that are lost or false."""
    given = arguments(
        __doc__,
        "problem",
        problem=tuple(PROBLEMS),
        seeds=20,
        frames=150,
        landmarks=40,
        period=0.1,
        rest=[0.0, 0.0],
        speed=0.5,
        mistakes=False,
    )

    def recorded(**options: Any) -> list[Recording]:
        settings = {name: getattr(given, name) for name in ("frames", "landmarks", "period", "rest")}
        runs = [PROBLEMS[given.problem](seed, **settings, **options) for seed in range(given.seeds)]
        return [told(one, given.speed) for one in runs]

    rows, right = [], recorded(imu=EXACT) if given.mistakes else recorded()
    if given.mistakes:
        late = {f"samples {1e3 * late:g} ms late": {"time_offset": late} for late in (0.002, 0.005)}
        turned = {"samples turned by 0.2 deg": {"imu": replace(EXACT, misalignment=np.deg2rad(0.2))}}
        for name, options in (late | turned).items():
            rows.append([name, *scores("inertial", recorded(**{"imu": EXACT, **options}), **MONOCULAR)])
        for name, (change, options) in MISTAKES.items():
            rows.append([name, *scores("inertial", [change(one) for one in right], **MONOCULAR, **options)])
    else:
        for gate in (0.99, None):
            rows.append([f"msckf, gate {gate}", *scores("msckf", right, gate=gate, **OPTIONS)])
        rows.append(["inertial, one camera", *scores("inertial", right, **MONOCULAR)])
    low, high = (bound / 3.0 for bound in mean_band(3, given.seeds))
    title = f"{given.seeds} {given.problem} of {given.frames * given.period:.0f} s; NEES/3 at the end in its band"
    show(f"{title}: {low:.2f} to {high:.2f}", ["", *HEADS, "lost", "false"], rows)


def scores(name: str, recordings: list[Recording], **options: Any) -> list[str]:
    """Cells of a row: medians over the runs, but the largest error and the mean of the NEES/3 at the end."""
    runs = [evaluate(name, one, **options) for one in recordings]
    errors, nees = np.array([(run.figures.position_rmse_m, run.figures.pose_anees / 6.0) for run in runs]).T
    series = [run.series for run in runs]
    claims = [np.sqrt(np.trace(one.pose_covariances[-1, :3, :3])) for one in series]
    turns = [Rotation.from_quat(one.orientations).inv() * Rotation.from_quat(one.true_orientations) for one in series]
    rotations = [1e3 * np.sqrt(np.mean(turn.magnitude() ** 2)) for turn in turns]
    positions = np.array([one.position_nees for one in series]) / 3.0
    medians = np.median(claims), np.median(rotations), np.median(nees), np.median(np.nanmean(positions, axis=1))
    cells = f"{np.median(errors):.3f}", f"{errors.max():.3f}", *(f"{x:.3g}" for x in medians)
    return [*cells, f"{positions[:, -1].mean():.3g}", str(np.sum(errors > LOST)), str(np.sum(nees > FALSE))]


def told(recording: Recording, sigma: float) -> Recording:
    """The recording with a speed at the start that is known to so many m/s, instead of 0.5."""
    start, truth = recording.start, recording.frames[0].truth_velocity.linear
    covariance, share = start.covariance.copy(), sigma / 0.5
    covariance[6:9, 6:9] *= share**2
    velocity = truth + share * (start.linear_velocity - truth)
    return replace(recording, start=replace(start, linear_velocity=velocity, covariance=covariance))


def unchanged(recording: Recording) -> Recording:
    """The recording itself."""
    return recording


def zoomed(recording: Recording) -> Recording:
    """The recording with a focal length that is 0.3 % too large."""
    camera = recording.camera
    return replace(recording, camera=replace(camera, fx=1.003 * camera.fx, fy=1.003 * camera.fy))


def boasted(recording: Recording) -> Recording:
    """The recording with densities of the unit that are three times too small."""
    frames = []
    for frame in recording.frames:
        if frame.inertial is not None:
            unit = frame.inertial.unit
            names = "gyro_density", "accelerometer_density", "gyro_walk", "accelerometer_walk"
            unit = replace(unit, **{name: getattr(unit, name) / 3.0 for name in names})
            frame = replace(frame, inertial=replace(frame.inertial, unit=unit))
        frames.append(frame)
    return replace(recording, frames=tuple(frames))


def drifting(recording: Recording) -> Recording:
    """The recording with tracks that walk by 0.3 px a frame, as those of KLT slide off their points."""
    rng, off, frames = np.random.default_rng(0), {}, []
    for frame in recording.frames:
        seen = frame.observation
        off = {i: off.get(i, 0.0) + 0.3 * rng.standard_normal(2) for i in seen.ids.tolist()}
        uvd = seen.uvd + np.array([[*off[i], 0.0] for i in seen.ids.tolist()]).reshape(-1, 3)
        frames.append(replace(frame, observation=StereoObservation(seen.ids, uvd)))
    return replace(recording, frames=tuple(frames))


def invented(share: float) -> Change:
    """A change to disparities of points at a depth of 5 m, whose deviation is that share of them; 0: as measured."""

    def change(recording: Recording) -> Recording:
        d, frames = recording.camera.disparity_constant / INVENTED, []
        for frame in recording.frames:
            seen = frame.observation
            R = seen.covariances(recording.noise).copy()
            if share:
                R[:, 2, :2] = R[:, :2, 2] = 0.0
                R[:, 2, 2] = (share * d) ** 2
            uvd = np.column_stack([seen.uvd[:, :2], np.full(len(seen), d)])
            frames.append(replace(frame, observation=StereoObservation(seen.ids, uvd, None, R)))
        return replace(recording, frames=tuple(frames))

    return change


def alone(recording: Recording) -> Recording:
    """The recording as one camera measures it."""
    frames = []
    for frame in recording.frames:
        seen = frame.observation
        R = seen.covariances(recording.noise)[:, :2, :2]
        frames.append(replace(frame, observation=StereoObservation.of_left(seen.ids, seen.uvd[:, :2], R)))
    return replace(recording, frames=tuple(frames))


MISTAKES: Mapping[str, tuple[Change, Mapping[str, Any]]] = {
    "none": (unchanged, {}),
    "focal length 0.3 % too large": (zoomed, {}),
    "densities three times too small": (boasted, {}),
    "tracks that walk by 0.3 px": (drifting, {}),
    "quaternion errors": (unchanged, {"error": "quaternion"}),
    "first-estimates": (unchanged, {"error": "first-estimates"}),
    "no disparities at all": (alone, {}),
    "disparities invented, as if measured": (invented(0.0), {}),
    "disparities invented, off by half": (invented(0.5), {}),
    "disparities invented, off by all": (invented(1.0), {}),
}

if __name__ == "__main__":
    main()
