"""Error definitions of the joint state: its retraction, and the points at which Jacobians are evaluated.

P is always kept in the standard coordinates (position, rotation on the right, velocities, parameters). What sets the
definitions apart is how they move the state, how P is carried along, and where they linearise:

`StandardError`
    parts are corrected one by one; P follows the orientation.
`FirstEstimates`
    H is taken at the predicted pose and at each landmark's first estimate, F and the Jacobians of new landmarks are
    constrained to agree with that, so that a rotation of the world stays unobservable (Huang et al. 2010).
`RightInvariant`
    the correction is exp(xi) of a group that rotates camera and map together about the origin of W
    (Zhang et al. 2017; Barrau and Bonnabel 2015). In standard coordinates that is: another retraction, and P carried
    along by delta+ = delta + (Gamma+ - Gamma) theta, with Gamma the effect of a rotation of the world on the error
    state.

Both of the latter rest on Gamma, `JointState.world_rotation`.

Derivation: docs/derivations/errors.md.

References
----------
Huang, Mourikis and Roumeliotis, IJRR 29(5), 2010. Barrau and Bonnabel, "An EKF-SLAM algorithm with consistency
properties", arXiv 1510.06263, 2015. Zhang, Wu, Song, Huang and Dissanayake, "Convergence and consistency analysis for a
3-D invariant-EKF SLAM", IEEE RA-L 2(2), 2017.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from filters import rotations
from filters.engine.joint_state import JointState, world_rotation_of_camera
from filters.engine.retraction import RETRACTIONS, Retraction
from filters.motion import ANGULAR, CAMERA_SIZE, LINEAR, POSITION, ROTATION, CameraState
from filters.validation import FloatArray

_EYE = np.eye(3)


def moved_camera(camera: CameraState, delta: FloatArray, retraction: Retraction) -> CameraState:
    """A camera, or many, corrected by the first 12 numbers of delta (..., n)."""
    return CameraState(
        camera.position + delta[..., POSITION],
        retraction.retract(camera.orientation, delta[..., ROTATION]),
        camera.linear_velocity + delta[..., LINEAR],
        camera.angular_velocity + delta[..., ANGULAR],
    )


class StandardError:
    """Position, velocities and landmarks are corrected by addition, the orientation by its retraction."""

    constrains = False
    """Whether `constrained` changes anything."""
    linearises_at_the_state = True
    """Whether `linearisation_point` is always None."""

    def __init__(self, retraction: Retraction) -> None:
        self.retraction = retraction

    def moved(self, state: JointState, delta: FloatArray) -> JointState:
        """The state corrected by delta (Eq. 17); P is shared, not yet carried along."""
        camera = moved_camera(state.camera, delta, self.retraction)
        return replace(state, camera=camera, blocks=state.blocks + delta[CAMERA_SIZE:].reshape(-1, 3))

    def transport(self, state: JointState, moved: JointState, delta: FloatArray) -> FloatArray:
        """W of the Jacobian I + W E^T that takes errors at `state` to errors at `moved`; E selects the rotation.

        Returns
        -------
        (12, 3) or (n, 3) ndarray
            Rows beyond the camera are zero where they are not given.
        """
        W = np.zeros((CAMERA_SIZE, 3))
        W[ROTATION] = self.retraction.transport(delta[ROTATION])
        W[ROTATION] -= _EYE
        return W

    def linearisation_point(self, state: JointState) -> JointState | None:
        """State at which H is evaluated; None: the state itself."""
        return None

    def constrained(self, J: FloatArray, image: FloatArray, state: JointState) -> FloatArray:
        """A Jacobian by the camera, made to take the effect of a rotation of the world there to that on something.

        Parameters
        ----------
        J : (m, k)
            By the first k >= 6 numbers of the predicted camera.
        image : (m, 3)
            Effect of a rotation of the world on what J is the Jacobian of.
        state : JointState
            Has the predicted camera.
        """
        return J

    def pose_error(
        self, camera: CameraState, P_pose: FloatArray, position: FloatArray, orientation: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Error (6,) of the pose against a true one, and the covariance (6, 6) claimed for it."""
        rotation = self.retraction.local(camera.orientation, orientation)
        return np.concatenate([position - camera.position, rotation], axis=-1), P_pose


class FirstEstimates(StandardError):
    """SO(3) errors with first-estimates Jacobians."""

    constrains = True
    linearises_at_the_state = False

    def __init__(self) -> None:
        super().__init__(RETRACTIONS["so3"])

    def transport(self, state: JointState, moved: JointState, delta: FloatArray) -> FloatArray:
        """None: errors stay those of the linearisation point, which a correction does not move."""
        return np.zeros((CAMERA_SIZE, 3))

    def linearisation_point(self, state: JointState) -> JointState | None:
        """Predicted pose, first estimates of the landmarks."""
        return state.at_first_estimates()

    def constrained(self, J: FloatArray, image: FloatArray, state: JointState) -> FloatArray:
        """J with its rotation columns changed by (image - J source) R_wc, source the effect on the camera."""
        source = world_rotation_of_camera(state.predicted)[: J.shape[1]]
        adjusted = J.copy()
        adjusted[:, ROTATION] += (image - J @ source) @ state.predicted.R_wc
        return adjusted


class RightInvariant(StandardError):
    """Right-invariant errors: camera and map are rotated together."""

    def __init__(self) -> None:
        super().__init__(RETRACTIONS["so3"])

    def moved(self, state: JointState, delta: FloatArray) -> JointState:
        """exp(xi) applied from the left, where delta = xi + Gamma theta and theta is the rotation in W."""
        camera = state.camera
        theta = camera.R_wc @ delta[ROTATION]
        xi = delta - state.world_rotation() @ theta
        turn = rotations.exp(theta)
        spread = rotations.right_jacobian(-theta)
        corrected = CameraState(
            turn @ camera.position + spread @ xi[POSITION],
            self.retraction.retract(camera.orientation, delta[ROTATION]),
            turn @ camera.linear_velocity + spread @ xi[LINEAR],
            camera.angular_velocity + delta[ANGULAR],
        )
        return replace(
            state, camera=corrected, blocks=state.turned_blocks(turn, spread, xi[CAMERA_SIZE:].reshape(-1, 3))
        )

    def transport(self, state: JointState, moved: JointState, delta: FloatArray) -> FloatArray:
        """(Gamma+ - Gamma) R_wc, on all rows: P stays what it was in invariant coordinates."""
        return (moved.world_rotation() - state.world_rotation()) @ state.camera.R_wc

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


ERRORS: dict[str, StandardError] = {
    **{name: StandardError(retraction) for name, retraction in RETRACTIONS.items()},
    "first-estimates": FirstEstimates(),
    "right-invariant": RightInvariant(),
}
