"""The loop that runs a filter (2 s)."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from filters import InverseDepthStereoEKF, Pose, StereoNoise, StereoObservation, make_filter
from stereo_slam_env.loop import FilterLoop, run
from stereo_slam_env.recording.archive import load_recording, save_recording
from stereo_slam_env.recording.recording import Frame, Reference
from stereo_slam_env.sensing.corruptions import DroppedFrames

from ..filters.drives import CAMERA as OTHER_CAMERA
from ..filters.drives import INDEPENDENT_PIXELS as PIXELS
from ..filters.inertial_drives import Journey, driven
from .benchmark.small_recordings import CAMERA, DT, small_recording

RECORDING = small_recording()


class Noted(InverseDepthStereoEKF):
    """Notes its calls."""

    def __init__(self, camera, noise, **options):
        self.calls = []
        super().__init__(camera, noise, **options)

    def reset(self, *start):
        self.calls.append("reset")
        super().reset(*start)

    def predict(self, dt, odometry=None):
        self.calls.append(("predict", round(dt, 9), odometry is not None))
        super().predict(dt, odometry)

    def update(self, observation):
        self.calls.append(("update", len(observation)))
        return super().update(observation)


@pytest.mark.parametrize("use_odometry", [True, False])
def test_the_first_frame_updates_and_every_later_one_predicts_first(use_odometry):
    slam = Noted(CAMERA, RECORDING.noise)
    moments = run(slam, RECORDING, use_odometry=use_odometry)
    slam.calls.clear()
    for moment, frame in zip(moments, RECORDING.frames, strict=True):
        step = [] if moment.number == 0 else [("predict", DT, use_odometry)]
        assert slam.calls == [*step, ("update", len(frame.observation))]
        assert (moment.time, moment.observation, moment.truth) == (frame.timestamp, frame.observation, frame.truth)
        slam.calls.clear()


def with_samples():
    """A drive with an inertial unit, as a recording."""
    journey = Journey.along(driven, 0, 2.0)
    frames = tuple(
        Frame(
            DT * k, step.observation, truth=Pose(step.position, step.orientation), inertial=step.inertial if k else None
        )
        for k, step in enumerate(journey.steps)
    )
    return replace(RECORDING, camera=OTHER_CAMERA, noise=PIXELS, frames=frames, start=journey.start, landmarks=None)


def ends(recording):
    *_, last = run("inertial", recording)
    return [last.pose.position, last.pose.orientation, last.pose.covariance, last.landmarks.positions]


def test_inertial_samples_are_used_and_replayed_to_the_same_bits(tmp_path):
    recording = with_samples()
    save_recording(tmp_path / "drive.npz", recording)
    for one, other in zip(ends(recording), ends(load_recording(tmp_path / "drive.npz")), strict=True):
        np.testing.assert_array_equal(one, other)


def test_samples_of_dropped_frames_are_those_of_the_longer_step():
    recording = with_samples()
    gaps = DroppedFrames(0.4).applied_to(recording, np.random.default_rng(0))
    assert len(gaps) < 16
    *_, last = run("inertial", gaps)
    assert last.position_error < 0.2


def test_a_filter_of_somebody_who_knows_no_samples_runs_without_and_says_so_once(caplog):
    with caplog.at_level("WARNING"):
        *_, last = run(Noted, with_samples())
    said = [record.getMessage() for record in caplog.records if "makes no use" in record.getMessage()]
    assert last.position_error < 1.0
    assert said == ["Noted makes no use of the inertial samples that it is given"]


def test_odometry_is_used_unless_it_is_withheld():
    slam = Noted(CAMERA, RECORDING.noise)
    list(run(slam, RECORDING))
    loop = FilterLoop(slam)
    loop.reset(RECORDING.start)
    for frame in RECORDING.frames:
        loop.step(frame)
    predicted = [call for call in slam.calls if call[0] == "predict"]
    assert predicted == [("predict", DT, True)] * (2 * (len(RECORDING) - 1))


@pytest.mark.parametrize("slam", ["inverse-depth", InverseDepthStereoEKF])
def test_a_name_a_class_and_an_instance_are_the_same_filter(slam):
    made = make_filter("inverse-depth", camera=CAMERA, noise=RECORDING.noise, gate=0.95)
    expected = [moment.pose.position for moment in run(made, RECORDING)]
    np.testing.assert_array_equal([m.pose.position for m in run(slam, RECORDING, gate=0.95)], expected)
    np.testing.assert_array_equal([m.pose.position for m in run(made, RECORDING)], expected)  # it is reset


def test_what_is_impossible_is_refused_before_the_first_frame():
    with pytest.raises(ValueError, match="has no frames"):
        run("inverse-depth", replace(RECORDING, frames=()))
    with pytest.raises(ValueError, match="recording must be a Recording, as load and record give it, got 'gtsam'"):
        run("inverse-depth", "gtsam")
    with pytest.raises(ValueError, match="did you mean 'inverse-depth'"):
        run("inverse-dept", RECORDING)
    made = make_filter("inverse-depth", camera=CAMERA, noise=RECORDING.noise)
    with pytest.raises(ValueError, match="noise, gate must be given to InverseDepthStereoEKF itself"):
        run(made, RECORDING, noise=StereoNoise.independent_pixels(1.0), gate=0.9)


def test_the_error_of_a_moment_is_that_of_the_filter_and_needs_an_independent_truth():
    for moment in run("right-invariant", RECORDING):
        error, covariance = moment.slam.pose_error(moment.truth.position, moment.truth.orientation)
        assert moment.nees == pytest.approx(error @ np.linalg.solve(covariance, error), rel=1e-9)
        assert moment.position_error == np.linalg.norm(moment.truth.position - moment.pose.position)
    odometry = replace(RECORDING, truth_from=Reference("odometry", "By hand."))
    assert all(np.isnan(moment.nees) and moment.position_error >= 0.0 for moment in run("inverse-depth", odometry))
    for moment in run("inverse-depth", small_recording(truth=False)):
        assert moment.pose_error is None
        assert np.isnan([moment.nees, moment.position_error]).all()


@pytest.mark.parametrize("filter_name", ["inverse-depth", "right-invariant"])
def test_stated_errors_of_the_truth_are_added_in_the_error_definition_of_the_filter(filter_name):
    """By differences of the filter's own error about its pose."""
    stated = Reference("surveyed", "By hand.", position_jitter=0.02, rotation_jitter=0.003, misalignment=0.002)
    first, step = RECORDING.frames[0].truth, 1e-5
    for moment in run(filter_name, replace(RECORDING, truth_from=stated)):
        position, turn = moment.pose.position, Rotation.from_quat(moment.pose.orientation)
        J = np.zeros((6, 6))
        for k, e in enumerate(step * np.eye(6)):
            ends = [(position + s * e[:3], (turn * Rotation.from_rotvec(s * e[3:])).as_quat()) for s in (1.0, -1.0)]
            plus, minus = (moment.slam.pose_error(*end)[0] for end in ends)
            J[:, k] = (plus - minus) / (2.0 * step)
        error, claimed = moment.pose_error
        wanted = claimed + J @ stated.covariance(first, moment.truth) @ J.T
        np.testing.assert_array_equal(moment.scored_error[0], error)
        np.testing.assert_allclose(moment.scored_error[1], wanted, rtol=1e-6, atol=1e-12)
        assert moment.nees == pytest.approx(error @ np.linalg.solve(wanted, error), rel=1e-6)


