"""A scripted drive as a sequence of rendered stereo images."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from filters.camera import StereoCamera
from stereo_slam_env.envs.drive import StereoDriveEnv
from stereo_slam_env.envs.recorder import described
from stereo_slam_env.recording.recording import SIMULATION, Reference, Start, StereoPair
from stereo_slam_env.rendering.images import grey


class RenderedDrive:
    """What the cameras of a scripted drive see; an `ImageSequence`.

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
        self._kwargs |= {"max_landmarks": 1, "refill_below": None, "render_images": False}  # nobody asks for landmarks
        self._seed = seed
        env = StereoDriveEnv(**self._kwargs)
        try:
            env.reset(seed=seed)
            self._start, self._count, options = env.start, env.route.frames, env.options
        finally:
            env.close()
        if frames is not None and not 1 <= frames <= self._count:
            raise ValueError(f"frames must be from 1 to {self._count} on route {options.route!r}, got {frames}")
        self._count = frames or self._count
        self.camera: StereoCamera = env.camera
        self.name = f"{options.surroundings}-{Path(options.route).stem}-{seed}"
        self._kwargs["render_images"] = True
        drawing = StereoDriveEnv(**self._kwargs)
        self.source: Mapping[str, Any] = {**described(drawing, seed), "frames": self._count}

    @property
    def start(self) -> Start:
        """What filters are told at the start."""
        return self._start

    @property
    def truth_from(self) -> Reference:
        """What is driven is known exactly."""
        return SIMULATION

    @property
    def skipped(self) -> Mapping[str, int]:
        """Nothing: what is drawn is whole."""
        return {}

    def __len__(self) -> int:
        return self._count

    def pairs(self) -> Iterator[StereoPair]:
        """Drive and look."""
        env = StereoDriveEnv(**self._kwargs)
        idle = np.zeros(2, dtype=np.float32)
        try:
            observation, _ = env.reset(seed=self._seed)
            for number in range(self._count):
                if number:
                    observation = env.step(idle)[0]
                frame = env.frame
                left, right = grey(observation["left"]), grey(observation["right"])
                yield StereoPair(frame.timestamp, left, right, frame.truth, frame.odometry)
        finally:
            env.close()
