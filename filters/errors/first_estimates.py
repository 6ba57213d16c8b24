"""First-estimates Jacobians: a rotation of the world stays unobservable (Huang et al. 2010).

H is taken at the predicted variables, corrected by odometry where there is any, and at each landmark's first estimate;
F, the step that odometry adds, and the Jacobians of new landmarks are constrained to agree with that. It rests on
Gamma, the effect of a rotation of the world, `JointState.world_rotation`.

Derivation: docs/derivations/errors.md.

References
----------
Huang, Mourikis and Roumeliotis, IJRR 29(5), 2010.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from filters.errors.model import ErrorDefinition, ErrorKernels
from filters.geometry.arrays import FloatArray
from filters.motions.model import ROTATION
from filters.state.joint_state import JointState, world_rotation_of_variables
from filters.state.transport import Transport


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
