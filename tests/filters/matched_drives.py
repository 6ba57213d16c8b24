"""Drives that are drawn from the filter's own model: start, accelerations and measurements of any sensor."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from filters import (
    ConstantVelocity,
    FisheyePair,
    MeasurementModel,
    RangeBearing,
    Start,
    StereoCamera,
    StereoEKF,
    StereoNoise,
    StereoObservation,
)
from stereo_slam_env.evaluation.bands import mean_band

from .drives import CAMERA, DT, run

RUNS = 60
LOW, HIGH = np.array(mean_band(6, RUNS)) / 6.0
"""Two-sided 95 % band of the mean pose NEES / 6 over the runs: about 0.86 to 1.15."""

JOINT = RangeBearing()
MOTION = ConstantVelocity(1.0, 0.2)
SIGMAS = np.repeat([1e-3, 1e-3, 0.5, 0.05], 3)
PIXELS = StereoNoise.independent_pixels(1.0)


@dataclass(frozen=True)
class Setup:
    """A sensor, its noise, and where its landmarks are: `draw` gives a point in the camera frame."""

    sensor: MeasurementModel = JOINT
    camera: StereoCamera = CAMERA
    noise: StereoNoise = PIXELS
    values: dict[str, np.ndarray] = field(default_factory=dict)
    frames: int = 12
    visible: int = 15

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        if isinstance(self.sensor, FisheyePair):  # all around, up to 100 degrees from the axis
            angle, around = np.sqrt(rng.uniform(0.0, 1.75**2)), rng.uniform(0.0, 2.0 * np.pi)
            direction = [np.sin(angle) * np.cos(around), np.sin(angle) * np.sin(around), np.cos(angle)]
            return rng.uniform(4.0, 20.0) * np.array(direction)
        u, v = rng.uniform(0.2, 0.9) * self.camera.width, rng.uniform(0.1, 0.9) * self.camera.height
        return self.camera.backproject([u, v, self.camera.disparity_constant * rng.uniform(1 / 40, 1 / 6)])

    def sees(self, point_c: np.ndarray) -> bool:
        if isinstance(self.sensor, FisheyePair):
            return np.linalg.norm(point_c) > 2.0 and np.arccos(point_c[2] / np.linalg.norm(point_c)) < 1.75
        return bool(point_c[2] > 3.0 and self.camera.in_view(self.camera.project(point_c), margin=5.0))


@dataclass(frozen=True)
class Frame:
    """What is true in one frame, and what the sensor measured."""

    position: np.ndarray
    rotation: Rotation
    observation: StereoObservation


def matched_drive(seed: int, setup: Setup) -> tuple[Start, list[Frame]]:
    """The start that the filter is told, and the frames of a drive that begins where that may be."""
    rng = np.random.default_rng(seed)
    told = Start(linear_velocity=(0.0, 0.0, 5.0), angular_velocity=(0.0, 0.2, 0.0), covariance=np.diag(SIGMAS**2))
    off = SIGMAS * rng.standard_normal(12)
    position, rotation = off[:3], Rotation.from_rotvec(off[3:6])
    velocity, rate = told.linear_velocity + off[6:9], told.angular_velocity + off[9:]
    points: dict[int, np.ndarray] = {}
    frames = []
    for number in range(setup.frames):
        if number:
            velocity = velocity + MOTION.sigma_acceleration * DT * rng.standard_normal(3)
            rate = rate + MOTION.sigma_angular_acceleration * DT * rng.standard_normal(3)
            position, rotation = position + velocity * DT, rotation * Rotation.from_rotvec(rate * DT)
        points = {i: p for i, p in points.items() if setup.sees(rotation.inv().apply(p - position))}
        for new in range(setup.visible - len(points)):
            points[100 * number + new] = position + rotation.apply(setup.draw(rng))
        ids = np.array(list(points))
        points_c = rotation.inv().apply(np.array(list(points.values())) - position)
        numbers = setup.sensor.predict(setup.camera, np.column_stack([points_c, np.ones(len(ids))]), setup.values)
        uvd = numbers[:, :3] + rng.multivariate_normal(np.zeros(3), setup.noise.R, len(ids))
        v_right = None
        if setup.sensor.size == 4:
            v_right = numbers[:, 3] + np.sqrt(setup.noise.R[1, 1]) * rng.standard_normal(len(ids))
        frames.append(Frame(position, rotation, StereoObservation(ids, uvd, v_right)))
    return told, frames


def finished(setup: Setup, seed: int, **options: Any) -> tuple[StereoEKF, Frame]:
    """A filter at the end of a drive of the setup, and the last frame."""
    start, frames = matched_drive(seed, setup)
    slam = StereoEKF(
        setup.camera,
        setup.noise,
        **{"measurement": setup.sensor, "motion": MOTION, "gate": None, "landmark": "shared-anchor", "error": "so3"}
        | options,
    )
    slam.reset(start)
    list(run(slam, frames))
    return slam, frames[-1]


def nees(slam: StereoEKF, frame: Frame) -> float:
    """Pose NEES / 6."""
    error, covariance = slam.pose_error(frame.position, frame.rotation.as_quat())
    return float(error @ np.linalg.solve(covariance, error)) / 6.0


def mean_nees(setup_of: Callable[[int], Setup], **options: Any) -> float:
    """Mean pose NEES / 6 at the end of `RUNS` drives, one for each seed."""
    return float(np.mean([nees(*finished(setup_of(seed), seed, **options)) for seed in range(RUNS)]))
