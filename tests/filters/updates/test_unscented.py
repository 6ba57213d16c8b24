"""Statistical linearisation: Jacobians where the model is straight, something better where it is not."""

from __future__ import annotations

import numpy as np
import pytest
from filterpy.kalman import MerweScaledSigmaPoints, unscented_transform
from scipy.spatial.transform import Rotation

from filters import InverseDepth, Start, StereoEKF, StereoObservation, check_filter
from filters.checks.conformance import REFERENCE_CAMERA as CAMERA
from filters.checks.conformance import REFERENCE_NOISE as NOISE
from filters.geometry import symmetric

from ..dense import Linearised, linearised
from ..engine.combinations import Case, figures, run_case

COUNT = 6
LANDMARKS = ("inverse-depth", "shared-anchor", "euclidean", "hybrid")


def started(
    landmark: str, velocity_sigma: float, depth_disparity: tuple[float, float] = (8.0, 30.0), update: str = "extended"
) -> StereoEKF:
    """A filter that has seen a few landmarks once and has moved since."""
    rng = np.random.default_rng(3)
    slam = StereoEKF(CAMERA, NOISE, landmark=landmark, gate=None, error="so3", update=update)
    slam.reset(
        Start(
            linear_velocity=(0, 0, 5),
            covariance=np.diag(np.repeat([1e-4, 1e-4, velocity_sigma, velocity_sigma / 10], 3) ** 2),
        )
    )
    low, high = depth_disparity
    uvd = rng.uniform((300, 80, low), (1000, 320, high), (COUNT, 3))
    slam.update(StereoObservation(np.arange(COUNT), uvd))
    slam.predict(0.1)
    return slam


def both(slam: StereoEKF) -> tuple[Linearised, Linearised]:
    """By Jacobians and by sigma points, of measurements of zero."""
    fitted = StereoEKF(CAMERA, NOISE, landmark=slam.options.landmark, gate=None, error="so3", update="unscented")
    fitted.state = slam.state
    seen = StereoObservation(np.arange(COUNT), np.zeros((COUNT, 3)))
    return linearised(slam, seen), linearised(fitted, seen)


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
    """Mean and covariance of the measurement: what H leaves of it is in R."""
    slam = started(landmark, 4.0, (2.5, 12.0) if landmark != "euclidean" else (6.0, 12.0))
    _, fitted = both(slam)
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


@pytest.mark.parametrize("landmark", LANDMARKS)
def test_where_the_state_is_known_well_it_predicts_like_the_jacobians(landmark: str) -> None:
    slam = started(landmark, 1e-3, (60.0, 90.0))
    state = slam.state
    state.P *= 1e-6
    slam.state = state
    analytic, fitted = both(slam)
    np.testing.assert_allclose(fitted.innovation, analytic.innovation, atol=1e-6)
    P = slam.state.P
    np.testing.assert_allclose(fitted.innovation_covariances(P), analytic.innovation_covariances(P), rtol=1e-6)


@pytest.mark.parametrize("landmark", LANDMARKS)
def test_mean_and_covariance_are_nearer_to_monte_carlo_where_it_is_not(landmark: str) -> None:
    slam = started(landmark, 4.0, (2.5, 12.0) if landmark != "euclidean" else (6.0, 12.0))
    analytic, fitted = both(slam)
    P = symmetric.full(slam.state.P)
    values, vectors = np.linalg.eigh(P)
    draws = np.random.default_rng(0).standard_normal((20_000, len(P))) * np.sqrt(np.maximum(values, 0)) @ vectors.T
    state, index = slam.state, np.arange(COUNT)
    mean_errors, spread_errors = [], []
    for i in index:
        z = measured_at(state, i, draws[:, rows_of(state, i)])
        z += np.random.default_rng(1).multivariate_normal(np.zeros(3), NOISE.R, len(z))
        for name, linear in (("analytic", analytic), ("fitted", fitted)):
            S = linear.innovation_covariances(slam.state.P)[i]
            mean_errors.append((name, np.linalg.norm((-linear.innovation[i] - z.mean(axis=0)) / z.std(axis=0))))
            spread_errors.append((name, np.abs(np.diag(S) / z.var(axis=0) - 1).max()))
    for errors in (mean_errors, spread_errors):
        by = {name: np.mean([value for who, value in errors if who == name]) for name in ("analytic", "fitted")}
        assert by["fitted"] < by["analytic"]


@pytest.mark.parametrize("landmark", LANDMARKS)
def test_it_conforms(landmark: str) -> None:
    check_filter(lambda camera, noise: StereoEKF(camera, noise, landmark=landmark, update="unscented"))


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


def test_first_estimates_have_no_place_in_it() -> None:
    with pytest.raises(
        ValueError, match=r"error must linearise at the state with update=Unscented.*got FirstEstimates"
    ):
        StereoEKF(CAMERA, NOISE, update="unscented", error="first-estimates")
