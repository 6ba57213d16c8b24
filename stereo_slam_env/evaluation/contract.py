"""Contract of a filter in every frame: finite beliefs, and covariances that are covariances.

A frame without them is a failure of the run, like an exception: a NEES that cannot be computed must not be left out of
a mean as if the frame had not been driven. The pose must be positive definite from the second frame on: before the
first prediction it is what the filter was told at `reset`, which may be exact; and so must landmarks, as seen from it.
Velocities may be known exactly, from odometry without errors.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from filters import PoseBelief
from filters.checks.consistency import are_definite, fault_of
from filters.geometry.arrays import BoolArray, FloatArray
from stereo_slam_env.evaluation.map_scoring import MapScore, MapView


class ContractBroken(ArithmeticError):
    """A belief of a filter is none: "frame 12: its covariance is not positive definite"."""

    def __init__(self, frame: int, what: str) -> None:
        super().__init__(f"frame {frame}: {what}")
        self.frame = frame


@dataclass(frozen=True, eq=False)
class Beliefs:
    """Beliefs of a filter in K frames."""

    values: Mapping[str, FloatArray]
    """(K, n) by name, for messages."""
    pose: FloatArray
    """(K, 6, 6): covariance."""
    velocity: FloatArray
    """(K, 6, 6): covariance."""
    errors: FloatArray
    """(K, 6): errors of the pose, where they are known."""
    claimed: FloatArray
    """(K, 6, 6): covariance claimed for them."""
    known: BoolArray
    """(K,): whether they are known."""

    def __getitem__(self, k: int) -> Beliefs:
        one = slice(k, k + 1)
        values = {name: value[one] for name, value in self.values.items()}
        return Beliefs(values, self.pose[one], self.velocity[one], self.errors[one], self.claimed[one], self.known[one])


def check_beliefs(first: int, beliefs: Beliefs) -> None:
    """Raise `ContractBroken` for the first frame in which pose, velocity or the error of the pose is none.

    The frames are numbered from `first` on.
    """
    sound = are_definite(beliefs.pose) & are_definite(beliefs.velocity)
    for value in beliefs.values.values():
        sound &= np.isfinite(value).all(axis=1)
    claimed = (beliefs.claimed == beliefs.pose).all(axis=(1, 2)) | are_definite(beliefs.claimed)
    sound &= ~beliefs.known | (claimed & np.isfinite(beliefs.errors).all(axis=1))
    for k in np.flatnonzero(~sound).tolist():  # perhaps they are semi-definite where they may be
        _check_frame(first + k, beliefs[k])


def _check_frame(k: int, belief: Beliefs) -> None:
    for name, value in belief.values.items():
        _require_finite(k, name, value)
    _require_covariance(k, "covariance", belief.pose[0], definite=k > 0)
    _require_covariance(k, "velocity covariance", belief.velocity[0], definite=False)
    if belief.known[0]:
        _require_finite(k, "pose error", belief.errors)
        if not np.array_equal(belief.claimed, belief.pose):
            _require_covariance(k, "covariance", belief.claimed[0], definite=k > 0, where=", as pose_error claims it")


def check_maps(view: MapView, score: MapScore) -> None:
    """Raise `ContractBroken` for the first frame in which the covariance of a landmark is none.

    Of those truly in view: the others are not scored. One without a finite place, such as one at infinity in XYZ, has
    none to be judged by. One that has a NEES has passed.
    """
    for place in np.flatnonzero(score.in_view & np.isnan(score.nees) & np.isfinite(view.uvd).all(axis=1)):
        frame, name = int(view.frames[place]), f"covariance of landmark {view.ids[place]}"
        _require_covariance(frame, name, view.covariance[place], definite=frame > 0)


def check_motion(frame: int, moved: PoseBelief) -> None:
    """Raise `ContractBroken` where the covariance of the motion over the window that ends here is none."""
    _require_covariance(frame, "covariance of the relative pose", moved.covariance, definite=True)


def _require_finite(frame: int, name: str, value: FloatArray) -> None:
    if not np.isfinite(value).all():
        raise ContractBroken(frame, f"its {name} is not finite")


def _require_covariance(frame: int, name: str, covariance: FloatArray, *, definite: bool, where: str = "") -> None:
    fault = fault_of(covariance, definite=definite)
    if fault is not None:
        raise ContractBroken(frame, f"its {name} {fault}{where}")
