"""Trials in lock-step are the filter itself, to 1e-9, whatever happens in each of them (20 s)."""

from __future__ import annotations

import inspect
from dataclasses import replace

import numpy as np
import pytest

from filters import StereoEKF, StereoEKFTrials, StereoObservation, VelocityDriven, make_filter

from ..drives import CAMERA, DT, INDEPENDENT_PIXELS, drive
from .drives_together import EQUAL, Race, drives, ekf, noisy_odometry

NOTHING = StereoObservation([], np.zeros((0, 3)))


def test_a_hundred_frames_with_landmarks_that_come_and_go():
    race = Race(3)
    race.run(drives(3, 101, noise_scale=1.6))
    for event in ("updated", "initialised", "dropped", "gated"):
        assert race.events[event] > 20, event


@pytest.mark.parametrize("landmark", ["inverse-depth", "shared-anchor", "euclidean"])
@pytest.mark.parametrize("measurement", ["joint", "left", "stacked", "sequential"])
def test_every_landmark_with_every_measurement(landmark, measurement):
    race = Race(3, landmark=landmark, measurement=measurement, min_disparity=10.0)
    race.run(drives(3, 12))
    assert race.events["rejected"] > 0


@pytest.mark.parametrize("measurement", ["stacked", "sequential"])
def test_a_measured_right_row(measurement):
    Race(3, measurement=measurement).run(drives(3, 15, v_right=True))


@pytest.mark.parametrize("landmark", ["inverse-depth", "shared-anchor", "euclidean"])
@pytest.mark.parametrize("error", ["quaternion", "so3"])
def test_landmarks_that_stay_in_the_map_and_are_seen_again(landmark, error):
    """The map outgrows the frame: only the measured landmarks are worked on."""
    race = Race(3, landmark=landmark, error=error, drop_unseen=False, gate=None)
    race.run(drives(3, 20, missed=0.3))
    seen = race.events["updated"] / (20 * 3)
    assert all(len(slam.landmarks.ids) > 1.5 * seen for slam in race.alone)


@pytest.mark.parametrize("landmark", ["inverse-depth", "shared-anchor"])
def test_odometry_in_some_steps_of_some_trials(landmark):
    Race(3, landmark=landmark).run(drives(3, 20), noisy_odometry(3, 20))


def test_frames_without_measurements_in_some_trials_and_in_all():
    trials = drives(4, 12)
    trials[1][5] = trials[2][0] = NOTHING
    for trial in trials:
        trial[8] = NOTHING
    race = Race(4)
    race.run(trials)
    assert race.events["dropped"] > 0


def test_a_covariance_of_its_own_for_some_measurements():
    trials = drives(3, 15)
    rng = np.random.default_rng(0)
    for trial in (trials[0], trials[2]):
        for k, seen in enumerate(trial):
            R = INDEPENDENT_PIXELS.R * rng.uniform(0.5, 4.0, (len(seen), 1, 1))
            trial[k] = StereoObservation(seen.ids, seen.uvd, R=R)
    Race(3).run(trials)


def test_measurements_in_any_order():
    trials = drives(3, 12)
    rng = np.random.default_rng(0)
    Race(3).run([[seen.select(rng.permutation(len(seen))) for seen in trial] for trial in trials])


def test_landmarks_behind_the_camera():
    race = Race(2, gate=None)
    first = [trial[0] for trial in drives(2, 1)]
    race.update(first)
    for _ in range(300):
        race.predict()
    race.update(first)
    assert race.events["behind_camera"] > 0


def test_a_trial_without_a_factorisation_harms_no_other_and_loses_only_the_measurement():
    race = Race(3, gate=None)
    trials = drives(3, 4, missed=0.0)
    for k in (0, 1):
        if k:
            race.predict()
        race.update([trial[k] for trial in trials])
    worst = 1
    landmark = int(race.alone[worst].landmarks.ids[2])
    states, state = race.together._states, race.alone[worst]._state
    place = int(np.flatnonzero(states.ids[worst] == landmark)[0])
    disparity = states.map_rows(np.array([worst]), np.array([place]))[0, -1]
    states.P[worst, disparity, disparity] -= 1.0
    block = state.parameter_block[state.ids == landmark][0]
    state.P[12 + 3 * block + 2, 12 + 3 * block + 2] -= 1.0
    race.predict()
    reports = race.update([trial[2] for trial in trials])
    assert landmark in reports[worst].failed
    assert race.events["failed"] == 1


def test_a_trial_that_has_lost_all_numbers_harms_no_other():
    together = StereoEKFTrials(ekf(), 3)
    together.reset([{}, {"covariance": 1e-6 * np.eye(12)}, {}])
    alone = ekf()
    trials = drives(3, 6)
    together._states.P[1] = np.nan
    for k in range(6):
        if k:
            together.predict(DT)
            alone.predict(DT)
        together.update([trial[k] for trial in trials])
        alone.update(trials[2][k])
    np.testing.assert_allclose(together.pose.covariance[2], alone.pose.covariance, rtol=EQUAL, atol=EQUAL)
    np.testing.assert_allclose(together.pose.position[2], alone.pose.position, rtol=EQUAL, atol=EQUAL)


