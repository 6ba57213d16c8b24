"""Figure 3: features of a rendered right turn at the first frame and after 10 updates."""

from __future__ import annotations

from functools import partial

import numpy as np

from stereo_slam_env import RenderedDrive
from stereo_slam_env.frontend import record_tracks
from stereo_slam_env.paper.claims import Arrays
from stereo_slam_env.paper.convergence import UPDATES, WIDE_RANGES, measurements, seen_throughout
from stereo_slam_env.paper.drives import ROUTES, TURN
from stereo_slam_env.rendering import tracks_picture

NEAR, BETWEEN, FAR = (230, 140, 0), (150, 150, 150), (30, 110, 200)  # RGB: orange, grey, blue
NAME = "features"


def experiments() -> dict[str, partial[Arrays]]:
    """The turn of seed 0."""
    return {NAME: partial(tracked, 0)}


def tracked(seed: int) -> Arrays:
    """Left images of the first and the last frame, and the pixels and depths of what is seen throughout."""
    drive = RenderedDrive({"route": ROUTES[TURN], "renderer": "gl"}, seed, UPDATES + 1)
    recording = record_tracks(drive, drive.front_end)
    images = [pair.left for number, pair in enumerate(drive.pairs()) if number in (0, UPDATES)]
    uvd = measurements(recording, seen_throughout(recording))
    depths = recording.camera.disparity_constant / np.median(uvd[:, :, 2], axis=1)
    return {"images": np.array(images), "pixels": uvd[:, :, :2].transpose(1, 0, 2), "depths": depths}


def picture(arrays: Arrays) -> bytes:
    """Both frames, one above the other, as a PNG file, with a ring at each feature and its way since the first."""
    (_, near), (far, _) = WIDE_RANGES.values()
    colours = [NEAR if depth < near else FAR if depth > far else BETWEEN for depth in arrays["depths"]]
    words = "first frame: features are initialised", f"after {UPDATES} updates"
    ways = arrays["pixels"][:1], arrays["pixels"]
    return tracks_picture(arrays["images"], ways, colours, words)
