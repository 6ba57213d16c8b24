"""Inertial samples (Imu) and steps of an odometry (Odometry) from a bag, beside its pictures.

Where the unit, and the body of the odometry, are on the rig is asked of the static transforms (/tf_static), from their
frames to that of the left images. Noise is what the messages state.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from filters import BodyVelocity, InertialSamples, InertialUnit, Pose
from filters.contract.validation import first_line, plain
from filters.geometry import rotations
from filters.geometry.arrays import FloatArray
from stereo_slam_env.datasets.restated import TrueMotion, pose_at
from stereo_slam_env.datasets.written_frame import INERTIAL, STEPS
from stereo_slam_env.recording.archive import reference_of
from stereo_slam_env.recording.inertial import samples_of_steps
from stereo_slam_env.recording.recording import Reference
from stereo_slam_env.recording.trajectory import Trajectory
from stereo_slam_env.recording.trajectory_bags import BIAS as BESIDE
from stereo_slam_env.recording.trajectory_bags import stamp_of, transforms_of, vector_of
from stereo_slam_env.recording.trajectory_transforms import fixed_pose
from stereo_slam_env.sensing.imu import DATA_SHEETS

IMU, ODOMETRY = "sensor_msgs/msg/Imu", "nav_msgs/msg/Odometry"
ASSUMED = "bmi088"
"""Data sheet of what messages do not state: the walks of the biases, and densities where a covariance is zero."""


log = logging.getLogger(__name__)

_SAME = 1e-6
"""Of two times, s."""
_SAME_NOISE = 0.01
"""By how much densities and the variances of messages may differ that say the same: stamps are not all as far apart."""
_NUMBERS = "std_msgs/msg/Float64MultiArray"
TRUTH = "/ground_truth"
"""Topic of an odometry of true poses."""
BIAS, _BIAS_KIND = f"{TRUTH}/{BESIDE}", "geometry_msgs/msg/AccelStamped"
"""Topic of the true biases, gyros angular, accelerometers linear."""
NOISE = "noise"
"""Name of a topic beside that of a unit: densities of gyros and accelerometers, their walks, offset of its stamps."""
REFERENCE = f"{TRUTH}/reference"
"""Topic of a text in JSON: kind and origin of the true poses."""
_TEXT = "std_msgs/msg/String"


@dataclass(frozen=True, eq=False)
class Clock:
    """Times of the pairs of a bag."""

    origin: int
    """Stamp that times count from, ns."""
    seconds: FloatArray
    """(K,), s."""
    imu_shift: float | None
    """Stamps of the unit less those of the pairs, s; None: what is stated beside its samples, or 0."""


@dataclass(frozen=True, eq=False)
class BagMotion:
    """Inertial samples and odometry of a bag; either may be absent."""

    inertial: list[InertialSamples | None]
    """Of the step to each pair; empty without a unit."""
    odometry: Trajectory | None
    """Poses of the left camera by the odometry, on the clock of the pairs."""
    twists: FloatArray
    """(N, 6, 6): covariances of the camera's velocity at the poses of the odometry, linear before angular."""
    source: Mapping[str, Any]
    """Topics, and whose noise was assumed."""
    not_read: Mapping[str, str]
    """Topics of other units and odometries, and their kinds."""

    def step(self, begin: float, end: float) -> BodyVelocity | None:
        """The mean velocity of the camera between two times, s; None where the odometry does not cover them."""
        if self.odometry is None:
            return None
        before, after = pose_at(self.odometry, begin), pose_at(self.odometry, end)
        if before is None or after is None:
            return None
        moved, dt = before.inverse() @ after, end - begin
        turn, times = rotations.log(moved.R_wc), self.odometry.timestamps
        assert times is not None
        first, last = np.searchsorted(times, [begin + _SAME, end + _SAME])
        twists = self.twists[first:last] if last > first else self.twists
        linear = rotations.exp(-0.5 * turn) @ moved.position / dt
        return BodyVelocity(linear, turn / dt, np.median(twists, axis=0))


def motion_of_bag(
    reader: Any, path: Path, images: str, clock: Clock, R_left: FloatArray, imu: str | None, odometry: str | None
) -> BagMotion:
    """Read what there is.

    Parameters
    ----------
    reader : AnyReader
        The bag, open.
    path : Path
        Its name, for messages.
    images : str
        Topic of the left images.
    clock : Clock
        Times of the left images.
    R_left : (3, 3) ndarray
        From the left camera as it is mounted to the rectified one.
    imu, odometry : str, optional
        Topics. Without `imu` the only one that is linked with the camera is taken; no odometry is taken unasked, since
        it may come from the same pictures.

    Raises
    ------
    ValueError
        No such topic, a frame that no static transform links with the camera, or an odometry without a covariance.
    """
    kinds = {c.topic: c.msgtype for c in reader.connections}
    for topic, kind, option in ((imu, IMU, "imu"), (odometry, ODOMETRY, "odometry")):
        if topic is not None and kinds.get(topic) != kind:
            offered = ", ".join(plain(name) for name, one in sorted(kinds.items()) if one == kind) or "none"
            raise ValueError(f"{path} has no {kind} on {topic!r}: {option} must be one of its topics ({offered})")
    unread = {
        topic: INERTIAL if kind == IMU else STEPS
        for topic, kind in kinds.items()
        if kind in (IMU, ODOMETRY) and topic not in (imu, odometry, TRUTH)
    }
    units = [topic for topic, kind in kinds.items() if kind == IMU] if imu is None else [imu]
    mounting = _Mounting(reader, path, images, R_left) if units or odometry is not None else None
    inertial, source = list[InertialSamples | None](), dict[str, Any]()
    if mounting is not None and (imu is not None or len(units) == 1):
        inertial, source = _inertial(reader, mounting, units[0], clock, asked=imu is not None)
        if inertial:
            unread.pop(units[0], None)
    if mounting is None or odometry is None:
        return BagMotion(inertial, None, np.zeros((0, 6, 6)), source, unread)
    poses, twists = _odometry(reader, mounting, odometry, clock.origin)
    return BagMotion(inertial, poses, twists, {**source, "odometry": odometry}, unread)


