"""States in general position, the same states in a turned world, and drives with odometry."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from filters import BodyVelocity, ErrorDefinition, StereoEKF
from filters.geometry.derivatives import columns_of
from filters.joint_state import JointState
from filters.motions.motion_model import CameraState

from ..dense import own_blocks
from ..drives import DT, Frame, drive, run
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


def some_filter(landmark: Any, error: str | ErrorDefinition, **options: Any) -> StereoEKF:
    """A filter with a map of several frames seen from a pose in general position, and a dense covariance."""
    slam = tilted(make(landmark=landmark, error=error, drop_unseen=False, **options))
    list(run(slam, drive(1, 5, visible=4, depths=(6.0, 30.0))))
    state = slam.state
    root = np.random.default_rng(2).standard_normal((len(state.P), len(state.P) + 5))
    slam.state = replace(state, predicted=state.camera, P=np.asfortranarray(np.tril(root @ root.T)))
    return slam


def turned_world(state: JointState, turn: Rotation) -> JointState:
    """Camera and map, rotated about the origin of W."""
    camera, model, own = state.camera, state.model, own_blocks(state)
    moved = CameraState(
        turn.apply(camera.position),
        (turn * Rotation.from_quat(camera.orientation)).as_quat(),
        turn.apply(camera.linear_velocity),
        camera.angular_velocity,
    )
    blocks = state.blocks.copy()
    blocks[:, :3] = turn.apply(blocks[:, :3])
    if len(own):
        seen = columns_of(model.point_of, state.blocks[own])
        seen[:, :3] = turn.apply(seen[:, :3])
        blocks[own] = columns_of(model.start_from, seen)
    return replace(state, camera=moved, blocks=blocks)


def small_correction(state: JointState, seed: int, size: float = 0.2) -> np.ndarray:
    """A correction of every number of the error state."""
    return size * np.random.default_rng(seed).standard_normal(len(state.P))
