"""Covariances of a trajectory in the conventions of ROS: 36 numbers for poses and twists, and settings of an EKF.

The 36 numbers of `PoseWithCovariance` and `TwistWithCovariance` are row-major, in the order x, y, z, rotation about X,
Y, Z. Those of a pose are about the fixed axes of `header.frame_id`, those of a twist in the axes of `child_frame_id`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from filters.geometry import rotations
from filters.geometry.arrays import FloatArray
from filters.motions.motion_model import POSE_SIZE, POSITION
from stereo_slam_env.evaluation.windows import motion_covariances, motions
from stereo_slam_env.files.folders import write_text
from stereo_slam_env.recording.recording import adjoints, distances
from stereo_slam_env.recording.trajectory import Trajectory, transformed
from stereo_slam_env.recording.trajectory_transforms import OPTICAL_TO_BASE, in_fixed_axes

GROWTH_SECONDS = (1.0, 10.0, 100.0)
"""Times after the start at which the covariance of the pose is stated, beside the end, s."""
_USUAL = 0.1
"""Steps whose length in time is within this share of the median count for the twist."""
_FORWARD = 0.8
"""Mean share of a step along an axis of the body from which the body is taken to drive along it."""


@dataclass(frozen=True, eq=False)
class RosCovariances:
    """Covariances that ROS messages of a trajectory should have."""

    name: str
    """Of the estimate."""
    times: FloatArray
    """(K,), s, from the first pose on."""
    distances: FloatArray
    """(K,), m, driven from the first pose on."""
    poses: FloatArray
    """(K, 6, 6): `pose.covariance` of each message; zero at the first one."""
    twist: FloatArray
    """(6, 6): `twist.covariance`, the mean over the steps of the usual length."""
    step: float
    """Usual length of a step, s."""
    integrated: float
    """Standard deviation of the last position, m, that follows from these twists with independent errors."""
    drives_along_z: bool
    """Whether the body drives along its z axis, as the optical frame of a camera does."""

    @property
    def growth(self) -> list[int]:
        """Rows at `GROWTH_SECONDS`, as far as the drive lasts, and the last one."""
        rows = [int(np.argmin(np.abs(self.times - seconds))) for seconds in GROWTH_SECONDS if seconds < self.times[-1]]
        return [*rows, len(self.times) - 1]


def ros_covariances(claimed: Trajectory, *, optical: bool = False) -> RosCovariances:
    """Covariances in the conventions of ROS of a trajectory that has times and covariances, as of `claim`.

    Parameters
    ----------
    claimed : Trajectory
        Its world is `header.frame_id`, its body `child_frame_id`.
    optical : bool
        Whether body and world are those of a camera (x right, y down, z forward): both are turned to x forward, y left,
        z up.

    Raises
    ------
    ValueError
        No times, no covariances, or a single pose.
    """
    covariances = claimed.pose_covariances
    if claimed.timestamps is None or covariances is None or len(claimed) < 2:
        raise ValueError(f"{claimed.name} needs times, covariances and two poses: use `claim` on a trajectory of TUM")
    times, rows = claimed.timestamps - claimed.timestamps[0], np.arange(len(claimed))
    steps = motion_covariances(claimed, rows[:-1], rows[1:])
    if steps is None:
        raise ValueError(f"{claimed.name} claims no covariance of its motions: use `claim`")
    dt = np.diff(times)
    usual = np.abs(dt - np.median(dt)) <= _USUAL * np.median(dt)
    turn = np.kron(np.eye(2), OPTICAL_TO_BASE if optical else np.eye(3))
    driven = distances(claimed.positions)
    moved, turns = motions(claimed, rows[:-1], rows[1:])
    before = in_fixed_axes(turns, steps)  # the rotation about the axes of the body before the step
    into_before = np.tile(np.eye(POSE_SIZE), (len(turns), 1, 1))
    into_before[:, POSITION, POSITION] = rotations.matrix(turns)
    velocities = transformed(into_before, before)[usual] / dt[usual, None, None] ** 2
    return RosCovariances(
        claimed.name,
        times,
        np.cumsum(driven),
        transformed(turn, in_fixed_axes(claimed.orientations, covariances)),
        transformed(turn, velocities.mean(axis=0)),
        float(np.median(dt)),
        _integrated(claimed, steps),
        bool(moved[:, 2].sum() > _FORWARD * driven.sum()),
    )


def _integrated(claimed: Trajectory, steps: FloatArray) -> float:
    """Standard deviation of the last position, m, by steps with independent errors of covariances (K - 1, 6, 6)."""
    A = adjoints(claimed.positions - claimed.positions[-1], claimed.orientations)[1:]
    P = (A @ steps @ A.swapaxes(1, 2)).sum(axis=0)
    return float(np.sqrt(np.trace(P[POSITION, POSITION])))


def write_ros_yaml(path: Path, covariances: RosCovariances) -> None:
    """Write the numbers, a fragment for `robot_localization`, and how to publish them, as YAML with comments."""
    poses = "".join(
        f"  - {{seconds: {covariances.times[row]:.6g}, metres: {covariances.distances[row]:.6g},\n"
        f"     covariance: {_numbers(covariances.poses[row], 18)}}}\n"
        for row in covariances.growth
    )
    claimed = float(np.sqrt(np.trace(covariances.poses[-1, POSITION, POSITION])))
    twist = f"  seconds: {covariances.step:.6g}\n  covariance: {_numbers(covariances.twist, 15)}\n"
    write_text(
        path,
        _TEXT.format(
            name=covariances.name.replace("\n", " "),
            poses=poses,
            twist=twist,
            seconds=f"{covariances.times[-1]:.3g}",
            claimed=f"{claimed:.3g}",
            integrated=f"{covariances.integrated:.3g}",
        ),
    )


def _numbers(matrix: FloatArray, indent: int) -> str:
    """The 36 numbers, six a line; all digits, and a point, without which YAML 1.1 reads a text."""
    lines = [", ".join(np.format_float_scientific(value, trim="0") for value in row) for row in matrix]
    return "[" + (",\n" + " " * indent).join(lines) + "]"


_TEXT = """\
# Covariances of {name} by `stereo-slam claim --ros`, learned by `stereo-slam calibrate`: m, rad, s.
# 36 numbers, row by row: x, y, z, rotation about X, Y, Z.

