"""Landmark drift: a filter whose landmarks may walk in the image is as certain as it is right when they do."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from filters import LandmarkDrift, Start, StereoEKF, StereoObservation, nees

from ..drives import CAMERA, INDEPENDENT_PIXELS, SPEED, Frame, drive, run, start

START = Start(linear_velocity=(0.0, 0.0, SPEED), covariance=np.diag(np.repeat([1e-3, 1e-3, 0.5, 0.5], 3) ** 2))
SHARE, RUNS, FRAMES = 0.5, 60, 25
UPPER = chi2.ppf(0.999, 6 * RUNS) / (6 * RUNS)


def walking(seed: int, share: float) -> list[Frame]:
    """A drive past points that walk: by `share` of the noise a frame, as the camera sees them then."""
    rng = np.random.default_rng(1000 + seed)
    root = np.linalg.cholesky(INDEPENDENT_PIXELS.R)
    walked: dict[int, np.ndarray] = defaultdict(lambda: np.zeros(3))
    frames = []
    for frame in drive(seed, FRAMES, visible=20, missed=0.0, noise_scale=0.0):
        R_wc, ids = Rotation.from_quat(frame.orientation).as_matrix(), frame.observation.ids
        points_c = CAMERA.backproject(frame.observation.uvd) + np.array([walked[i] for i in ids.tolist()]) @ R_wc
        exact = CAMERA.project(points_c)
        noise, step = rng.standard_normal((2, len(ids), 3)) @ root.T
        frames.append(replace(frame, observation=StereoObservation(ids, exact + noise)))
        by_uvd = np.linalg.inv(CAMERA.project_jacobian(points_c))
        for i, by_step in zip(ids.tolist(), np.einsum("mij,mj->mi", share * by_uvd, step), strict=True):
            walked[i] = walked[i] + R_wc @ by_step
    return frames


def mean_nees(share: float, **options: object) -> float:
    """Mean NEES/6 of the last pose over drives past points that walk."""
    values = []
    for seed in range(RUNS):
        frames = walking(seed, share)
        slam = StereoEKF(CAMERA, INDEPENDENT_PIXELS, landmark="shared-anchor", **options)
        slam.reset(START)
        list(run(slam, frames))
        error, covariance = slam.pose_error(frames[-1].position, frames[-1].orientation)
        values.append(nees(error[None], covariance[None])[0] / 6)
    return float(np.mean(values))


def test_the_pose_is_as_certain_as_it_is_right_with_the_drift_and_too_certain_without() -> None:
    # Points that stay give 0.65: the priors of start and motion are broader than what is driven.
    assert 0.6 < mean_nees(SHARE, drift=SHARE) < UPPER
    assert mean_nees(SHARE) > 2.0


def test_the_two_parts_of_a_step_add_up_to_it() -> None:
    drift = LandmarkDrift(share=0.3, pixels=(1.0, 2.0, 0.5), gate_pixels=(0.5, 0.1, 0.5))
    np.testing.assert_allclose(drift.parts, [[0.09, 0.25, 0.01, 0.25], [0.0, 0.75, 3.99, 0.0]])


def test_a_joint_test_for_short_steps_refuses_what_one_for_long_steps_lets_in() -> None:
    frames = drive(4, 8, missed=0.0, noise_scale=0.1)
    seen = frames[-1].observation
    wrong = seen.uvd.copy()
    wrong[0, 0] += 10.0
    frames[-1] = replace(frames[-1], observation=StereoObservation(seen.ids, wrong))
    drift = {"pixels": (4.0, 4.0, 2.0)}
    for gate_pixels, gated in ((None, False), ((0.2, 0.2, 0.2), True)):
        steps = {**drift, "gate_pixels": gate_pixels}
        slam = StereoEKF(CAMERA, INDEPENDENT_PIXELS, drift=steps, consensus=True)
        *_, last = run(start(slam), frames)
        assert (seen.ids[0] in last.gated) == gated


@pytest.mark.parametrize(
    ("given", "complaint"),
    [
        (-0.1, "share of drift must be"),
        (float("nan"), "share of drift must be"),
        ("much", "drift must be a share of the noise, a table"),
        (True, "drift must be a share of the noise, a table"),
        ({"pixel": (1.0, 1.0, 1.0)}, "drift must have no key but share, pixels and gate_pixels, got pixel"),
        ({"pixels": (1.0, 1.0)}, r"pixels of drift must be 3 finite numbers"),
        ({"pixels": (1.0, 1.0, -1.0)}, r"pixels of drift must be 3 finite numbers"),
        ({"pixels": (1.0, 1.0, 1.0), "gate_pixels": (2.0, 1.0, 1.0)}, "gate_pixels of drift must be at most pixels"),
    ],
)
def test_an_impossible_drift_is_refused(given: object, complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        StereoEKF(CAMERA, INDEPENDENT_PIXELS, drift=given)
