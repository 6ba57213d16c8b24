"""A short random drive past a cloud of points, with landmarks that enter, leave and are missed now and then."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from filters import Start, StereoCamera, StereoFilter, StereoNoise, StereoObservation, UpdateReport

CAMERA = StereoCamera(721.5, 721.5, 672.0, 195.5, 0.571, 1344, 391)
# Unequal focal lengths show a formula that takes the wrong one.
ODD_CAMERA = StereoCamera(700.0, 655.0, 600.0, 210.0, 0.4, 1280, 420)
INDEPENDENT_PIXELS = StereoNoise.independent_pixels(1.0)
INDEPENDENT_UVD = StereoNoise.diagonal(1.0, 1.0, 1.0)
DT = 0.1
SPEED = 5.0
START_COVARIANCE = np.diag(np.repeat([1e-3, 1e-3, 0.5, 0.05], 3) ** 2)


@dataclass(frozen=True)
class Frame:
    """What is true in one frame, and what the camera saw."""

    position: np.ndarray
    orientation: np.ndarray
    observation: StereoObservation


def drive(
    seed: int,
    frames: int = 15,
    *,
    visible: int = 15,
    noise: StereoNoise = INDEPENDENT_PIXELS,
    camera: StereoCamera = CAMERA,
    v_right: bool = False,
    missed: float = 0.1,
    noise_scale: float = 1.0,
    depths: tuple[float, float] = (6.0, 60.0),
) -> list[Frame]:
    """Drive ahead with a turn; a landmark that leaves the view or comes too near is replaced by a new one."""
    rng = np.random.default_rng(seed)
    position, heading = np.zeros(3), Rotation.identity()
    rate = rng.uniform(0.1, 0.4) * rng.choice([-1.0, 1.0])
    points: dict[int, np.ndarray] = {}
    made = []
    for frame in range(frames):
        if frame:
            position = position + heading.apply([0.0, 0.0, SPEED * DT])
            heading = heading * Rotation.from_rotvec([0.02 * np.sin(frame) * DT, rate * DT, 0.03 * np.cos(frame) * DT])
        points = {i: p for i, p in points.items() if _usable(camera, heading.inv().apply(p - position), depths)}
        first_new = 100 * frame
        for new in range(first_new, first_new + visible - len(points)):
            points[new] = position + heading.apply(_new_point(camera, rng, depths))
        ids = np.array([i for i in points if not frame or rng.uniform() > missed])
        exact = camera.project(heading.inv().apply(np.array([points[i] for i in ids]) - position))
        errors = noise_scale * rng.multivariate_normal(np.zeros(3), noise.R, len(ids))
        extra = exact[:, 1] + noise_scale * rng.standard_normal(len(ids)) if v_right else None
        observation = StereoObservation(ids, exact + errors, extra)
        made.append(Frame(position, heading.as_quat(), observation))
    return made


def start(stereo_filter: StereoFilter) -> StereoFilter:
    """Reset to the first frame of a `drive`."""
    stereo_filter.reset(Start(linear_velocity=(0.0, 0.0, SPEED), covariance=START_COVARIANCE))
    return stereo_filter


def run(stereo_filter: StereoFilter, frames: list[Frame]) -> Iterator[UpdateReport]:
    """Run a started filter over a drive, frame by frame."""
    for number, frame in enumerate(frames):
        if number:
            stereo_filter.predict(DT)
        yield stereo_filter.update(frame.observation)


def finish(stereo_filter: StereoFilter, frames: list[Frame]) -> StereoFilter:
    """Start a filter and run it over a whole drive."""
    for _ in run(start(stereo_filter), frames):
        pass
    return stereo_filter


def _usable(camera: StereoCamera, point_c: np.ndarray, depths: tuple[float, float]) -> bool:
    return bool(point_c[2] > 0.5 * depths[0] and camera.in_view(camera.project(point_c), margin=5.0))


def _new_point(camera: StereoCamera, rng: np.random.Generator, depths: tuple[float, float]) -> np.ndarray:
    uv = rng.uniform([0.2 * camera.width, 0.1 * camera.height], [0.95 * camera.width, 0.9 * camera.height])
    # Uniform in inverse depth: as many near points as far ones.
    disparity = camera.disparity_constant * rng.uniform(1 / depths[1], 1 / depths[0])
    return camera.backproject([*uv, disparity])