@dataclass(frozen=True, eq=False)
class StatedTruth:
    """True poses, velocities and biases that a bag has on `TRUTH`, in a world with z up, at times since 1970."""

    trajectory: Trajectory
    motion: TrueMotion
    T_bc: Pose
    """Left camera, as it is mounted, in the body."""
    reference: Reference | None
    """Kind and origin of the poses, where the bag says it."""


def truth_of_bag(reader: Any, path: Path, images: str) -> StatedTruth | None:
    """Read the truth that a bag states; None without it, or where no transform links its body with the camera."""
    if TRUTH not in {c.topic for c in reader.connections if c.msgtype == ODOMETRY}:
        return None
    try:
        mounting = _Mounting(reader, path, images, np.eye(3))
        body, table, twists, _ = _odometry_rows(reader, TRUTH)
        T_bc = mounting.camera_in(body)
        trajectory = Trajectory(table[:, 1:4], table[:, 4:8], table[:, 0], gauge=None)
        linear = Rotation.from_quat(table[:, 4:8]).apply(twists[:, :3])
    except ValueError as error:
        log.warning("%s: no truth is taken from %s: %s", path, TRUTH, error)
        return None
    if not twists.any():  # zeros throughout fill a place
        linear = np.full_like(linear, np.nan)
    motion = TrueMotion(table[:, 0], linear, twists[:, 3:], _biases(reader, table[:, 0]))
    return StatedTruth(trajectory, motion, T_bc, _reference(reader, path))


def _reference(reader: Any, path: Path) -> Reference | None:
    for connection in (c for c in reader.connections if c.topic == REFERENCE and c.msgtype == _TEXT):
        for _, _, raw in reader.messages([connection]):
            try:
                return reference_of({"truth_from": json.loads(reader.deserialize(raw, _TEXT).data)})
            except (TypeError, ValueError, KeyError) as error:
                raise ValueError(f"{path}: {REFERENCE} is no reference ({first_line(error)}): leave it out") from error
    return None


def _biases(reader: Any, times: FloatArray) -> FloatArray | None:
    """True biases (K, 6) on `BIAS` at the times, s; None without, NaN where there is none."""
    if BIAS not in {c.topic for c in reader.connections if c.msgtype == _BIAS_KIND}:
        return None
    at, rows = {time: k for k, time in enumerate(times.tolist())}, np.full((len(times), 6), np.nan)
    for stamp, message in _messages(reader, BIAS):
        if (k := at.get(1e-9 * stamp)) is not None:
            rows[k] = *vector_of(message.accel.angular), *vector_of(message.accel.linear)
    return rows


class _Mounting:
    """Poses of the rectified left camera in the frames that static transforms link with it."""

    def __init__(self, reader: Any, path: Path, images: str, R_left: FloatArray) -> None:
        self.path, self._links = path, transforms_of(reader)
        self._camera = _first(reader, images).header.frame_id.strip("/")
        self._turn = Pose(np.zeros(3), rotations.from_matrix(R_left.T))

    def camera_in(self, frame: str) -> Pose:
        """T_fc of the rectified camera in a frame."""
        link = fixed_pose(self._links, frame.strip("/"), self._camera)
        if link is None:
            message = f"no static transform links {plain(frame)!r} with the camera's frame {plain(self._camera)!r}"
            raise ValueError(f"{self.path}: {message}: record /tf_static with it")
        return link @ self._turn


