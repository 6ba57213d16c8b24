"""Errors of each landmark kept in the state instead of a walk: which has the better log score on real tracks.

    python benchmarks/lasting_state.py DATA      # some ten minutes

`coloured-noise` without the errors of the right camera, on the recordings of `changed_recordings.py`, vision only: as
the recording states its noise (each point walks), and with `LastingErrors` in the place of the walk, for shares of the
white noise (of R, where tracks bring one) and time constants.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np

import stereo_slam_env as sse
from changed_recordings import HEADS, RECORDINGS, scored
from filters import ColouredNoise, LastingErrors, PairWithLastingErrors
from filters.geometry.arrays import FloatArray
from harness import arguments, show
from stereo_slam_env.frontend.track_noise import bring_R
from stereo_slam_env.recording.recording import Recording

SHARES, SECONDS = (0.25, 1.0, 4.0), (0.5, 2.0, 8.0)


def white(recording: Recording, noise: ColouredNoise) -> FloatArray:
    """What is white in (u, v, d), px^2: as stated, or the median of what the tracks bring."""
    if not bring_R(recording):
        return noise.R if noise.white is None else noise.white
    seen = [frame.observation.covariances(noise) for frame in recording.frames]
    median: FloatArray = np.median(np.concatenate(seen), axis=0)
    return median


def main() -> None:
    """Run and print."""
    given = arguments(__doc__, "data", data=Path)
    for name, frames in RECORDINGS.items():
        told = sse.load(given.data / name)[:frames]
        assert isinstance(told.noise, ColouredNoise)
        drive = replace(told, noise=replace(told.noise, disparity_offset=0.0, right_yaw=0.0, right_roll=0.0))
        table, noise = [("each point walks", *scored(drive).cells)], white(told, told.noise)
        for share, seconds in product(SHARES, SECONDS):
            parts = {"landmark": LastingErrors(share * noise, seconds), "measurement": PairWithLastingErrors()}
            table.append((f"{share:g} of it, {seconds:g} s", *scored(drive, drift=None, **parts).cells))
        show(name, ("errors", *HEADS[1:]), table)


if __name__ == "__main__":
    main()
