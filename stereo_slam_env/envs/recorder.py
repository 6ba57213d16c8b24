"""Scripted drives and episodes as recordings (`record`, `recording_of`) and as images (`RenderedDrive`)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from filters.contract.inputs import Start
from filters.contract.noise import StereoNoise
from filters.geometry.camera import StereoCamera
from stereo_slam_env.datasets.measured_tracks import MeasuredTracks
from stereo_slam_env.envs.arguments import DriveOptions, StereoOptions
from stereo_slam_env.envs.core_rows import CoreRows
from stereo_slam_env.envs.stereo_env import StereoEnv
from stereo_slam_env.files.package_versions import version_of
from stereo_slam_env.frontend.settings import TrackerSettings
from stereo_slam_env.frontend.track_recorder import TYPICAL_NOISE
from stereo_slam_env.recording.recording import SIMULATION, Frame, LandmarkTruth, Recording, Reference, StereoPair
from stereo_slam_env.rendering.pinhole import grey
from stereo_slam_env.rendering.renderers import renderer_identity
from stereo_slam_env.world.routes import RANDOM_ROUTES

DRIVE = "StereoSlam/Drive-v0"


def record(
    env_kwargs: Mapping[str, Any] | None = None,
    seed: int = 0,
    frames: int | None = None,
    progress: Callable[[int, int | None], None] | None = None,
) -> Recording:
    """Drive a scripted route with the arguments of `StereoDriveEnv`, see `stereo_slam_env.record`."""
    return records(env_kwargs, [seed], frames, progress)[0]


def records(
    env_kwargs: Mapping[str, Any] | None,
    seeds: Sequence[int],
    frames: int | None = None,
    progress: Callable[[int, int | None], None] | None = None,
) -> list[Recording]:
    """The drives of some seeds, in rows of one simulator: each has the bits of `record`."""
    kwargs = {"policy": "route", **(env_kwargs or {})}
    if kwargs["policy"] != "route":
        raise ValueError(f"policy must be 'route' to record without an agent, got {kwargs['policy']!r}")
    if frames is not None and frames < 1:
        raise ValueError(f"frames must be at least 1, got {frames!r}")
    options = DriveOptions.checked(kwargs)
    with closing(CoreRows(options, len(seeds))) as rows:
        # Whether they are too many is known before the drive, which may take minutes, unless the route is random.
        short = frames is None or frames <= rows.route.frames or options.route in RANDOM_ROUTES
        collected = _drives(rows, seeds, frames, progress) if short else [[]]
        shortest = min(map(len, collected))
        if frames is not None and shortest < frames:
            most = shortest or rows.route.frames
            raise ValueError(f"frames must be at most {most} on route {options.route!r}, got {frames}")
        recordings = []
        for b, (taken, seed) in enumerate(zip(collected, seeds, strict=True)):
            about = {**described(options, seed), "frames": len(taken)}
            ends = rows.camera, rows.noise, rows.start(b), rows.landmark_truth(b)
            recordings.append(_recording(options, seed, taken, *ends, about))
        return recordings


def _drives(
    rows: CoreRows,
    seeds: Sequence[int],
    frames: int | None,
    progress: Callable[[int, int | None], None] | None,
) -> list[list[Frame]]:
    """The frames of every row, to the end of its drive or to so many."""
    active, nothing = np.ones(rows.num_envs, dtype=np.bool_), np.zeros((rows.num_envs, 2))
    rows.reset(active, seeds, {})
    collected = [[rows.frame(b)] for b in range(rows.num_envs)]
    for number in count(2) if frames is None else range(2, frames + 1):
        _, over, _ = rows.step(nothing, active)
        for b in np.flatnonzero(active).tolist():
            collected[b].append(rows.frame(b))
        active &= ~over
        if progress is not None:
            progress(number, frames)
        if not active.any():
            break
    return collected


def record_measurements(
    env_kwargs: Mapping[str, Any] | None,
    seed: int,
    measured: MeasuredTracks,
    frames: int | None = None,
    progress: Callable[[int, int | None], None] | None = None,
) -> Recording:
    """Recording of the measurements of another program in the pairs of `RenderedDrive`, up to its last one.

    The truth of a landmark is the point behind its left pixel where it was first measured, as for the front ends that
    an environment has itself. Neither the number of measurements nor their ids are limited.

    Raises
    ------
    ValueError
        An argument is not allowed, or the measurements cannot be of these pairs: beyond the drive or the image.
    """
    drive = RenderedDrive(env_kwargs, seed, frames)
    if measured.pairs > len(drive):
        raise ValueError(
            f"{measured.path} has a measurement in frame {measured.pairs - 1}, but the drive has frames 0 to "
            f"{len(drive) - 1}: give the route, and the number of frames, that the pairs were recorded with"
        )
    measured.require_inside(drive.camera)
    measured.reset()
    taken = []
    with closing(drive.rows(draws=True)) as rows:
        sensor = rows.new_image_sensor(0, measured)
        for number in range(1, measured.pairs + 1):
            frame = rows.frame(0)
            taken.append(replace(frame, observation=sensor.observe(rows.simulator.pose(0))))
            if progress is not None:
                progress(number, measured.pairs)
            if number < measured.pairs:
                rows.step(np.zeros((1, 2)), np.ones(1, dtype=np.bool_))
    images = replace(drive.options, sensor="images")
    return _recording(images, seed, taken, drive.camera, TYPICAL_NOISE, drive.start, sensor.landmarks, drive.source)


def recording_of(
    env: StereoEnv, frames: Sequence[Frame], seed: int, about: Mapping[str, Any] | None = None
) -> Recording:
    """The measurements of an environment in the episode of a seed, after its last frame.

    `frames` are its `frame` after `reset` and after each step, `about` further JSON-able entries of `source`.
    """
    source = described(env.options, seed, env.world_id)
    about = {**source, "frames": len(frames), **(about or {})}
    return _recording(env.options, seed, frames, env.camera, env.noise, env.start, env.landmark_truth(), about)


def _recording(
    options: StereoOptions,
    seed: int,
    frames: Sequence[Frame],
    camera: StereoCamera,
    noise: StereoNoise,
    start: Start,
    landmarks: LandmarkTruth,
    source: Mapping[str, Any],
) -> Recording:
    seen_by = options.renderer if options.sensor == "images" else options.noise
    name = f"{Path(options.route).stem}-{seen_by}-{seed}"
    return Recording(name, camera, tuple(frames), noise, start, landmarks, source, truth_from=SIMULATION)


def described(options: StereoOptions, seed: int, environment: str = DRIVE) -> dict[str, Any]:
    """Everything needed to make the same episode again; JSON-able.

    The renderer is part of it: images of different renderers are different measurements.
    """
    drawn = {"renderer": renderer_identity(options.renderer)} if options.draws else {}
    return {
        "environment": environment,
        "arguments": options.as_dict(),
        "seed": seed,
        **drawn,
        "versions": {name: version_of(name) for name in ("stereo-slam-env", "numpy", "pybullet", "gymnasium")},
    }


class RenderedDrive:
    """A scripted drive as a sequence of rendered stereo images; an `ImageSequence`.

    Parameters
    ----------
    env_kwargs : mapping, optional
        Arguments of `StereoDriveEnv`; `policy`, `sensor` and `render_images` are set here.
    seed : int
        Seed of the episode: same seed, same bits.
    frames : int, optional
        Stop after this many; None: at the end of the route.

    Raises
    ------
    ValueError
        An argument is not allowed.
    """

    draws_on_demand = True

    def __init__(self, env_kwargs: Mapping[str, Any] | None = None, seed: int = 0, frames: int | None = None) -> None:
        arguments = {**(env_kwargs or {}), "policy": "route", "sensor": "landmarks", "render_images": False}
        self.options = options = DriveOptions.checked({**arguments, "max_landmarks": 1, "refill_below": None})
        self._seed = seed
        with closing(self.rows(draws=False)) as rows:
            self.start, self._count = rows.start(0), rows.route.frames
        if frames is not None and not 1 <= frames <= self._count:
            raise ValueError(f"frames must be from 1 to {self._count} on route {options.route!r}, got {frames}")
        self._count = frames or self._count
        self.camera: StereoCamera = rows.camera
        self.name = f"{options.surroundings}-{Path(str(options.route)).stem}-{seed}"
        self.truth_from: Reference = SIMULATION
        self.skipped: Mapping[str, int] = {}
        self.front_end: TrackerSettings = DriveOptions.checked(env_kwargs or {}).front_end
        """Settings of the front end for these images."""
        about = described(replace(options, render_images=True), seed)
        self.source: Mapping[str, Any] = {**about, "frames": self._count}

    def __len__(self) -> int:
        return self._count

    def rows(self, *, draws: bool) -> CoreRows:
        """The simulator at the beginning of the drive."""
        rows = CoreRows(self.options, 1, draws=draws)
        rows.reset(np.ones(1, dtype=np.bool_), [self._seed], {})
        return rows

    def pairs(self, is_drawn: Callable[[int, float], bool] = lambda number, time: True) -> Iterator[StereoPair]:
        """The pairs in time order; those whose number and time, s, are not to be drawn have images of no size."""
        with closing(self.rows(draws=True)) as rows:
            one, nothing = np.ones(1, dtype=np.bool_), np.zeros((1, 2))
            for number in range(self._count):
                if number:
                    rows.step(nothing, one)
                frame, simulator = rows.frame(0), rows.simulator
                images = rows.images(0) if is_drawn(number, frame.timestamp) else None
                left, right = (NOT_DRAWN, NOT_DRAWN) if images is None else (grey(images.left), grey(images.right))
                velocity = frame.truth_velocity if simulator.rules.smooth else None  # else that of the whole step
                truth = frame.truth, frame.odometry, frame.inertial, velocity, simulator.biases(0)
                yield StereoPair(frame.timestamp, left, right, *truth)


NOT_DRAWN = np.zeros((0, 0), dtype=np.uint8)
"""Image of a frame that is not drawn."""
