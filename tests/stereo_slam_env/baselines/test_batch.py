"""Full smoothing: what it solves, how it is guided, and what it makes of outliers (10 s)."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import pytest

from filters import StereoEKF, StereoObservation
from stereo_slam_env.benchmark.recordings.reference_problem import short_turn
from stereo_slam_env.recording.recording import Recording

pytest.importorskip("gtsam", reason="needs the extra gtsam")

from stereo_slam_env.baselines.smoothers import BatchSmoother


def driven(stereo_filter, recording: Recording):
    start = recording.start
    stereo_filter.reset(start)
    for k, frame in enumerate(recording.frames):
        if k:
            stereo_filter.predict(frame.timestamp - recording.frames[k - 1].timestamp, frame.odometry)
        stereo_filter.update(frame.observation)
    return stereo_filter


def smoother(recording: Recording, **options) -> BatchSmoother:
    return driven(BatchSmoother(recording.camera, recording.noise, **options), recording)


def worst_position(positions: np.ndarray, recording: Recording) -> float:
    return float(np.abs(positions - [frame.truth.position for frame in recording.frames]).max())


def with_outliers(recording: Recording, share: float) -> Recording:
    """In every frame some measurements are somewhere else altogether."""
    rng = np.random.default_rng(5)
    frames = []
    for frame in recording.frames:
        seen = frame.observation
        uvd, wrong = seen.uvd.copy(), rng.random(len(seen)) < share
        uvd[wrong] += rng.uniform(-40, 40, (wrong.sum(), 3))
        frames.append(replace(frame, observation=StereoObservation(seen.ids, uvd)))
    return replace(recording, frames=tuple(frames))


def test_the_solution_has_a_pose_for_every_frame_and_the_cost_it_should() -> None:
    recording = short_turn(0)
    smoothed = smoother(recording, gate=None).smooth()
    assert smoothed.positions.shape == (12, 3)
    assert smoothed.orientations.shape == (12, 4)
    # chi-square with so many degrees of freedom: four standard deviations.
    spread = np.sqrt(2.0 / smoothed.degrees_of_freedom)
    assert smoothed.chi_square / smoothed.degrees_of_freedom == pytest.approx(1.0, abs=4 * spread)
    assert worst_position(smoothed.positions, recording) < 0.15


def test_the_last_pose_is_the_solution_and_the_guide_goes_on_from_there() -> None:
    recording = short_turn(1)
    estimator = smoother(recording, gate=None)
    smoothed = estimator.smooth()
    estimator.predict(1e-9)
    np.testing.assert_allclose(estimator.pose.position, smoothed.positions[-1], atol=1e-6)
    before = np.linalg.norm(estimator.landmarks.positions - estimator.pose.position, axis=1)
    guide = estimator._guide
    np.testing.assert_allclose(
        before, np.linalg.norm(guide.landmarks.positions - guide.pose.position, axis=1), rtol=1e-9
    )


def test_without_solutions_on_the_way_it_is_its_guide() -> None:
    recording = short_turn(2)
    alone = driven(
        StereoEKF(recording.camera, recording.noise, landmark="shared-anchor", measurement="stacked"), recording
    )
    guided = smoother(recording, growth=np.inf)
    # One step was solved before the drive could grow.
    assert np.linalg.norm(guided.pose.position - alone.pose.position) < 0.05
    np.testing.assert_allclose(np.diag(guided.pose.covariance)[3:], np.diag(alone.pose.covariance)[3:], rtol=1e-12)


def test_a_deep_copy_solves_on_its_own() -> None:
    recording = short_turn(3)
    estimator = smoother(recording)
    twin = copy.deepcopy(estimator)
    np.testing.assert_array_equal(estimator.smooth().positions, twin.smooth().positions)


@pytest.mark.parametrize("options", [{"consensus": True}, {"consensus": True, "tail_dof": 4.0}])
def test_the_guide_keeps_outliers_out(options: dict) -> None:
    recording = with_outliers(short_turn(4), 0.25)
    defended, bare = (smoother(recording, **chosen).smooth() for chosen in (options, {"gate": None}))
    assert worst_position(defended.positions, recording) < 0.2
    assert worst_position(bare.positions, recording) > 5 * worst_position(defended.positions, recording)


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ({"right_row": 1}, "right_row must be True or False, got 1"),
        ({"growth": 0.0}, "growth must be"),
        ({"tail_dof": -1.0}, "tail_dof must be"),
        ({"gate": None, "consensus": True}, "gate must be a probability with consensus=True"),
    ],
)
def test_impossible_options_are_refused(options: dict, complaint: str) -> None:
    recording = short_turn(0, frames=2)
    with pytest.raises(ValueError, match=complaint):
        BatchSmoother(recording.camera, recording.noise, **options)
