"""Statistical linearisation: Jacobians where the model is straight, something better where it is not."""

from __future__ import annotations

import numpy as np
import pytest
from filterpy.kalman import MerweScaledSigmaPoints, unscented_transform
from scipy.spatial.transform import Rotation

from filters import InverseDepth, Start, StereoEKF, StereoObservation
from filters.checks.conformance import REFERENCE_CAMERA as CAMERA
from filters.checks.conformance import REFERENCE_NOISE as NOISE
from filters.geometry import symmetric

from ..dense import linearised
from ..engine.combinations import Case, figures, run_case

COUNT = 6
LANDMARKS = ("inverse-depth", "shared-anchor", "euclidean", "hybrid")


def rows_of(state, i: int) -> np.ndarray:
    """Rows of the error state that the measurement of a landmark depends on: of the pose, then its own."""
    return np.concatenate([np.arange(6), state.map_rows(np.array([i]))[0]])


def measured_at(state, i: int, errors: np.ndarray) -> np.ndarray:
    """(u, v, d) of a landmark where the state has errors (N, w) in these rows; (N, 3)."""
    index = np.array([i])
    anchors = state.anchors(index)[0] + errors[:, 6:9] if state.model.anchored else None
    parameters = state.parameters(index)[0] + errors[:, -3:]
    seen = state.model.relative_to(state.camera.position + errors[:, :3], anchors, parameters).homogeneous
    R_wc = state.camera.R_wc @ Rotation.from_rotvec(errors[:, 3:6]).as_matrix()
    return CAMERA.project_scaled(np.einsum("nij,ni->nj", R_wc, seen[:, :3]), seen[:, 3])


@pytest.mark.parametrize("landmark", LANDMARKS)
def test_it_is_the_unscented_transform_of_filterpy(landmark: str) -> None:
    """Mean and covariance of the measurement, of landmarks seen once before a vague step: H leaves the rest in R."""
    rng = np.random.default_rng(3)
    slam = StereoEKF(CAMERA, NOISE, landmark=landmark, gate=None, error="so3", update="unscented")
    sigmas = np.repeat([1e-4, 1e-4, 4.0, 0.4], 3)
    slam.reset(Start(linear_velocity=(0, 0, 5), covariance=np.diag(sigmas**2)))
    uvd = rng.uniform((300, 80, 6.0 if landmark == "euclidean" else 2.5), (1000, 320, 12.0), (COUNT, 3))
    slam.update(StereoObservation(np.arange(COUNT), uvd))
    slam.predict(0.1)
    fitted = linearised(slam, StereoObservation(np.arange(COUNT), np.zeros((COUNT, 3))))
    state, P = slam.state, symmetric.full(slam.state.P)
    S = fitted.innovation_covariances(state.P)
    for i in range(COUNT):
        rows = rows_of(state, i)
        points = MerweScaledSigmaPoints(len(rows), 0.5, 2.0, 3.0 - len(rows))
        z = measured_at(state, i, points.sigma_points(np.zeros(len(rows)), P[np.ix_(rows, rows)]))
        mean, covariance = unscented_transform(z, points.Wm, points.Wc, NOISE.R)
        sigma = np.sqrt(np.diag(covariance))
        np.testing.assert_allclose((fitted.innovation[i] + mean) / sigma, 0.0, atol=1e-10)
        np.testing.assert_allclose(S[i] / np.outer(sigma, sigma), covariance / np.outer(sigma, sigma), atol=1e-9)
        left = fitted.R[i] - NOISE.R
        assert np.linalg.eigvalsh(left)[-1] > 1e-3
        np.testing.assert_allclose(left, left.T, atol=1e-12)


class ByNumbers(InverseDepth):
    """The same functions in Python."""

    in_machine_code = False


@pytest.mark.parametrize(
    "options",
    [
        {"error": "so3", "measurement": "sequential", "consensus": True},
        {"error": "right-invariant", "measurement": "stacked", "iterations": 3, "drop_unseen": False},
        {"error": "quaternion", "tail_dof": 4.0, "drift": 0.4},
    ],
)
def test_functions_in_python_do_the_same(options: dict) -> None:
    compiled, in_python = (
        figures(*run_case(Case("", {"landmark": landmark, "update": "unscented", **options}, 3)), False)
        for landmark in (InverseDepth(), ByNumbers())
    )
    np.testing.assert_allclose(compiled, in_python, rtol=1e-9, atol=1e-9)
