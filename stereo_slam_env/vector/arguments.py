"""Arguments of vector environments as Gymnasium has them, checked; and rows of single environments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from operator import index
from typing import Any

import numpy as np
from numpy.typing import NDArray

from filters.validation import BoolArray
from stereo_slam_env.envs.options import StereoOptions


def require_native(options: StereoOptions) -> None:
    """Raise a `ValueError` for what only single environments have."""
    only = {"sensor": "landmarks", "render_images": False, "moving_cars": 0, "pedestrians": 0}
    for name, value in only.items():
        if getattr(options, name) != value:
            raise ValueError(
                f"{name} must be {value!r} in a native vector environment, got {getattr(options, name)!r}: "
                "use make_vec(..., vectorization_mode='async') for a process each"
            )


def reset_mask(options: Mapping[str, Any] | None, begun: BoolArray) -> BoolArray:
    """Environments to be reset, from the options of `reset`; `begun` (B,) says which have been reset before."""
    if not options:
        return np.ones(len(begun), dtype=np.bool_)
    if set(options) != {"reset_mask"}:
        raise ValueError(f"reset takes no options but reset_mask, got {', '.join(map(repr, options))}")
    mask = np.asarray(options["reset_mask"])
    if mask.shape != begun.shape or mask.dtype != np.bool_ or not mask.any():
        raise ValueError(f"reset_mask must be ({len(begun)},) bool with at least one True, got {mask!r}")
    if not (mask | begun).all():
        raise ValueError("reset_mask must be all True in the first reset")
    return mask


def seeds_of(seed: int | Sequence[int | None] | None, count: int) -> list[int | None]:
    """A seed for each environment: one counts up from the first of them on."""
    each: list[int | None]
    try:
        if seed is None:
            each = [None] * count
        elif isinstance(seed, (Sequence, np.ndarray)):
            each = [None if value is None else index(value) for value in seed]
        else:
            each = [index(seed) + b for b in range(count)]
    except TypeError:
        each = []
    if len(each) != count:
        raise ValueError(f"seed must be a whole number or {count} of them, got {seed!r}")
    return each


def rows_of(observation: Mapping[str, Any], which: BoolArray) -> NDArray[Any]:
    """Observations of single environments, None where they are not asked for; (B,) objects."""
    rows = np.full(len(which), None, dtype=object)
    for b in np.flatnonzero(which).tolist():
        rows[b] = {key: value[b].copy() for key, value in observation.items()}
    return rows
