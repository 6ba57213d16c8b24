"""The joint covariance of pose and landmark positions, against the marginals and a dense numeric Jacobian (2 s)."""

from __future__ import annotations

import numpy as np
import pytest

from filters import Hybrid, InverseDepthStereoEKF, StereoFilter, make_filter
from filters.geometry import rotations, symmetric

from ..dense import plus
from ..drives import CAMERA, INDEPENDENT_PIXELS, drive, finish
from ..numeric import numeric_jacobian
from ..slots import ERRORS, LANDMARKS
from .beliefs import make, scaled

MODELS = (*LANDMARKS, Hybrid(0.3))
KINDS = [{"landmark": model} for model in MODELS]
KINDS += [{"landmark": "shared-anchor", "error": error} for error in ERRORS]


def driven(drop_unseen: bool = False, **options) -> StereoFilter:
    return finish(make(drop_unseen=drop_unseen, **options), drive(3, 8, visible=8))


@pytest.mark.parametrize("options", KINDS, ids=str)
def test_its_diagonal_blocks_are_the_marginals_and_it_is_positive_definite(options: dict) -> None:
    slam = driven(**options)
    joint, landmarks = slam.joint_covariance(), slam.landmarks
    assert len(landmarks.ids) > 8
    np.testing.assert_allclose(joint[:6, :6], slam.pose.covariance, rtol=1e-12)
    for k, covariance in enumerate(landmarks.covariances):
        rows = slice(6 + 3 * k, 9 + 3 * k)
        np.testing.assert_allclose(joint[rows, rows], covariance, rtol=1e-9, atol=1e-12 * covariance.max())
    np.testing.assert_array_equal(joint, joint.T)
    assert np.linalg.eigvalsh(scaled(joint, joint)[0])[0] > 0


@pytest.mark.parametrize("options", KINDS, ids=str)
def test_it_is_the_covariance_that_a_numeric_jacobian_of_everything_gives(options: dict) -> None:
    """P is kept in the standard coordinates whatever the error definition."""
    slam = driven(**options)
    state, order = slam.state, np.argsort(slam.state.ids)

    def shown(delta: np.ndarray) -> np.ndarray:
        moved = plus(state, delta)
        turn = rotations.log(state.camera.R_wc.T @ moved.camera.R_wc)
        positions = moved.model.points(moved.anchors(order), moved.parameters(order)).positions
        return np.concatenate([moved.camera.position, turn, positions.ravel()])

    J = numeric_jacobian(shown, len(state.P), step=1e-6)
    wanted = J @ symmetric.full(state.P) @ J.T
    np.testing.assert_allclose(*scaled(slam.joint_covariance(), wanted), rtol=0, atol=1e-6)


@pytest.mark.parametrize("options", KINDS, ids=str)
def test_its_parts_can_be_had_alone(options: dict) -> None:
    """What an EKF takes out of P landmark by landmark is what is cut out of the whole."""
    slam = driven(**options)
    ids = slam.landmarks.ids[[4, 0, 2]]
    expected = StereoFilter.pose_landmark_covariances(slam, ids)
    assert expected.shape == (3, 9, 9)
    joint = slam.joint_covariance(ids)
    np.testing.assert_array_equal(expected[1, :6, 6:], joint[:6, 9:12])
    np.testing.assert_allclose(slam.pose_landmark_covariances(ids), expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("name", ["shared-anchor", "submaps"])
def test_landmarks_come_in_the_order_they_are_asked_for(name: str) -> None:
    slam = finish(make_filter(name, camera=CAMERA, noise=INDEPENDENT_PIXELS), drive(3, 8, visible=8))
    whole, ids = slam.joint_covariance(), slam.landmarks.ids
    chosen = [5, 0, 3]
    rows = np.concatenate([np.arange(6), *(6 + 3 * k + np.arange(3) for k in chosen)])
    np.testing.assert_allclose(slam.joint_covariance(ids[chosen]), whole[np.ix_(rows, rows)], rtol=1e-9)
    assert slam.joint_covariance([]).shape == (6, 6)
    for joint in (slam.joint_covariance, lambda ids: StereoFilter.joint_covariance(slam, ids)):
        with pytest.raises(ValueError, match=r"ids must be in the map, not there: \[-7\]"):
            joint([int(ids[0]), -7])


def test_submaps_say_what_one_map_says() -> None:
    frames = drive(3, 14, visible=8)
    parts = {"camera": CAMERA, "noise": INDEPENDENT_PIXELS}
    one = finish(make_filter("shared-anchor", **parts, drop_unseen=False), frames)
    many = finish(make_filter("submaps", **parts, max_unseen=3, patience=1), frames)
    assert many.submaps >= 2
    before = many.landmarks.covariances
    np.testing.assert_allclose(*scaled(many.joint_covariance(), one.joint_covariance()), rtol=0, atol=1e-6)
    some = one.landmarks.ids[[9, 2, 13]]
    np.testing.assert_allclose(*scaled(many.joint_covariance(some), one.joint_covariance(some)), rtol=0, atol=1e-6)
    np.testing.assert_array_equal(many.landmarks.covariances, before)


def test_a_filter_with_nothing_better_leaves_out_the_correlations() -> None:
    slam = driven()
    ids = slam.landmarks.ids[[4, 1]]
    joint, exact = StereoFilter.joint_covariance(slam, ids), slam.joint_covariance(ids)
    blocks = [slice(0, 6), slice(6, 9), slice(9, 12)]
    for rows in blocks:
        np.testing.assert_allclose(joint[rows, rows], exact[rows, rows], rtol=1e-9, atol=1e-12)
        joint[rows, rows] = 0.0
    assert not joint.any()
    assert StereoFilter.joint_covariance(slam).shape == (6 + 3 * len(slam.landmarks.ids),) * 2


def test_without_a_map_it_is_that_of_the_pose() -> None:
    slam = InverseDepthStereoEKF(CAMERA, INDEPENDENT_PIXELS)
    np.testing.assert_array_equal(slam.joint_covariance(), slam.pose.covariance)


def test_a_landmark_at_infinity_is_not_finite_and_spoils_nothing_else() -> None:
    slam = driven()
    state = slam.state
    state.blocks[state.parameter_block[0], 2] = 0.0
    slam.state = state
    joint = slam.joint_covariance(slam.state.ids)
    assert not np.isfinite(joint[6:9, 6:9]).any()
    rest = np.delete(np.arange(len(joint)), [6, 7, 8])
    np.testing.assert_array_equal(joint[np.ix_(rest, rest)], slam.joint_covariance(slam.state.ids[1:]))


@pytest.mark.parametrize("options", KINDS, ids=str)
def test_whatever_rounding_does_a_covariance_is_symmetric(options: dict) -> None:
    """To the last bit, also where the map is hardly known: 20 s without a measurement."""
    slam = driven(**options)
    for _ in range(20):
        slam.predict(1.0)
    for covariances in (slam.landmarks.covariances, slam.forecast().S, slam.pose_landmark_covariances()):
        np.testing.assert_array_equal(covariances, covariances.transpose(0, 2, 1))
