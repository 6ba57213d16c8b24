"""The recursion of the best estimator, frame by frame (1 s)."""

import numpy as np

from filters import ConstantVelocity, make_filter
from stereo_slam_env.evaluation.cramer_rao import ReferenceBelief

from ..benchmark.small_recordings import small_recording

MOTION = ConstantVelocity(2.0, 0.5)


def run(recording, keep_all=True):
    """The belief after the whole recording."""
    first = recording.frames[0]
    best = ReferenceBelief(recording.camera, recording.noise, MOTION, recording.start, first.truth)
    for frame in recording.frames:
        best.step(frame, recording.landmarks)
        if not keep_all:
            best.keep(frame.observation.ids)
    return best


def test_it_claims_what_a_filter_with_hardly_any_noise_claims():
    """Then the filter, too, is linearised at the truth."""
    recording = small_recording(sigma=1e-4, frames=10)
    slam = make_filter(
        "euclidean", camera=recording.camera, noise=recording.noise, motion=MOTION, gate=None, drop_unseen=False
    )
    start = recording.start
    slam.reset(start)
    for k, frame in enumerate(recording.frames):
        if k:
            slam.predict(0.1, frame.odometry)
        slam.update(frame.observation)
    best, claimed = run(recording).joint_covariance(), slam.joint_covariance()
    sigmas = np.sqrt(np.diag(best))
    np.testing.assert_allclose(claimed / np.outer(sigmas, sigmas), best / np.outer(sigmas, sigmas), atol=1e-3)


def test_its_joint_covariance_is_that_of_the_pose_and_of_all_it_has_seen():
    recording = small_recording()
    best = run(recording)
    joint = best.joint_covariance()
    np.testing.assert_allclose(joint[:6, :6], best.pose_covariance, rtol=1e-12)
    assert len(joint) == 6 + 3 * len(best.ids)
    assert np.linalg.eigvalsh(joint)[0] > 0


def test_what_is_never_seen_again_can_go_without_loss():
    recording = small_recording(frames=25)
    kept, lean = run(recording), run(recording, keep_all=False)
    assert len(lean.ids) < len(kept.ids)
    np.testing.assert_array_equal(lean.ids, recording.frames[-1].observation.ids)
    np.testing.assert_allclose(lean.pose_covariance, kept.pose_covariance, rtol=1e-9, atol=1e-18)


def test_it_starts_with_what_the_estimator_is_told():
    recording = small_recording()
    best = ReferenceBelief(recording.camera, recording.noise, MOTION, recording.start, recording.frames[0].truth)
    np.testing.assert_array_equal(best.pose_covariance, recording.start.covariance[:6, :6])
    assert len(best.ids) == 0
    np.testing.assert_array_equal(best.joint_covariance(), best.pose_covariance)


def test_odometry_counts():
    with_odometry, without = (run(small_recording(odometry=given)).pose_covariance for given in (True, False))
    assert np.trace(with_odometry) < 0.99 * np.trace(without)
