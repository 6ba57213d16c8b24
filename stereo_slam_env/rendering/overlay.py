"""The picture of `render()`: both views, the observed landmarks, a caption and a map."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from filters import rotations
from filters.interface import StereoObservation
from filters.validation import FloatArray
from stereo_slam_env.recording import Pose
from stereo_slam_env.rendering.drawing import (
    INK,
    SUBPIXEL,
    both_views,
    caption_bar,
    disparity_colors,
    even_sides,
    fixed_point,
    label,
    line_scale,
    shade,
)
from stereo_slam_env.rendering.images import Image, StereoImages


def annotated_pair(
    pair: StereoImages, observation: StereoObservation, caption: Sequence[str], path: FloatArray, pose: Pose
) -> Image:
    """Both views with the landmarks drawn in, under a caption.

    Parameters
    ----------
    pair : StereoImages
        The views.
    observation : StereoObservation
        What the sensor measured; warm colours are near, cold ones far.
    caption : sequence of str
        Short texts for the bar at the top.
    path : (K, 3)
        Nominal positions in W, m, for the map.
    pose : Pose
        Where the camera is on it.

    Returns
    -------
    (H', W', 3) uint8
        Wide images one above the other, others side by side; H' and W' are even.
    """
    uvd = observation.uvd
    v_right = uvd[:, 1] if observation.v_right is None else observation.v_right
    right_pixels = np.stack([uvd[:, 0] - uvd[:, 2], v_right], axis=1)
    left = _with_landmarks(pair.left, uvd[:, :2], uvd[:, 2])
    right = _with_landmarks(pair.right, right_pixels, uvd[:, 2])
    for image, name in ((left, "left"), (right, "right")):
        label(image, name)
    _inset_map(right, path, pose)
    views = both_views(left, right)
    return even_sides(np.concatenate([caption_bar(views.shape[1], caption), views]))


def _with_landmarks(image: Image, pixels: FloatArray, disparities: FloatArray) -> Image:
    drawn = image.copy()
    radius = max(3.0, 6.0 * line_scale(image.shape[1]))
    fixed = 1 << SUBPIXEL
    centers = fixed_point(pixels)
    colors = disparity_colors(disparities)
    order = np.argsort(disparities)  # near ones on top
    for i in order:
        center = (int(centers[i, 0]), int(centers[i, 1]))
        color = tuple(int(c) for c in colors[i])
        cv2.circle(drawn, center, int(radius * fixed), INK, 4, cv2.LINE_AA, SUBPIXEL)
        cv2.circle(drawn, center, int(radius * fixed), color, 2, cv2.LINE_AA, SUBPIXEL)
        cv2.circle(drawn, center, int(1.0 * fixed), color, -1, cv2.LINE_AA, SUBPIXEL)
    return drawn


def _inset_map(image: Image, path: FloatArray, pose: Pose) -> None:
    """The route from above (forward is up), with the camera on it, in the lower right corner."""
    size = int(min(130, 0.34 * image.shape[0]))
    pad = max(4, size // 10)
    rows, columns = slice(-size - pad, -pad), slice(-size - pad, -pad)
    shade(image, rows, columns)
    window = image[rows, columns]
    plan = path[:, [0, 2]] * [1.0, -1.0]
    low, high = plan.min(axis=0), plan.max(axis=0)
    zoom = (size - 2 * pad) / max(float((high - low).max()), 1.0)

    def pixel(points: FloatArray) -> NDArray[np.int32]:
        offset = (points - 0.5 * (low + high)) * zoom + 0.5 * size
        return fixed_point(offset)

    cv2.polylines(window, [pixel(plan).reshape(-1, 1, 2)], False, (170, 178, 188), 2, cv2.LINE_AA, SUBPIXEL)
    forward = rotations.matrix(pose.orientation)[:, 2]
    at = pose.position[[0, 2]] * [1.0, -1.0]
    nose = forward[[0, 2]] * [1.0, -1.0]
    side = np.array([-nose[1], nose[0]])
    length = 0.075 * size / zoom
    arrow = np.stack([at + length * nose, at - 0.7 * length * nose + 0.7 * length * side,
                      at - 0.7 * length * nose - 0.7 * length * side])  # fmt: skip
    cv2.fillConvexPoly(window, pixel(arrow), (255, 196, 60), cv2.LINE_AA, SUBPIXEL)
