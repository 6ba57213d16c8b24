"""Errors of each landmark that last: in the state against the textbook, and consistent where they are as stated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from filters import (
    ColouredNoise,
    ColouredNoiseEKF,
    LastingErrors,
    PairWithLastingErrors,
    StereoEKF,
    StereoNoise,
    StereoObservation,
    check_part,
    nees,
)

from .. import textbook
from ..drives import CAMERA, DT, SPEED, START_COVARIANCE, Frame, drive, finish, run, start

WHITE, LASTING, TIME = StereoNoise.independent_pixels(0.5), StereoNoise.independent_pixels(1.0), 0.8
NOISE = ColouredNoise(WHITE.R + LASTING.R, WHITE.R, drift={"pixels": [0.5, 0.5, 0.7]}, lasting_time=TIME)
PARTS = {"landmark": LastingErrors(LASTING.R, TIME), "measurement": PairWithLastingErrors()}
RIG = {"offset_sigma": 0.2, "yaw_sigma": 0.002, "roll_sigma": 0.001}


def lasting_drive(seed: int, frames: int = 25, **options: object) -> list[Frame]:
    """A drive in which the errors of each landmark are white ones and a Gauss-Markov process."""
    rng, root, kept = np.random.default_rng(1000 + seed), np.linalg.cholesky(LASTING.R), np.exp(-DT / TIME)
    errors: dict[int, np.ndarray] = {}
    made = []
    for frame in drive(seed, frames, noise=WHITE, depths=(6.0, 40.0), **options):
        ids, uvd = frame.observation.ids, frame.observation.uvd.copy()
        errors = {i: kept * e + np.sqrt(1.0 - kept**2) * root @ rng.standard_normal(3) for i, e in errors.items()}
        uvd += [errors.setdefault(i, root @ rng.standard_normal(3)) for i in ids.tolist()]
        made.append(replace(frame, observation=StereoObservation(ids, uvd)))
    return made


@pytest.mark.parametrize("part", [*PARTS.values(), PairWithLastingErrors(**RIG)], ids=[*PARTS, "and the rig"])
def test_the_part_is_right(part: object) -> None:
    check_part(part)


class ByNumbers(LastingErrors):
    """A subclass states no kernels."""


@pytest.mark.parametrize("landmark", [LastingErrors, ByNumbers])
def test_they_are_kept_and_forgotten_as_in_the_textbook(landmark: type[LastingErrors]) -> None:
    """In one frame, and after many in which landmarks come, go and are missed."""
    options = {**PARTS, "landmark": landmark(LASTING.R, TIME), "gate": None}
    slam = start(StereoEKF(CAMERA, WHITE, **options))
    book = textbook.WithOwnErrors(CAMERA, WHITE.R, covariance=LASTING.R, memory=TIME)
    book.reset(np.array([0.0, 0.0, SPEED]), START_COVARIANCE)
    for k, frame in enumerate(lasting_drive(3, 12)):
        if k:
            slam.predict(DT)
            book.predict(DT)
        slam.update(frame.observation)
        book.update(frame.observation)
        np.testing.assert_allclose(slam.pose.position, book.x[:3], atol=1e-9)
        np.testing.assert_allclose(slam.pose.covariance, book.error_covariance()[:6, :6], rtol=1e-7, atol=1e-12)
        told = slam.state.parameters()
        for n, i in enumerate(slam.state.ids.tolist()):
            np.testing.assert_allclose(told[n], book.landmark(i)[3:], atol=1e-9)


def final_nees(slam: StereoEKF, frame: Frame) -> float:
    error, covariance = slam.pose_error(frame.position, frame.orientation)
    return float(nees(error[None], covariance[None])[0]) / 6.0


def test_the_filter_that_keeps_them_is_consistent_and_the_truest() -> None:
    """Mean of 40 x 6 numbers of variance one: within .75 and 1.3 (three sigmas). Taken for white, they are not."""
    kept, white, end = [], [], []
    for seed in range(40):
        frames = lasting_drive(seed, missed=0.0)
        slam = finish(ColouredNoiseEKF(CAMERA, NOISE, gate=None), frames)
        plain = finish(StereoEKF(CAMERA, StereoNoise(NOISE.R), gate=None, error="right-invariant"), frames)
        kept.append(final_nees(slam, frames[-1]))
        white.append(final_nees(plain, frames[-1]))
        end.append([np.linalg.norm(x.pose.position - frames[-1].position) for x in (slam, plain)])
    assert 0.75 < np.mean(kept) < 1.3
    assert np.mean(white) > 1.5
    mine, others = np.mean(end, axis=0)
    assert mine < others


def test_coloured_noise_takes_them_from_the_noise_and_what_is_given_goes_before() -> None:
    frames = lasting_drive(1, 6)
    named = finish(ColouredNoiseEKF(CAMERA, NOISE, gate=None), frames)
    parts = finish(StereoEKF(CAMERA, WHITE, error="right-invariant", gate=None, **PARTS), frames)
    np.testing.assert_array_equal(named.pose.covariance, parts.pose.covariance)
    of_the_rig = dict(zip(("disparity_offset", "right_yaw", "right_roll"), RIG.values(), strict=True))
    with_rig = finish(ColouredNoiseEKF(CAMERA, replace(NOISE, **of_the_rig), gate=None), frames)
    both = {**PARTS, "measurement": PairWithLastingErrors(**RIG)}
    parts = finish(StereoEKF(CAMERA, WHITE, error="right-invariant", gate=None, **both), frames)
    np.testing.assert_array_equal(with_rig.pose.covariance, parts.pose.covariance)
    assert np.trace(with_rig.pose.covariance) > np.trace(named.pose.covariance)
    walking = finish(ColouredNoiseEKF(CAMERA, NOISE, gate=None, drift=NOISE.drift), frames)
    without_time = finish(ColouredNoiseEKF(CAMERA, replace(NOISE, lasting_time=None), gate=None), frames)
    np.testing.assert_array_equal(walking.pose.covariance, without_time.pose.covariance)


def test_an_unseen_landmark_forgets_its_error_and_not_its_place() -> None:
    slam = start(StereoEKF(CAMERA, WHITE, drop_unseen=False, **PARTS))
    list(run(slam, lasting_drive(5, 6)))
    identity = int(slam.ids[0])
    H = np.zeros((3, 9))
    H[:, 6:] = np.eye(3)  # the anchor's three numbers, the place, and the errors
    innovation = np.array([1.0, 0.0, 0.0])
    slam.predict(50 * TIME)
    report = slam.correct(innovation, {identity: H}, 1e-9 * np.eye(3))
    assert report.nis == pytest.approx(innovation @ np.linalg.solve(LASTING.R, innovation), rel=1e-6)
    assert np.isfinite(slam.landmarks.positions[0]).all()


@pytest.mark.parametrize(
    ("given", "named"),
    [
        ({"white": None, "lasting_time": 1.0}, "white or lasting must be given"),
        ({"white": 2.0 * NOISE.R, "lasting_time": 1.0}, "R - white"),
        ({"white": WHITE.R, "lasting_time": -1.0}, "lasting_time"),
    ],
)
def test_impossible_noise_is_refused(given: dict[str, object], named: str) -> None:
    with pytest.raises(ValueError, match=named):
        ColouredNoise(NOISE.R, **given)
