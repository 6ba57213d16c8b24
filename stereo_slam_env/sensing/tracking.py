"""Limits of tracking: how many landmarks are tracked, and from where they can be seen."""

from __future__ import annotations

from dataclasses import dataclass


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
