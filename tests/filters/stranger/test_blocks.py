"""Landmarks of more than three error numbers, own biases: against the textbook, each other and the truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from filters import (
    Euclidean,
    FilterBatch,
    LandmarkModel,
    RightInvariant,
    Start,
    StereoEKF,
    StereoObservation,
    SubmapEKF,
    check_part,
    nees,
)
from filters.geometry import symmetric

from .. import textbook
from ..drives import CAMERA, DT, INDEPENDENT_PIXELS, SPEED, START_COVARIANCE, Frame, drive, finish, run, start
from .biased import Biased, BiasedPair

DEPTHS = (6.0, 40.0)
BIASED = {"landmark": Biased(), "measurement": BiasedPair()}


class BiasedByNumbers(Biased):
    """The same in Python."""

    in_machine_code = False


BY_NUMBERS = {"landmark": BiasedByNumbers(), "measurement": BiasedPair()}


@pytest.mark.parametrize("part", [Biased(), BiasedPair()], ids=lambda part: type(part).__name__)
def test_the_part_is_right(part: object) -> None:
    check_part(part)


def biased_drive(seed: int, frames: int = 12, sigma: float = 2.0, **options: object) -> list[Frame]:
    """A drive whose landmarks each have a bias of the disparity."""
    rng, biases = np.random.default_rng(1000 + seed), {}
    made = []
    for frame in drive(seed, frames, depths=DEPTHS, **options):
        ids, uvd = frame.observation.ids, frame.observation.uvd.copy()
        uvd[:, 2] += [biases.setdefault(i, sigma * rng.standard_normal()) for i in ids.tolist()]
        made.append(replace(frame, observation=StereoObservation(ids, uvd)))
    return made


@pytest.mark.parametrize("options", [BIASED, BY_NUMBERS], ids=["compiled", "by numbers"])
def test_landmarks_with_a_bias_are_those_of_the_textbook(options: dict[str, object]) -> None:
    """In one frame, and after many in which landmarks come, go and are missed."""
    slam = start(StereoEKF(CAMERA, INDEPENDENT_PIXELS, gate=None, **options))
    book = textbook.WithOwnErrors(CAMERA, INDEPENDENT_PIXELS.R, own=np.eye(3)[:, 2:], covariance=np.eye(1) * 2.0**2)
    book.reset(np.array([0.0, 0.0, SPEED]), START_COVARIANCE)
    for k, frame in enumerate(biased_drive(3)):
        if k:
            slam.predict(DT)
            book.predict(DT)
        slam.update(frame.observation)
        book.update(frame.observation)
        covariance = book.error_covariance()
        np.testing.assert_allclose(slam.pose.position, book.x[:3], atol=1e-9)
        np.testing.assert_allclose(slam.pose.covariance, covariance[:6, :6], rtol=1e-7, atol=1e-12)
        rows = {i: covariance_rows(book, i) for i in book.ids}
        state = slam.state
        for n, i in enumerate(state.ids.tolist()):
            own = state.own_rows(np.array([n]))[0]
            np.testing.assert_allclose(state.parameters()[n], book.landmark(i)[3:], atol=1e-9)
            P = state.P[np.maximum(own[:, None], own), np.minimum(own[:, None], own)]
            np.testing.assert_allclose(P, covariance[np.ix_(rows[i], rows[i])], rtol=1e-6, atol=1e-9)
        assert np.linalg.eigvalsh(symmetric.full(state.P))[0] > -1e-8  # anchors fill three of four rows


def covariance_rows(book: textbook.TextbookEKF, identity: int) -> np.ndarray:
    """Rows of the errors of a landmark without its anchor: one fewer before it than there are numbers."""
    return book._rows(identity)[3:] - 1


def beliefs(slam: StereoEKF) -> np.ndarray:
    """All that it believes."""
    map_, pose, seen, joint = slam.landmarks, slam.pose, slam.forecast(), slam.joint_covariance()
    believed = pose.position, pose.orientation, map_.inverse_distance, joint[np.isfinite(joint)], seen.uvd, seen.S
    return np.concatenate([np.ravel(part) for part in believed])


ERRORS = ("quaternion", "so3", "first-estimates", "right-invariant", RightInvariant(reset=True))
CASES = [({"iterations": 2, "drift": 0.3, "tail_dof": 4.0}, error) for error in ERRORS]
CASES += [({"consensus": True, "drop_unseen": False}, error) for error in ERRORS]
CASES += [({"gauge_walk": 1e-3}, error) for error in ("first-estimates", "right-invariant")]


@pytest.mark.parametrize(("option", "error"), CASES, ids=str)
def test_kernels_lead_where_the_numbers_do(option: dict[str, object], error: object) -> None:
    frames, told = biased_drive(1, 8), []
    for parts in (BIASED, BY_NUMBERS):
        slam = start(StereoEKF(CAMERA, INDEPENDENT_PIXELS, error=error, **option, **parts))
        for k, _ in enumerate(run(slam, frames)):
            if k == 3:
                slam.clone_pose("then")
        told.append(np.append(beliefs(slam), slam.belief("then").covariance))
    np.testing.assert_allclose(*told, rtol=1e-6, atol=1e-8)


class Scaled(LandmarkModel):
    """XYZ, seen at a scale 1 + s of homogeneous coordinates, which nothing tells."""

    size = value_size = 4
    in_world = True
    prior = np.array([[0.09]])

    def point_of(self, y):
        scale = 1.0 + y[3]
        return scale * y[0], scale * y[1], scale * y[2], scale

    def start_from(self, h):
        return h[0] / h[3], h[1] / h[3], h[2] / h[3], 0.0

    def can_start_from(self, h):
        return h[3] > 0.0


def test_a_number_that_no_measurement_tells_keeps_its_prior_and_changes_nothing() -> None:
    """Of a landmark without an anchor, wherever the camera is."""
    found, turned = [], Rotation.from_rotvec([0.2, -0.4, 0.1]).as_quat()
    for landmark in ("euclidean", Scaled()):
        slam = StereoEKF(CAMERA, INDEPENDENT_PIXELS, gate=None, landmark=landmark)
        slam.reset(Start((1.0, 2.0, -3.0), turned, (0.0, 0.0, SPEED), covariance=START_COVARIANCE))
        list(run(slam, drive(11, 4, depths=DEPTHS)))
        found.append(np.concatenate([slam.pose.covariance.ravel(), slam.landmarks.positions.ravel()]))
    np.testing.assert_allclose(*found, rtol=1e-7, atol=1e-9)
    open_rows = slam.state.own_rows()[:, 3]
    P = symmetric.full(slam.state.P)[open_rows]
    np.testing.assert_allclose(P[:, open_rows], 0.09 * np.eye(len(open_rows)), atol=1e-9)
    np.testing.assert_allclose(np.delete(P, open_rows, axis=1), 0.0, atol=1e-9)


def test_a_batch_and_submaps_hold_them_too() -> None:
    frames = [biased_drive(seed, 8) for seed in (1, 2)]
    batch = FilterBatch(lambda: StereoEKF(CAMERA, INDEPENDENT_PIXELS, **BIASED), 2)
    batch.reset(Start(linear_velocity=(0.0, 0.0, SPEED), covariance=START_COVARIANCE))
    for k in range(8):
        if k:
            batch.predict(DT)
        batch.update([frames[0][k].observation, frames[1][k].observation])
    for number, slam in enumerate(batch):
        alone = finish(StereoEKF(CAMERA, INDEPENDENT_PIXELS, **BIASED), frames[number])
        np.testing.assert_array_equal(beliefs(slam), beliefs(alone))
    assert batch.state_sizes.tolist() == [slam.state_size for slam in batch]
    mine, theirs = batch.forecasts()[0], batch[0].forecast()
    np.testing.assert_array_equal(mine.uvd, theirs.uvd)
    np.testing.assert_array_equal(mine.S, theirs.S)
    seen, first = batch.relative_landmarks(), batch[0]
    expected = (first.landmarks.positions - first.pose.position) @ first.state.camera.R_wc
    np.testing.assert_allclose(seen.points_c[: seen.offsets[1]], expected, rtol=1e-9)

    whole = finish(StereoEKF(CAMERA, INDEPENDENT_PIXELS, drop_unseen=False, error="so3", **BIASED), biased_drive(4, 15))
    parts = SubmapEKF(CAMERA, INDEPENDENT_PIXELS, max_unseen=3, error="so3", **BIASED)
    finish(parts, biased_drive(4, 15))
    assert parts.submaps > 1
    np.testing.assert_allclose(parts.pose.covariance, whole.pose.covariance, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(parts.landmarks.covariances, whole.landmarks.covariances, rtol=1e-5, atol=1e-7)


def test_the_unscented_update_and_corrections_reach_all_numbers() -> None:
    frames = biased_drive(2, 6)
    extended = finish(StereoEKF(CAMERA, INDEPENDENT_PIXELS, error="so3", **BIASED), frames)
    unscented = finish(StereoEKF(CAMERA, INDEPENDENT_PIXELS, error="so3", update="unscented", **BIASED), frames)
    np.testing.assert_allclose(unscented.pose.position, extended.pose.position, atol=0.1)
    identity = int(extended.ids[0])
    H = np.zeros((1, 7))
    H[0, 6] = 1.0  # the anchor's three numbers, then (theta, phi, rho, bias)
    before = extended.state
    assert extended.correct([0.5], {identity: H}, [[1e-12]]).used
    after = extended.state
    np.testing.assert_allclose(after.parameters()[0, 3] - before.parameters()[0, 3], 0.5, atol=1e-6)


@pytest.mark.parametrize("error", ["so3", "first-estimates", "right-invariant"])
def test_biases_are_estimated_and_the_filter_consistent(error: str) -> None:
    """Mean of 12 x 6 numbers of variance one: within .6 and 1.5 (four sigmas and a half). Without, it is not."""
    found, without = [], []
    for seed in range(12):
        frames = biased_drive(seed, 12, missed=0.0)
        slam = finish(StereoEKF(CAMERA, INDEPENDENT_PIXELS, error=error, gate=None, **BIASED), frames)
        found.append(final_nees(slam, frames[-1]))
        plain = StereoEKF(CAMERA, INDEPENDENT_PIXELS, error=error, gate=None, landmark="shared-anchor")
        without.append(final_nees(finish(plain, frames), frames[-1]))
    assert 0.6 < np.mean(found) < 1.5
    assert np.mean(without) > 2.0


def final_nees(slam: StereoEKF, frame: Frame) -> float:
    error, covariance = slam.pose_error(frame.position, frame.orientation)
    return float(nees(error[None], covariance[None])[0]) / 6.0


class WithoutPrior(Biased):
    prior = None


class TooSmall(Biased):
    size = 2


class StretchedPoint(Euclidean):
    def retract_by(self, y, c):
        return tuple(a + 2.0 * b for a, b in zip(y, c, strict=True))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"landmark": WithoutPrior(), "measurement": BiasedPair()}, r"prior of landmark WithoutPrior must .* \(1, 1\)"),
        ({"landmark": TooSmall(), "measurement": BiasedPair()}, "size of landmark TooSmall must be from 3"),
        ({"landmark": Biased()}, "measurement must have seen_size = 5 with landmark=Biased, got RangeBearing with 4"),
        ({"measurement": BiasedPair()}, "measurement must have seen_size = 4 .* got BiasedPair with 5"),
        ({"landmark": StretchedPoint()}, "landmark StretchedPoint is a point of W: its retraction must be addition"),
    ],
    ids=["prior", "size", "seen", "points", "retraction"],
)
def test_numbers_that_do_not_fit_are_refused_in_one_line(options: dict[str, object], words: str) -> None:
    with pytest.raises(ValueError, match=words) as refused:
        StereoEKF(CAMERA, INDEPENDENT_PIXELS, **options)
    assert "\n" not in str(refused.value)
