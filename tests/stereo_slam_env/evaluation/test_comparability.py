"""What keeps files from being compared: bodies, worlds, scales, clocks, swapped readings, divergence (10 s)."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import stereo_slam_env as sse
from filters import Pose
from filters.geometry import rotations
from stereo_slam_env.evaluation.body_frames import find_body_offset, read_body
from stereo_slam_env.evaluation.claims import Fit
from stereo_slam_env.evaluation.comparability import without_fillers
from stereo_slam_env.evaluation.synchronisation import find_time_offset, paired, share_at_risk

COUNT, DT = 300, 0.1
ROLL = rotations.exp_quaternion([0.0, 0.0, np.deg2rad(89.0)])


def drive(seed=0, error=0.01, **about):
    """A winding flight with independent errors of 1 cm and .01 rad that are claimed as they are, and its truth."""
    rng = np.random.default_rng(seed)
    t = DT * np.arange(COUNT)
    positions = np.column_stack([4.0 * np.sin(t / 3), 4.0 * np.cos(t / 4), np.sin(t / 2)])
    turns = Rotation.from_rotvec(np.column_stack([0.4 * np.sin(t / 2), 0.3 * np.cos(t / 3), t / 5]))
    truth = sse.Trajectory(positions, turns.as_quat(), t, name="truth")
    e = error * rng.normal(size=(COUNT, 6))
    orientations = rotations.multiply(truth.orientations, rotations.exp_quaternion(-e[:, 3:]))
    claimed = np.tile(error**2 * np.eye(6), (COUNT, 1, 1))
    return sse.Trajectory(positions - e[:, :3], orientations, t, claimed, name="mine", **about), truth


def noted(score, text):
    return any(text in note for note in score.notes)


def test_nothing_is_said_where_nothing_is_strange():
    score = sse.evaluate_trajectory(*drive())
    assert score.notes == ()
    assert score.verdict.startswith("consistent")
    assert score.diverged_at_s is None


# ---- bodies ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("world", [Pose(), Pose([5.0, 7.0, -2.0], rotations.exp_quaternion([0.1, -0.2, 1.5]))])
@pytest.mark.parametrize(
    ("T_bc", "parts", "words"),
    [
        (Pose([0.0, 0.0, 0.0], ROLL), {"pose", "rotation"}, "turned by 89° about"),
        (Pose([0.3, -0.2, 0.1]), {"pose", "position"}, "m away"),
        (Pose([0.3, -0.2, 0.1], ROLL), {"pose", "position", "rotation"}, "m away"),
    ],
    ids=["turned", "apart", "both"],
)
def test_another_body_is_named_and_is_no_claim(T_bc, parts, words, world):
    estimate, truth = drive(gauge="se3")
    other = estimate.of_body(T_bc.inverse()).moved(world)
    score = sse.evaluate_trajectory(other, truth)
    assert {name for name, claim in score.claims.items() if claim.obstacle} == parts
    assert words in score.claims["pose"].verdict
    assert "calibration, frames or truth: the reference's body seems to be" in score.verdict
    found = find_body_offset(other, truth).T_bc
    np.testing.assert_allclose((found @ T_bc.inverse()).log(), 0.0, atol=0.03)
    for body in (T_bc, "estimated"):
        mended = sse.evaluate_trajectory(other, truth, body=body)
        assert mended.verdict.startswith("consistent")
        assert 0.8 < mended.claims["pose"].nees.mean / 6.0 < 1.2


def test_bodies_that_are_named_need_the_pose_between_them():
    estimate, truth = drive(body="imu")
    lidar = replace(truth, body="lidar")
    with pytest.raises(ValueError, match="the pose of lidar in imu as body"):
        sse.evaluate_trajectory(estimate, lidar)
    assert sse.evaluate_trajectory(estimate, lidar, body=Pose()).verdict.startswith("consistent")


def test_a_constant_error_that_is_claimed_is_no_other_body():
    """Two degrees, and 2 degrees claimed; a tenth of that claimed, it is named."""
    estimate, truth = drive(error=1e-3)
    turned = estimate.of_body(Pose([0.0, 0.0, 0.0], rotations.exp_quaternion([0.0, 0.0, np.deg2rad(2.0)])))
    for sigma, is_named in ((np.deg2rad(2.0), False), (np.deg2rad(0.2), True)):
        claimed = np.tile(np.diag(np.repeat([1e-6, sigma**2], 3)), (COUNT, 1, 1))
        score = sse.evaluate_trajectory(replace(turned, covariances=claimed), truth)
        assert bool(score.claims["rotation"].obstacle) == is_named


def test_on_a_straight_line_the_body_is_found_from_relative_motions():
    estimate, truth = drive()
    line = np.outer(np.arange(COUNT), [1.0, 2.0, 0.0])
    estimate = replace(estimate, positions=line + estimate.positions - truth.positions)
    found = find_body_offset(estimate.of_body(Pose([0.0, 0.0, 0.0], ROLL).inverse()), replace(truth, positions=line))
    np.testing.assert_allclose(found.T_bc.R_wc, Pose(np.zeros(3), ROLL).R_wc, atol=0.03)


def test_a_drift_is_no_other_body():
    estimate, truth = drive()
    turn = rotations.exp_quaternion(np.outer(np.linspace(0.0, 0.5, COUNT), [0.0, 0.0, 1.0]))
    drifting = replace(estimate, orientations=rotations.multiply(turn, estimate.orientations))
    score = sse.evaluate_trajectory(drifting, truth)
    assert not score.claims["rotation"].obstacle
    assert score.claims["rotation"].verdict.startswith("overconfident")


@pytest.mark.parametrize("rows", [list(range(9)), "3x3"])
def test_a_body_is_read_from_json(tmp_path, rows):
    R = Rotation.from_rotvec([0.1, 0.2, 0.3]).as_matrix()
    written = R.ravel() if rows != "3x3" else R
    (tmp_path / "T.json").write_text(json.dumps({"R": written.tolist(), "t": [1, 2, 3]}))
    found = read_body(tmp_path / "T.json")
    np.testing.assert_allclose(found.R_wc, R)
    assert found.position.tolist() == [1.0, 2.0, 3.0]


SCALED = '{"R": [2, 0, 0, 0, 2, 0, 0, 0, 2], "t": [0, 0, 0]}'


@pytest.mark.parametrize("content", ["{}", "[]", '{"R": [1, 2], "t": 3}', '{"R": "a", "t": [0, 0, 0]}', "x", SCALED])
def test_a_body_that_is_none_is_refused_in_one_line(tmp_path, content):
    (tmp_path / "T.json").write_text(content)
    with pytest.raises(ValueError, match=r"\A.*T\.json.*\Z"):
        read_body(tmp_path / "T.json")


# ---- readings, scales, worlds ---------------------------------------------------------------------------------------


def inverted(trajectory):
    inverse = [trajectory.pose(k).inverse() for k in range(len(trajectory))]
    return replace(trajectory, positions=[T.position for T in inverse], orientations=[T.orientation for T in inverse])


def scalar_first(trajectory):
    return replace(trajectory, orientations=np.roll(trajectory.orientations, 1, axis=1))


@pytest.mark.parametrize("whose", ["estimate", "reference"])
@pytest.mark.parametrize(
    ("swap", "words"),
    [(scalar_first, "{}'s quaternions are read as qw qx qy qz"), (inverted, "one of them is read as T_bw")],
    ids=["wxyz", "inverse"],
)
def test_a_swapped_reading_is_named_and_is_no_claim(swap, words, whose):
    estimate, truth = drive(error=0.002)
    pair = (swap(estimate), truth) if whose == "estimate" else (estimate, swap(truth))
    score = sse.evaluate_trajectory(*pair)
    assert score.verdict.startswith("calibration, frames or truth: the files fit five times better")
    assert words.format(whose) in score.verdict


def test_a_scale_of_its_own_is_named_and_is_no_claim():
    estimate, truth = drive()
    score = sse.evaluate_trajectory(estimate.moved(Pose(), 0.25), truth)
    assert "a scale of its own, 0.25 m for a metre: --align sim3" in score.verdict
    assert "body" not in score.verdict
    aligned = sse.evaluate_trajectory(estimate.moved(Pose(), 0.25), truth, align="sim3")
    assert aligned.scale == pytest.approx(4.0, rel=1e-3)
    assert aligned.verdict.startswith("consistent")


def test_a_world_of_its_own_without_a_header_is_aligned_by_its_start():
    estimate, truth = drive(gauge=None)
    assert sse.evaluate_trajectory(estimate, truth).alignment == "none"
    elsewhere = sse.evaluate_trajectory(estimate.moved(Pose([50.0, 0.0, 0.0])), truth)
    assert elsewhere.alignment == "start"
    assert noted(elsewhere, "the world of mine is not that of the reference")
    silent = replace(estimate, covariances=None).moved(Pose([50.0, 0.0, 0.0]))
    assert noted(sse.evaluate_trajectory(silent, truth), "m after a rigid alignment")


def test_the_verdict_says_where_it_hangs_on_an_alignment_that_no_header_says():
    """A common offset that is not claimed is seen without an alignment, and not with one."""
    estimate, truth = drive(gauge=None)
    shifted = replace(estimate, positions=estimate.positions + 0.05)
    score = sse.evaluate_trajectory(shifted, truth)
    assert [gauge.alignment for gauge in score.gauges] == ["none", "start", "gravity-yaw", "rigid"]
    assert score.depends_on_the_gauge
    assert "but it depends on the alignment" in score.verdict
    assert not sse.evaluate_trajectory(shifted, truth, align="rigid").depends_on_the_gauge
    assert not sse.evaluate_trajectory(replace(shifted, gauge="fixed"), truth).depends_on_the_gauge


def test_a_claim_that_is_wrong_by_another_size_under_another_alignment_is_another_one():
    """Ten times too tight however it is aligned, and a hundred times more where a common offset is not aligned away."""
    estimate, truth = drive(gauge=None)
    tight = replace(estimate, covariances=0.01 * estimate.covariances)
    alike = sse.evaluate_trajectory(tight, truth)
    assert {gauge.fit for gauge in alike.gauges} == {Fit.TIGHT}
    assert not alike.depends_on_the_gauge
    offset = replace(tight, positions=tight.positions + 0.5)
    score = sse.evaluate_trajectory(offset, truth, align="none")
    sizes = {gauge.alignment: gauge.error_ratio for gauge in score.gauges}
    assert sizes["none"] > 2.0 * sizes["rigid"]
    assert not score.depends_on_the_gauge  # the caller has said which
    open_one = replace(score, gauge_is_open=True)
    assert open_one.depends_on_the_gauge
    assert all(f"({kind})" in open_one.verdict for kind in sizes)


def test_a_diverged_estimate_is_called_so_with_the_time():
    """Far away; or, over the last fifth, three times as fast: it ends less than the whole path away."""
    estimate, truth = drive()
    away = np.maximum(DT * np.arange(COUNT) - 12.0, 0.0)[:, None] ** 2 * [10.0, 0.0, 0.0]
    score = sse.evaluate_trajectory(replace(estimate, positions=estimate.positions + away), truth)
    assert 12.0 < score.diverged_at_s < 14.0
    assert score.verdict.startswith("not judged: the estimate diverged 1")
    assert "3.2" in score.verdict  # km
    assert {claim.obstacle != "" for claim in score.claims.values()} == {True}
    row = int(0.8 * COUNT)
    late = np.concatenate([np.zeros((row, 3)), 2.0 * (truth.positions[row:] - truth.positions[row])])
    score = sse.evaluate_trajectory(replace(estimate, positions=estimate.positions + late), truth)
    assert score.diverged_at_s == pytest.approx(DT * row, rel=0.1)


# ---- clocks ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("offset", [-0.37, 0.083])
def test_an_offset_of_the_clocks_is_found(offset):
    estimate, truth = drive()
    late = replace(estimate, timestamps=estimate.timestamps - offset)
    assert find_time_offset(late, truth) == pytest.approx(offset, abs=0.004)
    mended = sse.evaluate_trajectory(late, truth, time_offset="auto", interpolate=True)
    assert mended.time_offset_s == pytest.approx(offset, abs=0.004)
    assert mended.position_rmse_m < 0.02
    given = sse.evaluate_trajectory(late, truth, time_offset=offset)
    assert given.position_rmse_m == pytest.approx(sse.evaluate_trajectory(estimate, truth).position_rmse_m, rel=1e-6)
    assert noted(sse.evaluate_trajectory(late, truth, max_gap=0.05), f"the clocks seem to differ by {offset:+.2}")


def test_an_offset_that_no_path_shows_is_not_made_up():
    _, truth = drive()
    line = replace(truth, positions=np.outer(np.arange(COUNT), [1.0, 0.0, 0.0]))
    with pytest.raises(ValueError, match="time_offset is not determined"):
        find_time_offset(line, line)
    with pytest.raises(ValueError, match="a file has no times"):
        sse.evaluate_trajectory(replace(truth, timestamps=None), truth, time_offset="auto")


@pytest.mark.parametrize(
    ("degrees", "metres", "turned", "apart"),
    [(0.4, 0.0, False, False), (0.6, 0.0, True, False), (0.0, 0.008, False, False), (0.0, 0.013, False, True)],
)
def test_half_a_degree_and_a_centimetre_are_another_body_and_less_is_not(degrees, metres, turned, apart):
    _, truth = drive()
    T_bc = Pose(
        [0.0, 0.6 * metres, -0.8 * metres], rotations.exp_quaternion(np.deg2rad(degrees) * np.array([0.6, 0.0, 0.8]))
    )
    found = find_body_offset(truth.of_body(T_bc.inverse()), truth)
    assert (found.turned, found.apart) == (turned, apart)
    assert bool(found.words) == (turned or apart)
    np.testing.assert_allclose((found.T_bc @ T_bc.inverse()).log(), 0.0, atol=1e-3)


@pytest.mark.parametrize(
    ("late", "common"), [(0.0, COUNT), (1e-6, COUNT - 1), (-1e-6, COUNT - 1), (3.0 * DT, COUNT - 3)]
)
def test_the_ends_of_a_reference_are_within_it(late, common):
    estimate, truth = drive()
    found = paired(replace(estimate, timestamps=truth.timestamps + late), truth, interpolate=True)
    assert len(found.rows) == common


def test_poses_are_paired_within_the_gap_each_once_and_more_than_three():
    """The nearer one of two; the gap itself belongs to it."""
    _, truth = drive()
    short = truth.rows(slice(0, 6))
    apart = replace(short, timestamps=np.array([0.0, 0.25, 0.5, 0.75, 1.0, 1.25]))
    shifts = np.array([0.0, 0.0625, -0.0625, 0.03125, 0.0625, -0.125])
    late = replace(apart, timestamps=apart.timestamps + shifts)
    found = paired(late, apart, max_gap=0.0625)
    assert found.rows.tolist() == [0, 1, 2, 3, 4]
    np.testing.assert_array_equal(found.gaps, np.abs(shifts[:5]))
    np.testing.assert_array_equal(found.reference.timestamps, apart.timestamps[:5])
    twice = replace(late, timestamps=np.array([0.0, 0.03, 0.25, 0.5, 0.76, 0.78]))
    found = paired(twice, apart, max_gap=0.1)
    assert found.rows.tolist() == [0, 2, 3, 4]
    assert len(paired(late.rows(slice(0, 4)), apart, max_gap=0.0625).rows) == 4
    for few, gap, common in ((slice(0, 3), 0.0625, 3), (slice(None), 0.05, 2)):
        with pytest.raises(ValueError, match=f"have {common} poses in common, more than 3 are needed"):
            paired(late.rows(few), apart, max_gap=gap)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("offset", [-47.3, 12.1])
def test_clocks_that_are_far_off_are_found_by_what_both_paths_do(offset, scale):
    """Whatever the unit of the path, and with an estimate of its second half alone."""
    estimate, truth = drive(error=1e-4)
    estimate, truth = (replace(one, positions=scale * one.positions) for one in (estimate, truth))
    half = estimate.rows(slice(COUNT // 2, None))
    for one in (estimate, half):
        late = replace(one, timestamps=one.timestamps - offset)
        assert find_time_offset(late, truth) == pytest.approx(offset, abs=0.004)


@pytest.mark.parametrize("whole", ["estimate", "reference"])
def test_clocks_are_found_where_the_part_in_common_is_faster_than_the_rest(whole):
    """A slow half, then a fast one, of which alone the other one has a part: the mean speed says nothing of clocks."""
    t = DT * np.arange(4 * COUNT)
    speed = np.where(t < t[-1] / 2.0, 0.5 + 0.2 * np.sin(t), 20.0 + 2.0 * np.sin(t / 2) + np.cos(1.7 * t))
    heading = np.cumsum(0.2 * np.sin(t / 3) + 0.1 * np.sin(t)) * DT
    path = np.cumsum(speed * DT * np.array([np.cos(heading), np.sin(heading), np.zeros(len(t))]), axis=1).T
    truth = sse.Trajectory(path, np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1)), t, name="truth")
    fast = truth.rows(slice(5 * len(t) // 8, 7 * len(t) // 8))
    estimate, reference = (truth, fast) if whole == "estimate" else (fast, truth)
    late = replace(estimate, timestamps=estimate.timestamps - 200.0)
    assert find_time_offset(late, reference) == pytest.approx(200.0, abs=0.004)


@pytest.mark.parametrize("whose", ["mine", "truth"])
def test_equal_orientations_beside_a_turning_camera_are_a_filler(whose):
    """On a straight path, where the path itself does not tell."""
    line = np.outer(DT * np.arange(COUNT), [1.0, 0.0, 0.0])
    turning, still = (replace(one, positions=line) for one in drive())
    still = replace(still, orientations=np.tile([0.0, 0.0, 0.0, 1.0], (COUNT, 1)))
    pair = (replace(still, name="mine"), turning) if whose == "mine" else (turning, still)
    kept = without_fillers(*(replace(one, name=name) for one, name in zip(pair, ("mine", "truth"), strict=True)))
    assert kept[2] == [f"all quaternions of {whose} are equal, which is a filler: positions alone are judged"]
    assert not kept[0].is_oriented
    assert not kept[1].is_oriented


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_orientations_that_are_equal_in_both_are_fillers_where_the_path_bends(scale):
    """Whatever its unit; on a straight one they may be data."""
    estimate, truth = (replace(one, orientations=np.tile([0.0, 0.0, 0.0, 1.0], (COUNT, 1))) for one in drive())
    bent = [replace(one, positions=scale * one.positions) for one in (estimate, truth)]
    assert len(without_fillers(*bent)[2]) == 2
    line = scale * np.outer(DT * np.arange(COUNT), [1.0, 0.0, 0.0])
    assert without_fillers(*(replace(one, positions=line) for one in bent))[2] == []


def test_the_reference_is_taken_between_its_poses():
    _, truth = drive()
    between = truth.timestamps[:-1] + 0.5 * DT
    found = paired(replace(truth.rows(slice(0, -1)), timestamps=between), truth, interpolate=True)
    assert len(found.rows) == COUNT - 1
    np.testing.assert_allclose(found.reference.positions, 0.5 * (truth.positions[1:] + truth.positions[:-1]))
    half = Rotation.from_quat(truth.orientations[:-1]).inv() * Rotation.from_quat(found.reference.orientations)
    whole = Rotation.from_quat(truth.orientations[:-1]).inv() * Rotation.from_quat(truth.orientations[1:])
    np.testing.assert_allclose(2.0 * half.as_rotvec(), whole.as_rotvec(), atol=1e-9)
    rows = paired(truth, truth.rows(np.r_[0:100, 200:COUNT]), interpolate=True).rows
    assert not np.any((rows > 99) & (rows < 200))  # nothing across a hole


def test_the_risk_of_synchronisation_is_speed_times_gap_over_the_claim():
    estimate, truth = drive()
    late = replace(estimate, timestamps=estimate.timestamps + 0.004)
    risk = share_at_risk(paired(late, truth))
    speed = np.linalg.norm(np.gradient(truth.positions, truth.timestamps, axis=0), axis=1)
    assert risk == np.mean(speed * 0.004 > 0.3 * 0.01) > 0.1
    assert noted(
        sse.evaluate_trajectory(late, truth), f"at {100 * risk:.0f} % of the poses the time to the reference's"
    )
    assert not noted(sse.evaluate_trajectory(late, truth, interpolate=True), "of the poses the time")


@pytest.mark.parametrize(("unit", "name"), [(1e9, "nanoseconds"), (1e6, "microseconds"), (1e3, "milliseconds")])
def test_times_in_another_unit_are_named(unit, name):
    estimate, truth = drive()
    odd = replace(estimate, timestamps=unit * (7.0 + estimate.timestamps))
    with pytest.raises(ValueError, match=f"the times of the estimate seem to be {name}"):
        sse.evaluate_trajectory(odd, truth)
    lasts = (
        r"lasts from 100000 to 100029\.9 s, the reference from 0 to 29\.9 s; if it is another clock, say by how much"
    )
    with pytest.raises(ValueError, match=lasts):
        sse.evaluate_trajectory(replace(estimate, timestamps=estimate.timestamps + 1e5), truth)
