"""What makes a covariance believable on real tracks, part by part, and what a recording says of its own errors.

    python benchmarks/real_covariances.py DATA                  # five minutes
    python benchmarks/real_covariances.py --rendered 20         # right turns in rendered images, ten minutes
    python benchmarks/real_covariances.py --rendered 6 --route town --renderers gl --first-seed 30      # ten minutes
    python benchmarks/real_covariances.py DATA --estimates      # of the errors that all tracks have in common

DATA is the folder that holds the recordings `kitti07_tracks`, `kitti00_stereo_tracks`, `kitti06_stereo51` and
`starry_night_a`; those that are there are run. Each row adds one part to the row above; the last one is the filter
"coloured-noise" as it is. NEES/6 should be 1, of the pose and of the motion over windows; frames in the two-sided 95 %
band, %; rigid ATE, m. Of rendered drives also the mean roll error at the end, with its standard error over the seeds:
rotation about the optical axis, estimated against true, in microradians a frame.

`--estimates` compares what could size the gauge walk without ground truth, all in rad per root of a radian of image
motion: half of the difference between motions measured by two halves of the landmarks (at
random, left and right, near and far), over windows of ten frames; and the walk with which NEES/6 is 1, which needs the
truth.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

import stereo_slam_env as sse
from filters import ColouredNoise
from filters.geometry import rotations
from filters.geometry.arrays import BoolArray, FloatArray
from filters.kernels.process_noise import TURN_WEIGHT
from harness import arguments, mean_and_error, show
from stereo_slam_env.evaluation.filter_run import run_filter
from stereo_slam_env.evaluation.results import FilterRun, FilterSummary
from stereo_slam_env.evaluation.run_figures import figures_of, summarise_all
from stereo_slam_env.frontend.camera_motion import FIRST_GUESS
from stereo_slam_env.frontend.ego_motion import Pairs, Step, chained, robust_step
from stereo_slam_env.recording.recording import Recording

RECORDINGS = ("kitti07_tracks", "kitti00_stereo_tracks", "kitti06_stereo51", "starry_night_a")
WINDOW = 10
"""Frames over which the motions of two halves of the landmarks are compared."""
EXACT_RIG = dict.fromkeys(("misalignment", "scale", "disparity_offset", "right_yaw", "right_roll"), 0.0)


def parts(recording: Recording) -> Iterator[tuple[str, str, dict[str, Any], Recording]]:
    """What is added, the filter, its options, and the recording with what is stated of its noise."""
    yield "plain", "shared-anchor", {"gate": 0.99, "consensus": True}, recording
    noise = recording.noise
    if not isinstance(noise, ColouredNoise):
        yield "right-invariant errors", "coloured-noise", {}, recording
        return
    exact = replace(noise, **EXACT_RIG)
    walking = replace(recording, noise=exact)
    bare = {"error": "quaternion", "gauge_walk": 0.0}
    if noise.lasting is not None:
        points_walk = replace(exact, lasting=None, lasting_time=None)
        yield "landmark drift", "coloured-noise", bare, replace(recording, noise=points_walk)
        yield "errors kept in its place", "coloured-noise", bare, walking
    elif noise.drift is not None:
        yield "landmark drift", "coloured-noise", bare, walking
    yield "right-invariant errors", "coloured-noise", {"gauge_walk": 0.0}, walking
    yield "gauge walk", "coloured-noise", {}, walking
    unseen = replace(exact, misalignment=noise.misalignment, scale=noise.scale)
    yield "misalignment and scale", "coloured-noise", {}, replace(recording, noise=unseen)
    yield "rotation and offset of the right camera", "coloured-noise", {}, recording


def judged(recording: Recording, name: str, options: Mapping[str, Any], odometry: bool, windows: bool = True) -> Any:
    """Summary of a filter on a recording."""
    return summary_of(run_filter(recording, name, options, use_odometry=odometry, windows=windows))


def summary_of(run: FilterRun) -> FilterSummary:
    """Summary of one run."""
    return summarise_all([run], figures_of([run], divergence_percent=10.0))[0]


def roll_rate(run: FilterRun) -> float:
    """Roll error at the end by the number of frames, rad."""
    estimated, true = (rotations.matrix(q[-1]) for q in (run.orientations, run.true_orientations))
    return float(rotations.log(true.T @ estimated)[2]) / (len(run.orientations) - 1)


def cells(summary: FilterSummary) -> list[str]:
    """The figures of a row."""
    nees = [summary.pose_anees, summary.window_nees_1s, summary.window_nees_10s]
    one, short, long = ("-" if value is None else f"{value / 6:.2f}" for value in nees)
    band = "-" if summary.frames_in_band_percent is None else f"{summary.frames_in_band_percent:.0f}"
    return [one, band, short, long, f"{summary.ate_rigid_m:.2f}"]


def show_parts(recording: Recording) -> None:
    """A table for each way of running it."""
    for odometry in (True, False) if recording.frames[-1].odometry is not None else (False,):
        title = f"{recording.name}, {'odometry' if odometry else 'vision only'}"
        rows = [
            (label, *cells(judged(stated, name, options, odometry)))
            for label, name, options, stated in parts(recording)
        ]
        show(title, ("added", "NEES/6", "in band", "1 s", "10 s", "ATE"), rows)


def show_rendered(route: str, renderers: Sequence[str], seeds: range) -> None:
    """Drives in images that are rendered with a perfect rig."""
    for renderer in renderers:
        rows = []
        drives = [
            sse.record("StereoSlam/Drive-v0", seed=seed, route=route, sensor="images", renderer=renderer)
            for seed in seeds
        ]
        for label, name, options in (
            ("plain", "shared-anchor", {"gate": 0.99, "consensus": True}),
            ("right-invariant errors", "right-invariant", {"gate": 0.99, "consensus": True}),
            ("coloured-noise", "coloured-noise", {}),
        ):
            runs = [run_filter(drive, name, options, use_odometry=False, windows=False) for drive in drives]
            summaries = [summary_of(run) for run in runs]
            nees = [summary.pose_anees / 6 for summary in summaries]
            band = np.mean([summary.frames_in_band_percent for summary in summaries])
            rmse = np.mean([1e3 * summary.position_rmse_m for summary in summaries])
            figures = [np.mean(nees), min(nees), max(nees)]
            rolls = 1e6 * np.array([roll_rate(run) for run in runs])
            roll = mean_and_error(rolls, 2) if len(rolls) > 1 else f"{rolls[0]:.2f}"
            rows.append((label, *(f"{figure:.2f}" for figure in figures), f"{band:.0f}", f"{rmse:.2f}", roll))
        heads = ("filter", "NEES/6", "lowest", "highest", "in band", "rmse, mm", "roll, µrad a frame")
        show(f"{route} by {renderer}, {len(seeds)} seeds", heads, rows)


def show_estimates(recordings: Sequence[Recording]) -> None:
    """What could size the gauge walk, and what should."""
    halves = ("at random", "left, right", "near, far")
    rows = []
    for recording in recordings:
        figures = [*half_differences(recording), consistent_walk(recording)]
        rows.append((recording.name, *(f"{1e3 * figure:.1f}" for figure in figures)))
    show("errors common to all tracks, mrad per root of a radian", ("", *halves, "NEES/6 = 1"), rows)


def half_differences(recording: Recording) -> list[float]:
    """Robust half difference of the turns by two halves of the landmarks over windows, by root of image motion."""
    rng, sides = np.random.default_rng(0), {}
    windows: list[list[float]] = [[], [], []]
    pending: list[tuple[float, list[tuple[Step, Step] | None]]] = []
    frames = recording.frames
    for before, after in pairwise(frames):
        first, second = before.observation, after.observation
        ids, i, j = np.intersect1d(first.ids, second.ids, assume_unique=True, return_indices=True)
        R = [seen.covariances(FIRST_GUESS)[k] for seen, k in ((first, i), (second, j))]
        pairs = Pairs(first.uvd[i], second.uvd[j], *R)
        whole = robust_step(recording.camera, pairs, None)
        for name in ids.tolist():
            sides.setdefault(name, bool(rng.integers(2)))
        at_random = np.array([sides[name] for name in ids.tolist()], dtype=bool)
        splits = [at_random, *(pairs.first[:, k] < np.median(pairs.first[:, k]) for k in (0, 2))] if len(ids) else []
        both = [_by_halves(recording, pairs, split) for split in splits] if whole else [None] * 3
        motion = 0.0
        if whole is not None:
            points = recording.camera.backproject(np.maximum(pairs.first, 1e-3))
            by_step = np.linalg.norm(np.cross(whole.step.t, points), axis=1) / (points**2).sum(axis=1)
            turn = float(np.linalg.norm(rotations.log(whole.step.R)))
            motion = TURN_WEIGHT * turn + float(np.mean(by_step)) if len(points) else 0.0
        pending.append((motion, both))
        if len(pending) == WINDOW:
            total = sum(motion for motion, _ in pending)
            for kind, found in enumerate(windows):
                steps = [both[kind] for _, both in pending]
                if total > 0.0 and all(step is not None for step in steps):
                    found.append(_half_difference([step for step in steps if step is not None]) / math.sqrt(total))
            pending = []
    return [float(np.median(found)) / 1.538 if found else float("nan") for found in windows]  # of 3 axes: sigma


def _by_halves(recording: Recording, pairs: Pairs, split: BoolArray) -> tuple[Step, Step] | None:
    one, other = (robust_step(recording.camera, pairs.select(np.flatnonzero(part)), None) for part in (split, ~split))
    return None if one is None or other is None else (one.step, other.step)


def _half_difference(steps: Sequence[tuple[Step, Step]]) -> float:
    """Half of the angle between the turns over a window."""
    one, other = steps[0]
    for first, second in steps[1:]:
        one, other = chained(one, first), chained(other, second)
    difference: FloatArray = rotations.log(one.R.T @ other.R)
    return 0.5 * float(np.linalg.norm(difference))


def consistent_walk(recording: Recording) -> float:
    """The gauge walk with which NEES/6 of the pose is 1, by bisection of its logarithm."""
    low, high = math.log(1e-4), math.log(0.1)
    for _ in range(10):
        walk = math.exp(0.5 * (low + high))
        nees = judged(recording, "coloured-noise", {"gauge_walk": walk}, odometry=False, windows=False).pose_anees / 6
        low, high = (0.5 * (low + high), high) if nees > 1.0 else (low, 0.5 * (low + high))
    return math.exp(0.5 * (low + high))


def main() -> None:
    """Run and print."""
    given = arguments(
        __doc__,
        "data?",
        data=Path,
        estimates=False,
        rendered=int,
        route="right-turn",
        renderers=["gl", "tiny"],
        first_seed=0,
        frames=int,
    )
    if given.rendered:
        show_rendered(given.route, given.renderers, range(given.first_seed, given.first_seed + given.rendered))
    if given.data is None:
        return
    recordings = [sse.load(given.data / name)[: given.frames] for name in RECORDINGS if (given.data / name).is_dir()]
    if given.estimates:
        show_estimates([drive for drive in recordings if isinstance(drive.noise, ColouredNoise)])
        return
    for recording in recordings:
        show_parts(recording)


if __name__ == "__main__":
    main()
