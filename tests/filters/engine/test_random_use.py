"""Any sequence of legal calls keeps the belief healthy (hypothesis draws the sequences)."""

from __future__ import annotations

import copy

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from filters import (
    BodyVelocity,
    InertialSamples,
    InertialUnit,
    Start,
    StereoEKF,
    StereoFilter,
    StereoObservation,
    UpdateReport,
    VelocityDriven,
    make_filter,
)
from filters.catalogue.registry import named_filters
from filters.checks.conformance import assert_healthy as assert_contract
from filters.checks.conformance import shown_arrays

from ..drives import CAMERA, INDEPENDENT_PIXELS
from ..slots import ERRORS, LANDMARKS, MEASUREMENTS

REST, UNIT = np.array([[0.0, -9.81, 0.0]]), InertialUnit(np.zeros(3), (0.0, 0.0, 0.0, 1.0), 1e-3, 1e-2, 1e-5, 1e-3)
# From half a metre in front of the first camera to practically infinity; the last ones have less than 0.2 px.
_UVD = np.random.default_rng(0).uniform([200, 50, 3], [1150, 340, 80], (14, 3))
_UVD[-4:, 2] = [800.0, 300.0, 0.15, 0.01]
POINTS = CAMERA.backproject(_UVD)
ODOMETRY = BodyVelocity([0.0, 0.0, 5.0], [0.0, 0.1, 0.0], np.diag(np.repeat([0.5, 0.05], 3) ** 2))

ids = st.lists(st.integers(0, len(POINTS) - 1), unique=True, max_size=len(POINTS))
seeds = st.integers(0, 2**16)
kinds = st.sampled_from(["exact", "noisy", "noisy", "noisy", "outliers", "d <= 0"])
time_steps = st.one_of(st.just(0.1), st.floats(-3.0, 1.0).map(lambda exponent: 10.0**exponent))
calls = st.one_of(
    st.tuples(st.just("predict"), time_steps, st.booleans()),
    st.tuples(st.just("update"), ids, seeds, kinds),
    st.tuples(st.just("update"), ids, seeds, st.just("noisy")),
    st.tuples(st.just("see_again")),
    st.tuples(st.just("forget"), ids),
    st.tuples(st.just("forecast")),
    st.tuples(st.just("reset"), seeds),
    st.tuples(st.just("refuse"), st.integers(0, 8)),
)
sequences = st.lists(calls, min_size=4, max_size=25)
options = st.fixed_dictionaries(
    {
        "landmark": st.sampled_from(sorted(LANDMARKS)),
        "measurement": st.sampled_from(sorted(MEASUREMENTS)),
        "error": st.sampled_from(sorted(ERRORS)),
        "gate": st.sampled_from([0.99, None]),
        "drop_unseen": st.booleans(),
        "iterations": st.sampled_from([1, 1, 2]),
        "min_disparity": st.sampled_from([None, 2.0]),
    }
)
common_options = st.fixed_dictionaries({"gate": st.sampled_from([0.99, 0.5, None]), "drop_unseen": st.booleans()})


def same_bits(first: StereoFilter, second: StereoFilter) -> bool:
    pairs = zip(shown_arrays(first), shown_arrays(second), strict=True)
    return all(np.array_equal(a, b, equal_nan=True) for a, b in pairs)


