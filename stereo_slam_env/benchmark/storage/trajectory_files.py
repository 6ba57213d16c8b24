"""Trajectories in the formats that other tools read: TUM and KITTI."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from filters import rotations
from filters.validation import FloatArray
from stereo_slam_env.files.atomic import write_atomically


def write_tum(path: Path, timestamps: FloatArray, positions: FloatArray, orientations: FloatArray) -> None:
    """Rows `t x y z qx qy qz qw` of the poses that are known.

    Parameters
    ----------
    path : Path
        The file.
    timestamps, positions, orientations : (K,), (K, 3), (K, 4)
        s, m in W, q^WC xyzw.
    """
    rows = np.column_stack([timestamps, positions, orientations])
    _write(path, rows[np.isfinite(rows).all(axis=1)])


def write_kitti(path: Path, positions: FloatArray, orientations: FloatArray) -> None:
    """Rows of the 3x4 matrix T_wc, row-major, of the poses that are known.

    The format has no times: where poses are missing, the rows are no longer those of the frames.
    """
    known = np.isfinite(positions).all(axis=1) & np.isfinite(orientations).all(axis=1)
    T_wc = np.concatenate([rotations.matrix(orientations[known]), positions[known][:, :, None]], axis=2)
    _write(path, T_wc.reshape(-1, 12))


def _write(path: Path, rows: FloatArray) -> None:
    write_atomically(path, lambda stream: np.savetxt(stream, rows, fmt="%.9f"))
