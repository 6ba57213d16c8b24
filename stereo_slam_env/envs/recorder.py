"""Record an episode: the measurement stream that any number of filters can then be run on."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from stereo_slam_env.envs.drive import StereoDriveEnv
from stereo_slam_env.envs.options import DriveOptions, StereoOptions
from stereo_slam_env.envs.stereo_env import StereoEnv
from stereo_slam_env.files.package_versions import version_of
from stereo_slam_env.recording.recording import SIMULATION, Frame, Recording
from stereo_slam_env.rendering.backends import renderer_identity


def record(
    env_kwargs: Mapping[str, Any] | None = None,
    seed: int = 0,
    frames: int | None = None,
    progress: Callable[[int, int | None], None] | None = None,
) -> Recording:
    """Drive a scripted route and keep what was measured.

    Parameters
    ----------
    env_kwargs : mapping, optional
        Arguments of `StereoDriveEnv`; `policy` is "route" and can be nothing else.
    seed : int
        Seed of the episode: same seed, same bits.
    frames : int, optional
        Stop after this many; None: at the end of the route.
    progress : callable, optional
        Called after each frame with the number of frames so far and the number wanted (None: not known).

    Returns
    -------
    Recording
        With truth; `source` says how to make it again.

    Raises
    ------
    ValueError
        An argument of the environment is not allowed, `policy` is not "route", `frames` is less than 1, or the
        drive ended before `frames`.
    """
    kwargs = {"policy": "route", **(env_kwargs or {})}
    if kwargs["policy"] != "route":
        raise ValueError(f"policy must be 'route' to record without an agent, got {kwargs['policy']!r}")
    if frames is not None and frames < 1:
        raise ValueError(f"frames must be at least 1, got {frames!r}")
    env = StereoDriveEnv(**kwargs)
    try:
        if frames is not None and frames > env.route.frames:  # known before the drive, which may take minutes
            raise ValueError(_too_many(frames, env.route.frames, env.options))
        env.reset(seed=seed)
        collected = [env.frame]
        idle = np.zeros(2, dtype=np.float32)
        over = False
        while not over and (frames is None or len(collected) < frames):
            over = env.step(idle)[2]
            collected.append(env.frame)
            if progress is not None:
                progress(len(collected), frames)
        if frames is not None and len(collected) < frames:
            raise ValueError(_too_many(frames, len(collected), env.options))
        return recording_of(env, collected, seed)
    finally:
        env.close()


def recording_of(
    env: StereoEnv, frames: Sequence[Frame], seed: int, about: Mapping[str, Any] | None = None
) -> Recording:
    """What an environment measured in the episode of a seed.

    Parameters
    ----------
    env : StereoEnv
        After the last frame.
    frames : sequence of Frame
        Its `frame` after `reset` and after each step.
    seed : int
        Of the episode.
    about : mapping, optional
        What else there is to say of where the recording comes from; JSON-able.
    """
    return Recording(
        name=_name(env.options, seed),
        camera=env.camera,
        frames=tuple(frames),
        noise=env.noise,
        start=env.start,
        landmarks=env.landmark_truth(),
        source={**described(env, seed), "frames": len(frames), **(about or {})},
        truth_from=SIMULATION,
    )


def _too_many(frames: int, most: int, options: DriveOptions) -> str:
    return f"frames must be at most {most} on route {options.route!r}, got {frames}"


def _name(options: StereoOptions, seed: int) -> str:
    seen_by = options.renderer if options.sensor == "images" else options.noise
    return f"{Path(options.route).stem}-{seen_by}-{seed}"


def described(env: StereoEnv, seed: int) -> dict[str, Any]:
    """Everything needed to make the same episode again; JSON-able.

    The back end that draws is part of it: pictures of different ones are different measurements.
    """
    drawn = {"renderer": renderer_identity(env.options.renderer)} if env.options.draws else {}
    return {
        "environment": "StereoSlam/Drive-v0" if env.spec is None else env.spec.id,
        "arguments": env.options.as_dict(),
        "seed": seed,
        **drawn,
        "versions": {name: version_of(name) for name in ("stereo-slam-env", "numpy", "pybullet", "gymnasium")},
    }
