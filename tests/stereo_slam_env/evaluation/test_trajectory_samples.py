"""Published trajectories with their references: no false verdict; ATE as of evo, k as of smfeval (20 s)."""

import json
import re
from dataclasses import replace
from importlib import import_module
from importlib.util import find_spec

import numpy as np
import pytest

import stereo_slam_env as sse
from stereo_slam_env.evaluation import trajectory_metrics as metrics
from stereo_slam_env.evaluation.body_frames import read_body
from stereo_slam_env.evaluation.synchronisation import paired
from stereo_slam_env.evaluation.trajectory_runs import score_runs

from ..real_data import real_data

PAIRS = {
    "fast_lio2": ("smfeval_fast_lio2/est.smfeval", "smfeval_fast_lio2/ref.tum"),
    "openvins": ("openvins_mh04/mh04_openvins.txt", "openvins_mh04/MH_04_difficult.txt"),
    "stereo vio": ("rpg_stereo_vio/vio_stereo_MH_03.txt", "rpg_stereo_vio/MH_03_medium.txt"),
    "cnspy 6": ("cnspy_mc/ID1-pose-est-posorient-cov-run6.csv", "cnspy_mc/ID1-pose-gt.csv"),
    "cnspy 7": ("cnspy_mc/ID1-pose-est-posorient-cov-run7.csv", "cnspy_mc/ID1-pose-gt.csv"),
    "cnspy 8": ("cnspy_mc/ID1-pose-est-posorient-cov-run8.csv", "cnspy_mc/ID1-pose-gt.csv"),
    "euroc": ("euroc_v102/V102.txt", "euroc_v102/V102_groundtruth.csv"),
    "kitti": ("kitti_13_columns/09_estimate.txt", "kitti_13_columns/09_truth.txt"),
    "rgbd slam": ("tum_fr1_xyz/freiburg1_xyz-rgbdslam.txt", "tum_fr1_xyz/freiburg1_xyz-groundtruth.txt"),
    "orb mono": ("tum_fr1_xyz/freiburg1_xyz-ORB_kf_mono.txt", "tum_fr1_xyz/freiburg1_xyz-groundtruth.txt"),
    "orb": ("tum_fr2_desk/fr2_desk_ORB.txt", "tum_fr2_desk/fr2_desk_groundtruth.txt"),
    "orb keyframes": ("tum_fr2_desk/fr2_desk_ORB_kf_mono.txt", "tum_fr2_desk/fr2_desk_groundtruth.txt"),
}


def files(name):
    folder = real_data("field") / "trajectories"
    return tuple(folder / path for path in PAIRS[name])


@pytest.mark.parametrize(
    ("name", "verdict", "note"),
    [
        ("fast_lio2", "calibration, frames or truth: the reference's body seems to be turned by 88.9°", "33 % of the"),
        ("openvins", "not judged: the estimate diverged 5.75 s after its first pose", "is not that of the reference"),
        ("stereo vio", "none: no covariance", "the error is 0.111 m after a rigid alignment"),
        ("cnspy 6", "overconfident: errors are 1.59 times the claimed sigma; but it depends on the alignment", None),
        ("cnspy 7", "consistent, as far as one run can tell", None),
        ("cnspy 8", "overconfident: errors are 1.77 times the claimed sigma; but it depends on the alignment", None),
        ("euroc", "none: no covariance", "4 of 807 rows repeat the time"),
        ("kitti", "none: no covariance", "a scale of its own, 0.0477 m for a metre"),
        ("orb keyframes", "none: no covariance", "a scale of its own, 0.449 m for a metre"),
    ],
)
def test_the_verdict_on_published_files_is_true(name, verdict, note):
    score = sse.evaluate_trajectory(*files(name))
    assert score.verdict.startswith(verdict)
    assert note is None or any(note in said for said in score.notes)


def test_the_runs_of_an_estimator_are_judged_together():
    found = score_runs([sse.evaluate_trajectory(*files(f"cnspy {k}")) for k in (6, 7, 8)]).claims["pose"]
    assert [round(value / 6.0, 2) for value in found.each] == [2.52, 0.83, 3.15]
    assert found.alone == 1
    assert found.verdict == "overconfident: errors are 1.47 times the claimed sigma"


def test_the_scale_gap_is_that_of_smfeval_once_the_body_is_moved():
    """k = 102 in the report that is published with the sample."""
    estimate, reference = files("fast_lio2")
    body = read_body(estimate.parent / "imu_to_lidar.json")
    score = sse.evaluate_trajectory(estimate, reference, body=body)
    expected = json.loads((estimate.parent / "expected_report.json").read_text())
    claim = score.claims["position"]
    scores = expected["scores"]
    assert score.frames == expected["sync"]["n_matched"]
    assert claim.coverage[0.9] == pytest.approx(expected["calibration"]["coverage"])
    assert claim.log_score.mean == pytest.approx(scores["log_score_translation"]["mean"], rel=0.02)
    assert claim.crps == pytest.approx(scores["translation_crps"]["mean"], rel=0.01)
    assert claim.energy_score == pytest.approx(scores["energy_score"]["mean"], rel=0.02)


