"""Error definitions, the retraction of the joint state and where Jacobians are evaluated; updates: by which points.

P is always kept in the standard coordinates (position, rotation on the right, velocity, other variables, landmarks).
What sets the definitions apart is how they move the state, how P is carried along, and where they linearise; the engine
has that compiled (`filters.kernels.retraction`, `prediction`), and a definition says which of it applies. The base
class corrects all parts one by one; the paper's quaternion adds.

With first estimates H is taken at the predicted variables, corrected by odometry where there is any, and at each
landmark's first estimate; F, the step that odometry adds, and the Jacobians of new landmarks are constrained to agree
with that, so that a rotation of the world stays unobservable: J has (image - J source) R_wc added to its rotation
columns, `source` the effect of that rotation on the variables and `image` that on what J is the Jacobian of.

Invariant errors correct camera and map together, as one element of a group: that of the rotation with all points
(position, velocity, anchors, XYZ) behind it. The left- and the right-invariant correction of one estimate are the same
element, X exp(xi_L) = exp(Ad xi_L) X, and where the covariance is carried along by the full Jacobian of the retraction
both are the same filter (Ge et al. 2025). What differs is the coordinates of the pose error.

Derivation: docs/derivations/errors.md.

References
----------
Huang, Mourikis and Roumeliotis, IJRR 29(5), 2010. Barrau and Bonnabel, "An EKF-SLAM algorithm with consistency
properties", arXiv 1510.06263, 2015. Zhang, Wu, Song, Huang and Dissanayake, "Convergence and consistency analysis for a
3-D invariant-EKF SLAM", IEEE RA-L 2(2), 2017. Ge et al., arXiv 2507.04568, 2025.

Each landmark's measurement depends on its own few rows of the state (pose, anchor, parameters). Sigma points drawn
from their joint covariance are sent through Eq. 8-10, and a line is fitted: z = mean + H e + error, with the
covariance of that error added to R. With that H and R the ordinary update is the unscented one on the measured
sub-state (as Li and Aouf did for a stereo rig), for all landmarks at once, and it keeps its sparsity.

Derivation: docs/derivations/measurements.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from filters.contract.extras import require_core
from filters.contract.validation import positive
from filters.geometry import rotations
from filters.geometry.arrays import FloatArray
from filters.geometry.poses import AdditiveQuaternion, Retraction, RotationVector
from filters.motions.motion_model import POSITION, ROTATION, CameraState


class ErrorDefinition:
    """Position, velocities and points are corrected by addition, other values by their retraction."""

    orientation: Retraction = RotationVector()
    """Retraction of the orientation; the rotation error is three numbers in the camera frame."""
    additive_quaternion: ClassVar[bool] = False
    """Whether the orientation is corrected as by `AdditiveQuaternion`."""
    first_estimates: ClassVar[bool] = False
    """Whether H, F and the Jacobians of new landmarks are those of `FirstEstimates`."""
    turns: ClassVar[bool] = False
    """Whether camera and map are corrected together, as one element of a group; `reset` says how P is carried along."""
    submaps: ClassVar[bool] = True
    """Whether `SubmapEKF` can use it: blocks are corrected one by one."""
    keeps_gauge: bool = False
    """Whether Jacobians and transport keep the directions that cannot be observed unobservable."""
    reset: bool = True
    """Whether P is carried along by the full Jacobian of the retraction."""

    def pose_error(
        self, camera: CameraState, P_pose: FloatArray, position: FloatArray, orientation: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Error (6,) of the pose against a true one, and the covariance (6, 6) claimed for it."""
        rotation = self.orientation.local(camera.orientation, orientation)
        return np.concatenate([position - camera.position, rotation], axis=-1), P_pose


class QuaternionError(ErrorDefinition):
    """The paper's: the quaternion is corrected by addition and normalised."""

    orientation = AdditiveQuaternion()
    additive_quaternion: ClassVar[bool] = True


class RotationVectorError(ErrorDefinition):
    """SO(3): the orientation is corrected by a rotation vector."""