def _inertial(
    reader: Any, mounting: _Mounting, topic: str, clock: Clock, *, asked: bool
) -> tuple[list[InertialSamples | None], dict[str, Any]]:
    """Samples of the steps between `times`; nothing where the unit is not asked for and its place is not known."""
    messages = [(stamp, message) for stamp, message in _messages(reader, topic)]
    try:
        if len(messages) < 2:
            raise ValueError(f"{mounting.path}: {topic} has {len(messages)} messages: record it again")
        T_ci = mounting.camera_in(messages[0][1].header.frame_id).inverse()
    except ValueError as error:
        if asked:
            raise
        return [], {"imu": None, "imu_unused": str(error)}
    times = 1e-9 * np.array([stamp - clock.origin for stamp, _ in messages], dtype=np.float64)
    rows = np.array([[*vector_of(m.angular_velocity), *vector_of(m.linear_acceleration)] for _, m in messages])
    times, order = np.unique(times, return_index=True)
    stated = np.array(
        [[m.angular_velocity_covariance[::4], m.linear_acceleration_covariance[::4]] for _, m in messages]
    )
    sheet, variances = DATA_SHEETS[ASSUMED], np.median(stated, axis=0).mean(axis=1)
    step = float(np.median(np.diff(times)))
    has_variances = bool((variances > 0.0).all())
    gyro, accelerometer = sheet.gyro_density, sheet.accelerometer_density
    if has_variances:
        gyro, accelerometer = np.sqrt(variances * step).tolist()
    walks, assumed = (sheet.gyro_walk, sheet.accelerometer_walk), f"densities and walks of {ASSUMED}"
    stated_shift = 0.0
    if has_variances:
        assumed = f"walks of the biases of {ASSUMED}"
        noise = _noise_beside(reader, topic)
        if noise and np.allclose(noise[:2], [gyro, accelerometer], rtol=_SAME_NOISE):
            (gyro, accelerometer), walks, stated_shift, assumed = noise[:2], (noise[2], noise[3]), noise[4], "nothing"
    unit = InertialUnit(T_ci.position, T_ci.orientation, gyro, accelerometer, *walks)
    shift = stated_shift if clock.imu_shift is None else clock.imu_shift
    samples = samples_of_steps(mounting.path, times, rows[order], clock.seconds + shift, unit)
    return samples, {"imu": topic, "imu_assumed": assumed}


def _noise_beside(reader: Any, topic: str) -> list[float]:
    """Densities, walks and offset on the topic `noise` beside that of the samples, by `bag_writer`; empty without."""
    name = f"{topic.rpartition('/')[0]}/{NOISE}"
    for connection in (c for c in reader.connections if c.topic == name and c.msgtype == _NUMBERS):
        for _, _, raw in reader.messages([connection]):
            numbers = [float(number) for number in reader.deserialize(raw, _NUMBERS).data]
            if len(numbers) in (4, 5) and np.isfinite(numbers).all() and min(numbers[:4]) >= 0.0:
                return [*numbers, 0.0][:5]
    return []


def _odometry_rows(reader: Any, topic: str, origin: int = 0) -> tuple[str, FloatArray, FloatArray, FloatArray]:
    """Frame of the body, rows (K, 8), time since `origin` and pose, twists (K, 6) and their covariances, in order."""
    rows, twists, doubts, body = [], [], [], ""
    for stamp, message in _messages(reader, topic):
        p, q, twist = message.pose.pose.position, message.pose.pose.orientation, message.twist.twist
        rows.append([1e-9 * (stamp - origin), p.x, p.y, p.z, q.x, q.y, q.z, q.w])
        twists.append([*vector_of(twist.linear), *vector_of(twist.angular)])
        doubts.append(np.asarray(message.twist.covariance).reshape(6, 6))
        body = message.child_frame_id
    table = np.array(rows).reshape(-1, 8)
    order = np.unique(table[:, 0], return_index=True)[1]
    if len(order) < 2:
        raise ValueError(f"{topic} has {len(order)} messages: record it again")
    return body, table[order], np.array(twists)[order], np.array(doubts)[order]


def _odometry(reader: Any, mounting: _Mounting, topic: str, origin: int) -> tuple[Trajectory, FloatArray]:
    """Poses of the camera, and covariances of its velocity: those of the twists, carried from the body to it."""
    try:
        body, table, _, covariances = _odometry_rows(reader, topic, origin)
    except ValueError as error:
        raise ValueError(f"{mounting.path}: {error}") from error
    if not np.median(covariances, axis=0).any():
        said = f"{topic} states no covariance of its twist, so that nobody knows what it is worth"
        raise ValueError(f"{mounting.path}: {said}: have the driver state one, or leave it out")
    T_bc = mounting.camera_in(body)
    R_cb = T_bc.R_wc.T
    J = np.block([[R_cb, -R_cb @ rotations.skew(T_bc.position)], [np.zeros((3, 3)), R_cb]])
    twists = J @ covariances @ J.T
    poses = [Pose(row[1:4], row[4:8]) @ T_bc for row in table]
    trajectory = Trajectory(
        np.array([pose.position for pose in poses]),
        np.array([pose.orientation for pose in poses]),
        table[:, 0],
        gauge=None,
    )
    return trajectory, 0.5 * (twists + twists.swapaxes(1, 2))


def _messages(reader: Any, topic: str) -> Any:
    """Stamps, ns, and messages of a topic."""
    for connection, _, raw in reader.messages([c for c in reader.connections if c.topic == topic]):
        message = reader.deserialize(raw, connection.msgtype)
        yield stamp_of(message), message


def _first(reader: Any, topic: str) -> Any:
    return next(message for _, message in _messages(reader, topic))
