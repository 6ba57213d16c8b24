"""`SubmapEKF` against the filter that keeps every landmark in one state: the same estimates, at a bounded size."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest

from filters import (
    BodyVelocity,
    StereoEKF,
    StereoFilter,
    StereoObservation,
    VelocityDriven,
    available_filters,
    check_filter,
    make_filter,
)
from filters.checks.conformance import CHECKS
from filters.joint_state import JointState
from filters.submaps.submap_ekf import SubmapEKF

from ..drives import CAMERA, DT, INDEPENDENT_PIXELS, Frame, run
from .loop import LAP, RADIUS, SPEED, loop, start

SMALL: dict[str, Any] = {"max_unseen": 10, "patience": 1}  # some ten submaps a lap


def pair(**options: Any) -> tuple[StereoEKF, SubmapEKF]:
    """The full filter and submaps with the same options, started."""
    options = {"landmark": "shared-anchor", **options}
    full = StereoEKF(CAMERA, INDEPENDENT_PIXELS, drop_unseen=False, **options)
    ours = SubmapEKF(CAMERA, INDEPENDENT_PIXELS, **SMALL, **options)
    start(full, ours)
    return full, ours


def over(frames: list[Frame], **options: Any) -> tuple[StereoEKF, SubmapEKF]:
    """Both at the end of a drive."""
    both = pair(**options)
    for slam in both:
        list(run(slam, frames))
    return both


def assert_same_poses(full: StereoFilter, ours: StereoFilter, sigmas: float) -> None:
    """Equal to a share of the standard deviation, and so are the covariances."""
    sigma = np.sqrt(full.pose.covariance.diagonal())
    assert (np.abs(full.pose.position - ours.pose.position) <= sigmas * sigma[:3]).all()
    assert (np.abs(full.pose.orientation - ours.pose.orientation) <= sigmas * sigma[3:].min()).all()
    np.testing.assert_allclose(
        ours.pose.covariance / np.outer(sigma, sigma), full.pose.covariance / np.outer(sigma, sigma), atol=sigmas
    )
    np.testing.assert_allclose(ours.velocity.linear, full.velocity.linear, atol=sigmas)


def assert_same_maps(full: StereoFilter, ours: StereoFilter, sigmas: float) -> None:
    expected, found = full.landmarks, ours.landmarks
    assert found.ids.tolist() == expected.ids.tolist()
    finite = np.isfinite(expected.positions).all(axis=1) & (expected.inverse_distance > 0)
    assert finite.sum() > 0.9 * len(finite)
    sigma = np.sqrt(np.einsum("nii->ni", expected.covariances))[finite]
    assert (np.abs(expected.positions - found.positions)[finite] <= sigmas * sigma).all()
    apart = np.abs(expected.covariances - found.covariances)[finite]
    assert (apart <= sigmas * sigma[:, :, None] * sigma[:, None, :]).all()
    np.testing.assert_allclose(found.inverse_distance, expected.inverse_distance, rtol=1e-7)
    np.testing.assert_allclose(found.inverse_distance_variance, expected.inverse_distance_variance, rtol=1e-7)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"landmark": "inverse-depth"},
        {"landmark": "euclidean", "error": "so3", "measurement": "sequential"},
        {"error": "first-estimates", "iterations": 2},
        {"update": "unscented", "error": "so3", "tail_dof": 4.0},
    ],
)
def test_on_a_loop_the_estimates_are_those_of_the_full_filter(options: dict[str, Any]) -> None:
    """To rounding, before, at and after the loop closes.

    Nothing is left to relinearisation: the full filter, too, corrects a landmark out of view linearly, by its
    covariance with what is seen; submaps only carry out that correction later.
    """
    full, ours = pair(**options)
    brought = 0
    for number, frame in enumerate(loop(0, 1.25)):
        if number:
            full.predict(DT)
            ours.predict(DT)
        at_rest = ~np.isin(frame.observation.ids, ours.awake)
        report, expected = ours.update(frame.observation), full.update(frame.observation)
        np.testing.assert_array_equal(report.updated, expected.updated)
        np.testing.assert_array_equal(report.initialised, expected.initialised)
        np.testing.assert_allclose(report.nis, expected.nis, rtol=1e-7)
        assert_same_poses(full, ours, 1e-9)
        if number % 30 == 0:
            assert_same_maps(full, ours, 1e-8)
        brought += np.isin(frame.observation.ids[at_rest], report.updated).sum()
    assert ours.submaps >= 5
    assert brought > 0  # the loop has been closed
    assert len(ours.awake) < 0.5 * len(ours.landmarks.ids)


@pytest.mark.parametrize("noise_scale", [0.01, 3.0])
def test_the_agreement_does_not_depend_on_the_noise(noise_scale: float) -> None:
    """A difference by relinearisation would grow with the square of the noise."""
    full, ours = over(loop(1, 1.15, points=60, noise_scale=noise_scale), gate=None)
    assert ours.submaps >= 4
    assert_same_poses(full, ours, 1e-9)
    assert_same_maps(full, ours, 1e-8)


def test_without_the_camera_of_the_moment_landmarks_at_rest_would_not_be_independent(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The comparison has teeth: leave the camera out of what submaps have in common, and it fails."""
    monkeypatch.setattr(JointState, "hold_variables", lambda state: np.zeros(0, dtype=np.int64))
    full, ours = over(loop(0, 1.1), gate=None)
    with pytest.raises(AssertionError):
        assert_same_maps(full, ours, 1e-3)


