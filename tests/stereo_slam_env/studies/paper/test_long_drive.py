"""Section 4.4: each quantity is what it says, and the verdicts follow the numbers (1 s)."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stereo_slam_env.studies.paper import long_drive
from stereo_slam_env.studies.paper.claims import ASSUMED, NOISES, ClaimVerdict

FRAMES = 101
STEP = 0.5


def straight(scale=1.0, off=0.0, yaw=0.0, velocity=0.0, nees=6.0):
    """A run on a drive straight on, with its truth."""
    along = STEP * np.arange(FRAMES)
    ones = np.ones(FRAMES)
    return SimpleNamespace(
        positions=np.column_stack([off * ones, 0.0 * ones, scale * along]),
        orientations=np.tile(Rotation.from_rotvec([0.0, yaw, 0.0]).as_quat(), (FRAMES, 1)),
        linear_velocities=np.tile([velocity, 0.0, 5.0], (FRAMES, 1)),
        true_positions=np.column_stack([0.0 * ones, 0.0 * ones, along]),
        true_orientations=np.tile([0.0, 0.0, 0.0, 1.0], (FRAMES, 1)),
        true_linear_velocities=np.tile([0.0, 0.0, 5.0], (FRAMES, 1)),
        pose_nees=nees * ones,
        landmark_nees=0.5 * nees * ones,
        nis=25.0 * nees * ones,
        nis_dof=np.full(FRAMES, 150),
    )


def test_quantities():
    assert long_drive.position_rmse(straight(off=0.3)) == pytest.approx(0.3)
    assert long_drive.drift_percent(straight(off=0.3)) == pytest.approx(0.6)
    assert long_drive.yaw_rmse(straight(yaw=0.01)) == pytest.approx(np.rad2deg(0.01))
    assert long_drive.velocity_rmse(straight(velocity=0.1)) == pytest.approx(0.1)
    assert long_drive.scale_error_percent(straight(scale=1.02)) == pytest.approx(2.0)
    assert long_drive.scale_error_percent(straight(scale=0.99)) == pytest.approx(-1.0)
    assert long_drive.pose_nees(straight(nees=9.0)) == pytest.approx(1.5)
    assert long_drive.landmark_nees(straight(nees=9.0)) == pytest.approx(1.5)
    assert long_drive.nis(straight(nees=9.0)) == pytest.approx(1.5)


def test_the_yaw_has_no_jumps():
    turns = np.linspace(0.0, 3.0 * np.pi, 50)
    orientations = Rotation.from_rotvec(np.outer(turns, [0.0, 1.0, 0.0])).as_quat()
    np.testing.assert_allclose(long_drive.yaw(orientations), turns, atol=1e-12)


def test_jitter_is_no_error_of_the_scale():
    run = straight()
    run.positions = run.positions + 0.05 * np.random.default_rng(0).standard_normal((FRAMES, 3))
    assert abs(long_drive.scale_error_percent(run)) < 0.3


def runs_of(ours, competitor, xyz, drives=8):
    """Runs on several drives, the same but for a little spread."""
    found = {}
    for noise in NOISES:
        cases = long_drive.cases(long_drive.DRIVE, noise)
        for case, run in zip(cases, (ours, ours, competitor, xyz), strict=True):
            error = run.positions - run.true_positions
            found[case] = [
                SimpleNamespace(**vars(run) | {"positions": run.true_positions + spread * error})
                for spread in 1.0 + 0.02 * (np.arange(drives) - drives / 2) / drives
            ]
    return found


def verdicts(*runs):
    return {claim.sentence.key: claim.verdict for claim in long_drive.judge(runs_of(*runs))}


def test_a_good_filter_with_bad_competitors():
    judged = verdicts(straight(off=0.1), straight(off=0.2), straight(off=1.0, nees=100.0))
    assert set(judged.values()) == {ClaimVerdict.HOLDS}


def test_a_bad_filter_with_good_competitors():
    bad = straight(off=3.0, scale=1.05, yaw=0.1, velocity=0.5, nees=20.0)
    judged = verdicts(bad, straight(off=0.1), straight(off=0.1))
    assert set(judged.values()) == {ClaimVerdict.DOES_NOT_HOLD}


def test_a_filter_that_is_too_cautious_is_not_consistent():
    assert (
        verdicts(straight(off=0.1, nees=2.0), straight(off=0.2), straight())["consistent"] is ClaimVerdict.DOES_NOT_HOLD
    )


def test_a_few_drives_show_nothing():
    few = long_drive.judge(runs_of(straight(off=0.1), straight(off=0.2), straight(nees=100.0), drives=3))
    assert {claim.verdict for claim in few} == {ClaimVerdict.NOT_SHOWN}


def test_a_drive_on_which_the_filter_failed_is_left_out():
    runs = [straight(off=0.1) for _ in range(8)]
    runs[0].positions = np.full((FRAMES, 3), np.nan)
    assert np.isnan(long_drive.of_runs(runs, long_drive.position_rmse)).tolist() == [True] + [False] * 7


def test_the_benchmark_runs_every_case():
    """A cell has one assumed R, so each case is in one cell; `test_command` runs them."""
    study = long_drive.study(drives=3, frames=22)
    cases = []
    for cell in study.cells:
        place, noise, R = cell.factors.values()
        assert len(cell.scenario.seeds) == (3 if place == "drive" else 1)
        assert np.array_equal(cell.scenario.assumed_noise(None).R, ASSUMED[R].R)
        cases += [(place, noise, choice.name, R) for choice in cell.scenario.filters]
    wanted = [case for place in ("drive", "street") for noise in NOISES for case in long_drive.cases(place, noise)]
    assert sorted(cases) == sorted(wanted)
