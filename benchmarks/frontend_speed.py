"""Cost of the front end: corners, initial disparities, following landmarks, and the tracker as a whole.

    python benchmarks/frontend_speed.py                      # synthetic pairs of 1344 x 391, half a minute
    python benchmarks/frontend_speed.py --images DIR         # the first pair of DIR/image_l and image_r (image_0, _1)

Following is what happens in every frame: the stored patches are warped to how they should look, searched for inside
ellipses of three standard deviations (2 to 3 px each), and matched along the rows within 10 px of the expected
disparity (which need not be confirmed from the right image again). Everything runs in turns in one process on one
core; times are this machine's processor time, ms. The yardstick is an OpenCV call on the same image: ratios to it hold
on a busy machine, too.

The second table is of `StereoTracker.track` on a slow drive past three walls, in pairs that need no new corners (as
most do), by what it does; and of whole pairs: these, and those in which new corners are looked for.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from unittest.mock import patch

import cv2
import numpy as np
from threadpoolctl import threadpool_limits

from filters.geometry.camera import StereoCamera
from harness import arguments, in_turns, show, undisturbed
from stereo_slam_env.frontend import finding, tracker
from stereo_slam_env.frontend.finding import detect_corners
from stereo_slam_env.frontend.matching import match_rows, search
from stereo_slam_env.frontend.patches import Image, cut_patches, warped_patches
from stereo_slam_env.frontend.settings import TrackerSettings

WIDTH, HEIGHT = 1344, 391
SIGMA = (2.0, 3.0)  # of the forecast, px
WIDE_SIGMA = 10.0  # of a landmark about which little is known, px
HALF_RANGE = 10.0  # of the disparity of a landmark that is followed, px
WIDE = (0.5, 250.0)  # disparities of new corners, px
QUANTILES = (0.2, 0.5, 0.9)
CAMERA = StereoCamera(721.5, 721.5, 672.0, 195.5, 0.571, WIDTH, HEIGHT)
WALLS = (40.0, 12.0, 7.0)  # depth of each third of the image, m
SLOW = np.array([0.01, 0.0, 0.03])  # of the camera in each pair, m
STAGES: dict[str, tuple[tuple[Any, str], ...]] = {
    "expectation": ((tracker.StereoTracker, "_expected"), (tracker.StereoTracker, "_by_motion")),
    "warp": ((finding, "local_affine"), (finding, "warped_patches")),
    "search": ((finding, "search"),),
    "rows": ((finding, "match_rows"),),
    "motion": ((tracker.StereoTracker, "_motion"),),
    "judging": ((tracker, "judged"),),
}


def synthetic_pair(seed: int, disparity: float = 30.0) -> tuple[Image, Image]:
    """Smoothed noise on several scales, and the same further left."""
    rng = np.random.default_rng(seed)
    wide = WIDTH + int(disparity)
    texture = np.zeros((HEIGHT, wide))
    for sigma in (1.5, 3.0, 8.0, 30.0):
        layer = cv2.GaussianBlur(rng.standard_normal((HEIGHT, wide)), (0, 0), sigma)
        texture += layer / layer.std()
    grey = np.clip(128 + 25 * texture + rng.normal(0, 2, texture.shape), 0, 255).astype(np.uint8)
    return np.ascontiguousarray(grey[:, :WIDTH]), np.ascontiguousarray(grey[:, wide - WIDTH :])


def recorded_pair(folder: Path) -> tuple[Image, Image]:
    """The first pair of a recording, at the size of the reference rig."""
    for names in (("image_l", "image_r"), ("image_0", "image_1")):
        left, right = (sorted((folder / name).glob("*.png")) for name in names)
        if left and right:
            pair = [cv2.imread(str(path[0]), cv2.IMREAD_GRAYSCALE) for path in (left, right)]
            resized = [np.asarray(cv2.resize(image, (WIDTH, HEIGHT)), dtype=np.uint8) for image in pair]
            return resized[0], resized[1]
    raise SystemExit(f"{folder} has neither image_l and image_r nor image_0 and image_1 with PNG files")


def stages(left: Image, right: Image, landmarks: int, corners: int) -> dict[str, Callable[[], object]]:
    """What is timed, each a call without arguments."""
    rng = np.random.default_rng(0)
    none = np.zeros((0, 2))
    new = detect_corners(left, corners, none)
    wide = match_rows(left, right, new, np.full(len(new), WIDE[0]), np.full(len(new), WIDE[1]))
    uv = new[wide.accepted][:landmarks]
    d = wide.disparity[wide.accepted][:landmarks]
    n = len(uv)
    stored = cut_patches(left, uv)
    affine = np.eye(2) + rng.normal(0, 0.03, (n, 2, 2))
    sigma = rng.uniform(*SIGMA, n)
    S = np.zeros((n, 2, 2))
    S[:, 0, 0], S[:, 1, 1] = sigma**2, rng.uniform(*SIGMA, n) ** 2
    S[:, 0, 1] = S[:, 1, 0] = 0.5 * np.sqrt(S[:, 0, 0] * S[:, 1, 1])
    expected = uv + np.einsum("nij,nj->ni", np.linalg.cholesky(S), rng.standard_normal((n, 2)))
    templates, wide_S = warped_patches(stored, affine), WIDE_SIGMA**2 * np.eye(2)
    low, high = d - HALF_RANGE, d + HALF_RANGE

    def follow() -> object:
        found = search(left, warped_patches(stored, affine), expected, S)
        at = np.where(np.isfinite(found.position), found.position, uv)
        return found, match_rows(left, right, at, low, high, left_right_check=False)

    return {
        "yardstick: cv2.goodFeaturesToTrack": lambda: cv2.goodFeaturesToTrack(left, 1000, 0.01, 8),
        f"corners ({len(new)} found)": lambda: detect_corners(left, corners, none),
        f"{len(new)} corners along rows, {WIDE[1]:.0f} px, checked": lambda: match_rows(
            left, right, new, np.full(len(new), WIDE[0]), np.full(len(new), WIDE[1])
        ),
        f"cut {n} patches": lambda: cut_patches(left, uv),
        f"warp {n} patches": lambda: warped_patches(stored, affine),
        f"search {n} ellipses": lambda: search(left, templates, expected, S),
        f"search {n} ellipses, {WIDE_SIGMA:.0f} px": lambda: search(
            left, templates, expected, np.tile(wide_S, (n, 1, 1))
        ),
        f"{n} landmarks along rows, {2 * HALF_RANGE:.0f} px": lambda: match_rows(
            left, right, uv, low, high, left_right_check=False
        ),
        f"{n} landmarks along rows, checked": lambda: match_rows(left, right, uv, low, high),
        f"follow {n} landmarks: warp, search, rows": follow,
    }


def slow_drive(pairs: int, seed: int) -> Iterator[tuple[Image, Image]]:
    """Pairs of a camera that moves by `SLOW` past three walls, one above the other."""
    rng = np.random.default_rng(seed)
    size, border = (WIDTH, HEIGHT), 400
    wide = (WIDTH + 2 * border, HEIGHT + 2 * border)
    textures = []
    for _ in WALLS:
        texture = np.zeros((wide[1], wide[0]))
        for sigma in (1.5, 3.0, 8.0, 30.0):
            layer = cv2.GaussianBlur(rng.standard_normal(texture.shape), (0, 0), sigma)
            texture += layer / layer.std()
        textures.append((128 + 25 * texture).astype(np.float32))
    rows = np.arange(HEIGHT)[:, None] * len(WALLS) // HEIGHT
    for number in range(pairs):
        eyes = []
        for eye in (0.0, CAMERA.baseline):
            image = np.zeros((HEIGHT, WIDTH), dtype=np.float32)
            for index, (depth, texture) in enumerate(zip(WALLS, textures, strict=True)):
                x, _, z = number * SLOW + (eye, 0.0, 0.0)
                scale = depth / (depth - z)
                u = CAMERA.cx - scale * (CAMERA.cx + border) - CAMERA.fx * x / (depth - z)
                v = CAMERA.cy - scale * (CAMERA.cy + border)
                layer = cv2.warpAffine(texture, np.array([[scale, 0.0, u], [0.0, scale, v]]), size)
                image = np.where(rows == index, layer, image)
            eyes.append(np.clip(np.rint(image + rng.normal(0, 2, image.shape)), 0, 255).astype(np.uint8))
        yield eyes[0], eyes[1]


def tracked_drive(pairs: int, landmarks: int) -> dict[str, list[float]]:
    """Processor time of each stage of `track` in each pair that needs no new corners, s, and of whole pairs."""
    # The tracker follows more landmarks than the filter may have: about `landmarks` are followed.
    given = round(1.07 * landmarks / tracker._SPARE)
    settings = TrackerSettings(max_landmarks=given, refill_below=round(0.9 * given))
    following = tracker.StereoTracker(CAMERA, settings)
    spent = dict.fromkeys(STAGES, 0.0)
    running: list[str] = []

    def timed(stage: str, call: Callable[..., Any]) -> Callable[..., Any]:
        def wrapper(*args: Any, **kwargs: Any) -> Any:
            if running:  # inside another stage, whose time it is
                return call(*args, **kwargs)
            running.append(stage)
            began = time.process_time()
            try:
                return call(*args, **kwargs)
            finally:
                spent[stage] += time.process_time() - began
                running.pop()

        return wrapper

    patches = [
        patch.object(owner, name, timed(stage, getattr(owner, name)))
        for stage, places in STAGES.items()
        for owner, name in places
    ]
    whole, first, refilled = "whole pair, no new corners", "first pair", "whole pair, new corners"
    times: dict[str, list[float]] = {stage: [] for stage in (*STAGES, "rest", whole, refilled, first)}
    counts = []
    for change in patches:
        change.start()
    try:
        for number, (left, right) in enumerate(slow_drive(pairs, 0)):
            spent.update(dict.fromkeys(STAGES, 0.0))
            began = time.process_time()
            result = following.track(left, right, 0.1)
            total = time.process_time() - began
            if number == 0 or len(result.corners):
                times[refilled if number else first].append(total)
                continue
            counts.append(len(result.search.ids))
            for stage, value in {**spent, "rest": total - sum(spent.values()), whole: total}.items():
                times[stage].append(value)
    finally:
        for change in patches:
            change.stop()
    followed = f", {np.mean(counts):.0f} followed" if counts else ""
    return {(name + followed if name == whole else name): values for name, values in times.items() if values}


def main() -> None:
    """Measure and print."""
    given = arguments(__doc__, images=Path, landmarks=100, corners=150, repeats=60, pairs=60)
    cv2.setNumThreads(1)
    left, right = synthetic_pair(0) if given.images is None else recorded_pair(given.images)
    with threadpool_limits(1):
        times = in_turns(stages(left, right, given.landmarks, given.corners), given.repeats)
        drive = tracked_drive(given.pairs, given.landmarks)
    yardstick = undisturbed(next(iter(times.values())))
    for part, found in (("Parts", times), ("StereoTracker.track", drive)):
        rows = []
        for stage, each in found.items():
            quantiles = (f"{1e3 * value:.2f}" for value in np.quantile(each, QUANTILES))
            rows.append((stage, *quantiles, f"{undisturbed(each) / yardstick:.2f}"))
        title = f"{part}: {WIDTH} x {HEIGHT}, one core, ms of processor time"
        show(title, ("stage", *(f"{100 * q:.0f} %" for q in QUANTILES), "to yardstick"), rows)


if __name__ == "__main__":
    main()
