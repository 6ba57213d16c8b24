"""Inputs that are doubted before the estimator is: fillers, empty rows, clocks, blocks, bodies and scales (30 s)."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import stereo_slam_env as sse
from filters import Pose, StereoNoise
from filters.geometry import rotations

from .test_pairs_of_files import COUNT, ESTIMATE, IN_WORLD, T_TUM, TRUTH, full, score, text, tum

RIGHT = sse.evaluate_trajectory(ESTIMATE, TRUTH, align="none")
T_EPOCH = 1.5e9 + TRUTH.timestamps


def filled(quaternion):
    return text(np.column_stack([TRUTH.timestamps, TRUTH.positions, np.tile(quaternion, (COUNT, 1))]))


def leica():
    """EuRoC's tracker of a prism: nanoseconds and a position."""
    rows = np.column_stack([1e9 * TRUTH.timestamps, TRUTH.positions])
    return text(rows, ",", "#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m]\n")


POSITIONS_ALONE = {
    "identity": filled([0.0, 0.0, 0.0, 1.0]),
    "another constant": filled(Rotation.from_rotvec([0.3, -1.2, 0.4]).as_quat()),
    "all zero": filled([0.0, 0.0, 0.0, 0.0]),
    "t x y z": text(tum(TRUTH)[:, :4]),
    "leica0": leica(),
    "named columns": text(tum(TRUTH)[:, :4], ",", "time,x,y,z\n"),
    "a comment above": text(tum(TRUTH)[:, :4], " ", "# timestamp tx ty tz\n"),
}
"""Truths without orientations that are data."""


@pytest.mark.parametrize("name", POSITIONS_ALONE)
def test_positions_alone_are_judged_where_orientations_are_no_data(tmp_path, name):
    found = score(tmp_path, full(IN_WORLD), POSITIONS_ALONE[name])
    assert found.alignment == "none"
    assert found.position_rmse_m == pytest.approx(RIGHT.position_rmse_m, rel=1e-6)
    assert found.rotation_rmse_deg is None
    assert set(found.claims) == {"position"}
    assert found.claims["position"].nees.mean == pytest.approx(RIGHT.claims["position"].nees.mean, rel=1e-6)
    assert found.verdict == "consistent, as far as one run can tell"


@pytest.mark.parametrize("name", ["identity", "all zero"])
def test_an_estimate_without_orientations_is_judged_by_its_positions(tmp_path, name):
    found = score(tmp_path, POSITIONS_ALONE[name], text(tum(ESTIMATE)), align="none")
    assert found.position_rmse_m == pytest.approx(RIGHT.position_rmse_m, rel=1e-6)
    assert found.rotation_rmse_deg is None


def test_positions_alone_are_not_aligned_by_a_start_that_needs_an_orientation(tmp_path):
    with pytest.raises(ValueError, match=r"align 'start' needs orientations.*'rigid'"):
        score(tmp_path, full(IN_WORLD), POSITIONS_ALONE["identity"], align="start")


# ---- rows that claim nothing ----------------------------------------------------------------------------------------

EMPTY = {
    "variance 9999": lambda rows: rows.__setitem__((slice(None), slice(8, None)), 9999.0 * np.eye(6).ravel()),
    "variance 1e6": lambda rows: rows.__setitem__((slice(None), slice(8, None)), 1e6 * np.eye(6).ravel()),
    "NaN covariance": lambda rows: rows.__setitem__((slice(None), slice(8, None)), np.nan),
    "NaN pose": lambda rows: rows.__setitem__((slice(None), slice(1, 8)), np.nan),
    "zero quaternion": lambda rows: rows.__setitem__((slice(None), slice(1, 8)), 0.0),
    "unknown by ROS": lambda rows: rows.__setitem__((slice(None), 8), -1.0),
}


@pytest.mark.parametrize("name", EMPTY)
def test_rows_that_claim_nothing_are_left_out_and_counted(tmp_path, name):
    rows = np.column_stack([tum(ESTIMATE), IN_WORLD.reshape(COUNT, 36)])
    lost = np.isin(np.arange(COUNT), [40, 41, 42, 200])
    part = rows[lost]
    EMPTY[name](part)
    rows[lost] = part
    found = score(tmp_path, text(rows), T_TUM, align="none")
    kept = sse.evaluate_trajectory(ESTIMATE.rows(np.flatnonzero(~lost)), TRUTH, align="none")
    assert found.frames == COUNT - 1 - 4
    assert found.position_rmse_m == pytest.approx(kept.position_rmse_m, rel=1e-6)
    assert found.claims["pose"].nees.mean == pytest.approx(kept.claims["pose"].nees.mean, rel=1e-6)
    assert any(f"4 of {COUNT} rows claim nothing" in note for note in found.notes)


def test_a_negative_variance_that_is_no_mark_is_an_error_of_the_file(tmp_path):
    rows = np.column_stack([tum(ESTIMATE), IN_WORLD.reshape(COUNT, 36)])
    rows[70, 8] = -4e-4
    found = score(tmp_path, text(rows), T_TUM, align="none")
    assert found.verdict.startswith("none: 1 of")
    assert any("pose 70 has a variance of -0.0004" in note for note in found.notes)


