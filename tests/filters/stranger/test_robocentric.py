"""Landmarks in the frame of the camera: their step against differences of the whole, their consistency, their map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from filters import ConstantVelocity, StereoEKF, check_part, jacobian, nees

from ..drives import CAMERA, DT, INDEPENDENT_PIXELS, Frame, drive, finish, start
from .robocentric import InCamera

DEPTHS = (6.0, 40.0)
OPTIONS = {"landmark": InCamera(), "gate": None}


def test_the_part_is_right() -> None:
    check_part(InCamera())


def test_a_step_is_that_of_camera_and_landmarks_together() -> None:
    """F and the noise of the whole by differences of one function: motion, then each point seen from there."""
    frames, motion, model = drive(4, 4, depths=DEPTHS), ConstantVelocity(), InCamera()
    slam = finish(StereoEKF(CAMERA, INDEPENDENT_PIXELS, error="so3", motion=motion, **OPTIONS), frames)
    before = slam.state
    count, none = len(before), np.zeros(6)

    def after(e: np.ndarray, noise: np.ndarray) -> tuple[object, np.ndarray]:
        camera = motion.corrected(before.camera, e[:12])
        values = model.retract(before.parameters(), e[12:].reshape(count, 3))
        world = model.in_frame(values, camera.R_wc, camera.position)
        v, w = camera.linear_velocity + noise[:3], camera.angular_velocity + noise[3:]
        step = replace(camera, linear_velocity=v, angular_velocity=w)
        moved = motion.predict(step, DT, None).state
        return moved, model.in_frame(world, moved.R_wc.T, -moved.R_wc.T @ moved.position)

    camera, values = after(np.zeros(12 + 3 * count), none)

    def errors(e: np.ndarray, noise: np.ndarray) -> np.ndarray:
        moved, there = after(e, noise)
        return np.concatenate([motion.difference(camera, moved), model.local(values, there).ravel()])

    F = jacobian(lambda e: errors(e, none), 12 + 3 * count)
    G = jacobian(lambda noise: errors(np.zeros(12 + 3 * count), noise), 6)
    Q = motion.predict(before.camera, DT, None).Q
    order = np.concatenate([np.arange(12), before.own_rows().ravel()])
    P = symmetric(before.P)[np.ix_(order, order)]
    slam.predict(DT)
    state = slam.state
    np.testing.assert_allclose(state.parameters(), values, atol=1e-12)
    np.testing.assert_allclose(symmetric(state.P)[np.ix_(order, order)], F @ P @ F.T + G @ Q @ G.T, atol=1e-9)


def symmetric(P: np.ndarray) -> np.ndarray:
    """Both triangles of what is stored in the lower one."""
    return np.tril(P) + np.tril(P, -1).T


def final_nees(slam: StereoEKF, frame: Frame) -> float:
    error, covariance = slam.pose_error(frame.position, frame.orientation)
    return float(nees(error[None], covariance[None])[0]) / 6.0


@pytest.mark.parametrize(
    "error", ["so3", *(pytest.param(error, marks=pytest.mark.slow) for error in ("right-invariant", "left-invariant"))]
)
def test_pose_and_map_are_consistent_and_nearly_those_of_landmarks_in_the_world(error: str) -> None:
    """Mean of 12 x 6 numbers of variance one: within .6 and 1.5."""
    found, apart = [], []
    for seed in range(12):
        frames = drive(seed, 12, depths=DEPTHS)
        slam = finish(StereoEKF(CAMERA, INDEPENDENT_PIXELS, error=error, **OPTIONS), frames)
        other = StereoEKF(CAMERA, INDEPENDENT_PIXELS, error=error, gate=None, landmark="spherical")
        finish(other, frames)
        found.append(final_nees(slam, frames[-1]))
        apart.append(np.linalg.norm(slam.pose.position - other.pose.position))
    assert 0.6 < np.mean(found) < 1.5
    assert np.mean(apart) < 0.03
    mine, theirs = slam.landmarks, other.landmarks
    near = mine.inverse_distance > 0.03
    assert near.sum() > 5
    np.testing.assert_allclose(mine.positions[near], theirs.positions[near], atol=0.3)
    sizes = [np.linalg.eigvalsh(map_.covariances[near]) for map_ in (mine, theirs)]
    np.testing.assert_allclose(*sizes, rtol=0.2)


@pytest.mark.parametrize(
    "option",
    [
        {"drop_unseen": False, "drift": 0.2},
        {"consensus": True, "gate": 0.99},
        {"update": "unscented"},
        {"gauge_walk": 1e-3},
    ],
    ids=lambda option: next(iter(option)),
)
def test_options_work(option: dict[str, object]) -> None:
    frames = drive(3, 10, depths=DEPTHS)
    error = "right-invariant" if "gauge_walk" in option else "so3"
    slam = start(StereoEKF(CAMERA, INDEPENDENT_PIXELS, error=error, **{**OPTIONS, **option}))
    for k, frame in enumerate(frames):
        if k:
            slam.predict(DT)
        slam.update(frame.observation)
        if k == 5:
            slam.clone_pose("then")
    assert np.linalg.norm(slam.pose.position - frames[-1].position) < 0.5
    assert np.linalg.eigvalsh(symmetric(slam.state.P))[0] > -1e-9
    assert np.linalg.norm(slam.relative_pose("then").position - [0.0, 0.0, 2.0]) < 0.5


class Anchored(InCamera):
    anchored = True


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"landmark": Anchored()}, "landmark Anchored is in the frame of the camera: it must have no anchors"),
        ({"landmark": InCamera(), "error": "first-estimates"}, "error must not be first-estimates"),
        ({"landmark": InCamera(), "max_landmarks": 5}, "max_landmarks must be None"),
    ],
    ids=["anchor", "first-estimates", "max_landmarks"],
)
def test_what_cannot_be_is_refused_in_one_line(options: dict[str, object], words: str) -> None:
    with pytest.raises(ValueError, match=words) as refused:
        StereoEKF(CAMERA, INDEPENDENT_PIXELS, **options)
    assert "\n" not in str(refused.value)


class Failing(InCamera):
    """Fails when a step is made with a map."""

    def in_frame(self, parameters, R, shift):
        """Nothing."""
        raise ArithmeticError("lost")


def test_a_failure_in_the_step_leaves_the_state_as_it_was() -> None:
    slam = start(StereoEKF(CAMERA, INDEPENDENT_PIXELS, landmark=Failing()))
    slam.update(drive(1, 1)[0].observation)
    before = slam.state
    with pytest.raises(ArithmeticError, match="lost"):
        slam.predict(DT)
    np.testing.assert_array_equal(slam.state.blocks, before.blocks)
    np.testing.assert_array_equal(symmetric(slam.state.P), symmetric(before.P))
