"""The Cramer-Rao bound against all states at once, inverted densely (2 s)."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from filters import ConstantVelocity, StereoNoise, StereoObservation, make_filter, make_part
from stereo_slam_env.evaluation.cramer_rao import ReferenceBelief, cramer_rao_bound, cramer_rao_bounds
from stereo_slam_env.evaluation.filter_run import run_filter

from ..benchmark.small_recordings import CAMERA, DT, small_recording

MOTION = ConstantVelocity(2.0, 0.5)
START = np.repeat([0.05, 0.01, 0.3, 0.05], 3)
# A landmark seen throughout, one lost for ever, one that comes back, one that comes late, and some that keep the pose.
SEEN = ([0, 1, 2, 5, 6], [0, 1, 2, 5, 6], [0, 5, 6], [0, 2, 3, 5, 6], [0, 2, 3, 5])
STEP = 1e-5


def tiny_recording(seen=SEEN, odometry=False, right_row=False):
    """Five frames of the small drive with chosen sightings, each with a noise of its own."""
    recording = small_recording(frames=len(seen), odometry=odometry, sigma=1.0)
    rng = np.random.default_rng(1)
    frames = []
    for frame, wanted in zip(recording.frames, seen, strict=True):
        ids = frame.observation.ids[wanted]
        spread = rng.uniform(0.5, 2.0, len(ids))[:, None, None]
        uvd = frame.observation.uvd[wanted]
        observation = StereoObservation(ids, uvd, uvd[:, 1] if right_row else None, R=spread * recording.noise.R)
        frames.append(replace(frame, observation=observation))
    return replace(recording, frames=tuple(frames), start=replace(recording.start, covariance=np.diag(START**2)))


def dense_bound(recording, last: int, use_odometry: bool) -> np.ndarray:
    """Invert the Fisher information of start, impulses and map, from the sightings up to a frame; pose block (6, 6)."""
    truth = [frame.truth for frame in recording.frames]
    ids = np.unique(np.concatenate([frame.observation.ids for frame in recording.frames[: last + 1]]))
    points = recording.landmarks.positions[ids]
    true_poses = [(pose.position, Rotation.from_quat(pose.orientation)) for pose in truth]
    moves = [(b[0] - a[0]) / DT for a, b in pairwise(true_poses)]
    turns = [(a[1].inv() * b[1]).as_rotvec() / DT for a, b in pairwise(true_poses)]

    def drive(theta):
        """Poses and velocities of Eq. 6 from errors of start (12) and impulses (6 a step) about the truth."""
        r, R = true_poses[0][0] + theta[:3], true_poses[0][1] * Rotation.from_rotvec(theta[3:6])
        v, w = moves[0] + theta[6:9], turns[0] + theta[9:12]
        states = [(r, R, v, w)]
        for k in range(last):
            impulse = theta[12 + 6 * k : 18 + 6 * k]
            v = v + (moves[k] - moves[max(k - 1, 0)]) + impulse[:3]
            w = w + (turns[k] - turns[max(k - 1, 0)]) + impulse[3:]
            r, R = r + v * DT, R * Rotation.from_rotvec(w * DT)
            states.append((r, R, v, w))
        return states

    def measured(theta):
        landmarks = points + theta[12 + 6 * last :].reshape(-1, 3)
        out = []
        for k, (r, R, v, w) in enumerate(drive(theta)):
            place = np.searchsorted(ids, recording.frames[k].observation.ids)
            uvd = CAMERA.project((landmarks[place] - r) @ R.as_matrix())
            out.append(uvd.ravel())
            if recording.frames[k].observation.v_right is not None:
                out.append(uvd[:, 1])
            if use_odometry and k:
                half = R * Rotation.from_rotvec(-0.5 * DT * w)
                out.append(np.concatenate([half.inv().apply(v), w]))
        return np.concatenate(out)

    def pose(theta):
        r, R, _, _ = drive(theta)[-1]
        return np.concatenate([r, (true_poses[last][1].inv() * R).as_rotvec()])

    size = 12 + 6 * last + 3 * len(ids)
    weights = []
    for k, frame in enumerate(recording.frames[: last + 1]):
        weights += [np.linalg.inv(R) for R in frame.observation.R]
        if frame.observation.v_right is not None:
            weights += [1.0 / R[1:2, 1:2] for R in frame.observation.R]
        if use_odometry and k:
            weights.append(np.linalg.inv(frame.odometry.covariance))
    W = np.zeros((sum(map(len, weights)),) * 2)
    at = 0
    for weight in weights:
        W[at : at + len(weight), at : at + len(weight)] = weight
        at += len(weight)
    H, A = jacobian(measured, size), jacobian(pose, size)
    impulses = np.repeat([MOTION.sigma_acceleration * DT, MOTION.sigma_angular_acceleration * DT], 3)
    prior = np.concatenate([START, np.tile(impulses, last), np.full(3 * len(ids), np.inf)])
    return A @ np.linalg.solve(np.diag(prior**-2.0) + H.T @ W @ H, A.T)


def jacobian(function, size: int) -> np.ndarray:
    """Central differences at zero."""
    return np.array([(function(e) - function(-e)) / (2 * STEP) for e in STEP * np.eye(size)]).T


@pytest.mark.parametrize(("use_odometry", "right_row"), [(False, False), (True, False), (False, True)])
def test_the_bound_is_the_inverse_of_the_information_of_everything(use_odometry, right_row):
    recording = tiny_recording(odometry=True, right_row=right_row)
    told = []
    bound = cramer_rao_bound(recording, MOTION, use_odometry=use_odometry, progress=lambda *done: told.append(done))
    assert told == [(k, 5) for k in range(1, 6)]
    for last in range(len(recording)):
        wanted = dense_bound(recording, last, use_odometry)
        scale = np.sqrt(np.diag(wanted))
        np.testing.assert_allclose(
            bound.pose[last] / np.outer(scale, scale), wanted / np.outer(scale, scale), atol=1e-6
        )


@pytest.mark.parametrize("landmark", ["inverse-depth", "shared-anchor"])
def test_it_does_not_depend_on_the_parametrisation(landmark):
    recording = small_recording(frames=12)
    xyz = cramer_rao_bound(recording, MOTION).pose
    other = cramer_rao_bound(recording, MOTION, landmark=make_part("landmark", landmark)).pose
    np.testing.assert_allclose(other, xyz, rtol=1e-6, atol=1e-9 * np.abs(xyz).max())


def test_what_was_measured_does_not_matter_but_how_well():
    recording = small_recording()
    spoilt = tuple(
        replace(f, observation=StereoObservation(f.observation.ids, f.observation.uvd + np.array([3.0, -2.0, -9.0])))
        for f in recording.frames
    )
    bound = cramer_rao_bound(recording, MOTION).pose
    np.testing.assert_array_equal(cramer_rao_bound(replace(recording, frames=spoilt), MOTION).pose, bound)
    worse = replace(recording, noise=StereoNoise.independent_pixels(2.0))
    assert np.trace(cramer_rao_bound(worse, MOTION).pose[-1]) > 1.5 * np.trace(bound[-1])


def test_the_right_row_can_be_left_out():
    with_row = tiny_recording(right_row=True)
    alone = cramer_rao_bound(with_row, MOTION, right_row=False).pose
    np.testing.assert_array_equal(alone, cramer_rao_bound(tiny_recording(), MOTION).pose)
    assert np.trace(cramer_rao_bound(with_row, MOTION).pose[-1]) < np.trace(alone[-1])


def test_a_sighting_of_what_is_behind_the_camera_says_nothing():
    recording = small_recording()
    behind = replace(recording.landmarks, positions=np.vstack([recording.landmarks.positions, [0.0, 0.0, -30.0]]))
    behind = replace(behind, ids=np.arange(41))
    mistaken = [
        replace(f, observation=StereoObservation([*f.observation.ids, 40], [*f.observation.uvd, [600.0, 180.0, 20.0]]))
        for f in recording.frames
    ]
    bound = cramer_rao_bound(replace(recording, frames=tuple(mistaken), landmarks=behind), MOTION)
    np.testing.assert_allclose(bound.pose, cramer_rao_bound(recording, MOTION).pose, rtol=1e-9, atol=1e-18)


@pytest.mark.parametrize("empty", [0, 2])
def test_a_frame_without_measurements_says_nothing(empty):
    recording = small_recording(frames=6)
    frames = list(recording.frames)
    frames[empty] = replace(frames[empty], observation=frames[empty].observation.select(np.zeros(0, dtype=int)))
    bound, full = (
        cramer_rao_bound(each, MOTION).pose for each in (replace(recording, frames=tuple(frames)), recording)
    )
    assert np.trace(bound[max(empty, 1)]) > 1.05 * np.trace(full[max(empty, 1)])
    np.testing.assert_allclose(bound[:empty], full[:empty], rtol=1e-9)


def test_a_consistent_filter_claims_what_the_bound_allows():
    recording = small_recording(sigma=0.3, frames=30)
    options = {"motion": {"sigma_acceleration": 2.0, "sigma_angular_acceleration": 0.5}, "gate": None}
    claimed = run_filter(recording, "shared-anchor", options, use_odometry=False).pose_covariances
    bound = cramer_rao_bound(recording, MOTION).pose
    ratios = [np.linalg.eigvals(np.linalg.solve(b, c)).real for b, c in zip(bound[1:], claimed[1:], strict=True)]
    assert np.min(ratios) > 0.95
    assert np.max(ratios) < 1.05


@pytest.mark.parametrize("missing", ["poses", "one pose", "landmarks", "one landmark"])
def test_without_complete_truth_there_is_none(missing):
    recording = small_recording()
    frames, landmarks = list(recording.frames), recording.landmarks
    if missing == "poses":
        frames = [replace(frame, truth=None) for frame in frames]
    elif missing == "one pose":
        frames[4] = replace(frames[4], truth=None)
    elif missing == "landmarks":
        landmarks = None
    else:
        seen = frames[3].observation.ids[0]
        landmarks = replace(
            landmarks, ids=np.delete(landmarks.ids, seen), positions=np.delete(landmarks.positions, seen, 0)
        )
    assert cramer_rao_bound(replace(recording, frames=tuple(frames), landmarks=landmarks), MOTION) is None


@pytest.mark.parametrize("use_odometry", [True, False])
def test_together_recordings_have_the_bits_that_each_has_alone(use_odometry):
    """Of any length and noise; one without truth has no bound, and takes none from the others."""
    drives = [tiny_recording(), small_recording(1), small_recording(2, truth=False), small_recording(3, frames=4)]
    together = cramer_rao_bounds(drives, MOTION, use_odometry=use_odometry)
    alone = [cramer_rao_bound(drive, MOTION, use_odometry=use_odometry) for drive in drives]
    assert together[2] is None
    assert alone[2] is None
    for k in (0, 1, 3):
        np.testing.assert_array_equal(together[k].pose, alone[k].pose)


def test_recordings_of_different_cameras_are_not_run_together():
    other = replace(small_recording(), camera=replace(CAMERA, baseline=0.3))
    with pytest.raises(ValueError, match="differs from the first"):
        cramer_rao_bounds([small_recording(), other], MOTION)


def best_of(recording, keep_all=True):
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
    best, claimed = best_of(recording).joint_covariance(), slam.joint_covariance()
    sigmas = np.sqrt(np.diag(best))
    np.testing.assert_allclose(claimed / np.outer(sigmas, sigmas), best / np.outer(sigmas, sigmas), atol=1e-3)


def test_its_joint_covariance_is_that_of_the_pose_and_of_all_it_has_seen():
    recording = small_recording()
    best = best_of(recording)
    joint = best.joint_covariance()
    np.testing.assert_allclose(joint[:6, :6], best.pose_covariance, rtol=1e-12)
    assert len(joint) == 6 + 3 * len(best.ids)
    assert np.linalg.eigvalsh(joint)[0] > 0


def test_what_is_never_seen_again_can_go_without_loss():
    recording = small_recording(frames=25)
    kept, lean = best_of(recording), best_of(recording, keep_all=False)
    assert len(lean.ids) < len(kept.ids)
    np.testing.assert_array_equal(lean.ids, recording.frames[-1].observation.ids)
    np.testing.assert_allclose(lean.pose_covariance, kept.pose_covariance, rtol=1e-9, atol=1e-18)
