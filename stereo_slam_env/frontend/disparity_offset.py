"""The residual of the rectification along the rows: all disparities of a real rig are wrong by the same little.

A yaw of a quarter of a milliradian between the eyes, far below what a calibration promises, shifts every disparity by
0.2 px: 1 % of the depth, and so of the distance driven, at 20 px. A moving camera sees it: between two pairs, points
come nearer by what the step says, the same for all, while a wrong offset brings near and far ones nearer by
different amounts.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from filters.camera import StereoCamera
from filters.validation import FloatArray
from stereo_slam_env.stereo_step import Pairs, Step, transfer

PRIOR_SIGMA = 0.25
"""What a careful calibration leaves, px."""


class DisparityOffset:
    """A recursive estimate of what must be added to measured disparities.

    Parameters
    ----------
    camera : StereoCamera
        The rig.
    """

    def __init__(self, camera: StereoCamera) -> None:
        self._camera = camera
        self.value = 0.0
        """px."""
        self._information = PRIOR_SIGMA**-2

    @property
    def sigma(self) -> float:
        """Standard deviation of the estimate, px."""
        return float(self._information**-0.5)

    def update(self, pairs: Pairs, step: Step) -> float:
        """Learn from a step and the pairs that agree with it.

        Parameters
        ----------
        pairs : Pairs
            Measurements, with the present `value` added to their disparities; no measurement may come twice.
        step : Step
            The motion, as estimated from them.

        Returns
        -------
        float
            Change of `value`, px.
        """
        predicted = transfer(self._camera, pairs.first, step)
        A = predicted.by_first
        S = pairs.R_second + A @ pairs.R_first @ A.transpose(0, 2, 1)
        nu = pairs.second - predicted.uvd
        # Adding x to all disparities moves the measurement by x e_d and the prediction by A e_d x.
        by_offset = A[:, :, 2] - np.array([0.0, 0.0, 1.0])
        H = np.concatenate([predicted.by_step, by_offset[:, :, None]], axis=2)
        weighted = np.linalg.solve(S, H)
        normal: FloatArray = np.einsum("mij,mik->jk", H, weighted)
        normal[6, 6] += self._information
        try:
            factor = cho_factor(normal)
        except LinAlgError:
            return 0.0
        change = float(cho_solve(factor, np.einsum("mij,mi->j", weighted, nu))[6])
        self._information = float(1.0 / cho_solve(factor, np.eye(7)[6])[6])
        self.value += change
        return change
