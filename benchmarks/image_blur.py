"""How blurred are the images of a renderer? The setting `image_blur` of the front end with which points do not slide.

    python benchmarks/image_blur.py --renderer gl                     # 8 drives in town, 60 frames each, three minutes
    python benchmarks/image_blur.py --renderer tiny --seeds 6         # seven minutes

Corners are found in every fifth frame, and searched for ten frames later where the true motion and their disparity
have them, with their patch warped as the tracker does. They should be found there. As the camera moves forward, a
patch that is blurrier than the image matches towards the inside of its corner, and of the strongest corners more are
upper than lower ones: the mean displacement is downwards. It is given for each value of `image_blur` in thousandths of
a pixel a frame, in u and in v (down is +), with its standard error over the frames in which corners were found; and so
is the spread of a single match (1.4826 x the median absolute deviation), px.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

import stereo_slam_env as sse
from filters import StereoCamera
from filters.geometry.arrays import FloatArray
from harness import arguments, show
from stereo_slam_env.frontend.finding import PairFinder
from stereo_slam_env.frontend.matching import search
from stereo_slam_env.frontend.patches import cut_patches, local_affine, warped_patches
from stereo_slam_env.frontend.settings import TrackerSettings
from stereo_slam_env.recording.recording import StereoPair

LATER, EVERY = 10, 5
"""Frames between the two images, and between the first images of two comparisons."""
CORNERS = 140
NEAR = 3.0 * np.eye(2)
"""Covariance of the search, px^2: wide enough for the errors of the disparity."""
ACCEPTED, OUTLIER = 0.8, 1.5
"""Least correlation, and the displacement from which on a match is wrong, px."""


def displacements(
    camera: StereoCamera, pairs: Iterable[StereoPair], settings: TrackerSettings, blurs: Sequence[float]
) -> Iterator[list[FloatArray]]:
    """For each first image: found minus expected (u, v) (M, 2) px, with each of `blurs`."""
    recent: deque[StereoPair] = deque(maxlen=LATER + 1)
    for number, now in enumerate(pairs):
        recent.append(now)
        if number < LATER or number % EVERY:
            continue
        then = recent[0]
        uvd, _ = PairFinder(camera, settings, then.left, then.right).corners(CORNERS, np.zeros((0, 2)))
        R = now.truth.R_wc.T @ then.truth.R_wc
        t = now.truth.R_wc.T @ (then.truth.position - now.truth.position)
        points = camera.backproject(uvd) @ R.T + t
        expected = camera.project(np.where(points[:, 2:] > 1.0, points, [0.0, 0.0, -1.0]))
        seen = (points[:, 2] > 1.0) & camera.in_view(expected, settings.margin)
        uvd, expected = uvd[seen], expected[seen, :2]
        stored, affine = cut_patches(then.left, uvd[:, :2]), local_affine(camera, uvd, R, t)
        found = []
        for blur in blurs:
            templates = warped_patches(stored, affine, image_blur=blur)
            result = search(now.left, templates, expected, np.tile(NEAR, (len(expected), 1, 1)))
            found.append(np.where((result.score > ACCEPTED)[:, None], result.position - expected, np.nan))
        # The same corners with each blur.
        kept = np.all([(np.abs(away) < OUTLIER).all(axis=1) for away in found], axis=0)
        yield [away[kept] for away in found]


def summary(blocks: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Mean and its standard error, thousandths of a px a frame, and the spread of one match, px; (2,) each."""
    means = np.array([block.mean(axis=0) for block in blocks if len(block)])
    weights = np.array([len(block) for block in blocks if len(block)]) / sum(len(block) for block in blocks)
    mean = weights @ means
    error = np.sqrt((weights**2) @ (means - mean) ** 2)
    everything = np.concatenate(list(blocks))
    spread = 1.4826 * np.median(np.abs(everything - np.median(everything, axis=0)), axis=0)
    return 1e3 / LATER * mean, 1e3 / LATER * error, spread


def main() -> None:
    """Measure and print."""
    given = arguments(
        __doc__,
        renderer=("gl", "tiny"),
        supersample=1,
        route="town",
        first_seed=0,
        seeds=8,
        frames=60,
        blurs=[0.0, 0.4, 0.8, 1.0, 1.2, 1.6],
    )
    scene = {"route": given.route, "renderer": given.renderer, "supersample": given.supersample}
    blocks: list[list[FloatArray]] = []
    for seed in range(given.first_seed, given.first_seed + given.seeds):
        drive = sse.RenderedDrive(scene, seed=seed, frames=given.frames)
        settings = replace(drive.front_end, max_landmarks=CORNERS, refill_below=CORNERS)
        blocks += displacements(drive.camera, drive.pairs(), settings, given.blurs)
    rows = []
    for blur, of_blur in zip(given.blurs, zip(*blocks, strict=True), strict=True):
        mean, error, spread = summary(of_blur)
        slides = [f"{value:.2f} ± {by:.2f}" for value, by in zip(mean, error, strict=True)]
        rows.append((f"{blur:g}", *slides, *(f"{value:.3f}" for value in spread)))
    heads = ("image_blur, px²", "u, mpx a frame", "v, mpx a frame", "spread u, px", "spread v, px")
    show(f"{given.renderer}, supersample {given.supersample}: slide of points", heads, rows)


if __name__ == "__main__":
    main()
