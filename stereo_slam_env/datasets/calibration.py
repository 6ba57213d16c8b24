"""Rig of a rectified recording by the size of its images, and poses of its left camera."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from filters import Pose, StereoCamera
from filters.geometry.arrays import FloatArray
from stereo_slam_env.datasets.image_files import image_size
from stereo_slam_env.sensing.projections import camera_position, rectified_rig, require_principal_point


def rig_of(path: Path, P: tuple[FloatArray, FloatArray]) -> Callable[[Path], StereoCamera]:
    """Gives the rig of the projection matrices `P`, see `rectified_rig`, for the size of the image in a file."""

    def of_image(image: Path) -> StereoCamera:
        size = image_size(image)
        require_principal_point(path, P[0], size)
        return rectified_rig(path, *P, size)

    return of_image


def of_left_camera(poses: Sequence[Pose | None], P_left: FloatArray) -> list[Pose | None]:
    """Poses of the left camera from those of the reference camera that `P_left` = K [I | t] projects from."""
    offset = camera_position(P_left)
    if not offset.any():
        return list(poses)
    return [pose and Pose(pose.position + pose.R_wc @ offset, pose.orientation) for pose in poses]
