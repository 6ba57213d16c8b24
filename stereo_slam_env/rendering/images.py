"""Rendered stereo pairs, and what a renderer does."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from filters.geometry.arrays import FloatArray
from filters.geometry.poses import Pose
from stereo_slam_env.world.scene import Scene

Image = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class StereoImages:
    """A rendered pair, RGB (H, W, 3) uint8, and depth z of the left pixel centres (H, W), m; infinity: nothing."""

    left: Image
    right: Image
    depth: FloatArray


@dataclass(frozen=True)
class ImageQuality:
    """What a vision front end has to know of the images of a back end."""

    blur: float
    """Variance of the point spread along an axis, px^2: that of texture filter and sampling."""
    texture_sigma: float = 0.0
    """By how much textures are displaced in a way that the correlation of patches does not show, px."""


class StereoRenderer(Protocol):
    """A back end that draws both views."""

    @staticmethod
    def image_quality(supersample: int = 1) -> ImageQuality:
        """Quality of the images, drawn so many times finer and averaged."""

    def build(self, scene: Scene) -> None:
        """Replace whatever was drawn by `scene`."""

    def render_pair(self, pose: Pose, time: float = 0.0) -> StereoImages:
        """Draw what the rig sees from `pose` (left camera in W) when moving bodies are where they are at `time` s."""

    def close(self) -> None:
        """Free what the back end holds; may be called twice."""


def grey(image: Image) -> Image:
    """The brightness of an RGB image, what a vision front end works on; (H, W, 3) or (H, W) -> (H, W) uint8."""
    if image.ndim == 2:
        return image
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
