"""Pairs of files as people have them: judged rightly, or not judged, or refused, with a true reason (40 s).

The layouts are those that are published; `test_trajectory_samples.py` has the published files themselves.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import stereo_slam_env as sse
from filters import Pose, StereoNoise
from filters.geometry import rotations

COUNT = 300
LOWER, UPPER = np.tril_indices(6), np.triu_indices(3)
CNSPY = "t,tx,ty,tz,qx,qy,qz,qw,pxx,pxy,pxz,pyy,pyz,pzz,qrr,qrp,qry,qpp,qpy,qyy,est_err_type,err_representation\n"
SQUARE = "#%FORMAT SQUARE/0.3\n#%REPRESENTATION gaussian_se3\n"


def pair():
    """An estimate with errors as it claims, in blocks of the position (world) and the rotation (body); its truth."""
    rng = np.random.default_rng(0)
    t = 0.1 * np.arange(COUNT)
    positions = np.cumsum(np.column_stack([np.sin(t / 5), 0.3 * np.cos(t / 3), np.cos(t / 7)]), axis=0)
    turns = np.column_stack([0.5 * np.sin(0.31 * t), 0.8 * np.sin(0.17 * t) + 0.1 * t, 0.4 * np.cos(0.23 * t)])
    orientations = Rotation.from_rotvec(turns).as_quat()
    covariances = np.zeros((COUNT, 6, 6))
    for part, size in ((slice(0, 3), 0.05), (slice(3, 6), 0.005)):
        factor = size * rng.normal(size=(COUNT, 3, 3))
        covariances[:, part, part] = factor @ factor.swapaxes(1, 2) + (0.3 * size) ** 2 * np.eye(3)
    errors = (np.linalg.cholesky(covariances) @ rng.normal(size=(COUNT, 6, 1)))[..., 0]
    turns = np.array([rotations.exp_quaternion(-phi) for phi in errors[:, 3:]])
    estimate = sse.Trajectory(positions - errors[:, :3], rotations.multiply(orientations, turns), t, covariances)
    return estimate, sse.Trajectory(positions, orientations, t, name="truth")


ESTIMATE, TRUTH = pair()


def tum(trajectory, times=None):
    t = trajectory.timestamps if times is None else times
    return np.column_stack([t, trajectory.positions, trajectory.orientations])


def kitti(trajectory):
    R = rotations.matrix(trajectory.orientations)
    return np.concatenate([R, trajectory.positions[:, :, None]], axis=2).reshape(COUNT, 12)


def text(rows, mark=" ", header=""):
    return header + "".join(mark.join(f"{x:.17g}" for x in row) + "\n" for row in rows)


def blocks(first, second):
    return np.concatenate([part[:, UPPER[0], UPPER[1]] for part in (first, second)], axis=1)


P, ROT = ESTIMATE.covariances[:, :3, :3], ESTIMATE.covariances[:, 3:, 3:]
R_WB = rotations.matrix(ESTIMATE.orientations)
IN_BODY = np.zeros((COUNT, 6, 6))
IN_BODY[:, :3, :3], IN_BODY[:, 3:, 3:] = R_WB.swapaxes(1, 2) @ P @ R_WB, ROT
IN_WORLD = np.zeros((COUNT, 6, 6))
IN_WORLD[:, :3, :3], IN_WORLD[:, 3:, 3:] = P, R_WB @ ROT @ R_WB.swapaxes(1, 2)
LEFT = np.tile(np.eye(6), (COUNT, 1, 1))
LEFT[:, :3, 3:] = rotations.skew(ESTIMATE.positions)
LEFT = LEFT @ IN_WORLD @ LEFT.swapaxes(1, 2)
SWAPPED = [3, 4, 5, 0, 1, 2]
PLANAR = IN_WORLD.copy()
PLANAR[:, [2, 3, 4], :] = PLANAR[:, :, [2, 3, 4]] = 0.0
UNKNOWN = PLANAR.copy()
UNKNOWN[:, [2, 3, 4], [2, 3, 4]] = 1e6
ONLY_Z = IN_WORLD.copy()
ONLY_Z[:, 2, :] = ONLY_Z[:, :, 2] = 0.0


def square(covariances, *lines):
    rows = np.column_stack([tum(ESTIMATE), covariances[:, LOWER[0], LOWER[1]]])
    return text(rows, header=SQUARE + "".join(f"#%{line}\n" for line in lines))


def full(covariances):
    return text(np.column_stack([tum(ESTIMATE), covariances.reshape(COUNT, 36)]))


def cnspy(error):
    rows = np.column_stack([tum(ESTIMATE), blocks(P, ROT if error == "type1" else IN_WORLD[:, 3:, 3:])])
    return CNSPY + "".join(",".join(f"{x:.17g}" for x in row) + f",{error},theta_R\n" for row in rows)


SOME = np.flatnonzero(np.arange(COUNT) % 7 != 3)
T_TUM, T_KITTI = text(tum(TRUTH)), text(kitti(TRUTH))
TIMES_1E9 = 1e9 * ESTIMATE.timestamps

JUDGED = {
    "OpenVINS, 20 columns": (text(np.column_stack([tum(ESTIMATE), blocks(ROT, P)])), T_TUM),
    "cnspy csv, rotation in the body": (cnspy("type1"), T_TUM),
    "cnspy csv, rotation about the world's axes": (cnspy("type2"), T_TUM),
    "SQUARE, right, translation first": (square(IN_BODY, "TANGENT_CONVENTION right_perturbation"), T_TUM),
    "SQUARE, right, rotation first": (
        square(IN_BODY[:, SWAPPED][:, :, SWAPPED], "TANGENT_ORDER rotation_translation"),
        T_TUM,
    ),
    "SQUARE, left": (square(LEFT, "TANGENT_CONVENTION left_perturbation"), T_TUM),
    "TUM and 36 covariances of ROS": (full(IN_WORLD), T_TUM),
}
"""Pairs with covariances, by the same numbers."""
REFUSED = {
    "29 numbers without a header": (square(IN_BODY).replace(SQUARE, ""), T_TUM, "29 columns and no header"),
    "times a factor of 1e9 apart": (text(tum(ESTIMATE, TIMES_1E9)), T_TUM, "as nanoseconds they would be at"),
    "KITTI, rows missing, not numbered": (text(kitti(ESTIMATE)[SOME]), T_KITTI, "must be the same frames, or be num"),
    "bodies named, and others": (
        square(IN_BODY, "BODY_FRAME imu"),
        square(IN_BODY, "BODY_FRAME lidar"),
        "poses of imu, reference of lidar",
    ),
    "cnspy, an error of SE(3)": (cnspy("type4"), T_TUM, r"errors \(type4, theta_R\) that are not read"),
    "no trajectory": ("a letter to a friend\n", T_TUM, "is no trajectory"),
}
"""Pairs that are refused, and why."""


def score(folder, estimate, truth, **options):
    for name, content in (("est.txt", estimate), ("ref.txt", truth)):
        (folder / name).write_text(content)
    return sse.evaluate_trajectory(folder / "est.txt", folder / "ref.txt", **options)


@pytest.mark.parametrize("name", JUDGED)
def test_the_same_claim_has_the_same_nees_in_every_layout(tmp_path, name):
    """Of layouts that are right and left only to first order: nearly."""
    right = sse.evaluate_trajectory(ESTIMATE, TRUTH, align="none").claims
    found = score(tmp_path, *JUDGED[name], align="none").claims
    for part in ("pose", "position", "rotation"):
        exact = part == "rotation" or "SQUARE" not in name
        assert found[part].nees.mean == pytest.approx(right[part].nees.mean, rel=1e-6 if exact else 0.1)
        assert found[part].verdict == "consistent, as far as one run can tell"


@pytest.mark.parametrize("covariances", [PLANAR, UNKNOWN], ids=["zero", "1e6"])
def test_a_claim_in_the_plane_is_judged_by_x_y_and_yaw(tmp_path, covariances):
    found = score(tmp_path, full(covariances), T_TUM, align="none")
    errors = ESTIMATE.errors(TRUTH.positions, TRUTH.orientations)[1:]
    errors[:, 3:] = rotations.turned(R_WB[1:], errors[:, 3:])
    for name, axes in (("pose", [0, 1, 5]), ("position", [0, 1]), ("rotation", [5])):
        e, P_own = errors[:, axes], IN_WORLD[1:][:, axes][:, :, axes]
        mean = np.mean(np.einsum("ki,kij,kj->k", e, np.linalg.inv(P_own), e))
        assert found.claims[name].nees.mean == pytest.approx(mean, rel=1e-6)
        assert found.claims[name].dof == len(axes)
    assert found.verdict == "consistent, as far as one run can tell"
    assert all(window.nees is None for window in found.windows)


def test_a_plane_is_carried_into_the_world_of_the_reference(tmp_path):
    """The world of the reference has another axis up: the claim is judged in the plane all the same."""
    tilted = Pose([5.0, -2.0, 1.0], rotations.exp_quaternion([0.4, -0.9, 0.7]))
    found = score(tmp_path, full(PLANAR), text(tum(TRUTH.moved(tilted))), align="rigid")
    flat = score(tmp_path, full(PLANAR), T_TUM, align="rigid")
    for name in ("pose", "position", "rotation"):
        assert found.claims[name].nees.mean == pytest.approx(flat.claims[name].nees.mean, rel=1e-5)


@pytest.mark.parametrize("nanoseconds", ["estimate", "truth"])
def test_times_in_seconds_and_in_nanoseconds_go_together(tmp_path, nanoseconds):
    """Seconds since 1970 in a float64 are exact to 2e-7."""
    right, seconds, whole = sse.evaluate_trajectory(ESTIMATE, TRUTH, align="none"), 1.5e9 + TRUTH.timestamps, 1.5e18
    times = [whole + np.round(TIMES_1E9) if nanoseconds == name else seconds for name in ("estimate", "truth")]
    found = score(tmp_path, text(tum(ESTIMATE, times[0])), text(tum(TRUTH, times[1])), align="none")
    assert found.frames == COUNT - 1  # the first of them starts the world
    assert found.position_rmse_m == pytest.approx(right.position_rmse_m, rel=1e-9)


def test_numbered_frames_of_kitti_are_paired_with_rows_missing(tmp_path):
    numbered = np.column_stack([np.arange(COUNT), kitti(ESTIMATE)])[SOME]
    found = score(tmp_path, text(numbered), T_KITTI, align="none")
    right = sse.evaluate_trajectory(ESTIMATE.rows(SOME), TRUTH.rows(SOME), align="none")
    assert found.frames == len(SOME) - 1
    assert found.position_rmse_m == pytest.approx(right.position_rmse_m, rel=1e-9)


def test_a_claim_without_z_is_no_claim_of_a_pose(tmp_path):
    found = score(tmp_path, full(ONLY_Z), T_TUM)
    assert found.verdict.startswith("none")
    assert any("too large to say anything, for z, so there is none of a" in note for note in found.notes)


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_read_is_refused_with_a_true_reason_in_one_line(tmp_path, name):
    estimate, truth, reason = REFUSED[name]
    with pytest.raises(ValueError, match=rf"\A.*{reason}.*\Z"):
        score(tmp_path, estimate, truth)


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
