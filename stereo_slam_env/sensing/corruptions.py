"""What can go wrong between the world and a filter, applied to a `Recording` after the fact.

A corruption is a small frozen dataclass with one method; any number of them can be applied one after the other. They
change what a filter is given (measurements, what it is told about them, the order of frames) and never the truth of the
drive, so runs with and without one are paired.

To add one: a class with `applied_to`, listed in `CORRUPTIONS`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from filters.known_names import require_known
from stereo_slam_env.recording.recording import Recording
from stereo_slam_env.sensing.corrupted_frames import Blackouts, DroppedFrames, DuplicatedFrames, Latency
from stereo_slam_env.sensing.corrupted_measurements import (
    BiasedDisparity,
    MisscaledNoise,
    MissedDetections,
    MovingLandmarks,
    Outliers,
    WrongCalibration,
    WrongIds,
)


class Corruption(Protocol):
    """One thing that goes wrong."""

    def applied_to(self, recording: Recording, rng: np.random.Generator) -> Recording:
        """Return the recording as it is with this gone wrong; `recording` itself stays as it was.

        Parameters
        ----------
        recording : Recording
            What was measured.
        rng : numpy.random.Generator
            Source of everything random.

        Raises
        ------
        ValueError
            The recording lacks what this needs, such as the truth.
        """


CORRUPTIONS: Mapping[str, type[Any]] = {
    "outliers": Outliers,
    "wrong-ids": WrongIds,
    "missed-detections": MissedDetections,
    "blackouts": Blackouts,
    "dropped-frames": DroppedFrames,
    "duplicated-frames": DuplicatedFrames,
    "latency": Latency,
    "moving-landmarks": MovingLandmarks,
    "wrong-calibration": WrongCalibration,
    "biased-disparity": BiasedDisparity,
    "misscaled-noise": MisscaledNoise,
}
"""By the name they have in scenario files; each is a frozen dataclass and a `Corruption`."""


def make_corruption(entry: Mapping[str, Any]) -> Corruption:
    """A corruption from its JSON form.

    Parameters
    ----------
    entry : mapping
        `kind`, a key of `CORRUPTIONS`, and the fields of that class.

    Raises
    ------
    ValueError
        No or an unknown kind, an unknown or missing field, or an impossible value: the message names it.
    """
    if not isinstance(entry, Mapping) or "kind" not in entry:
        raise ValueError(f"a corruption must have a kind, one of {', '.join(CORRUPTIONS)}, got {entry!r}")
    kind = entry["kind"]
    require_known("there is no corruption", [kind], CORRUPTIONS)
    given = {name: value for name, value in entry.items() if name != "kind"}
    fields = dataclasses.fields(CORRUPTIONS[kind])
    require_known(f"corruption {kind!r} has no field", given, [field.name for field in fields])
    for field in fields:
        if field.default is dataclasses.MISSING and field.name not in given:
            raise ValueError(f"corruption {kind!r} needs the field {field.name}")
    try:
        made: Corruption = CORRUPTIONS[kind](**given)
    except ValueError as error:
        raise ValueError(f"corruption {kind!r}: {error}") from error
    return made


def corrupted(recording: Recording, entries: Sequence[Mapping[str, Any]], seed: int) -> Recording:
    """The recording with everything in `entries` gone wrong, in that order.

    Parameters
    ----------
    recording : Recording
        What was measured; it stays as it was.
    entries : sequence of mapping
        JSON forms, see `make_corruption`.
    seed : int
        Same seed, same bits. Each entry has a random stream of its own, so one added at the end changes nothing of
        what those before it do.

    Returns
    -------
    Recording
        `source["corruptions"]` says what was done.

    Raises
    ------
    ValueError
        An entry is wrong, or needs something that the recording does not have. Entries are all checked first.
    """
    corruptions = [make_corruption(entry) for entry in entries]
    if not corruptions:
        return recording
    streams = np.random.default_rng(seed).spawn(len(corruptions))
    result = recording
    for entry, corruption, rng in zip(entries, corruptions, streams, strict=True):
        try:
            result = corruption.applied_to(result, rng)
        except ValueError as error:
            raise ValueError(f"corruption {entry['kind']!r} of {recording.name!r}: {error}") from error
    done = [{"kind": e["kind"], **vars(c), "seed": seed} for e, c in zip(entries, corruptions, strict=True)]
    before = recording.source.get("corruptions", [])
    return dataclasses.replace(result, source={**result.source, "corruptions": [*before, *done]})
