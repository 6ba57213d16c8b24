"""Scripted drives and episodes as recordings (`record`, `recording_of`) and as images (`RenderedDrive`)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from filters.geometry.camera import StereoCamera
from stereo_slam_env.envs.drive import StereoDriveEnv
from stereo_slam_env.envs.options import DriveOptions
from stereo_slam_env.envs.stereo_env import StereoEnv
from stereo_slam_env.files.package_versions import version_of
from stereo_slam_env.frontend.settings import TrackerSettings
from stereo_slam_env.recording.recording import SIMULATION, Frame, Recording, Reference, StereoPair
from stereo_slam_env.rendering.backends import renderer_identity
from stereo_slam_env.rendering.images import grey


def record(
    env_kwargs: Mapping[str, Any] | None = None,
    seed: int = 0,
    frames: int | None = None,
    progress: Callable[[int, int | None], None] | None = None,
) -> Recording:
    """Drive a scripted route with the arguments of `StereoDriveEnv`, see `stereo_slam_env.record`."""
    kwargs = {"policy": "route", **(env_kwargs or {})}
    if kwargs["policy"] != "route":
        raise ValueError(f"policy must be 'route' to record without an agent, got {kwargs['policy']!r}")
    if frames is not None and frames < 1:
        raise ValueError(f"frames must be at least 1, got {frames!r}")
    with closing(StereoDriveEnv(**kwargs)) as env:
        wanted = env.route.frames if frames is None else frames
        collected = []
        if wanted <= env.route.frames:  # known before the drive, which may take minutes
            for _ in islice(_drive(env, seed), wanted):
                collected.append(env.frame)
                if progress is not None and len(collected) > 1:
                    progress(len(collected), frames)
        if frames is not None and len(collected) < frames:
            most = len(collected) or env.route.frames
            raise ValueError(f"frames must be at most {most} on route {env.options.route!r}, got {frames}")
        return recording_of(env, collected, seed)


def _drive(env: StereoDriveEnv, seed: int) -> Iterator[Mapping[str, Any]]:
    """The observations of a scripted drive, to its end."""
    observation, over = env.reset(seed=seed)[0], False
    yield observation
    while not over:
        observation, _, over, _, _ = env.step(np.zeros(2, dtype=np.float32))
        yield observation


def recording_of(
    env: StereoEnv, frames: Sequence[Frame], seed: int, about: Mapping[str, Any] | None = None
) -> Recording:
    """The measurements of an environment in the episode of a seed, after its last frame.

    `frames` are its `frame` after `reset` and after each step, `about` further JSON-able entries of `source`.
    """
    seen_by = env.options.renderer if env.options.sensor == "images" else env.options.noise
    return Recording(
        name=f"{Path(env.options.route).stem}-{seen_by}-{seed}",
        camera=env.camera,
        frames=tuple(frames),
        noise=env.noise,
        start=env.start,
        landmarks=env.landmark_truth(),
        source={**described(env, seed), "frames": len(frames), **(about or {})},
        truth_from=SIMULATION,
    )


def described(env: StereoEnv, seed: int) -> dict[str, Any]:
    """Everything needed to make the same episode again; JSON-able.

    The renderer is part of it: images of different renderers are different measurements.
    """
    drawn = {"renderer": renderer_identity(env.options.renderer)} if env.options.draws else {}
    return {
        "environment": "StereoSlam/Drive-v0" if env.spec is None else env.spec.id,
        "arguments": env.options.as_dict(),
        "seed": seed,
        **drawn,
        "versions": {name: version_of(name) for name in ("stereo-slam-env", "numpy", "pybullet", "gymnasium")},
    }


class RenderedDrive:
    """A scripted drive as a sequence of rendered stereo images; an `ImageSequence`.

    Parameters
    ----------
    env_kwargs : mapping, optional
        Arguments of `StereoDriveEnv`; `policy`, `sensor` and `render_images` are chosen here.
    seed : int
        Seed of the episode: same seed, same bits.
    frames : int, optional
        Stop after this many; None: at the end of the route.

    Raises
    ------
    ValueError
        An argument is not allowed.
    """

    def __init__(self, env_kwargs: Mapping[str, Any] | None = None, seed: int = 0, frames: int | None = None) -> None:
        self._kwargs = {**(env_kwargs or {}), "policy": "route", "sensor": "landmarks"}
        self._kwargs |= {"max_landmarks": 1, "refill_below": None, "render_images": False}
        self._seed = seed
        with closing(StereoDriveEnv(**self._kwargs)) as env:
            env.reset(seed=seed)
            self.start, self._count, options = env.start, env.route.frames, env.options
        if frames is not None and not 1 <= frames <= self._count:
            raise ValueError(f"frames must be from 1 to {self._count} on route {options.route!r}, got {frames}")
        self._count = frames or self._count
        self.camera: StereoCamera = env.camera
        self.name = f"{options.surroundings}-{Path(options.route).stem}-{seed}"
        self.truth_from: Reference = SIMULATION
        self.skipped: Mapping[str, int] = {}
        self.front_end: TrackerSettings = DriveOptions.checked(env_kwargs or {}).front_end
        """Settings of the front end for these images."""
        self._kwargs["render_images"] = True
        self.source: Mapping[str, Any] = {**described(StereoDriveEnv(**self._kwargs), seed), "frames": self._count}

    def __len__(self) -> int:
        return self._count

    def pairs(self) -> Iterator[StereoPair]:
        """The pairs in time order."""
        with closing(StereoDriveEnv(**self._kwargs)) as env:
            for observation in islice(_drive(env, self._seed), self._count):
                frame = env.frame
                left, right = grey(observation["left"]), grey(observation["right"])
                yield StereoPair(frame.timestamp, left, right, frame.truth, frame.odometry)
