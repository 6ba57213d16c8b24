"""The picture of `render()`: both views, the observed landmarks, a caption and a map."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from filters.camera import StereoCamera
from filters.interface import StereoObservation
from filters.validation import FloatArray
from stereo_slam_env.recording.recording import Pose
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
)
from stereo_slam_env.rendering.images import Image, StereoImages
from stereo_slam_env.rendering.insets import inset_gaze, inset_map


def annotated_pair(
    pair: StereoImages,
    observation: StereoObservation,
    caption: Sequence[str],
    path: FloatArray,
    pose: Pose,
    *,
    camera: StereoCamera | None = None,
    pan: float = 0.0,
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
        Of the left camera.
    camera : StereoCamera, optional
        The rig: a second map then shows where it looks.
    pan : float
        How far the head is turned from the direction of the car, positive to the right, rad.

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
    inset_map(right, path, pose, pan)
    if camera is not None:
        inset_gaze(left, path, pose, camera, uvd, pan)
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
