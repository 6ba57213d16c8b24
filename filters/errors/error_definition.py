"""Error definitions: the retraction of the joint state, and the points at which Jacobians are evaluated.

P is always kept in the standard coordinates (position, rotation on the right, velocity, other variables, landmarks).
What sets the definitions apart is how they move the state, how P is carried along, and where they linearise. The base
class corrects all parts one by one; the paper's quaternion adds. With first estimates H is taken at the predicted
variables, corrected by odometry where there is any, and at each landmark's first estimate; F, the step that odometry
adds, and the Jacobians of new landmarks are constrained to agree with that, so that a rotation of the world stays
unobservable. It rests on Gamma, the effect of a rotation of the world, `JointState.world_rotation`.

Derivation: docs/derivations/errors.md.

References
----------
Huang, Mourikis and Roumeliotis, IJRR 29(5), 2010.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from filters.geometry.arrays import FloatArray, IntArray
from filters.geometry.retractions import AdditiveQuaternion, Retraction, RotationVector
from filters.motions.motion_model import ROTATION, CameraState
from filters.state.joint_state import Clone, JointState, world_rotation_of_variables
from filters.state.layout import Transport


@dataclass(frozen=True)
class ErrorKernels:
    """Which of the error definitions that the engine has compiled this is; without any of these, "so3"."""

    additive_quaternion: bool = False
    """The orientation is corrected as by `AdditiveQuaternion`."""
    first_estimates: bool = False
    """H, F and the Jacobians of new landmarks are those of `FirstEstimates`."""
    turns: bool = False
    """Camera and map are corrected together, as by `RightInvariant`; `reset` says how P is carried along."""


class ErrorDefinition:
    """Position, velocities and points are corrected by addition, other values by their retraction."""

    orientation: Retraction = RotationVector()
    """Retraction of the orientation; the rotation error is three numbers in the camera frame."""
    constrains: ClassVar[bool] = False
    """Whether `constrained` changes anything."""
    linearises_at_the_state: ClassVar[bool] = True
    """Whether `linearisation_point` is always None."""
    submaps: ClassVar[bool] = True
    """Whether `SubmapEKF` can use it: blocks are corrected one by one."""
    keeps_gauge: bool = False
    """Whether Jacobians and transport keep the directions that cannot be observed unobservable."""
    reset: bool = True
    """Whether `transport` is the full Jacobian of the retraction."""
    kernels: ClassVar[ErrorKernels | None] = None
    """The same definition, compiled. They hold for the class that states them, not for its subclasses. None: none."""

    def moved(self, state: JointState, delta: FloatArray) -> JointState:
        """The state corrected by delta (Eq. 17); P is shared, not yet carried along."""
        by_block = delta[state.layout.size :].reshape(-1, state.size)
        return replace(
            state,
            camera=state.layout.moved(state.camera, delta, self.orientation),
            blocks=self._moved_blocks(state, delta, by_block),
            clones={name: self._moved_clone(clone, by_block) for name, clone in state.clones.items()},
        )

    def transport(self, state: JointState, moved: JointState, delta: FloatArray) -> Transport:
        """Jacobian that takes errors at `state` to errors at `moved`."""
        leading = state.layout.transport(delta, self.orientation)
        rows, own = self._own_transport(state, delta)
        for clone in state.clones.values():
            turned = delta[state.layout.size :].reshape(-1, state.size)[clone.blocks[1], :3]
            rows.append(state.block_rows(clone.blocks[1:])[None])
            own.append(np.eye(state.size)[None])
            own[-1][0, :3, :3] = self.orientation.transport(turned)
        if not rows:
            return Transport(leading)
        return Transport(leading, rows=np.concatenate(rows), own=np.concatenate(own))

    def linearisation_point(self, state: JointState) -> JointState | None:
        """State at which H is evaluated; None: the state itself."""
        return None

    def constrained(self, J: FloatArray, image: FloatArray, state: JointState) -> FloatArray:
        """A Jacobian by the variables, made to take the effect of a rotation of the world there to that on something.

        Parameters
        ----------
        J : (m, k)
            By the first k >= 6 rows of the predicted state.
        image : (m, 3)
            Effect of a rotation of the world on what J is the Jacobian of.
        state : JointState
            Has the predicted variables.
        """
        return J

    def pose_error(
        self, camera: CameraState, P_pose: FloatArray, position: FloatArray, orientation: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Error (6,) of the pose against a true one, and the covariance (6, 6) claimed for it."""
        rotation = self.orientation.local(camera.orientation, orientation)
        return np.concatenate([position - camera.position, rotation], axis=-1), P_pose

    def _moved_blocks(self, state: JointState, delta: FloatArray, by_block: FloatArray) -> FloatArray:
        blocks = state.blocks.copy()
        blocks[:, : state.size] += by_block
        if not state.model.additive:
            own = state.parameter_block
            blocks[own] = state.model.retract(state.blocks[own], by_block[own])
        return blocks

    def _own_transport(self, state: JointState, delta: FloatArray) -> tuple[list[IntArray], list[FloatArray]]:
        """Rows of landmarks whose retraction is not addition, and their Jacobians; a list of none or one."""
        rows = state.own_rows()
        own = None if state.model.additive else state.model.transport(state.parameters(), delta[rows])
        return ([], []) if own is None else ([rows], [own])

    def _moved_clone(self, clone: Clone, by_block: FloatArray) -> Clone:
        shift, turn = by_block[clone.blocks, :3]
        return Clone(clone.position + shift, self.orientation.retract(clone.orientation, turn), clone.blocks)


class QuaternionError(ErrorDefinition):
    """The paper's: the quaternion is corrected by addition and normalised."""

    orientation = AdditiveQuaternion()
    kernels: ClassVar[ErrorKernels | None] = ErrorKernels(additive_quaternion=True)


class RotationVectorError(ErrorDefinition):
    """SO(3): the orientation is corrected by a rotation vector."""

    kernels: ClassVar[ErrorKernels | None] = ErrorKernels()


class FirstEstimates(ErrorDefinition):
    """SO(3) errors with first-estimates Jacobians."""

    constrains: ClassVar[bool] = True
    linearises_at_the_state: ClassVar[bool] = False
    reset = False
    keeps_gauge = True
    kernels: ClassVar[ErrorKernels | None] = ErrorKernels(first_estimates=True)

    def transport(self, state: JointState, moved: JointState, delta: FloatArray) -> Transport:
        """The identity: errors stay those of the linearisation point, which landmarks do not move."""
        return Transport(np.eye(state.layout.size))

    def linearisation_point(self, state: JointState) -> JointState | None:
        """Predicted variables, first estimates of the landmarks."""
        return state.at_first_estimates()

    def constrained(self, J: FloatArray, image: FloatArray, state: JointState) -> FloatArray:
        """J with its rotation columns changed by (image - J source) R_wc, source the effect on the variables."""
        source = world_rotation_of_variables(state.layout, state.predicted)[: J.shape[1]]
        adjusted = J.copy()
        adjusted[:, ROTATION] += (image - J @ source) @ state.predicted.R_wc
        return adjusted