# ---- clocks ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("offset", [3.0, 18.0, -19.0, 37.0, 3600.0, -7200.0])
def test_clocks_that_differ_are_named_before_anything_else(tmp_path, offset):
    late = np.column_stack([tum(ESTIMATE, 1.5e9 + ESTIMATE.timestamps - offset), IN_WORLD.reshape(COUNT, 36)])
    late, truth = text(late), text(tum(TRUTH, T_EPOCH))
    if abs(offset) > TRUTH.timestamps[-1]:  # they have no time in common
        with pytest.raises(ValueError, match=rf"the paths fit with [+]?{offset:.2f}.*--time-offset auto"):
            score(tmp_path, late, truth)
    else:
        found = score(tmp_path, late, truth)
        assert found.verdict.startswith(f"calibration, frames or truth: the clocks seem to differ by {offset:+.1f}")
        assert all(claim.obstacle for claim in found.claims.values())
    mended = score(tmp_path, late, truth, time_offset="auto", interpolate=True, align="none")
    assert mended.time_offset_s == pytest.approx(offset, abs=0.02)
    assert mended.position_rmse_m < 1.5 * RIGHT.position_rmse_m


# ---- covariances ----------------------------------------------------------------------------------------------------


def rotation_first(covariances):
    exchanged = [3, 4, 5, 0, 1, 2]
    return covariances[:, exchanged][:, :, exchanged]


@pytest.mark.parametrize("smaller", [1.0, 0.1, 3.0])
def test_rotation_first_is_named_and_nothing_is_judged(tmp_path, smaller):
    """Whatever the sizes of the two are: they differ by a factor of 10, 100 and 3."""
    errors = ESTIMATE.errors(TRUTH.positions, TRUTH.orientations) * np.repeat([1.0, smaller], 3)
    poses = replace(
        ESTIMATE,
        orientations=rotations.multiply(TRUTH.orientations, rotations.exp_quaternion(-errors[:, 3:])),
        covariances=None,
    )
    P = IN_WORLD * np.outer(*[np.repeat([1.0, smaller], 3)] * 2)
    rows = np.column_stack([tum(poses), rotation_first(P).reshape(COUNT, 36)])
    found = score(tmp_path, text(rows), T_TUM, align="none")
    assert found.verdict.startswith("calibration, frames or truth: the covariances fit where the rotation block stands")
    right = score(tmp_path, text(np.column_stack([tum(poses), P.reshape(COUNT, 36)])), T_TUM, align="none")
    assert right.verdict == "consistent, as far as one run can tell"


@pytest.mark.parametrize("drift", [0.005, 0.02, 0.05])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_drift_to_one_side_turns_no_body(tmp_path, drift, axis):
    """It turns the path against orientations that are right."""
    gone = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(TRUTH.positions, axis=0), axis=1))])
    aside = replace(TRUTH, positions=TRUTH.positions + drift * np.outer(gone, np.eye(3)[axis]))
    found = score(tmp_path, text(tum(aside)), T_TUM, align="none")
    assert not any("body" in note for note in found.notes)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_quaternions_with_the_scalar_first_are_named_so_whatever_axis_they_turn_about(tmp_path, axis):
    t = TRUTH.timestamps
    turns = Rotation.from_rotvec(np.outer(0.1 * t + 0.2 * np.sin(t), np.eye(3)[axis])).as_quat()
    truth = np.column_stack([t, TRUTH.positions, turns])
    scalar_first = np.column_stack([t, TRUTH.positions + 0.01 * np.sin(3 * tum(TRUTH)[:, 1:4]), np.roll(turns, 1, 1)])
    found = score(tmp_path, text(scalar_first), text(truth))
    assert any("the estimate's quaternions are read as qw qx qy qz" in note for note in found.notes), found.notes


# ---- runs of filters ------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def recording():
    return sse.make_recording("quick", 1)


def with_truth(recording, changed):
    """The recording with another truth: of the pose and the number of the frame."""
    truths = [frame.truth for frame in recording.frames]
    frames = tuple(replace(frame, truth=changed(truths, k)) for k, frame in enumerate(recording.frames))
    return replace(recording, frames=frames)


def of_body(T_bc):
    return lambda truths, k: truths[k] @ T_bc


WRONG_TRUTHS = {
    "turned by 2 degrees": (of_body(Pose([0.0, 0.0, 0.0], rotations.exp_quaternion([0, 0, 0.035]))), "turn"),
    "turned by 90 degrees": (of_body(Pose([0.0, 0.0, 0.0], rotations.exp_quaternion([0, 0, np.pi / 2]))), "turned by"),
    "a lever arm": (of_body(Pose([0.1, 0.0, 0.0])), "a constant lever arm of"),
    "another scale": (lambda truths, k: replace(truths[k], position=1.1 * truths[k].position), "a scale of its own"),
    "another clock": (lambda truths, k: truths[max(k - 3, 0)], "the clocks seem to differ by +0."),
    "constant quaternions": (
        lambda truths, k: replace(truths[k], orientation=np.array([0.0, 0.0, 0.0, 1.0])),
        "the innovations are as claimed, NIS / dof 0.98",
    ),
}


@pytest.mark.parametrize("name", WRONG_TRUTHS)
def test_a_filter_is_not_condemned_by_a_wrong_truth(recording, name):
    changed, words = WRONG_TRUTHS[name]
    figures = sse.evaluate("inverse-depth", with_truth(recording, changed)).figures
    assert figures.pose_anees > figures.pose_anees_band[1]
    assert words in figures.doubt
    verdict = sse.compare(["inverse-depth"], with_truth(recording, changed)).verdict
    assert f"its covariance is not judged: calibration, frames or truth: {figures.doubt}" in verdict.headline
    assert "overconfident" not in verdict.headline


def test_nothing_is_doubted_of_a_filter_that_is_consistent_or_wrong_by_itself(recording):
    assert not sse.evaluate("inverse-depth", recording).figures.doubt
    figures = sse.evaluate("inverse-depth", recording, noise=StereoNoise(0.04 * recording.noise.R)).figures
    assert figures.pose_anees > figures.pose_anees_band[1]
    assert not figures.doubt
