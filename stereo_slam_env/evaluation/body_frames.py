"""Detection of poses of another frame of the same body, or of a swapped reading of a file.

Two trajectories of frames that are fixed to one body are T_wc = G T_w'b X, with the same G and X for all poses: G is
the other world, X the other frame.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from filters import Pose
from filters.geometry import rotations
from filters.geometry.arrays import FloatArray
from filters.motions.motion_model import POSITION, ROTATION
from stereo_slam_env.evaluation import trajectory_metrics as metrics
from stereo_slam_env.files.readers import read_json
from stereo_slam_env.recording.trajectory import Trajectory

_POSES = 400
"""Poses that are looked at."""
_DOMINATES = 3.0
"""An offset is named where without it the error is so many times as large."""
_TURNED, _APART = np.deg2rad(0.5), 0.01
"""rad and m: a smaller offset is not named ..."""
_BEYOND = 5.0
"""... nor one of fewer claimed deviations, which may be an error as claimed."""
_LINE = 0.01
"""Positions that spread by a smaller share of the path are on a line."""
_ROUNDING = 1e-7
"""rad and m: differences that say nothing."""
_FITS_BETTER = 5.0
"""A swapped reading is named where it fits so many times better; errors of a degree leave no more."""


@dataclass(frozen=True)
class BodyOffset:
    """A frame C, fixed to the body B of an estimate, whose poses fit those of the reference."""

    T_bc: Pose
    """Pose of C in B."""
    turned: bool
    """Whether its rotation explains most of the rotation error."""
    apart: bool
    """Whether its lever arm explains most of the position error."""

    @property
    def words(self) -> str:
        """Sentence on the offset; empty where there is none."""
        if not (self.turned or self.apart):
            return ""
        phi = rotations.log(self.T_bc.R_wc)
        angle, axis = float(np.linalg.norm(phi)), phi / max(float(np.linalg.norm(phi)), 1e-12)
        sentences = []
        if self.turned:
            sentences.append(f"turned by {np.rad2deg(angle):.3g}° about ({axis[0]:.2f}, {axis[1]:.2f}, {axis[2]:.2f})")
        if self.apart:
            sentences.append(f"{np.linalg.norm(self.T_bc.position):.3g} m away")
        return (
            f"the reference's body seems to be {' and '.join(sentences)}, as seen from the estimate's: give its pose "
            "by --body, or let --body-estimated apply what is found"
        )


def read_body(path: Path) -> Pose:
    """Pose T_bc of the reference's body in that of the estimate: JSON with R (9 numbers, or 3 rows) and t (3), m.

    Raises
    ------
    ValueError
        The file is missing or holds something else: one line that names it.
    """
    if not path.exists():
        raise ValueError(f"{path} does not exist: give JSON with R and t")
    content = read_json(path)
    try:
        t = np.asarray(content["t"], dtype=np.float64)
        R = np.asarray(content["R"], dtype=np.float64).reshape(3, 3)
        right = np.allclose(R @ R.T, np.eye(3), atol=1e-3) and np.linalg.det(R) > 0 and t.shape == (3,)
    except (KeyError, TypeError, ValueError, OverflowError):
        right = False
    if not (right and np.isfinite(t).all()):
        raise ValueError(f"{path} holds no pose: give JSON with R, a rotation of 9 numbers row by row, and t, 3 in m")
    return Pose(t, rotations.from_matrix(R))


def find_body_offset(estimate: Trajectory, reference: Trajectory) -> BodyOffset:
    """The frame of the estimate's body whose poses fit those of a paired reference best, whatever their worlds.

    The lever arm is what brings the positions together, the rotation what is left when they are; where they are on a
    line, which has no rotation of its own, it is what brings relative motions together.
    """
    rows = np.unique(np.linspace(0, len(estimate) - 1, _POSES).astype(int))
    R, p = rotations.matrix(estimate.orientations[rows]), estimate.positions[rows]
    R_ref, p_ref = rotations.matrix(reference.orientations[rows]), reference.positions[rows]
    R_bc, t_bc = np.eye(3), np.zeros(3)
    _, width, _ = np.linalg.svd(p_ref - p_ref.mean(axis=0), compute_uv=False)
    on_a_line = width < _LINE * metrics.path_length(p_ref)
    for _ in range(5):  # the lever arm needs the world's rotation, which the lever arm is part of
        if on_a_line:
            R_bc = _of_relative_motions(R, p, R_ref, p_ref, t_bc)
            G = _mean_rotation(R_ref @ (R @ R_bc).swapaxes(1, 2))
        else:
            G, _ = metrics.rigid_motion(p + R @ t_bc, p_ref)
            R_bc = _mean_rotation((G @ R).swapaxes(1, 2) @ R_ref)
        # p_ref = G (p + R t_bc) + t: linear in t_bc and t.
        columns = np.concatenate([G @ R, np.tile(np.eye(3), (len(rows), 1, 1))], axis=2).reshape(-1, 6)
        t_bc = np.linalg.lstsq(columns, (p_ref - p @ G.T).ravel(), rcond=1e-3)[0][:3]
    plain = _mean_rotation(R_ref @ R.swapaxes(1, 2)) if on_a_line else metrics.rigid_motion(p, p_ref)[0]
    turned = [
        metrics.root_mean_square(rotations.log((world @ R @ body).swapaxes(1, 2) @ R_ref))
        for world, body in ((plain, np.eye(3)), (G, R_bc))
    ]
    if not on_a_line:  # a drift to the side turns positions against orientations that are right, too
        by_turns = _mean_rotation(R_ref @ R.swapaxes(1, 2))
        remaining = [
            metrics.root_mean_square((q - q.mean(0)) - (p_ref - p_ref.mean(0))) for q in (p @ by_turns.T, p @ plain.T)
        ]
        if remaining[0] < _DOMINATES * remaining[1]:
            error = metrics.root_mean_square(rotations.log((by_turns @ R).swapaxes(1, 2) @ R_ref))
            turned[0] = min(turned[0], error)
    apart = [metrics.ate_rigid(p + R @ lever, p_ref) for lever in (np.zeros(3), t_bc)]
    apart[0] = min(apart[0], metrics.ate_scaled(p, p_ref))  # a scale of its own is none of the body
    least_turn, least_lever = _TURNED, _APART
    if (claimed := estimate.pose_covariances) is not None:
        variances = np.maximum(np.diagonal(claimed, axis1=1, axis2=2), 0.0)
        lever, turn = (float(np.sqrt(np.median(variances[:, part].mean(axis=1)))) for part in (POSITION, ROTATION))
        least_turn, least_lever = max(_TURNED, _BEYOND * turn), max(_APART, _BEYOND * lever)
    return BodyOffset(
        Pose(t_bc, rotations.from_matrix(R_bc)),
        turned[0] > _DOMINATES * turned[1] and float(np.linalg.norm(rotations.log(R_bc))) > least_turn,
        apart[0] > _DOMINATES * apart[1] and float(np.linalg.norm(t_bc)) > least_lever,
    )


def _of_relative_motions(
    R: FloatArray, p: FloatArray, R_ref: FloatArray, p_ref: FloatArray, t_bc: FloatArray
) -> FloatArray:
    """R_bc from rotation vectors and displacements between poses, which it turns; the world does not appear in them."""
    step = max(1, len(R) // 20)
    turn, turn_ref = (one[:-step].swapaxes(1, 2) @ one[step:] for one in (R, R_ref))
    moved = seen_from(R[:-step], p[step:] - p[:-step]) + (turn - np.eye(3)) @ t_bc
    moved_ref = seen_from(R_ref[:-step], p_ref[step:] - p_ref[:-step])
    ours, theirs = [], []
    for mine, other in ((rotations.log(turn), rotations.log(turn_ref)), (moved, moved_ref)):
        size = np.sqrt(np.mean(other**2)) + 1e-12
        ours += [mine / size, -mine / size]  # with their negatives, so that only a rotation brings them together
        theirs += [other / size, -other / size]
    R_cb, _ = metrics.rigid_motion(np.concatenate(ours), np.concatenate(theirs))
    R_bc: FloatArray = R_cb.T
    return R_bc


def swapped_reading(estimate: Trajectory, reference: Trajectory) -> str:
    """Reading of paired files that fits five times better, in a sentence; empty where none does."""
    plain = _misfit(estimate, reference)
    for words, swapped in _READINGS.items():
        other = _misfit(swapped(estimate), reference)
        worse = [mine > 1.1 * before + _ROUNDING for mine, before in zip(other, plain, strict=True)]
        better = [mine * _FITS_BETTER < before - _ROUNDING for mine, before in zip(other, plain, strict=True)]
        if any(better) and not any(worse[:2]):
            return f"the files fit five times better where {words}: write it so"
    return ""


def _rolled(trajectory: Trajectory, places: int) -> Trajectory:
    orientations = np.roll(trajectory.orientations, places, axis=1)
    return replace(trajectory, orientations=orientations, covariances=None)


def _inverted(trajectory: Trajectory) -> Trajectory:
    R = rotations.matrix(trajectory.orientations)
    conjugate = trajectory.orientations * np.array([-1.0, -1.0, -1.0, 1.0])
    return replace(trajectory, positions=-seen_from(R, trajectory.positions), orientations=conjugate, covariances=None)


_READINGS: Mapping[str, Callable[[Trajectory], Trajectory]] = {
    "the estimate's quaternions are read as qw qx qy qz": lambda trajectory: _rolled(trajectory, -1),
    "the reference's quaternions are read as qw qx qy qz": lambda trajectory: _rolled(trajectory, 1),
    "one of them is read as T_bw, the pose of the world in the body": _inverted,
    "the estimate is read as T_bw, with qw qx qy qz": lambda trajectory: _inverted(_rolled(trajectory, -1)),
}
"""Other readings, as what they do to the estimate; in words."""


def _misfit(estimate: Trajectory, reference: Trajectory) -> tuple[float, float, float]:
    """Error of relative rotations, rad, of positions after a rigid alignment, m, and of rotations in that world, rad.

    Neither world nor body count in the first two; the last tells readings apart that differ by a turn of the body.
    """
    rows = np.unique(np.linspace(0, len(estimate) - 1, _POSES).astype(int))
    R, p, R_ref, p_ref = (
        part
        for one in (estimate, reference)
        for part in (rotations.matrix(one.orientations[rows]), one.positions[rows])
    )
    R_bc = _of_relative_motions(R, p, R_ref, p_ref, np.zeros(3))
    step = max(1, len(rows) // 20)
    turn, turn_ref = (one[:-step].swapaxes(1, 2) @ one[step:] for one in (R, R_ref))
    turns_left = rotations.log((R_bc.T @ turn @ R_bc).swapaxes(1, 2) @ turn_ref)
    G, _ = metrics.rigid_motion(p, p_ref)
    turns_of_world = rotations.log((G @ R).swapaxes(1, 2) @ R_ref)
    return metrics.root_mean_square(turns_left), metrics.ate_rigid(p, p_ref), metrics.root_mean_square(turns_of_world)


def seen_from(R: FloatArray, vectors: FloatArray) -> FloatArray:
    """R^T v of each."""
    return rotations.turned(R.swapaxes(1, 2), vectors)


def _mean_rotation(R: FloatArray) -> FloatArray:
    """The rotation nearest to several (K, 3, 3)."""
    U, _, Vt = np.linalg.svd(R.sum(axis=0))
    return np.asarray(U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt, dtype=np.float64)
