"""Errors of each landmark kept in the state instead of a walk: which has the better log score on real tracks.

    python benchmarks/lasting_state.py DATA      # some ten minutes

`coloured-noise` on the recordings of `changed_recordings.py`, vision only, with the errors of the right camera and
without them: where each point walks, as the recording states its noise, and with errors that last so many seconds,
whose covariance is a multiple of the white one (of the median R, where tracks bring one). The last column is processor
time by that of the walk.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path
from time import process_time

import numpy as np

import stereo_slam_env as sse
from changed_recordings import HEADS, RECORDINGS, scored
from filters import ColouredNoise
from filters.geometry.arrays import FloatArray
from harness import arguments, show
from stereo_slam_env.frontend.track_noise import bring_R
from stereo_slam_env.recording.recording import Recording

TIMES_WHITE, SECONDS = (1.0, 4.0), (0.5, 2.0, 8.0)


def white(recording: Recording, noise: ColouredNoise) -> FloatArray:
    """What is white in (u, v, d), px^2: as stated, or the median of what the tracks bring."""
    if not bring_R(recording):
        return noise.white_part.R
    seen = [frame.observation.covariances(noise) for frame in recording.frames]
    median: FloatArray = np.median(np.concatenate(seen), axis=0)
    return median


def main() -> None:
    """Run and print."""
    given = arguments(__doc__, "data", data=Path, times_white=list(TIMES_WHITE), seconds=list(SECONDS))
    for name, frames in RECORDINGS.items():
        told = sse.load(given.data / name)[:frames]
        assert isinstance(told.noise, ColouredNoise)
        calibrated = replace(told.noise, disparity_offset=0.0, right_yaw=0.0, right_roll=0.0)
        for title, noise in {name: told.noise, f"{name}, right camera taken as calibrated": calibrated}.items():
            R = white(told, noise)
            kinds = {"each point walks": replace(noise, lasting=None, lasting_time=None)}
            if noise.lasting is not None:
                kinds["as stated"] = noise
            for times, seconds in product(given.times_white, given.seconds):
                kept = replace(noise, white=R, lasting=times * R, lasting_time=seconds)
                kinds[f"{times:g} x white, {seconds:g} s"] = kept
            table, spent = [], []
            for label, kind in kinds.items():
                begun = process_time()
                row = scored(replace(told, noise=kind))
                spent.append(process_time() - begun)
                table.append((label, *row.cells, f"{spent[-1] / spent[0]:.1f}"))
            show(title, ("errors", *HEADS[1:], "time"), table)


if __name__ == "__main__":
    main()
