"""Cost of the image-level half of the front end: corners, initial disparities, and following landmarks.

    python benchmarks/frontend_speed.py                      # a synthetic pair of 1344 x 391, half a minute
    python benchmarks/frontend_speed.py --images DIR         # the first pair of DIR/image_l and image_r (image_0, _1)
    python benchmarks/frontend_speed.py --json speed.json

Following is what happens in every frame: the stored patches are warped to how they should look, searched for inside
ellipses of three standard deviations (2 to 3 px each), and matched along the rows within 10 px of the expected
disparity (which need not be confirmed from the right image again). Everything runs in turns in one process on one
core; times are this machine's processor time, ms. The yardstick is an OpenCV call on the same image: ratios to it hold
on a busy machine, too.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from stereo_slam_env.frontend.correlation import search
from stereo_slam_env.frontend.detection import detect_corners
from stereo_slam_env.frontend.patches import Image, cut_patches, warped_patches
from stereo_slam_env.frontend.stereo_matching import match_rows

WIDTH, HEIGHT = 1344, 391
SIGMA = (2.0, 3.0)  # of the forecast, px
WIDE_SIGMA = 10.0  # of a landmark about which little is known, px
HALF_RANGE = 10.0  # of the disparity of a landmark that is followed, px
WIDE = (0.5, 250.0)  # disparities of new corners, px
QUANTILES = (0.2, 0.5, 0.9)


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


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=Path, help="folder of a recording; default: synthetic")
    parser.add_argument("--landmarks", type=int, default=100)
    parser.add_argument("--corners", type=int, default=150)
    parser.add_argument("--repeats", type=int, default=60)
    parser.add_argument("--json", type=Path, help="write the figures here, too")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    left, right = synthetic_pair(0) if arguments.images is None else recorded_pair(arguments.images)
    with threadpool_limits(1):
        calls = stages(left, right, arguments.landmarks, arguments.corners)
        times: dict[str, list[float]] = {name: [] for name in calls}
        for _ in range(arguments.repeats):
            for name, call in calls.items():
                began = time.process_time()
                call()
                times[name].append(time.process_time() - began)
    quantiles = {name: [1e3 * float(q) for q in np.quantile(t, QUANTILES)] for name, t in times.items()}
    table = Table(title=f"{WIDTH} x {HEIGHT}, one core, ms of processor time")
    table.add_column("stage")
    yardstick = next(iter(quantiles.values()))[0]
    for q in QUANTILES:
        table.add_column(f"{100 * q:.0f} %", justify="right")
    table.add_column("to yardstick", justify="right")
    for name, values in quantiles.items():
        table.add_row(name, *(f"{value:.2f}" for value in values), f"{values[0] / yardstick:.2f}")
    Console(width=100).print(table)
    if arguments.json:
        arguments.json.write_text(json.dumps({"quantiles": QUANTILES, "milliseconds": quantiles}, indent=2) + "\n")


if __name__ == "__main__":
    main()
