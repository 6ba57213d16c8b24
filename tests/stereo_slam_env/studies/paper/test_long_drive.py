"""Section 4.4: each quantity is what it says, and the verdicts follow the numbers (1 s)."""

import numpy as np
import pytest
from stereo_slam_env.studies.paper.settings import NOISES

from stereo_slam_env.studies.paper import long_drive
from stereo_slam_env.studies.paper.claims import Verdict

FRAMES = 101
STEP = 0.5


def straight(scale=1.0, off=0.0, yaw=0.0, velocity=0.0, nees=6.0):
    """A drive straight on: what a filter says of it."""
    along = scale * STEP * np.arange(FRAMES)
    positions = np.column_stack([np.full(FRAMES, off), np.zeros(FRAMES), along])
    velocities = np.tile([velocity, 0.0, 5.0], (FRAMES, 1))
    ones = np.ones(FRAMES)
    return {
        "positions": positions,
        "yaw": yaw * ones,
        "velocities": velocities,
        "pose_nees": nees * ones,
        "landmark_nees": 0.5 * nees * ones,
        "nis": 25.0 * nees * ones,
        "nis_dof": np.full(FRAMES, 150),
    }


TRUE = {name: straight()[name] for name in ("positions", "yaw", "velocities")}


def test_quantities():
    assert long_drive.position_rmse(straight(off=0.3), TRUE) == pytest.approx(0.3)
    assert long_drive.drift_percent(straight(off=0.3), TRUE) == pytest.approx(0.6)
    assert long_drive.yaw_rmse(straight(yaw=0.01), TRUE) == pytest.approx(np.rad2deg(0.01))
    assert long_drive.velocity_rmse(straight(velocity=0.1), TRUE) == pytest.approx(0.1)
    assert long_drive.scale_error_percent(straight(scale=1.02), TRUE) == pytest.approx(2.0)
    assert long_drive.scale_error_percent(straight(scale=0.99), TRUE) == pytest.approx(-1.0)
    assert long_drive.pose_nees(straight(nees=9.0), TRUE) == pytest.approx(1.5)
    assert long_drive.landmark_nees(straight(nees=9.0), TRUE) == pytest.approx(1.5)
    assert long_drive.nis(straight(nees=9.0), TRUE) == pytest.approx(1.5)


def test_jitter_is_no_error_of_the_scale():
    said = straight()
    said["positions"] = said["positions"] + 0.05 * np.random.default_rng(0).standard_normal((FRAMES, 3))
    assert abs(long_drive.scale_error_percent(said, TRUE)) < 0.3


def results_of(ours, rival, xyz, drives=8):
    """Arrays of several drives, the same but for a little spread."""
    found = {}
    for noise in NOISES:
        for seed in range(drives):
            arrays = {f"{long_drive.TRUTH}.{name}": values for name, values in TRUE.items()}
            spread = 1.0 + 0.02 * (seed - drives / 2) / drives
            for (name, R), said in zip(long_drive.cases(noise), (ours, ours, rival, xyz), strict=True):
                moved = said | {"positions": TRUE["positions"] + spread * (said["positions"] - TRUE["positions"])}
                arrays |= {f"{name}.{R}.{series}": values for series, values in moved.items()}
            found[f"drive-{noise}-{seed:04d}"] = arrays
    return found


def verdicts(*said):
    return {claim.sentence.key: claim.verdict for claim in long_drive.claims(results_of(*said))}


def test_a_good_filter_with_bad_rivals():
    judged = verdicts(straight(off=0.1), straight(off=0.2), straight(off=1.0, nees=100.0))
    assert set(judged.values()) == {Verdict.HOLDS}


def test_a_bad_filter_with_good_rivals():
    bad = straight(off=3.0, scale=1.05, yaw=0.1, velocity=0.5, nees=20.0)
    judged = verdicts(bad, straight(off=0.1), straight(off=0.1))
    assert set(judged.values()) == {Verdict.DOES_NOT_HOLD}


def test_a_filter_that_is_too_cautious_is_not_consistent():
    assert verdicts(straight(off=0.1, nees=2.0), straight(off=0.2), straight())["consistent"] is Verdict.DOES_NOT_HOLD


def test_a_few_drives_show_nothing():
    few = long_drive.claims(results_of(straight(off=0.1), straight(off=0.2), straight(nees=100.0), drives=3))
    assert {claim.verdict for claim in few} == {Verdict.NOT_SHOWN}


def test_a_drive_on_which_the_filter_failed_is_left_out():
    results = results_of(straight(off=0.1), straight(off=0.2), straight(nees=100.0))
    name, R = long_drive.cases("uvd")[0]
    lost = results["drive-uvd-0000"]
    lost[f"{name}.{R}.positions"] = np.full((FRAMES, 3), np.nan)
    values = long_drive.of_drives(results, "uvd", (name, R), long_drive.position_rmse)
    assert np.isnan(values).tolist() == [True] + [False] * 7


@pytest.mark.parametrize("place", ["drive", "street"])
def test_a_part_has_every_case_and_the_truth(place):
    arrays = long_drive.compute(place, "pixels", 0, 25)
    for name, R in long_drive.cases("pixels"):
        assert long_drive.one(arrays, f"{name}.{R}")["positions"].shape == (25, 3)
    truth = long_drive.one(arrays, long_drive.TRUTH)
    ours = long_drive.one(arrays, "inverse-depth.full")
    assert long_drive.position_rmse(ours, truth) < 0.3
