"""States in general position, the same states in a turned world, and what lies between two states."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from filters import BodyVelocity, StereoEKF
from filters.motions.motion_model import ANGULAR, CAMERA_SIZE, LINEAR, POSITION, ROTATION, CameraState
from filters.state.joint_state import JointState

from ..drives import DT, Frame, drive
from ..engine.beliefs import make, tilted


def odometry(before: Frame, after: Frame, rng: np.random.Generator, sigma: float = 0.05) -> BodyVelocity:
    """Velocity of a step with an error of `sigma`, m/s and rad/s."""
    start, end = Rotation.from_quat(before.orientation), Rotation.from_quat(after.orientation)
    turn = (start.inv() * end).as_rotvec()
    half_way = start * Rotation.from_rotvec(0.5 * turn)
    velocity = np.concatenate([half_way.inv().apply(after.position - before.position), turn]) / DT
    velocity += sigma * rng.standard_normal(6)
    return BodyVelocity(velocity[:3], velocity[3:], sigma**2 * np.eye(6))


def driven(frames: list[Frame], **options) -> StereoEKF:
    """A filter after a drive with noisy odometry."""
    stereo_filter = make(**{"drop_unseen": False, **options})
    rng = np.random.default_rng(0)
    for k, frame in enumerate(frames):
        if k:
            stereo_filter.predict(DT, odometry(frames[k - 1], frame, rng))
        stereo_filter.update(frame.observation)
    return stereo_filter


def some_state(landmark: str) -> JointState:
    """A map of several frames seen from a pose in general position, with a dense covariance."""
    stereo_filter = tilted(make(landmark=landmark, drop_unseen=False))
    for k, frame in enumerate(drive(1, 5, visible=4, depths=(6.0, 30.0))):
        if k:
            stereo_filter.predict(DT)
        stereo_filter.update(frame.observation)
    state = stereo_filter.state
    root = np.random.default_rng(2).standard_normal(state.P.shape)
    return replace(state, P=np.asfortranarray(np.tril(root @ root.T)))


def turned_world(state: JointState, turn: Rotation) -> JointState:
    """Camera and map, rotated about the origin of W."""
    camera = state.camera
    moved = CameraState(
        turn.apply(camera.position),
        (turn * Rotation.from_quat(camera.orientation)).as_quat(),
        turn.apply(camera.linear_velocity),
        camera.angular_velocity,
    )
    blocks = state.blocks.copy()
    blocks[:, :3] = turn.apply(blocks[:, :3])
    blocks[state.parameter_block] = state.model.rotated(state.anchors(), state.parameters(), turn.as_matrix())
    return replace(state, camera=moved, blocks=blocks)


def standard_error(state: JointState, other: JointState) -> np.ndarray:
    """The error in standard coordinates that leads from `state` to `other`; (n,)."""
    start, end = Rotation.from_quat(state.camera.orientation), Rotation.from_quat(other.camera.orientation)
    error = np.zeros(len(state.P))
    error[POSITION] = other.camera.position - state.camera.position
    error[ROTATION] = (start.inv() * end).as_rotvec()
    error[LINEAR] = other.camera.linear_velocity - state.camera.linear_velocity
    error[ANGULAR] = other.camera.angular_velocity - state.camera.angular_velocity
    blocks = (other.blocks - state.blocks)[:, :3]
    own = state.model.local(state.parameters(), other.parameters())
    if state.model.anchored:  # azimuth, if it is the first number, is an angle
        own[:, 0] = np.arctan2(np.sin(own[:, 0]), np.cos(own[:, 0]))
    blocks[state.parameter_block] = own
    error[CAMERA_SIZE:] = blocks.ravel()
    return error


def small_correction(state: JointState, seed: int, size: float = 0.2) -> np.ndarray:
    """A correction of every number of the error state."""
    return size * np.random.default_rng(seed).standard_normal(len(state.P))