@pytest.mark.parametrize("error", ["quaternion", "so3"])
def test_pose_errors_are_those_of_each_filter(error):
    race = Race(3, error=error)
    frames = drive(0, 6, visible=8)
    race.run([[frame.observation for frame in frames]] * 3)
    truth = frames[-1]
    errors, covariances = race.together.pose_error(np.tile(truth.position, (3, 1)), np.tile(truth.orientation, (3, 1)))
    for b, slam in enumerate(race.alone):
        wanted, covariance = slam.pose_error(truth.position, truth.orientation)
        np.testing.assert_allclose(errors[b], wanted, rtol=EQUAL, atol=EQUAL)
        np.testing.assert_allclose(covariances[b], covariance, rtol=EQUAL, atol=EQUAL)


@pytest.mark.parametrize("landmark", ["inverse-depth", "shared-anchor", "euclidean"])
def test_a_trial_can_go_on_alone(landmark):
    race = Race(2, landmark=landmark)
    trials = drives(2, 12)
    race.run([trial[:8] for trial in trials])
    leaving = race.together.trial(1)
    for seen in trials[1][8:]:
        for slam in (leaving, race.alone[1]):
            slam.predict(DT)
            slam.update(seen)
    np.testing.assert_allclose(leaving.pose.covariance, race.alone[1].pose.covariance, rtol=EQUAL, atol=EQUAL)
    np.testing.assert_array_equal(leaving.landmarks.ids, race.alone[1].landmarks.ids)


def test_memory_follows_the_size_of_the_maps():
    together = StereoEKFTrials(ekf(), 2)
    many, few = ([trial[0] for trial in drives(2, 1, visible=visible)] for visible in (60, 5))
    together.update(many)
    large = together._states.P.shape[1]
    for new in range(3):
        together.predict(DT)
        together.update([StereoObservation(seen.ids + 1000 * (new + 1), seen.uvd) for seen in few])
    assert together._states.P.shape[1] < 0.2 * large


def test_a_named_filter_is_run_with_its_choices():
    one = make_filter("dual-bearing", camera=CAMERA, noise=INDEPENDENT_PIXELS, gate=None)
    together = StereoEKFTrials(one, 2)
    trials = drives(2, 4)
    for k in range(4):
        together.predict(DT)
        one.predict(DT)
        reports = together.update([trial[k] for trial in trials])
        report = one.update(trials[1][k])
    assert reports[1].nis == pytest.approx(report.nis, rel=1e-9)


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({"update": "unscented"}, "update"),
        ({"consensus": True}, "consensus"),
        ({"tail_dof": 4.0}, "tail_dof"),
        ({"iterations": 2}, "iterations"),
        ({"error": "first-estimates"}, "error"),
        ({"error": "right-invariant"}, "error"),
        ({"motion": VelocityDriven()}, "motion"),
        ({"max_landmarks": 10}, "max_landmarks"),
        ({"landmark": "hybrid"}, "landmark"),
    ],
)
def test_an_option_that_works_only_one_by_one_is_refused_by_name(options, name):
    with pytest.raises(ValueError, match=f"^{name} must be .*: use StereoEKF one by one"):
        StereoEKFTrials(ekf(**options), 2)


def test_no_option_of_the_filter_is_silently_ignored():
    """A new option of `StereoEKF` must be decided on here: supported in lock-step, or refused."""
    supported = {"motion", "gate", "landmark", "measurement", "error", "drop_unseen", "min_disparity"}
    refused = {"update", "consensus", "tail_dof", "iterations", "max_landmarks"}
    without_effect_on_results = {"compiled"}
    options = set(inspect.signature(StereoEKF.__init__).parameters) - {"self", "camera", "noise"}
    assert options == supported | refused | without_effect_on_results


class TestBadInputIsRefusedAndChangesNothing:
    @pytest.fixture
    def slam(self):
        slam = StereoEKFTrials(ekf(), 2)
        slam.update([trial[0] for trial in drives(2, 1)])
        self.before = slam._states.P.copy()
        yield slam
        np.testing.assert_array_equal(slam._states.P, self.before)

    def test_another_number_of_observations(self, slam):
        with pytest.raises(ValueError, match="observations must be one for each of 2 trials, got 1"):
            slam.update([NOTHING])

    def test_something_else_than_an_observation(self, slam):
        with pytest.raises(ValueError, match=r"observations\[1\] must be a StereoObservation"):
            slam.update([NOTHING, None])

    def test_a_right_row_in_some_trials_only(self, slam):
        seen = drives(1, 1)[0][0]
        with pytest.raises(ValueError, match="v_right must be measured in all trials"):
            slam.update([seen, replace(seen, v_right=seen.uvd[:, 1])])

    def test_time_that_stands_still(self, slam):
        with pytest.raises(ValueError, match="dt must be"):
            slam.predict(0.0)

    @pytest.mark.parametrize("odometry", [[None], [None, "fast"]])
    def test_odometry_that_is_none(self, slam, odometry):
        with pytest.raises(ValueError, match=r"odometry(\[1\])? must be"):
            slam.predict(DT, odometry)

    @pytest.mark.parametrize("starts", [[{}], [{}, {"speed": 3.0}], [{}, {"position": (0, 0)}]])
    def test_an_impossible_start(self, slam, starts):
        with pytest.raises(ValueError, match=r"^(starts|position) must"):
            slam.reset(starts)


@pytest.mark.parametrize(("one", "trials"), [(ekf(), 0), (ekf(), 2.0), (None, 2)])
def test_what_cannot_be_run_is_refused(one, trials):
    with pytest.raises(ValueError, match="must be"):
        StereoEKFTrials(one, trials)
