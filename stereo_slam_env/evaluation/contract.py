"""Contract of a filter in every frame: finite beliefs, and covariances that are covariances.

A frame without them is a failure of the run, like an exception: a NEES that cannot be computed must not be left out of
a mean as if the frame had not been driven. The pose must be positive definite from the second frame on: before the
first prediction it is what the filter was told at `reset`, which may be exact; and so must landmarks, as seen from it.
Velocities may be known exactly, from odometry without errors.
"""

from __future__ import annotations

import numpy as np

from filters import PoseBelief
from filters.consistency import are_definite, fault_of
from filters.validation import FloatArray
from stereo_slam_env.evaluation.map_scoring import MapScore, MapView
from stereo_slam_env.loop import Moment


class ContractBroken(ArithmeticError):
    """A belief of a filter is none: "frame 12: its covariance is not positive definite"."""

    def __init__(self, frame: int, what: str) -> None:
        super().__init__(f"frame {frame}: {what}")


def check_beliefs(moment: Moment) -> None:
    """Raise `ContractBroken` where pose, velocity or the error of the pose is none."""
    k, pose, velocity = moment.number, moment.pose, moment.slam.velocity
    _require_finite(k, "position", pose.position)
    _require_finite(k, "orientation", pose.orientation)
    _require_finite(k, "linear velocity", velocity.linear)
    _require_finite(k, "angular velocity", velocity.angular)
    _require_covariance(k, "covariance", pose.covariance, definite=k > 0)
    _require_covariance(k, "velocity covariance", velocity.covariance, definite=False)
    if moment.pose_error is not None:
        error, covariance = moment.pose_error
        _require_finite(k, "pose error", error)
        _require_covariance(k, "covariance", covariance, definite=k > 0, where=", as pose_error claims it")


def check_map(frame: int, view: MapView, score: MapScore) -> None:
    """Raise `ContractBroken` where the covariance of a landmark is none.

    Of those truly in view: the others are not scored. One without a finite place, such as one at infinity in XYZ, has
    none to be judged by.
    """
    seen = np.flatnonzero(score.in_view & np.isfinite(view.uvd).all(axis=1))
    if not are_definite(view.covariance[seen]).all():
        for place in seen:
            name = f"covariance of landmark {view.ids[place]}"
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
