"""Between a `StereoObservation` and the fixed-shape arrays of a Gymnasium observation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from filters.interface import StereoObservation

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


def padded_v_right(observation: StereoObservation, rows: int) -> dict[str, Any]:
    """`v_right` as (rows,) float64, 0 where there is none, and whether it was measured: `v_right_measured`."""
    v_right = np.zeros(rows)
    if observation.v_right is not None:
        v_right[: len(observation)] = observation.v_right
    return {"v_right": v_right, "v_right_measured": observation.v_right is not None}


def stereo_observation(observation: Mapping[str, Any], info: Mapping[str, Any] | None = None) -> StereoObservation:
    """What the environment returned, as a filter takes it: without padding.

    Parameters
    ----------
    observation : mapping
        From `reset` or `step`: `uvd`, `ids` and `mask`.
    info : mapping, optional
        From the same call; its `v_right` is used where it was measured.

    Returns
    -------
    StereoObservation
    """
    seen = np.asarray(observation["mask"]).astype(bool)
    v_right = None
    if info is not None and info["v_right_measured"]:
        v_right = np.asarray(info["v_right"], dtype=np.float64)[seen]
    return StereoObservation(observation["ids"][seen], observation["uvd"][seen], v_right)
