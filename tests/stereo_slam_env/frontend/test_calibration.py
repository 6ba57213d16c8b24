"""What the rectification left along the rows (about 6 s)."""

import numpy as np
import pytest

from filters.geometry import rotations
from stereo_slam_env.frontend.ego_motion import Pairs, Step
from stereo_slam_env.frontend.rectification_errors import PRIOR_SIGMA, DisparityOffset, calibrated
from stereo_slam_env.frontend.settings import TrackerSettings
from stereo_slam_env.frontend.track_recorder import record_tracks

from .drawn_street import DrawnStreet
from .synthetic_steps import CAMERA

SETTINGS = TrackerSettings(max_landmarks=60, refill_below=50)
PAIRS = 24


def offset_of(right_shift):
    return calibrated(DrawnStreet(PAIRS, right_shift=right_shift), SETTINGS, PAIRS).disparity_offset


@pytest.mark.parametrize("residual", [0.3, -0.3])
def test_the_residual_of_a_rig_is_found(residual):
    assert offset_of(residual) == pytest.approx(residual, abs=0.06)


def test_a_perfect_rig_is_hardly_changed():
    assert abs(offset_of(0.0)) < 0.02


def test_what_little_motion_leaves_unknown_is_left_to_the_filter():
    """Three pairs say next to nothing: the offset is as unknown as before, and filters that estimate it are told so."""
    street = DrawnStreet(3, right_shift=0.3)
    settings = calibrated(street, SETTINGS, 3)
    assert settings.disparity_offset_sigma == pytest.approx(PRIOR_SIGMA, rel=0.2)
    noise = record_tracks(street, settings).noise
    assert noise.disparity_offset == settings.disparity_offset_sigma


def learned(offset, seed=0, steps=8, sigma=0.1):
    """Drive 5 m past a cloud of points, `steps` times; all measured disparities are too small by `offset`."""
    rng = np.random.default_rng(seed)
    step = Step(rotations.exp([0.004, 0.03, -0.002]), np.array([0.05, -0.02, 5.0]))
    estimate = DisparityOffset(CAMERA)
    for _ in range(steps):
        depth = rng.uniform(10.0, 60.0, 80)
        uvd = np.column_stack(
            [rng.uniform(300, 1000, 80), rng.uniform(100, 300, 80), CAMERA.disparity_constant / depth]
        )
        first, second = (
            CAMERA.project(p) - [0, 0, offset] + sigma * rng.standard_normal((80, 3))
            for p in (CAMERA.backproject(uvd), (CAMERA.backproject(uvd) - step.t) @ step.R)
        )
        R = np.tile(sigma**2 * np.eye(3), (80, 1, 1))
        estimate.learn(Pairs(first, second, R, R), step)
    return estimate


def test_the_estimate_is_as_good_as_it_says():
    normalised = np.array([(e.value - 0.3) / e.sigma for e in (learned(0.3, seed) for seed in range(12))])
    assert np.abs(normalised).max() < 3.0
    assert 0.4 < np.sqrt((normalised**2).mean()) < 1.6


def test_more_pairs_make_it_surer():
    few, many = learned(0.3, steps=2), learned(0.3, steps=12)
    assert many.sigma < 0.6 * few.sigma < PRIOR_SIGMA


def test_nothing_learned_is_nothing_corrected():
    estimate = DisparityOffset(CAMERA)
    none = np.zeros((0, 3))
    estimate.learn(Pairs(none, none, np.zeros((0, 3, 3)), np.zeros((0, 3, 3))), Step(np.eye(3), np.zeros(3)))
    assert (estimate.value, estimate.sigma) == (0.0, PRIOR_SIGMA)
