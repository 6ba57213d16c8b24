"""Which keys of the observation come in rows, and which key says how many rows there are."""

from __future__ import annotations

from collections.abc import Mapping

ROWS: Mapping[str, tuple[str, ...]] = {
    "mask": ("uvd", "ids"),
    "belief_mask": ("belief_landmark_ids", "belief_landmarks", "belief_landmark_covariances"),
}
"""Mask -> the keys whose first dimension it belongs to; rows in use come first."""

MASK_OF: Mapping[str, str] = {key: mask for mask, keys in ROWS.items() for key in keys}
"""The other way round."""
