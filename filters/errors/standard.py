"""Errors that are corrected one by one: with the paper's additive quaternion, or on SO(3)."""

from __future__ import annotations

from typing import ClassVar

from filters.errors.model import ErrorDefinition, ErrorKernels
from filters.geometry.retractions import AdditiveQuaternion


class QuaternionError(ErrorDefinition):
    """The paper's: the quaternion is corrected by addition and normalised."""

    orientation = AdditiveQuaternion()
    kernels: ClassVar[ErrorKernels | None] = ErrorKernels(additive_quaternion=True)


class RotationVectorError(ErrorDefinition):
    """SO(3): the orientation is corrected by a rotation vector."""

    kernels: ClassVar[ErrorKernels | None] = ErrorKernels()
