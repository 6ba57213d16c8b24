"""Any sequence of legal calls keeps the belief healthy (hypothesis draws the sequences)."""

from __future__ import annotations

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from filters import BodyVelocity, StereoEKF, StereoObservation, UpdateReport, VelocityDriven
from filters.engine.error_definition import ERRORS
from filters.engine.options import LANDMARKS, MEASUREMENTS

from .drives import CAMERA, INDEPENDENT_PIXELS

POINTS = CAMERA.backproject(np.random.default_rng(0).uniform([200, 50, 3], [1150, 340, 80], (12, 3)))
ODOMETRY = BodyVelocity([0.0, 0.0, 5.0], [0.0, 0.1, 0.0], np.diag(np.repeat([0.5, 0.05], 3) ** 2))

ids = st.lists(st.integers(0, len(POINTS) - 1), unique=True, max_size=len(POINTS))
seeds = st.integers(0, 2**16)
calls = st.one_of(
    st.tuples(st.just("predict"), st.floats(0.01, 0.5), st.booleans()),
    st.tuples(st.just("update"), ids, seeds, st.sampled_from(["exact", "noisy", "noisy", "outliers", "d <= 0"])),
    st.tuples(st.just("update"), ids, seeds, st.just("noisy")),
    st.tuples(st.just("forget"), ids),
    st.tuples(st.just("forecast")),
    st.tuples(st.just("reset"), seeds),
)
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


class Drive:
    """The truth beside a filter: a camera that goes straight on past `POINTS`."""

    def __init__(self, stereo_filter: StereoEKF, dead_reckoning: bool) -> None:
        self.stereo_filter = stereo_filter
        self.dead_reckoning = dead_reckoning
        self.reset(0)

    def reset(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.position, self.orientation = np.zeros(3), Rotation.from_rotvec(0.1 * rng.standard_normal(3))
        covariance = np.diag(np.repeat(10.0 ** rng.uniform(-4, -0.5, 4), 3) ** 2)
        velocity = self.orientation.apply([0, 0, 5.0])
        self.stereo_filter.reset(
            self.position, self.orientation.as_quat(), velocity, covariance=covariance if seed % 3 else None
        )

    def predict(self, dt: float, with_odometry: bool) -> None:
        self.position = self.position + self.orientation.apply([0, 0, 5.0]) * dt
        self.stereo_filter.predict(dt, ODOMETRY if with_odometry or self.dead_reckoning else None)

    def update(self, seen: list[int], seed: int, kind: str) -> None:
        rng = np.random.default_rng(seed)
        points_c = self.orientation.inv().apply(POINTS[seen] - self.position) if seen else np.zeros((0, 3))
        # The sensor shows nothing that is behind it.
        seen = np.array(seen, dtype=np.int64)[points_c[:, 2] > 0.5]
        uvd = CAMERA.project(points_c[points_c[:, 2] > 0.5])
        if kind == "noisy":
            uvd += rng.multivariate_normal(np.zeros(3), INDEPENDENT_PIXELS.R, len(uvd))
        elif kind == "outliers":
            uvd[::2] = rng.uniform([0, 0, 0], [1343, 390, 100], (len(uvd[::2]), 3))
        elif kind == "d <= 0":
            uvd[::2, 2] = rng.choice([0.0, -1.0, -30.0], len(uvd[::2]))
        v_right = uvd[:, 1] if seed % 2 else None
        before = set(self.stereo_filter.landmarks.ids.tolist())
        report = self.stereo_filter.update(StereoObservation(seen, uvd, v_right))
        assert_partition(report, set(seen.tolist()), before)

    def forget(self, gone: list[int]) -> None:
        self.stereo_filter.forget(gone)
        assert not set(gone) & set(self.stereo_filter.landmarks.ids.tolist())

    def forecast(self) -> None:
        forecast = self.stereo_filter.forecast()
        np.testing.assert_array_equal(forecast.ids, self.stereo_filter.landmarks.ids)
        finite = np.isfinite(forecast.S).all(axis=(1, 2))
        assert (np.linalg.eigvalsh(forecast.S[finite]) > 0).all()


def assert_partition(report: UpdateReport, observed: set[int], before: set[int]) -> None:
    """Every observed id is told once; known ones are corrected or say why not, new ones are started or say why not."""
    known = [report.updated, report.gated, report.behind_camera, report.failed]
    new = [report.initialised, report.rejected]
    told = np.concatenate(known + new).tolist()
    assert len(told) == len(set(told))
    assert set(told) == observed
    assert set(np.concatenate(known).tolist()) == observed & before
    assert set(report.dropped.tolist()) <= before - observed
    assert np.isfinite(report.nis)
    assert report.nis >= 0
    # Each landmark brings 2 to 4 numbers; one refused in the right eye may have brought its left pixel.
    assert report.nis_dof <= 4 * len(observed & before)


def assert_healthy(stereo_filter: StereoEKF) -> None:
    pose, velocity, landmarks = stereo_filter.pose, stereo_filter.velocity, stereo_filter.landmarks
    for array in (pose.position, pose.covariance, velocity.linear, velocity.angular, velocity.covariance):
        assert np.isfinite(array).all()
    assert abs(np.linalg.norm(pose.orientation) - 1.0) < 1e-12
    for covariance in (pose.covariance, velocity.covariance):
        np.testing.assert_array_equal(covariance, covariance.T)
        assert (np.diag(covariance) >= 0).all()
    sigmas = np.sqrt(np.diag(pose.covariance))
    assert np.linalg.eigvalsh(pose.covariance / np.outer(sigmas, sigmas)).min() > 0
    assert (landmarks.inverse_distance_variance >= 0).all()
    assert (np.diff(landmarks.ids) > 0).all()


@settings(max_examples=120, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck), database=None)
@given(options=options, dead_reckoning=st.booleans(), sequence=st.lists(calls, min_size=4, max_size=25))
def test_random_sequences_of_calls(options: dict, dead_reckoning: bool, sequence: list[tuple]) -> None:
    motion = VelocityDriven() if dead_reckoning else None
    drive = Drive(StereoEKF(CAMERA, INDEPENDENT_PIXELS, motion=motion, **options), dead_reckoning)
    assert_healthy(drive.stereo_filter)
    for name, *arguments in sequence:
        getattr(drive, name)(*arguments)
        assert_healthy(drive.stereo_filter)
