"""Stereo image sequences: what every reader of images and every rendered drive yields, and the front end takes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from filters.camera import StereoCamera
from filters.interface import BodyVelocity
from stereo_slam_env.recording.recording import Pose, Reference, Start

GreyImage = NDArray[np.uint8]
"""(H, W) uint8."""


@dataclass(frozen=True, eq=False)
class StereoPair:
    """Both images of one instant, rectified.

    Attributes
    ----------
    timestamp : float
        s.
    left, right : (H, W) uint8
        Grey.
    truth : Pose, optional
        True pose of the left camera in W.
    odometry : BodyVelocity, optional
        Mean body velocity of the step from the previous pair to this one.
    """

    timestamp: float
    left: GreyImage
    right: GreyImage
    truth: Pose | None = None
    odometry: BodyVelocity | None = None


class ImageSequence(Protocol):
    """A drive as stereo images; the images are made or read one pair at a time."""

    @property
    def name(self) -> str:
        """Short name for tables and files."""

    @property
    def camera(self) -> StereoCamera:
        """The rectified rig that all pairs were taken with."""

    @property
    def start(self) -> Start:
        """What filters are told at the start."""

    @property
    def source(self) -> Mapping[str, Any]:
        """Where the images come from; JSON-able."""

    @property
    def truth_from(self) -> Reference:
        """What the truth of the pairs is, where they have one."""

    @property
    def skipped(self) -> Mapping[str, int]:
        """Why pairs were left out, and how many; known after they have been iterated over."""

    def __len__(self) -> int:
        """Number of pairs."""

    def pairs(self) -> Iterator[StereoPair]:
        """The pairs in time order; may be called again."""
