"""What the front end returns for one pair: the measurements, and how it came to them."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from filters.interface import StereoObservation
from filters.validation import FloatArray, IntArray


class Outcome(IntEnum):
    """What became of a landmark that was searched for."""

    MATCHED = 0
    """Found in both images."""
    NO_MATCH = 1
    """The best correlation inside the ellipse was too low or not unique."""
    NO_DISPARITY = 2
    """Found in the left image, but not along the row of the right one."""
    INCONSISTENT = 3
    """Found, but moved unlike the rest of the scene."""
    MOVING = 4
    """Found, on a body that moves: kept out of the map."""
    OUT_OF_VIEW = 5
    """Expected outside one of the images."""


@dataclass(frozen=True, eq=False)
class Search:
    """Where landmarks were searched for and what was found; N rows, all the landmarks tracked so far.

    Attributes
    ----------
    ids : (N,) int64
        Landmarks.
    predicted : (N, 3)
        Expected (u, v, d), px.
    S : (N, 3, 3)
        Covariance of measured minus expected, px^2: the ellipse that was searched.
    found : (N, 3)
        Where it was found, px; NaN where it was not.
    outcome : (N,) int64
        An `Outcome` each.
    """

    ids: IntArray
    predicted: FloatArray
    S: FloatArray
    found: FloatArray
    outcome: IntArray


@dataclass(frozen=True, eq=False)
class TrackedPair:
    """The front end's result for one pair.

    Attributes
    ----------
    observation : StereoObservation
        The measurements for the filter, ids ascending, each with its own R.
    search : Search
        How the landmarks of earlier pairs were followed.
    corners : StereoObservation
        New corners of this pair; those that stand still will be given to the filter after their probation.
    initialised : (K,) int64
        Ids in `observation` that are new to the filter.
    dropped : (L,) int64
        Ids that will not come again: out of view, missed too often, or moving.
    """

    observation: StereoObservation
    search: Search
    corners: StereoObservation
    initialised: IntArray
    dropped: IntArray
