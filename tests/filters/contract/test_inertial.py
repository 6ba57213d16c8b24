"""Samples of an inertial unit: what they are, what is refused, and who uses them (3 s)."""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np
import pytest

from filters import BodyVelocity, FilterBatch, InertialSamples, InertialUnit, StereoEKF, make_filter, shown_arrays

from ..drives import CAMERA, INDEPENDENT_PIXELS
from ..inertial_drives import DT, UNIT, Journey, driven

SAMPLES = InertialSamples([0.04, 0.1], np.ones((2, 3)), np.ones((2, 3)), UNIT)
ODOMETRY = BodyVelocity(np.zeros(3), np.zeros(3), np.eye(6))


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"times": [0.1, 0.04]}, r"^inertial.times must ascend from above 0, one at least: count them from the last"),
        ({"times": [0.0, 0.1]}, r"^inertial.times must ascend from above 0"),
        ({"times": []}, r"^inertial.times must ascend from above 0"),
        ({"angular_rates": np.ones((3, 3))}, r"^inertial.angular_rates must have shape \(2, 3\), got \(3, 3\)"),
        ({"specific_forces": np.full((2, 3), np.nan)}, r"^inertial.specific_forces must be finite"),
        ({"angular_rates": np.full((2, 3), 1e7)}, r"^inertial.angular_rates must be at most 1e\+06 rad/s"),
        ({"unit": "ADIS16448"}, r"^inertial.unit must be an InertialUnit, got 'ADIS16448'$"),
    ],
)
def test_wrong_samples_are_refused_in_one_line(changed: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(SAMPLES, **changed)  # type: ignore[arg-type]


def test_a_unit_has_a_noise_and_an_orientation() -> None:
    with pytest.raises(ValueError, match=r"^unit.gyro_walk must be a finite number >= 0, got -1.0$"):
        replace(UNIT, gyro_walk=-1.0)
    with pytest.raises(ValueError, match=r"^unit.orientation must be a unit quaternion"):
        InertialUnit(np.zeros(3), (0.0, 0.0, 0.0, 2.0), 0.0, 0.0, 0.0, 0.0)


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


@pytest.mark.parametrize(
    ("name", "given", "unused"),
    [("inverse-depth", {"inertial": SAMPLES}, "inertial samples"), ("inertial", {"odometry": ODOMETRY}, "odometry")],
)
def test_a_filter_says_once_what_it_makes_no_use_of(
    name: str, given: dict[str, object], unused: str, caplog: pytest.LogCaptureFixture
) -> None:
    slam = make_filter(name, camera=CAMERA, noise=INDEPENDENT_PIXELS)
    with caplog.at_level(logging.WARNING):
        for _ in range(3):
            slam.predict(DT, **{"inertial": SAMPLES, **given} if name == "inertial" else given)  # type: ignore[arg-type]
    assert [record.getMessage() for record in caplog.records] == [
        f"{type(slam).__name__} makes no use of the {unused} that it is given"
    ]


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
