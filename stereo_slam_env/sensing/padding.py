"""Limits of tracking, and fixed-shape arrays of a Gymnasium observation to and from a `StereoObservation`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from filters import StereoObservation


@dataclass(frozen=True)
class TrackingPolicy:
    """Number and visibility limits of the tracked landmarks.

    A landmark is kept as long as both cameras see it. New ones are drawn with a probability proportional to their
    disparity, so near ones are preferred.
    """

    max_landmarks: int = 90
    """Most landmarks in one frame."""
    refill_below: int = 65
    """New ones are only taken up, to `max_landmarks`, when fewer than this are left."""
    nearest: float = 4.0
    """Least depth z, m."""
    farthest: float = 150.0
    """Largest depth z, m."""
    margin: float = 2.0
    """Distance to the edge of both images, px."""
    revisit: bool = False
    """Whether a lost landmark may be tracked again, under its old id."""


NO_LANDMARK = -1
"""Id of a padding row."""


def padded(observation: StereoObservation, rows: int) -> dict[str, NDArray[Any]]:
    """The observation as `uvd` (rows, 3) float32, `ids` (rows,) int64 and `mask` (rows,) int8.

    Padding rows have uvd 0, id -1 and mask 0.
    """
    count = len(observation)
    uvd = np.zeros((rows, 3), dtype=np.float32)
    ids = np.full(rows, NO_LANDMARK, dtype=np.int64)
    mask = np.zeros(rows, dtype=np.int8)
    uvd[:count], ids[:count], mask[:count] = observation.uvd, observation.ids, 1
    return {"uvd": uvd, "ids": ids, "mask": mask}


def padded_extras(observation: StereoObservation, rows: int) -> dict[str, Any]:
    """Measurements that not every sensor has, 0 where there is none, and whether they were made.

    `v_right` (rows,) float64 px and `v_right_measured`; the covariances `R` (rows, 3, 3) float64 px^2 and `R_measured`.
    """
    extras: dict[str, Any] = {}
    for name, values, shape in (("v_right", observation.v_right, ()), ("R", observation.R, (3, 3))):
        extras[name] = np.zeros((rows, *shape))
        if values is not None:
            extras[name][: len(observation)] = values
        extras[f"{name}_measured"] = np.bool_(values is not None)
    return extras


def stereo_observation(observation: Mapping[str, Any], info: Mapping[str, Any] | None = None) -> StereoObservation:
    """Observation of an environment as a filter takes it, without padding.

    Parameters
    ----------
    observation : mapping
        From `reset` or `step`: `uvd`, `ids` and `mask`.
    info : mapping, optional
        From the same call; its `v_right` and `R` are used where they were measured.

    Raises
    ------
    ValueError
        The observation is without ids.
    """
    if "ids" not in observation:
        raise ValueError("observation must have ids: make the environment with observe_ids=True")
    is_filled = np.asarray(observation["mask"]).astype(bool)
    measured: dict[str, Any] = {}
    for name in ("v_right", "R"):
        if info is not None and info[f"{name}_measured"]:
            measured[name] = np.asarray(info[name], dtype=np.float64)[is_filled]
    return StereoObservation(observation["ids"][is_filled], observation["uvd"][is_filled], **measured)
