"""Drives and flights written with their images for other programs, read back: consistency of inertial filters.

    python benchmarks/written_drives.py --out sims --seeds 20 --drive flight   # ten minutes on two cores, with OpenGL

Each seed is a flight of 10 s at 20 Hz, or the drive round a corner, with a BMI088 at 200 Hz, in the layout of EuRoC.
Inertial samples, calibration and truth are those of the files. Measurements are, first, points of a cloud with white
noise of 1 px, which asks whether the files are right, then what the front end finds in the images, which asks how well
its noise is known. The first seed also runs from memory: to the same numbers. At last the trajectories of the first
filter, written as those of the body in the world of the truth, are judged as anybody's: `evaluate` by their pattern.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from filters import StereoNoise, StereoObservation
from filters.geometry.arrays import FloatArray
from harness import arguments, by_seed, show
from stereo_slam_env import Trajectory, evaluate, save_trajectory
from stereo_slam_env.cli import app
from stereo_slam_env.datasets import open_for_front_end, write_recording
from stereo_slam_env.envs.recorder import RenderedDrive
from stereo_slam_env.envs.rendered_flight import RenderedFlight
from stereo_slam_env.evaluation.bands import mean_band
from stereo_slam_env.evaluation.filter_run import FilterRun
from stereo_slam_env.frontend.camera_motion import set_up_for_tracks
from stereo_slam_env.frontend.track_recorder import record_tracks
from stereo_slam_env.recording.recording import SIMULATION, Frame, ImageSequence, Recording
from stereo_slam_env.sensing.sensor_suite import SensorSuite

POINTS, MOST, NEAREST, FARTHEST = 4000, 40, 2.0, 40.0
"""Points of a cloud, how many are measured in a frame, and their depths, m."""
ESTIMATE = "inertial.square"
FILTERS: dict[str, tuple[str, dict[str, Any]]] = {
    "inertial, white noise of 1 px": ("inertial", {}),
    "inertial, images": ("inertial", {}),
    "msckf with strapdown, images": ("msckf", {"motion": "strapdown"}),
}


def main() -> None:
    """Print the NEES of the pose over the seeds, and how far memory and files are apart."""
    drives, renderers = ("flight", "right-turn"), ("gl", "tiny")
    given = arguments(__doc__, out=Path, seeds=20, jobs=2, frames=200, drive=drives, rig="vga", renderer=renderers)
    rows = by_seed(judged, given.seeds, given.jobs, given.out, given.drive, given.frames, given.rig, given.renderer)
    low, high = (end / 6.0 for end in mean_band(6, given.seeds))
    table = []
    for k, label in enumerate(FILTERS):
        nees, errors, apart = (np.array([row[k][i] for row in rows]) for i in range(3))
        by_frame = np.nanmean(nees, axis=0)
        inside = np.mean((by_frame >= low) & (by_frame <= high))
        rmse, mean, worst = np.sqrt(np.mean(errors**2)), np.nanmean(nees), np.nanmax(apart)
        table.append([label, f"{rmse:.4f}", f"{mean:.2f}", f"{100.0 * inside:.0f}", f"{worst:.1g}"])
    show(
        f"{given.seeds} times {given.drive} through files; band of one frame {low:.2f} to {high:.2f}",
        ["filter, measurements", "position RMSE, m", "NEES / 6", "frames in band, %", "memory less files, m"],
        table,
    )
    app.main(["evaluate", str(given.out / "{seed}" / ESTIMATE)])


def judged(
    seed: int, out: Path, drive: str, frames: int, rig: str, renderer: str
) -> list[tuple[FloatArray, float, float]]:
    """Each filter's NEES / 6 of every frame after the first, its position RMSE, m, and the difference to memory, m."""
    options = {"imu": "bmi088", "imu_calibrated": True, "renderer": renderer, "rig": rig, "vehicle": "smooth"}
    simulated: Any
    if drive == "flight":
        simulated = RenderedFlight(options, seed, frames)
    else:
        simulated = RenderedDrive({**options, "route": drive}, seed)
    folder = write_recording(simulated, out / f"{seed:03d}", "euroc", keep_same=True, about={})
    read, settings = open_for_front_end(folder)

    def by_images(sequence: ImageSequence) -> Recording:
        return set_up_for_tracks(record_tracks(sequence, settings))

    def by_white_noise(sequence: ImageSequence) -> Recording:
        return of_cloud(sequence, np.random.default_rng([seed, 3]))

    results = []
    made: dict[Callable[..., Recording], list[Recording]] = {}
    for label, (name, more) in FILTERS.items():
        source = by_images if label.endswith("images") else by_white_noise
        if source not in made:
            recordings = [source(one) for one in ((read, simulated) if seed == 0 else (read,))]
            made[source] = [replace(one, start=recordings[0].start) for one in recordings]
        run, *memory = (evaluate(name, one, use_odometry=False, **more).series for one in made[source])
        apart = max((float(np.abs(run.positions - one.positions).max()) for one in memory), default=np.nan)
        errors = np.linalg.norm(run.positions - run.true_positions, axis=1)
        if not results:
            write_as_body(folder / ESTIMATE, run, read)
        results.append((run.pose_nees[1:] / 6.0, float(np.sqrt(np.mean(errors**2))), apart))
    return results


def write_as_body(path: Path, run: FilterRun, sequence: Any) -> None:
    """Write the poses of the left camera in W as those of the inertial unit in the world of the truth."""
    unit = next(samples.unit for pair in sequence.pairs() if (samples := pair.inertial) is not None)
    suite = SensorSuite(sequence.camera, 10.0, unit, gravity=sequence.gravity)
    times = run.timestamps + sequence.source["epoch_s"]
    estimate = Trajectory(run.positions, run.orientations, times, run.pose_covariances, name="inertial", body="imu")
    save_trajectory(path, estimate.moved(suite.T_uw).of_body(suite.T_bc.inverse()))


def of_cloud(sequence: ImageSequence, rng: np.random.Generator) -> Recording:
    """The drive with measurements of a cloud of points around its path, with white noise of 1 px."""
    camera, pairs = sequence.camera, list(sequence.pairs())
    path = np.array([pair.truth.position for pair in pairs if pair.truth is not None])
    points = path[rng.integers(0, len(path), POINTS)] + rng.uniform([-15, -5, 2], [15, 5, FARTHEST], (POINTS, 3))
    ids, frames = np.zeros(0, dtype=np.int64), []
    for pair in pairs:
        assert pair.truth is not None
        points_c = pair.truth.to_camera(points)
        near = (points_c[:, 2] > NEAREST) & (points_c[:, 2] < FARTHEST)
        visible = np.flatnonzero(near & camera.in_view(camera.project(np.where(near[:, None], points_c, [0, 0, 1.0]))))
        lost = rng.random(len(ids)) < 0.05  # as tracks are
        ids = ids[np.isin(ids, visible) & ~lost]
        ids = np.sort(np.concatenate([ids, rng.permutation(np.setdiff1d(visible, ids))[: MOST - len(ids)]]))
        left, right = rng.normal(size=(2, len(ids), 2))
        uvd = camera.project(points_c[ids]) + np.column_stack([left, left[:, 0] - right[:, 0]])
        observation = StereoObservation(ids, uvd)
        frames.append(Frame(pair.timestamp, observation, None, pair.truth, inertial=pair.inertial))
    noise = StereoNoise.independent_pixels(1.0)
    return Recording(sequence.name, camera, tuple(frames), noise, source=sequence.source, truth_from=SIMULATION)


if __name__ == "__main__":
    main()