def test_missed_detections_empty_frames_and_odometry_change_nothing_of_it() -> None:
    full, ours = pair(motion=VelocityDriven())
    rng = np.random.default_rng(3)
    sigmas = np.repeat([0.3, 0.06], 3)
    for number, frame in enumerate(loop(2, 1.15, missed=0.2)):
        observation = frame.observation.select(rng.permutation(len(frame.observation)))
        if number:
            twist = [0, 0, SPEED, 0, SPEED / RADIUS, 0] + sigmas * rng.standard_normal(6)
            odometry = BodyVelocity(twist[:3], twist[3:], np.diag(sigmas**2))
            full.predict(DT, odometry)
            ours.predict(DT, odometry)
        if number % 40 == 20:
            observation = observation.select(np.zeros(0, dtype=np.int64))
        full.update(observation)
        ours.update(observation)
        assert_same_poses(full, ours, 1e-9)
    assert ours.submaps >= 5
    assert_same_maps(full, ours, 1e-8)


def driven(laps: float = 0.8) -> tuple[StereoEKF, SubmapEKF]:
    return over(loop(4, laps))


def test_landmarks_at_rest_can_be_forecast_without_waking_them() -> None:
    full, ours = driven()
    awake = ours.awake
    ids = full.landmarks.ids
    for wanted in (None, ids[::-1], ids[:3], np.setdiff1d(ids, awake)[-4:], awake[:2], ids[:0]):
        expected, found = full.forecast(wanted), ours.forecast(wanted)
        assert found.ids.tolist() == expected.ids.tolist()
        np.testing.assert_allclose(found.uvd, expected.uvd, rtol=1e-7)
        np.testing.assert_allclose(found.S, expected.S, rtol=1e-6, atol=1e-6)
        np.testing.assert_array_equal(found.in_view, expected.in_view)
    np.testing.assert_array_equal(ours.awake, awake)
    with pytest.raises(ValueError, match="ids must be in the map"):
        ours.forecast([*ids[:2], 10**6])


def test_landmarks_at_rest_can_be_forgotten_and_seen_again() -> None:
    full, ours = driven()
    again = loop(4, 1.1)[round(0.8 * LAP) :]
    gone = full.landmarks.ids[::3]
    assert len(np.setdiff1d(gone, ours.awake)) > 5
    full.forget(gone)
    ours.forget(gone)
    started: set[int] = set()
    for frame in again:
        full.predict(DT)
        ours.predict(DT)
        full.update(frame.observation)
        started |= set(ours.update(frame.observation).initialised.tolist())
        assert_same_poses(full, ours, 1e-9)
    assert started & set(gone.tolist())
    assert_same_maps(full, ours, 1e-8)


def test_a_copy_goes_its_own_way_and_reset_forgets_all_submaps() -> None:
    _, ours = driven()
    twin = copy.deepcopy(ours)
    before = ours.landmarks
    for frame in loop(4, 1.1)[round(0.8 * LAP) :]:
        twin.predict(DT)
        twin.update(frame.observation)
    np.testing.assert_array_equal(ours.landmarks.positions, before.positions)
    twin.reset()
    assert twin.submaps == len(twin.landmarks.ids) == len(twin.awake) == 0


def test_the_active_state_stays_small_while_the_map_grows() -> None:
    """Rows of the state against those of a filter that keeps only what is in view; the times are a benchmark's."""
    in_view = StereoEKF(CAMERA, INDEPENDENT_PIXELS, landmark="shared-anchor")
    ours = SubmapEKF(CAMERA, INDEPENDENT_PIXELS, max_unseen=12, patience=2)
    rng = np.random.default_rng(0)
    rows, reference = [], []
    for frame in range(120):
        ids = 3 * frame + np.arange(60)
        uvd = np.column_stack([rng.uniform((300, 60), (1000, 330), (60, 2)), rng.uniform(10, 40, 60)])
        for slam in (in_view, ours):
            slam.predict(DT)
            slam.update(StereoObservation(ids, uvd))
        rows.append(ours.state_size)
        reference.append(len(in_view.state.P))
    assert len(ours.landmarks.ids) == 60 + 3 * 119
    # The camera's clone (12), up to 12 + 2 x 3 landmarks out of view with their anchors.
    assert max(rows[30:]) <= max(reference) + 12 + 3 * (12 + 6 + 9)
    assert max(rows[90:]) <= max(rows[30:60])


@pytest.mark.parametrize("options", [{}, {"max_unseen": 1, "patience": 1}, {"landmark": "inverse-depth"}])
def test_it_conforms(options: dict[str, Any]) -> None:
    report = check_filter(lambda camera, noise: make_filter("submaps", camera=camera, noise=noise, **options))
    assert len(report.passed) == len(CHECKS)
    assert "submaps" in available_filters()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"drop_unseen": True}, "drop_unseen must be False with submaps, got True"),
        ({"error": "right-invariant"}, "error must be one of 'quaternion', 'so3', 'first-estimates' with submaps"),
        ({"landmark": "hybrid"}, "landmark must be one of .* with submaps, got Hybrid"),
        ({"max_unseen": 0}, "max_unseen must be an integer >= 1, got 0"),
        ({"patience": 1.5}, "patience must be an integer >= 1, got 1.5"),
        ({"gat": 0.9}, "option 'gat' is not one of SubmapEKF"),
        ({"gate": 2.0}, "gate must be a probability"),
    ],
)
def test_what_it_cannot_do_is_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make_filter("submaps", camera=CAMERA, noise=INDEPENDENT_PIXELS, **options)
