"""Inverse depth with shared anchors: landmarks that enter the map in one frame keep one anchor between them.

They would all copy the same camera position, so their anchor rows of P are equal and stay equal under every
Kalman update: the estimate is the one of six-dimensional inverse depth, in 3 n + 3 k instead of 6 n numbers.

Derivation: docs/derivations/inverse_depth.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from filters.landmarks.inverse_depth import KERNELS, InverseDepth
from filters.landmarks.model import LandmarkKernels


@dataclass(frozen=True)
class SharedAnchorInverseDepth(InverseDepth):
    """`InverseDepth` whose anchors are shared by the landmarks of one frame."""

    shares_anchors: ClassVar[bool] = True
    kernels: ClassVar[LandmarkKernels | None] = KERNELS
