"""A pair as it is written for other programs: its stamp, true poses in a world with z up, inertial rows, odometry."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from filters import BodyVelocity, Pose
from filters.geometry import rotations
from filters.geometry.arrays import FloatArray
from stereo_slam_env.recording.inertial import InertialRows
from stereo_slam_env.recording.recording import StereoPair
from stereo_slam_env.sensing.sensor_suite import SensorSuite

INERTIAL, STEPS, POSES, STATES = "inertial samples", "odometry", "true poses", "true velocities and biases"
KINDS = frozenset({INERTIAL, STEPS, POSES, STATES})
"""Data that a recording may have beside images."""


@dataclass(frozen=True, eq=False)
class WrittenFrame:
    """A pair and what came since the one before it, in the frames of `SensorSuite`."""

    number: int
    """From 0."""
    stamp: int
    """ns since 1970."""
    pair: StereoPair
    """Images and what was measured, in W and C0."""
    rows: list[tuple[int, FloatArray]]
    """Stamps, ns, of the clock of the unit, angular rates and specific forces (6,) that are known by now."""
    suite: SensorSuite
    """Places of the sensors."""
    dt: float
    """Time since the frame before, s."""
    driven: Pose
    """Pose of C0 in where it was at first, by odometry alone."""

    @property
    def T_uc(self) -> Pose | None:
        """True pose of C0 in U; None where it is not known."""
        return None if self.pair.truth is None else self.suite.T_uw @ self.pair.truth

    @property
    def T_ub(self) -> Pose | None:
        """True pose of B in U; None where it is not known."""
        return None if (T_uc := self.T_uc) is None else T_uc @ self.suite.T_bc.inverse()

    @property
    def velocity_u(self) -> FloatArray | None:
        """True velocity (3,) of B in U, m/s; None where it is not known."""
        pair, p_cb = self.pair, self.suite.T_bc.inverse().position
        if pair.velocity is None or pair.truth is None:
            return None
        v_w = pair.velocity.linear + pair.truth.R_wc @ np.cross(pair.velocity.angular, p_cb)
        return np.asarray(self.suite.T_uw.R_wc @ v_w)


def frames_of(pairs: Iterable[StereoPair], suite: SensorSuite, epoch: int) -> Iterator[WrittenFrame]:
    """The pairs, whose times count from `epoch`, ns; a row whose period a frame cuts comes with the next one."""
    rows, driven, before, shift = InertialRows(), Pose(), epoch, round(1e9 * suite.time_offset)
    frame: WrittenFrame | None = None
    for number, pair in enumerate(pairs):
        if frame is not None:
            yield frame
        stamp = epoch + round(1e9 * pair.timestamp)
        dt = 1e-9 * (stamp - before)
        if pair.odometry is not None:
            driven = driven @ step_of(pair.odometry, dt)
        come = rows.of_step(before, pair.inertial) if number else []
        frame = WrittenFrame(number, stamp, pair, [(t + shift, values) for t, values in come], suite, dt, driven)
        before = stamp
    if frame is not None:
        yield replace(frame, rows=[*frame.rows, *((t + shift, values) for t, values in rows.rest())])


def step_of(odometry: BodyVelocity, dt: float) -> Pose:
    """Motion over `dt` seconds at a mean body velocity, whose linear part is in the attitude half way."""
    turn = dt * odometry.angular
    return Pose(rotations.exp(0.5 * turn) @ (dt * odometry.linear), rotations.exp_quaternion(turn))


def seconds(stamp: int) -> str:
    """Stamp in s, to the ns."""
    return f"{stamp // 10**9}.{stamp % 10**9:09d}"


def numbers(values: Iterable[float], separator: str = " ") -> str:
    """Numbers with all their digits."""
    return separator.join(repr(float(value)) for value in values)


class TrueTrajectories:
    """True poses of B and of C0 in U as TUM files, frame by frame; no file without poses."""

    FILES = ("truth_body.tum", "truth_left_camera.tum")

    def __init__(self, folder: Path) -> None:
        self._stack = ExitStack()
        self._paths = [folder / name for name in self.FILES]
        self._files = [self._stack.enter_context(path.open("w")) for path in self._paths]

    def write(self, frame: WrittenFrame) -> None:
        """Write the poses of a frame."""
        for file, pose in zip(self._files, (frame.T_ub, frame.T_uc), strict=True):
            if pose is not None:
                file.write(f"{seconds(frame.stamp)} {numbers([*pose.position, *pose.orientation])}\n")

    def close(self) -> None:
        """Close the files; remove them where there was no pose."""
        self._stack.close()
        for path in self._paths:
            if path.stat().st_size == 0:
                path.unlink()
