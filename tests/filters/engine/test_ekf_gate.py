"""Measurements that are not used: outliers, landmarks behind the camera, disparities that start nothing."""

from __future__ import annotations

import copy

import numpy as np
import pytest
from scipy.stats import binom

from filters import ConstantVelocity, Start, StereoEKF, StereoObservation
from filters.geometry import symmetric

from .. import textbook
from ..dense import plus
from ..drives import CAMERA, DT, INDEPENDENT_PIXELS, SPEED, drive, run
from .beliefs import assert_identical, assert_same_belief, make, snapshot, tilted

MODELS = [
    ("joint", False),
    ("sequential", False),
    ("sequential", True),
    ("stacked", False),
    ("stacked", True),
    ("left", False),
]
GATES = [("inverse-depth", *model, "extended", 0.99) for model in MODELS]
GATES += [("euclidean", *model, "extended", p) for model in MODELS for p in (0.5, 0.9, 0.99)]
GATES += [("shared-anchor", "joint", False, update, p) for update in ("extended", "unscented") for p in (0.5, 0.99)]


@pytest.mark.parametrize(("landmark", "measurement", "v_right", "update", "probability"), GATES)
def test_the_gate_passes_consistent_measurements_at_its_nominal_rate(
    landmark: str, measurement: str, v_right: bool, update: str, probability: float
) -> None:
    """2400 measurements drawn from the filter's own belief; the pose is nearly known, so they are independent."""
    count, draws = 30, 80
    rng = np.random.default_rng(9)
    uvd = rng.uniform([200.0, 60.0, 15.0], [1200.0, 330.0, 60.0], (count, 3))
    motion = ConstantVelocity(1e-3, 1e-4)
    stereo_filter = make(landmark=landmark, measurement=measurement, update=update, gate=probability, motion=motion)
    stereo_filter.reset(Start(linear_velocity=(0.0, 0.0, SPEED), covariance=np.diag(np.repeat(1e-10, 12))))
    stereo_filter.update(StereoObservation(np.arange(count), uvd))
    stereo_filter.predict(DT)
    P = symmetric.full(stereo_filter.state.P)
    values, vectors = np.linalg.eigh(P)
    root = vectors * np.sqrt(np.maximum(values, 0))
    passed = 0
    for _ in range(draws):
        error = root @ rng.standard_normal(len(P))
        truth = copy.deepcopy(stereo_filter)
        truth.state = plus(stereo_filter.state, error)
        exact = truth.forecast().uvd
        z = exact + rng.multivariate_normal(np.zeros(3), INDEPENDENT_PIXELS.R, count)
        row = exact[:, 1] + rng.standard_normal(count) if v_right else None
        report = copy.deepcopy(stereo_filter).update(StereoObservation(np.arange(count), z, row))
        assert len(report.updated) + len(report.gated) == count
        passed += len(report.updated)
    low, high = binom.ppf([0.001, 0.999], count * draws, probability)
    assert low <= passed <= high


def before_an_update(**options) -> tuple[StereoEKF, StereoObservation, int]:
    """A filter after a prediction, a consistent frame, and a known landmark in it."""
    stereo_filter = make(gate=0.99, drop_unseen=False, **options)
    frames = drive(10, 5, missed=0.0, depths=(6.0, 30.0))
    list(run(stereo_filter, frames[:4]))
    stereo_filter.predict(DT)
    seen = frames[4].observation
    return stereo_filter, seen, int(np.intersect1d(seen.ids, stereo_filter.landmarks.ids)[2])


def with_outlier(stereo_filter: StereoEKF, seen: StereoObservation, victim: int, axis: int) -> np.ndarray:
    """The frame's (u, v, d) with `victim` where it is expected, but 20 sigma off along one axis."""
    forecast = stereo_filter.forecast([victim])
    uvd = seen.uvd.copy()
    uvd[seen.ids == victim] = forecast.uvd[0]
    uvd[seen.ids == victim, axis] += 20 * np.sqrt(forecast.S[0, axis, axis])
    return uvd


