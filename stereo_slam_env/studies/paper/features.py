"""Figure 3: features of a rendered right turn at the first frame and after 10 updates."""

from __future__ import annotations

from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from stereo_slam_env import RenderedDrive
from stereo_slam_env.frontend import record_tracks
from stereo_slam_env.studies.paper.claims import Arrays, FloatArray
from stereo_slam_env.studies.paper.convergence import UPDATES, WIDE_RANGES, measured_disparities, seen_throughout
from stereo_slam_env.studies.paper.drives import ROUTES, TURN

Image = NDArray[np.uint8]
NEAR, BETWEEN, FAR = (0, 140, 230), (150, 150, 150), (200, 110, 30)  # BGR: orange, grey, blue
NAME = "features"


def experiments() -> dict[str, partial[Arrays]]:
    """The turn of seed 0."""
    return {NAME: partial(tracked, 0)}


def tracked(seed: int) -> Arrays:
    """Left images of the first and the last frame, and the pixels and depths of what is seen throughout."""
    drive = RenderedDrive({"route": ROUTES[TURN], "renderer": "gl"}, seed, UPDATES + 1)
    recording = record_tracks(drive, drive.front_end)
    images = [pair.left for number, pair in enumerate(drive.pairs()) if number in (0, UPDATES)]
    ids = seen_throughout(recording)
    pixels = []
    for frame in recording.frames:
        order = np.argsort(frame.observation.ids)
        at = order[np.searchsorted(frame.observation.ids, ids, sorter=order)]
        pixels.append(frame.observation.uvd[at, :2])
    depths = recording.camera.disparity_constant / np.median(measured_disparities(recording, ids), axis=1)
    return {"images": np.array(images), "pixels": np.array(pixels), "depths": depths}


def picture(arrays: Arrays) -> Image:
    """Both frames, one above the other, BGR, with a ring at each feature and its way from the first frame."""
    images, pixels, depths = (arrays[name] for name in ("images", "pixels", "depths"))
    shown = []
    for number, words in ((0, "first frame: features are initialised"), (UPDATES, f"after {UPDATES} updates")):
        view = cv2.cvtColor(images[0 if number == 0 else 1], cv2.COLOR_GRAY2BGR)
        for way, depth in zip(pixels.transpose(1, 0, 2), depths, strict=True):
            colour = _colour(depth)
            cv2.polylines(view, [np.rint(way[: number + 1]).astype(np.int32)], False, colour, 1, cv2.LINE_AA)
            cv2.circle(view, tuple(np.rint(way[number]).astype(int).tolist()), 6, colour, 2, cv2.LINE_AA)
        cv2.rectangle(view, (0, 0), (440, 40), (0, 0, 0), cv2.FILLED)
        cv2.putText(view, words, (12, 28), cv2.FONT_HERSHEY_SIMPLEX, 0.7, (255, 255, 255), 1, cv2.LINE_AA)
        shown.append(view)
    return np.concatenate(shown)


def _colour(depth: FloatArray) -> tuple[int, int, int]:
    (_, near), (far, _) = WIDE_RANGES.values()
    return NEAR if depth < near else FAR if depth > far else BETWEEN
