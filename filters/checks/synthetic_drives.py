"""Simulated drives for `check_filter`, with the camera and the noise that the filter is handed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from filters.contract.inputs import BodyVelocity, InertialSamples, InertialUnit, Start, StereoObservation
from filters.contract.noise import StereoNoise
from filters.contract.stereo_filter import StereoFilter
from filters.geometry import rotations
from filters.geometry.arrays import FloatArray, IntArray
from filters.geometry.camera import StereoCamera

DT = 0.1
SPEED = 5.0
FRAMES = 100
VISIBLE = 15
NEAREST, FARTHEST = 4.0, 45.0
ODOMETRY_SIGMAS = np.repeat([0.1, 0.01], 3)
"""Of the odometry that a filter is given if it asks for some: m/s, then rad/s."""
UNIT = InertialUnit(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), 2e-4, 2e-3, 2e-5, 3e-3)
"""Whose samples a filter is given if it asks for some: at the left camera and turned as that, gravity along y."""
_SAMPLES, _GRAVITY = 20, np.array([0.0, 9.81, 0.0])
_HEADING, _HEADING_PERIOD = 0.5, 8.0
_SPEED_CHANGE, _SPEED_PERIOD = 1.5, 6.0


START_COVARIANCE = np.diag(np.repeat([1e-6, 1e-6, 0.5, 0.05], 3) ** 2)
START = Start(linear_velocity=np.array([0.0, 0.0, SPEED]), covariance=START_COVARIANCE)
"""Start of the drives: at the origin of W, looking along z."""


def predict_step(
    stereo_filter: StereoFilter, dt: float, odometry: BodyVelocity, inertial: InertialSamples | None
) -> None:
    """Predict a step, with odometry or inertial samples only if the filter refuses to go without."""
    refusals = []
    for inputs in ({}, {"odometry": odometry}, {"inertial": inertial}):
        try:
            stereo_filter.predict(dt, **inputs)
        except ValueError as error:
            refusals.append(error)
        else:
            return
    raise refusals[0]


@dataclass(frozen=True, eq=False)
class StraightDrive:
    """Straight ahead at `SPEED` past points spread over the view; measurements with the noise that a filter is told."""

    camera: StereoCamera
    noise: StereoNoise
    points_c: FloatArray
    """(N, 3), m: in the camera frame at the start."""
    seed: int
    start: Start
    steps: Sequence[float]
    """Seconds from frame to frame, again and again."""

    @classmethod
    def simulated(
        cls,
        camera: StereoCamera,
        noise: StereoNoise,
        seed: int = 0,
        start: Start = START,
        steps: Sequence[float] = (DT,),
    ) -> StraightDrive:
        """The drive of that seed for this rig, past 30 points."""
        rng = np.random.default_rng(seed)
        u = rng.uniform(0.3, 0.7, 30) * camera.width
        v = rng.uniform(0.3, 0.7, 30) * camera.height
        depth = rng.uniform(15.0, 60.0, 30)
        uvd = np.stack([u, v, camera.disparity_constant / depth], axis=1)
        return cls(camera, noise, camera.backproject(uvd), seed, start, steps)

    @property
    def orientation(self) -> FloatArray:
        """True q^WC, all the way."""
        return self.start.orientation

    @cached_property
    def R_wc(self) -> FloatArray:
        """Rotation matrix R_wc of the camera."""
        return rotations.matrix(self.orientation)

    @property
    def points(self) -> FloatArray:
        """(N, 3), m, in W."""
        points_w: FloatArray = self.start.position + self.points_c @ self.R_wc.T
        return points_w

    def step(self, frame: int) -> float:
        """Seconds from the frame before."""
        return self.steps[(frame - 1) % len(self.steps)]

    def driven(self, frame: int) -> FloatArray:
        """Way from the start in the camera frame, m."""
        return np.array([0.0, 0.0, SPEED * math.fsum(self.step(k) for k in range(1, frame + 1))])

    def position(self, frame: int) -> FloatArray:
        """True position r^WC of the camera, m."""
        position: FloatArray = self.start.position + self.R_wc @ self.driven(frame)
        return position

    def predict(self, stereo_filter: StereoFilter, frame: int, scale: float = 1.0) -> None:
        """Predict the step to the frame, see `predict_step`; with errors of `scale` times the noise."""
        dt = self.step(frame)
        rng, of_unit = (np.random.default_rng([self.seed, frame, which]) for which in (1, 2))
        odometry = _odometry(np.array([0.0, 0.0, SPEED]), np.zeros(3), scale * rng.standard_normal(6))
        forces = np.tile(-_GRAVITY @ self.R_wc, (_SAMPLES, 1))
        predict_step(stereo_filter, dt, odometry, _samples(np.zeros((_SAMPLES, 3)), forces, of_unit, scale, dt))

    def observe(self, frame: int, scale: float = 1.0) -> StereoObservation:
        """All points, with errors of `scale` times the noise."""
        rng = np.random.default_rng([self.seed, frame])
        errors = rng.multivariate_normal(np.zeros(3), self.noise.R, len(self.points_c))
        uvd = self.camera.project(self.points_c - self.driven(frame)) + scale * errors
        return StereoObservation(np.arange(len(self.points_c)), uvd)


@dataclass(frozen=True, eq=False)
class WindingFrame:
    """True pose of the camera (r^WC in m, q^WC), its measurements, odometry and inertial samples of the step to it."""

    position: FloatArray
    orientation: FloatArray
    observation: StereoObservation
    odometry: BodyVelocity
    inertial: InertialSamples


@dataclass(frozen=True, eq=False)
class WindingDrive:
    """Ten seconds along a winding road with changing speed; landmarks enter, pass by and leave.

    Accelerations stay within the standard deviations of `ConstantVelocity()`. A landmark that leaves the view is
    replaced by a new one, so that each frame has `VISIBLE`.
    """

    linear_velocity: FloatArray
    """(3,), m/s in W: the true one at the start."""
    angular_velocity: FloatArray
    """(3,), rad/s in the camera frame: the true one at the start."""
    frames: tuple[WindingFrame, ...]
    """Every `DT` seconds."""

    @classmethod
    def simulated(cls, camera: StereoCamera, noise: StereoNoise, seed: int) -> WindingDrive:
        """The drive of that seed for this rig."""
        rng = np.random.default_rng([seed, FRAMES])
        times = DT * np.arange(FRAMES)
        headings = _heading(times)
        speeds = SPEED + _SPEED_CHANGE * np.sin(2.0 * np.pi * times / _SPEED_PERIOD)
        steps = DT * speeds[:, None] * np.stack([np.sin(headings), np.zeros(FRAMES), np.cos(headings)], axis=1)
        positions = np.cumsum(steps, axis=0) - steps
        root = np.linalg.cholesky(noise.R)
        ids: IntArray = np.zeros(0, dtype=np.int64)
        points, frames = np.zeros((0, 3)), []
        entered = 0
        of_odometry, of_unit = (np.random.default_rng([seed, FRAMES, which]) for which in (1, 2))
        path = CubicSpline(times, positions)
        for number, (position, heading) in enumerate(zip(positions, headings, strict=True)):
            orientation = rotations.exp_quaternion(np.array([0.0, heading, 0.0]))
            R_wc = rotations.matrix(orientation)
            points_c = (points - position) @ R_wc
            stays = points_c[:, 2] > NEAREST
            stays[stays] = camera.in_view(camera.project(points_c[stays]))
            missing = VISIBLE - int(stays.sum())
            new_w = _points_in_view(camera, rng, missing) @ R_wc.T + position
            points = np.vstack([points[stays], new_w])
            ids = np.concatenate([ids[stays], np.arange(entered, entered + missing)])
            entered += missing
            exact = camera.project((points - position) @ R_wc)
            uvd = exact + rng.standard_normal(exact.shape) @ root.T
            before = max(number - 1, 0)
            turn = heading - headings[before]
            R_mid = rotations.matrix(rotations.exp_quaternion(np.array([0.0, heading - 0.5 * turn, 0.0])))
            linear, angular = (position - positions[before]) @ R_mid / DT, np.array([0.0, turn / DT, 0.0])
            odometry = _odometry(linear, angular, of_odometry.standard_normal(6))
            ends = times[before] + DT / _SAMPLES * np.arange(_SAMPLES + 1)
            middles = 0.5 * (ends[1:] + ends[:-1])
            forces = np.diff(path(ends, 1), axis=0) * _SAMPLES / DT - _GRAVITY
            along = rotations.exp_quaternion(np.outer(_heading(middles), [0.0, 1.0, 0.0]))
            forces = np.einsum("kij,ki->kj", rotations.matrix(along), forces)
            rates = np.outer(np.diff(_heading(ends)) * _SAMPLES / DT, [0.0, 1.0, 0.0])
            inertial = _samples(rates, forces, of_unit, 1.0)
            frames.append(WindingFrame(position, orientation, StereoObservation(ids, uvd), odometry, inertial))
        turning = np.array([0.0, 2.0 * np.pi * _HEADING / _HEADING_PERIOD, 0.0])
        return cls(np.array([0.0, 0.0, SPEED]), turning, tuple(frames))


def _heading(times: ArrayLike) -> FloatArray:
    """Heading of the winding road at these times, rad."""
    headings: FloatArray = _HEADING * np.sin(2.0 * np.pi * np.asarray(times) / _HEADING_PERIOD)
    return headings


def _samples(
    rates: FloatArray, forces: FloatArray, rng: np.random.Generator, scale: float, dt: float = DT
) -> InertialSamples:
    """Samples of a step in equal times, with errors of `scale` times the noise of `UNIT`."""
    densities = np.repeat([UNIT.gyro_density, UNIT.accelerometer_density], 3)
    errors = scale * densities / np.sqrt(dt / _SAMPLES) * rng.standard_normal((_SAMPLES, 6))
    times: FloatArray = dt / _SAMPLES * np.arange(1.0, _SAMPLES + 1.0)
    return InertialSamples(times, rates + errors[:, :3], forces + errors[:, 3:], UNIT)


def _odometry(linear: FloatArray, angular: FloatArray, errors: FloatArray) -> BodyVelocity:
    """Odometry of these velocities, in the camera frame, with errors in standard deviations."""
    measured = np.concatenate([linear, angular]) + ODOMETRY_SIGMAS * errors
    return BodyVelocity(measured[:3], measured[3:], np.diag(ODOMETRY_SIGMAS**2))


def _points_in_view(camera: StereoCamera, rng: np.random.Generator, count: int) -> FloatArray:
    """New landmarks in the camera frame; (count, 3) m."""
    u, v = rng.uniform(0.05, 0.95, (2, count))
    depth = rng.uniform(2.0 * NEAREST, FARTHEST, count)
    return camera.backproject(
        np.stack([u * camera.width, v * camera.height, camera.disparity_constant / depth], axis=1)
    )
