"""What gravity would tell a camera on a head: the error of the gaze task by direction, with and without a known tilt.

    python benchmarks/gaze_tilt.py      # 100 drives, two minutes

`Gaze-v0` with the head straight ahead, the filter of the training task. No inertial unit is simulated on a head; a
measurement of the vertical in the camera frame in each frame, `--sigma-mrad` off about each axis, stands for one.
"""

from __future__ import annotations

import gymnasium as gym
import numpy as np
from scipy.stats import bootstrap

from filters import make_filter
from filters.geometry import rotations
from filters.geometry.arrays import FloatArray
from harness import arguments, show
from stereo_slam_env.envs import GazeTask
from stereo_slam_env.envs.recorder import recording_of
from stereo_slam_env.recording.recording import Recording

DOWN = np.array([0.0, 1.0, 0.0])
AXES = "sideways", "vertical", "ahead"


def drive(seed: int) -> Recording:
    """An episode with the head straight ahead."""
    env = gym.make("StereoSlam/Gaze-v0", disable_env_checker=True).unwrapped
    try:
        env.reset(seed=seed)
        frames, over = [env.frame], False
        while not over:
            *_, terminated, truncated, _ = env.step(np.zeros(2, dtype=np.float32))
            frames.append(env.frame)
            over = terminated or truncated
        return recording_of(env, frames, seed)
    finally:
        env.close()


def final_error(recording: Recording, seed: int, sigma: float | None) -> FloatArray:
    """Position error in the last frame, (3,) m; the vertical is measured to `sigma`, rad, unless that is None."""
    slam = make_filter("shared-anchor", camera=recording.camera, noise=recording.noise, **GazeTask().filter_options)
    slam.reset(recording.start)
    rng, before = np.random.default_rng(seed), recording.frames[0].timestamp
    for number, frame in enumerate(recording.frames):
        if number:
            slam.predict(frame.timestamp - before, frame.odometry)
            before = frame.timestamp
        if number and sigma is not None:
            vertical = rotations.matrix(frame.truth.orientation).T @ DOWN
            told = rotations.exp(sigma * rng.standard_normal(3)) @ vertical
            forecast = rotations.matrix(slam.pose.orientation).T @ DOWN
            H = np.hstack([np.zeros((3, 3)), rotations.skew(forecast)])
            slam.correct(told - forecast, {"pose": H}, sigma**2 * np.eye(3))
        slam.update(frame.observation)
    return np.asarray(slam.pose.position - recording.frames[-1].truth.position)


def main() -> None:
    """Rows: without and with; mean final error, RMS by axis, share of the vertical in the squared error."""
    given = arguments(__doc__, drives=100, seed=300_000, sigma_mrad=5.0)
    seeds = range(given.seed, given.seed + given.drives)
    found = np.empty((2, given.drives, 3))
    for k, seed in enumerate(seeds):
        recording = drive(seed)
        for i, sigma in enumerate((None, 1e-3 * given.sigma_mrad)):
            found[i, k] = final_error(recording, seed, sigma)
    distance = np.linalg.norm(found, axis=2)
    rows = []
    for label, errors, each in zip(("images, odometry", "and the vertical"), found, distance, strict=True):
        rms, share = np.sqrt((errors**2).mean(axis=0)), (errors[:, 1] ** 2).sum() / (errors**2).sum()
        rows.append([label, f"{each.mean():.3f}", *(f"{number:.3f}" for number in rms), f"{100.0 * share:.0f} %"])
    ratio = bootstrap(
        (distance[1], distance[0]),
        lambda a, b, axis=-1: a.mean(axis=axis) / b.mean(axis=axis),
        paired=True,
        method="percentile",
        rng=0,
    ).confidence_interval
    title = f"{given.drives} drives; ratio of the mean errors {distance[1].mean() / distance[0].mean():.2f}"
    heads = ["given", "final error, m", *(f"{axis}, RMS" for axis in AXES), "vertical share"]
    show(f"{title} ({ratio.low:.2f} to {ratio.high:.2f})", heads, rows)


if __name__ == "__main__":
    main()
