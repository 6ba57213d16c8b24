"""Moving bodies that the filter believes in, as numbers for policies: `ObserveBodies`."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from filters.bodies.rigid_bodies import BODY_SIZE, V, W
from filters.contract.validation import whole_number
from filters.geometry import rotations
from filters.geometry.arrays import FloatArray
from filters.motions.motion_model import POSE_SIZE
from stereo_slam_env.envs.filter_rows import FilterRows
from stereo_slam_env.envs.row_wrapper import RowsWrapper
from stereo_slam_env.envs.rows import Arrays

POSITION, VELOCITY, YAW_RATE, SIGMAS, MASK = slice(0, 3), slice(3, 6), 6, slice(7, 10), 10
"""Columns of `bodies`."""
_HIGH: FloatArray = np.array([*[1e3] * 3, *[100.0] * 3, 10.0, 1e3, 100.0, 10.0, 1.0])
_LOW: FloatArray = np.where(np.arange(len(_HIGH)) < SIGMAS.start, -_HIGH, 0.0)


class ObserveBodies(RowsWrapper):
    """Adds the key `bodies` (most, 11), float32: the moving bodies in the filter's state, the nearest first.

    Axes are those of the camera (x right, y down, z forward). Values beyond the bounds are clipped to them, and rows
    without a body are 0:

    | Column | Bounds | Meaning |
    |--------|--------|---------|
    | 0-2 | 1e3 | position relative to the camera, m: of the point at which the body's landmarks were when it was born |
    | 3-5 | 100 | velocity of that point relative to W, m/s |
    | 6 | 10 | yaw rate, rad/s, about the y axis of the camera: positive to the right |
    | 7 | 0 to 1e3 | standard deviation of the distance, m, correlations with the pose of the camera included |
    | 8 | 0 to 100 | standard deviation of the speed, m/s |
    | 9 | 0 to 10 | standard deviation of the yaw rate, rad/s |
    | 10 | 0 to 1 | 1 where there is a body |

    A body is born without an error of its distance: that standard deviation is of its motion since then.

    Parameters
    ----------
    env : gymnasium.Env
        With `BeliefObservation` inside, whose filter has moving bodies in its state: "moving-bodies".
    most : int
        Rows.

    Raises
    ------
    ValueError
        `most` is not a positive integer, there is no filter in the loop, or it has no moving bodies.
    """

    def __init__(self, env: Any, most: int = 8) -> None:
        super().__init__(env)
        self._most = whole_number("most", most, 1)
        self._beliefs: FilterRows = self.needed("beliefs")
        if getattr(getattr(self._beliefs.filters[0], "options", None), "bodies", None) is None:
            raise ValueError("ObserveBodies needs a filter with moving bodies: BeliefObservation(env, 'moving-bodies')")
        low, high = (np.tile(bound, (most, 1)).astype(np.float32) for bound in (_LOW, _HIGH))
        self.observation_space = spaces.Dict({**self.dict_space(), "bodies": spaces.Box(low, high)})
        self._reads_bodies = True

    def select_keys(self, keys: Collection[str]) -> None:
        """Without `bodies` none are read."""
        self._reads_bodies = "bodies" in keys
        self.rows.select_keys(keys)

    def observe(self) -> tuple[Arrays, Arrays]:
        observation, info = self.rows.observe()
        return ({**observation, "bodies": self._nearest_bodies()} if self._reads_bodies else observation), info

    def _nearest_bodies(self) -> NDArray[np.float32]:
        """Columns of `bodies` of all rows, (B, most, 11)."""
        rows = np.zeros((self.num_envs, self._most, len(_HIGH)))
        for b in range(self.num_envs):
            nearest = body_rows(self._beliefs.filters[b])[: self._most]
            rows[b, : len(nearest)] = nearest
        return np.clip(rows, _LOW, _HIGH).astype(np.float32)


def body_rows(slam: Any) -> FloatArray:
    """Columns of `bodies` (K, 11) for all bodies of a filter whose numbers are finite, the nearest first."""
    bodies, pose = slam.bodies, slam.pose
    R_wc, away = rotations.matrix(pose.orientation), bodies.positions - pose.position
    rows = np.ones((len(bodies), len(_HIGH)))
    rows[:, POSITION], rows[:, VELOCITY] = away @ R_wc, bodies.linear @ R_wc
    rows[:, YAW_RATE] = bodies.angular @ R_wc[:, 1]
    sights, headings = (vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-9)
                        for vectors in (away, bodies.linear))  # fmt: skip
    for k, number in enumerate(bodies.ids.tolist()):
        # Distance, speed and yaw rate by the errors of pose and body; what they are correlated by cancels.
        J = np.zeros((3, POSE_SIZE + BODY_SIZE))
        of_body = J[:, POSE_SIZE:]
        J[0, :3], of_body[0, :3], of_body[1, V], of_body[2, W] = -sights[k], sights[k], headings[k], R_wc[:, 1]
        variances = np.einsum("ij,jk,ik->i", J, slam.belief("pose", f"body-{number}").covariance, J)
        rows[k, SIGMAS] = np.sqrt(np.maximum(variances, 0.0))
    rows = rows[np.isfinite(rows).all(axis=1)]
    return rows[np.argsort(np.linalg.norm(rows[:, POSITION], axis=1), kind="stable")]