@pytest.mark.skipif(find_spec("smfeval") is None, reason="needs smfeval (extra dev)")
def test_the_claimed_scale_gap_is_that_which_smfeval_computes(capsys):
    estimate, reference = files("fast_lio2")
    body = estimate.parent / "imu_to_lidar.json"
    arguments = [
        "nees",
        str(estimate),
        str(reference),
        "--ref-body-frame",
        "lidar",
        "--body-frame-transform",
        str(body),
    ]
    assert import_module("smfeval.cli.main").main([*arguments, "--json"]) == 0
    theirs = json.loads(capsys.readouterr().out)
    claim = sse.evaluate_trajectory(estimate, reference, body=read_body(body)).claims["position"]
    assert claim.claimed_scale_gap == pytest.approx(theirs["k"], rel=0.01)
    assert claim.scale_gap == pytest.approx(theirs["k"], rel=0.02)


@pytest.mark.skipif(find_spec("smfeval") is None, reason="needs smfeval (extra dev)")
@pytest.mark.parametrize("name", ["cnspy 6", "cnspy 7", "cnspy 8", "openvins"])
def test_the_scale_gap_of_all_that_claim_is_that_of_smfeval(name, tmp_path, capsys):
    """The same pairs in its format, by the error that it knows, Log of SE(3): those of ours differ in second order."""
    estimate, reference = (sse.load_trajectory(path) for path in files(name))
    square, tum = tmp_path / "est.square", tmp_path / "ref.tum"
    sse.save_trajectory(square, replace(estimate, gauge="fixed"))
    square.write_text(re.sub("#%TANGENT_CHART.*\n", "", square.read_text()))
    sse.save_trajectory(tum, replace(reference, covariances=None))
    arguments = ["nees", str(square), str(tum), "--ref-body-frame", "body", "--json"]
    assert import_module("smfeval.cli.main").main(arguments) == 0
    theirs = json.loads(capsys.readouterr().out)
    claim = sse.evaluate_trajectory(square, tum, align="none").claims["position"]
    assert claim.claimed_scale_gap == pytest.approx(theirs["k"], rel=0.01)


@pytest.mark.skipif(find_spec("evo") is None, reason="needs evo (extra evo)")
@pytest.mark.parametrize("name", PAIRS)
def test_errors_of_published_files_are_those_of_evo(name):
    """The same pairs given to both: APE, as it is, aligned, with scale; of the rotation; RPE over 10 poses."""
    from evo.core import metrics as evo
    from evo.core.trajectory import PosePath3D

    estimate, reference = (sse.load_trajectory(path) for path in files(name))
    pairs = paired(estimate, reference)
    ours, theirs = (
        PosePath3D(one.positions.copy(), np.roll(one.orientations, 1, axis=1).copy())
        for one in (pairs.reference, pairs.estimate)
    )

    def ape(relation):
        found = evo.APE(relation)
        found.process_data((ours, theirs))
        return found.get_statistic(evo.StatisticsType.rmse)

    p, q = pairs.estimate.positions, pairs.reference.positions
    assert metrics.ate_unaligned(p, q) == pytest.approx(ape(evo.PoseRelation.translation_part), rel=1e-9)
    turned = metrics.rotation_errors(pairs.estimate.orientations, pairs.reference.orientations)
    assert metrics.root_mean_square(turned) == pytest.approx(ape(evo.PoseRelation.rotation_angle_rad), rel=1e-9)
    rpe = evo.RPE(evo.PoseRelation.translation_part, delta=10, delta_unit=evo.Unit.frames, all_pairs=True)
    rpe.process_data((ours, theirs))
    first = np.arange(len(p) - 10)
    moved, _ = metrics.relative_errors(
        p, pairs.estimate.orientations, q, pairs.reference.orientations, first, first + 10
    )
    assert metrics.root_mean_square(moved) == pytest.approx(rpe.get_statistic(evo.StatisticsType.rmse), rel=1e-9)
    theirs.align(ours)
    assert metrics.ate_rigid(p, q) == pytest.approx(ape(evo.PoseRelation.translation_part), rel=1e-9)
    theirs.align(ours, correct_scale=True)
    assert metrics.ate_scaled(p, q) == pytest.approx(ape(evo.PoseRelation.translation_part), rel=1e-9)
