"""A reference is held against the images, step by step."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from filters import Pose
from filters.geometry import rotations
from stereo_slam_env.evaluation.audits import ReferenceAudit
from stereo_slam_env.frontend import camera_motion
from stereo_slam_env.frontend.camera_motion import audit_of, needed_motion
from stereo_slam_env.frontend.ego_motion import robust_step
from stereo_slam_env.frontend.track_noise import with_measured_noise
from stereo_slam_env.recording.recording import SIMULATION, Recording

from .test_track_noise import drive


def spoiled(recording: Recording, frames: range, turn: np.ndarray) -> Recording:
    """The drive with the true poses of some frames turned by a rotation vector, rad."""
    by = Pose(np.zeros(3), rotations.exp_quaternion(turn))
    poses = [frame.truth @ by if k in frames else frame.truth for k, frame in enumerate(recording.frames)]  # type: ignore[operator]
    moved = (dataclasses.replace(frame, truth=pose) for frame, pose in zip(recording.frames, poses, strict=True))
    return dataclasses.replace(recording, frames=tuple(moved))


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("degrees", [0.2, 1.0])
def test_steps_into_and_out_of_wrong_poses_are_doubtful_and_no_others(axis: int, degrees: float) -> None:
    wrong = spoiled(drive(white=0.1), range(20, 25), np.radians(degrees) * np.eye(3)[axis])
    audit = audit_of(wrong)
    assert audit.frames[audit.doubtful].tolist() == [20, 25]
    assert "disagree in 2 of 59 steps" in str(audit)
    assert "20, 25" in str(audit)


@pytest.mark.parametrize("errors", [{}, {"white": 0.5}, {"walk": 0.3}, {"slide": 0.3}])
@pytest.mark.parametrize("seed", range(3))
def test_true_poses_are_not_in_doubt(errors: dict[str, float], seed: int) -> None:
    audit = audit_of(drive(seed=seed, **errors))
    assert len(audit.frames) == 59
    assert not audit.doubtful.any()
    assert "tracks and reference agree in" in str(audit)


def test_frames_without_a_truth_are_not_audited() -> None:
    recording = drive(white=0.1)
    half = tuple(dataclasses.replace(frame, truth=None) for frame in recording.frames[:30])
    audit = audit_of(dataclasses.replace(recording, frames=half + recording.frames[30:]))
    assert audit.frames.min() == 31
    one = half + recording.frames[30:31]
    assert "no motion" in str(audit_of(dataclasses.replace(recording, frames=one)))


def test_without_a_truth_or_with_an_exact_one_there_is_nothing_to_audit() -> None:
    recording = drive(white=0.1)
    none = tuple(dataclasses.replace(frame, truth=None) for frame in recording.frames)
    assert audit_of(dataclasses.replace(recording, frames=none)) is None
    assert audit_of(dataclasses.replace(recording, truth_from=SIMULATION)) is None


def test_an_audit_survives_as_json() -> None:
    audit = audit_of(spoiled(drive(white=0.1), range(20, 25), np.array([0.0, 0.01, 0.0])))
    again = ReferenceAudit.from_dict(json.loads(json.dumps(audit.as_dict())))
    np.testing.assert_array_equal(again.doubtful, audit.doubtful)
    assert str(again) == str(audit)


def test_the_motions_between_the_frames_are_found_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Noise of the tracks, accelerations and audit share them, and the noise that is found changes no frame."""
    calls = []
    monkeypatch.setattr(camera_motion, "robust_step", lambda *given: calls.append(0) or robust_step(*given))
    recording = with_measured_noise(drive(white=0.1, seed=7))
    needed_motion(recording)
    audit_of(recording)
    assert len(calls) == len(recording) - 1
