"""Section 4.4: each quantity is what it says, and the verdicts follow the numbers (10 s)."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stereo_slam_env.paper import drives, long_drive
from stereo_slam_env.paper.paper_claims import (
    DUAL,
    EUCLIDEAN,
    FILTERS,
    JOINT,
    MONOCULAR,
    NOISES,
    ODOMETRY,
    PAZ,
    PIXELS,
    POINTS,
    XYZ_POINTS,
    ClaimVerdict,
)
from stereo_slam_env.recording.recording import SIMULATION


@dataclass(frozen=True, eq=False)
class Run:
    """What the quantities need of a `FilterRun`."""

    positions: Any
    orientations: Any
    linear_velocities: Any
    true_positions: Any
    true_orientations: Any
    true_linear_velocities: Any
    pose_nees: Any
    landmark_nees: Any
    nis: Any
    nis_dof: Any
    window_nees_1s: Any
    timestamps: Any
    truth_from: Any = SIMULATION


FRAMES = 101
STEP = 0.5


def straight(scale=1.0, off=0.0, yaw=0.0, velocity=0.0, nees=6.0):
    """A run on a drive straight on, with its truth."""
    along = STEP * np.arange(FRAMES)
    ones = np.ones(FRAMES)
    return Run(
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
        window_nees_1s=nees * ones,
        timestamps=0.1 * np.arange(FRAMES),
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
    noise = 0.05 * np.random.default_rng(0).standard_normal((FRAMES, 3))
    assert abs(long_drive.scale_error_percent(replace(run, positions=run.positions + noise))) < 0.3


def results_of(ours, competitor, xyz, drives_of=8, key=None):
    """Results on several drives, the same but for a little spread; the left camera alone and odometry are as bad."""
    results = {}
    for noise in (key,) if key else NOISES:
        setting = drives.setting(noise)
        runs = {JOINT: ours, DUAL: competitor, PAZ: competitor, POINTS: ours, XYZ_POINTS: xyz, EUCLIDEAN: xyz}
        runs |= {MONOCULAR: straight(off=2.0, scale=1.05), ODOMETRY: straight(off=0.5)}
        for number, spread in enumerate(1.0 + 0.02 * (np.arange(drives_of) - drives_of / 2) / drives_of):
            arrays = {}
            for name, R in long_drive.cases(setting):
                run = runs[name]
                error = run.positions - run.true_positions
                spread_out = replace(run, positions=run.true_positions + spread * error)
                arrays |= {f"{name}.{R}.{key}": values for key, values in long_drive.quantities(spread_out).items()}
            results[f"drive.{noise}.{number:04d}"] = arrays
    return results


def verdicts(*runs, **about):
    return {claim.sentence.key: claim.verdict for claim in long_drive.judge(results_of(*runs, **about))}


def test_a_good_filter_with_bad_competitors():
    judged = verdicts(straight(off=0.1), straight(off=0.2), straight(off=1.0, nees=100.0))
    not_shown = {key for key, verdict in judged.items() if verdict is not ClaimVerdict.HOLDS}
    assert not_shown == {"no-divergence"}  # eight drives without a loss do not show that four in five survive


def test_a_bad_filter_with_good_competitors():
    bad = straight(off=3.0, scale=1.05, yaw=0.1, velocity=0.5, nees=20.0)
    judged = verdicts(bad, straight(off=0.1), straight(off=0.1))
    of_others = {"monocular-scale", "odometry-truth", "paz-consistent", "xyz-inconsistent", "nonlinearity"}
    refuted = {key for key, verdict in judged.items() if verdict is ClaimVerdict.DOES_NOT_HOLD}
    assert refuted == judged.keys() - of_others - {"no-divergence"} | {"xyz-inconsistent"}


def test_a_filter_that_is_too_cautious_is_not_consistent():
    cautious = verdicts(straight(off=0.1, nees=2.0), straight(off=0.2), straight())
    assert cautious["consistent"] is ClaimVerdict.DOES_NOT_HOLD


def test_drives_that_are_lost_are_counted():
    lost = verdicts(straight(off=6.0), straight(off=0.1), straight(off=0.1), drives_of=20)
    assert lost["no-divergence"] is ClaimVerdict.DOES_NOT_HOLD
    kept = verdicts(straight(off=0.1), straight(off=0.1), straight(off=0.1), drives_of=20)
    assert kept["no-divergence"] is ClaimVerdict.HOLDS


def test_a_few_drives_show_nothing():
    few = verdicts(straight(off=0.1), straight(off=0.2), straight(nees=100.0), drives_of=3)
    assert set(few.values()) == {ClaimVerdict.NOT_SHOWN}


def test_a_drive_on_which_the_filter_failed_has_no_accuracy_and_is_lost():
    run = replace(straight(off=0.1), positions=np.full((FRAMES, 3), np.nan))
    values = long_drive.quantities(run)
    assert np.isnan([values[name] for name in long_drive.ACCURACY]).all()
    assert values["diverged"] == 1.0


def test_the_motion_over_windows_does_not_care_where_the_drive_began():
    """A run that is turned and moved as a whole has moved as the truth; one with a longer path has not."""
    turned = straight()
    R = Rotation.from_rotvec([0.0, 0.3, 0.0])
    turned = replace(
        turned,
        positions=R.apply(turned.positions) + 5.0,
        orientations=(R * Rotation.from_quat(turned.orientations)).as_quat(),
    )
    np.testing.assert_allclose(long_drive.motion_errors(turned), np.zeros(FRAMES // 10), atol=1e-12)
    longer = long_drive.motion_errors(straight(scale=1.02))
    np.testing.assert_allclose(longer, np.full(FRAMES // 10, 0.02 * 10 * STEP))


def test_every_filter_has_the_right_R_and_three_have_both():
    for noise in NOISES:
        setting = drives.setting(noise)
        cases = long_drive.cases(setting)
        assert len(cases) == len(set(cases)) == 11
        assert {name for name, R in cases if setting.right == R} == set(FILTERS)


def test_a_simulated_drive_with_all_its_filters():
    (name, work), *_ = long_drive.experiments({PIXELS: 1}, 30, {}).items()
    assert name == "drive.pixels.0000"
    arrays = work()
    for case in long_drive.cases(drives.setting(PIXELS)):
        assert np.isfinite(arrays[".".join((*case, "position"))])
    assert arrays["said.yaw"].shape == arrays["true.yaw"].shape == (30,)
