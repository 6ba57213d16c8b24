"""Pictures of simulated drives: scenes, what the cameras and the front end see, and a filter on its way.

Each is the same whenever it is drawn, on one machine to the bit.
"""

from __future__ import annotations

from contextlib import closing
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

import stereo_slam_env as sse
from stereo_slam_env.benchmark.scenarios.streams import without_measurements
from stereo_slam_env.frontend import ActiveSearch
from stereo_slam_env.rendering.overlay import label
from stereo_slam_env.viewer import Drive, save_still, search_picture

Image = NDArray[np.uint8]
JPEG_QUALITY = 88
GAP = 4
"""Between pictures that stand together, px."""
SCENES: tuple[tuple[str, int, int, dict[str, Any]], ...] = (
    ("street, route town", 0, 12, {"route": "town"}),
    ("street, right-turn, moving_cars=8, pedestrians=8", 0, 25, {"moving_cars": 8, "pedestrians": 8}),
    ("field", 1, 5, {"route": "straight", "surroundings": "field"}),
    ("corridor", 0, 22, {"surroundings": "corridor"}),
    ("street, route loop", 0, 8, {"route": "loop"}),
    ("groves", 0, 26, {"surroundings": "groves"}),
    ("street, randomise=True, seed 1", 1, 5, {"route": "straight", "randomise": True}),
    ("street, randomise=True, seed 6", 6, 5, {"route": "straight", "randomise": True}),
)
"""What is shown: words, seed, frame, and arguments of the environment."""
BLANK_FROM = 8.0


def scenes(path: Path) -> None:
    """Eight kinds of scene, as the left camera sees them."""
    views = []
    for words, seed, frame, arguments in SCENES:
        (left,) = left_views({"route": "right-turn", "supersample": 2, "renderer": "gl", **arguments}, seed, [frame])
        half = cv2.resize(left, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        label(half, words)
        views.append(half)
    rows = [beside(*pair) for pair in zip(views[::2], views[1::2], strict=True)]
    save_picture(path, above(*rows))


def groves(path: Path) -> None:
    """A bend between groups of things, on a clear day and in fog."""
    drive = {"route": "right-turn", "surroundings": "groves", "renderer": "gl", "supersample": 2}
    views = [left_views(drive | air, 0, [26])[0] for air in ({}, {"visibility": 30.0})]
    views = [cv2.resize(view, None, fx=0.7, fy=0.7, interpolation=cv2.INTER_AREA)[70:] for view in views]
    save_picture(path, above(*views))


def blank(path: Path) -> None:
    """A street and a corridor that lose their texture."""
    frames = [round(10 * time) for time in (BLANK_FROM - 0.1, BLANK_FROM, BLANK_FROM + 2.0)]
    drive = {"route": "loop", "rig": "qvga", "sensor": "images", "randomise": True, "blank_from": BLANK_FROM}
    rows = [left_views({**drive, "surroundings": name}, 0, frames) for name in ("street", "corridor")]
    save_picture(path, np.concatenate([np.concatenate(row, axis=1) for row in rows]))


def gaze(path: Path) -> None:
    """Both views of the gaze task with the head turned to the right."""
    with closing(gym.make("StereoSlam/Gaze-v0", renderer="gl", render_mode="rgb_array")) as env:
        env.reset(seed=0)
        for _ in range(40):
            env.step(np.array([0.5, 0.0], dtype=np.float32))
        picture = env.render()
    assert isinstance(picture, np.ndarray)
    save_picture(path, picture)


def search(path: Path) -> None:
    """The active search of a filter between vans and lorries."""
    traffic = {"route": "right-turn", "renderer": "gl", "moving_cars": 12, "pedestrians": 6}
    drive, frame = sse.RenderedDrive(traffic, seed=3, frames=38), 37
    pictures: list[Image] = []

    def watch(pair: Any, tracked: Any) -> None:
        caption = ("right-turn, seed 3, gl", f"pair {frame}", f"t = {pair.timestamp:.1f} s")
        pictures[:] = [search_picture(pair.left, pair.right, tracked, caption)]

    looks = ActiveSearch(drive, watch=watch)
    blind = without_measurements(sse.record("StereoSlam/Drive-v0", seed=3, policy="route", frames=38, **traffic))
    for _ in islice(sse.run("inverse-depth", blind, gate=0.99, observe=looks.observe), frame + 1):
        pass
    save_picture(path, pictures[0])


def view(path: Path) -> None:
    """A filter on a turn, in one picture."""
    save_still(Drive.of(sse.make_recording("turn", 0), "inverse-depth", title="inverse-depth: turn, seed 0"), path, 38)


def left_views(arguments: dict[str, Any], seed: int, frames: list[int]) -> list[Image]:
    """Left images (H, W, 3) of a scripted drive at some frames, ascending."""
    with closing(gym.make("StereoSlam/Drive-v0", policy="route", render_images=True, **arguments)) as env:
        observation, _ = env.reset(seed=seed)
        views = []
        for k in range(frames[-1] + 1):
            if k:
                observation, *_ = env.step(np.zeros(2, dtype=np.float32))
            if k in frames:
                views.append(observation["left"].copy())
    return views


def beside(left: Image, right: Image) -> Image:
    """Two pictures of one height with a gap between them."""
    return np.concatenate([left, np.full((len(left), GAP, 3), 255, dtype=np.uint8), right], axis=1)


def above(*pictures: Image) -> Image:
    """Pictures of one width, the first one on top, with gaps between them."""
    gap = np.full((GAP, pictures[0].shape[1], 3), 255, dtype=np.uint8)
    return np.concatenate([pictures[0], *(part for picture in pictures[1:] for part in (gap, picture))])


def save_picture(path: Path, picture: Image) -> None:
    """Write an RGB picture as its ending says."""
    quality = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY] if path.suffix == ".jpg" else []
    if not cv2.imwrite(str(path), picture[..., ::-1], quality):
        raise OSError(f"{path} cannot be written")
