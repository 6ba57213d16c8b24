"""A cap on landmarks keeps those that say most about the pose."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from filters import Extended, RangeBearing, Stage, StereoEKF, StereoObservation
from filters.engine import selection
from filters.engine.new_landmarks import start_landmarks
from filters.geometry import symmetric

from ..drives import CAMERA, INDEPENDENT_PIXELS, drive, finish, run, start
from ..slots import LANDMARKS
from ..state.states import augment, transform_variables
from .linear_problems import update

COUNT = 12
SENSOR = RangeBearing()


def noise(count: int) -> np.ndarray:
    return np.broadcast_to(INDEPENDENT_PIXELS.R, (count, 3, 3))


def tracked(seed: int, landmark: str = "shared-anchor") -> tuple[StereoEKF, StereoObservation]:
    """A filter with `COUNT` landmarks or more, and measurements of as many new ones."""
    slam = StereoEKF(CAMERA, INDEPENDENT_PIXELS, gate=None, landmark=landmark)
    finish(slam, drive(seed, 8, visible=COUNT + 4, missed=0.0, depths=(6, 30)))
    return slam, StereoObservation(np.arange(COUNT) + 10**6, drive(seed + 100, 1, visible=COUNT)[0].observation.uvd)


def candidates(slam: StereoEKF, known: np.ndarray, new: StereoObservation) -> selection.Candidates:
    return selection.next_measurements(SENSOR, CAMERA, slam.state, known, noise(len(known)), new.uvd, noise(len(new)))


def pose_covariance(of: selection.Candidates, kept: np.ndarray) -> np.ndarray:
    """Covariance of the next pose given the measurements kept."""
    rows = np.repeat(kept, 3)
    cross = of.cross[:, rows]
    return of.pose - cross @ np.linalg.solve(of.S[np.ix_(rows, rows)], cross.T)


def log_determinant(covariance: np.ndarray) -> float:
    return float(np.linalg.slogdet(covariance)[1])


@pytest.mark.parametrize("landmark", LANDMARKS)
def test_what_is_foreseen_is_what_happens(landmark: str) -> None:
    """Start the new landmarks, make the step, measure everything once more: the covariance of the pose then."""
    slam, new = tracked(3, landmark)
    known = np.arange(5)
    foreseen = pose_covariance(candidates(slam, known, new), np.ones(5 + len(new), dtype=bool))
    ids = slam.state.ids[known]
    state = slam.state
    augment(state, start_landmarks(SENSOR, CAMERA, state, new, noise(len(new))))
    step = np.zeros((12, 12))
    step[:6, :6] = selection.STEP
    transform_variables(state, np.eye(12), step)
    everything = np.flatnonzero(np.isin(state.ids, [*ids, *new.ids]))
    stage = Stage(np.zeros((len(everything), 3)), np.eye(3), noise(len(everything)))
    update(state.P, Extended().linearise(SENSOR, CAMERA, state, everything, stage))
    happened = symmetric.full(state.P[:6, :6])
    scale = np.sqrt(np.diag(happened))
    np.testing.assert_allclose(foreseen / np.outer(scale, scale), happened / np.outer(scale, scale), atol=1e-5)


@pytest.mark.parametrize("seed", range(5))
def test_it_comes_close_to_the_best_set_there_is(seed: int) -> None:
    """Every set of 4 out of 10, by brute force."""
    slam, new = tracked(seed)
    of = candidates(slam, np.arange(5), new.select(np.arange(5)))
    kept = selection.most_informative(of, 4)
    sets = [np.isin(np.arange(10), chosen) for chosen in combinations(range(10), 4)]
    every = np.array([log_determinant(pose_covariance(of, chosen)) for chosen in sets])
    assert kept.sum() == 4
    assert log_determinant(pose_covariance(of, kept)) < every.min() + 0.35  # a factor of 1.03 in each direction
    assert log_determinant(pose_covariance(of, kept)) < np.quantile(every, 0.03)


@pytest.mark.parametrize("count", [1, 2, 17, 30])
def test_it_keeps_as_many_as_there_may_be(count: int) -> None:
    slam, new = tracked(1)
    assert selection.most_informative(candidates(slam, np.arange(6), new), count).sum() == min(count, 6 + COUNT)


def test_a_frame_of_new_landmarks_only_is_chosen_from_as_well() -> None:
    slam, new = start(StereoEKF(CAMERA, INDEPENDENT_PIXELS)), tracked(1)[1]
    assert selection.most_informative(candidates(slam, np.zeros(0, dtype=np.int64), new), 5).sum() == 5


def test_a_filter_never_holds_more_and_accounts_for_the_rest() -> None:
    slam = start(StereoEKF(CAMERA, INDEPENDENT_PIXELS, max_landmarks=8))
    frames = drive(5, 20, visible=20)
    for frame, report in zip(frames, run(slam, frames), strict=True):
        in_map = slam.landmarks.ids
        assert len(in_map) == min(8, len(frame.observation))
        lost = np.setdiff1d(frame.observation.ids, in_map)
        assert set(lost.tolist()) <= {*report.rejected.tolist(), *report.dropped.tolist()}


def test_landmarks_out_of_view_do_not_count() -> None:
    slam = start(StereoEKF(CAMERA, INDEPENDENT_PIXELS, max_landmarks=8, drop_unseen=False))
    frames = drive(5, 2, visible=20)
    first, second = frames[0].observation, frames[1].observation
    slam.update(first)
    slam.update(StereoObservation(second.ids + 1000, second.uvd))
    assert len(slam.landmarks.ids) == 16


@pytest.mark.parametrize("value", [0, -3, 2.5, "many"])
def test_an_impossible_cap_is_refused(value: object) -> None:
    with pytest.raises(ValueError, match="max_landmarks must be an integer >= 1"):
        StereoEKF(CAMERA, INDEPENDENT_PIXELS, max_landmarks=value)
