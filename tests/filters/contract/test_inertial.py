"""Samples of an inertial unit: what they are, what is refused, and who uses them (3 s)."""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np
import pytest

from filters import BodyVelocity, FilterBatch, InertialSamples, Pose, Start, StereoEKF, make_filter, shown_arrays
from filters.geometry import rotations
from filters.geometry.derivatives import jacobian
from filters.motions.constant_velocity import moved_by

from ..drives import CAMERA, INDEPENDENT_PIXELS
from ..inertial_drives import DT, GRAVITY, TURN, UNIT, Journey, driven

SAMPLES = InertialSamples([0.04, 0.1], np.ones((2, 3)), np.ones((2, 3)), UNIT)
STILL = InertialSamples([0.04, 0.1], np.zeros((2, 3)), np.tile(TURN.inv().apply(-GRAVITY), (2, 1)), UNIT)
ODOMETRY = BodyVelocity(np.zeros(3), np.zeros(3), np.eye(6))


@pytest.mark.parametrize(
    ("given", "changed", "message"),
    [
        *(
            (SAMPLES, {"times": times}, r"^inertial.times must ascend from above 0")
            for times in ([0.1, 0.04], [0.0, 0.1], [])
        ),
        (
            SAMPLES,
            {"angular_rates": np.ones((3, 3))},
            r"^inertial.angular_rates must have shape \(2, 3\), got \(3, 3\)",
        ),
        (SAMPLES, {"specific_forces": np.full((2, 3), np.nan)}, r"^inertial.specific_forces must be finite"),
        (SAMPLES, {"angular_rates": np.full((2, 3), 1e7)}, r"^inertial.angular_rates must be at most 1e\+06 rad/s"),
        (SAMPLES, {"unit": "ADIS16448"}, r"^inertial.unit must be an InertialUnit, got 'ADIS16448'$"),
        (UNIT, {"gyro_walk": -1.0}, r"^unit.gyro_walk must be a finite number >= 0, got -1.0$"),
        (UNIT, {"orientation": (0.0, 0.0, 0.0, 2.0)}, r"^unit.orientation must be a unit quaternion"),
    ],
)
def test_wrong_samples_and_units_are_refused_in_one_line(given: object, changed: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(given, **changed)  # type: ignore[type-var]


@pytest.mark.parametrize("dt", [0.05, 0.099, 0.2])
def test_samples_are_those_of_the_step(dt: float) -> None:
    """Absolute times, or those of another step, would be integrated without a word."""
    slam = make_filter("inertial", camera=CAMERA, noise=INDEPENDENT_PIXELS)
    before = shown_arrays(slam)
    with pytest.raises(ValueError, match=r"^inertial.times must end with the step, at .* s, got 0.1 s"):
        slam.predict(dt, inertial=SAMPLES)
    for now, then in zip(shown_arrays(slam), before, strict=True):
        np.testing.assert_array_equal(now, then)


def test_steps_are_joined() -> None:
    joined = SAMPLES.followed_by(SAMPLES, 0.11)
    np.testing.assert_allclose(joined.times, [0.04, 0.11, 0.15, 0.21])
    assert joined.specific_forces.shape == (4, 3)


def test_a_filter_says_once_that_it_makes_no_use_of_samples(caplog: pytest.LogCaptureFixture) -> None:
    slam = make_filter("inverse-depth", camera=CAMERA, noise=INDEPENDENT_PIXELS)
    with caplog.at_level(logging.WARNING):
        for _ in range(3):
            slam.predict(DT, inertial=SAMPLES)
    assert [record.getMessage() for record in caplog.records] == [
        f"{type(slam).__name__} makes no use of the inertial samples that it is given"
    ]


def test_odometry_is_fused_with_samples() -> None:
    """Wheels of standard deviation .001 say that it stands still; no clone is left of the fusion."""
    slam = make_filter("inertial", camera=CAMERA, noise=INDEPENDENT_PIXELS)
    slam.reset(Start(linear_velocity=np.array([0.2, 0.0, 0.0]), covariance=np.diag(np.repeat([1e-6, 0.25], 6))))
    slam.predict(DT, BodyVelocity(np.zeros(3), np.zeros(3), 1e-6 * np.eye(6)), STILL)
    assert np.linalg.norm(slam.pose.position) < 1e-3
    assert np.abs(slam.velocity.linear).max() < 0.02
    assert np.sqrt(np.diag(slam.velocity.covariance)[:3]).max() < 0.03  # of .5: what is left is the accelerometers'
    assert slam.clones == ()


def test_odometry_as_a_relative_pose() -> None:
    """Innovation of the pose that it says: none; covariance by differences of that pose, first order."""
    rng = np.random.default_rng(3)
    twist, A = rng.normal(0.0, 1.0, 6), rng.normal(0.0, 0.1, (6, 6))

    def pose_of(numbers: np.ndarray) -> Pose:
        turn = rotations.exp_quaternion(DT * numbers[3:])
        return Pose(rotations.exp(0.5 * DT * numbers[3:]) @ numbers[:3] * DT, turn)

    there = pose_of(twist)
    innovation, R = moved_by(BodyVelocity(twist[:3], twist[3:], A @ A.T), DT, there)
    np.testing.assert_allclose(innovation, 0.0, atol=1e-12)

    def error(delta: np.ndarray) -> np.ndarray:
        moved = pose_of(twist + delta)
        return np.concatenate([moved.position - there.position, rotations.log(there.R_wc.T @ moved.R_wc)])

    J = jacobian(error, 6)
    np.testing.assert_allclose(R, J @ A @ A.T @ J.T, atol=1e-9)


def test_a_batch_with_samples_refuses_odometry() -> None:
    batch = FilterBatch(lambda: make_filter("inertial", camera=CAMERA, noise=INDEPENDENT_PIXELS), 2)
    with pytest.raises(ValueError, match=r"^odometry must be None in a batch with inertial samples"):
        batch.predict(DT, [ODOMETRY, None], [SAMPLES, SAMPLES])


def test_a_subclass_of_odometry_is_refused() -> None:
    """What it adds, such as m/s^2 where m/s are expected, no filter would know of."""

    class Accelerations(BodyVelocity):
        """With more in it."""

    slam = StereoEKF(CAMERA, INDEPENDENT_PIXELS)
    with pytest.raises(ValueError, match=r"^odometry must be a BodyVelocity itself, got the subclass Accelerations"):
        slam.predict(DT, Accelerations(np.zeros(3), np.zeros(3), np.eye(6)))


def test_a_filter_without_its_samples_says_what_it_needs() -> None:
    slam = make_filter("inertial", camera=CAMERA, noise=INDEPENDENT_PIXELS)
    with pytest.raises(ValueError, match=r"^inertial must be given in every predict with motion=Strapdown\(\)"):
        slam.predict(DT)
    with pytest.raises(ValueError, match=r"^inertial must be InertialSamples or None, got ndarray$"):
        slam.predict(DT, inertial=np.zeros((4, 6)))  # type: ignore[arg-type]


def test_a_batch_has_the_bits_of_its_filters() -> None:
    journeys = [Journey.along(driven, seed, 1.0) for seed in (0, 1)]

    def made() -> StereoEKF:
        slam = make_filter("inertial", camera=CAMERA, noise=INDEPENDENT_PIXELS)
        assert isinstance(slam, StereoEKF)
        return slam

    batch = FilterBatch(made, 2)
    batch.reset([journey.start for journey in journeys])
    for k, steps in enumerate(zip(*(journey.steps for journey in journeys), strict=True)):
        seen = [step.observation for step in steps]
        if k == 0:
            batch.update(seen)
        elif k % 2:
            batch.step(DT, seen, inertial=[step.inertial for step in steps])
        else:
            batch.predict(DT, inertial=[step.inertial for step in steps])
            batch.update(seen)
    for b, journey in enumerate(journeys):
        alone = made()
        journey.run(alone)
        for one, other in zip(shown_arrays(batch[b]), shown_arrays(alone), strict=True):
            np.testing.assert_array_equal(one, other)
