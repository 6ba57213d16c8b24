"""Large maps by submaps: what a frame costs while the map grows, and whether the estimates stay consistent.

    python benchmarks/submaps.py cost                      # 5,000 landmarks in the map, 100 in view; a minute
    python benchmarks/submaps.py cost --landmarks 1000
    python benchmarks/submaps.py loops --seeds 20          # NEES on two laps of a circle, against the full filter

`cost` drives along a street; two filters get the same measurements, some frames of each in turns, in one process with
one BLAS thread: a shared-anchor filter that keeps only the 100 landmarks in view, and submaps that keep everything. The
ratio of their processor times is what counts; the milliseconds are this machine's. It is given as the map grows, as
median (the usual frame) and as mean (with the frames in which landmarks come to rest).

`loops` drives round a circle of 15 m radius twice, so that the second lap sees the first one's landmarks again, with
the full filter (`drop_unseen=False`) and with submaps on the same measurements: pose NEES/6 over all frames and seeds,
the greatest difference between the two filters' poses in standard deviations, and the cost of the second lap.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation
from threadpoolctl import threadpool_limits

from filters import Start, StereoEKF, StereoFilter, StereoNoise, StereoObservation
from filters.checks.conformance import REFERENCE_CAMERA as CAMERA
from filters.submaps.submap_ekf import SubmapEKF
from harness import arguments, show
from stereo_slam_env.evaluation.bands import mean_band

NOISE = StereoNoise.independent_pixels(1.0)
DT, SPEED, RADIUS = 0.1, 4.9, 15.0
IN_VIEW = 100
BURST = 5  # frames of one filter in a row: in use it does not share the processor's caches with its rival
START = np.diag(np.repeat([1e-6, 1e-6, 0.5, 0.05], 3) ** 2)


def street(seed: int) -> Iterator[StereoObservation]:
    """Straight ahead for ever; whatever leaves the view is replaced, so that there are always 100 landmarks in it."""
    rng = np.random.default_rng(seed)
    ids, points, next_id, frame = np.zeros(0, dtype=np.int64), np.zeros((0, 3)), 0, 0
    while True:
        here = np.array([0.0, 0.0, SPEED * DT * frame])
        stays = (points - here)[:, 2] > 4.0
        stays[stays] = CAMERA.in_view(CAMERA.project(points[stays] - here))
        missing = IN_VIEW - int(stays.sum())
        uv = rng.uniform((200, 20), (CAMERA.width - 50, CAMERA.height - 20), (missing, 2))
        disparity = CAMERA.disparity_constant * rng.uniform(1 / 80, 1 / 15, missing)
        new = CAMERA.backproject(np.column_stack([uv, disparity])) + here
        ids = np.concatenate([ids[stays], np.arange(next_id, next_id + missing)])
        points, next_id, frame = np.vstack([points[stays], new]), next_id + missing, frame + 1
        errors = rng.multivariate_normal(np.zeros(3), NOISE.R, IN_VIEW)
        yield StereoObservation(ids, CAMERA.project(points - here) + errors)


def timed(slam: StereoFilter, frames: list[StereoObservation]) -> list[float]:
    """Time of predict + update of each frame, s."""
    times = []
    for observation in frames:
        began = time.process_time()
        slam.predict(DT)
        slam.update(observation)
        times.append(time.process_time() - began)
    return times


def cost(landmarks: int, seed: int, max_unseen: int) -> None:
    """Time of a frame as the map grows."""
    in_view = StereoEKF(CAMERA, NOISE, landmark="shared-anchor")
    whole_map = SubmapEKF(CAMERA, NOISE, max_unseen=max_unseen)
    for slam in (in_view, whole_map):
        slam.reset(Start(linear_velocity=(0, 0, SPEED), covariance=START))
    rows = []
    frames, stage = street(seed), max(landmarks // 5, IN_VIEW)
    times: tuple[list[float], list[float]] = ([], [])
    while whole_map.size < landmarks:
        burst = [next(frames) for _ in range(BURST)]
        times[0].extend(timed(in_view, burst))
        times[1].extend(timed(whole_map, burst))
        if whole_map.size >= stage:
            plain, ours = (np.array(each) for each in times)
            sizes = (str(whole_map.size), str(whole_map.submaps), f"{whole_map.nbytes / 1e6:.0f}")
            medians = (f"{1e3 * np.median(each):.1f}" for each in (plain, ours))
            ratios = (np.median(ours) / np.median(plain), ours.mean() / plain.mean())
            rows.append((*sizes, *medians, *(f"{ratio:.2f}" for ratio in ratios)))
            times, stage = ([], []), stage + landmarks // 5
    heads = ("in the map", "submaps", "MB", "ms, in view only", "ms, submaps", "median ratio", "mean ratio")
    show(f"a frame with {IN_VIEW} landmarks in view, all kept by submaps (max_unseen={max_unseen})", heads, rows)
    began = time.process_time()
    count = len(whole_map.landmarks.ids)
    print(f"the whole map, {count} landmarks corrected: {time.process_time() - began:.2f} s")


@dataclass(frozen=True)
class Frame:
    """What is true in one frame, and what the camera saw."""

    position: np.ndarray
    orientation: np.ndarray
    observation: StereoObservation


def circle(seed: int, laps: float, points: int) -> list[Frame]:
    """Round a circle to the right, past a cloud of points; shaken as much as the filters assume."""
    rng = np.random.default_rng(seed)
    along = rng.uniform(0.0, 2 * np.pi, points)
    beside = RADIUS + rng.choice([-1.0, 1.0], points) * rng.uniform(2.0, 5.0, points)
    cloud = np.stack([RADIUS - beside * np.cos(along), rng.uniform(-1.5, 1.5, points), beside * np.sin(along)], axis=1)
    made = []
    for frame in range(round(laps * 2 * np.pi * RADIUS / (SPEED * DT))):
        turned = SPEED / RADIUS * DT * frame
        position = RADIUS * np.array([1.0 - np.cos(turned), 0.0, np.sin(turned)])
        heading = Rotation.from_rotvec([0.0, turned, 0.0])
        if frame:
            position += 0.012 * rng.standard_normal(3)
            heading = heading * Rotation.from_rotvec(0.0024 * rng.standard_normal(3))
        p_c = heading.inv().apply(cloud - position)
        uvd = CAMERA.project(np.where(p_c[:, 2:] > 0.1, p_c, (0.0, 0.0, 1.0)))
        seen = (p_c[:, 2] > 2.0) & (p_c[:, 2] < 14.0) & CAMERA.in_view(uvd)
        ids = np.flatnonzero(seen)
        errors = rng.multivariate_normal(np.zeros(3), NOISE.R, len(ids))
        made.append(Frame(position, heading.as_quat(), StereoObservation(ids, uvd[ids] + errors)))
    return made


def followed(slam: StereoFilter, frames: list[Frame]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """NEES (F,), positions (F, 3) with standard deviations, and times (F,) of a drive."""
    slam.reset(Start(linear_velocity=(0, 0, SPEED), angular_velocity=(0, SPEED / RADIUS, 0), covariance=START))
    nees, positions, times = [], [], []
    for number, frame in enumerate(frames):
        began = time.process_time()
        if number:
            slam.predict(DT)
        slam.update(frame.observation)
        times.append(time.process_time() - began)
        error, covariance = slam.pose_error(frame.position, frame.orientation)
        nees.append(error @ np.linalg.solve(covariance, error))
        positions.append(np.stack([slam.pose.position, np.sqrt(slam.pose.covariance.diagonal()[:3])]))
    return np.array(nees), np.array(positions), np.array(times)


def loops(seeds: int, points: int, max_unseen: int) -> None:
    """NEES on two laps, for both filters."""
    makers: dict[str, Callable[[], StereoFilter]] = {
        "full": lambda: StereoEKF(CAMERA, NOISE, landmark="shared-anchor", drop_unseen=False, gate=None),
        "submaps": lambda: SubmapEKF(CAMERA, NOISE, max_unseen=max_unseen, gate=None),
    }
    nees: dict[str, list[np.ndarray]] = {name: [] for name in makers}
    times: dict[str, list[np.ndarray]] = {name: [] for name in makers}
    difference = 0.0
    for seed in range(seeds):
        frames, positions = circle(seed, 2.0, points), {}
        for name, make in makers.items():
            its_nees, positions[name], its_times = followed(make(), frames)
            nees[name].append(its_nees)
            times[name].append(its_times)
        apart = np.abs(positions["full"][1:, 0] - positions["submaps"][1:, 0]) / positions["full"][1:, 1]
        difference = max(difference, float(apart.max()))
    band = mean_band(6, seeds)
    rows = []
    for name in makers:
        by_frame = np.mean(nees[name], axis=0)[1:] / 6
        half = len(by_frame) // 2
        inside = np.mean((by_frame >= band[0] / 6) & (by_frame <= band[1] / 6))
        spent = 1e3 * np.median(times[name], axis=0)
        means = (f"{lap.mean():.3f}" for lap in (by_frame[:half], by_frame[half:]))
        rows.append((name, *means, f"{inside:.0%}", *(f"{lap.mean():.1f}" for lap in (spent[:half], spent[half:]))))
    heads = ("filter", "NEES/6, first lap", "second lap", "frames in band", "ms first lap", "ms second lap")
    show(f"two laps of a circle, {points} points, {seeds} seeds, no gate", heads, rows)
    print(f"95 % band of NEES/6 in one frame: {band[0] / 6:.2f} to {band[1] / 6:.2f}")
    print(f"greatest difference of the two positions: {difference:.1e} standard deviations")


def main() -> None:
    """Read the command line and run."""
    given = arguments(__doc__, "what", what=("cost", "loops"), landmarks=5000, points=150, seeds=20, max_unseen=16)
    with threadpool_limits(1):
        if given.what == "cost":
            cost(given.landmarks, 0, given.max_unseen)
        else:
            loops(given.seeds, given.points, given.max_unseen)


if __name__ == "__main__":
    main()