OUTLIERS = [("joint", 0), ("joint", 1), ("joint", 2), ("stacked", 0), ("stacked", 1), ("stacked", 2)]
OUTLIERS += [("sequential", 0), ("sequential", 1), ("left", 0), ("left", 1)]


@pytest.mark.parametrize(("measurement", "axis"), OUTLIERS)
def test_an_outlier_is_gated_and_leaves_the_estimate_as_if_it_had_not_been_there(measurement: str, axis: int) -> None:
    stereo_filter, seen, victim = before_an_update(measurement=measurement)
    uvd = with_outlier(stereo_filter, seen, victim, axis)
    without = copy.deepcopy(stereo_filter)
    report = stereo_filter.update(StereoObservation(seen.ids, uvd))
    expected = without.update(seen.select(seen.ids != victim))
    assert victim in report.gated
    assert victim not in report.updated
    np.testing.assert_array_equal(report.updated, expected.updated)
    assert (report.nis, report.nis_dof) == (expected.nis, expected.nis_dof)
    assert_identical(snapshot(stereo_filter), snapshot(without))


def test_two_observers_judge_each_eye_by_itself() -> None:
    """A wrong disparity shows in the right eye only: the left pixel has been used, the right one has not."""
    stereo_filter, seen, victim = before_an_update(measurement="sequential")
    uvd = with_outlier(stereo_filter, seen, victim, 2)
    left_only = copy.deepcopy(stereo_filter)
    report = stereo_filter.update(StereoObservation(seen.ids, uvd))
    assert victim in report.gated
    assert victim not in report.updated
    # The same frame, where the victim's u_right carries no information.
    R = np.tile(INDEPENDENT_PIXELS.R, (len(seen), 1, 1))
    R[seen.ids == victim] = np.diag([1.0, 1.0, 1e14])
    left_only.update(StereoObservation(seen.ids, uvd, R=R))
    assert_same_belief(stereo_filter, left_only, 1e-9)


def test_a_frame_of_outliers_only_changes_no_bit() -> None:
    stereo_filter = make(gate=0.99, drop_unseen=False)
    frames = drive(11, 3, missed=0.0)
    list(run(stereo_filter, frames[:2]))
    stereo_filter.predict(DT)
    before = snapshot(stereo_filter)
    forecast = stereo_filter.forecast()
    report = stereo_filter.update(StereoObservation(forecast.ids, forecast.uvd + np.array([0.0, 500.0, 0.0])))
    assert len(report.gated) == len(forecast.ids)
    assert_identical(snapshot(stereo_filter), before)


# --- at and beyond infinity, behind the camera ---


@pytest.mark.parametrize("landmark", ["inverse-depth", "shared-anchor"])
def test_a_negative_disparity_is_the_point_behind_of_the_literal_equations(landmark: str) -> None:
    """Eq. 21-24 put it behind with rho > 0; the forward ray with rho < 0 has the same projection from anywhere."""
    stereo_filter = tilted(make(landmark=landmark, drop_unseen=False))
    z = np.array([[800.0, 150.0, -0.7], [300.0, 300.0, -3.0]])
    report = stereo_filter.update(StereoObservation([1, 2], z))
    assert report.initialised.tolist() == [1, 2]
    assert (stereo_filter.landmarks.inverse_distance < 0).all()
    np.testing.assert_allclose(stereo_filter.forecast().uvd, z, rtol=1e-12)

    pose = np.concatenate([stereo_filter.pose.position, stereo_filter.pose.orientation])
    literal = [textbook.new_inverse_depth(CAMERA, pose, row).real for row in z]
    stereo_filter.predict(0.3)
    pose = np.concatenate([stereo_filter.pose.position, stereo_filter.pose.orientation])
    expected = [textbook.project(CAMERA, pose, textbook.point_of_inverse_depth(y)) for y in literal]
    np.testing.assert_allclose(stereo_filter.forecast().uvd, expected, rtol=1e-10)
    points = [textbook.point_of_inverse_depth(y) for y in literal]
    np.testing.assert_allclose(stereo_filter.landmarks.positions, points, rtol=1e-10)


