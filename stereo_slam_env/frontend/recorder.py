"""From images to a recording: the same tracks for every filter."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

from filters.noise import StereoNoise
from stereo_slam_env.frontend.settings import TrackerSettings
from stereo_slam_env.frontend.tracker import StereoTracker
from stereo_slam_env.image_sequence import ImageSequence
from stereo_slam_env.recording import Frame, Recording

TYPICAL_NOISE = StereoNoise.diagonal(0.3, 0.3, 0.3)
"""What a filter is told beforehand; every measurement then comes with a covariance of its own."""


def record_tracks(
    sequence: ImageSequence,
    settings: TrackerSettings | None = None,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> Recording:
    """Follow landmarks through a sequence without a filter.

    Parameters
    ----------
    sequence : ImageSequence
        The images.
    settings : TrackerSettings, optional
        Of the front end.
    progress : callable, optional
        Called with (pairs done, pairs) after each.

    Returns
    -------
    Recording
        With the truth and odometry of the sequence.
    """
    settings = TrackerSettings() if settings is None else settings
    tracker = StereoTracker(sequence.camera, settings)
    frames: list[Frame] = []
    for number, pair in enumerate(sequence.pairs()):
        dt = pair.timestamp - frames[-1].timestamp if frames else None
        observation = tracker.track(pair.left, pair.right, dt).observation
        frames.append(Frame(pair.timestamp, observation, pair.odometry, pair.truth))
        if progress is not None:
            progress(number + 1, len(sequence))
    return Recording(
        sequence.name,
        sequence.camera,
        tuple(frames),
        TYPICAL_NOISE,
        sequence.start,
        source={**sequence.source, "front_end": dataclasses.asdict(settings)},
    )