def test_a_held_moment_stays_when_the_filter_goes_on():
    held = [moment.hold() for moment in run("inverse-depth", RECORDING)]
    for kept, moment in zip(held, run("inverse-depth", RECORDING), strict=True):
        np.testing.assert_allclose(kept.pose.position, moment.pose.position, atol=1e-12)
        np.testing.assert_array_equal(kept.landmarks.ids, moment.landmarks.ids)


def test_measuring_may_be_guided_by_the_filter_and_is_not_timed():
    seen = []

    def observe(number, slam):
        seen.append((number, len(slam.landmarks.ids)))
        return StereoObservation([], np.zeros((0, 3))) if number == 3 else RECORDING.frames[number].observation

    moments = [moment.hold() for moment in run("inverse-depth", RECORDING, observe=observe)]
    assert [number for number, _ in seen] == list(range(len(RECORDING)))
    assert len(moments[3].observation) == len(moments[3].landmarks.ids) == 0
    assert seen[4] == (4, 0)


def test_a_filter_that_is_started_already_needs_no_reset():
    slam = Noted(CAMERA, RECORDING.noise)
    loop, (first, second) = FilterLoop(slam, use_odometry=False), RECORDING.frames[:2]
    slam.calls.clear()
    assert [loop.step(first).number, loop.step(second).number] == [0, 1]
    assert [call[0] for call in slam.calls] == ["update", "predict", "update"]


def test_after_a_refused_time_the_next_frame_is_predicted_from_the_last_good_one():
    slam = Noted(CAMERA, RECORDING.noise)
    loop = FilterLoop(slam, use_odometry=False)
    loop.reset(RECORDING.start)
    first, second, third = RECORDING.frames[:3]
    loop.step(first)
    loop.step(second)
    with pytest.raises(ValueError, match="dt must be"):
        loop.step(replace(third, timestamp=first.timestamp))
    assert loop.step(third).number == 2
    assert slam.calls[-2] == ("predict", pytest.approx(third.timestamp - second.timestamp), False)
