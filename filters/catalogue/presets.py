"""The named filters: each is a choice of parts of the engine."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from filters.catalogue.msckf import MultiStateConstraintEKF
from filters.contract.inputs import Start
from filters.contract.noise import ColouredNoise, StereoNoise
from filters.contract.outputs import PoseBelief
from filters.contract.stereo_filter import AT_ORIGIN, StereoFilter
from filters.engine.stereo_ekf import StereoEKF
from filters.geometry import rotations
from filters.geometry.arrays import FloatArray, IntArray
from filters.geometry.camera import StereoCamera
from filters.geometry.poses import Pose
from filters.landmarks.lasting_errors import LastingErrors
from filters.measurements.rectified_pair import PairWithLastingErrors
from filters.submaps.submap_ekf import SubmapEKF


def _named(class_name: str, description: str, **chosen: Any) -> type[StereoEKF]:
    """A `StereoEKF` with other defaults: those of `chosen`."""

    def __init__(self: StereoEKF, camera: StereoCamera, noise: StereoNoise, **options: Any) -> None:
        StereoEKF.__init__(self, camera, noise, **{**chosen, **options})

    stated = {"open_options": StereoEKF.open_options - chosen.keys(), "__doc__": description, "__module__": __name__}
    return type(class_name, (StereoEKF,), {"__init__": __init__, **stated})


InverseDepthStereoEKF = _named(
    "InverseDepthStereoEKF",
    """Inverse-depth stereo EKF with joint (u, v, d) updates (the paper's).

    Landmarks are stored with shared anchors, which gives the paper's estimates in half the numbers;
    `landmark="inverse-depth"` stores the paper's six each.
    """,
    landmark="shared-anchor",
)
DualBearingEKF = _named(
    "DualBearingEKF",
    """Inverse-depth EKF that updates with the left, then the right bearing.

    `measurement={"name": "sequential", "copied_row_variance": 1.0}` takes the left row for a right one that is not
    measured, as the paper's rival does. Landmarks are stored with shared anchors, as in `InverseDepthStereoEKF`.
    """,
    landmark="shared-anchor",
    measurement="sequential",
)
EuclideanEKF = _named(
    "EuclideanEKF",
    """Euclidean XYZ stereo EKF with joint (u, v, d) updates.

    Without `min_disparity` it starts landmarks from any d > 0, as the textbook does, and diverges on far points.
    Comparisons give it 4 px, the best guard on drives of 350 m with errors of 1 px, at the price of throwing far points
    away.
    """,
    landmark="euclidean",
)
HybridEKF = _named(
    "HybridEKF",
    """Inverse-depth stereo EKF whose landmarks become XYZ once their position is Gaussian enough.

    `landmark={"name": "hybrid", "linearity_limit": 0.02}` sets when.
    """,
    landmark="hybrid",
)
RightInvariantEKF = _named(
    "RightInvariantEKF",
    """Shared-anchor inverse-depth stereo EKF with right-invariant errors.""",
    landmark="shared-anchor",
    error="right-invariant",
)
UnscentedStereoFilter = _named(
    "UnscentedStereoFilter",
    """Shared-anchor inverse-depth stereo filter with unscented updates on the measured sub-state.

    Source: Li and Aouf, who use sigma points for a stereo rig.
    """,
    landmark="shared-anchor",
    update="unscented",
)
MonocularEKF = _named(
    "MonocularEKF",
    """Shared-anchor inverse-depth EKF that updates with the left camera only; disparity starts its landmarks.""",
    landmark="shared-anchor",
    measurement="left",
)


def coloured_options(noise: ColouredNoise, chosen: Iterable[str] = ()) -> dict[str, Any]:
    """Options of `StereoEKF` for what a noise states of errors that last and of the rig, beside those `chosen`."""
    options: dict[str, Any] = {"drift": noise.drift, "gauge_walk": noise.gauge_walk}
    sigmas = {"offset_sigma": noise.disparity_offset, "yaw_sigma": noise.right_yaw, "roll_sigma": noise.right_roll}
    priors: dict[str, Any] = {name: sigma for name, sigma in sigmas.items() if sigma}
    if priors:
        options["measurement"] = {"name": "calibrated", **priors}
    lasting = noise.lasting_covariance
    if lasting is not None and noise.lasting_time and {"landmark", "measurement", "drift"}.isdisjoint(chosen):
        errors = LastingErrors(lasting, noise.lasting_time)
        options |= {"drift": None, "landmark": errors, "measurement": PairWithLastingErrors(**priors)}
    return options


class ColouredNoiseEKF(StereoEKF):
    """Stereo EKF for errors that last from frame to frame, as those of tracks in real images do.

    What a `ColouredNoise` states becomes process noise of landmarks, a gauge walk, and variables for the offset of the
    disparities and the rotation of the right camera. What images do not show is added to the covariance of `pose` and
    `relative_pose`: the scale, and how the camera is turned in the body whose pose is wanted. Where the noise states
    nothing, it is taken for white. Shared anchors, right-invariant errors, and the joint test over the frame where
    there is a gate.
    """

    open_options = StereoEKF.open_options - {"landmark", "measurement", "error", "consensus", "drift", "gauge_walk"}

    def __init__(self, camera: StereoCamera, noise: StereoNoise, *, gate: float | None = 0.99, **options: Any) -> None:
        stated: dict[str, Any] = {}
        scale = misalignment = 0.0
        if isinstance(noise, ColouredNoise):
            stated = coloured_options(noise, options)
            scale, misalignment = noise.scale, noise.misalignment
            noise = noise.white_part
        usual = {"landmark": "shared-anchor", "error": "right-invariant", "consensus": gate is not None}
        super().__init__(camera, noise, gate=gate, **{**usual, **stated, **options})
        self._unseen = np.square([scale, *[misalignment] * 3])

    @property
    def does_as_the_engine(self) -> bool:
        """Whether there is no doubt to add, so that it may run in a batch."""
        return type(self) in (ColouredNoiseEKF, InertialEKF) and not self._unseen.any()

    @property
    def pose(self) -> PoseBelief:
        """Pose of the left camera, with the doubt about the way from the start."""
        return self._in_doubt(super().pose, self._start)

    def relative_pose(self, name: str) -> PoseBelief:
        """Relative pose as of `StereoEKF`, with the doubt about the way from the clone."""
        return self._in_doubt(super().relative_pose(name), Pose())

    def joint_covariance(self, ids: Sequence[int] | IntArray | None = None) -> FloatArray:
        """As of `StereoEKF`, with the covariance of `pose`."""
        joint = super().joint_covariance(ids)
        joint[:6, :6] = self.pose.covariance
        return joint

    def pose_landmark_covariances(self, ids: Sequence[int] | IntArray | None = None) -> FloatArray:
        """As of `StereoEKF`, with the covariance of `pose`."""
        joint = super().pose_landmark_covariances(ids)
        joint[:, :6, :6] = self.pose.covariance
        return joint

    def reset(self, start: Start = AT_ORIGIN) -> None:
        """As of `StereoEKF`."""
        super().reset(start)
        self._start = Pose(start.position, start.orientation)

    def _in_doubt(self, pose: PoseBelief, start: Pose) -> PoseBelief:
        """Covariance that constants, which no image shows, add to that of a pose T that was T_0 once.

        A scale of 1 + s makes an error s (t - t_0), and a camera that is turned in its body by x, which makes of the
        motion M = T_0^-1 T = (p, R) the motion Exp(x)^-1 M Exp(x), one of R_0 [p]x x and (I - R^T) x.
        """
        if not self._unseen.any():
            return pose
        moved = start.inverse() @ Pose(pose.position, pose.orientation)
        by_unseen = np.zeros((6, 4))
        by_unseen[:3, 0] = pose.position - start.position
        by_unseen[:3, 1:] = start.R_wc @ rotations.skew(moved.position)
        by_unseen[3:, 1:] = np.eye(3) - moved.R_wc.T
        return PoseBelief(pose.position, pose.orientation, pose.covariance + (by_unseen * self._unseen) @ by_unseen.T)


class InertialEKF(ColouredNoiseEKF):
    """Stereo-inertial EKF: strapdown motion, shared-anchor inverse depth, right-invariant errors.

    Needs samples of an inertial unit in every step. `motion={"name": "strapdown", "sigma_gravity": 10.0}` starts
    without a vertical; see `Strapdown` for what else may be unknown. Like `coloured-noise` it takes from a
    `ColouredNoise` how errors of tracks last, without which its covariance on images is far too small.
    """

    open_options = StereoEKF.open_options - {"landmark", "motion", "error"}

    def __init__(self, camera: StereoCamera, noise: StereoNoise, **options: Any) -> None:
        super().__init__(camera, noise, **{"motion": "strapdown", "consensus": False, **options})


class MovingBodiesEKF(StereoEKF):
    """Stereo EKF with moving bodies in the state, and which landmarks are on them found out.

    `bodies={"reach": 2.0, ...}` sets how bodies move and are born (`RigidBodies`). A landmark is used once it is known
    to stand or to be on a body, and few of one place are, so that the scene is what takes up most room.
    """

    open_options = StereoEKF.open_options - {"landmark", "error", "consensus"}

    def __init__(self, camera: StereoCamera, noise: StereoNoise, *, gate: float | None = 0.99, **options: Any) -> None:
        usual = {"landmark": "shared-anchor", "error": "so3", "consensus": gate is not None, "bodies": True}
        super().__init__(camera, noise, gate=gate, **{**usual, **options})


PRESETS: Mapping[str, type[StereoFilter]] = {
    "inverse-depth": InverseDepthStereoEKF,
    "dual-bearing": DualBearingEKF,
    "euclidean": EuclideanEKF,
    "right-invariant": RightInvariantEKF,
    "inertial": InertialEKF,
    "msckf": MultiStateConstraintEKF,
    "unscented": UnscentedStereoFilter,
    "monocular": MonocularEKF,
    "coloured-noise": ColouredNoiseEKF,
    "moving-bodies": MovingBodiesEKF,
    "submaps": SubmapEKF,
}
"""The named filters by name; the first line of a class describes it."""
UNLISTED: Mapping[str, type[StereoFilter]] = {"shared-anchor": InverseDepthStereoEKF, "hybrid": HybridEKF}
"""Names that resolve and are not listed: `inverse-depth` by how it stores landmarks, and with another landmark."""