class FirstEstimates(ErrorDefinition):
    """SO(3) errors with first-estimates Jacobians. Errors stay those of the linearisation point."""

    first_estimates: ClassVar[bool] = True
    reset = False
    keeps_gauge = True


@dataclass(frozen=True)
class RightInvariant(ErrorDefinition):
    """Right-invariant errors: the correction exp(xi) is applied from the left.

    Parameters
    ----------
    reset : bool
        Whether the covariance is carried along by the full Jacobian of the retraction (Ge et al. 2025). False: P stays
        what it was in invariant coordinates, as Barrau and Bonnabel, and Zhang et al. have it. Then a rotation of the
        world stays unobservable, which under large orientation uncertainty is worth more (docs/derivations/errors.md).
    """

    reset: bool = False
    turns: ClassVar[bool] = True
    submaps: ClassVar[bool] = False

    @property
    def keeps_gauge(self) -> bool:  # type: ignore[override]
        """Whether P stays what it was in invariant coordinates, in which these directions never change."""
        return not self.reset

    def pose_error(
        self, camera: CameraState, P_pose: FloatArray, position: FloatArray, orientation: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """xi of the pose, position part first: what is left of the true pose after turning the estimate by theta."""
        R_wc = camera.R_wc
        theta = rotations.log(rotations.matrix(orientation) @ R_wc.T)
        spread = rotations.right_jacobian(-theta)
        shift = np.linalg.solve(spread, position - rotations.exp(theta) @ camera.position)
        # delta -> xi: theta = R delta_theta, e_p = delta_r + [r]x theta
        J = np.eye(6)
        J[POSITION, ROTATION] = rotations.skew(camera.position) @ R_wc
        J[ROTATION, ROTATION] = R_wc
        covariance = J @ P_pose @ J.T
        return np.concatenate([shift, theta]), 0.5 * (covariance + covariance.T)


@dataclass(frozen=True)
class LeftInvariant(ErrorDefinition):
    """Left-invariant errors: the correction exp(xi) is applied from the right."""

    turns: ClassVar[bool] = True
    submaps: ClassVar[bool] = False

    def pose_error(
        self, camera: CameraState, P_pose: FloatArray, position: FloatArray, orientation: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """xi of the pose in the camera frame, position part first."""
        R_wc = camera.R_wc
        phi = rotations.log(R_wc.T @ rotations.matrix(orientation))
        shift = np.linalg.solve(rotations.right_jacobian(-phi), R_wc.T @ (position - camera.position))
        J = np.eye(6)
        J[POSITION, POSITION] = R_wc.T
        covariance = J @ P_pose @ J.T
        return np.concatenate([shift, phi]), 0.5 * (covariance + covariance.T)


class Linearisation:
    """The fifth part of a filter: a line through what the sensor measures near the state."""

    def sigma_points(self, size: int) -> tuple[float, ...]:
        """Sigma points of `size` numbers: distance from the centre, its weights (mean, covariance), that of the others.

        None of them: the line is that of the Jacobians.
        """
        return ()


class Extended(Linearisation):
    """The extended Kalman filter's: Jacobians at the state, or at the first estimates."""


@dataclass(frozen=True)
class Unscented(Linearisation):
    """H and R fitted to sigma points.

    Parameters
    ----------
    alpha : float
        Spread of the sigma points.
    beta : float
        Weight of the covariance; 2 is the Gaussian choice (Merwe).
    """

    alpha: float = 0.5
    beta: float = 2.0

    def __post_init__(self) -> None:
        positive("alpha", self.alpha)
        positive("beta", self.beta, allow_zero=True)
        require_core("filterpy")

    def sigma_points(self, size: int) -> tuple[float, ...]:
        """Sigma points of Merwe with kappa = 3 - size."""
        # Half of the time that `import filters` would take, for those who never ask for this.
        from filterpy.kalman import MerweScaledSigmaPoints

        scaled = MerweScaledSigmaPoints(size, self.alpha, self.beta, 3.0 - size)
        return float(np.sqrt(self.alpha**2 * 3.0)), float(scaled.Wm[0]), float(scaled.Wc[0]), float(scaled.Wm[1])
