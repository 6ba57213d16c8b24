"""Student's t re-weighting: no measurement counts more than its R says, surprising ones count less."""

from __future__ import annotations

import numpy as np
import pytest

from filters import Start, StereoEKF, StereoObservation
from filters.checks.conformance import REFERENCE_CAMERA as CAMERA
from filters.checks.conformance import REFERENCE_NOISE as NOISE

from ..drives import drive, finish
from .beliefs import assert_same_belief


@pytest.mark.parametrize("error", [0.0, 4.0, 30.0])
def test_the_weight_is_that_of_students_t_and_never_above_one(error: float) -> None:
    """One measurement off by `error`: as by a Gaussian filter that is given its R over the weight."""
    made = []
    for tail_dof in (4.0, None):
        slam = StereoEKF(CAMERA, NOISE, gate=None, tail_dof=tail_dof, drop_unseen=False)
        slam.reset(Start(covariance=np.diag(np.repeat([1e-3, 1e-3, 0.5, 0.05], 3) ** 2)))
        uvd = np.array([[600.0, 200.0, 20.0], [900.0, 150.0, 30.0]])
        slam.update(StereoObservation([1, 2], uvd))
        slam.predict(0.1)
        forecast = slam.forecast([1])
        nu = np.array([error, 0.0, 0.0])
        distance = nu @ np.linalg.solve(forecast.S[0], nu)
        weight = min((4.0 + 3.0) / (4.0 + distance), 1.0)
        R = NOISE.R if tail_dof else NOISE.R / weight
        slam.update(StereoObservation([1], forecast.uvd + nu, R=R[None]))
        made.append(slam)
    assert_same_belief(*made, 1e-10)


def test_many_degrees_of_freedom_are_gaussian() -> None:
    frames = drive(1, 10, depths=(6.0, 30.0))
    tailed, gaussian = (finish(StereoEKF(CAMERA, NOISE, tail_dof=dof), frames) for dof in (1e12, None))
    assert_same_belief(tailed, gaussian, 1e-9)
