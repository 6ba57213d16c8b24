"""Where the camera would be in the next steps, if the car keeps to its route and the head turns to some direction."""

from __future__ import annotations

import numpy as np

from filters import rotations
from filters.validation import FloatArray
from stereo_slam_env.policies.foresight import CameraPoses
from stereo_slam_env.recording.recording import Pose
from stereo_slam_env.world.routes import FRAME_PERIOD, Route
from stereo_slam_env.world.vehicle import Head, head_turn


def planned_bodies(body: Pose, route: Route, step: int, steps: int) -> CameraPoses:
    """Where the camera of a car that is at `body` now would be, looking straight ahead, after each step of its route.

    Speeds and yaw rates are the route's, from `step` on; after its end the car stands still.

    Parameters
    ----------
    body : Pose
        Now, after `step` steps, as it is believed to be.
    route : Route
        The nominal drive.
    step, steps : int
        Steps driven so far; steps to imagine, K.

    Returns
    -------
    CameraPoses
        (K, 3) and (K, 3, 3).
    """
    frames = np.minimum(step + np.arange(1, steps + 1), route.frames - 1)
    now = min(step, route.frames - 1)
    R_wb = rotations.matrix(body.orientation)
    heading = np.zeros((steps, 3))
    heading[:, 1] = route.headings[frames] - route.headings[now]
    R_bw_nominal = rotations.exp(np.array([0.0, -route.headings[now], 0.0]))
    moved = (route.positions[frames] - route.positions[now]) @ R_bw_nominal.T
    return CameraPoses(body.position + moved @ R_wb.T, R_wb @ rotations.exp(heading))


def turning_head(head: Head, angles: FloatArray, targets: FloatArray, steps: int) -> FloatArray:
    """Pan and tilt after each step of turning from `angles` (2,) to each of the targets (B, 2), rad; (B, K, 2)."""
    command = targets[:, None, :] / np.maximum(head.max_angles, np.finfo(float).tiny)
    times: FloatArray = FRAME_PERIOD * np.arange(1.0, steps + 1.0)
    return head.turned(angles, command, times[:, None])


def seen_from(head: Head, bodies: CameraPoses, angles: FloatArray) -> CameraPoses:
    """Cameras with the head turned to `angles` (..., K, 2), rad, on bodies (K,), see `Head.camera_pose`."""
    R_bc = rotations.matrix(head_turn(angles))
    middle = np.array([0.5 * head.baseline, 0.0, 0.0])
    shift = middle - R_bc @ middle
    return CameraPoses(bodies.positions + (bodies.R_wc @ shift[..., None])[..., 0], bodies.R_wc @ R_bc)
