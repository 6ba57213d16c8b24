"""The head that carries both eyes: it pans and tilts on the roof of the car."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from filters import rotations
from filters.validation import FloatArray
from stereo_slam_env.recording.recording import Pose, Velocity


@dataclass(frozen=True)
class Head:
    """A pan-tilt head whose axes meet half-way between the eyes.

    R_wc = R_wb R_y(pan) R_x(tilt), where B is where the left camera is when the head looks straight ahead: positive
    pan looks right, positive tilt looks up.

    Attributes
    ----------
    baseline : float
        Distance of the eyes, m.
    max_angles : (2,) tuple
        Largest pan and tilt to either side, rad.
    max_rates : (2,) tuple
        Fastest pan and tilt, rad/s.
    """

    baseline: float
    max_angles: tuple[float, float]
    max_rates: tuple[float, float]

    def turned(self, angles: FloatArray, command: FloatArray, dt: float | FloatArray) -> FloatArray:
        """Angles after `dt` s of turning towards a command, as fast as the head can; arguments are broadcast.

        Parameters
        ----------
        angles : (2,)
            Pan and tilt now, rad.
        command : (2,)
            Wanted pan and tilt in -1..1 of their limits.
        dt : float
            s.
        """
        most = np.array(self.max_rates) * dt
        after: FloatArray = angles + np.clip(command * self.max_angles - angles, -most, most)
        return after

    def camera_pose(self, body: Pose, angles: FloatArray) -> Pose:
        """Pose of the left camera, from its pose when looking straight ahead and pan and tilt, rad."""
        turn = head_turn(angles)
        middle = np.array([0.5 * self.baseline, 0.0, 0.0])
        shift = middle - rotations.matrix(turn) @ middle
        return Pose(
            body.position + rotations.matrix(body.orientation) @ shift, rotations.multiply(body.orientation, turn)
        )

    def body_pose(self, camera: Pose, angles: FloatArray) -> Pose:
        """Inverse of `camera_pose`: where the left camera would be if the head looked straight ahead."""
        turn = head_turn(angles)
        orientation = rotations.multiply(camera.orientation, turn * np.array([-1.0, -1.0, -1.0, 1.0]))
        middle = np.array([0.5 * self.baseline, 0.0, 0.0])
        shift = middle - rotations.matrix(turn) @ middle
        return Pose(camera.position - rotations.matrix(orientation) @ shift, orientation)


def head_turn(angles: FloatArray) -> FloatArray:
    """Quaternion xyzw of R_y(pan) R_x(tilt); (..., 2) rad -> (..., 4)."""
    (sin_pan, sin_tilt), (cos_pan, cos_tilt) = np.sin(0.5 * angles.T), np.cos(0.5 * angles.T)
    return np.array([cos_pan * sin_tilt, sin_pan * cos_tilt, -sin_pan * sin_tilt, cos_pan * cos_tilt]).T


def velocity_between(before: Pose, after: Pose, dt: float) -> Velocity:
    """The constant velocity that leads from one pose to the other (Eq. 6)."""
    turn = rotations.matrix(before.orientation).T @ rotations.matrix(after.orientation)
    return Velocity((after.position - before.position) / dt, rotations.log(turn) / dt)