# PoseWithCovariance: position, and rotation about the FIXED axes, of header.frame_id (the world of the trajectory), as
# seen from the first pose, which is known. It grows: these are examples. The .square file has that of every pose, and
# in Python ros_covariances(claim(trajectory, model)).poses is this list for each message.
pose_covariance:
{poses}
# TwistWithCovariance: in the axes of child_frame_id (the body of the trajectory) before the step, of a velocity that is
# the motion over the step divided by its time: covariance of the motion / seconds^2. Another rate needs another one.
twist_covariance:
{twist}
# A fragment for robot_localization: copy the node below into a file of its own.
# - Twist, no pose. A visual odometry drifts: its pose is no absolute measurement, and its errors from message to
#   message are nearly the same, which an EKF takes for independent.
# - No odom0_differential: it takes the covariance of the difference of two poses to be (P_before + P_now) * dt, as if
#   their errors were independent. P grows all the time, so the drive would count ever less.
# - No odom0_relative: it sets the first pose to zero and goes on as with an absolute pose.
# - No acceleration: an odometry measures none.
# After {seconds} s the model claims {claimed} m of position; such twists with independent errors make {integrated} m.
# If these differ much, multiply twist_covariance by the square of the first over the second.
ekf_filter_node:
  ros__parameters:
    frequency: 30.0
    odom_frame: odom
    base_link_frame: base_link
    world_frame: odom
    odom0: /visual_odometry
    odom0_config: [false, false, false,   # x, y, z
                   false, false, false,   # roll, pitch, yaw
                   true, true, true,      # their velocities, of child_frame_id
                   true, true, true,
                   false, false, false]   # accelerations
    odom0_differential: false
    odom0_relative: false
    odom0_queue_size: 10

# To publish them (rclpy), with `found` this file as read by yaml.safe_load:
#   message = nav_msgs.msg.Odometry()
#   message.header.stamp, message.header.frame_id, message.child_frame_id = stamp, "odom", "base_link"
#   message.pose.covariance = pose_covariances[k].ravel().tolist()       # of this pose; all zero means "not known"
#   message.twist.twist.linear.x, ... = R_wb_before.T @ (p_now - p_before) / dt
#   message.twist.covariance = found["twist_covariance"]["covariance"]
#   publisher.publish(message)
"""
