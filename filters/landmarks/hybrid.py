"""Hybrid: inverse depth while a landmark needs it, Euclidean XYZ once its position is practically Gaussian.

Civera's linearity index tells (Civera, Davison and Montiel 2008). At first sight by a stereo pair it is 4 sigma_d / d.

Derivation: docs/derivations/euclidean.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from filters.contract.validation import positive
from filters.landmarks.inverse_depth import InverseDepth, ray_of
from filters.landmarks.landmark_model import Numbers


@dataclass(frozen=True)
class Hybrid(InverseDepth):
    """Inverse depth with shared anchors, or XYZ without an anchor.

    Parameters
    ----------
    linearity_limit : float or None
        A landmark becomes XYZ as soon as its linearity index is below this; None: never. The default keeps the pose
        consistent on the reference drive, Civera's 0.1 does not (docs/verification.md).
    """

    linearity_limit: float | None = 0.03
    shares_anchors: ClassVar[bool] = True
    submaps: ClassVar[bool] = False
    steady: ClassVar[bool] = False

    def __post_init__(self) -> None:
        if self.linearity_limit is not None:
            positive("linearity_limit", self.linearity_limit)

    def becomes_point(self, to_anchor: Numbers, y: Numbers, variances: Numbers) -> Any:
        """Whether Civera's linearity index L_d = 4 sigma_depth |cos alpha| / d_1 is below the limit.

        sigma_depth = sigma_rho / rho^2 is along the first ray, d_1 the distance from here, alpha the angle between the
        two rays (the parallax). Never where rho <= 0.
        """
        m, rho = ray_of(y[0], y[1]), y[2]
        x, y_, z = rho * to_anchor[0] + m[0], rho * to_anchor[1] + m[1], rho * to_anchor[2] + m[2]
        across, squared = np.abs(x * m[0] + y_ * m[1] + z * m[2]), x * x + y_ * y_ + z * z
        sigma = np.sqrt(np.maximum(variances[2], 0.0))
        limit = 0.0 if self.linearity_limit is None else self.linearity_limit
        return (rho > 0.0) & (4.0 * sigma * across < limit * rho * squared)
