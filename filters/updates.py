"""Linearisation of the measurements, option `update`: by Jacobians, Eq. 8-10 and 13-14, or by sigma points.

Each landmark's measurement depends on its own few rows of the state (pose, anchor, parameters). Sigma points drawn
from their joint covariance are sent through Eq. 8-10, and a line is fitted: z = mean + H e + error, with the
covariance of that error added to R. With that H and R the ordinary update is the unscented one on the measured
sub-state (as Li and Aouf did for a stereo rig), for all landmarks at once, and it keeps its sparsity.

Derivation: docs/derivations/measurements.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from filters.contract.extras import require_core
from filters.contract.validation import positive


class Linearisation:
    """The fifth part of a filter: a line through what the sensor measures near the state."""

    def sigma_points(self, size: int) -> tuple[float, ...]:
        """Of `size` numbers: distance from the centre, its weights in mean and covariance, weight of each other one.

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
        """Those of Merwe with kappa = 3 - size."""
        # Half of the time that `import filters` would take, for those who never ask for this.
        from filterpy.kalman import MerweScaledSigmaPoints

        scaled = MerweScaledSigmaPoints(size, self.alpha, self.beta, 3.0 - size)
        return float(np.sqrt(self.alpha**2 * 3.0)), float(scaled.Wm[0]), float(scaled.Wc[0]), float(scaled.Wm[1])
