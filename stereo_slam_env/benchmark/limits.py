"""How good any filter could be: the posterior Cramer-Rao bound along the true trajectory."""

from __future__ import annotations

from dataclasses import dataclass

from filters.motion import ConstantVelocity
from filters.validation import FloatArray
from stereo_slam_env.recording import Recording


@dataclass(frozen=True, eq=False)
class Bound:
    """Lower bound of the error covariance of any unbiased filter, frame by frame.

    Attributes
    ----------
    pose : (K, 6, 6)
        Of position in W, m, and rotation in the camera frame, rad; NaN where it is not known.
    """

    pose: FloatArray


def cramer_rao_bound(recording: Recording, motion: ConstantVelocity, *, use_odometry: bool = False) -> Bound | None:
    """Posterior Cramer-Rao bound along the true trajectory of a recording; None where its truth is not complete."""
    raise NotImplementedError