@pytest.mark.parametrize(
    ("options", "disparities", "rejected"),
    [
        ({"landmark": "euclidean"}, (-1.0, 0.0, 1e-3, 2.0), [0, 1]),
        ({"landmark": "euclidean", "min_disparity": 5.0}, (4.99, 5.0, 6.0), [0]),
        ({"landmark": "inverse-depth", "min_disparity": 5.0}, (4.99, 5.0, 6.0), [0]),
    ],
)
def test_what_no_landmark_can_start_from_is_reported(options: dict, disparities: tuple, rejected: list[int]) -> None:
    stereo_filter, ids = make(**options), np.arange(len(disparities))[::-1]
    report = stereo_filter.update(StereoObservation(ids, [[700.0, 190.0, disparities[i]] for i in ids]))
    assert report.rejected.tolist() == rejected
    assert report.initialised.tolist() == stereo_filter.landmarks.ids.tolist() == sorted(set(ids) - set(rejected))


@pytest.mark.parametrize("gate", [0.99, None])
@pytest.mark.parametrize("measurement", ["joint", "sequential", "stacked", "left"])
@pytest.mark.parametrize("landmark", ["inverse-depth", "shared-anchor", "euclidean"])
def test_a_landmark_behind_is_counted_and_not_used(landmark: str, measurement: str, gate: float | None) -> None:
    """Id 1 has been driven past; the others correct the state as if it had not been observed."""
    stereo_filter = make(landmark=landmark, measurement=measurement, gate=gate, drop_unseen=False)
    uvd = [[700.0, 190.0, 200.0], [600.0, 150.0, 20.0], [800.0, 250.0, 25.0]]
    stereo_filter.update(StereoObservation([1, 2, 3], uvd))
    stereo_filter.predict(1.0)
    assert stereo_filter.forecast([1]).in_view.tolist() == [False]
    forecast = stereo_filter.forecast([2, 3]).uvd
    without = copy.deepcopy(stereo_filter)
    report = stereo_filter.update(StereoObservation([1, 2, 3], [[700.0, 190.0, 200.0], *forecast]))
    without.update(StereoObservation([2, 3], forecast))
    assert report.behind_camera.tolist() == [1]
    assert report.updated.tolist() == [2, 3]
    assert_identical(snapshot(stereo_filter), snapshot(without))


@pytest.mark.parametrize("measurement", ["joint", "sequential", "stacked", "left"])
def test_a_failed_factorisation_is_named_by_id_and_the_measurement_not_used(measurement: str) -> None:
    """A covariance broken from outside, for one landmark of three: nothing is raised."""
    stereo_filter = make(measurement=measurement, drop_unseen=False)
    uvd = [[700.0, 190.0, 30.0], [600.0, 150.0, 20.0], [800.0, 250.0, 25.0]]
    stereo_filter.update(StereoObservation([1, 2, 3], uvd))
    stereo_filter.predict(DT)
    state = stereo_filter.state
    rows = state.map_rows(np.flatnonzero(state.ids == 2))[0, 3:]
    state.P[rows, rows] = -1.0
    stereo_filter.state = state
    forecast = stereo_filter.forecast([1, 3])
    without = copy.deepcopy(stereo_filter)
    report = stereo_filter.update(StereoObservation([1, 2, 3], [forecast.uvd[0], uvd[1], forecast.uvd[1]]))
    without.update(StereoObservation([1, 3], forecast.uvd))
    assert report.failed.tolist() == [2]
    assert report.failed_factorisations == 1
    assert report.updated.tolist() == [1, 3]
    np.testing.assert_allclose(stereo_filter.pose.covariance, without.pose.covariance, rtol=1e-9, atol=1e-15)
