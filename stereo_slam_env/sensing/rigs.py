"""The stereo rigs that can be asked for by name. All take 10 frames a second."""

from __future__ import annotations

from filters.camera import StereoCamera

RIGS: dict[str, StereoCamera] = {
    "reference": StereoCamera(721.5, 721.5, 672.0, 195.5, 0.571, 1344, 391),
    "vga": StereoCamera(460.0, 460.0, 319.5, 239.5, 0.571, 640, 480),
    "qvga": StereoCamera(230.0, 230.0, 159.5, 119.5, 0.571, 320, 240),
}
"""`reference` is like the cars of Karlsruhe and KITTI; the others are cheaper to render."""

CAMERA_HEIGHT = 1.65
"""Of both eyes above the ground, m."""
