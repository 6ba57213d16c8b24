"""Drives that are drawn: what goes wrong is in the images, and the front end measures what is left to see."""

from __future__ import annotations

from dataclasses import replace

from stereo_slam_env.envs.recorder import record
from stereo_slam_env.recording.recording import Recording


def drawn_drive(surroundings: str, seed: int, frames: int, blank_from: float | None) -> Recording:
    """Small images of a drive round a block, by a renderer that works everywhere.

    Look and cameras are drawn from the seed. The cameras are noisy on purpose: without noise, corners are found where
    two walls differ by one grey level. There is no odometry, as in the reference drive: it would carry a filter on.

    Parameters
    ----------
    surroundings : str
        Name in `world.surroundings.SURROUNDINGS`.
    seed, frames : int
        Same seed, same bits; the first turn is from 7 to 13 s.
    blank_from : float, optional
        From then on nothing has a texture, s; None: never.
    """
    recording = record(
        {
            "route": "loop",
            "surroundings": surroundings,
            "rig": "qvga",
            "sensor": "images",
            "renderer": "tiny",
            "randomise": True,
            "blank_from": blank_from,
        },
        seed,
        frames,
    )
    return replace(recording, frames=tuple(replace(frame, odometry=None) for frame in recording.frames))