class Drive:
    """The truth beside a filter: a camera that goes straight on past `POINTS`."""

    def __init__(self, stereo_filter: StereoFilter, dead_reckoning: bool = False) -> None:
        self.stereo_filter = stereo_filter
        self.dead_reckoning = dead_reckoning
        self.reset(0)

    def reset(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.position, self.orientation = np.zeros(3), Rotation.from_rotvec(0.1 * rng.standard_normal(3))
        covariance = np.diag(np.repeat(10.0 ** rng.uniform(-4, -0.5, 4), 3) ** 2)
        velocity = self.orientation.apply([0, 0, 5.0])
        self.stereo_filter.reset(
            Start(self.position, self.orientation.as_quat(), velocity, covariance=covariance if seed % 3 else None)
        )
        self.last: StereoObservation | None = None
        assert len(self.stereo_filter.landmarks.ids) == 0

    def predict(self, dt: float, with_odometry: bool) -> None:
        self.position = self.position + self.orientation.apply([0, 0, 5.0]) * dt
        odometry = ODOMETRY if with_odometry or self.dead_reckoning else None
        self.stereo_filter.predict(dt, odometry, InertialSamples([dt], np.zeros((1, 3)), REST, UNIT))

    def update(self, seen: list[int], seed: int, kind: str) -> None:
        rng = np.random.default_rng(seed)
        points_c = self.orientation.inv().apply(POINTS[seen] - self.position) if seen else np.zeros((0, 3))
        # The sensor shows nothing that is behind it.
        seen = np.array(seen, dtype=np.int64)[points_c[:, 2] > 0.5]
        uvd = CAMERA.project(points_c[points_c[:, 2] > 0.5])
        scales = 10.0 ** rng.uniform(-1, 1, len(uvd)) if seed % 5 == 0 else np.ones(len(uvd))
        if kind == "noisy":
            errors = rng.multivariate_normal(np.zeros(3), INDEPENDENT_PIXELS.R, len(uvd))
            uvd += scales[:, None] * errors
        elif kind == "outliers":
            uvd[::2] = rng.uniform([0, 0, 0], [1343, 390, 100], (len(uvd[::2]), 3))
        elif kind == "d <= 0":
            uvd[::2, 2] = rng.choice([0.0, -1.0, -30.0], len(uvd[::2]))
        v_right = uvd[:, 1] + rng.standard_normal(len(uvd)) if seed % 2 else None
        R = scales[:, None, None] ** 2 * INDEPENDENT_PIXELS.R if seed % 5 == 0 else None
        self.look(StereoObservation(seen, uvd, v_right, R), reordered=seed % 4 == 0)

    def look(self, observation: StereoObservation, reordered: bool = False) -> None:
        before = set(self.stereo_filter.landmarks.ids.tolist())
        twin = copy.deepcopy(self.stereo_filter) if reordered else None
        report = self.stereo_filter.update(observation)
        released = getattr(self.stereo_filter, "options", None) is not None and self.stereo_filter.options.bodies
        assert_partition(report, set(observation.ids.tolist()), before, may_leave=bool(released))
        after = (before - set(report.dropped.tolist())) | set(report.initialised.tolist())
        assert set(self.stereo_filter.landmarks.ids.tolist()) == after
        if twin is not None:
            twin.update(observation.select(np.arange(len(observation))[::-1]))
            assert same_bits(twin, self.stereo_filter)
        self.last = observation

    def see_again(self) -> None:
        """The same frame once more: a camera that has stalled."""
        if self.last is not None:
            self.look(self.last)

    def forget(self, gone: list[int]) -> None:
        self.stereo_filter.forget(gone)
        assert not set(gone) & set(self.stereo_filter.landmarks.ids.tolist())

    def forecast(self) -> None:
        before = copy.deepcopy(self.stereo_filter)
        forecast = self.stereo_filter.forecast()
        np.testing.assert_array_equal(forecast.ids, self.stereo_filter.landmarks.ids)
        finite = np.isfinite(forecast.S).all(axis=(1, 2))
        assert (np.linalg.eigvalsh(forecast.S[finite]) > 0).all()
        assert np.isfinite(forecast.uvd[forecast.in_view]).all()
        assert same_bits(before, self.stereo_filter)

    def refuse(self, which: int) -> None:
        """A call with bad input raises `ValueError` and changes nothing."""
        before = copy.deepcopy(self.stereo_filter)
        attempts = (
            lambda: self.stereo_filter.predict(0.0),
            lambda: self.stereo_filter.predict(float("nan")),
            lambda: self.stereo_filter.predict(0.1, odometry=(1.0, 0.0, 0.0)),
            lambda: self.stereo_filter.update(None),
            lambda: self.stereo_filter.forecast([10**9]),
            lambda: self.stereo_filter.forget([0, 0]),
            lambda: self.stereo_filter.reset(Start(position=(np.nan, 0.0, 0.0))),
            lambda: self.stereo_filter.reset(Start(covariance=-np.eye(12))),
            lambda: self.stereo_filter.pose_error((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)),
        )
        with pytest.raises(ValueError, match=r"."):
            attempts[which]()
        assert same_bits(before, self.stereo_filter)

    def run(self, sequence: list[tuple]) -> None:
        assert_healthy(self.stereo_filter)
        for name, *arguments in sequence:
            getattr(self, name)(*arguments)
            assert_healthy(self.stereo_filter)


def assert_partition(report: UpdateReport, observed: set[int], before: set[int], *, may_leave: bool) -> None:
    """Every observed id is told once; known ones are corrected or say why not, new ones are started or say why not.

    An observed one `may_leave` the map where it is not on the body, or on the scene, that it was taken for.
    """
    known = [report.updated, report.gated, report.behind_camera, report.failed]
    new = [report.initialised, report.rejected]
    told = np.concatenate(known + new).tolist()
    assert len(told) == len(set(told))
    assert set(told) == observed
    assert set(np.concatenate(known).tolist()) == observed & before
    assert set(report.dropped.tolist()) <= (before if may_leave else before - observed)
    assert np.isfinite(report.nis)
    assert report.nis >= 0
    # Each landmark brings 2 to 4 numbers; one refused in the right eye may have brought its left pixel.
    assert report.nis_dof <= 4 * len(observed & before)


def assert_healthy(stereo_filter: StereoFilter) -> None:
    """What `check_filter` asks for, and as strictly as our own filters can keep it."""
    assert_contract(stereo_filter)
    pose, velocity, landmarks = stereo_filter.pose, stereo_filter.velocity, stereo_filter.landmarks
    assert abs(np.linalg.norm(pose.orientation) - 1.0) < 1e-12
    for covariance in (pose.covariance, velocity.covariance):
        np.testing.assert_array_equal(covariance, covariance.T)
        assert (np.diag(covariance) >= 0).all()
    assert (np.diff(landmarks.ids) > 0).all()


drawn = settings(
    deadline=None, derandomize=True, suppress_health_check=list(HealthCheck), database=None, print_blob=False
)


@settings(drawn, max_examples=120)
@given(options=options, dead_reckoning=st.booleans(), sequence=sequences)
def test_random_sequences_of_calls(options: dict, dead_reckoning: bool, sequence: list[tuple]) -> None:
    motion = VelocityDriven() if dead_reckoning else None
    Drive(StereoEKF(CAMERA, INDEPENDENT_PIXELS, motion=motion, **options), dead_reckoning).run(sequence)


@pytest.mark.parametrize("name", sorted(named_filters()))
@settings(drawn, max_examples=30)
@given(options=common_options, sequence=sequences)
def test_random_sequences_of_calls_to_named_filters(name: str, options: dict, sequence: list[tuple]) -> None:
    if name == "submaps":  # its purpose is to keep what is out of view
        options = {**options, "drop_unseen": False}
    Drive(make_filter(name, camera=CAMERA, noise=INDEPENDENT_PIXELS, **options)).run(sequence)
